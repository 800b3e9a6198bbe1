"""When a faulty sensor may be believed again: it has come back, at once, and stays."""

from __future__ import annotations

from collections import deque

BACK = 0.5  # of the worst deviation: below it a sensor has come back
AT_ONCE = 1.0  # s in which it has to come back; a model that errs does so slowly


class Recovery:
    """Of one fault; time is in s."""

    def __init__(self, dwell: float) -> None:
        self.dwell = dwell
        self.worst = 0.0
        self._since: float | None = None
        self._lately: deque[tuple[float, float]] = deque()

    def step(self, time: float, deviation: float | None, sound: bool, leaps: bool) -> bool:
        """
        Tell whether the sensor has been back for the dwell.

        deviation: of its residual from the healthy mean, None when nothing shows it. sound: its
        readings alone look healthy: they move, and are no rougher than they were. leaps: it
        deviated by a jump or a drift, so it has to come back by a jump.
        """
        if deviation is None:
            if leaps:  # nothing would show that it has come back
                return False
            deviation = 0.0
        self.worst = max(self.worst, abs(deviation))
        lately = self._lately
        while lately and time - lately[0][0] > AT_ONCE:
            lately.popleft()
        back = sound and abs(deviation) <= BACK * self.worst
        if not back:
            self._since = None
        elif self._since is None:
            fell = max((abs(before - deviation) for _, before in lately), default=0.0)
            if not leaps or fell >= BACK * self.worst:
                self._since = time
        lately.append((time, deviation))
        return self._since is not None and time - self._since >= self.dwell
