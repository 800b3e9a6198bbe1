"""A publisher of a node that only listens there."""

from __future__ import annotations

from typing import Any

from rclpy.qos import QoSProfile


class Mute:
    """Stands in for a publisher: takes all, and sends nothing."""

    def __init__(self, topic: str, qos: QoSProfile) -> None:
        self.topic_name, self.qos_profile = topic, qos  # as it would have been opened
        self.handle = self

    def publish(self, message: Any) -> None:
        """Send nothing."""

    def publish_raw(self, raw: bytes) -> None:
        """Send nothing."""

    def get_subscription_count(self) -> int:
        """Nobody hears it."""
        return 0
