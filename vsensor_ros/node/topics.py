"""
Message streams: what arrives on topics, and what goes out in place of failed channels.

Subscriptions are polled (an executor costs several times as much a message): they sit in a
callback group that never executes and are drained with take_message.

While a channel of a stream is failed, messages are composed: the latest live message is the
template, the failed channels are written into it, and every other channel is what it last said.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from vsensor_ros.node.accessor import get_stamp, has_stamp, put_stamp
from vsensor_ros.node.parameters import Sensor

DEPTH = 200  # messages kept between two polls, and taken at most in one
CLOCKS_APART = 1_000_000_000  # ns; stamps further than this from ours are another clock's
PATIENCE = 5_000_000_000  # ns of nothing but stamps that run backwards, then they are believed
NOT_NEWER = 'not sent on: not newer than what went out'
# a best-effort subscription also hears reliable publishers, a volatile one transient-local ones
LISTEN = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
LISTEN_RELIABLY = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
SPEAK = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)


class Polled(CallbackGroup):
    """A group whose subscriptions no executor waits for."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


def subscribe(node: Node, group: Polled, kind: Any, topic: str, qos: QoSProfile) -> Subscription:
    """Subscribe to serialized messages, to be taken with `drain`."""
    return node.create_subscription(
        kind, topic, _never, qos, callback_group=group, raw=True,
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))


def _never(message: Any) -> None:
    raise AssertionError('a polled subscription was executed')


def drain(subscription: Subscription) -> list[tuple[bytes, int]]:
    """
    Return what has arrived: serialized messages, each with its time of receipt.

    The time is the system clock's, in ns. Mostly nothing has arrived, so that must cost little.
    """
    take, kind = subscription.handle.take_message, subscription.msg_type
    arrived: list[tuple[bytes, int]] = []
    while len(arrived) < DEPTH and (taken := take(kind, True)) is not None:
        arrived.append((taken[0], taken[1]['received_timestamp']))
    return arrived


def decode(kind: Any, raw: bytes) -> Any:
    """Return the message in these bytes, or None when there is none."""
    try:
        return deserialize_message(raw, kind)
    except (RuntimeError, ValueError, MemoryError):  # what rmw raises on bytes of another make
        return None


class Arrived(NamedTuple):
    """One message, decoded."""

    raw: bytes
    message: Any
    stamp: int | None  # ns, the header's; None when the type has none or it is not filled in
    received: int  # ns, by the system's clock
    readings: dict[str, float | str]  # by channel: the value, or why there is none
    foreign: bool  # of other joints: names none of the channels, which is sound


@dataclass(eq=False)
class Stream:
    """The messages of one input topic, on their way to one output topic. Times are in ns."""

    sensors: tuple[Sensor, ...]
    subscription: Subscription
    publisher: Publisher
    stamped: bool
    max_age: int  # of what a channel said, to go out
    warn: Callable[[str], None]
    passing: frozenset[str] = frozenset()  # failed, let through all the same
    problem: str | None = None  # why nothing goes out, though it should
    last_sent: int | None = None  # the largest stamp that went out
    blocked: int | None = None  # node clock, since when all stamps were too old to go out
    _template: Arrived | None = None
    _composed: Any = None  # the message of the template, with what was put into it
    _taken: int = 0  # node clock, of the template
    _strict: bool = False  # something was composed: from now on stamps increase strictly
    _offset: int = 0  # of the driver's clock to the node's
    _latest: dict[str, float] = field(default_factory=dict)  # by channel: what it said
    _heard: dict[str, int] = field(default_factory=dict)  # and when
    _lacks: dict[str, tuple[str, int]] = field(default_factory=dict)  # why it did not, and when

    def read(self, raw: bytes, received: int) -> Arrived | None:
        """Decode a message of this stream; None when it is not one."""
        message = decode(self.sensors[0].kind, raw)
        if message is None:
            return None
        stamp = get_stamp(message) if self.stamped else 0
        return Arrived(raw, message, stamp or None, received,
                       {s.name: s.accessor.get(message) for s in self.sensors},
                       all(s.accessor.absent(message) for s in self.sensors))

    def lacks(self, reason: str, now: int) -> None:
        """Note that something arrived that says nothing of any channel."""
        self._lacks.update({sensor.name: (reason, now) for sensor in self.sensors})

    def fresh(self, name: str, now: int) -> bool:
        """Tell whether a channel has spoken within max_age."""
        heard = self._heard.get(name)
        return heard is not None and now - heard <= self.max_age

    def why_silent(self, name: str, now: int) -> str | None:
        """Return in words why a healthy channel is not to be had live, or None when it is."""
        topic = self.sensors[0].input
        if self.fresh(name, now):
            stuck = self.blocked is not None and now - self.blocked > self.max_age
            return f'messages arrive on {topic}, but are {NOT_NEWER}' if stuck else None
        reason, at = self._lacks.get(name, ('', 0))
        if reason and now - at <= self.max_age:
            return f'messages arrive on {topic}, but {reason}'
        return f'nothing comes on {topic}'

    def forget(self) -> None:
        """Begin anew after the clock went back."""
        self.last_sent = self.blocked = None
        self._strict, self._offset, self._taken = False, 0, 0
        self._heard.clear()
        self._lacks.clear()

    def accept(self, arrived: Arrived, now: int, faulty: Collection[str]) -> str | None:
        """
        Send a live message on unchanged, or keep what it says for the messages composed of it.

        Returns why a message that should have gone out did not, or None.
        """
        failed = any(s.name in faulty and s.name not in self.passing for s in self.sensors)
        if arrived.foreign and not (failed and self._same_driver(arrived.message)):
            self.lacks(next(str(why) for why in arrived.readings.values()), now)
            self.publisher.publish(arrived.raw)  # its stamps are its own
            return None
        for name, said in arrived.readings.items():
            if isinstance(said, str):
                self._lacks[name] = (said, now)
            else:
                self._latest[name], self._heard[name] = said, now
        # of two drivers on one topic the one with more of the channels
        if self._template is None or now - self._taken > self.max_age or \
                _carried(arrived, faulty) >= _carried(self._template, faulty):
            self._template, self._composed, self._taken = arrived, arrived.message, now
        if failed:
            return None  # it goes out in the next message that is composed
        stamp = arrived.stamp
        if stamp is not None:
            if self._strict and not self._in_order(stamp, now):
                return NOT_NEWER
            self._offset = stamp - now
            if self.last_sent is None or self.last_sent < stamp or \
                    self.last_sent - stamp > CLOCKS_APART:
                self.last_sent = stamp
        self.publisher.publish(arrived.raw)
        return None

    def _same_driver(self, message: Any) -> bool:
        """Tell whether a message shares joints with the template: not all of it is foreign."""
        return self._composed is not None and any(
            set(s.accessor.names(message)) & set(s.accessor.names(self._composed))
            for s in self.sensors)

    def compose(self, time: int, values: Mapping[str, float], now: int) -> None:
        """
        Send the template with these channels replaced, stamped with the state's time.

        All other channels are as they were last heard, NaN when that is too long ago. `problem`
        says afterwards why nothing was sent; it is None, too, when something as new is out.
        """
        self.problem = self._compose(time, values, now)

    def _compose(self, time: int, values: Mapping[str, float], now: int) -> str | None:
        message = self._composed
        if message is None:
            if self.stamped:
                return 'no message of its driver was ever seen, so frame and names are not known'
            message = self.sensors[0].kind()
        apart = self.stamped and abs(self._offset) > CLOCKS_APART
        stamp = time + self._offset if apart else time
        if not self._in_order(stamp, now):
            assert self.blocked is not None
            return NOT_NEWER if now - self.blocked > self.max_age else None
        for sensor in self.sensors:
            put, get = sensor.accessor.put, sensor.accessor.get
            if sensor.name in values:
                problem = put(message, values[sensor.name])
            elif self.fresh(sensor.name, now):
                problem = put(message, self._latest[sensor.name])
            elif isinstance(get(message), float):
                problem = put(message, float('nan'))
            else:
                continue  # neither known nor there
            if problem is not None:
                return problem
        if self.stamped:
            put_stamp(message, stamp)
        if apart and not self._strict:
            self.warn(f'the stamps on {self.sensors[0].input} are {self._offset * 1e-9:+.1f} s '
                      'from the clock of this node; the estimates in their place follow them')
        self.publisher.publish(message)
        self._composed, self.last_sent, self._strict = message, stamp, True
        return None

    def _in_order(self, stamp: int, now: int) -> bool:
        """Tell whether a message with this stamp may go out; after a while, it may."""
        if self.last_sent is None or stamp > self.last_sent:
            self.blocked = None
            return True
        if self.blocked is None:
            self.blocked = now
        if now - self.blocked < PATIENCE:
            return False
        self.warn(f'the stamps on {self.sensors[0].input} stay '
                  f'{(self.last_sent - stamp) * 1e-9:.1f} s behind what went out on '
                  f'{self.sensors[0].output}: they step back there now; mend the clock of the '
                  'driver')
        self.blocked = self.last_sent = None
        return True


def _carried(arrived: Arrived, faulty: Collection[str]) -> int:
    """Return how many healthy channels a message carries."""
    return sum(isinstance(said, float) and name not in faulty
               for name, said in arrived.readings.items())


def open_streams(node: Node, group: Polled, sensors: Sequence[Sensor], max_age: int,
                 warn: Callable[[str], None]) -> tuple[Stream, ...]:
    """Create the subscription and the publisher of each topic, once and for all."""
    streams = []
    for topic in dict.fromkeys(sensor.input for sensor in sensors):
        sharing = tuple(sensor for sensor in sensors if sensor.input == topic)
        kind, output = sharing[0].kind, sharing[0].output
        publisher = node.create_publisher(
            kind, output, SPEAK,
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False))
        streams.append(Stream(
            sharing, subscribe(node, group, kind, topic, LISTEN), publisher, has_stamp(kind),
            max_age, warn))
    return tuple(streams)
