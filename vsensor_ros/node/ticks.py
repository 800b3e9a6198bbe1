"""When the bank is stepped, and how far. Times are in ns, on the node's clock."""

from __future__ import annotations

from collections.abc import Collection, Iterator
import time

from vsensor_ros.bank import Bank
from vsensor_ros.engine.clock import NodeClock
from vsensor_ros.node.pace import Pace

CATCH_UP = 10  # ticks made good one by one when the loop or the clock is late; else the newest
SLACK = 0.25  # of a period that a tick waits for readings: a held one is a small step behind
LONGEST_SLACK = 2_500_000  # that it waits at most
LEAD = 0.6  # of what a tick waits, by which one that is to send begins sooner, and then holds
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
        self._lead = round(LEAD * self._slack)
        self._sending: int | None = None  # when what the tick sends is due
        self.due = 0  # by the system's clock: when to look whether there is a tick

    @property
    def time(self) -> int:
        """Time of the last tick."""
        time = self._bank.time
        return self._last if time is None else time + self._behind

    def now(self, without: Collection[str]) -> Iterator[int]:
        """
        Yield the times of the ticks that are due; their readings, but of those named, come.

        Those are the failed ones. If there are such, ticks begin sooner, and `hold` waits.
        """
        now, period, simulated = self._clock.now, self._period, self._clock.simulated
        if now == 0 or (now < self.due and not simulated):
            return  # 0: simulated time has not begun
        last, wait = self.time, self._slack - (self._lead if without else 0)
        if simulated:
            missed = (now - last) // period
            if missed == 1 and now < last + period + self._slack and \
                    not self._bank.confirmed(last + period, without):
                return
        else:  # at a fixed phase, whatever has arrived
            missed = (now - wait - last) // period
        if missed > CATCH_UP:
            if last:
                self.pace.overruns += missed - 1
            last = now - now % period - period if self._bank.time is None \
                else last + (missed - 1) * period
            missed = 1
        for i in range(1, missed + 1):  # mostly once
            self.pace.begin()
            self._sending = None if simulated else last + i * period + self._slack
            yield last + i * period
            self._sending = None
            self.pace.end()
        self.due = self.time + period + wait

    def hold(self) -> None:
        """Wait, within a tick, until it is time to send: all else is done then."""
        if self._sending is not None:
            left, self._sending = self._sending - time.time_ns(), None
            if 0 < left <= self._lead:
                self.pace.wait(left)

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
        self._last, self._behind, self.due = self._clock.now, 0, 0
