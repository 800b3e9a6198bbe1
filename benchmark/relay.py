"""
The peer: what anybody would write with rclpy to pass messages on.

One typed subscription and one publisher a topic, spun by the SingleThreadedExecutor.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.executors import ExternalShutdownException

from benchmark.load import Load


def relay(load: Load) -> None:
    """Pass on until told to stop."""
    rclpy.init()
    node = rclpy.create_node('relay')
    for topic in load.outputs:
        publisher = node.create_publisher(load.kind, topic, 10)
        node.create_subscription(load.kind, f'{topic}_raw', publisher.publish, 10)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    relay(Load.parse(sys.argv[1:]))
