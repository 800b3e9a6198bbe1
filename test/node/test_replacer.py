import math
import time

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState, Range, Temperature
from std_msgs.msg import Float64, String

from vsensor_ros.node.accessor import get_stamp, put_stamp
from vsensor_ros.node.graph import complaints

RANGE = 'sensor_msgs/msg/Range'
PERIOD = 10_000_000  # ns, of the bank and of the sensors


def decode(kind, raw):
    return deserialize_message(bytes(raw), kind)


def reading(value, frame='tank'):
    message = Range(range=float(value), min_range=0.1, max_range=9.0, variance=0.5)
    message.header.frame_id = frame
    return message


def healthy(y1=0.5, y2=1.0, y3=0.0):
    return [(f'/{name}_raw', reading(value, f'frame of {name}'))
            for name, value in (('y1', y1), ('y2', y2), ('y3', y3))]


def stamps(raws, kind=Range):
    return [get_stamp(decode(kind, raw)) for raw in raws]


def values(raws):
    return [decode(Range, raw).range for raw in raws]


def test_healthy_messages_go_on_byte_for_byte(rig, parameters):
    r = rig(parameters)
    heard = [r.listen(RANGE, f'/y{i}') for i in (1, 2, 3)]
    for i in range(20):
        r.step(*healthy(y1=i, y2=math.nan if i == 7 else -i, y3=math.inf if i == 8 else 0))
    assert r.spin_until(lambda: all(len(h) == 20 for h in heard))
    for i, h in enumerate(heard, 1):
        assert [bytes(raw) for raw in h] == r.sent[f'/y{i}_raw']


def test_a_frozen_sensor_is_replaced_at_the_rate_and_comes_back(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y1')
    for _ in range(2):
        r.command(2.0)
        r.step(*healthy())
    r.step(*healthy(), periods=8)
    assert len(heard) == 10
    r.isolate('y1')
    r.step(*healthy(y1=7.7), periods=30)  # it goes on sending what is wrong
    assert r.spin_until(lambda: len(heard) == 40)
    virtual = [decode(Range, raw) for raw in heard[10:]]
    at = np.array([get_stamp(m) for m in virtual])
    assert np.all(np.diff(at) == PERIOD) and at[0] > get_stamp(decode(Range, heard[9]))
    # the truth between any two of them, with the command at 2; float32 on the wire
    z = np.array([m.range for m in virtual])
    truth = 2.0 + (z[0] - 2.0) * np.exp(-(at - at[0]) * 1e-9)
    np.testing.assert_allclose(z, truth, atol=1e-6)
    for m in virtual:
        assert (m.header.frame_id, m.min_range, m.max_range) == (
            'frame of y1', np.float32(0.1), 9.0)
    r.isolate()
    r.step(*healthy(y1=1.25))
    assert r.spin_until(lambda: len(heard) == 41)
    assert bytes(heard[40]) == r.sent['/y1_raw'][-1]
    assert np.all(np.diff(stamps(heard)) > 0)


def test_a_sensor_that_drops_out_is_replaced(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(y1=0.5, y2=1.0), periods=5)
    r.isolate('y2')
    rest = healthy(y1=0.75)
    r.step(rest[0], rest[2], periods=100)  # far longer than max_age
    assert r.spin_until(lambda: len(heard) == 105)
    assert values(heard[-90:]) == [1.5] * 90
    assert np.all(np.diff(stamps(heard)) > 0)
    assert decode(Range, heard[-1]).header.frame_id == 'frame of y2'


def test_an_estimate_without_its_reading_is_not_sent(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(), periods=5)
    r.isolate('y2')
    r.step(healthy()[2], periods=60)  # y1 says nothing for longer than max_age
    assert 50 <= len(heard) - 5 <= 52
    said = r.replacer.why['y2']
    assert 'y1 silent' in said


def test_messages_from_before_the_last_estimate_are_left_out(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(), periods=5)
    r.isolate('y2')
    r.step(*healthy(), periods=5)
    r.isolate()
    late = reading(9.0)
    late.header.stamp = decode(Range, heard[-2]).header.stamp
    r.publisher(Range, '/y2_raw').publish(late)
    r.spin()
    r.step(*healthy(), periods=2)
    assert r.spin_until(lambda: len(heard) == 12)
    assert 9.0 not in values(heard)
    assert np.all(np.diff(stamps(heard)) > 0)


@pytest.mark.parametrize('action', ['stop', 'hold', 'nan', 'pass'])
@pytest.mark.parametrize('faulty', [('y3',), ('y1', 'y3')])  # a refusal; a set without a design
def test_what_cannot_be_replaced(rig, parameters, action, faulty):
    r = rig({**parameters, 'without_estimate': action})
    heard = r.listen(RANGE, '/y3')
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(*healthy(y3=4.0), periods=5)
    r.isolate(*faulty)
    r.step(*healthy(y3=99.0), periods=10)
    r.spin()
    after = heard[5:]
    if action == 'stop':
        assert not after
    elif action == 'hold':
        assert values(after) == [4.0] * 10
    elif action == 'nan':
        assert len(after) == 10 and all(math.isnan(v) for v in values(after))
    else:
        assert values(after) == [99.0] * 10
        assert [bytes(raw) for raw in after] == r.sent['/y3_raw'][5:]
    assert np.all(np.diff(stamps(heard)) > 0)
    last = {s.name: s for s in decode(DiagnosticArray, status[-1]).status}
    assert last['replacer: y3'].level == b'\x02'
    reason = 'does not depend' if faulty == ('y3',) else 'y1, y3'
    assert reason in last['replacer: y3'].message and 'repair y3' in last['replacer: y3'].message
    assert last['replacer: y2'].level == b'\x00'


def test_the_exact_set_is_looked_up(rig, parameters):
    r = rig(parameters)
    y1, y2 = r.listen(RANGE, '/y1'), r.listen(RANGE, '/y2')
    r.command(2.0)
    r.step(*healthy(), periods=5)
    r.isolate('y1', 'y2')
    r.step(*healthy(y1=99.0, y2=99.0), periods=5)
    assert r.spin_until(lambda: len(y1) == 10)
    assert len(y2) == 5 and 99.0 not in values(y1)
    r.isolate('y2')  # y1 is back, y2 is now replaced from it
    r.step(*healthy(y1=0.5, y2=99.0), periods=60)
    assert values(y2)[-1] == 1.0 and 99.0 not in values(y2)


def test_bad_readings_are_counted_and_stop_nothing(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(), periods=3)
    for value in (math.nan, math.inf, -math.inf):
        r.step(*healthy(y1=value))
    backwards = reading(0.5)
    backwards.header.stamp.sec = r.now // 10**9 - 5
    r.publisher(Range, '/y1_raw').publish(backwards)
    r.spin()
    counts = r.replacer.counts
    assert counts['y1', 'not finite'] == 3
    assert counts['y1', 'stamp runs backwards'] == 1
    r.isolate('y2')
    r.step(*healthy(y1=0.75), periods=3)
    assert values(heard)[-1] == 1.5


def test_bytes_that_are_no_message(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y1')
    r.step(*healthy(), periods=3)
    topics = {'/y1_raw': Range, '/u1': Float64, '/isolation': DiagnosticArray}
    for topic, kind in topics.items():
        for raw in (b'', b'garbage', b'\x00\x01\x00\x00' + b'\xff' * 6):
            r.publisher(kind, topic).publish(raw)
    r.spin()
    assert sum(r.replacer.counts.values()) == 6 and not r.replacer.switch.faulty
    r.step(*healthy())
    assert r.spin_until(lambda: len(heard) == 4)


def test_ticks_that_were_missed_are_made_good(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(y1=0.75), periods=5)
    r.isolate('y2')
    r.now += 4 * PERIOD
    r.step(*healthy(y1=0.75))
    assert r.spin_until(lambda: len(heard) == 10)
    assert np.all(np.diff(stamps(heard)) == PERIOD)
    r.now += 29 * PERIOD  # too many: the newest will do
    r.step(*healthy(y1=0.75))
    assert len(heard) == 11 and stamps(heard)[-1] == r.now
    assert r.replacer.overruns == 29


def joint_parameters(parameters, **changes):
    """y1 and y2 in one JointState, y3 alone."""
    given = dict(parameters)
    for name, joint in (('y1', 'shoulder'), ('y2', 'elbow')):
        given[f'sensors.{name}.topic'] = '/joint_states'
        given[f'sensors.{name}.type'] = 'sensor_msgs/msg/JointState'
        given[f'sensors.{name}.field'] = f'position[{joint}]'
    return {**given, **changes}


def arm(shoulder, elbow, wrist=0.0):
    message = JointState(name=['wrist', 'elbow', 'shoulder'],
                         position=[wrist, elbow, shoulder], effort=[wrist] * 3)
    message.header.frame_id = 'base'
    return ('/joint_states_raw', message)


def test_two_sensors_in_one_message(rig, parameters):
    r = rig(joint_parameters(parameters))
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    for i in range(5):
        r.step(arm(0.5, 1.0, i), healthy()[2])
    r.isolate('y2')
    for i in range(5, 15):
        r.step(arm(0.75, 99.0, i), healthy()[2])
    assert r.spin_until(lambda: len(heard) == 15)
    for i, raw in enumerate(heard[5:], 5):
        m = decode(JointState, raw)
        assert list(m.position) == [i, 1.5, 0.75] and list(m.effort) == [i] * 3
        assert m.name == ['wrist', 'elbow', 'shoulder'] and m.header.frame_id == 'base'
    assert np.all(np.diff(stamps(heard, JointState)) == PERIOD)


def test_a_silent_healthy_channel_is_not_sent_as_if_live(rig, parameters):
    r = rig(joint_parameters(parameters, without_estimate='hold'))
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.command(0.0)
    r.step(arm(0.5, 1.0), healthy()[2], periods=5)
    r.isolate('y1')
    r.step(healthy()[2], periods=60)
    first, last = decode(JointState, heard[6]), decode(JointState, heard[-1])
    assert first.position[1] == 1.0 and math.isnan(last.position[1])
    assert 0.0 < last.position[2] < first.position[2]  # the estimate goes on


def test_messages_of_other_joints_and_short_arrays(rig, parameters):
    r = rig(joint_parameters(parameters))
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(arm(0.5, 1.0), healthy()[2], periods=5)
    r.isolate('y2')
    other = JointState(name=['finger'], position=[0.125])
    put_stamp(other, r.now - PERIOD)  # it need not wait for the estimates
    hand = serialize_message(other)
    short = JointState(name=['elbow', 'shoulder'], position=[99.0])
    publisher = r.publisher(JointState, '/joint_states_raw')
    publisher.publish(hand)
    publisher.publish(short)
    r.spin()
    assert [bytes(raw) for raw in heard[5:]] == [hand]
    assert any('too short' in reason for _, reason in r.replacer.counts)
    r.step(arm(0.75, 99.0), healthy()[2], periods=2)
    assert decode(JointState, heard[-1]).position[1] == 1.5


def test_types_without_a_header(rig, parameters):
    given = {**parameters, 'sensors.y1.type': 'std_msgs/msg/Float64', 'sensors.y1.field': 'data'}
    r = rig(given)
    heard = r.listen('std_msgs/msg/Float64', '/y1')
    r.command(3.0)
    r.step(*healthy()[1:], periods=3)
    r.isolate('y1')  # it has never said anything
    r.step(*healthy()[1:], periods=5)
    assert r.spin_until(lambda: len(heard) == 6)  # the tick before the isolation, and five
    z = np.array([decode(Float64, raw).data for raw in heard])
    np.testing.assert_allclose(
        z, 3.0 + (z[0] - 3.0) * np.exp(-np.arange(6) * 0.01), atol=1e-12)


def test_no_template_no_message(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y1')
    r.command(3.0)
    r.step(*healthy()[1:], periods=3)
    r.isolate('y1')
    r.step(*healthy()[1:], periods=5)
    assert not heard and 'ever seen' in r.replacer.why['y1']


def test_isolation_by_text(rig, parameters, capfd):
    r = rig({**parameters, 'isolation.type': 'std_msgs/msg/String'})
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(), periods=3)
    r.say('y2, knee')
    assert r.spin_until(lambda: r.replacer.switch.faulty == {'y2'})
    assert "'knee' is not a sensor" in capfd.readouterr().err
    r.step(*healthy(y1=0.75, y2=9.0), periods=3)
    assert values(heard)[-1] == 1.5
    r.say('')
    assert r.spin_until(lambda: not r.replacer.switch.faulty)


def test_isolation_from_a_latched_publisher_is_heard(rig, parameters):
    r = rig({**parameters, 'isolation.type': 'std_msgs/msg/String'})
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = r.node.create_publisher(String, '/isolation', latched)
    assert r.spin_until(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(String(data='y1'))
    assert r.spin_until(lambda: r.replacer.switch.faulty == {'y1'})


def test_other_types_and_qos_on_our_topics_are_said(rig, parameters, capfd):
    r = rig(parameters)
    context = Context()  # one participant cannot have a topic with two types
    context.init()
    stranger = Node('stranger', context=context)
    stranger.create_publisher(Temperature, '/y1_raw', 10)
    stranger.create_subscription(
        Range, '/y2', print, QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    stranger.create_publisher(Range, '/y3', 10)
    stranger.create_subscription(Range, '/y1', print, 10)  # nothing wrong with this
    node = r.replacer.node
    assert r.spin_until(lambda: len(list(complaints(node, r.replacer.ends))) >= 3)
    r.replacer._look_around()  # may have been half discovered: said when it is still so
    assert 'stranger' not in capfd.readouterr().err
    r.replacer._look_around()
    said = capfd.readouterr().err
    assert '/y1_raw: /stranger uses the type sensor_msgs/msg/Temperature' in said
    assert '/y2: the QoS of /stranger does not match' in said
    assert '/y3: /stranger publishes there too' in said
    assert said.count('stranger') == 3
    r.replacer._look_around()
    assert 'stranger' not in capfd.readouterr().err  # once
    stranger.destroy_node()
    context.shutdown()


def test_a_clock_that_goes_back_starts_anew(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(), periods=5)
    r.isolate('y2')
    r.step(*healthy(), periods=5)
    r.now -= 10**9
    before, start = len(heard), r.now
    r.step(*healthy(y1=0.75), periods=10)
    assert r.spin_until(lambda: len(heard) > before)
    fresh = stamps(heard)[before:]
    assert start < fresh[0] <= fresh[-1] < start + 10**9 and np.all(np.diff(fresh) > 0)
    assert values(heard)[-1] == 1.5


def test_diagnostics_of_all_sources(rig, parameters):
    r = rig(parameters)
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.command(2.0)
    r.step(*healthy()[:2], periods=5)
    r.isolate('y1')
    r.step(*healthy()[:2], periods=3)
    r.spin()
    last = {s.name: s for s in decode(DiagnosticArray, status[-1]).status}
    assert set(last) == {'replacer: y1', 'replacer: y2', 'replacer: y3'}
    assert last['replacer: y1'].level == b'\x01' and 'u1' in last['replacer: y1'].message
    facts = {v.key: v.value for v in last['replacer: y1'].values}
    assert facts['source'] == 'virtual' and facts['order'] == '1' and facts['switches'] == '1'
    assert last['replacer: y2'].level == b'\x00'
    assert last['replacer: y3'].level == b'\x03'  # healthy, but never heard
    assert last['replacer: y1'].hardware_id == '/y1'


def test_on_the_wall_clock(rig, parameters):
    r = rig(parameters, sim_time=False)
    heard = r.listen(RANGE, '/y2')
    y1, y2, y3 = (r.publisher(Range, f'/y{i}_raw') for i in (1, 2, 3))
    u1 = r.publisher(Float64, '/u1')

    def send(seconds, value):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for publisher in (y1, y2, y3):
                message = reading(value)
                message.header.stamp = r.node.get_clock().now().to_msg()
                publisher.publish(message)
            u1.publish(Float64(data=0.0))
            r.spin(0.01)

    send(0.2, 0.75)
    r.isolate('y2')
    count = len(heard)
    send(0.5, 0.75)
    assert values(heard[count:]) == [1.5] * len(heard[count:])
    assert len(heard) - count >= 5  # of 50: the machine may be busy
    assert np.all(np.diff(stamps(heard)) > 0)
    r.isolate()
    send(0.1, 0.75)
    assert values(heard)[-1] == 0.75
    assert np.all(np.diff(stamps(heard)) > 0)
