"""Whose stamps are so far from the clock that no virtual sensor can use the readings."""

from __future__ import annotations

from vsensor_ros.bank.inputs import MOST_AHEAD

STEADY = 1_500_000_000  # ns for which they are looked at before it is said: not a burst, not one


class Apart:
    """Since when the stamps of each channel are of another clock. Times are in ns."""

    def __init__(self) -> None:
        self._since: dict[str, int] = {}

    def steadily(self, channel: str, ahead: int, max_age: int, now: int) -> bool:
        """Note by how much the last stamp lay ahead; tell whether all have been off for long."""
        if now == 0 or -max_age <= ahead <= min(max_age, MOST_AHEAD):
            self._since.pop(channel, None)
            return False
        return now - self._since.setdefault(channel, now) >= STEADY

    def forget(self, channel: str) -> None:
        """Begin anew with one that is not heard."""
        self._since.pop(channel, None)
