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
from typing import Any, Protocol

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import String

from vsensor_ros.engine import isolation, IsolationReport
from vsensor_ros.node.cdr import decode
from vsensor_ros.node.polling import DEPTH, drain, LISTEN_RELIABLY, Polled, subscribe
from vsensor_ros.reason import Reason

LATE = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE,
                  durability=DurabilityPolicy.TRANSIENT_LOCAL)
MOST = 50  # messages looked at in one poll; the rest wait
_TWICE = 4 * DEPTH  # live messages remembered until the other subscription has heard them, too


class Wording(Protocol):
    """How messages of one type say which sensors are faulty."""

    kind: Any  # the message class
    shared: bool  # others speak on the topic of other things, too

    def concerns(self, raw: bytes) -> bool:
        """Tell whether a serialized message may name a sensor; cheap."""

    def understand(self, message: Any, faulty: frozenset[str],
                   ) -> tuple[isolation.Isolation, frozenset[str]]:
        """Return the faulty sensors after a message, and of which sensors it speaks."""


class Statuses:
    """DiagnosticArray: a status for each sensor that is spoken of."""

    kind = DiagnosticArray

    def __init__(self, sensors: Collection[str], shared: bool) -> None:
        self.shared, self._sensors = shared, frozenset(sensors)
        self._ordered = tuple(sensors)

    def concerns(self, raw: bytes) -> bool:
        """Tell whether a serialized message may name a sensor; cheap."""
        return isolation.names_one(raw, self._ordered)

    def understand(self, message: Any, faulty: frozenset[str],
                   ) -> tuple[isolation.Isolation, frozenset[str]]:
        """Return the faulty sensors after a message, and of which sensors it speaks."""
        return (isolation.from_statuses(((s.name, s.level) for s in message.status),
                                        self._ordered, faulty, self.shared),
                self._sensors.intersection(s.name for s in message.status))


class Text:
    """String: the names of all faulty sensors."""

    kind, shared = String, False

    def __init__(self, sensors: Collection[str]) -> None:
        self._sensors = tuple(sensors)

    def concerns(self, raw: bytes) -> bool:
        """Tell whether a serialized message may name a sensor; cheap."""
        return isolation.names_one_in_text(raw, self._sensors)

    def understand(self, message: Any, faulty: frozenset[str],
                   ) -> tuple[isolation.Isolation, frozenset[str]]:
        """Return the faulty sensors after a message, which speaks of all."""
        return (isolation.from_text(message.data, self._sensors, faulty),
                frozenset(self._sensors))


class Reports:
    """A source of isolation: what its topic says, from both subscriptions."""

    def __init__(self, node: Node, group: Polled, topic: str, wording: Wording,
                 say: Callable[[str, str], None]) -> None:
        """Open the topic. say: is told an error and its subject."""
        self.topic, self._wording, self._say = topic, wording, say
        self._live = subscribe(node, group, wording.kind, topic, LISTEN_RELIABLY)
        # the parameters of the topic's QoS are those of the other one
        self._late = subscribe(node, group, wording.kind, topic, LATE, overridden=False)
        self.subscriptions: tuple[Subscription, ...] = (self._live, self._late)
        self._faulty: dict[str, int] = {}  # with the time since which they are
        self._heard: dict[tuple[int, bytes], None] = {}
        self._said: dict[str, int] = {}  # by sensor: when its last message was sent
        self._allowances = {  # by whether a message names a sensor
            True: isolation.Allowance(),
            False: isolation.Allowance(isolation.STRANGERS, rate=isolation.STRANGERS)}
        self._behind = False  # more has arrived than was looked at
        self._told = 0  # messages that the transient-local subscription has heard
        self.heard = False  # anything at all
        self.not_used = 0  # messages that were not used, or not wholly
        self.thrown_away = 0  # of these, not even read

    def report(self) -> IsolationReport:
        """Return who is faulty now, of whom anything was said, and since when."""
        return IsolationReport(dict(self._faulty), frozenset(self._said))

    @property
    def known(self) -> bool:
        """
        Whether all that was said before is known, of those who are there and keep what they said.

        A message does not say who sent it: as many as there are publishers will do.
        """
        return not self._behind and self._told >= self._late.get_publisher_count()

    def take(self, now: int) -> None:
        """Take all that has arrived by this time [ns]."""
        live, late = drain(self._live, MOST), drain(self._late, MOST)
        self._behind = MOST in (len(live), len(late))
        self._told += len(late)
        self.heard = self.heard or bool(live or late)
        for raw, info in live:
            sent = info['source_timestamp']
            if len(self._heard) >= _TWICE:
                del self._heard[next(iter(self._heard))]
            self._heard[sent, raw] = None
            self.apply(sent, raw, now)
        for sent, raw in sorted((info['source_timestamp'], raw) for raw, info in late):
            if (sent, raw) in self._heard:
                del self._heard[sent, raw]
            else:
                self.apply(sent, raw, now, late=True)

    def apply(self, sent: int, raw: bytes, now: int, late: bool = False) -> None:
        """
        Apply a message that was sent then.

        late: only who comes late was told, so that it counts for those sensors alone of which
        nothing newer was said.
        """
        wording, faulty = self._wording, frozenset(self._faulty)
        ours = len(raw) <= isolation.LARGEST and wording.concerns(raw)
        if wording.shared and not ours and len(raw) <= isolation.LARGEST:
            return  # others' business
        self._allowances[ours], refused = self._allowances[ours].admit(
            len(raw), time.monotonic_ns())
        message = None if refused else decode(wording.kind, raw)
        if message is None:
            problems: tuple[str, ...] = (refused or str(Reason('unreadable')),)
        else:
            said, spoken = wording.understand(message, faulty)
            problems = said.problems
            counts = {s for s in spoken if not late or self._said.get(s, 0) < sent}
            for name in counts:
                self._said[name] = max(sent, self._said.get(name, 0))
            after = faulty - counts | said.faulty & counts
            self._faulty = {s: self._faulty.get(s, now) for s in sorted(after)}
        if problems:
            self.not_used += 1
            self.thrown_away += refused is not None
            self._say(f'{self.topic}: {"; ".join(problems)}' + (
                f' ({self.thrown_away} thrown away so far)' if refused else ''),
                'thrown away' if refused else 'isolation')
