"""
Where the messages of one input are taken, and which node sent them.

Mostly one node publishes there, and nobody asks. While there are several, it is noted which of
them says what: two that say the same number are a mistake that shows in no message. When some
were chosen, the messages of all others are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import math
import time
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from vsensor_ros.node.cdr import Reader
from vsensor_ros.node.endpoints import Command, Sensor
from vsensor_ros.node.graph import Complaint, full_name, listed, UNKNOWN
from vsensor_ros.node.polling import DEPTH
from vsensor_ros.node.private_rclpy import identifying_taker, IdentifyingTaker, taker

SAMPLE = 0.1  # s between two messages of one publisher that are looked into
LATELY = 10.0  # s for which it counts what was seen
AGAIN = 0.2  # s between two looks at the graph for the name of a publisher
MOST = 64  # publishers that are told apart


class Inlet:
    """One input: `take` takes its next message, as `taker` says. To be used under one lock."""

    def __init__(self, node: Node, subscription: Subscription, reader: Reader,
                 sources: Sequence[Sensor | Command], refused: Callable[[], object]) -> None:
        """
        Begin; sources: what the numbers of the reader are.

        refused: is called for each message from a node that was not chosen for any of them.
        """
        self.topic, self.reader, self._sources = subscription.topic_name, reader, sources
        self._node, self._subscription, self._refused = node, subscription, refused
        self._chosen = {source.publisher for source in sources if source.publisher}
        self._identify: IdentifyingTaker | None = None
        # by name and publisher: since when and until when it said so
        self._spans: dict[str, dict[bytes, tuple[float, float]]] = {
            source.name: {} for source in sources}
        self._next: dict[bytes, float] = {}  # by publisher: when it is looked at again
        self._nodes: dict[bytes, str] = {}  # by publisher: its node
        self._looked = -math.inf  # when they were looked for
        self.take: Callable[[Any, bool], Any] = taker(subscription)
        self.watch(False)

    def watch(self, several: bool) -> None:
        """Note from now on who says what, or no more."""
        if several or self._chosen:
            self._identify = self._identify or identifying_taker(self._subscription)
            if self._identify is not None:
                self.take = self._take
        elif self._identify is not None:
            self._identify, self.take = None, taker(self._subscription)

    def complaints(self, there: Sequence[str]) -> Iterator[Complaint]:
        """Yield what is wrong with who publishes; there: the nodes that do."""
        for source, spans in zip(self._sources, self._spans.values()):
            if rivals := self._rivals(spans):
                yield Complaint(self.topic, f'{listed(rivals)} both say what {source.name} is; '
                                f'stop one, or choose one with {_key(source)}', source.name)
        for source in self._sources:
            if source.publisher and self._identify is None:
                yield Complaint(self.topic, f'this release of rcl does not tell who sent a '
                                f'message, so {_key(source)} has no effect; leave it out',
                                source.name)
            elif source.publisher and there and source.publisher not in there:
                yield Complaint(self.topic, f'{source.publisher} was chosen with {_key(source)}, '
                                f'but does not publish here, as {listed(there)} does; start it, '
                                'or choose another', source.name)

    def _rivals(self, spans: dict[bytes, tuple[float, float]]) -> list[str]:
        """Return the nodes of the publishers that were seen lately, in turns."""
        now = time.monotonic()
        for gid in [gid for gid, (_, last) in spans.items() if now - last > LATELY]:
            del spans[gid]
        return sorted(self._name(gid) or UNKNOWN for gid, (first, last) in spans.items() if any(
            first <= others_last and others_first <= last
            for other, (others_first, others_last) in spans.items() if other != gid))

    def _take(self, kind: Any, raw: bool) -> Any:
        assert self._identify is not None
        for _ in range(DEPTH):
            taken = self._identify(kind, raw)
            if taken is None:
                return None
            gid, now = taken[1]['publisher_gid'], time.monotonic()
            if self._chosen and self._name(gid) not in self._chosen:
                self._refused()
                continue
            if now >= self._next.get(gid, 0.0):
                self._note(gid, taken[0], now)
            return taken
        return None  # there may be more: whoever waits is woken again

    def _note(self, gid: bytes, raw: bytes, now: float) -> None:
        """Look at what a publisher says."""
        if len(self._next) >= MOST:
            self._next.clear()
        self._next[gid] = now + SAMPLE
        reading = self.reader.read(raw)
        for spans, value in zip(self._spans.values(), reading.values if reading else ()):
            if isinstance(value, float) and math.isfinite(value):
                first, last = spans.get(gid, (now, now))
                if len(spans) < MOST or gid in spans:
                    spans[gid] = (first if now - last <= LATELY else now, now)

    def _name(self, gid: bytes) -> str | None:
        """Return the full name of the node of a publisher; None: it is not known yet."""
        now = time.monotonic()
        if gid not in self._nodes and now - self._looked > AGAIN:
            self._looked = now
            self._nodes = {
                bytes(end.endpoint_gid): name for end in
                self._node.get_publishers_info_by_topic(self.topic)
                if (name := full_name(end)) is not None}
        return self._nodes.get(gid)


def _key(source: Sensor | Command) -> str:
    """Return the parameter by which a publisher is chosen."""
    return f'{"sensors" if isinstance(source, Sensor) else "commands"}.{source.name}.publisher'
