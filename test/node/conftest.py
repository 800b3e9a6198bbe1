"""
A replacer on a real graph, with everything around it in the same process.

Truth: the plant is one state x' = -x + u1, measured by y1 = x and y2 = 2 x; y3 measures something
else. So the virtual sensor of y1 obeys z(t) = u + (z(s) - u) exp(s - t) for a constant u, and
that of y2 is twice y1.
"""

from collections import Counter
from dataclasses import replace
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
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Float64, String

from vsensor_ros.node.accessor import get_stamp, message_type, put_stamp
from vsensor_ros.node.cdr import decode
from vsensor_ros.node.parameters import read
from vsensor_ros.node.polling import drain, Polled, subscribe
from vsensor_ros.node.replacer import Replacer
from vsensor_ros.observers import Design, Refusal, VirtualSensor

PERIOD = 10_000_000  # ns
START = 1_000_000_000_000  # ns
# A node without the services that nobody calls here: each costs as much as a topic to open.
FEW_SERVICES = {'start_parameter_services': False, 'enable_rosout': False}
NO_DESCRIPTIONS = {'start_type_description_service': False}  # the parameter


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


def make_virtual_sensor(channel, fault_set, healthy, N, J, B, Cv, Q, z0, start=0.0):
    k, l0 = len(z0), len(healthy)
    return VirtualSensor(
        channel, fault_set, healthy, ('u1',), np.ones((k, 1)), np.reshape(N, (k, k)),
        np.reshape(J, (k, l0)), np.reshape(B, (k, 1)), np.zeros((k, 0)), np.reshape(Cv, (1, k)),
        np.reshape(Q, (1, l0)), (), (), (), None, np.array(z0), np.zeros((k, l0)),
        np.array(N, dtype=complex), 1.0, 'by hand', start=None if start is None else
        start * np.eye(k))


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
    given = {'design_file': str(design_file), 'rate': 100.0, 'time_constant': 0.0,
             'recovery.dwell': 0.0}
    for name in ('y1', 'y2', 'y3'):
        given[f'sensors.{name}.topic'] = f'/{name}'
        given[f'sensors.{name}.type'] = 'sensor_msgs/msg/Range'
        given[f'sensors.{name}.field'] = 'range'
    given['commands.u1.topic'] = '/u1'
    given['commands.u1.type'] = 'std_msgs/msg/Float64'
    given['commands.u1.field'] = 'data'
    return given


@pytest.fixture(scope='session')
def joint_parameters(parameters):
    """Have y1 and y2 in one JointState, y3 alone."""
    given = dict(parameters)
    for name, joint in (('y1', 'shoulder'), ('y2', 'elbow')):
        given[f'sensors.{name}.topic'] = '/joint_states'
        given[f'sensors.{name}.type'] = 'sensor_msgs/msg/JointState'
        given[f'sensors.{name}.field'] = f'position[{joint}]'
    return given


class Rig:
    """A replacer under a clock that the test steps, its drivers and one listener a topic."""

    def __init__(self, parameters, sim_time=True, active=True, clock=True):
        self.context = Context()
        self.context.init()
        # a busy machine makes no driver silent, and no jump of the system's clock
        patient = {} if sim_time else {'max_age': 60.0, 'max_jump': 60.0}
        values = {'use_sim_time': sim_time, **patient, **NO_DESCRIPTIONS, **parameters}
        node = Node('replacer', context=self.context, **FEW_SERVICES,
                    parameter_overrides=[Parameter(k, value=v) for k, v in values.items()],
                    automatically_declare_parameters_from_overrides=True)
        self.node = Node('rig', context=self.context, **FEW_SERVICES, parameter_overrides=[
            Parameter(k, value=v) for k, v in NO_DESCRIPTIONS.items()])
        self.now = START
        self.publishers = {}
        self.listeners = []
        self.sent = {}
        self.taken = Counter()
        self.replacer = None
        self.restart(node)
        if sim_time:
            self.clock = self.publisher(Clock, '/clock', 2)  # rclpy hears it, too
        if sim_time and clock:
            self.clock.publish(Clock(clock=stamp_of(START)))
            assert self.spin_until(lambda: self.replacer.engine.now == START)
        if active:
            self.replacer.activate()

    def restart(self, node=None):
        """Start a replacer, on the node of the one before if there was one."""
        if self.replacer is not None:
            node = self.replacer.node
            self.replacer.close()
        self.replacer = Replacer(node, read(node))
        for topic, reader in self.replacer.readers.items():
            self.count(topic, reader)

    def close(self):
        self.node.destroy_node()
        self.replacer.close()
        self.replacer.node.destroy_node()
        self.context.try_shutdown()

    def count(self, topic, reader):
        """Count what is read from a topic."""
        read = reader.read

        def reading(raw):
            self.taken[topic] += 1
            return read(raw)
        reader.read = reading

    def publisher(self, kind, topic, subscribers=1):
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(kind, topic, 100)
            assert self.spin_until(
                lambda: self.publishers[topic].get_subscription_count() >= subscribers)
        return self.publishers[topic]

    def listen(self, kind_name, topic, reliability=ReliabilityPolicy.RELIABLE):
        """Return the list that the messages (raw) of a topic will go to."""
        subscription = subscribe(self.node, Polled(), message_type(kind_name), topic,
                                 QoSProfile(depth=1000, reliability=reliability),
                                 overridden=False)
        heard = []
        self.listeners.append((subscription, heard))
        assert self.spin_until(lambda: subscription.get_publisher_count() == 1)
        return heard

    def spin_until(self, condition, timeout=60.0):
        """Poll until a condition holds, at least once; tell whether it came to that."""
        end, pause = time.monotonic() + timeout, 0.0003
        while not condition():
            late = time.monotonic() > end
            self.replacer.poll()
            for subscription, heard in self.listeners:
                heard.extend(raw for raw, _ in drain(subscription))
            if condition():
                return True
            if late:
                return False
            time.sleep(pause)
            pause = min(1.2 * pause, 0.002)  # a look costs as much as a message
        return True

    def spin(self, seconds=0.02):
        self.spin_until(lambda: False, seconds)

    def step(self, *messages, periods=1, period=PERIOD):
        """Send (topic, message) pairs with the next stamp, and step the clock to it."""
        streams = {topic.subscription.topic_name for topic in self.replacer.topics}
        for _ in range(periods):
            self.now += period
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
            assert self.spin_until(lambda: self.replacer.engine.now == self.now)
        if self.listeners:  # what was sent is on its way, if the machine is not busy
            time.sleep(0.001)
            self.spin(0.0)

    def send(self, stamp, value=0.75, topic='/y2_raw'):
        """Send one reading with a stamp, and wait until it is read."""
        message = self.reading(value)
        put_stamp(message, stamp)
        before = self.taken[topic]
        self.publisher(Range, topic).publish(message)
        assert self.spin_until(lambda: self.taken[topic] > before)

    def isolate(self, *names):
        """Say that these sensors are faulty and all others healthy."""
        statuses = [DiagnosticStatus(name=name, level=b'\x02' if name in names else b'\x00')
                    for name in ('y1', 'y2', 'y3')]
        self.publisher(DiagnosticArray, '/isolation').publish(
            DiagnosticArray(status=statuses))
        assert self.spin_until(lambda: self.reported == set(names))

    def command(self, value):
        before = self.taken['/u1']
        self.publisher(Float64, '/u1').publish(Float64(data=value))
        assert self.spin_until(lambda: self.taken['/u1'] > before)

    def say(self, text):
        self.publisher(String, '/isolation').publish(String(data=text))

    @property
    def reported(self):
        """The sensors that isolation says are faulty, as the replacer understood it."""
        return {c.name for c in self.replacer.snapshot().channels if not np.isnan(c.isolated_s)}

    @property
    def counts(self):
        """How often what was not used or not sent on, by sensor and reason in words."""
        with self.replacer.lock:
            counts = self.replacer.engine._intake.counts()
        return Counter({(name, str(why)): n for (name, why), n in counts.items()})

    def why(self, name):
        """Return in words why a channel is what it is."""
        return self.told()[name].reason

    def told(self):
        """Return the state of each channel, its reasons in words."""
        self.spin(0.005)
        return {c.name: replace(c, reason=str(c.reason or ''), counts={
            str(why): count for why, count in c.counts.items()})
            for c in self.replacer.snapshot().channels}

    # what is sent and what was heard

    @staticmethod
    def reading(value, frame='tank'):
        message = Range(range=float(value), min_range=-1e6, max_range=1e6, variance=0.5)
        message.header.frame_id = frame
        return message

    @staticmethod
    def healthy(y1=0.5, y2=1.0, y3=0.0):
        """Return readings of all three sensors, that of y2 twice that of y1."""
        return [(f'/{name}_raw', Rig.reading(value, f'frame of {name}'))
                for name, value in (('y1', y1), ('y2', y2), ('y3', y3))]

    @staticmethod
    def arm(shoulder, elbow, wrist=0.0):
        message = JointState(name=['wrist', 'elbow', 'shoulder'],
                             position=[wrist, elbow, shoulder], effort=[wrist] * 3)
        message.header.frame_id = 'base'
        return ('/joint_states_raw', message)

    @staticmethod
    def raw(message):
        return serialize_message(message)

    @staticmethod
    def stamps(raws, kind=Range):
        return [get_stamp(decode(kind, raw)) for raw in raws]

    @staticmethod
    def values(raws):
        return [decode(Range, raw).range for raw in raws]


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

