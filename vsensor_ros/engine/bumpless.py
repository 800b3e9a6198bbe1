"""
A change of source without a jump: an offset that dies out is added to the new one's values.

Pure: times [ns] are arguments. One for each channel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

_GONE = 1e-3  # of its first size: what is left of an offset then is dropped
_SOON = 0.2  # time constants, in which what is not believed goes


@dataclass(frozen=True)
class Bumpless:
    """
    output = value + offset * exp(-age / time_constant) + passing * (1 - age / soon)^2.

    Where age is t - since, and all in units of the channel. So what the offset does to the output
    has fallen to 37 % after one time constant, and is gone after 7. What is `passing`, because the
    old source was not to be believed so far, is gone after a fifth of one: that is soon. With the
    time constant 0 there is never any. Raises ValueError, one line.
    """

    time_constant: float  # s
    offset: float = 0.0  # at `since`
    passing: float = 0.0  # at `since`
    since: int = 0  # ns
    before: float = math.nan  # the last output before the switch, until the first one after it
    step: float = math.nan  # that first output minus the last before; nan: none is known
    steps: int = 0  # switches begun

    def __post_init__(self) -> None:
        if not (math.isfinite(self.time_constant) and self.time_constant >= 0.0):
            raise ValueError(f'time_constant: {self.time_constant} is not a time in s; '
                             'give 0 or more')

    def begin(self, time: int, offset: float, before: float = math.nan,
              passing: float = 0.0) -> Bumpless:
        """
        Switch: add this offset to the new source's values from now on; none if not finite.

        passing: added, too, but not for long. before: the last output that went out, nan when
        there was none. Something that is left of the last switch is forgotten: see `left`.
        """
        if not math.isfinite(offset + passing) or self.time_constant == 0.0:
            offset = passing = 0.0
        return replace(self, offset=float(offset), passing=float(passing), since=time,
                       before=float(before), step=math.nan, steps=self.steps + 1)

    def left(self, time: int) -> float:
        """
        Return what is left of the offset at a time.

        A little before `since` it is the whole offset; more than a time constant before, when the
        clock was set back, there is none.
        """
        return sum(self._parts(time))

    def doubtful(self, time: int) -> float:
        """Return what is left at a time of what is passing."""
        return self._parts(time)[1]

    def _parts(self, time: int) -> tuple[float, float]:
        """Return what is left of the offset, and of what is passing."""
        if (self.offset == 0.0 and self.passing == 0.0) or self.time_constant == 0.0:
            return 0.0, 0.0
        age = (time - self.since) * 1e-9 / self.time_constant
        if age <= -1.0:
            return 0.0, 0.0
        factor = math.exp(-max(age, 0.0))
        return self.offset * factor if factor >= _GONE else 0.0, \
            self.passing * (1.0 - min(max(age / _SOON, 0.0), 1.0))**2

    def active(self, time: int) -> bool:
        """Tell whether anything is left of the offset."""
        return self.left(time) != 0.0

    def add(self, value: float, time: int) -> float:
        """Return the output for a value of the source."""
        return value + self.left(time)

    def sent(self, output: float) -> Bumpless:
        """Note an output that goes out: the first one after a switch gives its step."""
        if math.isnan(self.before) or math.isnan(output):
            return self
        return replace(self, step=output - self.before, before=math.nan)

    def with_time_constant(self, time_constant: float, time: int) -> Bumpless:
        """Let what is left decay with another time constant [s] from now on."""
        offset, passing = self._parts(time)
        return replace(self, time_constant=time_constant, offset=offset, passing=passing,
                       since=time)
