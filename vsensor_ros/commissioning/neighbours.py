"""Who is on the graph: which nodes publish and listen where, and whether their QoS fits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile

HIDDEN = '_NODE_NAME_UNKNOWN_'  # of a node that is discovered in part


@dataclass(frozen=True)
class Neighbour:
    """One publisher or subscription of another node."""

    node: str  # its full name
    type: str  # package/msg/Name
    mismatch: str = ''  # how its QoS does not fit ours; '' when it does

    @property
    def fits(self) -> bool:
        """Whether messages would pass, the type aside."""
        return not self.mismatch


def publishers(node: Node, topic: str, ours: Sequence[QoSProfile] = ()) -> tuple[Neighbour, ...]:
    """Return who publishes on a topic; ours: what we hear it with, one that fits will do."""
    return _neighbours(node.get_publishers_info_by_topic(topic), [
        lambda other, own=own: qos_check_compatible(other, own) for own in ours])


def listeners(node: Node, topic: str, ours: QoSProfile | None = None) -> tuple[Neighbour, ...]:
    """Return who listens on a topic, other than this node; ours: what we would send with."""
    own = node.get_name(), node.get_namespace()
    return _neighbours(
        (e for e in node.get_subscriptions_info_by_topic(topic)
         if (e.node_name, e.node_namespace) != own),
        [] if ours is None else [lambda other: qos_check_compatible(ours, other)])


def types_of_topics(node: Node) -> Mapping[str, str]:
    """Return the topics that anybody publishes on, each with its first type."""
    return {topic: types[0] for topic, types in node.get_topic_names_and_types()
            if types and node.count_publishers(topic)}


def _neighbours(endpoints: Iterable[Any], checks: Sequence[Any]) -> tuple[Neighbour, ...]:
    found = []
    for endpoint in endpoints:
        said = [check(endpoint.qos_profile) for check in checks]
        wrong = said and all(fit == QoSCompatibility.ERROR for fit, _ in said)
        found.append(Neighbour(_name(endpoint), endpoint.topic_type,
                               said[0][1].strip().rstrip(';') if wrong else ''))
    return tuple(sorted(found, key=lambda n: (n.node, n.type)))


def _name(endpoint: Any) -> str:
    if endpoint.node_name == HIDDEN:
        return 'a node without a name yet'
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'
