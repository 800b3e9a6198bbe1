"""
The peer of a tick: a timer of rclpy, spun by the SingleThreadedExecutor, that publishes.

It does nothing else and hears nothing, so it is as steady as such a timer can be.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.executors import ExternalShutdownException

from benchmark.load import Load, TIMER_TOPIC


def tick(load: Load, rate: float) -> None:
    """Publish one message a tick until told to stop."""
    rclpy.init()
    node = rclpy.create_node('timer')
    publisher = node.create_publisher(load.kind, TIMER_TOPIC, 10)
    message = load.message_of(1.0)
    node.create_timer(1.0 / rate, lambda: publisher.publish(message))
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    tick(Load.parse(sys.argv[2:]), float(sys.argv[1]))
