"""Live messages go on whatever their stamps; what is composed is newer, and what follows it."""

import math

import numpy as np
import pytest
from sensor_msgs.msg import JointState, Range

from vsensor_ros.engine.stream import NOT_NEWER
from vsensor_ros.node.accessor import put_stamp
from vsensor_ros.node.cdr import decode

RANGE = 'sensor_msgs/msg/Range'
PERIOD = 10_000_000  # ns, of the bank and of the sensors


def test_messages_from_before_the_last_estimate_are_left_out(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    r.isolate()
    late = r.reading(9.0)
    late.header.stamp = decode(Range, heard[-2]).header.stamp
    r.publisher(Range, '/y2_raw').publish(late)
    r.spin()
    r.step(*r.healthy(), periods=2)
    assert r.spin_until(lambda: len(heard) == 13)
    assert 9.0 not in r.values(heard)
    assert np.all(np.diff(r.stamps(heard)) > 0)


def test_nothing_as_old_as_an_estimate_goes_out_after_it(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    r.isolate()
    before = len(heard)
    sent = r.stamps(heard)[-1]
    for stamp in (sent - 1_500_000_000, sent - 500_000_000, sent):  # a backlog
        r.send(stamp, 9.0)
    r.spin()
    assert len(heard) == before
    assert r.counts['y2', 'not sent on: not newer than what went out'] == 3
    r.send(sent + 1, 8.0)
    assert r.spin_until(lambda: len(heard) == before + 1) and r.values(heard)[-1] == 8.0


def test_estimates_are_newer_than_the_newest_live_message(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    newest = r.now + 200_000_000
    r.send(newest)
    r.send(r.now + 1)
    assert r.spin_until(lambda: len(heard) == 7)
    r.isolate('y2')
    r.step(*r.healthy()[::2], periods=40)
    assert r.stamps(heard)[7:] == [newest + (i + 1) * PERIOD for i in range(20)]


def test_estimates_that_have_to_wait_are_said_to(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    for i in range(3):  # more than a mistake
        r.send(r.now + 900_000_000 + i)
    r.isolate('y2')
    r.step(*r.healthy()[::2], periods=80)
    r.spin()
    assert len(heard) == 8 and r.told()['y2'].source == 'none'
    assert 'not newer than what went out' in r.told()['y2'].reason
    r.step(*r.healthy()[::2], periods=20)
    r.spin()
    assert len(heard) > 8 and r.told()['y2'].source == 'virtual'


def test_old_messages_among_new_ones_are_never_believed(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    r.isolate()
    last = r.stamps(heard)[-1]
    for i in range(9):
        r.now += 49 * PERIOD
        r.step(*r.healthy()[::2])
        r.send(r.now)
        r.send(last - i * 10**9, 9.0)
        told = r.told()['y2']
        assert told.source == 'real' and told.counts[str(NOT_NEWER)] == i + 1
        assert told.reason == f'{i + 1} of its messages in 5 s {NOT_NEWER}'  # not all is well
    assert r.spin_until(lambda: len(heard) == 11 + 9)
    assert 9.0 not in r.values(heard)


@pytest.mark.parametrize('isolated', [False, True])
def test_one_stamp_from_far_away_silences_nobody(rig, parameters, isolated):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.send(r.now + 3600 * 10**9)
    r.step(*r.healthy(), periods=5)
    assert r.spin_until(lambda: len(heard) == 6)
    if isolated:
        r.isolate('y2')
    r.step(*r.healthy(), periods=10)
    assert r.spin_until(lambda: len(heard) == 16 + isolated)
    assert r.stamps(heard)[-4:] == [r.now - i * PERIOD for i in range(3, -1, -1)]


@pytest.mark.parametrize('ahead', [900_000_000, 100 * 10**9])
def test_a_single_stamp_from_the_future_does_no_harm(rig, parameters, ahead):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.send(r.now + ahead, 7.0)
    r.step(*r.healthy(), periods=5)
    r.send(r.now + ahead, 7.0)  # the last thing it says
    assert r.spin_until(lambda: len(heard) == 12)
    r.isolate('y2')
    r.step(*r.healthy()[::2], periods=5)
    assert r.spin_until(lambda: len(heard) == 18)
    assert r.stamps(heard)[-5:] == [r.now - i * PERIOD for i in range(4, -1, -1)]


LATE = 300_000_000  # ns


def whole_seconds(r, i):
    return r.now // 10**9 * 10**9


def stuck(r, i):
    return 5 * 10**9


def batches(r, i):
    return r.now - i % 10 * PERIOD


def backwards(r, i):
    return r.now - 2 * i * PERIOD


def all_sorts(r, i):
    return r.now - (0, 10**6, 0, 5 * 10**8, 2 * 10**9, -3600 * 10**9, 3 * 10**9)[i % 7]


@pytest.mark.parametrize('stamp', [whole_seconds, stuck, batches, backwards, all_sorts])
def test_a_relay_first(rig, joint_parameters, stamp):
    r = rig(joint_parameters)
    one = r.listen(RANGE, '/y3')
    two = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    sent = []
    for i in range(70):  # longer than max_age
        r.step()
        r.send(stamp(r, i), i, topic='/y3_raw')
        for names in (['elbow', 'wrist'], ['shoulder']):  # joint by joint, with one stamp
            message = JointState(name=names, position=[float(i)] * len(names))
            put_stamp(message, stamp(r, i))
            sent.append(r.raw(message))
            before = r.taken['/joint_states_raw']
            r.publisher(JointState, '/joint_states_raw').publish(sent[-1])
            assert r.spin_until(lambda due=before: r.taken['/joint_states_raw'] > due)
    assert r.spin_until(lambda: len(one) == 70 and len(two) == 140)
    assert [bytes(raw) for raw in two] == sent and r.values(one) == list(range(70))
    for told in r.told().values():
        assert told.source == 'real' and not told.reason and str(NOT_NEWER) not in told.counts


def test_a_clock_set_back_is_followed_at_once(rig, parameters, capfd):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    back = 100 * 10**9
    for _ in range(70):
        r.step(*r.healthy()[::2])
        r.send(r.now - back)
    r.isolate('y2')
    r.step(*r.healthy()[::2], periods=5)
    after = r.stamps(heard)[5:]
    assert len(after) == 70 + 5 + 1 and after[-1] == r.now - back and np.all(np.diff(after) > 0)
    assert capfd.readouterr().err.count('mend the clock of the driver') == 1


@pytest.mark.parametrize('every', [1, 3])
def test_a_late_driver_keeps_its_stamps(rig, joint_parameters, every):
    """All of a message is of the time of its stamp; truth: y1 = sin(2 t), y2 = 2 y1."""
    r = rig(joint_parameters)
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    sent = []

    def truth(stamp):
        return math.sin(2e-9 * (stamp % 10**12))

    def drive(count, failed=False):
        for _ in range(count):
            r.step(r.healthy()[2], periods=every)
            stamp = r.now - LATE
            _, arm = r.arm(truth(stamp), 99.0 if failed else 2.0 * truth(stamp), truth(stamp))
            put_stamp(arm, stamp)
            sent.append(stamp)
            before = r.taken['/joint_states_raw']
            r.publisher(JointState, '/joint_states_raw').publish(arm)
            assert r.spin_until(lambda due=before: r.taken['/joint_states_raw'] > due)
    drive(120)
    r.isolate('y2')
    drive(60, failed=True)
    assert r.told()['y2'].source == 'virtual'
    r.isolate()
    drive(30)
    r.spin()
    assert r.told()['y2'].source == 'real'
    messages = [decode(JointState, raw) for raw in heard]
    stamps = r.stamps(heard, JointState)
    assert stamps == sent[:len(stamps)] and len(stamps) >= len(sent) - 1
    for stamp, m in zip(stamps, messages):
        wrist, elbow, shoulder = m.position
        assert wrist == shoulder == truth(stamp)  # nothing is stamped anew
        assert elbow == pytest.approx(2.0 * truth(stamp), abs=3e-3)
    assert str(NOT_NEWER) not in r.told()['y1'].counts


def test_a_reset_after_a_failover_is_believed_soon(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    r.isolate()
    r.step(*r.healthy(), periods=20)
    before = len(heard)
    for _ in range(70):
        r.step(*r.healthy()[::2])
        r.send(r.now - 100 * 10**9, 4.0)
    r.spin()
    assert 17 <= len(heard) - before <= 21  # what came after max_age


def test_what_has_no_stamp_goes_on_as_it_is(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    for _ in range(3):
        r.send(0)
    assert r.spin_until(lambda: len(heard) == 3)
    r.isolate('y2')
    r.step(*r.healthy()[::2], periods=5)
    r.isolate()
    before = len(heard)
    assert before >= 3 + 4 and np.all(np.diff(r.stamps(heard)[3:]) > 0)
    r.send(0)
    assert r.spin_until(lambda: len(heard) == before + 1)
    assert ('y2', str(NOT_NEWER)) not in r.counts


@pytest.mark.parametrize('offset', [-3600 * 10**9, 3600 * 10**9])
def test_estimates_keep_the_clock_of_the_driver(rig, parameters, offset, capfd, monkeypatch):
    monkeypatch.setattr('vsensor_ros.node.log.QUIET', 0.0)
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    for _ in range(5):
        r.step(*r.healthy()[::2])
        r.send(r.now + offset)
    r.isolate('y2')
    r.step(*r.healthy(y1=0.75)[::2], periods=5)
    assert r.stamps(heard)[6:] == [r.now + offset - i * PERIOD for i in range(4, -1, -1)]
    r.isolate()
    r.step(*r.healthy()[::2])
    r.send(r.now + offset, 3.0)
    assert r.spin_until(lambda: r.values(heard)[-1] == 3.0)
    assert np.all(np.diff(r.stamps(heard)) > 0)
    said = capfd.readouterr().err
    assert said.count('the stamps on /y2_raw are') == 1
    assert f'{offset * 1e-9:+.1f} s from the clock' in said


def test_a_driver_that_restarts_with_an_earlier_clock_is_not_dead_for_ever(
        rig, parameters, capfd):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    r.isolate()
    before = len(heard)
    for _ in range(48):
        r.now += 9 * PERIOD
        r.step(*r.healthy()[::2])
        r.send(r.now - 100 * 10**9, 4.0)
    assert len(heard) == before
    assert 'not newer than what went out' in r.told()['y2'].reason
    for _ in range(10):
        r.now += 9 * PERIOD
        r.step(*r.healthy()[::2])
        r.send(r.now - 100 * 10**9, 4.0)
    r.spin()
    after = r.stamps(heard)[before:]
    assert 5 <= len(after) <= 10 and np.all(np.diff(after) > 0)
    assert capfd.readouterr().err.count('mend the clock of the driver') == 1
