"""
Who is on our topics, and what cannot work there.

Another type, QoS that does not match, nobody who isolates; for more see `Inlet`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
import difflib
from itertools import islice
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from vsensor_ros.node.parameters import Settings
from vsensor_ros.node.qos import mends, misfit


@dataclass(frozen=True)
class End:
    """One topic that we hear or speak on."""

    topic: str
    type: str  # package/msg/Name
    speaks: bool  # we publish there


@dataclass(frozen=True)
class Complaint:
    """What other nodes do on a topic, or fail to do, that cannot work."""

    topic: str
    text: str  # what is and what to do about it
    about: str = ''  # the sensor or command that it is about alone

    def __str__(self) -> str:
        return f'{self.topic}: {self.text}'


MOST_TOPICS = 1000  # that are looked through for one that may have been meant
FEW = 3  # that are named
ALIKE = 0.75  # ratio of difflib
UNKNOWN = 'a node whose name is not known'
_NO_NAME = '_NODE_NAME_UNKNOWN_'  # of rmw, until it has discovered it


def ends_of(settings: Settings) -> tuple[End, ...]:
    """Return the topics that were configured, each once."""
    ends = [End(settings.isolation_topic, settings.isolation_type, False)]
    for sensor in settings.sensors:
        ends.append(End(sensor.input, sensor.type, False))
        ends.append(End(sensor.output, sensor.type, True))
    ends += [End(command.topic, command.type, False) for command in settings.commands]
    return tuple(dict.fromkeys(ends))


def complaints(node: Node, ends: Iterable[End]) -> Iterator[Complaint]:
    """Yield a complaint for each endpoint on the graph that does not go with ours."""
    for end in ends:
        ours, publishers = _split(node, node.get_publishers_info_by_topic(end.topic))
        if end.speaks:
            for other in publishers:
                yield Complaint(end.topic, f'{_who(other)} publishes there too, on the output of '
                                f'this node; remap it, if it is the driver to {end.topic}_raw')
            for other in ours[1:]:  # this node has one
                yield Complaint(end.topic, f'another {_who(other)} publishes there too, on the '
                                'output of this node; end it, unless it was killed just now')
            _, listeners = _split(node, node.get_subscriptions_info_by_topic(end.topic))
            for other in listeners:
                yield from _mismatch(end, other, [(p, other) for p in ours])
        else:
            ours, _ = _split(node, node.get_subscriptions_info_by_topic(end.topic))
            for other in publishers:
                yield from _mismatch(end, other, [(other, s) for s in ours])


def silent_isolation(node: Node, end: End, there: Sequence[str]) -> Iterator[Complaint]:
    """Yield a complaint when nobody says which sensors are faulty; there: who publishes."""
    if not there:
        like = published_like(node, end.topic, end.type)
        yield Complaint(end.topic, 'nobody publishes here, so no fault will be heard of; start '
                        'what finds the faults, or correct isolation.topic' + meant(like))


def published_like(node: Node, topic: str, kind: str) -> tuple[str, ...]:
    """Return what is published with a type on topics with names like that of one; a few."""
    name, others = topic.casefold(), {}
    for other, kinds in islice(node.get_topic_names_and_types(), MOST_TOPICS):
        if kind in kinds and other != topic and node.count_publishers(other):
            others[other] = other.casefold()
    same = [other for other, folded in others.items()
            if folded.rpartition('/')[2] == name.rpartition('/')[2]]
    return tuple(same[:FEW]) or tuple(
        other for other, folded in others.items()
        if folded in difflib.get_close_matches(name, others.values(), FEW, ALIKE))[:FEW]


def meant(topics: Sequence[str]) -> str:
    """Name the topics that may have been meant."""
    return f' (to {" or ".join(topics)}?)' if topics else ''


def listed(nodes: Sequence[str]) -> str:
    """List nodes, of which some may have the same name."""
    return ' and '.join(f'another {node}' if node in nodes[:i] else node
                        for i, node in enumerate(nodes))


def _split(node: Node, endpoints: Iterable[Any]) -> tuple[list[Any], list[Any]]:
    """Return the endpoints of nodes named as this one, and those of others."""
    own = (node.get_name(), node.get_namespace())
    ours: list[Any] = []
    others: list[Any] = []
    for e in endpoints:
        if (e.node_name, e.node_namespace) == own:
            ours.append(e)
        elif e.node_name != _NO_NAME:  # told apart at the next look
            others.append(e)
    return ours, others


def _mismatch(end: End, other: Any, pairs: Sequence[tuple[Any, Any]]) -> Iterator[Complaint]:
    """Compare with one endpoint, given as (publisher, subscription) with each of ours."""
    if other.topic_type != end.type:
        yield Complaint(end.topic, f'{_who(other)} uses the type {other.topic_type}, this node '
                        f'{end.type}; nothing passes between them, correct the type of one')
        return
    wrong, mend = unfit([(publisher.qos_profile, subscription.qos_profile)
                         for publisher, subscription in pairs], end.topic, end.speaks)
    if wrong:
        yield Complaint(end.topic, f'the QoS of {_who(other)} does not match that of this '
                        f'node ({wrong}); nothing passes between them, {mend}')


def unfit(pairs: Sequence[tuple[QoSProfile, QoSProfile]], topic: str,
          speaks: bool) -> tuple[str, str]:
    """
    Say why nothing passes between another's end and ours, and the mend; ('', '') when it does.

    pairs: (publisher, subscription), one for each of our ends: it is enough that one fits, as on
    the isolation topic, where this node has two. speaks: ours publish.
    """
    wrong = [misfit(*pair) for pair in pairs]
    if not wrong or not all(wrong):
        return '', ''
    ours = 'publisher' if speaks else 'subscription'
    mend = min(filter(None, (mends(*pair, topic, ours) for pair in pairs)), key=len, default=[])
    return wrong[0], 'change it there' + (f', or here with {" and ".join(mend)}' if mend else '')


def publishers(node: Node, topics: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return by topic the full names of other nodes' publishers there, one for each."""
    return {topic: tuple(sorted(_who(other) for other in _split(
        node, node.get_publishers_info_by_topic(topic))[1])) for topic in topics}


def full_name(endpoint: Any) -> str | None:
    """Return the full name of an endpoint's node; None: it is not known yet."""
    return None if endpoint.node_name == _NO_NAME else _who(endpoint)


def _who(endpoint: Any) -> str:
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'
