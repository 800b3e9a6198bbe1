"""
Readings that wrap, such as a heading that jumps at +-pi.

Inside they are one angle that goes on and on, so that it can be interpolated, integrated and
differentiated. Only what goes out is put into the range that the driver uses.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from types import MappingProxyType

import numpy as np

from vsensor_ros.bank.readings import Samples
from vsensor_ros.functions.curve import Curve
from vsensor_ros.reason import Reason

MOST_TURNS = 1e9  # of a reading; beyond them its angle is lost in rounding
ROUNDING = 1e-3  # of a turn by which a driver may overstep its range
SMALL, LARGE = 0.25, 1.5  # turns that a reading may move on, and a driver's number may jump
NO_ANGLE = Reason('no angle')


class Angle:
    """
    What is known of a sensor that wraps: its turn [unit of the sensor], the range of its driver.

    That is -turn/2 to turn/2 until a reading lies beyond; then 0 to turn, if none was negative;
    else the driver does not wrap, and goes on and on itself.
    """

    def __init__(self, turn: float) -> None:
        self.turn = turn
        self._low: float | None = -turn / 2.0  # of the range; None: there is none
        self._negative = False  # a reading was
        self._before = math.nan  # the last reading that counted

    def learn(self, reading: float) -> None:
        """Learn the range from a reading as it came; a sudden one far away is no evidence."""
        turn, slack = self.turn, ROUNDING * self.turn
        beyond = self._low is not None and not \
            self._low - slack <= reading <= self._low + turn + slack
        if beyond:
            step = reading - self._before
            if abs(step) > LARGE * turn or abs(self.shortest(step)) > SMALL * turn:
                return
            positive = not self._negative and 0.0 <= reading <= turn + slack
            self._low = 0.0 if positive else None
        self._negative = self._negative or reading < -slack
        self._before = reading

    def put(self, value: float, near: float = math.nan) -> float:
        """Return an angle as the driver would say it; near: next to this, if it does not wrap."""
        if self._low is None:
            return self.next_to(value, near)
        middle = self._low + self.turn / 2.0
        return value - self.whole(value - middle)  # either end of the range is left as it is

    def next_to(self, value: float, near: float) -> float:
        """Return the same angle, by whole turns as near as can be to another; NaN: as it is."""
        return value + self.whole(near - value)

    def shortest(self, difference: float) -> float:
        """Return a difference of two angles the short way round."""
        return difference - self.whole(difference)

    def whole(self, difference: float) -> float:
        """Return the whole turns in a difference of two angles, 0 if it is not finite."""
        turns = difference / self.turn
        return round(turns) * self.turn if math.isfinite(turns) else 0.0


class Angles(Samples):
    """
    Samples of a sensor that wraps: each is put next to the one before.

    The first, and the first after more than `max_age` [ns], is put next to what `alike` say of the
    same angle then: others, each with a factor to the unit of these. Else it stays as it came.
    offset: by how much readings lie above the angle.
    """

    def __init__(self, angle: Angle, max_age: int, offset: float = 0.0,
                 learns: bool = True) -> None:
        super().__init__()
        self.alike: Sequence[tuple[Angles, float]] = ()
        self._angle, self._max_age, self._offset = angle, max_age, offset
        self._learns = learns

    def apart(self) -> Angles:
        """Return an empty one for readings that are not believed."""
        return Angles(self._angle, self._max_age, self._offset, learns=False)

    def add(self, stamp: int, value: float, latest_wins: bool = False) -> Reason | None:
        """Append a sample; return why not."""
        if abs(value) > MOST_TURNS * self._angle.turn:
            return NO_ANGLE
        reason = super().add(stamp, self._angle.next_to(
            value - self._offset, self._near(stamp)), latest_wins)
        if reason is None and self._learns:
            self._angle.learn(value)
        return reason

    def _near(self, stamp: int) -> float:
        if self.stamps and stamp - self.stamps[-1] <= self._max_age:
            return self.values[-1]
        for other, factor in self.alike:
            said = other.interpolated(stamp, other._max_age)
            if said is not None:
                return factor * said
        return math.nan


def samples_of(turns: Mapping[str, float], angles: Mapping[str, Angle],
               ages: Mapping[str, int],
               curves: Mapping[str, Curve] = MappingProxyType({})) -> dict[str, Samples]:
    """Return empty samples of sensors of one angle; turns: of each, negative if it runs back."""
    found = {name: Angles(angles[name], ages[name],
                          curves[name].offset if name in curves else 0.0) for name in turns}
    for name, samples in found.items():
        samples.alike = [(other, turns[name] / turns[of])
                         for of, other in found.items() if of != name]
    return dict(found)


class ShortWay:
    """Makes differences of readings and estimates (.., O) the short way round where they wrap."""

    def __init__(self, turns: Sequence[float | None]) -> None:
        """Prepare for O columns, each with its turn; None: it does not wrap."""
        self._all = turns
        self._columns = [i for i, turn in enumerate(turns) if turn is not None]
        self._turns = np.array([turn for turn in turns if turn is not None])

    def of(self, outputs: Iterable[int]) -> ShortWay:
        """Return what does so to the differences of some outputs alone."""
        return ShortWay([self._all[output] for output in outputs])

    def __call__(self, differences: np.ndarray) -> np.ndarray:
        """Return the differences; the array itself may be changed."""
        if self._columns:
            wrapped = differences[..., self._columns]
            differences[..., self._columns] = wrapped - self._turns * np.rint(
                wrapped / self._turns)
        return differences
