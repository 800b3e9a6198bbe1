"""What the replacer says on ``/diagnostics``: one status a channel, with a remedy in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

LEVELS = {
    'real': DiagnosticStatus.OK,
    'silent': DiagnosticStatus.STALE,
    'virtual': DiagnosticStatus.WARN,
    'none': DiagnosticStatus.ERROR,
}


@dataclass(frozen=True)
class Channel:
    """The state of one channel."""

    name: str
    topic: str  # on which it goes out
    source: str  # 'real', 'silent' (healthy, but not heard), 'virtual' or 'none'
    message: str  # what is, and what to do about it
    facts: Mapping[str, object]  # for people who look closer


def report(node: str, channels: Iterable[Channel], stamp: int) -> DiagnosticArray:
    """Build the message, stamped in ns. The node's name keeps our names off the isolation's."""
    array = DiagnosticArray()
    array.header.stamp = Time(sec=stamp // 10**9, nanosec=stamp % 10**9)
    for channel in channels:
        facts = {'source': channel.source, **channel.facts}
        array.status.append(DiagnosticStatus(
            level=LEVELS[channel.source], name=f'{node}: {channel.name}',
            message=channel.message, hardware_id=channel.topic,
            values=[KeyValue(key=key, value=str(value)) for key, value in facts.items()]))
    return array
