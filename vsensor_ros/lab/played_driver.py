"""A driver of the machine as the laboratory plays it: one topic, with the channels on it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from vsensor_ros.lab.wiring import blank, Port
from vsensor_ros.node.accessor import has_stamp, put_stamp

NAME_FIELDS = ('name', 'joint_names')

Garble = Callable[[Any], Sequence[Any]]  # a driver's message to those that it sends instead


class PlayedDriver:
    """One topic of the machine and the channels that travel on it."""

    def __init__(self, node: Node, ports: Sequence[Port]) -> None:
        self.ports, self.topic, self.kind = ports, ports[0].source, ports[0].kind
        self.stamped = has_stamp(self.kind)
        self.message = blank(list(ports))
        self.frame = self.topic.strip('/') if self.stamped else ''
        if self.stamped:
            self.message.header.frame_id = self.frame
        self.names = names_in(self.message)
        self.garble: Garble | None = None
        self.publisher: Publisher | None = None
        self.open(node)

    @property
    def heard(self) -> bool:
        """Tell whether anybody listens."""
        return self.publisher is not None and self.publisher.get_subscription_count() > 0

    def open(self, node: Node) -> None:
        """Begin to publish."""
        self.publisher = node.create_publisher(self.kind, self.topic, QoSProfile(depth=1000))

    def close(self, node: Node) -> None:
        """Die; what is to be published is lost."""
        if self.publisher is not None:
            node.destroy_publisher(self.publisher)
            self.publisher = None

    def send(self, values: Sequence[float], stamp: int) -> None:
        """Publish a value for each port, NaN where it has none."""
        message = blank(list(self.ports)) if self.garble else self.message
        for port, value in zip(self.ports, values):
            port.field.put(message, value)
        if self.stamped:
            message.header.frame_id = self.frame
            put_stamp(message, stamp)
        for sent in self.garble(message) if self.garble else (message,):
            if self.publisher is not None:
                self.publisher.publish(sent)


def drivers_of(node: Node, ports: Iterable[Port]) -> list[PlayedDriver]:
    """Return who publishes these channels: those of one topic travel together."""
    by_topic: dict[str, list[Port]] = {}
    for port in ports:
        by_topic.setdefault(port.source, []).append(port)
    return [PlayedDriver(node, group) for group in by_topic.values()]


def names_in(message: Any) -> tuple[str, ...]:
    """Return the names of the elements of a message, () when its type has none."""
    return next((tuple(getattr(message, f)) for f in NAME_FIELDS
                 if isinstance(getattr(message, f, None), list)), ())
