"""What was withheld of late, so that nobody calls a channel well of which a part is missing."""

from __future__ import annotations

from collections import deque

from vsensor_ros.reason import Reason

LATELY = 5_000_000_000  # ns
MOST = 1000  # of a channel that are counted


class Withheld:
    """When messages of each channel did not go on. Times are in ns."""

    def __init__(self) -> None:
        self._times: dict[str, deque[int]] = {}

    def note(self, channel: str, now: int) -> None:
        """Note that a message of a channel does not go on."""
        self._times.setdefault(channel, deque(maxlen=MOST)).append(now)

    def why(self, channel: str, cause: Reason, now: int) -> Reason | None:
        """Return what is to be said of a channel; None: nothing was withheld LATELY."""
        times = self._times.get(channel)
        if times is None:
            return None
        count = sum(now - time <= LATELY for time in times)
        return Reason.of('withheld', count=count, seconds=LATELY * 1e-9, why=cause) \
            if count else None
