"""What is heard on the isolation topic, now and from before."""

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from vsensor_ros.node.reports import LATELY, MOST_STRANGERS

RANGE = 'sensor_msgs/msg/Range'
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TEXT = {'isolation.type': 'std_msgs/msg/String'}


def statuses(**levels):
    return DiagnosticArray(status=[DiagnosticStatus(name=name, level=bytes([level]))
                                   for name, level in levels.items()])


def reported(r, *names):
    return r.spin_until(lambda: r.reported == set(names))


def keeper(r, kind):
    """Return a publisher whose last message is there for who comes later."""
    publisher = r.node.create_publisher(kind, '/isolation', KEPT)
    assert r.spin_until(lambda: publisher.get_subscription_count() == 2)
    return publisher


def test_isolation_by_text(rig, parameters, capfd):
    r = rig({**parameters, **TEXT})
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=3)
    r.say('y2, knee')
    assert reported(r, 'y2')
    assert "'knee' is not a sensor" in capfd.readouterr().err
    r.step(*r.healthy(y1=0.75, y2=9.0), periods=3)
    assert r.values(heard)[-1] == 1.5
    r.say('')
    assert reported(r)


@pytest.mark.parametrize('given, kind, message', [
    (TEXT, String, String(data='y2')), ({}, DiagnosticArray, statuses(y2=2))])
def test_a_replacer_that_starts_during_a_fault_knows_it(rig, parameters, given, kind, message):
    r = rig({**parameters, **given})
    keeper(r, kind).publish(message)
    assert reported(r, 'y2')
    r.restart()
    assert reported(r, 'y2')
    r.publisher(kind, '/isolation').publish(String() if kind is String else statuses(y2=0))
    assert reported(r)
    r.spin(0.05)
    assert reported(r)


def test_history_does_not_overrule_what_is_newer(rig, parameters):
    r = rig(parameters)
    old = keeper(r, DiagnosticArray)
    old.publish(statuses(y1=2, y2=2))
    assert reported(r, 'y1', 'y2')
    r.publisher(DiagnosticArray, '/isolation').publish(statuses(y1=0))
    assert reported(r, 'y2')
    # what only the transient-local subscription hears is told as if it came now, once more
    reports = r.replacer.reports
    for sent, what in ((reports._said['y1', 'y1'] - 1, statuses(y1=2, y3=2)),
                       (reports._said['y1', 'y1'] + 1, statuses(y2=0))):
        reports.apply(sent, r.raw(what), r.now, late=True)
        assert set(reports.report().faulty) == (
            {'y2', 'y3'} if what.status[0].name == 'y1' else {'y3'})


def test_a_live_message_heard_twice_counts_once(rig, parameters):
    r = rig({**parameters, **TEXT})
    publisher = keeper(r, String)
    for i in range(30):
        publisher.publish(String(data='y2' if i % 2 else ''))
    assert reported(r, 'y2')
    r.spin()
    assert reported(r, 'y2') and not r.replacer.reports._heard


def test_bytes_that_are_no_message_of_isolation(rig, parameters, capfd):
    r = rig(parameters)
    r.isolate('y2')
    publisher = r.publisher(DiagnosticArray, '/isolation')
    for raw in (b'', b'garbage', b'\x00\x01\x00\x00' + b'\xff' * 6, bytes(300_000)):
        publisher.publish(raw)
    r.spin(0.05)
    assert reported(r, 'y2')
    assert r.replacer.health().not_used == 4
    assert 'not a message of the type' in capfd.readouterr().err
    r.isolate('y1')


def test_isolation_may_chatter_without_flooding_the_log(rig, parameters, capfd):
    r = rig({**parameters, **TEXT})
    r.step(*r.healthy(), periods=3)
    r.say('y2')
    assert reported(r, 'y2')
    r.say('["y2"]')  # not understood: y2 is no healthier for it
    for i in range(20):
        r.say(f'foo{i}')
    r.spin(0.1)
    assert reported(r, 'y2')
    for i in range(20):
        r.say('y1' if i % 2 else '')
        r.spin(0.01)
    said = capfd.readouterr().err
    assert said.count('faulty sensors:') == 1 and said.count('is not a sensor') == 1
    assert r.replacer.snapshot().faulty == ('y1',)


@pytest.mark.parametrize('topic', ['/isolation', '/diagnostics'])
def test_a_fault_of_something_that_is_no_sensor(rig, parameters, topic, capfd):
    r = rig({**parameters, 'isolation.topic': topic})
    publisher = r.publisher(DiagnosticArray, topic)
    for _ in range(5):
        publisher.publish(statuses(Y1=2))
        r.spin(0.02)
    assert capfd.readouterr().err.count('is not a sensor') == (topic == '/isolation')
    assert r.replacer.health().not_used == 5 * (topic == '/isolation')


def test_a_flood_about_others_leaves_room_for_what_is_true(rig, parameters, monkeypatch):
    monkeypatch.setattr('vsensor_ros.node.reports.time.monotonic_ns', lambda: 10**9)
    r = rig(parameters)
    r.step(*r.healthy(), periods=3)
    reports = r.replacer.reports
    flood, true = r.raw(statuses(q=2)), r.raw(statuses(y1=2))
    for i in range(2000):
        reports.apply(i + 1, flood, r.now, late=True)
    reports.apply(3000, true, r.now, late=True)
    assert reports.report().faulty == {'y1': r.now}
    health = r.replacer.health()
    assert health.not_used == 2000 and 1000 < health.thrown_away < 2000


def test_what_others_say_on_a_shared_topic_is_thrown_away_by_nobody(rig, parameters):
    r = rig({**parameters, 'isolation.topic': '/diagnostics'})
    raw = r.raw(statuses(q=2))
    for i in range(2000):
        r.replacer.reports.apply(i + 1, raw, r.now, late=True)
    assert r.replacer.health().not_used == r.replacer.health().thrown_away == 0


def several(*said):
    """Make a message of (name, level) or (name, level, hardware_id)."""
    return DiagnosticArray(status=[
        DiagnosticStatus(name=name, level=bytes([level]), hardware_id=''.join(hardware))
        for name, level, *hardware in said])


def test_of_several_statuses_of_one_name_the_worst_counts(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=3)
    isolation = r.publisher(DiagnosticArray, '/isolation')
    isolation.publish(several(('y2', 2), ('y2', 0)))
    assert reported(r, 'y2')
    r.step(*r.healthy(y1=0.75, y2=9.0), periods=3)
    assert r.values(heard)[-1] == 1.5
    isolation.publish(several(('y2', 0), ('y2', 1), ('y1', 0), ('y1', 3)))
    assert reported(r, 'y1', 'y2')
    isolation.publish(several(('y2', 0), ('y2', 0), ('y1', 0)))
    assert reported(r)


NAMED = {'isolation.names': ['isolator: *=*', 'motor_*: velocity=y2', 'hardware_id=SN-7=y2']}


@pytest.mark.parametrize('topic', ['/isolation', '/diagnostics'])
@pytest.mark.parametrize('said', [
    ('isolator: y2', 2), ('motor_left: velocity', 3), ('imu: noise', 2, 'SN-7'),
    ('imu: noise', 2, 'y2')])
def test_names_that_were_given_to_a_sensor(rig, parameters, topic, said):
    r = rig({**parameters, **NAMED, 'isolation.topic': topic})
    isolation = r.publisher(DiagnosticArray, topic)
    isolation.publish(several(('motor_left: current', 2), said))
    assert reported(r, 'y2')
    isolation.publish(several((said[0], 0, *said[2:])))
    assert reported(r)


def test_each_name_of_a_sensor_speaks_for_itself(rig, parameters):
    r = rig({**parameters, **NAMED})
    isolation = r.publisher(DiagnosticArray, '/isolation')
    for said, faulty in (
            ([('isolator: y2', 2)], {'y2'}), ([('y2', 0), ('imu: noise', 0, 'y2')], {'y2'}),
            ([('y2', 2)], {'y2'}), ([('isolator: y2', 0), ('y3', 2)], {'y2', 'y3'}),
            ([('y2', 0)], {'y3'})):
        isolation.publish(several(*said, ('y1', 0)))
        assert r.spin_until(lambda faulty=faulty: r.reported == faulty), said
        r.spin(0.01)
        assert r.reported == faulty
    assert r.replacer.snapshot().spoken_of == ('y1', 'y2', 'y3')


def test_a_text_may_use_names_that_were_given(rig, parameters):
    r = rig({**parameters, **TEXT, 'isolation.names': ['imu_*=y2']})
    for text, names in (('imu_left y1', ('y1', 'y2')), ('imu_right', ('y2',)), ('', ())):
        r.say(text)
        assert reported(r, *names)


def test_what_a_replacer_says_of_itself_is_no_isolation(rig, parameters):
    """With a pattern that would take it for one, from this node or another, also passed on."""
    r = rig({**parameters, 'isolation.names': ['*y2=y2']})
    isolation = r.publisher(DiagnosticArray, '/isolation')
    own = several(('other: y2', 2), ('other: the loop', 2))
    own.status[0].values = [KeyValue(key='faulty sensors', value='y2')]
    own.status[1].values = [KeyValue(key='spoken_of', value='')]
    isolation.publish(own)
    isolation.publish(several(('y1', 2)))
    assert reported(r, 'y1') and r.replacer.snapshot().spoken_of == ('y1',)
    own.status[0].values = []
    isolation.publish(own)
    assert reported(r, 'y1', 'y2')


@pytest.mark.parametrize('topic', ['/isolation', '/diagnostics'])
def test_a_name_that_ends_like_a_sensor_is_told_with_the_mend(rig, parameters, topic, capfd,
                                                              monkeypatch):
    r = rig({**parameters, 'isolation.topic': topic})
    isolation = r.publisher(DiagnosticArray, topic)
    reports = r.replacer.reports
    for name in ('isolator: y2', '/robot/y2', 'motor/y2'):
        isolation.publish(several((name, 2), ('pump', 0)))
        assert r.spin_until(lambda name=name: name in reports.strangers())
    isolation.publish(several(('before: y1', 0)))  # is told before the fault
    assert r.spin_until(lambda: 'before: y1' in reports.strangers())
    isolation.publish(several(('y1', 0)))  # y1 has a name that is known
    assert r.spin_until(lambda: 'before: y1' not in reports.strangers())
    assert r.reported == set()
    said = capfd.readouterr().err
    assert "did you mean y2? If so, add 'isolator: y2=y2' to isolation.names" in said
    later = time.monotonic() + LATELY + 1.0
    monkeypatch.setattr('vsensor_ros.node.reports.time.monotonic', lambda: later)
    assert reports.strangers() == []


def test_what_was_said_to_be_nobodys_is_passed_over(rig, parameters, capfd):
    r = rig({**parameters, 'isolation.names': ['driver: y2=', 'pump_*=']})
    isolation = r.publisher(DiagnosticArray, '/isolation')
    isolation.publish(several(('driver: y2', 2), ('pump_3', 2)))
    isolation.publish(several(('y1', 2)))
    assert reported(r, 'y1')
    assert r.replacer.health().not_used == 0 and not r.replacer.reports.strangers()
    assert 'is not a sensor' not in capfd.readouterr().err


def test_names_by_pattern_are_bounded(rig, parameters, monkeypatch):
    monkeypatch.setattr('vsensor_ros.node.reports.MOST_NAMES', 10)
    r = rig({**parameters, 'isolation.names': ['motor_*=y2']})
    reports = r.replacer.reports
    for i in range(30):
        reports.apply(i + 1, r.raw(several((f'motor_{i}', 2), (f'x{i}: y2', 2))), r.now)
    reports.apply(31, r.raw(several(('y1', 2))), r.now)
    assert set(reports.report().faulty) == {'y1', 'y2'} and len(reports._said) == 11
    assert len(reports._strangers) == MOST_STRANGERS and len(reports.strangers()) <= 5
