"""Several publishers on one input: they are told apart, named, and one may be chosen."""

from pathlib import Path
import sys

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Float64

from vsensor_ros.node import inlet, status

sys.path.append(str(Path(__file__).parent))
from managed_rig import KEPT, logged, machines, told


@pytest.fixture
def machine(parameters, monkeypatch):
    monkeypatch.setattr(status, 'LOOK', 0.1)
    yield from machines(parameters)


@pytest.fixture
def another():
    """Make more nodes beside those of a machine; each publishes at 50 Hz until it is stopped."""
    nodes = []

    def make(m, name, topic, message):
        node = Node(name, context=m.context)
        m.executor.add_node(node)
        publisher = node.create_publisher(type(message), topic, 10)

        def send():
            if hasattr(message, 'header'):
                message.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(message)
        node.create_timer(0.02, send)
        nodes.append((m, node))
        return node
    yield make
    for m, node in nodes:
        m.executor.remove_node(node)
        node.destroy_node()


def stop(m, node):
    for publisher in list(node.publishers):
        node.destroy_publisher(publisher)
    for timer in list(node.timers):
        node.destroy_timer(timer)


@pytest.fixture(name='logged')
def logged_(capfd):
    return logged(capfd)


def test_two_publishers_of_one_sensor_are_named(machine, another, logged, monkeypatch):
    monkeypatch.setattr(inlet, 'LATELY', 1.0)
    m = machine()
    m.drive()
    m.isolate('')
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    dummy = another(m, 'dummy', '/y2_raw', Range(range=0.0))
    line = ('/y2_raw: /dummy and /engineer both say what y2 is; stop one, or choose one with '
            'sensors.y2.publisher')
    assert m.spin_until(lambda: line in told(heard, 'y2')[1])
    assert told(heard, 'y2')[0] == DiagnosticStatus.WARN
    assert 'both say' not in told(heard, 'y1')[1] + told(heard, 'replacer')[1]
    assert m.spin_until(lambda: logged(line))
    stop(m, dummy)
    assert m.spin_until(lambda: 'both say' not in told(heard, 'y2')[1])


def test_only_who_was_chosen_is_heard(machine, another, logged):
    m = machine(sensors__y2__publisher='engineer', isolation__topic='/diagnostics',
                isolation__type='diagnostic_msgs/msg/DiagnosticArray')
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    out = m.listen(Range, '/y2', 1000)
    dummy = another(m, 'dummy', '/y2_raw', Range(range=0.0))
    line = '/y2_raw: /engineer was chosen with sensors.y2.publisher, but does not publish here'
    assert m.spin_until(lambda: line in told(heard, 'y2')[1])
    assert not out
    m.drive()  # y2 reads 3
    assert m.spin_until(lambda: len(out) >= 50)
    assert m.spin_until(lambda: line not in told(heard, 'y2')[1])
    assert {message.range for message in out} == {3.0}
    assert told(heard, 'y2')[2].get('source') == 'real' and 'both say' not in told(heard, 'y2')[1]
    assert int(told(heard, 'y2')[2]['not_used']) > 10
    assert not logged('from another publisher')
    stop(m, dummy)
    count = len(out)
    assert m.spin_until(lambda: len(out) >= count + 10)


def test_where_nobody_can_tell_publishers_apart_a_choice_is_told_to_be_void(machine, monkeypatch):
    monkeypatch.setattr(inlet, 'identifying_taker', lambda subscription: None)
    m = machine(sensors__y2__publisher='/somebody')
    m.drive()
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    line = '/y2_raw: this release of rcl does not tell who sent a message, so ' \
        'sensors.y2.publisher has no effect'
    assert m.spin_until(lambda: line in told(heard, 'y2')[1])
    assert told(heard, 'y2')[2].get('source') == 'real'


def test_two_who_command(machine, another):
    m = machine()
    m.drive()  # commands 1.5
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    another(m, 'teleop', '/u1', Float64(data=0.0))
    line = '/u1: /engineer and /teleop both say what u1 is; stop one, or choose one with ' \
        'commands.u1.publisher'
    assert m.spin_until(lambda: line in told(heard, 'replacer')[1])
    assert told(heard, 'replacer')[0] == DiagnosticStatus.WARN


def test_a_command_of_the_chosen_one_counts(machine, another):
    m = machine(commands__u1__publisher='/engineer')
    another(m, 'teleop', '/u1', Float64(data=-1000.0))
    m.drive()
    m.isolate('y1')
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    assert m.spin_until(lambda: told(heard, 'y1')[2].get('source') == 'virtual')
    # x' = -x + u1 forgets its start, x = 0.25, in favour of x = u1
    assert m.spin_until(lambda: abs(float(told(heard, 'y1')[2]['value']) - 1.5) < 0.1)


def test_drivers_that_share_a_topic_but_no_joint_are_right(machine, another):
    joints = {f'sensors__{name}__{key}': value for name, joint in (('y1', 'a'), ('y2', 'b'))
              for key, value in (('topic', '/joint_states'),
                                 ('type', 'sensor_msgs/msg/JointState'),
                                 ('field', f'position[{joint}]'))}
    m = machine(**joints)
    assert m.spin_until(m.node.active.is_set)
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    another(m, 'left', '/joint_states_raw', JointState(name=['a'], position=[1.5]))
    another(m, 'right', '/joint_states_raw', JointState(name=['b'], position=[3.0]))
    assert m.spin_until(lambda: any(all(i._spans[name] for name in ('y1', 'y2'))
                                    for i in m.node.replacer.inlets if 'y1' in i._spans))
    another(m, 'third', '/joint_states_raw', JointState(name=['b', 'c'], position=[0.0, 0.0]))
    assert m.spin_until(lambda: '/right and /third both say what y2 is' in told(heard, 'y2')[1])
    assert 'both say' not in told(heard, 'y1')[1]


def test_a_driver_that_is_started_again_has_no_rival(rig, parameters):
    r = rig(parameters)
    way = next(i for i in r.replacer.inlets if i.topic == '/y2_raw')
    way.watch(True)
    for name in ('first', 'first', 'second'):
        node = Node(name, context=r.context)
        publisher = node.create_publisher(Range, '/y2_raw', 10)
        assert r.spin_until(lambda p=publisher: p.get_subscription_count() == 1)
        for _ in range(3):
            before = r.taken['/y2_raw']
            publisher.publish(Range(range=1.0))
            assert r.spin_until(lambda before=before: r.taken['/y2_raw'] > before)
            way._next.clear()  # look at every message
        node.destroy_node()
    assert len(way._spans['y2']) == 3 and not list(way.complaints(()))


def test_the_plain_way_is_taken_again_once_there_is_one_publisher(rig, parameters):
    r = rig(parameters)
    way = next(i for i in r.replacer.inlets if i.topic == '/y2_raw')
    heard = r.listen('sensor_msgs/msg/Range', '/y2')
    for several in (True, False, True):
        way.watch(several)
        assert (way.take == way._take) == several
        r.step(*r.healthy(y2=1.25), periods=3)
    assert r.values(heard) == [1.25] * 9


def test_a_message_that_cannot_be_read_is_nobodys(rig, parameters):
    r = rig(parameters)
    way = next(i for i in r.replacer.inlets if i.topic == '/y2_raw')
    way.watch(True)
    publisher = r.publisher(Range, '/y2_raw')
    for raw in (b'garbage', bytes(3), b'\0\1\0\0' + bytes(10_000)):
        publisher.publish(raw)
    r.step(*r.healthy(), periods=2)
    assert r.counts['y2', 'bytes that are not a message of the type'] == 2
