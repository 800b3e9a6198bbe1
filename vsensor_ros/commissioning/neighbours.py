"""Who is on the graph: which nodes publish and listen where, and whether their QoS fits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from vsensor_ros.node.graph import full_name, unfit


@dataclass(frozen=True)
class Neighbour:
    """One publisher or subscription of another node."""

    node: str  # its full name
    type: str  # package/msg/Name
    mismatch: str = ''  # how its QoS does not fit ours; '' when it does
    mend: str = ''  # what to do about that


def publishers(node: Node, topic: str, ours: Sequence[QoSProfile] = ()) -> tuple[Neighbour, ...]:
    """Return who publishes on a topic; ours: what we hear it with, one that fits will do."""
    return _sorted(Neighbour(_name(e), e.topic_type, *unfit(
        [(e.qos_profile, own) for own in ours], topic, False))
        for e in node.get_publishers_info_by_topic(topic))


def listeners(node: Node, topic: str, ours: QoSProfile | None = None) -> tuple[Neighbour, ...]:
    """Return who listens on a topic, other than this node; ours: what we would send with."""
    own = node.get_name(), node.get_namespace()
    return _sorted(Neighbour(_name(e), e.topic_type, *unfit(
        [] if ours is None else [(ours, e.qos_profile)], topic, True))
        for e in node.get_subscriptions_info_by_topic(topic)
        if (e.node_name, e.node_namespace) != own)


def types_of_topics(node: Node) -> Mapping[str, str]:
    """Return the topics that anybody publishes on, each with its first type."""
    return {topic: types[0] for topic, types in node.get_topic_names_and_types()
            if types and node.count_publishers(topic)}


def _sorted(found: Iterable[Neighbour]) -> tuple[Neighbour, ...]:
    return tuple(sorted(found, key=lambda n: (n.node, n.type)))


def _name(endpoint: Any) -> str:
    return full_name(endpoint) or 'a node without a name yet'
