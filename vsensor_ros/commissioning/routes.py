"""Where the driver of each sensor is to publish, so that the replacer can speak in its place."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import count

RAW = '_raw'  # what drivers' topics end in


@dataclass(frozen=True)
class Route:
    """The way of the messages of one topic through the replacer."""

    input: str  # the driver publishes there
    output: str  # the replacer speaks there

    @property
    def plain(self) -> bool:
        """Whether the input is what the node takes by default."""
        return self.input == self.output + RAW


def routes(topics: Iterable[str], inputs: Collection[str], others: Iterable[str],
           ) -> dict[str, Route]:
    """
    Return the route of each topic that has sensors.

    inputs: those of the topics where the driver has moved to already. others: all topics that are
    published or have commands; no driver is sent there.
    """
    topics = list(dict.fromkeys(topics))
    found = {topic: Route(topic, topic.removesuffix(RAW)) for topic in topics if topic in inputs}
    used = {*others, *topics, *(route.output for route in found.values())}
    for topic in topics:
        if topic not in found:
            found[topic] = Route(next(t for t in _places(topic) if t not in used), topic)
            used.add(found[topic].input)
    return found


def _places(topic: str) -> Iterator[str]:
    yield topic + RAW
    yield f'{topic}_driver'
    yield from (f'{topic}_driver{i}' for i in count(2))
