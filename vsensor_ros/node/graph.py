"""What others do on our topics that cannot work: another type, QoS that does not match."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility


@dataclass(frozen=True)
class End:
    """One topic that we hear or speak on."""

    topic: str
    type: str  # package/msg/Name
    speaks: bool  # we publish there


def complaints(node: Node, ends: Iterable[End]) -> Iterator[str]:
    """Yield one line for each endpoint on the graph that does not go with ours."""
    for end in ends:
        ours, publishers = _split(node, node.get_publishers_info_by_topic(end.topic))
        if end.speaks:
            for other in publishers:
                yield (f'{end.topic}: {_who(other)} publishes there too, on the output of this '
                       f'node; remap it, if it is the driver to {end.topic}_raw')
            for other in ours[1:]:  # this node has one
                yield (f'{end.topic}: another {_who(other)} publishes there too, on the output '
                       'of this node; end it, unless it was killed just now')
            _, listeners = _split(node, node.get_subscriptions_info_by_topic(end.topic))
            for other in listeners:
                yield from _mismatch(end, other, [(p, other) for p in ours])
        else:
            ours, _ = _split(node, node.get_subscriptions_info_by_topic(end.topic))
            for other in publishers:
                yield from _mismatch(end, other, [(other, s) for s in ours])


def _split(node: Node, endpoints: Iterable[Any]) -> tuple[list[Any], list[Any]]:
    """Return the endpoints of nodes named as this one, and those of others."""
    own = (node.get_name(), node.get_namespace())
    ours: list[Any] = []
    others: list[Any] = []
    for e in endpoints:
        if (e.node_name, e.node_namespace) == own:
            ours.append(e)
        elif e.node_name != '_NODE_NAME_UNKNOWN_':  # told apart at the next look
            others.append(e)
    return ours, others


def _mismatch(end: End, other: Any, pairs: Iterable[tuple[Any, Any]]) -> Iterator[str]:
    """Compare with one endpoint, given as (publisher, subscription) with each of ours."""
    if other.topic_type != end.type:
        yield (f'{end.topic}: {_who(other)} uses the type {other.topic_type}, this node '
               f'{end.type}; nothing passes between them, correct the type of one')
        return
    for publisher, subscription in pairs:
        compatible, reason = qos_check_compatible(
            publisher.qos_profile, subscription.qos_profile)
        if compatible == QoSCompatibility.ERROR:
            yield (f'{end.topic}: the QoS of {_who(other)} does not match that of this node '
                   f'({reason.strip().rstrip(";")}); nothing passes between them')


def _who(endpoint: Any) -> str:
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'
