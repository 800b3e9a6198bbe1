"""
A replacer on a real graph, with everything around it in the same process.

Truth: the plant is one state x' = -x + u1, measured by y1 = x and y2 = 2 x; y3 measures something
else. So the virtual sensor of y1 obeys z(t) = u + (z(s) - u) exp(s - t) for a constant u, and
that of y2 is twice y1.
"""

from collections import Counter
import os
from pathlib import Path
import socket
import sys
import time

# before any message class is loaded
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(
    Path(__file__).parents[2] / 'config' / 'fastdds_localhost.xml'))

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
import pytest
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64, String

from vsensor_ros.node.accessor import message_type, put_stamp
from vsensor_ros.node.replacer import make_node, Replacer
from vsensor_ros.virtual_sensor import Design, Refusal, VirtualSensor

PERIOD = 10_000_000  # ns
START = 1_000_000_000_000  # ns


@pytest.fixture(scope='session', autouse=True)
def domain():
    """Reserve a ROS domain for this process by holding a TCP port."""
    for number in range(1, 101):
        holder = socket.socket()
        try:
            holder.bind(('127.0.0.1', 27400 + number))
        except OSError:
            holder.close()
            continue
        os.environ['ROS_DOMAIN_ID'] = str(number)
        yield number
        holder.close()
        return
    raise RuntimeError('no free ROS domain')


def make_virtual_sensor(channel, fault_set, healthy, N, J, B, Cv, Q, z0):
    k, l0 = len(z0), len(healthy)
    return VirtualSensor(
        channel, fault_set, healthy, ('u1',), np.ones((k, 1)), np.reshape(N, (k, k)),
        np.reshape(J, (k, l0)), np.reshape(B, (k, 1)), np.zeros((k, 0)), np.reshape(Cv, (1, k)),
        np.reshape(Q, (1, l0)), (), (), (), None, np.array(z0), np.zeros((k, l0)),
        np.array(N, dtype=complex), 1.0, 'by hand')


@pytest.fixture(scope='session')
def plan():
    """Design by hand; y3 is refused, the set {y1, y2} replaces y1 only, {y1, y3} is not there."""
    y1, y2, y3, both = ('y1',), ('y2',), ('y3',), ('y1', 'y2')
    return Design('one_state', '0' * 64, ('x',), ('u1',), ('y1', 'y2', 'y3'), {}, None, {
        (y1, 'y1'): make_virtual_sensor(
            'y1', y1, ('y2', 'y3'), [-1.0], [0.0, 0.0], [1.0], [1.0], [0.0, 0.0], [0.25]),
        (y2, 'y2'): make_virtual_sensor(
            'y2', y2, ('y1', 'y3'), [], [], [], [], [2.0, 0.0], []),
        (y3, 'y3'): Refusal('y3', y3, 'y3 does not depend on anything else'),
        (both, 'y1'): make_virtual_sensor(
            'y1', both, ('y3',), [-1.0], [0.0], [1.0], [1.0], [0.0], [0.25]),
        (both, 'y2'): Refusal('y2', both, 'nothing is left to read'),
    })


@pytest.fixture(scope='session')
def design_file(plan, tmp_path_factory):
    path = tmp_path_factory.mktemp('design') / 'one_state.json'
    plan.save(path)
    return path


@pytest.fixture(scope='session')
def parameters(design_file):
    """Parameters by their full names, three sensors on topics of their own."""
    given = {'design_file': str(design_file), 'rate': 100.0}
    for name in ('y1', 'y2', 'y3'):
        given[f'sensors.{name}.topic'] = f'/{name}'
        given[f'sensors.{name}.type'] = 'sensor_msgs/msg/Range'
        given[f'sensors.{name}.field'] = 'range'
    given['commands.u1.topic'] = '/u1'
    given['commands.u1.type'] = 'std_msgs/msg/Float64'
    given['commands.u1.field'] = 'data'
    return given


class Rig:
    """A replacer under a clock that the test steps, its drivers and one listener a topic."""

    def __init__(self, parameters, sim_time=True):
        self.context = Context()
        self.context.init()
        values = {'use_sim_time': sim_time, **parameters}
        self.replacer = Replacer(make_node(
            self.context, [Parameter(name, value=value) for name, value in values.items()]))
        self.node = Node('rig', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.replacer.node)
        self.executor.add_node(self.node)
        self.now = START
        self.publishers = {}
        self.sent = {}
        self.taken = Counter()
        for stream in self.replacer.streams:
            stream.read = self.counted(stream.subscription.topic_name, stream.read)
        if sim_time:
            self.clock = self.publisher(Clock, '/clock')
            self.clock.publish(Clock(clock=stamp_of(START)))
            assert self.spin_until(lambda: self.replacer.now == START)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.replacer.node.destroy_node()
        self.context.try_shutdown()

    def counted(self, topic, read):
        def reading(raw, received):
            self.taken[topic] += 1
            return read(raw, received)
        return reading

    def publisher(self, kind, topic, subscribers=1):
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(kind, topic, 100)
            assert self.spin_until(
                lambda: self.publishers[topic].get_subscription_count() >= subscribers)
        return self.publishers[topic]

    def listen(self, kind_name, topic):
        """Return the list that the messages (raw) of a topic will go to."""
        kind = message_type(kind_name)
        heard = []
        subscription = self.node.create_subscription(kind, topic, heard.append, 1000, raw=True)
        assert self.spin_until(lambda: subscription.get_publisher_count() == 1)
        return heard

    def spin_until(self, condition, timeout=10.0):
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self.replacer.poll()
            self.executor.spin_once(timeout_sec=0.001)
        return True

    def spin(self, seconds=0.05):
        self.spin_until(lambda: False, seconds)

    def step(self, *messages, periods=1):
        """Send (topic, message) pairs with the next stamp, and step the clock to it."""
        streams = {s.subscription.topic_name for s in self.replacer.streams}
        for _ in range(periods):
            self.now += PERIOD
            before = self.taken.copy()
            expected = Counter()
            for topic, message in messages:
                if hasattr(message, 'header'):
                    put_stamp(message, self.now)
                publisher = self.publisher(type(message), topic)
                if topic in streams:
                    expected[topic] += 1
                raw = serialize_message(message)
                self.sent.setdefault(topic, []).append(raw)
                publisher.publish(raw)  # padding has any content: bytes compare only with bytes
            assert self.spin_until(lambda due=before + expected: self.taken >= due)
            self.clock.publish(Clock(clock=stamp_of(self.now)))
            assert self.spin_until(lambda: self.replacer.now == self.now)
        self.spin(0.005)

    def isolate(self, *names):
        """Say that these sensors are faulty and all others healthy."""
        statuses = [DiagnosticStatus(name=name, level=b'\x02' if name in names else b'\x00')
                    for name in ('y1', 'y2', 'y3')]
        self.publisher(DiagnosticArray, '/isolation').publish(DiagnosticArray(status=statuses))
        assert self.spin_until(lambda: self.replacer.switch.faulty == set(names))

    def command(self, value):
        before = self.replacer.bank._samples['u1'].stamps[-1:]
        self.publisher(Float64, '/u1').publish(Float64(data=value))
        assert self.spin_until(
            lambda: self.replacer.bank._samples['u1'].stamps[-1:] != before)

    def say(self, text):
        self.publisher(String, '/isolation').publish(String(data=text))


def stamp_of(nanoseconds):
    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(nanoseconds, 10**9)
    return message.clock


@pytest.fixture
def rig():
    """Start replacers; all end with the test."""
    rigs = []

    def start(parameters, **options):
        rigs.append(Rig(parameters, **options))
        return rigs[-1]
    yield start
    for started in rigs:
        started.close()

