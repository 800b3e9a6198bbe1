"""
The isolation topic: what is heard now, and what was said before this node was there.

A transient-local publisher repeats its last messages to who comes later, but only to transient-
local subscriptions, which in turn do not hear volatile publishers; so there are two subscriptions.
What both hear is live. What only the transient-local one hears is history: it counts for the
sensors of which nothing newer was heard, by the times at which the messages were sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
import time
from typing import Any, Protocol

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import String

from vsensor_ros.engine import isolation, IsolationReport
from vsensor_ros.engine.isolation_names import Names
from vsensor_ros.node.cdr import decode
from vsensor_ros.node.diagnostics import LOOP, MARKS
from vsensor_ros.node.polling import DEPTH, drain, LISTEN_RELIABLY, Polled, subscribe
from vsensor_ros.reason import Reason

LATE = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE,
                  durability=DurabilityPolicy.TRANSIENT_LOCAL)
MOST = 50  # messages looked at in one poll; the rest wait
LATELY = 60.0  # s for which a name that is no sensor's is told after it was heard
MOST_STRANGERS = 20  # of these, remembered
MOST_NAMES = 4096  # for sensors, by patterns, that are told apart
_OF_A_REPLACER = f': {LOOP}\0'.encode()  # in its /diagnostics alone
_TWICE = 4 * DEPTH  # live messages remembered until the other subscription has heard them, too


class Wording(Protocol):
    """How messages of one type say which sensors are faulty."""

    kind: Any  # the message class
    shared: bool  # others speak on the topic of other things, too

    def concerns(self, raw: bytes) -> bool:
        """Tell whether a serialized message may name a sensor; cheap."""

    def resembles(self, raw: bytes) -> bool:
        """Tell whether one that does not may have a name that sounds like a sensor's; cheap."""

    def understand(self, message: Any) -> isolation.Said:
        """Return what a message says."""


class Statuses:
    """DiagnosticArray: a status for each sensor that is spoken of."""

    kind = DiagnosticArray

    def __init__(self, names: Names, shared: bool) -> None:
        self._names, self.shared = names, shared

    def concerns(self, raw: bytes) -> bool:
        """Tell whether a serialized message may name a sensor; cheap."""
        return (not self.shared or isolation.may_name_one(raw, self._names)) and \
            isolation.names_one(raw, self._names)

    def resembles(self, raw: bytes) -> bool:
        """Tell whether one that does not may have a name that sounds like a sensor's; cheap."""
        return isolation.may_name_one(raw, self._names) and _OF_A_REPLACER not in raw

    def understand(self, message: Any) -> isolation.Said:
        """Return what a message says; what replacers say of themselves is no isolation."""
        return isolation.from_statuses(
            ((s.name, s.level, s.hardware_id) for s in message.status
             if not any(v.key in MARKS for v in s.values)), self._names, self.shared)


class Text:
    """String: the names of all faulty sensors."""

    kind, shared = String, False

    def __init__(self, names: Names) -> None:
        self._names = names

    def concerns(self, raw: bytes) -> bool:
        """Tell whether a serialized message may name a sensor; cheap."""
        return isolation.names_one_in_text(raw, self._names)

    def resembles(self, raw: bytes) -> bool:
        """Tell nothing: nobody else speaks there."""
        return False

    def understand(self, message: Any) -> isolation.Said:
        """Return what a message says, which is of all sensors."""
        return isolation.from_text(message.data, self._names)


@dataclass(frozen=True)
class Stranger:
    """A name on the topic that is no sensor's."""

    heard: float  # s, the last time, by a steady clock
    faulty: bool  # it was said to be


@dataclass(frozen=True)
class Trouble:
    """What was wrong with one message, in words that are made only if they are wanted."""

    topic: str
    problems: tuple[str, ...]
    strangers: Sequence[str]
    names: Names

    def __str__(self) -> str:
        told = [*self.problems, *map(self.names.tell, self.strangers[:isolation.FEW])]
        if (more := len(self.strangers) - isolation.FEW) > 0:
            told.append(f'and {more} more that are not sensors')
        return f'{self.topic}: {"; ".join(told)}'


class Reports:
    """A source of isolation: what its topic says, from both subscriptions."""

    def __init__(self, node: Node, group: Polled, topic: str, wording: Wording, names: Names,
                 say: Callable[[object, str], None]) -> None:
        """Open the topic. say: is told an error and its subject."""
        self.topic, self._wording, self._names, self._say = topic, wording, names, say
        self._live = subscribe(node, group, wording.kind, topic, LISTEN_RELIABLY)
        # the parameters of the topic's QoS are those of the other one
        self._late = subscribe(node, group, wording.kind, topic, LATE, overridden=False)
        self.subscriptions: tuple[Subscription, ...] = (self._live, self._late)
        # by sensor and the name that stood for it: since when it is faulty, by that name
        self._faulty: dict[isolation.Key, int] = {}
        self._heard: dict[tuple[int, bytes], None] = {}
        self._said: dict[isolation.Key, int] = {}  # likewise: when its last message was sent
        self._strangers: dict[str, Stranger] = {}  # the latest last
        self._allowances = {  # by whether a message names a sensor
            True: isolation.Allowance(),
            False: isolation.Allowance(isolation.STRANGERS, rate=isolation.STRANGERS)}
        self._behind = False  # more has arrived than was looked at
        self._told = 0  # messages that the transient-local subscription has heard
        self.heard = False  # anything at all
        self.not_used = 0  # messages that were not used, or not wholly
        self.thrown_away = 0  # of these, not even read

    def report(self) -> IsolationReport:
        """Return who is faulty now, by any name, of whom anything was said, and since when."""
        faulty: dict[str, int] = {}
        for (sensor, _), since in self._faulty.items():
            faulty[sensor] = min(since, faulty.get(sensor, since))
        return IsolationReport(faulty, frozenset(sensor for sensor, _ in self._said))

    def strangers(self) -> list[str]:
        """Return which names that are no sensor's were heard lately, and matter; a few."""
        now = time.monotonic()
        return [name for name, stranger in reversed(self._strangers.items())
                if now - stranger.heard < LATELY and self._matters(name, stranger.faulty)
                ][:isolation.FEW]

    def _matters(self, name: str, faulty: bool) -> bool:
        """Tell whether a stranger may be a sensor of which nothing is known."""
        alike = self._names.alike(name)
        return faulty or not any(sensor == alike for sensor, _ in self._said)

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
        wording, fits = self._wording, len(raw) <= isolation.LARGEST
        ours = fits and wording.concerns(raw)
        others = wording.shared and not ours and fits  # others' business
        if others and not wording.resembles(raw):
            return
        self._allowances[ours], refused = self._allowances[ours].admit(
            len(raw), time.monotonic_ns())
        message = None if refused else decode(wording.kind, raw)
        if others and message is None:
            return
        if refused:
            self.thrown_away += 1
            self._complain('thrown away', refused, f'{self.thrown_away} thrown away so far')
        elif message is None:
            self._complain('isolation', str(Reason('unreadable')))
        else:
            self._take(wording.understand(message), sent, now, late)

    def _take(self, said: isolation.Said, sent: int, now: int, late: bool) -> None:
        problems = said.problems
        for key, faulty in said.faulty.items():
            if late and self._said.get(key, 0) >= sent:
                continue
            if key not in self._said and len(self._said) >= MOST_NAMES and key[0] != key[1]:
                problems = (*problems, f'more than {MOST_NAMES} names; the others are ignored')
                break
            self._said[key] = max(sent, self._said.get(key, 0))
            if faulty:
                self._faulty.setdefault(key, now)
            else:
                self._faulty.pop(key, None)
        new = self._meet(said.strangers)
        if problems or (any(said.strangers.values()) and not self._wording.shared):
            self._complain('isolation', *problems, strangers=tuple(said.strangers))
        elif new:
            self._say(Trouble(self.topic, (), new, self._names), 'strangers')

    def _meet(self, strangers: Mapping[str, bool]) -> list[str]:
        """Remember names that are no sensor's; return those that are new, and matter."""
        new = []
        for name, faulty in islice(strangers.items(), MOST_STRANGERS):
            if self._strangers.pop(name, None) is None and self._matters(name, faulty):
                new.append(name)
            self._strangers[name] = Stranger(time.monotonic(), faulty)
            if len(self._strangers) > MOST_STRANGERS:
                del self._strangers[next(iter(self._strangers))]
        return new

    def _complain(self, subject: str, *problems: str, strangers: tuple[str, ...] = ()) -> None:
        self.not_used += 1
        self._say(Trouble(self.topic, problems, strangers, self._names), subject)
