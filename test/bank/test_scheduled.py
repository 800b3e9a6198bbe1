"""A motor whose encoder is lost, by scheduled injection in the bank, beside its simulation."""

from dataclasses import replace
import json

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import Bank
from vsensor_ros.designer.scheduled_entry import over_the_ranges
from vsensor_ros.observers import Design, ScheduledSensor
from vsensor_ros.observers.memberships import Weights
from vsensor_ros.plant import from_equations

pytest.importorskip('cvxpy')

MOTOR = """
name: motor
time: continuous
parameters: {R: 0.2, Ld: 0.0008, Lq: 0.0012, flux: 0.0175, pp: 4, J: 0.0008, b: 0.0003}
states:
  id: {range: [-15, 60]}
  iq: {range: [-60, 60]}
  w: {range: [-400, 400]}
inputs: {vd: {range: [-60, 60]}, vq: {range: [-60, 60]}}
disturbances: {load: {range: [-500, 500]}}
dynamics:
  id: (vd - R*id + pp*w*Lq*iq)/Ld
  iq: (vq - R*iq - pp*w*(Ld*id + flux))/Lq
  w: (1.5*pp*(flux*iq + (Ld - Lq)*id*iq) - b*w)/J + load
sensors:
  amp_d: {measures: id, noise: 0.05}
  amp_q: {measures: iq, noise: 0.05}
  encoder: {measures: w, noise: 0.5}
"""
LOST, STEP, LOAD = ('encoder',), 1e-3, 500.0


@pytest.fixture(name='made', scope='module')
def _made(tmp_path_factory):
    path = tmp_path_factory.mktemp('motor') / 'motor.yaml'
    path.write_text(MOTOR)
    return design(load_plant(path), [LOST])


def slope(x, u, load):
    """Return what the motor does, written out again."""
    d, q, w = x
    return np.array([(u[0] - 0.2 * d + 4 * w * 0.0012 * q) / 0.0008,
                     (u[1] - 0.2 * q - 4 * w * (0.0008 * d + 0.0175)) / 0.0012,
                     (6 * (0.0175 * q - 0.0004 * d * q) - 0.0003 * w) / 0.0008 + load])


def run(made, seconds, wanted, seed=0):
    """Yield time [s], bank and true speed; wanted(t): id, iq that a controller holds."""
    rng, bank, x, fine = np.random.default_rng(seed), Bank(made, 1 / STEP), np.zeros(3), 20
    for k in range(round(seconds / STEP)):
        now = round(k * STEP * 1e9)
        d, q = wanted(k * STEP, x[2])
        u = np.array([0.2 * d - 4 * x[2] * 0.0012 * q + 0.2 * (d - x[0]),
                      0.2 * q + 4 * x[2] * (0.0008 * d + 0.0175) + 0.3 * (q - x[1])])
        for name, value in zip(('amp_d', 'amp_q'), x[:2] + np.clip(
                0.05 * rng.standard_normal(2), -0.15, 0.15)):
            bank.take(name, now, value)
        for name, value in zip(('vd', 'vq'), u):
            bank.take(name, now, value)
        bank.advance(now)
        yield k * STEP, bank, x[2]
        load = LOAD * (1 if int(k * STEP * 4) % 2 else -1)
        h = STEP / fine
        for _ in range(fine):
            middle = x + h / 2 * slope(x, u, load)
            x = x + h * slope(middle, u, load)


TANK = """
name: tank
time: continuous
states: {level: {range: [0.2, 4]}, flow: {range: [0, 4]}}
inputs: {pump: {range: [0, 3], operating: 1}, valve: {range: [0.2, 1], operating: 0.5}}
disturbances: {leak: {range: [-0.1, 0.1]}}
dynamics: {level: pump - 0.8*valve*level + leak, flow: 16*valve*level - 20*flow}
sensors: {gauge: {measures: level, noise: 0.01}, meter: {measures: flow, noise: 0.01}}
"""


@pytest.mark.parametrize('comes', [
    lambda k: k % 20 == 0, lambda k: k % 300 < 255], ids=['slowly', 'with gaps'])
def test_readings_that_are_held_or_far_apart_are_counted_with(tmp_path, comes):
    (tmp_path / 'tank.yaml').write_text(TANK)
    bank = Bank(design(load_plant(tmp_path / 'tank.yaml'), [('gauge',)]), 100.0)
    x, step, claimed, held, off, said = np.array([1.0, 1.0]), 0.01, 0, 0, [], []
    for k in range(1500):
        now, valve = k * 10_000_000, 1.0 if k // 33 % 2 else 0.2
        pump, leak = float(np.clip(2.0 if k // 200 % 2 else 0.7 * (2.5 - x[0]), 0.0, 3.0)), 0.1
        if comes(k):
            bank.take('meter', now, x[1])
        bank.take('pump', now, pump)
        bank.take('valve', now, valve)
        bank.advance(now)
        interval = bank.interval(('gauge',), 'gauge')
        if interval is not None:
            claimed += 1
            assert interval[0] <= x[0] <= interval[1]
        held += not comes(k) and k > 0
        assert comes(k) or interval is None
        if bank.ready(('gauge',), 'gauge'):
            off.append(abs(bank.estimate(('gauge',), 'gauge') - x[0]))
            said.append(bank.deviation(('gauge',), 'gauge'))
        for _ in range(20):
            x = x + step / 20 * np.array([pump - 0.8 * valve * x[0] + leak,
                                          16 * valve * x[0] - 20 * x[1]])
    assert claimed > 50 and held > 100 and len(off) > 500
    assert np.mean(np.array(off) <= 2.0 * np.array(said)) > 0.95


def turning(t, w):
    """Go from one end of what id may be to the other, and about with the speed."""
    return 20 + 25 * np.sin(5 * t), np.clip(0.5 * (150 * np.sin(4 * t) - w), -40, 40)


def test_the_truth_is_in_the_interval_from_the_start_on(made):
    widths, off, ready = [], [], 0
    for _, bank, w in run(made, 1.5, turning):
        interval = bank.interval(LOST, 'encoder')
        if interval is None:
            continue
        low, high = interval
        assert low <= w <= high
        if bank.ready(LOST, 'encoder'):
            ready += 1
            widths.append((high - low) / 2)
            off.append(bank.estimate(LOST, 'encoder') - w)
    entry = made.entries[LOST, 'encoder']
    assert ready > 200
    assert entry.half_width <= min(widths) and np.median(widths) < 2.0 * entry.half_width
    assert np.sqrt(np.mean(np.square(off))) < entry.half_width / 2
    assert not bank.outside_domain[LOST, 'encoder']


def test_premises_that_leave_their_range_are_counted_and_nothing_is_claimed(made):
    def leaving(t, w):
        return (-40 if 0.6 < t < 0.7 else 20), 5 * np.sin(4 * t)
    before, outside, ready = 0, 0, []
    for t, bank, w in run(made, 1.8, leaving):
        interval = bank.interval(LOST, 'encoder')
        assert interval is None or interval[0] <= w <= interval[1]
        if t < 0.6:
            before = bank.outside_domain[LOST, 'encoder']
            assert not (t > 0.5) or bank.ready(LOST, 'encoder')
        elif 0.65 < t < 0.7:
            outside += 1
            assert interval is None and bank.outside_region(LOST, 'encoder')
            assert not bank.ready(LOST, 'encoder')
        elif t > 0.7 and bank.ready(LOST, 'encoder'):
            ready.append((t, abs(bank.estimate(LOST, 'encoder') - w)))
    assert before == 0 and outside > 40
    assert bank.outside_domain[LOST, 'encoder'] > 40
    assert not bank.outside_region(LOST, 'encoder')
    # it started again: it is ready once that is forgotten, and right from then on
    (first, _), *_ = ready
    entry = made.entries[LOST, 'encoder']
    assert first > 0.75 and max(off for _, off in ready) < entry.half_width


def test_a_design_file_holds_it_and_is_checked(made, tmp_path):
    made.save(tmp_path / 'one.json')
    read, mine = Design.load(tmp_path / 'one.json').entries[LOST, 'encoder'], made.entries[
        LOST, 'encoder']
    assert read.kind == 'takagi_sugeno' and read.memberships == mine.memberships
    assert np.array_equal(read.N, mine.N) and read.half_width == mine.half_width
    for key, value in (('memberships', ['2'] * len(mine.N)), ('start', 0.5), ('decay', 0.0),
                       ('S', (-mine.S).tolist()), ('reads', ['encoder', 'amp_d']), ('N', [[1.0]]),
                       ('N', (-mine.N).tolist()), ('decay', 10.0 * mine.decay)):
        text = json.loads((tmp_path / 'one.json').read_text())
        [section] = [one for one in text['entries'] if one['kind'] == 'takagi_sugeno']
        section[key] = value
        (tmp_path / 'bad.json').write_text(json.dumps(text))
        with pytest.raises(BadInput, match=key):
            Design.load(tmp_path / 'bad.json')


ARM = """
name: arm
time: continuous
states: {a: {range: [-3.1415927, 3.1415927]}, w: {range: [-20, 20]}}
inputs: {torque: {range: [-20, 20]}}
dynamics: {a: w, w: -4*w - 9*sin(a) - 0.5*cos(a)*w + torque}
sensors:
  encoder: {measures: a, noise: 0.001, wrap: 6.283185307179586}
  tacho: {measures: w, noise: 0.05}
"""


def test_weights_of_an_angle_are_those_of_one_in_its_range(tmp_path):
    (tmp_path / 'arm.yaml').write_text(ARM)
    made = from_equations(load_plant(tmp_path / 'arm.yaml'), ['a'])
    turns = np.array([2.0 * np.pi])
    told, untold = (Weights([made], [np.array([[1.0, 0.0]])], *more) for more in ([[turns]], []))
    for at in (-3.0, 0.4, 3.1):
        here, inside = told.at(np.array([at, 0.0]))
        for whole in (-3, 1, 2):
            end = np.array([at + whole * turns[0], 0.0])
            found, there = told.at(end)
            np.testing.assert_allclose(found, here, atol=1e-9)
            assert inside.all() and there.all() and not untold.at(end)[1].any()


@pytest.mark.slow
def test_an_angle_that_turns_over_stays_in_its_range(tmp_path):
    """The arm turns three times; its speed is told from the encoder all along."""
    (tmp_path / 'arm.yaml').write_text(ARM)
    plant = load_plant(tmp_path / 'arm.yaml')
    entry = over_the_ranges(plant, ('tacho',), 'tacho', 0.5)
    assert isinstance(entry, ScheduledSensor)
    assert entry.turns.tolist() == [2.0 * np.pi if name == 'a' else 0.0
                                    for name in entry.premises]
    made = replace(design(plant, [['tacho']], scheduled=False),
                   entries={(('tacho',), 'tacho'): entry})
    made.save(tmp_path / 'arm.json')
    bank, x, off = Bank(Design.load(tmp_path / 'arm.json'), 200.0), np.zeros(2), []
    for k in range(1800):
        bank.take('encoder', k * 5_000_000, float(np.remainder(x[0] + np.pi, 2 * np.pi) - np.pi))
        bank.take('torque', k * 5_000_000, 18.0)
        bank.advance(k * 5_000_000)
        if k > 900:
            off.append(bank.estimate(('tacho',), 'tacho') - x[1])
            assert bank.why_not(('tacho',), 'tacho') is None
        for _ in range(10):
            x = x + 5e-4 * plant.rate_of_change(x, np.array([18.0]))
    assert x[0] > 6.0 * np.pi and bank.outside_domain.total() == 0
    assert np.abs(off).max() < entry.half_width
