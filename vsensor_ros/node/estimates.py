"""What the virtual sensors said, on ``~/estimates``: value, deviation and offset of each."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from vsensor_ros.engine.channel import Channel
from vsensor_ros.node.qos import ESTIMATES, qos_options


class Estimates:
    """One message for each time at which estimates went out, when somebody listens."""

    def __init__(self, node: Node) -> None:
        self.count = 0  # estimates that went out
        self._publisher = node.create_publisher(
            DiagnosticArray, ESTIMATES,
            QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
            qos_overriding_options=qos_options())
        self._statuses: list[DiagnosticStatus] = []

    def add(self, channel: Channel, deviation: float, offset: float) -> None:
        """Note an estimate that went out, with its standard deviation and offset."""
        self.count += 1
        if self._publisher.handle.get_subscription_count():
            facts = {'value': channel.value, 'deviation': deviation, 'offset': offset}
            self._statuses.append(DiagnosticStatus(
                level=DiagnosticStatus.OK, name=channel.name,
                values=[KeyValue(key=key, value=repr(float(value)))
                        for key, value in facts.items()]))

    def send(self, at: int) -> None:
        """Publish what was noted, stamped with the time of the state [ns]."""
        if self._statuses:
            message = DiagnosticArray(status=self._statuses)
            message.header.stamp = Time(sec=at // 10**9, nanosec=at % 10**9)
            self._statuses = []
            self._publisher.publish(message)

    def close(self, node: Node) -> None:
        """Close the topic."""
        node.destroy_publisher(self._publisher)
