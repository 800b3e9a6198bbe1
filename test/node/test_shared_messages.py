"""Several channels in one message, and several drivers on one topic."""

import math

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Int32MultiArray

from vsensor_ros.node.accessor import put_stamp
from vsensor_ros.node.cdr import decode

RANGE = 'sensor_msgs/msg/Range'
PERIOD = 10_000_000  # ns, of the bank and of the sensors


def test_two_sensors_in_one_message(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    for i in range(5):
        r.step(r.arm(0.5, 1.0, i), r.healthy()[2])
    r.isolate('y2')
    for i in range(5, 15):
        r.step(r.arm(0.75, 99.0, i), r.healthy()[2])
    assert r.spin_until(lambda: len(heard) == 16)
    for i, raw in enumerate(heard[6:], 5):
        m = decode(JointState, raw)
        assert list(m.position) == [i, 1.5, 0.75] and list(m.effort) == [i] * 3
        assert m.name == ['wrist', 'elbow', 'shoulder'] and m.header.frame_id == 'base'
    assert np.all(np.diff(r.stamps(heard, JointState)) > 0)


def test_a_silent_healthy_channel_is_not_sent_as_if_live(rig, joint_parameters):
    r = rig({**joint_parameters, 'without_estimate': 'hold'})
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.command(0.0)
    r.step(r.arm(0.5, 1.0), r.healthy()[2], periods=5)
    r.isolate('y1')
    r.step(r.healthy()[2], periods=60)
    first, last = decode(JointState, heard[6]), decode(JointState, heard[-1])
    assert first.position[1] == 1.0 and math.isnan(last.position[1])
    assert 0.0 < last.position[2] < first.position[2]  # the estimate goes on


def test_messages_of_other_joints_and_short_arrays(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(r.arm(0.5, 1.0), r.healthy()[2], periods=5)
    r.isolate('y2')
    before = len(heard)
    other = JointState(name=['finger'], position=[0.125])
    put_stamp(other, r.now - PERIOD)  # it need not wait for the estimates
    hand = serialize_message(other)
    short = JointState(name=['elbow', 'shoulder'], position=[99.0])
    publisher = r.publisher(JointState, '/joint_states_raw')
    publisher.publish(hand)
    publisher.publish(short)
    r.spin()
    assert [bytes(raw) for raw in heard[before:]] == [hand]
    assert any('too short' in reason for _, reason in r.counts)
    r.step(r.arm(0.75, 99.0), r.healthy()[2], periods=2)
    assert decode(JointState, heard[-1]).position[1] == 1.5


def test_numbers_without_names_are_not_those_of_other_joints(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(r.arm(0.5, 1.0), r.healthy()[2], periods=5)
    r.isolate('y2')
    before = len(heard)
    for name in ([], ['finger']):  # there is more than one number
        r.step(('/joint_states_raw', JointState(name=name, position=[0.0, 99.0, 0.5])),
               r.healthy()[2])
    assert len(heard) > before
    for raw in heard[before:]:
        m = decode(JointState, raw)
        assert m.name == ['wrist', 'elbow', 'shoulder'] and 99.0 not in m.position


def test_nothing_measured_is_repeated_for_a_driver_that_is_silent(rig, joint_parameters):
    """The wrist is no sensor: its number is known to be measured because it has changed."""
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.command(0.0)
    for i in range(5):
        topic, message = r.arm(0.5, 1.0, float(i))
        message.velocity = [0.0, 7.0, float(i)]
        r.step((topic, message), r.healthy()[2])
    r.isolate('y1')
    r.step(r.healthy()[2], periods=40)  # not yet max_age
    assert decode(JointState, heard[-1]).position[0] == 4.0
    assert 'silent' not in r.told()['y1'].reason
    r.step(r.healthy()[2], periods=20)
    last = decode(JointState, heard[-1])
    assert math.isnan(last.position[0]) and all(map(math.isnan, last.effort))
    assert list(last.velocity[:2]) == [0.0, 7.0] and math.isnan(last.velocity[2])
    assert 0.0 < last.position[2] < 0.5 and last.header.frame_id == 'base'  # the estimate
    told = r.told()['y1']
    assert told.source == 'virtual'
    assert told.reason.endswith('; its driver has been silent for 0.6 s')
    r.step(r.arm(0.5, 1.0, 9.0), r.healthy()[2], periods=2)
    last = decode(JointState, heard[-1])
    assert last.position[0] == 9.0 and list(last.effort) == [9.0] * 3
    assert 'silent' not in r.told()['y1'].reason


def empty_effort(i):
    return ['wrist', 'elbow', 'shoulder'], [i, 99.0, 0.75], []


def no_name(i):
    return ['wrist', 'shoulder'], [i, 0.75], [i, i]


def short_effort(i):
    return ['wrist', 'shoulder', 'elbow'], [i, 0.75, 99.0], [i]


@pytest.mark.parametrize('failing', [empty_effort, no_name, short_effort])
def test_what_is_healthy_stays_live_when_the_failed_element_is_gone(
        rig, joint_parameters, failing):
    r = rig({**joint_parameters, 'sensors.y2.field': 'effort[elbow]'})
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    for i in range(5):
        r.step(r.arm(0.5, 0.0, i), r.healthy()[2])
    r.isolate('y2')
    before = len(heard)
    for i in range(5, 80):  # longer than max_age
        name, position, effort = failing(float(i))
        r.step(('/joint_states_raw', JointState(name=name, position=position, effort=effort)),
               r.healthy()[2])
    assert r.spin_until(lambda: len(heard) == before + 75)
    for i, raw in enumerate(heard[-74:], 6):
        m = decode(JointState, raw)
        position, effort = dict(zip(m.name, m.position)), dict(zip(m.name, m.effort))
        assert position['shoulder'] == 0.75 and effort['elbow'] == 1.5
        assert position['wrist'] == i
    assert np.all(np.diff(r.stamps(heard, JointState)) > 0)


def test_a_joint_that_disappears_from_its_own_drivers_messages(rig, joint_parameters):
    given = {**joint_parameters,
        'sensors.y1.topic': '/y1', 'sensors.y1.type': RANGE, 'sensors.y1.field': 'range'}
    r = rig(given)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(r.arm(0.5, 1.0), r.healthy()[0], r.healthy()[2], periods=5)
    r.isolate('y2')
    before = len(heard)
    for i in range(80):
        rest = JointState(name=['wrist'], position=[float(i)])
        r.step(('/joint_states_raw', rest), r.healthy(y1=0.75)[0], r.healthy()[2])
    assert r.spin_until(lambda: len(heard) == before + 80)  # none of them raw
    last = decode(JointState, heard[-1])
    assert last.name == ['wrist', 'elbow'] and list(last.position) == [79.0, 1.5]


def test_the_template_is_the_message_with_the_channels(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    for _ in range(5):
        r.step(r.arm(0.5, 1.0, 0.25), r.healthy()[2])
        r.step(('/joint_states_raw', JointState(name=['shoulder'], position=[0.75])))
    r.isolate('y2')
    r.step(r.healthy()[2], periods=2)
    last = decode(JointState, heard[-1])
    assert last.name == ['wrist', 'elbow', 'shoulder'] and list(last.effort) == [0.25] * 3
    assert list(last.position) == [0.25, 1.5, 0.75]  # of both


def test_the_rest_of_the_message_stays_live_when_a_healthy_joint_disappears(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.command(1.0)
    r.step(r.arm(0.5, 1.0), r.healthy()[2], periods=5)
    r.isolate('y1')
    for i in range(70):
        rest = JointState(name=['wrist', 'shoulder'], position=[float(i), 99.0])
        r.step(('/joint_states_raw', rest), r.healthy()[2])
    assert r.spin_until(lambda: decode(JointState, heard[-1]).position[0] == 69.0)
    last = decode(JointState, heard[-1])
    assert last.name == ['wrist', 'shoulder'] and 0.0 < last.position[1] < 1.0


def test_room_that_cannot_be_made_is_said_of_every_channel(rig, parameters):
    given = dict(parameters)
    for i, name in enumerate(('y1', 'y2')):
        given.update({f'sensors.{name}.topic': '/both', f'sensors.{name}.field': f'data[{i}]',
                      f'sensors.{name}.type': 'std_msgs/msg/Int32MultiArray'})
    r = rig(given)
    heard = r.listen('std_msgs/msg/Int32MultiArray', '/both')
    r.step(('/both_raw', Int32MultiArray(data=[1, 2])), r.healthy()[2], periods=5)
    r.isolate('y2')
    before = len(heard)
    r.step(('/both_raw', Int32MultiArray(data=[1])), r.healthy()[2], periods=60)
    said = r.told()
    assert said['y2'].source == 'none' and 'too short for data[1]' in said['y2'].reason
    assert said['y1'].source == 'none' and 'too short for data[1]' in said['y1'].reason
    assert len(heard) - before <= 1
    r.isolate()
    r.step(('/both_raw', Int32MultiArray(data=[1, 2])), periods=2)
    r.spin()
    assert r.told()['y1'].source == 'real'


def test_each_channel_has_its_own_silence(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(r.arm(0.5, 1.0), *r.healthy()[2:], periods=5)
    rest = ('/joint_states_raw', JointState(name=['wrist', 'elbow'], position=[0.0, 1.0]))
    r.step(rest, periods=60)
    said = r.told()
    assert said['y1'].source == 'silent' and said['y1'].reason.startswith(
        'messages arrive on /joint_states_raw, but position[shoulder] is not in the message')
    assert said['y2'].source == 'real'
    assert said['y3'].reason.startswith('nothing comes on /y3_raw')
    r.command(1.0)
    r.isolate('y1', 'y2')  # nothing is known of y2 in that set
    r.step(('/joint_states_raw', JointState(name=['wrist'], position=[0.0])), *r.healthy()[2:],
           periods=5)
    last = decode(JointState, heard[-1])
    position = dict(zip(last.name, last.position))
    assert math.isnan(position['elbow']) and math.isfinite(position['shoulder'])


def test_messages_of_which_nothing_can_be_read_are_silence(rig, joint_parameters):
    r = rig(joint_parameters)
    r.step(r.arm(0.5, 1.0), periods=5)
    r.step(('/joint_states_raw', JointState(name=['elbow', 'shoulder'])), periods=60)
    r.publisher(Range, '/y3_raw').publish(b'garbage')
    r.spin()
    said = r.told()
    assert [said[name].source for name in ('y1', 'y2', 'y3')] == ['silent'] * 3
    assert 'messages arrive on /joint_states_raw, but the array is too short' in \
        said['y1'].reason
    assert 'messages arrive on /y3_raw, but bytes' in said['y3'].reason
    assert said['y2'].counts['the array is too short for position[elbow]'] == 60


def test_stop_of_one_channel_leaves_the_others_of_its_message(rig, joint_parameters):
    given = dict(joint_parameters)
    for key, value in (('topic', '/joint_states'), ('type', 'sensor_msgs/msg/JointState'),
                       ('field', 'position[wrist]')):
        given[f'sensors.y3.{key}'] = value
    r = rig(given)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(r.arm(0.5, 1.0), periods=5)
    r.isolate('y3')  # refused
    r.step(r.arm(0.75, 1.5, 99.0), periods=5)
    assert r.spin_until(lambda: len(heard) == 11)
    last = decode(JointState, heard[-1])
    assert math.isnan(last.position[0]) and list(last.position[1:]) == [1.5, 0.75]
    r.spin()
    said = r.told()
    assert said['y3'].source == 'none' and 'NaN goes out' in said['y3'].reason
    assert said['y1'].source == said['y2'].source == 'real'
    r.command(1.0)
    r.isolate('y1', 'y2')  # y1 is virtual, y2 refused
    r.step(r.arm(99.0, 99.0, 0.0), periods=5)
    last = decode(JointState, heard[-1])
    assert last.position[0] == 0.0 and math.isnan(last.position[1])
    assert 0.0 < last.position[2] < 1.0
    r.isolate('y1', 'y2', 'y3')  # no design: all stop
    before = len(heard)
    r.step(r.arm(99.0, 99.0, 99.0), periods=5)
    r.spin()
    assert len(heard) == before
    assert all('nothing goes out' in s.reason for s in r.told().values())


def test_what_passes_is_live_beside_what_is_virtual(rig, joint_parameters):
    r = rig({**joint_parameters, 'without_estimate': 'pass'})
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.command(1.0)
    r.step(r.arm(0.5, 1.0), r.healthy()[2], periods=5)
    r.isolate('y1', 'y2')
    for i in range(5):
        r.step(r.arm(99.0, 50.0 + i), r.healthy()[2])
    last = decode(JointState, heard[-1])
    assert last.position[1] == 54.0 and 0.0 < last.position[2] < 1.0


def test_several_drivers_on_one_topic(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    publisher = r.publisher(JointState, '/joint_states_raw')

    def step(shoulder, elbow, wrist):
        r.step(('/joint_states_raw', JointState(name=['wrist', 'shoulder'],
                                                position=[wrist, shoulder])), r.healthy()[2])
        other = JointState(name=['elbow', 'finger'], position=[elbow, wrist])
        put_stamp(other, r.now)  # that the other has the same is its own business
        raw = serialize_message(other)
        before = r.taken['/joint_states_raw']
        publisher.publish(raw)
        assert r.spin_until(lambda: r.taken['/joint_states_raw'] > before)
        return raw
    r.command(1.0)
    for i in range(5):
        step(0.5, 1.0, i)
    r.isolate('y1')
    r.spin()
    before = len(heard)
    sent = [step(99.0, 1.0 + i, i) for i in range(5)]
    assert r.spin_until(lambda: len(heard) == before + 10)
    after = [decode(JointState, raw) for raw in heard[before:]]
    composed = [m for m in after if 'shoulder' in m.name]
    assert [m.name for m in composed] == [['wrist', 'shoulder']] * 5
    assert all(0.0 < m.position[1] < 1.0 for m in composed)
    assert [m.position[0] for m in composed] == [0, 1, 2, 3, 4]
    assert [bytes(raw) for raw in heard[before:] if b'finger' in bytes(raw)] == sent
    assert sum(r.counts.values()) == 1  # before the other was heard


def test_joints_that_change_their_order(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(r.arm(0.5, 1.0), r.healthy()[2], periods=5)
    r.isolate('y2')
    for i in range(6):
        name, position = ['elbow', 'wrist', 'shoulder'], [99.0, float(i), 0.75]
        turned = i % 3
        r.step(('/joint_states_raw', JointState(
            name=name[turned:] + name[:turned], position=position[turned:] + position[:turned])),
            r.healthy()[2])
        last = decode(JointState, heard[-1])
        assert last.name == name[turned:] + name[:turned]
        assert dict(zip(last.name, last.position)) == {'elbow': 1.5, 'wrist': i, 'shoulder': 0.75}


def test_numbers_without_names_may_be_those_of_the_failed(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(r.healthy()[2], periods=3)
    r.isolate('y1')  # before its driver was ever heard
    r.step(('/joint_states_raw', JointState(position=[100.0, 200.0])), r.healthy()[2], periods=3)
    assert not heard
    r.step(('/joint_states_raw', JointState(name=['gripper'], position=[0.1])))
    assert r.spin_until(lambda: len(heard) == 1)  # of others: what has names is known to be

