"""The heading of a base from where it goes: from any start, driving, turning and standing."""

import math
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import Design, load_plant
from vsensor_ros.bank import Bank
from vsensor_ros.bank.bank import FREE, INDEPENDENT
from vsensor_ros.designer.extended import extended, of_angle
from vsensor_ros.observers import kind_named, Told
from vsensor_ros.observers.kinds.extended.batch import KNOWN
from vsensor_ros.observers.kinds.extended.filter import ANYWHERE, LOST

CONFIG = Path(__file__).parents[2] / 'config'
RATE, MS = 20, 50
H = 1.0 / RATE
YAW = ('yaw',)
PHASE = 6 * RATE
DRIVES, TURNS, STANDS = ((0.5, 0.0), (0.4, 0.7), (0.0, 0.0))  # m/s, rad/s


@pytest.fixture(name='plant', scope='module')
def _plant():
    return load_plant(CONFIG / 'base' / 'plant.yaml')


@pytest.fixture(name='made', scope='module')
def _made(plant):
    return design_of(plant, {(YAW, 'yaw'): of_angle(plant, YAW, 'yaw')})


def design_of(plant, entries):
    return Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                  dict(plant.units), None, entries, ranges=plant.reading_ranges(),
                  wrap=plant.angles())


def driven(plant, phases, runs, seed):
    """
    Return readings (T, R, 6) of bases in these phases, commands (T, 2) and headings (T, R).

    They start anywhere, heading anywhere. What stands does not slip.
    """
    p, rng = plant.parameters, np.random.default_rng(seed)
    speed, turn = np.repeat(np.array(phases), PHASE, axis=0).T
    commands = np.stack([speed - turn * p['track'] / 2, speed + turn * p['track'] / 2],
                        axis=1) / p['radius']
    x = np.concatenate([rng.uniform(-80.0, 80.0, (2, runs)),
                        rng.uniform(-np.pi, np.pi, (1, runs)),
                        0.02 * rng.standard_normal((1, runs)),
                        np.repeat(commands[0][:, None], runs, axis=1)])
    readings, headings, stays, fine = [], [], math.exp(-H / 4 / p['lag']), H / 4
    for u, moves in zip(commands, speed != 0.0):
        rate = p['radius'] / p['track'] * (x[5] - x[4])
        clean = np.array([x[0], x[1], x[2], rate + x[3], x[4], x[5]])
        readings.append((clean + plant.noise[:, None] * rng.standard_normal(clean.shape)).T)
        headings.append(x[2].copy())
        for _ in range(4):
            rate = p['radius'] / p['track'] * (x[5] - x[4])
            forward, middle = p['radius'] / 2 * (x[4] + x[5]), x[2] + rate * fine / 2
            x = x + plant.process_noise[:, None] * math.sqrt(fine) * moves * \
                rng.standard_normal(x.shape)
            x[:3] += fine * np.array([forward * np.cos(middle), forward * np.sin(middle), rate])
            x[4:] = u[:, None] + (x[4:] - u[:, None]) * stays
    return np.array(readings), commands, np.array(headings)


def short_way(off):
    return np.abs(np.remainder(off + np.pi, 2 * np.pi) - np.pi)


def filtered(made, readings, commands):
    """Return what the filter says of R bases (T, R), and how surely, from no heading at all."""
    batch = kind_named('extended').batch([made[YAW, 'yaw']], made, H, None)
    runs, there = readings.shape[1], np.ones(8, dtype=bool)
    filter_, said, deviations, worst = batch.filter.of(np.zeros(runs, dtype=int)), [], [], 0.0
    z = filter_.start(Told(readings[0], there, np.zeros(0)))
    for k, y in enumerate(readings):
        told = Told(y, there, np.zeros(0))
        if k:
            z = filter_.step(z, told, np.stack([commands[k - 1]] * 3))
        said.append(batch.estimate(0, z, y, np.zeros(0)))
        deviations.append([batch.deviation(0, one[None], told, 1.0) for one in z]
                          if k % 10 == 0 else [np.nan] * runs)
        worst = max(worst, z[:, -1].max())
    return np.array(said), np.array(deviations), worst


def covered(off, deviations, phase):
    """Return the share of what was said in a phase that is within two deviations."""
    part = slice(phase * PHASE, (phase + 1) * PHASE)
    told = np.isfinite(deviations[part])
    return (off[part] <= 2.0 * deviations[part])[told].mean()


def test_from_any_start_it_is_known_after_six_seconds_of_driving(plant, made):
    readings, commands, truth = driven(plant, (DRIVES, TURNS, STANDS), 200, 1)
    said, deviations, worst = filtered(made, readings, commands)
    off = short_way(said - truth)
    assert off[PHASE:].max() < 0.2
    assert all(covered(off, deviations, phase) >= 0.9 for phase in range(3))
    # the base that stands: no error grows, and each says that it may have
    begin, end = 2 * PHASE + 10, 3 * PHASE - 10
    assert (off[end] - off[begin]).max() < 0.02
    assert np.median(deviations[end] / deviations[begin]) > 1.3
    assert worst < LOST


def test_a_base_that_stands_knows_nothing_until_it_drives(plant, made):
    readings, commands, truth = driven(plant, (STANDS, TURNS), 50, 2)
    said, deviations, _ = filtered(made, readings, commands)
    off = short_way(said - truth)
    assert covered(off, deviations, 0) >= 0.9 and covered(off, deviations, 1) >= 0.9
    stood, drove = deviations[:PHASE:10], deviations[PHASE + 2 * RATE::10]
    assert (stood == ANYWHERE).mean() > 0.99 and drove.max() < KNOWN
    assert off[-1].max() < 0.2


def through_bank(made, plant, readings, commands, truth, lost=0.0):
    """Return how far it is off (T,) by the bank, its deviations and whether it is ready."""
    bank, found = Bank(made, RATE), []
    for k, y in enumerate(readings):
        now = k * MS * 1_000_000
        if k == round(lost * RATE):
            bank.distrust(YAW, now)
        for name, value in zip(plant.inputs, commands[k]):
            bank.take(name, now, value)
        for name, value in zip(plant.sensors, y):
            if name != 'yaw' or k < lost * RATE:
                bank.take(name, now, math.remainder(value, math.tau) if name == 'yaw' else value)
        bank.advance(now)
        said = bank.estimate(YAW, 'yaw')
        found.append((np.nan if said is None else short_way(said - truth[k]),
                      bank.deviation(YAW, 'yaw'), bank.ready(YAW, 'yaw')))
    return bank, *np.array(found, dtype=float).T


def all_through_bank(made, plant, runs, seed):
    readings, commands, truth = driven(plant, (DRIVES, TURNS, STANDS), runs, seed)
    found = [through_bank(made, plant, readings[:, r], commands, truth[:, r])
             for r in range(runs)]
    off, deviations, ready = (np.array([one[i] for one in found]).T for i in (1, 2, 3))
    assert all(bank.run(YAW, 'yaw') == INDEPENDENT and not bank.restarts for bank, *_ in found)
    assert ready[PHASE:].all() and off[PHASE:].max() < 0.2
    for phase in range(3):
        part = slice(phase * PHASE, (phase + 1) * PHASE)
        served = ready[part] > 0.0
        assert (off[part] <= 2.0 * deviations[part])[served].mean() >= 0.9


def test_the_bank_tells_it_with_a_compass_that_never_worked(made, plant):
    all_through_bank(made, plant, 2, 3)


@pytest.mark.slow
def test_the_bank_tells_it_of_many_bases(made, plant):
    all_through_bank(made, plant, 60, 4)


def test_a_compass_that_is_lost_while_it_stands_tells_where_to_go_on_from(made, plant):
    readings, commands, truth = driven(plant, (STANDS, TURNS), 1, 5)
    bank, off, deviations, ready = through_bank(
        made, plant, readings[:, 0], commands, truth[:, 0], lost=3.0)
    assert bank.run(YAW, 'yaw') == FREE
    after = slice(3 * RATE + 1, None)
    assert ready[after].all() and off[after].max() < 0.1
    assert (off[after] <= 2.0 * deviations[after]).mean() >= 0.9


def test_one_that_is_misled_starts_anew(made, plant):
    """Somebody lifts the base and puts it down elsewhere, facing another way."""
    readings, commands, truth = driven(plant, (DRIVES, TURNS), 1, 6)
    moved = readings.copy()
    east, north = readings[PHASE:, :, 0], readings[PHASE:, :, 1]
    moved[PHASE:, :, 0], moved[PHASE:, :, 1] = 20.0 - north, east  # a quarter to the left
    truth = truth.copy()
    truth[PHASE:] += math.pi / 2
    bank, off, deviations, ready = through_bank(
        made, plant, moved[:, 0], commands, truth[:, 0])
    assert bank.restarts[YAW, 'yaw'] > 0
    assert ready[-1] and off[-1] < 0.1 and deviations[-1] < 0.1


def test_filters_with_and_without_an_angle_run_side_by_side(tmp_path):
    path = tmp_path / 'plant.yaml'
    path.write_text("""
name: cart
time: continuous
parameters: {lag: {value: 0.5, spread: 0.02}}
states:
  x: {process_noise: 0.01}
  y: {process_noise: 0.01}
  heading: {process_noise: 0.01}
  v: {process_noise: 0.1, range: [-2, 2]}
inputs: {push: {process_noise: 0.1}, turn: {process_noise: 0.01}}
dynamics: {x: v*cos(heading), y: v*sin(heading), heading: turn, v: (push - v*(1 + v))/lag}
sensors:
  x: {measures: x, noise: 0.02}
  y: {measures: y, noise: 0.02}
  yaw: {measures: heading, noise: 0.02, wrap: 2*pi}
  odo: {measures: v, noise: 0.02}
""", encoding='utf-8')
    plant = load_plant(path)
    made = design_of(plant, {(YAW, 'yaw'): of_angle(plant, YAW, 'yaw'),
                             (('odo',), 'odo'): extended(plant, ('odo',), 'odo')})
    made.save(tmp_path / 'design.json')
    bank = Bank(Design.load(tmp_path / 'design.json'), RATE)
    heading = math.atan2(0.8, -0.6)
    for k in range(4 * RATE):
        now, along = k * MS * 1_000_000, 0.5 * k * H
        for name, value in (('push', 0.75), ('turn', 0.0), ('x', 3.0 - 0.6 * along),
                            ('y', 0.8 * along), ('odo', 0.5), ('yaw', heading)):
            bank.take(name, now, value)
        bank.advance(now)
    assert bank.estimate(YAW, 'yaw') == pytest.approx(heading, abs=0.02)
    assert bank.estimate(('odo',), 'odo') == pytest.approx(0.5, abs=0.02)
