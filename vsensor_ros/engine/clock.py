"""
The engine's clock: what it is told of the time, and when that jumped. All times are in ns.

Stamps, grid times and ages are on this clock, which is that of the drivers' stamps. How long
something has lasted (a dwell, an offset that decays) is measured on the same clock with its jumps
taken out.
"""

from __future__ import annotations

from collections import Counter

TRIMMED = 1_000_000_000  # a system clock set back by less stands still for us until it is there
NOTICED = 10_000_000  # a system clock set back by less is not worth counting


class Clock:
    """What time it is."""

    def __init__(self, max_jump: int, simulated: bool) -> None:
        """
        Begin unset. A clock that moves ahead by more than max_jump between two looks has jumped.

        simulated: it is a simulation's, which may go back by any amount.
        """
        self.now = 0  # 0 until it has begun
        self.jumps: Counter[str] = Counter()  # 'backwards', 'forwards', 'stood still'
        self.simulated = simulated
        self.max_jump = max_jump
        self._begin = 0  # `now` less what has passed without the jumps
        self._still = False

    def look(self, now: int | None) -> int:
        """Take what the clock shows, None for nothing new; return by how much it has jumped."""
        before = self.now
        if now is None or now == before:
            return 0
        if before == 0:
            self.now = self._begin = now
            return 0
        ahead = now - before
        if 0 < ahead <= self.max_jump:
            self.now, self._still = now, False
            return 0
        if -TRIMMED < ahead < 0 and not self.simulated:
            if ahead < -NOTICED and not self._still:
                self._still = True
                self.jumps['stood still'] += 1
            return 0
        self.now, self._still = now, False
        self._begin += ahead
        self.jumps['forwards' if ahead > 0 else 'backwards'] += 1
        return ahead

    def resume(self, now: int | None) -> None:
        """Take what the clock shows after a rest: what has passed meanwhile is no jump ahead."""
        if now is not None and now > self.now > 0:
            self.now, self._still = now, False

    def lasting(self, at: int | None = None) -> int:
        """Return what had passed at a time on this clock, its jumps taken out; by default now."""
        return (self.now if at is None else at) - self._begin
