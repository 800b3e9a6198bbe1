"""What goes out for a failed sensor."""

import math

import numpy as np
import pytest
from sensor_msgs.msg import Range
from std_msgs.msg import Float64

from vsensor_ros.node.accessor import get_stamp
from vsensor_ros.node.cdr import decode
from vsensor_ros.observers import Noise

RANGE = 'sensor_msgs/msg/Range'
PERIOD = 10_000_000  # ns, of the bank and of the sensors


def test_a_frozen_sensor_is_replaced_at_the_rate_and_comes_back(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y1')
    for _ in range(2):
        r.command(2.0)
        r.step(*r.healthy())
    r.step(*r.healthy(), periods=8)
    assert len(heard) == 10
    r.isolate('y1')
    r.step(*r.healthy(y1=7.7), periods=30)  # it goes on sending what is wrong
    assert r.spin_until(lambda: len(heard) == 41)  # one at once, then one a tick
    virtual = [decode(Range, raw) for raw in heard[10:]]
    at = np.array([get_stamp(m) for m in virtual])
    assert np.all(np.diff(at[1:]) == PERIOD)
    assert get_stamp(decode(Range, heard[9])) < at[0] < at[1]
    # the truth between any two of them, with the command at 2; float32 on the wire
    z = np.array([m.range for m in virtual])
    truth = 2.0 + (z[0] - 2.0) * np.exp(-(at - at[0]) * 1e-9)
    np.testing.assert_allclose(z, truth, atol=1e-6)
    for m in virtual:
        assert (m.header.frame_id, m.min_range, m.max_range) == (
            'frame of y1', -1e6, 1e6)
    r.isolate()
    r.step(*r.healthy(y1=1.25))
    assert r.spin_until(lambda: len(heard) == 42)
    assert bytes(heard[41]) == r.sent['/y1_raw'][-1]
    assert np.all(np.diff(r.stamps(heard)) > 0)


def test_a_sensor_that_drops_out_is_replaced(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(y1=0.5, y2=1.0), periods=5)
    r.isolate('y2')
    rest = r.healthy(y1=0.75)
    r.step(rest[0], rest[2], periods=100)  # far longer than max_age
    assert r.spin_until(lambda: len(heard) == 106)
    assert r.values(heard[-90:]) == [1.5] * 90
    assert np.all(np.diff(r.stamps(heard)) > 0)
    assert decode(Range, heard[-1]).header.frame_id == 'frame of y2'


def test_an_estimate_without_its_reading_is_not_sent(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(r.healthy()[2], periods=60)  # y1 says nothing for longer than max_age
    assert 51 <= len(heard) - 5 <= 53
    said = r.why('y2')
    assert 'y1 silent' in said


@pytest.mark.parametrize('action', ['stop', 'hold', 'nan', 'pass'])
@pytest.mark.parametrize('faulty', [('y3',), ('y1', 'y3')])  # a refusal; a set without a design
def test_what_cannot_be_replaced(rig, parameters, action, faulty):
    r = rig({**parameters, 'without_estimate': action})
    heard = r.listen(RANGE, '/y3')
    r.step(*r.healthy(y3=4.0), periods=5)
    r.isolate(*faulty)
    r.step(*r.healthy(y3=99.0), periods=10)
    r.spin()
    after = heard[5:]
    if action == 'stop':
        assert not after
    elif action == 'hold':
        assert r.values(after) == [4.0] * 11
    elif action == 'nan':
        assert len(after) == 11 and all(math.isnan(v) for v in r.values(after))
    else:
        assert r.values(after) == [99.0] * 10
        assert [bytes(raw) for raw in after] == r.sent['/y3_raw'][5:]
    assert np.all(np.diff(r.stamps(heard)) > 0)
    last = r.told()
    assert last['y3'].source == 'none' and last['y2'].source == 'real'
    assert ('does not depend' if faulty == ('y3',) else 'y1, y3') in last['y3'].reason
    assert math.isnan(last['y3'].value) and last['y3'].serves is None


def test_the_exact_set_is_looked_up(rig, parameters):
    r = rig(parameters)
    y1, y2 = r.listen(RANGE, '/y1'), r.listen(RANGE, '/y2')
    r.command(2.0)
    r.step(*r.healthy(), periods=5)
    r.isolate('y1', 'y2')
    r.step(*r.healthy(y1=99.0, y2=99.0), periods=5)
    assert r.spin_until(lambda: len(y1) == 11)
    assert len(y2) == 5 and 99.0 not in r.values(y1)
    r.isolate('y2')  # y1 is back, y2 is now replaced from it
    r.step(*r.healthy(y1=0.5, y2=99.0), periods=60)
    assert r.values(y2)[-1] == 1.0 and 99.0 not in r.values(y2)


def test_ticks_that_were_missed_are_made_good(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(y1=0.75), periods=5)
    r.isolate('y2')
    r.now += 4 * PERIOD
    r.step(*r.healthy(y1=0.75))
    assert r.spin_until(lambda: len(heard) == 11)
    assert np.all(np.diff(r.stamps(heard)[6:]) == PERIOD)
    assert r.replacer.snapshot().jumps == {}
    r.now += 29 * PERIOD  # too many: the newest will do
    r.step(*r.healthy(y1=0.75))
    assert len(heard) == 12 and r.stamps(heard)[-1] == r.now
    assert r.replacer.snapshot().left_out == 29


def test_types_without_a_header(rig, parameters):
    given = {**parameters, 'sensors.y1.type': 'std_msgs/msg/Float64', 'sensors.y1.field': 'data'}
    r = rig(given)
    heard = r.listen('std_msgs/msg/Float64', '/y1')
    r.command(3.0)
    r.step(*r.healthy()[1:], periods=3)
    r.isolate('y1')  # it has never said anything
    r.step(*r.healthy()[1:], periods=5)
    assert r.spin_until(lambda: len(heard) == 6)  # the tick before the isolation, and five
    z = np.array([decode(Float64, raw).data for raw in heard])
    np.testing.assert_allclose(
        z, 3.0 + (z[0] - 3.0) * np.exp(-np.arange(6) * 0.01), atol=1e-12)


def test_no_template_no_message(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y1')
    r.command(3.0)
    r.step(*r.healthy()[1:], periods=3)
    r.isolate('y1')
    r.step(*r.healthy()[1:], periods=5)
    assert not heard and 'ever seen' in r.why('y1')


def test_from_no_source_back_to_a_virtual_one(rig, parameters):
    r = rig({**parameters, 'without_estimate': 'hold'})
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(y1=0.5, y2=1.0), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(y1=0.75), periods=5)
    r.step(*r.healthy()[2:], periods=60)
    r.spin()
    assert r.told()['y2'].source == 'none'
    assert r.values(heard)[-1] == 1.5  # the last estimate, not the last reading
    r.step(*r.healthy(y1=0.25), periods=5)
    assert 'ready again' in r.why('y2')
    r.step(*r.healthy(y1=0.25), periods=50)
    r.spin()
    assert r.told()['y2'].source == 'virtual' and r.values(heard)[-1] == 0.5


def test_there_may_be_nothing_to_hold(rig, parameters):
    r = rig({**parameters, 'without_estimate': 'hold',
             'sensors.y3.type': 'std_msgs/msg/Float64', 'sensors.y3.field': 'data'})
    heard = r.listen('std_msgs/msg/Float64', '/y3')
    r.step(*r.healthy()[:2], periods=3)
    r.isolate('y3')
    r.step(*r.healthy()[:2], periods=3)
    assert not heard and 'nothing goes out' in r.why('y3')


def test_a_tick_waits_for_the_readings_of_its_time(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(y1=0.5), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(y1=0.5), periods=2)
    before = len(heard)
    r.step()  # the clock is there first
    assert len(heard) == before
    for topic, value in (('/y1_raw', 0.75), ('/y3_raw', 0.0)):
        r.send(r.now, value, topic)
    assert r.spin_until(lambda: len(heard) == before + 1)
    assert r.stamps(heard)[-1] == r.now and r.values(heard)[-1] == 1.5


def test_a_driver_that_sends_nothing_but_nan_is_silent(rig, parameters):
    r = rig(parameters)
    r.step(*r.healthy(), periods=5)
    r.step(*r.healthy(y2=math.nan), periods=2)
    assert r.told()['y2'].source == 'real'  # one may happen
    r.step(*r.healthy(y2=math.nan), periods=58)
    told = r.told()['y2']
    assert told.source == 'silent' and told.reason == 'nothing but NaN arrives on /y2_raw'
    r.step(*r.healthy())
    assert r.told()['y2'].source == 'real'


def test_the_variance_counts_an_offset_that_may_be_the_fault(rig, bench, tmp_path):
    """Nothing was measured yet, so that all of the last reading's 0.3 may be the fault."""
    path = tmp_path / 'twice.json'
    bench.design(bench.virtual_sensor([], [], Q=[[2.0]], fault_set=('y2',), healthy=('y1',),
                                      noise=Noise(0.1, 0.1, True)), names=('y1', 'y2')).save(path)
    given = {'design_file': str(path), 'rate': 100.0, 'time_constant': 0.5}
    for name in ('y1', 'y2'):
        given.update({f'sensors.{name}.topic': f'/{name}', f'sensors.{name}.field': 'range',
                      f'sensors.{name}.type': RANGE, f'sensors.{name}.max_deviation': 0.0})
    r = rig(given)
    heard = r.listen(RANGE, '/y2')
    both = r.healthy(y1=0.5, y2=1.3)[:2]
    r.step(*both, periods=20)
    r.isolate('y2')
    r.step(*both, periods=12)
    assert r.spin_until(lambda: len(heard) >= 32)
    first, last = (decode(Range, raw) for raw in (heard[20], heard[31]))
    assert first.range > 1.25 and first.variance > 0.25**2
    assert 0.0 < last.variance < 0.04
