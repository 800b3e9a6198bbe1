"""What one command has said so far: each value holds until the next one, or until it has ended."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import math

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank.readings import Samples

PERIODIC = 10  # intervals in a row, none longer than max_age, of a command that comes periodically
_NEVER = 2**63  # ns


@dataclass(frozen=True)
class End:
    """
    When a command that comes no more has ended, and what counts from then on.

    It has ended when nothing has come of it for max_age [s], or ever. Then `value` counts; None:
    nothing does, and what reads it stops. only_periodic: a command that did not come periodically
    holds; it ends only when what came of it later could not be used.
    """

    max_age: float = 0.5
    value: float | None = None
    only_periodic: bool = False


def check_ends(ends: Mapping[str, End], commands: Sequence[str]) -> None:
    """Raise BadInput when one is of no command, or has a number that is none."""
    for name, end in ends.items():
        if name not in commands:
            raise BadInput('', 'command_ends', f'{name} is no command',
                           f'name one of {", ".join(commands)}' if commands else 'leave it out')
        if not end.max_age > 0.0:
            raise BadInput('', 'command_ends', f'{end.max_age} is not a time in s',
                           'give a number above 0')
        if end.value is not None and not math.isfinite(end.value):
            raise BadInput('', 'command_ends', f'{end.value} is not a value', 'give a number')


class Command(Samples):
    """Values of one command, at stamps [ns] that strictly increase. It jumps at its stamps."""

    def __init__(self, end: End | None, least: int) -> None:
        """Begin; end: None, it holds for ever. least: max_age at least [ns]."""
        super().__init__()
        self._age = _NEVER if end is None else max(round(min(end.max_age, 1e9) * 1e9), least)
        self._value = None if end is None else end.value
        self._only_periodic = end is not None and end.only_periodic
        self._began: int | None = None  # time
        self._unusable: list[int] = []  # when such a one came, the first after a value only
        self.may_stop = end is not None and end.value is None  # what reads it

    def begin(self, time: int) -> None:
        """Note when time began: a command that never comes has ended max_age later."""
        self._began = time

    def take(self, stamp: int, value: float) -> bool:
        """Append a value, or put it in the place of one with the same stamp; tell whether."""
        if self.add(stamp, value, latest_wins=True) is not None:
            return False
        if self._unusable and self._unusable[-1] >= stamp:
            del self._unusable[bisect_left(self._unusable, stamp):]
        return True

    def spoil(self, time: int) -> None:
        """Note that what came at a time could not be used: no value is known to hold since."""
        if self.stamps and self._age != _NEVER and not (
                self._unusable and self._unusable[-1] >= self.stamps[-1]):
            self._unusable.append(max(time, self.stamps[-1]))

    @property
    def spoilt(self) -> int | None:
        """When something came after the last value that could not be used, or None."""
        last = self._unusable[-1:]
        return last[0] if last and last[0] >= self.stamps[-1] else None

    def forget(self, before: int) -> None:
        """Drop what no value at or after this time depends on."""
        first = bisect_right(self.stamps, before) - 1 - PERIODIC
        if first > 0:
            super().forget(self.stamps[first])
            del self._unusable[:bisect_left(self._unusable, self.stamps[0])]

    def held(self, time: int) -> float | None:
        """Return what counts at a time, be it that a value holds; None when nothing ever has."""
        i = bisect_right(self.stamps, time) - 1
        if i >= 0 and time - self.stamps[i] < self._age:  # mostly
            return self.values[i]
        return self._counts(i, time)

    def stopped(self, time: int) -> bool:
        """Tell whether it has ended at a time, and nothing counts in its place."""
        stamps = self.stamps
        if not self.may_stop or not stamps or 0 <= time - stamps[-1] <= self._age:
            return False
        i = bisect_right(stamps, time) - 1
        return i >= 0 and time - stamps[i] > self._age and time > self._end_of(i)

    def over(self, start: int, end: int) -> tuple[float, float, float]:
        """
        Return (at the start, at the end, mean) over a step.

        Start and end are those of the straight line with the same mean and the same first moment,
        which does to an observer what the jumps do, to third order in the step.
        """
        stamps = self.stamps
        first = bisect_right(stamps, start)
        if first == len(stamps) > 0 and end - stamps[-1] <= self._age:
            value = self.values[-1]
            return value, value, value
        before = self._counts(first - 1, start)
        if before is None:
            return 0.0, 0.0, 0.0  # nobody who reads it is running yet
        value, mean, slope = before, before, 0.0
        for time, new in self._jumps(first, bisect_left(stamps, end), start, end):
            part, jump, value = (time - start) / (end - start), new - value, new
            mean += jump * (1.0 - part)
            slope += 6.0 * jump * part * (1.0 - part)
        return mean - slope / 2, mean + slope / 2, mean

    def _counts(self, i: int, time: int) -> float | None:
        """Return what counts at a time of the i-th value; -1: that is before the first."""
        if i < 0:
            late = self._began is not None and time - self._began >= self._age
            return self._value if late else None
        if self._value is not None and time - self.stamps[i] >= self._age and \
                time >= self._end_of(i):
            return self._value
        return self.values[i]

    def _jumps(self, first: int, last: int, start: int, end: int) -> Iterable[tuple[int, float]]:
        """Return from when what counts anew between two times; first: the next value, of last."""
        stamps, values = self.stamps, self.values
        if self._value is None:
            return zip(stamps[first:last], values[first:last])
        jumps = list(zip(stamps[first:last], values[first:last]))
        for i in range(max(first - 1, 0), last):
            at = self._end_of(i)
            if start < at < end and (i + 1 == len(stamps) or at < stamps[i + 1]):
                jumps.append((at, self._value))
        return sorted(jumps)

    def _end_of(self, i: int) -> int:
        """Return when the i-th value has ended, if no other one comes before."""
        stamp = self.stamps[i]
        if not self._only_periodic or self._is_periodic(i):
            return stamp + self._age
        unusable = self._unusable[bisect_left(self._unusable, stamp):]
        return unusable[0] + self._age if unusable else _NEVER

    def _is_periodic(self, i: int) -> bool:
        """Tell whether the values up to the i-th came periodically."""
        return i >= PERIODIC and all(self.stamps[k] - self.stamps[k - 1] <= self._age
                                     for k in range(i, i - PERIODIC, -1))
