"""What one channel has said so far, and its value at any time: samples (stamp [ns], value)."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
import math
from typing import Protocol

from vsensor_ros.functions.curve import Curve
from vsensor_ros.reason import Reason

_HELD = 10  # times its age is that of a value which is held on, beside one on a line
_MOST = 2**16  # samples kept at most, whatever is sent
DUPLICATE = Reason.of('duplicate stamp')
BACKWARDS = Reason.of('stamp runs backwards')


class Samples:
    """Samples of one channel in the order of their stamps, which strictly increase."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self.values: list[float] = []

    def moved(self) -> Samples:
        """Return all samples, and forget them."""
        new = self.apart()
        new.stamps, self.stamps[:] = self.stamps[:], []
        new.values, self.values[:] = self.values[:], []
        return new

    def apart(self) -> Samples:
        """Return an empty one for samples of the same channel that are not believed."""
        return Samples()

    def drop_after(self, time: int) -> int:
        """Forget the samples after a time; return how many."""
        count = len(self.stamps) - bisect_right(self.stamps, time)
        if count:
            del self.stamps[-count:], self.values[-count:]
        return count

    def add(self, stamp: int, value: float, latest_wins: bool = False) -> Reason | None:
        """Append a sample, or put it in the place of one with the same stamp; return why not."""
        if self.stamps and stamp <= self.stamps[-1]:
            if latest_wins and stamp == self.stamps[-1]:
                self.values[-1] = value
                return None
            return DUPLICATE if stamp == self.stamps[-1] else BACKWARDS
        if len(self.stamps) >= _MOST:
            self._drop(_MOST // 2)
        self.stamps.append(stamp)
        self.values.append(value)
        return None

    def forget(self, before: int) -> None:
        """Drop what no value at or after this time depends on."""
        count = bisect_right(self.stamps, before) - 1
        if count > len(self.stamps) // 2:  # now and then: each drop moves the rest
            self._drop(count)

    def _drop(self, count: int) -> None:
        del self.stamps[:count], self.values[:count]

    def interpolated(self, time: int, max_age: int, seen: Seen = ()) -> float | None:
        """
        Return a reading's value at a time [ns]: linear between samples, else held.

        None before the first sample, and where the last one is older than max_age [ns] and the
        next one unknown or too far from it to say what was between them. What each sample has
        seen of commands, which jump, is taken out of it.
        """
        stamps = self.stamps
        i = bisect_right(stamps, time)
        if i == 0:
            return None
        age, value = time - stamps[i - 1], self.values[i - 1]
        if seen:
            value -= _of_commands(seen, stamps[i - 1])
        if i < len(stamps) and (gap := stamps[i] - stamps[i - 1]) <= max_age:
            part, after = age / gap, self.values[i]
            if seen:
                after -= _of_commands(seen, stamps[i])
            return value + part * (after - value)  # of one that is stuck just what it says
        return value if age <= max_age else None

    def age(self, time: int) -> int:
        """
        Return how much of a guess `interpolated` is at a time [ns]; 0: it is a sample, or none.

        On a line the geometric mean of the times to both samples, for a line is off by their
        product; ten times the age while the next one has not come.
        """
        i = bisect_right(self.stamps, time)
        age = time - self.stamps[i - 1] if i else 0
        return math.isqrt(age * (self.stamps[i] - time)) if age and i < len(self.stamps) \
            else _HELD * age

    def before(self, time: int) -> int:
        """Return the last stamp before a time [ns], or that time where there is none."""
        i = bisect_left(self.stamps, time)
        return self.stamps[i - 1] if i else time


class Held(Protocol):
    """A command, which holds a value at each time."""

    def held(self, time: int) -> float | None:
        """Return what counts at a time [ns]; None when nothing ever has."""


# gains of commands in a reading, and these commands
Seen = Sequence[tuple[float, Held]]


class Curved(Samples):
    """Samples of a sensor that shows a curve of its linear reading: that is what they say."""

    def __init__(self, curve: Curve, beside: Seen) -> None:
        """Begin; beside: the commands that are added to the curve."""
        super().__init__()
        self._curve, self._beside = curve, beside

    def apart(self) -> Samples:
        """Return an empty one for readings that are not believed."""
        return Curved(self._curve, self._beside)

    def interpolated(self, time: int, max_age: int, seen: Seen = ()) -> float | None:
        """Return the linear reading's value at a time [ns], see `Samples`."""
        i, near = max(bisect_right(self.stamps, time) - 1, 0), Samples()
        near.stamps = self.stamps[i:i + 2]
        near.values = [self._curve.linear(value, _of_commands(self._beside, stamp))
                       for stamp, value in zip(near.stamps, self.values[i:i + 2])]
        return near.interpolated(time, max_age, seen)


def _of_commands(seen: Seen, time: int) -> float:
    """Return what a reading at a time [ns] has in it of commands; one never given counts as 0."""
    return sum(gain * (command.held(time) or 0.0) for gain, command in seen)
