"""
Message streams: what arrives on topics, and what goes out in place of failed channels.

Subscriptions are polled (an executor costs several times as much a message): they sit in a
callback group that never executes and are drained with take_message.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(eq=False)
class Stream:
    """The messages of one input topic, on their way to one output topic."""

    sensors: tuple[Sensor, ...]
    subscription: Subscription
    publisher: Publisher
    stamped: bool
    template: Any = None  # the latest live message that has all channels of the stream
    heard: int | None = None  # ns, node clock, of the latest message
    last_sent: int | None = None  # ns, the largest stamp that went out
    replacing: bool = False  # the latest message out was not a live one
    passing: frozenset[str] = frozenset()  # failed, let through all the same

    def read(self, raw: bytes, received: int) -> Arrived | None:
        """Decode a message of this stream; None when it is not one."""
        message = decode(self.sensors[0].kind, raw)
        if message is None:
            return None
        stamp = get_stamp(message) if self.stamped else 0
        return Arrived(raw, message, stamp or None, received,
                       {s.name: s.accessor.get(message) for s in self.sensors})

    def accept(self, arrived: Arrived, now: int, faulty: frozenset[str]) -> str | None:
        """
        Send a live message on unchanged, or keep it as the template for what replaces it.

        Returns why neither was done, or None.
        """
        missing = {name: why for name, why in arrived.readings.items() if isinstance(why, str)}
        if len(missing) < len(self.sensors):
            self.heard = now
        if not missing:
            self.template = arrived.message
        failed = [s for s in self.sensors if s.name in faulty and s.name not in self.passing]
        if not failed:
            return self._forward(arrived, now)
        if all(s.name in missing and s.accessor.named for s in failed):
            self.publisher.publish(arrived.raw)  # of other joints; their stamps are their own
            return None
        return f'not sent on: {next(iter(missing.values()))}' if missing else None

    def _forward(self, arrived: Arrived, now: int) -> str | None:
        stamp = arrived.stamp
        if stamp is not None and self.last_sent is not None and self.replacing \
                and 0 <= self.last_sent - stamp < CLOCKS_APART:
            return 'not sent on: older than the last estimate'
        self.publisher.publish(arrived.raw)
        self.replacing = False
        if stamp is not None and stamp <= now + CLOCKS_APART:
            self.last_sent = stamp if self.last_sent is None else max(self.last_sent, stamp)
        return None

    def replace(self, time: int, values: dict[str, float], silent: bool) -> str | None:
        """
        Send the template with the given channels replaced, stamped with the state's time [ns].

        silent: the driver has fallen silent, so its healthy channels are no longer known and go
        out as NaN. Returns why nothing was sent, or None; also None when a message at least as
        new is out already.
        """
        if self.last_sent is not None and time <= self.last_sent:
            return None
        message = self.template
        if message is None:
            if self.stamped:
                return 'no message of its driver was ever seen, so frame and names are not known'
            message = self.sensors[0].kind()
        for sensor in self.sensors:
            if sensor.name in values:
                problem = sensor.accessor.put(message, values[sensor.name])
            elif silent and sensor.name not in self.passing:
                problem = sensor.accessor.put(message, float('nan'))
            else:
                problem = None
            if problem is not None:
                return problem
        if self.stamped:
            put_stamp(message, time)
        self.template = message
        self.publisher.publish(message)
        self.last_sent, self.replacing = time, True
        return None


def open_streams(node: Node, group: Polled, sensors: Sequence[Sensor]) -> tuple[Stream, ...]:
    """Create the subscription and the publisher of each topic, once and for all."""
    streams = []
    for topic in dict.fromkeys(sensor.input for sensor in sensors):
        sharing = tuple(sensor for sensor in sensors if sensor.input == topic)
        kind, output = sharing[0].kind, sharing[0].output
        publisher = node.create_publisher(
            kind, output, SPEAK,
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False))
        streams.append(Stream(
            sharing, subscribe(node, group, kind, topic, LISTEN), publisher, has_stamp(kind)))
    return tuple(streams)
