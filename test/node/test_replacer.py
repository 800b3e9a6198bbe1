import math
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState, Range, Temperature
from std_msgs.msg import Float64, Int32MultiArray, String

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


def statuses(raws):
    """Return the last diagnostics, by channel."""
    return {s.name.partition(': ')[2]: s for s in decode(DiagnosticArray, raws[-1]).status}


def facts(status):
    return {v.key: v.value for v in status.values}


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
    assert ('make a design' in last['replacer: y3'].message) == (len(faulty) == 2)
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


def test_isolation_from_a_transient_local_publisher_is_heard_while_running(rig, parameters):
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
        Range, '/y2', lambda message: None,
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    stranger.create_publisher(Range, '/y3', 10)
    stranger.create_subscription(Range, '/y1', lambda message: None, 10)  # nothing wrong with this
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
    r.step()
    assert 'nothing comes' in r.replacer.streams[0].why_silent('y1', r.now)
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


# ------------------------------------------------------------- several channels in one message


def empty_effort(i):
    return ['wrist', 'elbow', 'shoulder'], [i, 99.0, 0.75], []


def no_name(i):
    return ['wrist', 'shoulder'], [i, 0.75], [i, i]


def short_effort(i):
    return ['wrist', 'shoulder', 'elbow'], [i, 0.75, 99.0], [i]


@pytest.mark.parametrize('failing', [empty_effort, no_name, short_effort])
def test_what_is_healthy_stays_live_when_the_failed_element_is_gone(rig, parameters, failing):
    r = rig(joint_parameters(parameters, **{'sensors.y2.field': 'effort[elbow]'}))
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    for i in range(5):
        r.step(arm(0.5, 0.0, i), healthy()[2])
    r.isolate('y2')
    before = len(heard)
    for i in range(5, 80):  # longer than max_age
        name, position, effort = failing(float(i))
        r.step(('/joint_states_raw', JointState(name=name, position=position, effort=effort)),
               healthy()[2])
    assert r.spin_until(lambda: len(heard) == before + 75)
    for i, raw in enumerate(heard[-74:], 6):
        m = decode(JointState, raw)
        position, effort = dict(zip(m.name, m.position)), dict(zip(m.name, m.effort))
        assert position['shoulder'] == 0.75 and effort['elbow'] == 1.5
        assert position['wrist'] == i
    assert np.all(np.diff(stamps(heard, JointState)) > 0)


def test_a_joint_that_disappears_from_its_own_drivers_messages(rig, parameters):
    given = joint_parameters(parameters, **{
        'sensors.y1.topic': '/y1', 'sensors.y1.type': RANGE, 'sensors.y1.field': 'range'})
    r = rig(given)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(arm(0.5, 1.0), healthy()[0], healthy()[2], periods=5)
    r.isolate('y2')
    before = len(heard)
    for i in range(80):
        rest = JointState(name=['wrist'], position=[float(i)])
        r.step(('/joint_states_raw', rest), healthy(y1=0.75)[0], healthy()[2])
    assert r.spin_until(lambda: len(heard) == before + 80)  # none of them raw
    last = decode(JointState, heard[-1])
    assert last.name == ['wrist', 'elbow'] and list(last.position) == [79.0, 1.5]


def test_the_template_is_the_message_with_the_channels(rig, parameters):
    r = rig(joint_parameters(parameters))
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    for _ in range(5):
        r.step(arm(0.5, 1.0, 0.25), healthy()[2])
        r.step(('/joint_states_raw', JointState(name=['shoulder'], position=[0.75])))
    r.isolate('y2')
    r.step(healthy()[2], periods=2)
    last = decode(JointState, heard[-1])
    assert last.name == ['wrist', 'elbow', 'shoulder'] and list(last.effort) == [0.25] * 3
    assert list(last.position) == [0.25, 1.5, 0.75]  # of both


def test_the_rest_of_the_message_stays_live_when_a_healthy_joint_disappears(rig, parameters):
    r = rig(joint_parameters(parameters))
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.command(1.0)
    r.step(arm(0.5, 1.0), healthy()[2], periods=5)
    r.isolate('y1')
    for i in range(70):
        rest = JointState(name=['wrist', 'shoulder'], position=[float(i), 99.0])
        r.step(('/joint_states_raw', rest), healthy()[2])
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
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(('/both_raw', Int32MultiArray(data=[1, 2])), healthy()[2], periods=5)
    r.isolate('y2')
    before = len(heard)
    r.step(('/both_raw', Int32MultiArray(data=[1])), healthy()[2], periods=60)
    r.replacer._report()
    r.spin()
    said = statuses(status)
    assert said['y2'].level == b'\x02' and 'too short for data[1]' in said['y2'].message
    assert said['y1'].level == b'\x02' and 'nothing goes out with it' in said['y1'].message
    assert len(heard) - before <= 1
    r.isolate()
    r.step(('/both_raw', Int32MultiArray(data=[1, 2])), periods=2)
    r.spin()
    assert statuses(status)['y1'].level == b'\x00'


def test_each_channel_has_its_own_silence(rig, parameters):
    r = rig(joint_parameters(parameters))
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(arm(0.5, 1.0), *healthy()[2:], periods=5)
    rest = ('/joint_states_raw', JointState(name=['wrist', 'elbow'], position=[0.0, 1.0]))
    r.step(rest, periods=60)
    r.replacer._report()
    r.spin()
    said = statuses(status)
    assert said['y1'].level == b'\x03' and said['y1'].message.startswith(
        'messages arrive on /joint_states_raw, but position[shoulder] is not in the message')
    assert said['y2'].level == b'\x00'
    assert said['y3'].message.startswith('nothing comes on /y3_raw')
    r.command(1.0)
    r.isolate('y1', 'y2')  # nothing is known of y2 in that set
    r.step(('/joint_states_raw', JointState(name=['wrist'], position=[0.0])), *healthy()[2:],
           periods=5)
    last = decode(JointState, heard[-1])
    position = dict(zip(last.name, last.position))
    assert math.isnan(position['elbow']) and math.isfinite(position['shoulder'])


def test_messages_of_which_nothing_can_be_read_are_silence(rig, parameters):
    r = rig(joint_parameters(parameters))
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(arm(0.5, 1.0), periods=5)
    r.step(('/joint_states_raw', JointState(name=['elbow', 'shoulder'])), periods=60)
    r.publisher(Range, '/y3_raw').publish(b'garbage')
    r.spin()
    r.replacer._report()
    r.spin()
    said = statuses(status)
    assert [said[name].level for name in ('y1', 'y2', 'y3')] == [b'\x03'] * 3
    assert 'messages arrive on /joint_states_raw, but the array is too short' in \
        said['y1'].message
    assert 'messages arrive on /y3_raw, but bytes' in said['y3'].message
    assert facts(said['y2'])['the array is too short for position[elbow]'] == '60'


def test_stop_of_one_channel_leaves_the_others_of_its_message(rig, parameters):
    given = joint_parameters(parameters)
    for key, value in (('topic', '/joint_states'), ('type', 'sensor_msgs/msg/JointState'),
                       ('field', 'position[wrist]')):
        given[f'sensors.y3.{key}'] = value
    r = rig(given)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(arm(0.5, 1.0), periods=5)
    r.isolate('y3')  # refused
    r.step(arm(0.75, 1.5, 99.0), periods=5)
    r.replacer._report()
    assert r.spin_until(lambda: len(heard) == 10)
    last = decode(JointState, heard[-1])
    assert math.isnan(last.position[0]) and list(last.position[1:]) == [1.5, 0.75]
    r.spin()
    said = statuses(status)
    assert said['y3'].level == b'\x02' and 'NaN goes out' in said['y3'].message
    assert said['y1'].level == said['y2'].level == b'\x00'
    r.command(1.0)
    r.isolate('y1', 'y2')  # y1 is virtual, y2 refused
    r.step(arm(99.0, 99.0, 0.0), periods=5)
    last = decode(JointState, heard[-1])
    assert last.position[0] == 0.0 and math.isnan(last.position[1])
    assert 0.0 < last.position[2] < 1.0
    r.isolate('y1', 'y2', 'y3')  # no design: all stop
    before = len(heard)
    r.step(arm(99.0, 99.0, 99.0), periods=5)
    r.spin()
    r.replacer._report()
    r.spin()
    assert len(heard) == before
    assert all('nothing goes out' in s.message for s in statuses(status).values())


def test_what_passes_is_live_beside_what_is_virtual(rig, parameters):
    r = rig(joint_parameters(parameters, without_estimate='pass'))
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.command(1.0)
    r.step(arm(0.5, 1.0), healthy()[2], periods=5)
    r.isolate('y1', 'y2')
    for i in range(5):
        r.step(arm(99.0, 50.0 + i), healthy()[2])
    last = decode(JointState, heard[-1])
    assert last.position[1] == 54.0 and 0.0 < last.position[2] < 1.0


# ------------------------------------------------------------------------------------- stamps


def send(r, stamp, value=0.75, topic='/y2_raw'):
    message = reading(value)
    put_stamp(message, stamp)
    before = r.taken[topic]
    r.publisher(Range, topic).publish(message)
    assert r.spin_until(lambda: r.taken[topic] > before)


def test_nothing_as_old_as_an_estimate_goes_out_after_it(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(), periods=5)
    r.isolate('y2')
    r.step(*healthy(), periods=5)
    r.isolate()
    before = len(heard)
    sent = stamps(heard)[-1]
    for stamp in (sent - 1_500_000_000, sent - 500_000_000, sent):  # a backlog
        send(r, stamp, 9.0)
    r.spin()
    assert len(heard) == before
    assert r.replacer.counts['y2', 'not sent on: not newer than what went out'] == 3
    send(r, sent + 1, 8.0)
    assert r.spin_until(lambda: len(heard) == before + 1) and values(heard)[-1] == 8.0


def test_estimates_are_newer_than_the_newest_live_message(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(), periods=5)
    newest = r.now + 300_000_000
    send(r, newest)
    send(r, r.now + 1)
    assert r.spin_until(lambda: len(heard) == 7)
    r.isolate('y2')
    r.step(*healthy()[::2], periods=40)
    assert stamps(heard)[7:] == [newest + (i + 1) * PERIOD for i in range(10)]


def test_estimates_that_have_to_wait_are_said_to(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(*healthy(), periods=5)
    send(r, r.now + 900_000_000)
    r.isolate('y2')
    r.step(*healthy()[::2], periods=80)
    r.spin()
    assert len(heard) == 6 and statuses(status)['y2'].level == b'\x02'
    assert 'not newer than what went out' in statuses(status)['y2'].message
    r.step(*healthy()[::2], periods=20)
    r.spin()
    assert len(heard) > 6 and statuses(status)['y2'].level == b'\x01'


def test_old_messages_among_new_ones_are_never_believed(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(), periods=5)
    r.isolate('y2')
    r.step(*healthy(), periods=5)
    r.isolate()
    for _ in range(14):
        r.now += 49 * PERIOD
        r.step(*healthy()[::2])
        send(r, r.now)
        send(r, r.now - 10**9, 9.0)
    assert r.spin_until(lambda: len(heard) == 24)
    assert 9.0 not in values(heard)


def test_one_stamp_from_far_away_silences_nothing(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    send(r, r.now + 3600 * 10**9)
    r.step(*healthy(), periods=5)
    r.isolate('y2')
    r.step(*healthy(), periods=5)
    assert stamps(heard)[-5:] == [r.now - i * PERIOD for i in range(4, -1, -1)]


@pytest.mark.parametrize('offset', [-3600 * 10**9, 3600 * 10**9])
def test_estimates_keep_the_clock_of_the_driver(rig, parameters, offset, capfd, monkeypatch):
    monkeypatch.setattr('vsensor_ros.node.replacer.QUIET', 0.0)
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    for _ in range(5):
        r.step(*healthy()[::2])
        send(r, r.now + offset)
    r.isolate('y2')
    r.step(*healthy(y1=0.75)[::2], periods=5)
    assert stamps(heard)[5:] == [r.now + offset - i * PERIOD for i in range(4, -1, -1)]
    r.isolate()
    r.step(*healthy()[::2])
    send(r, r.now + offset, 3.0)
    assert r.spin_until(lambda: values(heard)[-1] == 3.0)
    assert np.all(np.diff(stamps(heard)) > 0)
    said = capfd.readouterr().err
    assert said.count('the stamps on /y2_raw are') == 1
    assert f'{offset * 1e-9:+.1f} s from the clock' in said


def test_a_driver_that_restarts_with_an_earlier_clock_is_not_dead_for_ever(
        rig, parameters, capfd):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(*healthy(), periods=5)
    r.isolate('y2')
    r.step(*healthy(), periods=5)
    r.isolate()
    before = len(heard)
    for _ in range(48):
        r.now += 9 * PERIOD
        r.step(*healthy()[::2])
        send(r, r.now - 100 * 10**9, 4.0)
    r.replacer._report()
    r.spin()
    assert len(heard) == before
    assert 'not newer than what went out' in statuses(status)['y2'].message
    for _ in range(10):
        r.now += 9 * PERIOD
        r.step(*healthy()[::2])
        send(r, r.now - 100 * 10**9, 4.0)
    r.spin()
    after = stamps(heard)[before:]
    assert 5 <= len(after) <= 10 and np.all(np.diff(after) > 0)
    assert capfd.readouterr().err.count('mend the clock of the driver') == 1


def test_a_clock_trimmed_back_by_less_than_a_second_resets_nothing(rig, parameters, capfd):
    r = rig(parameters, sim_time=False)
    r.spin()
    r.replacer.now = ahead = r.replacer.now + 800_000_000
    r.replacer.poll()
    assert r.replacer.now >= ahead and 'went back' not in capfd.readouterr().err
    r.replacer.now += 5_000_000_000
    r.replacer.poll()
    assert r.replacer.now < ahead + 4_000_000_000 and 'went back' in capfd.readouterr().err


def test_a_tick_waits_for_the_readings_of_its_time(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*healthy(y1=0.5), periods=5)
    r.isolate('y2')
    r.step(*healthy(y1=0.5), periods=2)
    before = len(heard)
    r.step()  # the clock is there first
    assert len(heard) == before
    for topic, value in (('/y1_raw', 0.75), ('/y3_raw', 0.0)):
        send(r, r.now, value, topic)
    assert r.spin_until(lambda: len(heard) == before + 1)
    assert stamps(heard)[-1] == r.now and values(heard)[-1] == 1.5


# -------------------------------------------------------------------------- what is said of it


def test_from_no_source_back_to_a_virtual_one(rig, parameters):
    r = rig({**parameters, 'without_estimate': 'hold'})
    heard = r.listen(RANGE, '/y2')
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(*healthy(y1=0.5, y2=1.0), periods=5)
    r.isolate('y2')
    r.step(*healthy(y1=0.75), periods=5)
    r.step(*healthy()[2:], periods=60)
    r.spin()
    assert statuses(status)['y2'].level == b'\x02'
    assert values(heard)[-1] == 1.5  # the last estimate, not the last reading
    r.step(*healthy(y1=0.25), periods=5)
    r.spin()
    assert statuses(status)['y2'].level == b'\x01' and values(heard)[-1] == 0.5


def test_there_may_be_nothing_to_hold(rig, parameters):
    r = rig({**parameters, 'without_estimate': 'hold',
             'sensors.y3.type': 'std_msgs/msg/Float64', 'sensors.y3.field': 'data'})
    heard = r.listen('std_msgs/msg/Float64', '/y3')
    r.step(*healthy()[:2], periods=3)
    r.isolate('y3')
    r.step(*healthy()[:2], periods=3)
    assert not heard and 'nothing goes out' in r.replacer.why['y3']


def test_facts_of_the_bank(rig, parameters):
    r = rig(parameters)
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(*healthy(), periods=5)
    r.isolate('y2')
    r.step(*healthy(), periods=20)
    r.now -= 10**9
    r.step(*healthy(), periods=21)
    r.replacer._report()
    r.spin()
    told = facts(statuses(status)['y2'])
    assert told['restarts'] == '0' and told['running since [s]'] == '0.2'
    assert told['clock went backwards'] == '1' and told['faulty sensors'] == 'y2'


def test_a_sensor_that_is_slower_than_max_age_is_said_once(rig, parameters, capfd):
    r = rig(parameters)
    r.step(*healthy(), periods=3)
    for _ in range(6):
        r.step(*healthy()[::2], periods=4)
        r.now += 96 * PERIOD
        r.step()  # the clock, first
        send(r, r.now)
    said = [line for line in capfd.readouterr().err.splitlines() if 'raise max_age' in line]
    assert len([line for line in said if 'y2: its readings are 1.01 s apart' in line]) == 1


def test_isolation_may_chatter_without_flooding_the_log(rig, parameters, capfd):
    r = rig({**parameters, 'isolation.type': 'std_msgs/msg/String'})
    status = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/diagnostics')
    r.step(*healthy(), periods=3)
    r.say('y2')
    assert r.spin_until(lambda: r.replacer.switch.faulty == {'y2'})
    r.say('["y2"]')  # not understood: y2 is no healthier for it
    for i in range(20):
        r.say(f'foo{i}')
    r.spin(0.1)
    assert r.replacer.switch.faulty == {'y2'}
    for i in range(20):
        r.say('y1' if i % 2 else '')
        r.spin(0.01)
    said = capfd.readouterr().err
    assert said.count('faulty sensors:') == 1 and said.count('is not a sensor') == 1
    r.replacer._report()
    r.spin()
    assert facts(statuses(status)['y3'])['faulty sensors'] == 'y1'


@pytest.mark.parametrize('topic', ['/isolation', '/diagnostics'])
def test_a_fault_of_something_that_is_no_sensor(rig, parameters, topic, capfd):
    r = rig({**parameters, 'isolation.topic': topic})
    publisher = r.publisher(DiagnosticArray, topic)
    for _ in range(5):
        publisher.publish(DiagnosticArray(status=[DiagnosticStatus(name='Y1', level=b'\x02')]))
        r.spin(0.02)
    assert capfd.readouterr().err.count('is not a sensor') == (topic == '/isolation')


def test_the_same_again_is_not_logged_again(rig, parameters, capfd):
    r = rig(parameters)
    r.step(*healthy(), periods=2)
    for _ in range(20):
        r.step(*healthy(y1=math.nan))
    assert r.replacer.counts['y1', 'not finite'] == 20
    assert capfd.readouterr().err.count('y1: not finite') == 1


def test_two_replacers_of_one_name_complain_of_each_other(rig, parameters):
    first, second = rig(parameters), rig({**parameters, 'isolation.topic': '/other'})
    for one in (first, second):
        replacer = one.replacer
        assert one.spin_until(lambda replacer=replacer: any(
            '/y1: another /replacer publishes there too' in line
            for line in complaints(replacer.node, replacer.ends)))
