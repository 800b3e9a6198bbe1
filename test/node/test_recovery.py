"""No step at a switch, one switch a fault, and when a sensor is believed again."""

from dataclasses import replace
import math

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import JointState, Range

from vsensor_ros.engine import Engine
from vsensor_ros.node.cdr import decode

RANGE = 'sensor_msgs/msg/Range'
LONG = 400  # periods, after which it is known how a virtual sensor and its sensor disagree


def started(rig, parameters, y2=1.2, **changes):
    """Start with a y2 that lies 0.2 above what y1 says of it, for long enough to know."""
    r = rig({**parameters, 'time_constant': 0.1, **changes})
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(y2=y2), periods=LONG)
    return r, heard


def test_the_step_is_spread_over_time_both_ways(rig, parameters):
    r, heard = started(rig, parameters)
    r.isolate('y2')
    r.step(*r.healthy(y2=99.0), periods=80)
    assert r.spin_until(lambda: len(heard) == LONG + 81)
    at = np.array(r.stamps(heard[LONG:])) * 1e-9
    at -= at[0]
    np.testing.assert_allclose(r.values(heard)[LONG:], 1.0 + 0.2 * np.exp(-at / 0.1) * (
        np.exp(-at / 0.1) >= 1e-3), atol=1e-6)
    told = r.told()['y2']
    assert told.switches == 1 and told.last_step == pytest.approx(0.0, abs=1e-6)
    r.isolate()
    r.step(*r.healthy(y2=1.2), periods=80)
    assert r.spin_until(lambda: len(heard) == LONG + 161)
    at = np.arange(80) * 0.01
    np.testing.assert_allclose(r.values(heard)[LONG + 81:], 1.2 - 0.2 * np.exp(-at / 0.1) * (
        np.exp(-at / 0.1) >= 1e-3), atol=1e-6)
    assert bytes(heard[-1]) == r.sent['/y2_raw'][-1]  # as it came, once nothing is left
    told = r.told()['y2']
    assert told.switches == 2 and told.last_step == pytest.approx(0.0, abs=1e-6)
    assert told.virtual_s == pytest.approx(0.8, abs=0.02)
    assert np.all(np.diff(r.stamps(heard)) > 0)


def test_a_sensor_healthy_until_isolated_steps_by_no_more_than_its_noise(rig, parameters):
    r = rig({**parameters, 'time_constant': 0.1})
    heard = r.listen(RANGE, '/y2')
    noise = 0.01 * np.random.default_rng(4).uniform(-1.0, 1.0, LONG)
    for n in noise:
        r.step(*r.healthy(y2=1.0 + n))
    r.isolate('y2')
    r.step(*r.healthy(y2=1.0), periods=5)
    r.isolate()
    r.step(*r.healthy(y2=1.0 + noise[0]), periods=5)
    assert r.spin_until(lambda: len(heard) == LONG + 11)
    values = np.array(r.values(heard))
    assert np.abs(np.diff(values[LONG - 1:])).max() <= 0.02


def test_what_a_fault_did_before_it_was_isolated_does_not_count(rig, parameters):
    r, heard = started(rig, parameters)
    r.step(*r.healthy(y2=50.0), periods=3)
    r.isolate('y2')
    r.step(*r.healthy(y2=50.0))
    first = r.values(heard)[LONG + 3]
    assert first == pytest.approx(1.2, abs=1e-6)
    assert r.told()['y2'].last_step == pytest.approx(first - 50.0)  # seen, and said


def test_a_plain_switch_steps(rig, parameters):
    r, heard = started(rig, parameters, time_constant=0.0)
    r.isolate('y2')
    r.step(*r.healthy())
    assert r.values(heard)[LONG] == 1.0
    assert r.told()['y2'].last_step == pytest.approx(-0.2, abs=1e-6)


def test_no_step_between_two_virtual_sensors(rig, parameters):
    r = rig({**parameters, 'time_constant': 0.1})
    heard = r.listen(RANGE, '/y1')
    r.command(2.0)
    r.step(*r.healthy(), periods=5)
    r.isolate('y1')
    r.step(*r.healthy(), periods=5)
    r.isolate('y1', 'y2')
    r.step(*r.healthy(), periods=5)
    assert r.spin_until(lambda: len(heard) >= 16)
    assert r.told()['y1'].fault_set == ('y1', 'y2') and r.told()['y1'].switches == 2
    assert np.abs(np.diff(r.values(heard)[5:])).max() < 0.03  # what a period changes, no more


def test_what_a_second_fault_did_to_an_estimate_is_not_carried_on(
        rig, parameters, plan, tmp_path):
    entry = plan[('y1',), 'y1']
    half_of_y2 = replace(entry, Q=np.array([[0.5, 0.0]]), Cv=np.zeros((1, 1)))
    path = tmp_path / 'design.json'
    replace(plan, entries={**plan.entries, (('y1',), 'y1'): half_of_y2}).save(path)
    r = rig({**parameters, 'design_file': str(path), 'time_constant': 1.0})
    heard = r.listen(RANGE, '/y1')
    r.command(0.5)
    r.step(*r.healthy(), periods=LONG)
    r.isolate('y1')
    r.step(*r.healthy(), periods=5)
    r.step(*r.healthy(y2=51.0), periods=2)
    r.isolate('y1', 'y2')
    r.step(*r.healthy(y2=51.0), periods=3)
    assert r.spin_until(lambda: len(heard) >= LONG + 10)
    values = np.array(r.values(heard))
    assert values[LONG + 5:].max() > 20.0  # nobody knew yet
    np.testing.assert_allclose(values[-3:], 0.5, atol=0.01)


def test_an_offset_fades_in_a_message_of_several(rig, joint_parameters):
    r = rig({**joint_parameters, 'time_constant': 0.1})
    heard = r.listen('sensor_msgs/msg/JointState', '/joint_states')
    r.step(r.arm(0.5, 1.2, 7.0), r.healthy()[2], periods=LONG)
    r.isolate('y2')
    r.step(r.arm(0.5, 99.0, 7.0), r.healthy()[2], periods=100)
    r.isolate()
    r.step(r.arm(0.5, 1.2, 7.0), r.healthy()[2], periods=10)
    assert r.spin_until(lambda: len(heard) == LONG + 111)
    sent = [decode(JointState, raw) for raw in heard[LONG:]]
    assert all(m.position[0] == 7.0 and m.position[2] == 0.5 for m in sent)
    elbow = np.array([m.position[1] for m in sent])
    assert np.abs(np.diff(elbow)).max() < 0.021 and elbow[100] == pytest.approx(1.0, abs=1e-9)
    assert elbow[101] == pytest.approx(1.0, abs=1e-9)
    assert elbow[110] == pytest.approx(1.2 - 0.2 * math.exp(-0.9), abs=1e-9)


def test_a_fault_that_toggles_makes_one_switch(rig, parameters, capfd):
    r = rig({**parameters, 'recovery.dwell': 0.2})
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    for _ in range(8):
        r.isolate('y2')
        r.step(*r.healthy(y2=9.0), periods=5)
        r.isolate()
        r.step(*r.healthy(y2=9.0), periods=10)
    told = r.told()['y2']
    assert told.source == 'virtual' and told.switches == 1
    assert told.recovering_s == pytest.approx(0.1, abs=0.02) and 9.0 not in r.values(heard)
    assert capfd.readouterr().err.count('faulty sensors') == 1
    r.step(*r.healthy(), periods=15)
    assert r.told()['y2'].source == 'real' and r.told()['y2'].switches == 2


def test_hold_latched_and_cleared(rig, parameters):
    r = rig({**parameters, 'recovery.policy': 'hold', 'sensors.y1.recovery': 'latched'})
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=3)
    with pytest.raises(ValueError, match='^y2: isolation still reports it faulty'):
        r.replacer.clear('y2')
    r.isolate()
    r.step(*r.healthy(), periods=20)
    assert r.told()['y2'].source == 'virtual'
    r.replacer.clear('y2')
    r.step(*r.healthy(), periods=2)
    assert r.told()['y2'].source == 'real'
    r.isolate('y1')
    r.isolate()
    r.step(*r.healthy(), periods=5)
    with pytest.raises(ValueError, match='^y1: is latched'):
        r.replacer.clear('y1')
    assert r.told()['y1'].source != 'real'
    r.replacer.reset()
    r.step(*r.healthy(), periods=5)
    assert r.told()['y1'].source == 'real'


def test_forced_and_released(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(y1=0.75, y2=1.0), periods=5)
    r.replacer.force('y2')
    r.step(*r.healthy(y1=0.75, y2=1.0), periods=5)
    told = r.told()['y2']
    assert told.forced and told.source == 'virtual' and r.values(heard)[-1] == 1.5
    r.replacer.release('y2')
    r.step(*r.healthy(y1=0.75, y2=1.0), periods=2)
    told = r.told()['y2']
    assert not told.forced and told.source == 'real' and r.values(heard)[-1] == 1.0
    with pytest.raises(ValueError, match='^y3: cannot be forced'):
        r.replacer.force('y3')


def test_nothing_serves_before_it_has_converged(rig, parameters, plan, tmp_path):
    """The virtual sensor of y1 forgets a start that nobody knows in ln(100) of its seconds."""
    slow = plan.entries[('y1',), 'y1']
    entries = {(('y1',), 'y1'): replace(
        slow, start=None, N=10.0 * slow.N, B=10.0 * slow.B, eigenvalues=10.0 * slow.eigenvalues)}
    replace(plan, entries=entries).save(tmp_path / 'design.json')
    r = rig({**parameters, 'design_file': str(tmp_path / 'design.json')})
    heard = r.listen(RANGE, '/y1')
    r.command(2.0)
    r.step(*r.healthy(), periods=20)
    r.isolate('y1')
    r.step(*r.healthy(y1=9.0), periods=10)
    told = r.told()['y1']
    assert told.source == 'none' and 'converging' in told.reason and len(heard) == 20
    r.step(*r.healthy(y1=9.0), periods=30)
    assert r.told()['y1'].source == 'virtual' and 9.0 not in r.values(heard)
    # the start was 1.75 away, and it is a period older than the first that was sent
    assert abs(r.values(heard)[20] - 2.0) < 0.0175
    r.replacer.reset()
    r.command(2.0)
    r.step(*r.healthy(y1=9.0), periods=5)
    assert r.told()['y1'].source == 'none'
    assert 'converging' in str(r.replacer.engine._bank.why_not(('y1',), 'y1'))


def test_an_estimate_too_uncertain_is_not_sent(rig, parameters):
    r = rig({**parameters, 'sensors.y2.max_deviation': 0.05})
    heard = r.listen(RANGE, '/y2')
    for n in np.random.default_rng(1).uniform(-0.01, 0.01, LONG):
        r.step(*r.healthy(y1=0.5 + n))  # of which the estimate has twice as much
    r.isolate('y2')
    r.step(*r.healthy(), periods=3)
    told = r.told()['y2']
    # 0.02 / sqrt(3) = 0.0115, and a bound of it after so little
    assert told.source == 'virtual' and 0.01 < told.deviation < 0.017
    assert decode(Range, heard[-1]).variance == pytest.approx(told.deviation ** 2, rel=1e-6)
    count = len(heard)
    r.replacer.apply(replace(r.replacer.settings.live, max_deviation={
        'y1': 0.0, 'y2': 0.004, 'y3': 0.0}))
    r.step(*r.healthy(), periods=3)
    told = r.told()['y2']
    assert told.source == 'none' and 'max_deviation' in told.reason and len(heard) == count


def test_by_default_an_estimate_beyond_a_tenth_of_the_range_is_not_sent(
        rig, parameters, plan, tmp_path):
    replace(plan, ranges={'y2': (-0.05, 0.05)}).save(tmp_path / 'design.json')
    r = rig({**parameters, 'design_file': str(tmp_path / 'design.json')})
    heard = r.listen(RANGE, '/y2')
    for n in np.random.default_rng(1).uniform(-0.01, 0.01, LONG):
        r.step(*r.healthy(y1=0.5 + n))  # as above: it is good to more than 0.01
    before = r.told()['y2'].reserve
    assert before.code == 'beyond a tenth of the range' and before.fact('limit') == 0.01
    r.isolate('y2')
    r.step(*r.healthy(), periods=3)
    told = r.told()['y2']
    assert told.source == 'none' and 'above a tenth of the range, 0.01' in str(told.reason)
    assert r.spin_until(lambda: len(heard) == LONG)
    limits = {'y1': None, 'y2': 0.0, 'y3': None}
    r.replacer.apply(replace(r.replacer.settings.live, max_deviation=limits))
    r.step(*r.healthy(), periods=3)
    assert r.told()['y2'].source == 'virtual'


def test_a_silent_sensor_is_replaced_when_that_is_wanted(rig, parameters):
    r = rig({**parameters, 'sensors.y2.silent': 'replace', 'sensors.y2.max_age': 0.1})
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=10)
    r.step(*r.healthy(y1=0.75)[::2], periods=9)
    assert r.told()['y2'].source == 'real' and len(heard) == 10
    r.step(*r.healthy(y1=0.75)[::2], periods=10)
    told = r.told()['y2']
    assert told.source == 'virtual' and 'silent' in told.reason and r.values(heard)[-1] == 1.5
    assert told.offset == 0.0
    r.step(*r.healthy(y1=0.75), periods=5)
    assert r.told()['y2'].source == 'real' and r.values(heard)[-1] == 1.0
    assert r.told()['y3'].source == 'real'
    assert np.all(np.diff(r.stamps(heard)) > 0)


def said_of(raw, *keys):
    """Return what a message on ~/estimates says of each channel with these keys, all of them."""
    facts = {s.name: (s.message, {v.key: float(v.value) for v in s.values})
             for s in decode(DiagnosticArray, raw).status}
    return {name: said for name, said in facts.items() if list(said[1]) == list(keys)}


def test_what_went_out_is_told_to_who_listens(rig, parameters):
    r, heard = started(rig, parameters)
    told = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/replacer/estimates',
                    ReliabilityPolicy.BEST_EFFORT)
    r.step(*r.healthy(y2=1.2), periods=2)
    keys = 'value', 'deviation', 'offset'
    assert not [raw for raw in told if said_of(raw, *keys)]
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    assert r.spin_until(lambda: len([raw for raw in told if said_of(raw, *keys)]) == 6)
    for said, raw in zip(filter(None, (said_of(raw, *keys) for raw in told)), heard[LONG + 2:]):
        (name, (_, facts)), = said.items()
        assert name == 'y2' and facts['value'] == pytest.approx(
            decode(Range, raw).range, abs=1e-6)
        assert facts['value'] - facts['offset'] == pytest.approx(1.0, abs=1e-9)
        assert math.isfinite(facts['deviation'])
    assert r.replacer.snapshot().estimates == 6


def test_reserves_are_told_beside_the_readings_while_somebody_listens(rig, parameters,
                                                                      monkeypatch):
    asked = []
    reserves = Engine.reserves
    monkeypatch.setattr(Engine, 'reserves', lambda engine: asked.append(1) or reserves(engine))
    r, _ = started(rig, parameters)
    assert not asked  # nobody listens, nothing is computed
    told = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/replacer/estimates',
                    ReliabilityPolicy.BEST_EFFORT)
    assert r.spin_until(lambda: r.replacer.estimates.listeners())
    r.command(0.5)
    r.step(*r.healthy(y2=1.2), periods=40)  # y2 is off by 0.2 of what y1 says
    keys = 'reading', 'reserve', 'reserve_deviation'
    assert r.spin_until(lambda: len(told) > 5)
    said = said_of(told[-1], *keys)
    assert set(said) == {'y1', 'y2'}  # y3 has none
    message, facts = said['y2']
    assert message == 'reserve' and facts['reading'] == pytest.approx(1.2)
    assert facts['reserve'] == pytest.approx(1.0) and math.isfinite(facts['reserve_deviation'])
    rehearsed = r.told()['y2'].rehearsed
    assert rehearsed.mean == pytest.approx(0.2) and rehearsed.seconds > 1.0
    r.isolate('y2')
    r.step(*r.healthy(), periods=20)
    assert r.spin_until(lambda: 'y2' in said_of(told[-1], 'value', 'deviation', 'offset') or
                        set(said_of(told[-1], *keys)) == {'y1'})
    assert 'y2' not in said_of(told[-1], *keys)  # there is nothing that it is a reserve of
