"""Stamps increase strictly once something was replaced."""


import numpy as np
import pytest
from sensor_msgs.msg import Range

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
    assert r.replacer.counts['y2', 'not sent on: not newer than what went out'] == 3
    r.send(sent + 1, 8.0)
    assert r.spin_until(lambda: len(heard) == before + 1) and r.values(heard)[-1] == 8.0


def test_estimates_are_newer_than_the_newest_live_message(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    newest = r.now + 300_000_000
    r.send(newest)
    r.send(r.now + 1)
    assert r.spin_until(lambda: len(heard) == 7)
    r.isolate('y2')
    r.step(*r.healthy()[::2], periods=40)
    assert r.stamps(heard)[7:] == [newest + (i + 1) * PERIOD for i in range(10)]


def test_estimates_that_have_to_wait_are_said_to(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.send(r.now + 900_000_000)
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


def test_one_stamp_from_far_away_silences_nothing(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.send(r.now + 3600 * 10**9)
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    assert r.stamps(heard)[-5:] == [r.now - i * PERIOD for i in range(4, -1, -1)]


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
