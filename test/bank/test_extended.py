"""The arm whose elbow encoder is lost, calm and turning over, by a filter with wrong numbers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant
from vsensor_ros.bank import Bank
from vsensor_ros.designer.extended import extended

CONFIG = Path(__file__).parents[2] / 'config' / 'two_link'
MS, PERIOD, RATE = 1_000_000, 10, 100
ELBOW = ('pos2', 'vel2')
NAMES = ('pos1', 'pos2', 'vel1', 'vel2')
PARAMETERS = ('a1', 'a2', 'a3', 'b1', 'b2', 'd1', 'd2', 'f1', 'f2', 'k2', 'a4', 'z1', 'z2')
NOISE = np.array([2e-4, 2e-4, 0.03, 0.03])


VS = 0.5  # rad/s


def accelerations(p, x, torque, load):
    """Return the derivative (4, W) of pos1, pos2, vel1, vel2 (4, W), of the equations by hand."""
    a1, a2, a3, b1, b2, d1, d2, f1, f2, k2, a4, z1, z2 = p
    q1, q2, v1, v2 = x[0] + z1, x[1] + z2, x[2], x[3]
    m11, m12, m22 = a1 + 2 * a3 * np.cos(q2), a2 + a3 * np.cos(q2), a2 + a4
    lean = b2 * np.sin(q1 + q2)
    r1 = torque[0] + a3 * np.sin(q2) * (2 * v1 * v2 + v2**2) - b1 * np.sin(q1) - lean \
        - d1 * v1 - f1 * np.tanh(v1 / VS)
    r2 = k2 * torque[1] + load - a3 * np.sin(q2) * v1**2 - lean - d2 * v2 - f2 * np.tanh(v2 / VS)
    det = m11 * m22 - m12**2
    return np.array([v1, v2, (m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det])


@pytest.fixture(name='made', scope='module')
def _made():
    plant = load_plant(CONFIG / 'plant.yaml')
    entries = {(ELBOW, channel): extended(plant, ELBOW, channel) for channel in ELBOW}
    return Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                  dict(plant.units), None, entries, ranges=plant.reading_ranges())


def played(plant, size, seed, seconds=4.0):
    """
    Return readings (T, 4) and truth (T, 4) of an arm, and its torques (T, 2), every 10 ms.

    Its parameters are off by 5 %, or by their spread, and torques act that nobody tells.
    """
    rng, steps = np.random.default_rng(seed), round(seconds * RATE)
    p = np.array([plant.parameters[name] + plant.spreads[name] * rng.standard_normal()
                  for name in PARAMETERS])
    p[[5, 6]] = np.maximum(p[[5, 6]], 0.0)
    t, h = np.arange(steps) / RATE, 2.5e-3
    torque = size * np.array([0.8 * np.sin(2 * np.pi * (0.7 + 0.2 * rng.random()) * t + 3 * seed),
                              0.6 * np.sin(2 * np.pi * (0.9 + 0.3 * rng.random()) * t)]).T
    load, pull = 0.03 * rng.standard_normal(), 0.05 * rng.standard_normal()
    x, truth = np.zeros((4, 1)), []
    for k in range(steps):
        truth.append(x[:, 0])
        unsaid = np.array([0.04, 0.01]) * np.sqrt(RATE) * rng.standard_normal(2)
        for _ in range(round(1 / (RATE * h))):
            u = torque[k] + [unsaid[0] + pull, 0.0]
            of = [accelerations(p, x, u, load + unsaid[1])]
            for part in (h / 2, h / 2, h):
                of.append(accelerations(p, x + part * of[-1], u, load + unsaid[1]))
            x = x + h / 6 * (of[0] + 2 * of[1] + 2 * of[2] + of[3])
    truth = np.array(truth)
    return truth + NOISE * rng.standard_normal(truth.shape), truth, torque


def lost(made, y, torque, at=1.5):
    """Return what is said of the elbow (T, 2), and how surely, after its loss; NaN: nothing."""
    bank, said = Bank(made, RATE), []
    gone = False
    for k in range(len(y)):
        now = k * PERIOD * MS
        if not gone and k / RATE >= at:
            bank.distrust(ELBOW, now)
            gone = True
        for j, name in enumerate(NAMES):
            if not (gone and name in ELBOW):
                bank.take(name, now, y[k, j])
        for name, value in zip(('torque1', 'torque2'), torque[k]):
            bank.take(name, now, value)
        bank.advance(now)
        if gone:
            said.append([(bank.estimate(ELBOW, channel), bank.deviation(ELBOW, channel))
                         if bank.ready(ELBOW, channel) else (np.nan, np.nan)
                         for channel in ELBOW])
    return bank, np.array(said).transpose(2, 0, 1)


def judged(made, runs):
    """Return errors and deviations (N, 2) of what may go out: within a tenth of the range."""
    errors, deviations = [], []
    for y, truth, torque in runs:
        _, (value, deviation) = lost(made, y, torque)
        off = value - truth[-len(value):, [1, 3]]
        out = (deviation <= [0.64, 4.0]).all(axis=1)
        errors.append(np.where(out[:, None], off, np.nan))
        deviations.append(deviation)
    return np.concatenate(errors), np.concatenate(deviations)


def test_an_arm_with_other_numbers_than_the_plant_file(made):
    plant = load_plant(CONFIG / 'plant.yaml')
    errors, deviations = judged(made, [played(plant, 0.5, 2, 3.0)])
    served = np.isfinite(errors)
    assert served.mean() > 0.95
    assert (np.abs(errors) <= 2.0 * deviations)[served].mean() >= 0.9
    assert np.sqrt(np.nanmean(errors[:, 0]**2)) < 0.1


@pytest.mark.slow
def test_arms_that_turn_over(made):
    plant = load_plant(CONFIG / 'plant.yaml')
    runs = [played(plant, 1.6, seed) for seed in range(10)]
    assert all(np.abs(truth[150:, 1]).max() > 3.0 for _, truth, _ in runs)
    errors, deviations = judged(made, runs)
    served = np.isfinite(errors)
    assert served.mean() > 0.5
    assert (np.abs(errors) <= 2.0 * deviations)[served].mean() >= 0.9
    assert np.nanmax(np.abs(errors[:, 0])) < np.pi


def test_what_the_model_does_not_hold_for_is_withdrawn(made):
    """Somebody holds the elbow fast after its encoder was lost: the shoulder tells."""
    plant = load_plant(CONFIG / 'plant.yaml')
    y, truth, torque = played(plant, 1.0, 7)
    other = played(plant, 1.0, 8)[0]
    y[200:, [0, 2]] = other[200:, [0, 2]]
    bank, (value, _) = lost(made, y, torque)
    assert np.isfinite(value[:40]).all() and np.isnan(value[-20:]).all()
    assert bank.why_not(ELBOW, 'pos2').code == 'model lost'
    bank.distrust(())
    for k in range(len(y), len(y) + 150):  # the encoder is back, and tracks
        for j, name in enumerate(NAMES):
            bank.take(name, k * PERIOD * MS, truth[k % 100 + 50, j])
        for name in ('torque1', 'torque2'):
            bank.take(name, k * PERIOD * MS, 0.0)
        bank.advance(k * PERIOD * MS)
    assert bank.waiting(ELBOW, 'pos2') == 0.0


PENDULUM = """
name: pendulum
time: continuous
parameters: {l: {value: 0.7, spread: 0.035}}
states:
  angle: {process_noise: 0, range: [-4, 4]}
  speed: {process_noise: 0.05, range: [-8, 8]}
inputs: {torque: {}}
dynamics: {angle: speed, speed: -9.81*sin(angle)/l - 0.2*speed + 2*torque}
sensors: {encoder: {measures: angle, noise: 0.001}, tacho: {measures: speed, noise: 0.02}}
"""


def test_beside_another_kind_it_says_what_it_says_alone(tmp_path):
    path = tmp_path / 'plant.yaml'
    path.write_text(PENDULUM, encoding='utf-8')
    both = design(load_plant(path))
    kinds = {sensor: both[(sensor,), sensor].kind for sensor in ('encoder', 'tacho')}
    assert kinds == {'encoder': 'extended', 'tacho': 'functional'}

    def heard(made, sensor):
        bank, said = Bank(made, RATE), []
        for k in range(260):
            now = k * PERIOD * MS
            if k == 180:
                bank.distrust((sensor,), now)
            for name, value in (('encoder', 0.5 * np.cos(3.7 * now * 1e-9)),
                                ('tacho', -1.85 * np.sin(3.7 * now * 1e-9)), ('torque', 0.0)):
                bank.take(name, now, value)
            bank.advance(now)
            said.append((bank.estimate((sensor,), sensor), bank.deviation((sensor,), sensor)))
        return np.array(said[100:], dtype=float)
    for sensor in kinds:
        alone = replace(both, entries={
            key: entry for key, entry in both.entries.items() if key[1] == sensor})
        np.testing.assert_allclose(heard(both, sensor), heard(alone, sensor), rtol=1e-9)


def swing(x, u):
    return np.array([x[1], -9.81 * np.sin(x[0]) / 0.7 - 0.2 * x[1] + 2 * u])


@pytest.mark.parametrize('pause', [5, 30])
def test_a_healthy_sensor_that_pauses(tmp_path, pause):
    """The tacho says nothing for a while, less than max_age: the filter goes on without it."""
    path = tmp_path / 'plant.yaml'
    path.write_text(PENDULUM, encoding='utf-8')
    bank, said, x = Bank(design(load_plant(path)), RATE), [], np.array([0.3, 0.0])
    for k in range(500):
        now = k * PERIOD * MS
        if k == 250:
            bank.distrust(('encoder',), now)
        u = 3.0 * np.sin(3.8 * k / RATE)
        bank.take('encoder', now, x[0])
        if not 300 <= k < 300 + pause:
            bank.take('tacho', now, x[1])
        bank.take('torque', now, u)
        bank.advance(now)
        if k >= 250:
            said.append((bank.estimate(('encoder',), 'encoder') - x[0],
                         bank.deviation(('encoder',), 'encoder'),
                         bank.ready(('encoder',), 'encoder')))
        for _ in range(20):
            x = x + swing(x + swing(x, u) / 4000, u) / 2000
    error, deviation, ready = np.array(said).T
    assert ready.all() and (np.abs(error) <= 3 * deviation).all()
    assert np.abs(error).max() < 0.1
