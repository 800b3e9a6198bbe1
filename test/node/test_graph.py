import time

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64, String

from vsensor_ros.node.graph import complaints, End

RELIABLE = QoSProfile(depth=1)
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ENDS = (End('/y_raw', 'std_msgs/msg/Float64', False), End('/y', 'std_msgs/msg/Float64', True),
        End('/isolation', 'std_msgs/msg/String', False))


@pytest.fixture
def nodes():
    """Make nodes, each a participant of its own: within one, a topic has one type."""
    contexts, made = [], []

    def make(name):
        contexts.append(Context())
        contexts[-1].init()
        made.append(Node(name, context=contexts[-1]))
        return made[-1]
    yield make
    for node, context in zip(made, contexts):
        node.destroy_node()
        context.shutdown()


def say(node, count):
    """Return what is complained of once there are so many complaints, as lines."""
    end = time.monotonic() + 60.0
    while len(found := {str(c) for c in complaints(node, ENDS)}) < count:
        assert time.monotonic() < end, found
        time.sleep(0.01)
    return found


def ignore(message):
    """Take a message; Python 3.10 does not tell rclpy how `print` is called."""


def open_ours(node):
    node.create_subscription(Float64, '/y_raw', ignore, BEST_EFFORT)
    node.create_publisher(Float64, '/y', RELIABLE)
    node.create_subscription(String, '/isolation', ignore, RELIABLE)
    node.create_subscription(String, '/isolation', ignore, KEPT)  # the replacer has both
    return node


def test_those_that_fit_are_not_complained_of(nodes):
    node, other = open_ours(nodes('replacer')), nodes('other')
    for qos in (RELIABLE, BEST_EFFORT, KEPT):
        other.create_publisher(Float64, '/y_raw', qos)
    other.create_publisher(String, '/isolation', RELIABLE)
    other.create_publisher(String, '/isolation', KEPT)
    other.create_subscription(Float64, '/y', ignore, BEST_EFFORT)
    wrong = other.create_publisher(Float64, '/y', RELIABLE)
    say(node, 1)  # by now all is known
    other.destroy_publisher(wrong)
    end = time.monotonic() + 60.0
    while lines := [str(c) for c in complaints(node, ENDS)]:
        assert time.monotonic() < end, lines
        time.sleep(0.01)


def test_everything_that_cannot_work(nodes):
    node, other = open_ours(nodes('replacer')), nodes('other')
    other.create_publisher(Float64, '/y', RELIABLE)
    other.create_subscription(Float64, '/y', ignore, KEPT)
    other.create_publisher(String, '/y_raw', RELIABLE)
    other.create_publisher(String, '/isolation', BEST_EFFORT)
    open_ours(nodes('replacer'))  # a second one by mistake
    lines = sorted(say(node, 5))
    # the second replacer's publisher is seen on /y; each told once, with what to do about it
    assert [line.partition(': ')[0] for line in lines] == [
        '/isolation', '/y', '/y', '/y', '/y_raw']
    assert lines[0].startswith('/isolation: the QoS of /other does not match') and \
        'qos_overrides./isolation' in lines[0]
    assert lines[1].startswith('/y: /other publishes there too') and '/y_raw' in lines[1]
    assert lines[2].startswith('/y: another /replacer publishes there too')
    assert lines[3].startswith('/y: the QoS of /other does not match')
    assert lines[4] == ('/y_raw: /other uses the type std_msgs/msg/String, this node '
                        'std_msgs/msg/Float64; nothing passes between them, correct the type of '
                        'one')
