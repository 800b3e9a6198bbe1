"""Sensor and actuator faults of a plant that moves, estimated in the bank beside its truth."""

import json

import numpy as np
import pytest

from benchmark.twin_rotor import command, faults, moved, PLANT, SAMPLE
from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import Bank
from vsensor_ros.designer.fault_design import fault_design
from vsensor_ros.observers import Design
from vsensor_ros.plant import load_takagi_sugeno

pytest.importorskip('cvxpy')

CART = """
name: cart
time: {sample_time: 0.05}
states:
  p: {unit: m, noise_bound: 0.002}
  v: {unit: m/s, range: [-3, 3], noise_bound: 0.002}
inputs: {push: {range: [-2, 2]}}
sensors:
  ruler: {measures: p, unit: m, noise_bound: 0.01}
  tacho: {measures: v, unit: m/s, noise_bound: 0.01}
premises: {p: [-2, 2]}
submodels:
  - {A: [[1, 0.05], [-0.1, 0.9]], B: [0, 0.05], membership: (2 - p)/4}
  - {A: [[1, 0.05], [-0.02, 0.98]], B: [0, 0.05], membership: (2 + p)/4}
"""
LOST, STEP = ('tacho',), 50_000_000


@pytest.fixture(name='plant', scope='module')
def _plant(tmp_path_factory):
    path = tmp_path_factory.mktemp('cart') / 'cart.yaml'
    path.write_text(CART)
    return load_takagi_sugeno(path)


@pytest.fixture(name='made', scope='module')
def _made(plant):
    return fault_design(plant, ['tacho'], [0.1])


def cart(made, steps, *, fault=lambda k: 0.0, push=lambda k: 1.2 * np.sin(0.1 * k), skip=(),
         mute=(), late=lambda k: 0.0):
    """
    Yield step, bank, truth (p, v) of the cart.

    skip, mute: steps without a reading of ruler, tacho; late: samples by which readings are.
    """
    rng, bank, x = np.random.default_rng(0), Bank(made, 20.0), np.array([0.5, 0.0])
    for k in range(steps):
        w = rng.normal(size=4)
        w *= np.sqrt(0.5) / np.linalg.norm(w)
        h = np.clip((2 - x[0]) / 4, 0, 1)
        A = h * np.array([[1, 0.05], [-0.1, 0.9]]) + (1 - h) * np.array([[1, 0.05], [-0.02, 0.98]])
        ahead = A @ x + np.array([0.0, 0.05]) * push(k) + 0.002 * w[:2]
        readings = x + late(k) * (ahead - x) + 0.01 * w[2:] + [0.0, fault(k)]
        stamp = round((k + late(k)) * STEP)
        bank.take('push', k * STEP, push(k))
        if k not in skip:
            bank.take('ruler', stamp, readings[0])
        if k not in mute:
            bank.take('tacho', stamp, readings[1])
        bank.advance(k * STEP)
        yield k, bank, x
        x = ahead


def test_truth_is_in_the_interval_from_the_start_on_whatever_the_fault(made):
    entry, served, widths, said = made.entries[LOST, 'tacho'], 0, [], []
    for k, bank, x in cart(made, 400, fault=lambda k: 9.0 * np.sin(k * k)):
        if k == 150:
            bank.distrust(LOST, k * STEP)
        low, high = bank.interval(LOST, 'tacho')
        assert low <= x[1] <= high
        served += k > 200 and bank.ready(LOST, 'tacho')
        widths.append((high - low) / 2)
        said.append(bank.estimate(LOST, 'tacho'))
        if k > 200:
            # of the reading that is not believed: the fault, and the noise of its reading
            off = bank.residual(LOST, 'tacho') - 9.0 * np.sin(k * k)
            assert abs(off) <= entry.half_widths[0] + 0.01
    assert served == 199
    assert widths[0] > 2 * entry.half_widths[0]
    assert widths[-1] == pytest.approx(entry.half_widths[0], rel=1e-3)
    # the failed readings move nothing: without fault, or without any, it says the same
    assert said == [bank.estimate(LOST, 'tacho') for _, bank, _ in cart(made, 400)]
    silent = [(bank.estimate(LOST, 'tacho'), bank.residual(LOST, 'tacho'), bank.ready(
        LOST, 'tacho')) for _, bank, _ in cart(made, 400, mute=range(400))]
    assert said == [estimate for estimate, _, _ in silent]
    assert silent[-1][1:] == (None, True)


def test_equations_that_read_the_failed_channel_say_the_same(plant, made):
    from vsensor_ros.designer.fault_estimator import descriptor, estimator
    form = descriptor(plant, np.zeros((2, 0)), ['tacho'], W1=0.002 * np.eye(2),
                      W2=0.01 * np.eye(2))
    found, entry = estimator(form, [0.1]), made.entries[LOST, 'tacho']
    rng, h = np.random.default_rng(1), 0.5
    z, xb = np.zeros(3), np.zeros(3)
    y = np.zeros(2)
    for _ in range(100):
        N, K = ((1 - h) * a[0] + h * a[1] for a in (entry.N, entry.K))
        whole = N @ z + ((1 - h) * found.L[0] + h * found.L[1]) @ y
        ahead = rng.normal(size=2) * [1.0, 100.0]
        xb = N @ xb + K @ y[:1] + entry.T2 @ ahead[:1]
        z, y, h = whole, ahead, rng.random()
        assert (z + found.T2 @ y - xb)[:2] == pytest.approx(0, abs=1e-9)
        assert (z + found.T2 @ y - xb)[2] == pytest.approx(y[1], abs=1e-9)


def test_nothing_is_claimed_out_of_range_or_after_a_lost_sample(made):
    held = []
    for k, bank, x in cart(made, 300, skip=(200,)):
        interval = bank.interval(LOST, 'tacho')
        if interval is None:
            held.append(k)
            assert bank.outside_region(LOST, 'tacho') and bank.ready(LOST, 'tacho')
            assert abs(bank.estimate(LOST, 'tacho') - x[1]) < 4 * bank.deviation(LOST, 'tacho')
        else:
            assert interval[0] <= x[1] <= interval[1]
    entry = made.entries[LOST, 'tacho']
    assert held[0] == 200 and held == list(range(200, 200 + len(held)))
    assert len(held) * 0.05 == pytest.approx(bank.warm_up(LOST, 'tacho'), abs=0.2)
    out, again = 0, 0
    for _, bank, x in cart(made, 600, push=lambda k: 2.0 if 100 < k < 180 else -0.2 * (k > 180)):
        if x[0] > 2.05:
            out += 1
            assert str(bank.why_not(LOST, 'tacho')) == 'nothing is proved where p are now'
            assert bank.interval(LOST, 'tacho') is None
        elif out and bank.ready(LOST, 'tacho'):
            again += 1
            assert abs(bank.estimate(LOST, 'tacho') - x[1]) < entry.half_widths[0]
    assert out > 10 and again > 10 and bank.outside_domain[LOST, 'tacho'] >= out


def test_stamps_that_are_a_little_off_the_samples_are_no_lost_ones(made):
    truth, known = [], 0
    for k, bank, x in cart(made, 300, late=lambda k: 0.2 * (k > 0) * np.sin(k)):
        truth.append(x[1])
        if k > 2:  # of the step before last all readings have come
            _, _, interval = bank.recall(LOST, 'tacho', (k - 2) * STEP)
            assert interval is not None and interval[0] <= truth[k - 2] <= interval[1]
            known += bank.ready(LOST, 'tacho')
    assert known > 100


def test_a_design_file_holds_it_and_is_checked(made, tmp_path):
    made.save(tmp_path / 'one.json')
    read, mine = Design.load(tmp_path / 'one.json').entries[LOST, 'tacho'], made.entries[
        LOST, 'tacho']
    assert read.kind == 'fault_estimator' and read.memberships == mine.memberships
    assert np.array_equal(read.N, mine.N) and np.array_equal(read.half_widths, mine.half_widths)
    for key, value in (
            ('memberships', ['2', '0']), ('start', 0.5), ('alpha', 1.0), ('alpha', 0.9),
            ('P', (-mine.P).tolist()), ('P', np.triu(mine.P).tolist()),
            ('P', np.ones_like(mine.P).tolist()), ('reads', ['tacho']),
            ('N', [[1.0]]), ('N', (2 * mine.N).tolist()), ('deviations', [-1.0]),
            ('ranges', [[2, -2]]), ('outputs', ['tacho', 'tacho']), ('outputs', ['ruler']),
            ('premises', ['q']), ('gain', 1.0)):
        text = json.loads((tmp_path / 'one.json').read_text())
        text['entries'][0][key] = value
        (tmp_path / 'bad.json').write_text(json.dumps(text))
        with pytest.raises(BadInput, match=r'entries\[0\]\.') as caught:
            Design.load(tmp_path / 'bad.json')
        assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('faulty', 'change', 'said'), [
    (['speed'], None, "'speed' is no sensor and no input; name some of ruler, tacho, push"),
    (['push'], None, 'faulty: names no sensor'),
    (['ruler'], None, "'p' is read by no healthy sensor"),
    (['tacho'], (', noise_bound: 0.002', ''), 'noise_bound: is not given for states and sensors'),
    (['tacho'], (', range: [-3, 3]', ''), r'v.range: is open; give \[low, high\]'),
])
def test_what_cannot_be_designed_is_one_line(faulty, change, said, tmp_path):
    (tmp_path / 'cart.yaml').write_text(CART.replace(*change) if change else CART)
    with pytest.raises(BadInput, match=said):
        fault_design(load_takagi_sugeno(tmp_path / 'cart.yaml'), faulty, [0.1])


def test_noise_bounds_of_a_plant_file_are_all_there_or_none(tmp_path):
    path = tmp_path / 'cart.yaml'
    path.write_text(CART.replace('{measures: v, unit: m/s, noise_bound: 0.01}', 'v'))
    with pytest.raises(BadInput, match='sensors.tacho.noise_bound: is missing, while others'):
        load_takagi_sugeno(path)
    path.write_text(CART.replace('noise_bound: 0.01', 'noise_bound: -1', 1))
    with pytest.raises(BadInput, match='ruler.noise_bound: -1 is negative'):
        load_takagi_sugeno(path)


@pytest.mark.slow
def test_twin_rotor_from_its_nonlinear_machine():
    plant = load_takagi_sugeno(PLANT)
    made = fault_design(plant, ['yaw_rate', 'pitch_rate', 'u_h', 'u_v'], [0.012])
    entry = made.virtual_sensors[0]
    lost, bank, rng = entry.fault_set, Bank(made, 1 / SAMPLE), np.random.default_rng(3)
    assert (entry.half_widths[:2] < [1.2, 1.3]).all()
    x, before, off, faulty = np.zeros(6), np.zeros(2), [], set()
    for k in range(8000):
        w = rng.normal(size=12)
        w *= rng.random()**(1 / 12) / np.linalg.norm(w) / np.sqrt(2)
        u, now = command(k), round(k * SAMPLE * 1e9)
        fa, fs = faults(k, u)
        y = x + 0.05 * w[6:]
        y[[1, 4]] += fs
        if faulty != (faulty := {name for name, size in zip(lost, fs) if size}):
            bank.distrust(faulty, now)
        for name, value in zip((*made.sensors, *made.inputs), (*y, *u)):
            bank.take(name, now, value)
        bank.advance(now)
        for name, true in zip(entry.outputs, (x[1], x[4], *before)):
            low, high = bank.interval(lost, name)
            assert low <= true <= high
        if k >= 1500:
            assert all(bank.ready(lost, name) for name in entry.outputs)
            off.append([*(bank.residual(lost, name) - size for name, size in zip(lost, fs)), *(
                bank.estimate(lost, name) - true
                for name, true in zip(entry.outputs, (x[1], x[4], *before)))])
        x, before = moved(x, u + fa) + 0.01 * w[:6], fa
    rms = np.sqrt(np.mean(np.square(off), axis=0))
    assert (rms <= [0.022, 0.022, 0.02, 0.02, 1e-4, 5e-4]).all()
