"""What is heard on one topic: how often, how old, and what stands in the fields."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
import math

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile

from vsensor_ros.node.cdr import decode, Reader, Reading
from vsensor_ros.node.endpoints import Command, Sensor
from vsensor_ros.node.inlet import Inlet
from vsensor_ros.node.polling import DEPTH, Polled, subscribe
from vsensor_ros.reason import Reason

MOST = 100_000  # ages and intervals that are kept of one topic
LOOKED_AT = 20  # messages that lack a field and are decoded for the names they have
MOST_NAMES = 200  # of elements that are remembered


@dataclass
class FieldHeard:
    """What one field said."""

    found: int = 0  # numbers, NaN not among them
    nan: int = 0
    lack: Reason | None = None  # why a message had no number there; the last one
    low: float = math.inf
    high: float = -math.inf

    def take(self, value: float | Reason) -> None:
        """Take what one message says."""
        if isinstance(value, Reason):
            self.lack = value
        elif math.isnan(value):
            self.nan += 1
        else:
            self.found += 1
            self.low, self.high = min(self.low, value), max(self.high, value)


@dataclass
class Heard:
    """What was heard on a topic; times in s."""

    fields: dict[str, FieldHeard]
    count: int = 0
    unreadable: int = 0
    unstamped: int = 0  # whose stamp is not filled in
    first: float = math.nan  # when they came
    last: float = math.nan
    longest: float = 0.0  # between two of them
    returns: int = 0  # times that the number of a message fell behind: two publishers take turns
    repeated: int = 0  # whose stamp is that of the message before, with the same fields
    ages: deque[float] = field(default_factory=lambda: deque(maxlen=MOST))  # arrival - stamp
    names: dict[str, None] = field(default_factory=dict)  # of elements, of messages that lack one

    @property
    def rate(self) -> float:
        """Messages a second, NaN when there are too few."""
        passed = self.last - self.first
        return (self.count - 1) / passed if self.count > 1 and passed > 0.0 else math.nan

    @property
    def age(self) -> tuple[float, float]:
        """
        Median of arrival - stamp [s], and the spread: half of what nine tenths lie within.

        NaN when nothing has a stamp.
        """
        if not self.ages:
            return math.nan, math.nan
        low, middle, high = np.percentile(np.array(self.ages), (5.0, 50.0, 95.0))
        return float(middle), float(high - low) / 2.0


class Ear:
    """Listens to one topic."""

    def __init__(self, node: Node, group: Polled, topic: str, qos: QoSProfile,
                 readers: Sequence[Reader], choosing: Sequence[Sensor | Command] = ()) -> None:
        """
        Subscribe as the replacer would; readers: what is to be looked at, of one type.

        choosing: those whose publishers alone are to be heard.
        """
        self.kind = kind = readers[0].kind
        self.heard = Heard({accessor.path: FieldHeard() for reader in readers
                            for accessor in reader.accessors})
        self.subscription = subscribe(node, group, kind, topic, qos)
        self._inlet = Inlet(node, self.subscription, readers[0], choosing, lambda: None)
        self._readers = readers
        self._stamp: tuple[int, list[bool]] | None = None  # the last one, and who was there
        self._stamped = kind.get_fields_and_field_types().get('header') == 'std_msgs/Header'
        self._number = -1  # of the last message, by its publisher's count
        self._left = LOOKED_AT

    def listen(self, simulated: int | None = None) -> None:
        """Take what has come; simulated: the time [ns] by which stamps are judged, if any is."""
        for _ in range(DEPTH):
            if (taken := self._inlet.take(self.kind, True)) is None:
                break
            raw, info = taken
            received = info['received_timestamp']
            self._count(received * 1e-9, info.get('publication_sequence_number'))
            readings = [reading for reader in self._readers
                        if (reading := reader.read(raw)) is not None]
            if not readings:
                self.heard.unreadable += 1
                continue
            if readings[0].stamp is not None:
                now = received if simulated is None else simulated
                self.heard.ages.append((now - readings[0].stamp) * 1e-9)
                stamp = readings[0].stamp, [isinstance(v, Reason) for r in readings
                                            for v in r.values]
                self.heard.repeated += stamp == self._stamp
                self._stamp = stamp
            elif self._stamped:
                self.heard.unstamped += 1
            for reader, reading in zip(self._readers, readings):
                self._look(reader, reading, raw)

    def _count(self, at: float, number: int | None) -> None:
        heard = self.heard
        if heard.count == 0:
            heard.first = at
        else:
            heard.longest = max(heard.longest, at - heard.last)
        heard.last = at
        heard.count += 1
        if number is not None:
            heard.returns += number <= self._number
            self._number = number

    def _look(self, reader: Reader, reading: Reading, raw: bytes) -> None:
        lacking = False
        for accessor, value in zip(reader.accessors, reading.values):
            self.heard.fields[accessor.path].take(value)
            lacking = lacking or isinstance(value, Reason)
        if lacking and self._left:
            self._left -= 1
            message = decode(self.kind, raw)
            for accessor in reader.accessors:
                for name in list(accessor.names(message))[:MOST_NAMES - len(self.heard.names)]:
                    self.heard.names[name] = None
