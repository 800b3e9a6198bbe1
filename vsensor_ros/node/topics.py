"""The two ends of a stream on the graph: where drivers are heard, and where we speak."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import copy
import math
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from vsensor_ros.engine import ANYBODYS, Composition, Forward, StreamPlan, Substitute
from vsensor_ros.node.accessor import compile_holder, compile_names, owner_of_names
from vsensor_ros.node.cdr import decode, Reader, Reading
from vsensor_ros.node.disowned import compile_remover
from vsensor_ros.node.endpoints import Sensor
from vsensor_ros.node.mute import Mute
from vsensor_ros.node.polling import LISTEN, Polled, subscribe
from vsensor_ros.node.private_rclpy import sender
from vsensor_ros.node.qos import DEEPEST, qos_options
from vsensor_ros.node.room import complete
from vsensor_ros.node.template import blank, Template
from vsensor_ros.node.variance import compile_variance
from vsensor_ros.reason import Reason

SPEAK = QoSProfile(depth=DEEPEST, reliability=ReliabilityPolicy.RELIABLE)


class Topic:
    """The messages of one input topic, and those that go out on one output topic."""

    def __init__(self, index: int, sensors: Sequence[Sensor], subscription: Subscription,
                 publisher: Publisher) -> None:
        """Serve the stream of this index; sensors: whose fields are in its messages."""
        self.index, self.sensors = index, sensors
        self.subscription, self.publisher = subscription, publisher
        self.kind = kind = sensors[0].kind
        self.stamps = sensors[0].stamps
        self.reader = Reader(kind, [s.accessor for s in sensors], self.stamps)
        self.send = sender(publisher)
        self._templates: dict[int, Template] = {}  # by number of the sender
        self._set_variance = [compile_variance(kind, s.accessor.path) for s in sensors]
        self._remove_marks = [compile_remover(s.accessor) for s in sensors]
        ways = [s.accessor.steps[:depth + 1] for s in sensors
                for depth, step in enumerate(s.accessor.steps) if step.names is not None]
        self._named = [(compile_holder(steps[:-1]), steps[-1].field, compile_names(steps))
                       for steps in ways if steps[-1].name is not None]
        self._owners = {(*owner_of_names(steps), steps[-1].kind): (
            compile_holder(owner_of_names(steps)), steps[-1]) for steps in ways}.values()

    @property
    def plan(self) -> StreamPlan:
        """What the engine must know of it."""
        first = self.sensors[0]
        return StreamPlan(tuple(s.name for s in self.sensors), first.input, first.output,
                          bool(self.stamps))

    def forward(self, raw: bytes, reading: Reading, verdict: Forward) -> None:
        """Send a message on; raises RuntimeError when the middleware cannot."""
        if verdict.changed:
            written = self.reader.write(raw, reading, verdict.changed)
            raw = raw if isinstance(written, Reason) else written
        self.send(raw)

    def related(self, raw: bytes, templates: Sequence[tuple[int, bytes]]) -> int | None:
        """
        Return which of these templates, by number, shares joints with a message; None: none.

        One with numbers that have no names may be anybody's.
        """
        message = decode(self.kind, raw)
        if any(not (there := names(message)) or len(getattr(holder, field)) > len(there)
               for find, field, names in self._named if (holder := find(message)) is not None):
            return ANYBODYS
        for number, template in templates:
            there = self._template(number, template).message
            if any(set(s.accessor.names(message)) & set(s.accessor.names(there))
                   for s in self.sensors):
                return number
        return None

    def compose(self, composition: Composition) -> Any:
        """Return the message that a composition describes, or the reason why it cannot be."""
        template = self._template(composition.sender, composition.template)
        message = template.message
        first, last = composition.first, template.raw
        if composition.blank and not template.blanked and first is not None and last is not None:
            blank(message, decode(self.kind, first), decode(self.kind, last))
            template.blanked = True
        for i, field in composition.fields:
            if isinstance(field, Substitute):
                self._remove_marks[i](message, field.value)
        for i, field in composition.fields:
            problem = self._write(message, i, field)
            if problem is not None:
                return problem
        ever = set().union(*(self.reader.aligned[i] for i, _ in composition.fields))
        for find, step in self._owners:
            if (owner := find(message)) is not None:
                complete(owner, step, ever)
        for stamp in self.stamps:
            problem = stamp.put(message, composition.stamp)
            if problem is not None:
                return problem
        return message

    def _write(self, message: Any, i: int, field: Substitute | float | None) -> Reason | None:
        """Write what a composition has for a field; return why it cannot be written."""
        accessor = self.sensors[i].accessor
        if isinstance(field, Substitute):
            set_variance, there = self._set_variance[i], accessor.get(message)
            if set_variance is not None and not (  # nothing is supplied: its mark may stay
                    isinstance(there, Reason) and math.isnan(field.value)):
                set_variance(message, math.hypot(field.deviation, field.doubtful))
            return accessor.put(message, field.value)
        if field is not None:
            return accessor.put(message, field)
        if isinstance(accessor.get(message), float):
            return accessor.put(message, math.nan)
        return None  # neither known nor there

    def _template(self, number: int, raw: bytes | None) -> Template:
        """Return the template of a sender, decoded when it is needed."""
        template = self._templates.get(number)
        if template is None or template.raw is not raw:
            message = self.kind() if raw is None else decode(self.kind, raw)
            template = self._templates[number] = Template(raw, message)
        return template


def open_topics(node: Node, group: Polled, sensors: Sequence[Sensor],
                speaks: bool = True) -> tuple[Topic, ...]:
    """
    Create the subscription and the publisher of each topic, once and for all.

    speaks: whether the node may publish there; else others do not see a publisher.
    """
    sharing: Mapping[str, list[Sensor]] = {sensor.input: [] for sensor in sensors}
    for sensor in sensors:
        sharing[sensor.input].append(sensor)
    topics = []
    for index, (topic, together) in enumerate(sharing.items()):
        kind, output = together[0].kind, together[0].output
        publisher: Any = Mute(output, SPEAK) if not speaks else node.create_publisher(
            kind, output, copy.copy(SPEAK), qos_overriding_options=qos_options(),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False))
        topics.append(Topic(index, together, subscribe(node, group, kind, topic, LISTEN),
                            publisher))
    return tuple(topics)
