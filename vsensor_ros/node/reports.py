"""
The isolation topic: what is heard now, and what was said before this node was there.

A transient-local publisher repeats its last messages to who comes later, but only to transient-
local subscriptions, which in turn do not hear volatile publishers; so there are two subscriptions.
What both hear is live. What only the transient-local one hears is history: it counts for the
sensors of which nothing newer was heard, by the times at which the messages were sent.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import String

from vsensor_ros.engine import isolation
from vsensor_ros.node.cdr import decode
from vsensor_ros.node.polling import DEPTH, drain, LISTEN_RELIABLY, Polled, subscribe

LATE = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE,
                  durability=DurabilityPolicy.TRANSIENT_LOCAL)
MOST = 50  # messages looked at in one poll; the rest wait
UNREADABLE = 'bytes that are not a message of the type'
_TWICE = 4 * DEPTH  # live messages remembered until the other subscription has heard them, too


class Reports:
    """What isolation says, from both subscriptions."""

    def __init__(self, node: Node, group: Polled, topic: str, kind: Any,
                 sensors: Collection[str], shared: bool, say: Callable[[str, str], None]) -> None:
        """Open the topic; shared: others speak there of other things, too. say: error, subject."""
        self.kind, self.topic = kind, topic
        self._sensors, self._shared, self._say = sensors, shared, say
        self._live = subscribe(node, group, kind, topic, LISTEN_RELIABLY)
        # the parameters of the topic's QoS are those of the other one
        self._late = subscribe(node, group, kind, topic, LATE, overridden=False)
        self.subscriptions: tuple[Subscription, ...] = (self._live, self._late)
        self._heard: dict[tuple[int, bytes], None] = {}
        self._said: dict[str, int] = {}  # by sensor: when its last message was sent
        self._allowances = {  # by whether a message names a sensor
            True: isolation.Allowance(),
            False: isolation.Allowance(isolation.STRANGERS, rate=isolation.STRANGERS)}
        self._names_one = isolation.names_one if kind is DiagnosticArray else \
            isolation.names_one_in_text
        self._behind = False  # more has arrived than was looked at
        self._told = 0  # messages that the transient-local subscription has heard
        self.heard = False  # anything at all
        self.not_used = 0  # messages that were not used, or not wholly
        self.thrown_away = 0  # of these, not even read

    @property
    def known(self) -> bool:
        """
        Whether all that was said before is known, of those who are there and keep what they said.

        A message does not say who sent it: as many as there are publishers will do.
        """
        return not self._behind and self._told >= self._late.get_publisher_count()

    def take(self, faulty: frozenset[str]) -> frozenset[str]:
        """Return the faulty sensors after all that has arrived."""
        live, late = drain(self._live, MOST), drain(self._late, MOST)
        self._behind = MOST in (len(live), len(late))
        self._told += len(late)
        self.heard = self.heard or bool(live or late)
        for raw, info in live:
            sent = info['source_timestamp']
            if len(self._heard) >= _TWICE:
                del self._heard[next(iter(self._heard))]
            self._heard[sent, raw] = None
            faulty = self._apply(raw, sent, faulty, self._sensors)
        for sent, raw in sorted((info['source_timestamp'], raw) for raw, info in late):
            if (sent, raw) in self._heard:
                del self._heard[sent, raw]
            else:
                faulty = self.late(sent, raw, faulty)
        return faulty

    def late(self, sent: int, raw: bytes, faulty: frozenset[str]) -> frozenset[str]:
        """Apply a message, sent then, that only who comes late was told."""
        news = {s for s in self._sensors if self._said.get(s, 0) < sent}
        return faulty - news | self._apply(raw, sent, faulty, news) & news

    def _apply(self, raw: bytes, sent: int, faulty: frozenset[str],
               about: Collection[str]) -> frozenset[str]:
        """Return the faulty sensors after a message; note for those it speaks of when it was."""
        ours = len(raw) <= isolation.LARGEST and self._names_one(raw, self._sensors)
        if self._shared and not ours and len(raw) <= isolation.LARGEST:
            return faulty  # others' business
        self._allowances[ours], refused = self._allowances[ours].admit(
            len(raw), time.monotonic_ns())
        message = None if refused else decode(self.kind, raw)
        if message is None:
            said = isolation.Isolation(faulty, (refused or UNREADABLE,))
            spoken: Collection[str] = ()
        elif isinstance(message, DiagnosticArray):
            said = isolation.from_statuses(((s.name, s.level) for s in message.status),
                                           self._sensors, faulty, self._shared)
            spoken = {s.name for s in message.status}.intersection(about)
        else:
            said = isolation.from_text(message.data, self._sensors, faulty)
            spoken = about
        for name in spoken:
            self._said[name] = max(sent, self._said.get(name, 0))
        if said.problems:
            self.not_used += 1
            self.thrown_away += refused is not None
            self._say(f'{self.topic}: {"; ".join(said.problems)}' + (
                f' ({self.thrown_away} thrown away so far)' if refused else ''),
                'thrown away' if refused else 'isolation')
        return said.faulty


def kind_of(type_name: str, diagnostics: str) -> Any:
    """Return the message class of an isolation topic."""
    return DiagnosticArray if type_name == diagnostics else String
