"""When the bank is stepped, and how far. Times are in ns, on the engine's clock."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from vsensor_ros.bank import Bank
from vsensor_ros.engine.clock import Clock

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
    catches up before it is asked. While only late drivers are spoken for, it stays behind by as
    much as they do: then it reads what they have said by that time, too.
    """

    def __init__(self, bank: Bank, clock: Clock) -> None:
        self._bank, self._clock, self._period = bank, clock, bank.period
        self._slack = min(round(SLACK * bank.period), LONGEST_SLACK)
        self._last = 0  # tick, while the bank has no grid yet
        self._behind = 0  # by which the state is older than the last tick
        self.lead = round(LEAD * self._slack)  # that a message is ready before it is due, at most
        self.due = 0  # by the system's clock: when to look whether there is a tick
        self.count = 0
        self.left_out = 0

    @property
    def time(self) -> int:
        """Time of the last tick."""
        time = self._bank.time
        return self._last if time is None else time + self._behind

    def now(self, without: Collection[str]) -> Iterator[int]:
        """
        Yield the times of the ticks that are due; their readings, but of those named, come.

        Those are the failed ones. If there are such, ticks begin sooner: see `send_at`.
        """
        now, period, simulated = self._clock.now, self._period, self._clock.simulated
        if now == 0 or (now < self.due and not simulated):
            return  # 0: simulated time has not begun
        last, wait = self.time, self._slack - (self.lead if without else 0)
        if simulated:
            missed = (now - last) // period
            if missed == 1 and now < last + period + self._slack and \
                    not self._bank.confirmed(last + period, without):
                return
        else:  # at a fixed phase, whatever has arrived
            missed = (now - wait - last) // period
        if missed > CATCH_UP:
            if last:
                self.left_out += missed - 1
            last = now - now % period - period if self._bank.time is None \
                else last + (missed - 1) * period
            missed = 1
        for i in range(1, missed + 1):  # mostly once
            self.count += 1
            yield last + i * period
        self.due = self.time + period + wait

    def send_at(self, tick: int) -> int:
        """Return when what a tick has to say is due, so that estimates come at even distances."""
        return 0 if self._clock.simulated else tick + self._slack

    def advance(self, at: int, lag: int | None) -> None:
        """Bring the bank to a tick, less the lag of those who ask for it; None: nobody does."""
        self._last = at
        if lag is not None:
            self._bring(at, lag)
            return
        self._behind += self._period
        if self._behind > TOGETHER * self._period or self._bank.time is None:
            self._behind = self._period
            self._bank.advance(at - self._period)

    def catch_up(self, lag: int) -> None:
        """Bring the bank to the last tick, less the lag of those who ask for it."""
        if self._behind or lag:
            self._bring(self.time, lag)

    def _wait(self, lag: int) -> int:
        """Return for how long the bank waits: what is said with this lag lies before its state."""
        steps = min(lag, self._clock.max_jump // 2) // self._period - 1
        return max(0, steps) * self._period

    def _bring(self, at: int, lag: int) -> None:
        self._behind = self._wait(lag)
        to, time = at - self._behind, self._bank.time
        if time is None or time <= to:
            self._bank.advance(to)
        else:
            self._behind = at - self._bank.step_back(to)

    def restart(self) -> None:
        """Begin anew after the clock jumped."""
        self._last, self._behind, self.due = self._clock.now, 0, 0
