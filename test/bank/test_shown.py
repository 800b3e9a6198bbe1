"""Sensors that show an offset or a curve, and dead times: beside the simulated truth."""

from dataclasses import replace

import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant
from vsensor_ros.bank import Bank
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse
from vsensor_ros.simulate.simulate import readings, simulate

CART = """
name: cart
time: continuous
states: {pos: {unit: m}, vel: {unit: m/s}}
inputs: {force: {unit: N}}
dynamics: {pos: vel, vel: force/2 - 0.5*vel}
sensors:
  encoder: {measures: 4 + 2*pos, unit: m, noise: 0.001}
  tacho: {measures: vel - 1, unit: m/s, noise: 0.001}
"""

BATTERY = """
name: battery
time: continuous
states: {soc: {range: [0.05, 1], initial: 0.8, process_noise: 1e-6}}
inputs: {current: {unit: A, range: [-20, 20]}}
dynamics: {soc: -current/3600}
sensors:
  voltage: {measures: 3.2 + 0.7*soc + 0.1*log(soc) - 0.05*current, unit: V, noise: 0.001}
  gauge: {measures: 100*soc, noise: 0.1}
"""

RELAXING = """
name: relaxing_battery
time: continuous
states: {ocv: {unit: V, range: [3.2, 4], initial: 3.9, process_noise: 1e-5}, u1: {unit: V}}
inputs: {current: {unit: A, range: [-20, 20], operating: 5}}
dynamics: {ocv: -current/3600/(2*(ocv - 3)), u1: 0.01*current/5 - u1/5}
sensors:
  voltage: {measures: ocv - u1 - 0.01*current, unit: V, noise: 0.001}
  gauge: {measures: 100*(ocv - 3)**2, noise: 0.1}
operating_point: {ocv: 3.8, u1: 0.05}
"""

RATE = 50.0


def loaded(tmp_path, text):
    path = tmp_path / 'plant.yaml'
    path.write_text(text)
    return load_plant(path)


def played(plant, found, t, u, lost, at, fault_set=None):
    """Return truth and estimate of a sensor from when it is isolated, as readings come in."""
    x = simulate(plant, t, u)
    y = readings(plant, t, x, u)
    bank = Bank(found, RATE)
    said = np.full(len(t), np.nan)
    for k, stamp in enumerate(np.rint(t * 1e9).astype(int)):
        for name, value in zip((*plant.sensors, *plant.inputs), (*y[k], *u[k])):
            bank.take(name, int(stamp), float(value))
        bank.advance(int(stamp))
        if k == at:
            bank.distrust([lost])
        value = bank.estimate((lost,), lost) if k > at else None
        said[k] = np.nan if value is None else value
    return y[at + 1:, plant.sensors.index(lost)], said[at + 1:], bank


@pytest.mark.parametrize('lost', ['encoder', 'tacho'])
def test_what_goes_out_has_the_offset_of_the_sensor(tmp_path, lost):
    plant = loaded(tmp_path, CART)
    assert plant.C.tolist() == [[2, 0], [0, 1]]
    assert [plant.curves[s].offset for s in plant.sensors] == [4, -1]
    design(plant).save(tmp_path / 'd.json')
    t = np.arange(400) / RATE
    truth, said, bank = played(plant, Design.load(tmp_path / 'd.json'), t,
                               2 + np.sin(t)[:, None], lost, 300)
    assert np.abs(said - truth).max() < 0.01
    assert abs(bank.residual((lost,), lost)) < 0.01


@pytest.mark.parametrize('lost', ['voltage', 'gauge'])
def test_a_curve_is_inverted_where_readings_come_in_and_applied_on_the_way_out(tmp_path, lost):
    plant = loaded(tmp_path, BATTERY)
    at = 0.7 + 0.1 / 0.8  # slope at the operating point
    assert plant.C[:, 0] == pytest.approx([at, 100])
    assert plant.Cu[:, 0] == pytest.approx([-0.05, 0])
    design(plant).save(tmp_path / 'd.json')
    t = np.arange(1500) / RATE
    u = np.where(t % 4 < 2, 20.0, 5.0)[:, None]
    plant = load_plant(tmp_path / 'plant.yaml')
    full = played(plant, Design.load(tmp_path / 'd.json'), t, u, lost, 1000)
    truth, said, bank = full
    assert np.ptp(truth) > 0.3 if lost == 'gauge' else np.ptp(truth) > 0.7
    assert np.abs(said - truth).max() < (1e-4 if lost == 'voltage' else 1e-2)


def test_deviations_are_as_steep_as_the_curve(tmp_path):
    text = BATTERY.replace('initial: 0.8', 'initial: 0.1')
    plant = loaded(tmp_path, text.replace('dynamics:', 'operating_point: {soc: 0.8}\ndynamics:'))
    t = np.arange(300) / RATE
    _, _, bank = played(plant, design(plant), t, np.zeros((300, 1)), 'voltage', 200)
    curve = plant.curves['voltage']
    assert curve.slope(curve.linear(3.2 + 0.7 * 0.1 + 0.1 * np.log(0.1))) == pytest.approx(
        (0.7 + 0.1 / 0.1) / (0.7 + 0.1 / 0.8), rel=1e-3)
    flat = design(loaded(tmp_path, text.replace('initial: 0.1', 'initial: 0.8')))
    assert bank.deviation(('voltage',), 'voltage') == pytest.approx(
        flat['voltage', 'voltage'].noise.error * 1.7 / 0.825, rel=0.2)


@pytest.mark.parametrize(('measures', 'needle'), [
    ('(soc - 0.5)**2', 'cannot be inverted: it does not rise, or fall, all over'),
    ('log(soc) + aux', 'cannot be inverted: aux is added to a curve of soc, and is not known'),
    ('log(soc)*current', 'no curve of one linear combination'),
    ('1/(soc - 0.5)', 'cannot be inverted'),
])
def test_what_cannot_be_inverted_is_said_and_no_linear_map_uses_it(tmp_path, measures, needle):
    text = BATTERY.replace('states: {', 'states: {aux: {range: [0, 1]}, ').replace(
        'dynamics: {', 'dynamics: {aux: -aux, ')
    before = '3.2 + 0.7*soc + 0.1*log(soc) - 0.05*current'
    assert before in text
    plant = loaded(tmp_path, text.replace(before, measures))
    [said] = [remark for remark in plant.remarks if remark.startswith('voltage is nonlinear')]
    assert needle in said and '; ' in said
    assert 'bend_of_voltage' in design(plant, method='jordan')['voltage', 'voltage'].reason


@pytest.mark.parametrize('measures', ['(soc - 0.5)**2', '1/(soc - 0.5)'])
def test_what_cannot_be_inverted_is_had_from_a_healthy_sensor_at_once(tmp_path, measures):
    before = '3.2 + 0.7*soc + 0.1*log(soc) - 0.05*current'
    found = design(loaded(tmp_path, BATTERY.replace(before, measures)))['voltage', 'voltage']
    assert found.z == () and 'bend_of_voltage' in found.why
    said = Equations([parse(found.out)], ['gauge']).values(np.array([[20.0, 70.0]]))
    true = Equations([parse(measures)], ['soc']).values(np.array([[0.2, 0.7]]))
    assert np.allclose(said, true)


LATE = """
name: late
time: continuous
states: {a: {process_noise: 0.1}, b: {process_noise: 0.001}}
inputs: {u: {delay: 0.2}}
dynamics: {a: 3*u - 2*a, b: a - b}
sensors:
  first: {measures: a, noise: 0.001, delay: 0.06, stamp_offset: 0.04}
  second: {measures: b, noise: 0.001}
"""
LATE_SAMPLED = LATE.replace('continuous', '{sample_time: 0.02}').replace(
    '3*u - 2*a', '0.06*u + 0.96*a').replace('a - b', '0.02*a + 0.98*b').replace(
    ', stamp_offset: 0.04', '')


# of a continuous plant a late reading is held until the next one comes
@pytest.mark.parametrize(('text', 'lost', 'error'), [
    (LATE, 'first', 5e-3), (LATE, 'second', 0.03),
    (LATE_SAMPLED, 'first', 1e-9), (LATE_SAMPLED, 'second', 1e-9)])
def test_dead_times_are_held_in_the_bank(tmp_path, designed, text, lost, error):
    plant = loaded(tmp_path, text)
    sampled = plant.sample_time is not None
    assert plant.delays() == pytest.approx(
        {'u': 0.2} if sampled else {'u': 0.2, 'first': 0.1})
    found = designed(plant)
    assert set(found[lost, lost].reads) == {'first', 'second'} - {lost}
    found.save(tmp_path / 'd.json')
    t = np.arange(800) / RATE
    u = np.where(t % 3 < 1.5, 1.0, -1.0)[:, None]
    truth, said, bank = played(plant, Design.load(tmp_path / 'd.json'), t, u, lost, 500)
    assert np.ptp(truth) > 0.5
    assert np.abs(said - truth).max() < error
    # without the dead times in the design it is far off
    blind = designed(loaded(tmp_path, text.replace('delay: 0.2', '').replace(
        ', delay: 0.06', '').replace(', stamp_offset: 0.04', '')))
    assert np.abs(played(plant, blind, t, u, lost, 500)[1] - truth).max() > 0.02


def test_what_is_later_than_states_are_kept_is_refused(tmp_path):
    text = LATE.replace('delay: 0.06, stamp_offset: 0.04', 'delay: 20')
    late = design(loaded(tmp_path, text))
    with pytest.raises(ValueError, match='first: is 20 s late, 1000 steps at 50 Hz, of which 1000 '
                       'are kept; lower the rate'):
        Bank(late, RATE)
    Bank(late, 20.0)


def test_a_late_sensor_is_silent_as_soon_as_a_prompt_one(tmp_path):
    bank = Bank(design(loaded(tmp_path, LATE)), RATE)
    for name in ('first', 'second', 'u'):
        assert bank.take(name, 10**9, 1.0) is None
    bank.advance(10**9)
    for late in (400_000_000, 600_000_000):
        assert [bank.silent(name, 10**9 + late) for name in ('first', 'second')] == \
            [late > 500_000_000] * 2


def test_what_wraps_has_no_curve_but_an_offset(tmp_path):
    found = design(loaded(tmp_path, BATTERY))
    with pytest.raises(ValueError, match='voltage: shows a curve, and wraps; write it without'):
        Bank(replace(found, wrap=({'voltage': 6.28},)), RATE)


def test_a_curve_beside_a_second_state_becomes_a_state_itself(tmp_path):
    """Of soc' = -I/3600 with 3 + sqrt(soc) - u1 - 0.01 I to be seen, as the docs say to write."""
    found = design(loaded(tmp_path, RELAXING), [('gauge',)])
    rate = 20.0
    bank = Bank(found, rate)
    soc, u1, worst = 0.81, 0.0, 0.0
    for k in range(int(60 * rate)):
        stamp, current = round(k / rate * 1e9), 15.0 if k > 10 * rate else 2.0
        for name, value in (('current', current), ('gauge', 100 * soc),
                            ('voltage', 3 + np.sqrt(soc) - u1 - 0.01 * current)):
            bank.take(name, stamp, value)
        bank.advance(stamp)
        if k == int(30 * rate):
            bank.distrust(['gauge'])
        if k > 40 * rate:
            worst = max(worst, abs(bank.estimate(('gauge',), 'gauge') - 100 * soc))
        soc -= current / 3600 / rate
        u1 = 0.01 * current + (u1 - 0.01 * current) * np.exp(-0.2 / rate)
    assert soc < 0.65 and worst < 0.1
