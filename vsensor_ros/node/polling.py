"""
Subscriptions that no executor waits for: an executor costs several times as much a message.

They sit in a callback group that never executes and are drained with take_message.
"""

from __future__ import annotations

import copy
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock

from vsensor_ros.node.cdr import decode
from vsensor_ros.node.private_rclpy import taker
from vsensor_ros.node.qos import DEEPEST, qos_options

DEPTH = 200  # messages of a topic that one poll takes at most, so that ticks come in between
# A best-effort subscription also hears reliable publishers, a volatile one transient-local ones.
# On a busy machine the loop may not get to run for long: what comes meanwhile must find room.
LISTEN = QoSProfile(depth=DEEPEST, reliability=ReliabilityPolicy.BEST_EFFORT)
LISTEN_TO_CLOCK = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
LISTEN_RELIABLY = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)


class Polled(CallbackGroup):
    """A group whose subscriptions no executor waits for."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


def subscribe(node: Node, group: Polled, kind: Any, topic: str, qos: QoSProfile,
              overridden: bool = True) -> Subscription:
    """
    Subscribe to serialized messages, to be taken with `drain`.

    overridden: parameters may change the QoS.
    """
    return node.create_subscription(
        kind, topic, _never, copy.copy(qos), callback_group=group, raw=True,
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        qos_overriding_options=qos_options() if overridden else None)


def _never(message: Any) -> None:
    raise AssertionError('a polled subscription was executed')


def drain(subscription: Subscription, most: int = DEPTH) -> list[tuple[bytes, dict[str, Any]]]:
    """
    Return what has arrived: serialized messages, each with what the middleware says of it.

    Mostly nothing has arrived, so that must cost little.
    """
    take, kind = taker(subscription), subscription.msg_type
    arrived: list[tuple[bytes, dict[str, Any]]] = []
    while len(arrived) < most and (taken := take(kind, True)) is not None:
        arrived.append(taken)
    return arrived


class SimulatedTime:
    """
    What ``/clock`` says, heard by the loop itself.

    So time moves between two polls and never within one, and it wakes the loop like any message.
    """

    def __init__(self, node: Node, group: Polled) -> None:
        self.subscription = subscribe(node, group, Clock, '/clock', LISTEN_TO_CLOCK,
                                      overridden=False)

    def read(self) -> int | None:
        """Return the newest time [ns], or None when nothing new was said."""
        arrived = drain(self.subscription)
        message = decode(Clock, arrived[-1][0]) if arrived else None
        return None if message is None else message.clock.sec * 10**9 + message.clock.nanosec
