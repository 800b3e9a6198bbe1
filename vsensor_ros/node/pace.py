"""How the loop keeps up with its rate, on a steady clock."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math
import time

LAST = 1000  # ticks that the figures are of
AWAKE = 150_000  # ns before the time, from which on it waits awake: a sleep ends late


@dataclass(frozen=True)
class Health:
    """How the loop keeps up, and what it had no use for; times in s."""

    rate: float  # Hz, of the virtual sensors, as configured
    achieved: float  # Hz, over the last ticks; NaN before there are two
    step_p50: float  # computing time of the last ticks
    step_p99: float
    step_max: float
    jitter_p99: float  # |interval - period| of the last ticks
    not_used: int  # messages of isolation that were not used, or not wholly
    thrown_away: int  # of these, not even read: too large, or too many


class Pace:
    """When the last ticks began and what they cost [ns]."""

    def __init__(self) -> None:
        self._begun: deque[int] = deque(maxlen=LAST)
        self._spent: deque[int] = deque(maxlen=LAST)
        self._before = 0  # spent before it waited

    def rest(self) -> None:
        """Forget when ticks began: the next interval is none."""
        self._begun.clear()

    def begin(self) -> None:
        """Note that a tick begins."""
        self._before = 0
        self._begun.append(time.perf_counter_ns())

    def wait(self, left: int) -> None:
        """Wait in a tick [ns]; it counts as begun when that is over, though some of it is done."""
        begin = time.perf_counter_ns()
        self._before = begin - self._begun[-1]
        if left > AWAKE:
            time.sleep((left - AWAKE) * 1e-9)
        while time.perf_counter_ns() < begin + left:
            pass
        self._begun[-1] = time.perf_counter_ns()

    def end(self) -> None:
        """Note that it is done."""
        self._spent.append(time.perf_counter_ns() - self._begun[-1] + self._before)

    def step(self) -> tuple[float, float, float]:
        """Return the median, the 99th percentile and the largest of the costs [s]."""
        spent = sorted(self._spent)
        return _part(spent, 0.5), _part(spent, 0.99), _part(spent, 1.0)

    def achieved(self) -> float:
        """Return the rate of the last ticks [Hz]; NaN before there are two."""
        if len(self._begun) < 2 or self._begun[-1] == self._begun[0]:
            return math.nan
        return (len(self._begun) - 1) / ((self._begun[-1] - self._begun[0]) * 1e-9)

    def jitter(self, period: int) -> float:
        """Return the 99th percentile of how far intervals are from the period [s]."""
        begun = list(self._begun)
        return _part(sorted(abs(b - a - period) for a, b in zip(begun, begun[1:])), 0.99)


def _part(ordered: list[int], part: float) -> float:
    return ordered[round(part * (len(ordered) - 1))] * 1e-9 if ordered else math.nan
