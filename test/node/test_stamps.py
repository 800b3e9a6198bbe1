"""What goes out of one driver has stamps that increase strictly, live or estimated."""

import numpy as np
import pytest
from sensor_msgs.msg import JointState, Range

from vsensor_ros.engine.stream import FROM_THE_FUTURE, NOT_NEWER
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
    r.send(r.now + 1)  # late, and not sent on
    assert r.spin_until(lambda: len(heard) == 6)
    r.isolate('y2')
    r.step(*r.healthy()[::2], periods=40)
    assert r.stamps(heard)[6:] == [newest + (i + 1) * PERIOD for i in range(20)]


def test_estimates_that_have_to_wait_are_said_to(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    for i in range(3):  # more than a mistake
        r.send(r.now + 900_000_000 + i)
    r.isolate('y2')
    r.step(*r.healthy()[::2], periods=80)
    r.spin()
    assert len(heard) == 6 and r.told()['y2'].source == 'none'
    assert 'not newer than what went out' in r.told()['y2'].reason
    r.step(*r.healthy()[::2], periods=20)
    r.spin()
    assert len(heard) > 6 and r.told()['y2'].source == 'virtual'


def test_old_messages_among_new_ones_are_never_believed(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    r.isolate()
    for _ in range(14):
        r.now += 49 * PERIOD
        r.step(*r.healthy()[::2])
        r.send(r.now)
        r.send(r.now - 10**9, 9.0)
    assert r.spin_until(lambda: len(heard) == 25)
    assert 9.0 not in r.values(heard)


@pytest.mark.parametrize('isolated', [False, True])
def test_one_stamp_from_far_away_silences_for_max_age_at_most(rig, parameters, isolated):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.send(r.now + 3600 * 10**9)
    r.step(*r.healthy(), periods=5)
    assert r.spin_until(lambda: len(heard) == 1)
    if isolated:
        r.isolate('y2')
    r.step(*r.healthy(), periods=40)
    assert len(heard) == 1
    r.step(*r.healthy(), periods=10)
    assert r.spin_until(lambda: len(heard) >= 5)
    assert r.stamps(heard)[-4:] == [r.now - i * PERIOD for i in range(3, -1, -1)]


@pytest.mark.parametrize('ahead', [900_000_000, 100 * 10**9])
def test_a_single_stamp_from_the_future_does_no_harm(rig, parameters, ahead):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.send(r.now + ahead, 7.0)
    r.step(*r.healthy(), periods=5)
    assert r.spin_until(lambda: len(heard) == 10)
    assert r.counts['y2', str(FROM_THE_FUTURE)] == 1
    r.send(r.now + ahead, 7.0)  # the last thing it says
    r.isolate('y2')
    r.step(*r.healthy()[::2], periods=5)
    assert r.spin_until(lambda: len(heard) == 16) and 7.0 not in r.values(heard)
    assert r.stamps(heard)[-5:] == [r.now - i * PERIOD for i in range(4, -1, -1)]


def test_live_messages_increase_strictly_before_anything_has_failed(rig, joint_parameters):
    r = rig(joint_parameters)
    one = r.listen(RANGE, '/y3')
    two = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    topic, arm = r.arm(0.5, 1.0)
    r.step((topic, arm), r.healthy()[2], periods=5)
    for late in (0, 10**6, 0, 5 * 10**8, 2 * 10**9, 3 * 10**9):
        r.send(r.now - late, topic='/y3_raw')
        put_stamp(arm, r.now - late)
        before = r.taken[topic]
        r.publisher(JointState, topic).publish(arm)
        assert r.spin_until(lambda due=before: r.taken[topic] > due)
    r.send(r.now + 1, topic='/y3_raw')
    r.step((topic, arm), r.healthy()[2], periods=60)  # longer than max_age
    r.spin()
    assert len(one) == 5 + 1 + 60 and len(two) == 5 + 60
    assert np.all(np.diff(r.stamps(one)) > 0) and np.all(np.diff(r.stamps(two, JointState)) > 0)
    counts = r.counts
    assert counts['y3', str(NOT_NEWER)] == counts['y1', str(NOT_NEWER)] == 6


def test_a_clock_set_back_is_believed_after_max_age(rig, parameters, capfd):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    stopped = r.now - 5 * 10**9
    for i in range(60):  # neither stands a clock still, nor does it run backwards
        r.step(*r.healthy()[::2])
        r.send(stopped - max(0, i - 30) * PERIOD)
    assert len(heard) == 5
    r.step(*r.healthy(), periods=2)
    assert r.spin_until(lambda: len(heard) == 7)
    back = 100 * 10**9
    for _ in range(70):
        r.step(*r.healthy()[::2])
        r.send(r.now - back)
    r.spin()
    after = r.stamps(heard)[7:]
    assert 15 <= len(after) <= 20 and after[-1] == r.now - back and np.all(np.diff(after) > 0)
    assert capfd.readouterr().err.count('mend the clock of the driver') == 1


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
