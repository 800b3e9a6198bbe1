"""What could be a sensor or a command: the numbers in the messages that are on the graph."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
import time
from typing import Any

from rclpy.node import Node

from vsensor_ros.bad_input import BadInput
from vsensor_ros.commissioning.likeness import bracketed
from vsensor_ros.commissioning.neighbours import (
    listeners,
    Neighbour,
    publishers,
    types_of_topics,
)
from vsensor_ros.commissioning.ranking import Candidate
from vsensor_ros.commissioning.routes import RAW
from vsensor_ros.commissioning.units import units_of
from vsensor_ros.node.accessor import field_type, message_type, NAME_ARRAYS, trace
from vsensor_ros.node.cdr import decode
from vsensor_ros.node.orientation import ANGLES, EulerAngle
from vsensor_ros.node.polling import drain, LISTEN, Polled, subscribe
from vsensor_ros.node.topics import SPEAK

SETTLED = 1.0  # s without a new topic after which all are taken to be found
LONGEST = 10.0  # s that may be listened beyond what was asked for, while topics turn up
PAUSE = 0.01  # s between two looks at what has come
LOOK = 0.2  # s between two looks at the graph
DECODED = 300  # messages of a topic that are looked into; the others are counted
LARGEST = 2**16  # bytes of a message that is looked into: images and clouds are no sensors
MOST_ELEMENTS = 64  # of an array
MOST_FIELDS = 500  # of a topic
DEEPEST = 6  # messages within messages
DIAGNOSTICS, TEXT = 'diagnostic_msgs/msg/DiagnosticArray', 'std_msgs/msg/String'

# these are no signals, whatever numbers they have
_STRANGE = ('builtin_interfaces/', 'rcl_interfaces/', 'diagnostic_msgs/', 'lifecycle_msgs/',
            'rosgraph_msgs/', 'tf2_msgs/', 'visualization_msgs/', 'shape_msgs/',
            'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage',
            'sensor_msgs/msg/PointCloud', 'sensor_msgs/msg/CameraInfo',
            'sensor_msgs/msg/LaserScan', 'nav_msgs/msg/OccupancyGrid', 'nav_msgs/msg/Path')
# beside a measurement in its message, and none itself
_BESIDE = {'covariance', 'variance', 'min_range', 'max_range', 'field_of_view', 'header', 'layout',
           'radiation_type', 'design_capacity', 'capacity'}


@dataclass(frozen=True)
class Leaf:
    """A number in a message: where, and in what unit."""

    path: str
    value: float
    units: tuple[str, ...]
    element: str
    whole: bool


@dataclass
class Topic:
    """A topic of the graph, and what was heard there."""

    name: str
    type: str
    kind: Any
    publishers: tuple[Neighbour, ...] = ()
    listeners: tuple[Neighbour, ...] = ()
    count: int = 0
    first: float = math.nan
    last: float = math.nan
    fields: dict[str, Candidate] = field(default_factory=dict)

    @property
    def rate(self) -> float:
        """Messages a second; 0 when that is not known."""
        passed = self.last - self.first
        return (self.count - 1) / passed if self.count > 1 and passed > 0.0 else 0.0

    def take(self, raw: bytes, received: int) -> None:
        """Take a serialized message."""
        self.first = received * 1e-9 if self.count == 0 else self.first
        self.last = received * 1e-9
        self.count += 1
        if self.count > DECODED or len(raw) > LARGEST:
            return
        message = decode(self.kind, raw)
        for leaf in leaves(message) if message is not None else ():
            known = self.fields.get(leaf.path)
            if known is None and len(self.fields) >= MOST_FIELDS:
                continue
            if known is None:
                known = Candidate(self.name, self.type, leaf.path, leaf.units, leaf.element,
                                  leaf.whole, low=math.inf, high=-math.inf)
            self.fields[leaf.path] = known if math.isnan(leaf.value) else replace(
                known, found=known.found + 1, low=min(known.low, leaf.value),
                high=max(known.high, leaf.value))

    def candidates(self) -> list[Candidate]:
        """Return its fields as they may be wired, with what was heard."""
        if not self.count:  # what a message has at least, if it is all numbers
            for leaf in leaves(self.kind()):
                self.fields.setdefault(leaf.path, Candidate(
                    self.name, self.type, leaf.path, leaf.units, leaf.element, leaf.whole))
        return [replace(c, heard=self.count, rate=self.rate, published=bool(self.publishers),
                        listened=bool(self.listeners))
                for c in self.fields.values() if _can_be_wired(self.kind, c.field)]


@dataclass(frozen=True)
class Surroundings:
    """All that was found on the graph."""

    topics: Mapping[str, Topic]  # with numbers
    isolations: tuple[tuple[str, str], ...]  # topics, with types, that may say who is faulty
    clock: bool  # somebody publishes /clock
    replacers: frozenset[str]  # full names of nodes that are replacers
    strange: tuple[str, ...]  # topics with types that are not installed here
    published: frozenset[str]  # all topics that anybody publishes on
    namespace: str = ''  # in which the replacer will be; '' when in none

    def is_input(self, name: str) -> bool:
        """Tell whether a driver has moved there: nobody but a replacer is on the plain topic."""
        plain = name.removesuffix(RAW)
        return plain != name and (plain not in self.published or (
            plain in self.topics and self.is_replaced(plain)))

    def is_replaced(self, name: str) -> bool:
        """Tell whether replacers, and nobody else, publish on a topic."""
        there = self.topics[name].publishers
        return bool(there) and all(p.node in self.replacers for p in there)

    def candidates(self) -> list[Candidate]:
        """Return all that may be wired: not what a replacer says, or is to say."""
        return [replace(c, moved=self.is_input(name), namespace=self.namespace)
                for name, topic in self.topics.items()
                if not self.is_replaced(name) and not self._is_answered(name)
                for c in topic.candidates()]

    def _is_answered(self, name: str) -> bool:
        """Tell whether this is where a replacer is to speak: its driver has moved."""
        return name not in self.published and f'{name}{RAW}' in self.published


def look_around(node: Node, seconds: float) -> Surroundings:
    """Listen to all topics for so long, and longer while new ones turn up."""
    group = Polled()
    topics: dict[str, Topic] = {}
    open_: dict[str, Any] = {}
    strange: dict[str, None] = {}
    begin = now = found = time.monotonic()
    looked = 0.0
    while now < begin + seconds or (now < found + SETTLED and now < begin + seconds + LONGEST):
        if now > looked + LOOK:
            looked = now
            for name, types in node.get_topic_names_and_types():
                if name in topics or name in strange or not _may_be(types):
                    continue
                try:
                    topics[name] = Topic(name, types[0], message_type(types[0]))
                    open_[name] = subscribe(node, group, topics[name].kind, name, LISTEN,
                                            overridden=False)
                except (BadInput, RuntimeError):  # not installed here, or of two types
                    topics.pop(name, None)
                    strange[name] = None
                    continue
                found = now
        for name, subscription in open_.items():
            for raw, info in drain(subscription):
                topics[name].take(raw, info['received_timestamp'])
        time.sleep(PAUSE)
        now = time.monotonic()
    for topic in topics.values():
        topic.publishers = publishers(node, topic.name)
        topic.listeners = listeners(node, topic.name, SPEAK)
    replacers = _replacers(node)
    return Surroundings(topics, _isolations(node, replacers),
                        bool(node.count_publishers('/clock')), replacers, tuple(strange),
                        frozenset(types_of_topics(node)), node.get_namespace().rstrip('/'))


def leaves(message: Any) -> Iterator[Leaf]:
    """Yield the numbers in a message that may be signals."""
    yield from _leaves(message, '', (), '', 0)


def _leaves(message: Any, place: str, units: tuple[str, ...], element: str,
            depth: int) -> Iterator[Leaf]:
    if depth > DEEPEST:
        return
    kind = type(message)
    fields = kind.get_fields_and_field_types()
    known_as = f'{kind.__module__.split(".")[0]}/{kind.__name__}'
    names = next((list(getattr(message, f)) for f in NAME_ARRAYS
                  if fields.get(f) == 'sequence<string>'), None)
    for name, text in fields.items():
        if name in _BESIDE or name.endswith('covariance') or name in NAME_ARRAYS:
            continue
        of, value, path = field_type(text), getattr(message, name), f'{place}{name}'
        own = units_of(known_as, name) or units
        if not of.is_array:
            yield from _within(value, of.inner, path, own, element, depth)
            continue
        if names is None and of.is_sequence and of.inner in ('uint8', 'int8', 'octet'):
            continue  # a heap of bytes
        for i, item in enumerate(list(value)[:MOST_ELEMENTS]):
            called = names[i] if names is not None and i < len(names) else ''
            if names is None or called:
                yield from _within(item, of.inner, path + (bracketed(called) if called else
                                                           f'[{i}]'), own, called or element,
                                   depth)


def _within(value: Any, inner: str, path: str, units: tuple[str, ...], element: str,
            depth: int) -> Iterator[Leaf]:
    if inner == 'geometry_msgs/Quaternion':
        for name in ANGLES:
            said = EulerAngle(name, path).read((value.x, value.y, value.z, value.w))
            yield Leaf(f'{name}({path})', said if isinstance(said, float) else math.nan, ('rad',),
                       element, False)
    if '/' in inner:
        if not inner.startswith(_STRANGE) and inner != 'std_msgs/Header':
            yield from _leaves(value, f'{path}.', units, element, depth + 1)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield Leaf(path, float(value), units, element, isinstance(value, int))


def _may_be(types: Sequence[str]) -> bool:
    return bool(types) and '/msg/' in types[0] and not types[0].startswith(_STRANGE) and \
        types[0] not in (TEXT, 'std_msgs/msg/Header', 'std_msgs/msg/Empty', 'std_msgs/msg/Bool')


def _can_be_wired(kind: Any, path: str) -> bool:
    try:
        trace(kind, path)
    except BadInput:
        return False
    return True


def _isolations(node: Node, replacers: Collection[str]) -> tuple[tuple[str, str], ...]:
    """
    Return published topics that are called isolation and have a type that is understood.

    What a replacer's own isolator says is known to it without a topic.
    """
    return tuple((topic, types[0]) for topic, types in node.get_topic_names_and_types()
                 if types and types[0] in (DIAGNOSTICS, TEXT) and node.count_publishers(topic)
                 and topic.rpartition('/')[2] in ('isolation', 'fault_isolation', 'isolated')
                 and topic.rpartition('/')[0] not in replacers)


def _replacers(node: Node) -> frozenset[str]:
    """Return the nodes that say on ~/estimates what virtual sensors say."""
    return frozenset(p.node for topic, _ in node.get_topic_names_and_types()
                     if topic.endswith('/estimates') for p in publishers(node, topic)
                     if f'{p.node}/estimates' == topic)


