"""What the virtual sensors said, on ``~/estimates``: value, deviation and offset of each."""

from __future__ import annotations

from collections.abc import Sequence

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from vsensor_ros.engine import Substitute
from vsensor_ros.node.qos import ESTIMATES, qos_options


class Estimates:
    """One message for each time at which estimates went out, when somebody listens."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(
            DiagnosticArray, ESTIMATES,
            QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
            qos_overriding_options=qos_options())

    def send(self, at: int, estimates: Sequence[tuple[str, Substitute]]) -> None:
        """Publish what went out for these channels, stamped with the time of the state [ns]."""
        if not estimates or not self._publisher.get_subscription_count():
            return
        message = DiagnosticArray(status=[_status(name, said) for name, said in estimates])
        message.header.stamp = Time(sec=at // 10**9, nanosec=at % 10**9)
        self._publisher.publish(message)

    def close(self, node: Node) -> None:
        """Close the topic."""
        node.destroy_publisher(self._publisher)


def _status(name: str, said: Substitute) -> DiagnosticStatus:
    facts = {'value': said.value, 'deviation': said.deviation, 'offset': said.offset}
    if said.interval is not None:
        facts['low'], facts['high'] = said.interval
    return DiagnosticStatus(
        level=DiagnosticStatus.OK, name=name,
        values=[KeyValue(key=key, value=repr(float(value))) for key, value in facts.items()])
