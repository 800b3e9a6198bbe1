"""
The node's clock: the system's, or with use_sim_time that of ``/clock``. All times are in ns.

Each clock is chosen on purpose. Stamps, grid times and ages are on the node's clock, which is that
of the drivers' stamps. How long something has lasted (a dwell, an offset that decays) is measured
on the same clock with its jumps taken out. What the loop costs is measured on a steady clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import time

TRIMMED = 1_000_000_000  # a system clock set back by less stands still for us until it is there
NOTICED = 10_000_000  # a system clock set back by less is not worth counting


class NodeClock:
    """What time it is on the node, and when that jumped."""

    def __init__(self, max_jump: int, simulated: Callable[[], int | None] | None = None) -> None:
        """
        Begin unset. A clock that moves ahead by more than max_jump between two looks has jumped.

        simulated: returns what ``/clock`` said last, or None when nothing new; None for the
        system's clock.
        """
        self.now = 0  # 0 until simulated time has begun
        self.jumps: Counter[str] = Counter()  # 'backwards', 'forwards', 'stood still'
        self.simulated = simulated is not None
        self._read = simulated or time.time_ns
        self._max_jump = max_jump
        self._begin = 0  # `now` less what has passed without the jumps
        self._still = False

    def look(self) -> int:
        """Read the clock; return by how much it has jumped, 0 when it has not."""
        now = self._read()
        before = self.now
        if now is None or now == before:
            return 0
        if before == 0:
            self.now = self._begin = now
            return 0
        ahead = now - before
        if 0 < ahead <= self._max_jump:
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

    def resume(self) -> None:
        """Read the clock after a rest: what has passed meanwhile is no jump ahead."""
        now = self._read()
        if now is not None and now > self.now > 0:
            self.now, self._still = now, False

    def lasting(self, at: int | None = None) -> int:
        """Return what had passed at a time on this clock, its jumps taken out; by default now."""
        return (self.now if at is None else at) - self._begin
