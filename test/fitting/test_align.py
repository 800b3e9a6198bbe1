"""Delays that were put into the stamps of simulated machines are found again, with their sign."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from plants import recorded, torques, written
import pytest

from vsensor_ros import load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import grid
from vsensor_ros.command.align import main
from vsensor_ros.fitting import align
from vsensor_ros.fitting.align_search import Search
from vsensor_ros.fitting.align_text import cost_text, STEPS
from vsensor_ros.fitting.align_windows import Channels
from vsensor_ros.fitting.model import Model
from vsensor_ros.plant.free import load_free
from vsensor_ros.recordings import load_dataset, Recording, Track

AXIS = """\
# an axis, kept as it is
name: axis
time: continuous
parameters:
  inertia: {value: 0.5}   # of the load
  drag: {value: 0.3}
states:
  angle: {unit: rad}
  speed: {unit: rad/s}
inputs:
  torque: {unit: N m}
dynamics:
  angle: speed
  speed: (torque - drag*speed)/inertia
sensors:
  encoder: {measures: angle, unit: rad}   # four lines a turn
  tacho: {measures: speed, unit: rad/s}
"""
NOISE = {'encoder': 0.002, 'tacho': 0.05, 'torque': 0.0}
BASE = Path(__file__).resolve().parents[2] / 'config' / 'base' / 'plant.yaml'


def driven(folder, late, seed=0, size=2.0):
    """Return 30 s of an axis whose parameters are 2 % off, and by channel how late stamps are."""
    random = np.random.default_rng(seed)
    run = recorded(written(folder, AXIS, inertia=0.51, drag=0.294),
                   torques(6000, 0.005, random, size), 0.005, 0.0, random)
    tracks = {}
    for i, (name, track) in enumerate(run.tracks.items()):
        rows = slice(i % 2, None, 4)  # a command at a time of its own would be late itself
        tracks[name] = Track.of(track.times[rows] + late.get(name, 0.0), track.values[rows]
                                + NOISE[name] * random.standard_normal(len(track.values[rows])))
    return Recording(tracks)


def of_axis(folder):
    return load_free(written(folder, AXIS), every=True)


@pytest.mark.parametrize(('late', 'expected'), [
    ({}, {'encoder': 0.0, 'tacho': 0.0, 'torque': 0.0}),
    ({'tacho': 0.2}, {'encoder': 0.0, 'tacho': 0.2, 'torque': 0.0}),
    ({'encoder': 0.13}, {'encoder': 0.13, 'tacho': 0.0, 'torque': 0.0}),
    # the command's stamps are late, so that it acts before them
    ({'torque': 0.1}, {'encoder': 0.0, 'tacho': 0.0, 'torque': -0.1})])
@pytest.mark.slow
def test_a_delay_of_stamps_is_found_with_its_sign(tmp_path, late, expected):
    found = align(of_axis(tmp_path), [driven(tmp_path, late)])
    print(found.reference, found.delays, found.errors)
    assert found.delays == pytest.approx(expected, abs=0.01)
    assert all(found.errors[name] < 0.01 for name in expected)
    assert set(found.late()) == set(late) - {'torque'}


@pytest.mark.slow
def test_where_nothing_is_late_nothing_is_found(tmp_path):
    within = []
    for seed in range(20):
        found = align(of_axis(tmp_path), [driven(tmp_path, {}, 100 + seed)], most=0.2,
                      reference='encoder')
        within += [abs(found.delays[name]) <= 2.0 * found.errors[name]
                   for name in ('tacho', 'torque')]
        assert max(found.errors.values()) < 0.02  # and that is no empty saying
    assert np.mean(within) >= 0.95


@pytest.mark.slow
def test_what_stands_still_is_not_seen(tmp_path):
    random = np.random.default_rng(3)
    t = 0.02 * np.arange(1500)
    run = Recording({name: Track.of(t, noise * random.standard_normal(len(t)))
                     for name, noise in NOISE.items()})
    found = align(of_axis(tmp_path), [run], reference='encoder')
    print(found.delays, found.errors)
    assert np.isinf(found.errors['tacho'])
    assert not found.late()


@pytest.mark.slow
def test_the_files_take_the_delays_and_keep_their_comments(tmp_path, capsys):
    run = driven(tmp_path, {'tacho': 0.1})
    rows = {name: dict(zip(np.rint(1e4 * t.times).astype(int).tolist(), t.values.tolist()))
            for name, t in run.tracks.items()}
    times = sorted(set().union(*rows.values()))
    (tmp_path / 'run.csv').write_text('t,' + ','.join(rows) + '\n' + ''.join(
        f'{k / 1e4},' + ','.join(str(rows[n].get(k, '')) for n in rows) + '\n' for k in times))
    dataset, out = tmp_path / 'axis.yaml', tmp_path / 'aligned.yaml'
    dataset.write_text('recordings: [run.csv]   # of Monday\n')
    plant = written(tmp_path, AXIS.replace('unit: rad/s}\n', 'unit: rad/s, stamp_offset: 0.04}\n')
                    .replace('speed: {unit: rad/s, stamp_offset: 0.04}', 'speed: {unit: rad/s}'))
    assert main([str(plant), str(dataset), '--most', '0.15', '--reference', 'encoder',
                 '--into-dataset', '-o', str(out)]) == 0
    said = capsys.readouterr().out
    assert 'tacho is 0.0' in said and 'rad/s (rms) meanwhile' in said
    assert load_plant(out).sensor_delay == pytest.approx([0.0, 0.1], abs=0.01)
    assert '# four lines a turn' in out.read_text()
    assert dataset.read_text().startswith('recordings: [run.csv]   # of Monday\n')
    moved, = load_dataset(dataset)
    assert moved.tracks['tacho'].times[5] == pytest.approx(
        run.tracks['tacho'].times[5] - 0.06, abs=0.01)


def test_a_delay_that_a_node_cannot_wait_for_is_said(tmp_path):
    run = Recording({'encoder': Track.of(0.1 * np.arange(50), 0.3 * np.arange(50))})
    lines = cost_text(of_axis(tmp_path), [run], {'encoder': 2.0}, 1000.0)
    assert 'It moves by 6 rad (rms) meanwhile' in lines[0]
    assert lines[1].endswith('goes back by 1000 steps; run it below 500 Hz')
    assert len(cost_text(of_axis(tmp_path), [run], {'encoder': 2.0}, 100.0)) == 1
    assert STEPS == grid._LONGEST


def test_what_cannot_be_aligned_is_one_line(tmp_path):
    run = driven(tmp_path, {})
    with pytest.raises(BadInput, match='--reference: gyro is no sensor of the recording'):
        align(of_axis(tmp_path), [run], reference='gyro')
    few = Recording({n: Track(t.stamps[:200], t.values[:200]) for n, t in run.tracks.items()})
    with pytest.raises(BadInput, match='is too short'):
        align(of_axis(tmp_path), [few])
    two = Recording({n: Track(t.stamps[:2], t.values[:2]) for n, t in run.tracks.items()})
    with pytest.raises(BadInput, match='no sensor has three readings'):
        align(of_axis(tmp_path), [two])
    with pytest.raises(BadInput, match='--most: 0.001 s is less than between two readings'):
        align(of_axis(tmp_path), [run], most=0.001)
    with pytest.raises(BadInput, match='this command of the plant is not in the recording'):
        align(of_axis(tmp_path), [Recording({'encoder': run.tracks['encoder']})])


def base(late, seed, seconds=40.0, h=0.002):
    """Return a base that is 2 % off in all parameters, with each channel at a rate of its own."""
    random, plant = np.random.default_rng(seed), load_plant(BASE)
    p, t = plant.parameters, h * np.arange(int(seconds / h))
    radius, track, lag = 1.02 * p['radius'], 0.98 * p['track'], 1.02 * p['lag']
    ahead, turn = (np.repeat(random.uniform(*ends, int(seconds) + 1), round(1 / h))[:len(t)]
                   for ends in ((3.0, 7.0), (-2.0, 2.0)))
    slip = plant.process_noise * np.sqrt(h) * random.standard_normal((len(t), 6))
    x, said = np.array([0.0, 0.0, 0.0, 0.02, 5.0, 5.0]), np.empty((len(t), 6))
    for k in range(len(t)):
        rate = radius / track * (x[5] - x[4])
        said[k] = [*x[:3], rate + x[3], *x[4:]]
        way = h * radius / 2 * (x[4] + x[5])
        x = x + slip[k] + [way * np.cos(x[2] + rate * h / 2), way * np.sin(x[2] + rate * h / 2),
                           h * rate, 0.0, *((ahead[k] + s * turn[k] - w) * (1 - np.exp(-h / lag))
                                            for s, w in zip((-1, 1), x[4:]))]
    tracks = {}
    for i, (name, hertz) in enumerate(zip(plant.sensors, (10, 10, 10, 100, 50, 50))):
        at = np.arange(0.001 * i, seconds - 1.0, 1 / hertz)
        tracks[name] = Track.of(at + late.get(name, 0.0), np.interp(at, t, said[:, i])
                                + plant.noise[i] * random.standard_normal(len(at)))
    rows = np.arange(0, len(t), round(0.02 / h))
    return Recording({**tracks, 'left_set': Track.of(t[rows], (ahead - turn)[rows]),
                      'right_set': Track.of(t[rows], (ahead + turn)[rows])})


@pytest.mark.slow
@pytest.mark.parametrize('late', [{}, {'gyro': 0.2}, {'wheel_left': 0.2, 'wheel_right': 0.2}])
def test_the_wheels_and_the_gyro_of_a_base(late):
    found = align(load_free(BASE, every=True), [base(late, 1)], most=0.4)
    print(found.reference, found.delays, found.errors)
    against = found.delays['wheel_right'] - late.get('wheel_right', 0.0)
    for name in ('gyro', 'wheel_left', 'wheel_right'):
        assert found.delays[name] - against == pytest.approx(late.get(name, 0.0), abs=0.01)
    for name in ('x', 'y', 'yaw'):  # ten a second, and noisy
        assert found.delays[name] - against == pytest.approx(
            0.0, abs=3.0 * max(found.errors.values()))


def test_a_reading_stands_at_a_node_with_how_much_later_that_is(tmp_path):
    u = torques(6000, 0.005, np.random.default_rng(5), 2.0)
    run = recorded(written(tmp_path, AXIS), u, 0.005, 0.0, np.random.default_rng(0))
    tracks = {name: Track.of(t.times[1:][i::4], t.values[1:][i::4])
              for i, (name, t) in enumerate(run.tracks.items())}  # 20 ms, apart from each other
    channels = Channels.of(Model(of_axis(tmp_path)), [Recording(tracks)])
    search = Search(channels, 0.2, ('encoder', 'tacho'), None)
    nodes = channels.nodes(*search.where, np.zeros(3))
    off = []
    for i, name in enumerate(('encoder', 'tacho')):
        times = nodes.starts + 0.02 * np.arange(len(nodes.readings))[:, None]
        there = np.isfinite(nodes.readings[:, i])
        of = times[there] - nodes.after[:, i][there]
        assert nodes.readings[:, i][there] == pytest.approx(tracks[name].at(of), abs=1e-9)
        off.append(np.abs(nodes.after[:, i][there]).max())
    assert max(off) > 0.004  # some lie between nodes


@pytest.mark.parametrize(('scatter', 'seen'), [(0.0, True), (3000.0, False)])
def test_a_curvature_that_is_not_clear_tells_nothing(scatter, seen):
    random, count = np.random.default_rng(2), 40
    search = object.__new__(Search)
    search.free, search.most, search.tell = np.arange(2), 1.0, lambda *_: None
    search.channels = SimpleNamespace(step=0.01)
    search._points = lambda points, *_: SimpleNamespace(at=points[0], slopes=None)

    def solved(point):
        """Return slopes of parabolas of which each window has its own, and what is assumed."""
        own = 1e4 / count * point.at + scatter * random.standard_normal((count, 2))
        return own, np.diag([1e4, 1e4])
    search._solved = solved
    errors = search._errors(np.zeros(2), None, search._points([np.zeros(2)]))
    assert np.isfinite(errors).all() == seen
