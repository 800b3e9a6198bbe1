"""When the bank is stepped, and how far. Times are in ns, on the node's clock."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from vsensor_ros.bank import Bank
from vsensor_ros.node.clock import NodeClock
from vsensor_ros.node.pace import Pace

CATCH_UP = 10  # ticks made good one by one when the loop or the clock is late; else the newest
SLACK = 0.25  # of a period that a tick waits for readings: a held one is a small step behind
LONGEST_SLACK = 2_000_000  # that it waits at most
TOGETHER = 5  # steps taken at once while nobody needs an estimate


class Ticks:
    """
    The ticks of a bank: on its grid of times, a little later, so that readings have come.

    While all sensors are healthy nobody needs an estimate. Then the bank stays behind: steps cost
    less together than one by one, and none has to be redone with a reading that comes late. It
    catches up before it is asked.
    """

    def __init__(self, bank: Bank, clock: NodeClock) -> None:
        self.pace = Pace()
        self._bank, self._clock, self._period = bank, clock, bank.period
        self._slack = min(round(SLACK * bank.period), LONGEST_SLACK)
        self._last = 0  # tick, while the bank has no grid yet
        self._behind = 0  # by which the state is older than the last tick
        self._due = 0

    @property
    def time(self) -> int:
        """Time of the last tick."""
        time = self._bank.time
        return self._last if time is None else time + self._behind

    @property
    def due(self) -> int | None:
        """Time of the next tick by the system's clock; None when that is not known."""
        return None if self._clock.simulated else self._due

    def now(self, without: Collection[str]) -> Iterator[int]:
        """Yield the times of the ticks that are due; their readings, but of those named, come."""
        now, period = self._clock.now, self._period
        if now == 0 or (now < self._due and not self._clock.simulated):
            return  # 0: simulated time has not begun
        last = self.time
        if self._clock.simulated:
            missed = (now - last) // period
            if missed == 1 and now < last + period + self._slack and \
                    not self._bank.confirmed(last + period, without):
                return
        else:  # at a fixed phase, whatever has arrived
            missed = (now - self._slack - last) // period
        if missed > CATCH_UP:
            if last:
                self.pace.overruns += missed - 1
            last = now - now % period - period if self._bank.time is None \
                else last + (missed - 1) * period
            missed = 1
        for i in range(1, missed + 1):  # mostly once
            self.pace.begin()
            yield last + i * period
            self.pace.end()
        self._due = self.time + period + self._slack

    def advance(self, at: int, idle: bool) -> None:
        """Bring the bank to a tick; idle: nobody needs it yet."""
        self._last = at
        if idle:
            self._behind += self._period
            if self._behind > TOGETHER * self._period or self._bank.time is None:
                self._behind = self._period
                self._bank.advance(at - self._period)
        else:
            self._behind = 0
            self._bank.advance(at)

    def catch_up(self) -> None:
        """Bring the bank to the last tick."""
        if self._behind:
            at, self._behind = self.time, 0
            self._bank.advance(at)

    def restart(self) -> None:
        """Begin anew after the clock jumped."""
        self._last, self._behind, self._due = self._clock.now, 0, 0
