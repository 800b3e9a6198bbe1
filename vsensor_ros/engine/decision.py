"""Who serves a channel, or why nobody could."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from vsensor_ros.engine.choice import FaultSet
from vsensor_ros.reason import Reason


class Source(Enum):
    """Where a channel's values come from."""

    REAL = 'real'
    VIRTUAL = 'virtual'
    NONE = 'none'


@dataclass(frozen=True)
class Decision:
    """Who serves one channel, and why not another."""

    source: Source
    fault_set: FaultSet = ()  # of the virtual sensor that serves
    reason: Reason | None = None


class CannotServe(ValueError):
    """A sensor cannot be forced: `channel` would be without a value then, for a `reason`."""

    def __init__(self, name: str, channel: str, failed: FaultSet, reason: Reason | None) -> None:
        """Say it in one line; reason: None: nothing is designed for `channel` without these."""
        self.channel, self.reason = channel, reason
        without = ', '.join(failed)
        who = 'no virtual sensor is designed that' if reason is None else 'nobody'
        super().__init__(f'{name}: cannot be forced; {who} could speak for {channel} without '
                         f'{without}' + ('' if reason is None else f': {reason}'))
