"""What a fit finds of plants that are known, and what it says of those it cannot know."""

import numpy as np
from plants import AXIS, recorded, torques, TRUTH, written
import pytest

from vsensor_ros import load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.fit import main
from vsensor_ros.fitting import fit
from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.suspicion import loops
from vsensor_ros.fitting.windows import cut
from vsensor_ros.plant.free import load_free
from vsensor_ros.recordings import Recording, Track


@pytest.fixture(scope='module')
def axis(tmp_path_factory):
    folder = tmp_path_factory.mktemp('axis')
    u = torques(500, 0.02, np.random.default_rng(3))
    run = recorded(written(folder, **TRUTH), u)
    path = written(folder)
    return path, run, fit(load_free(path), [run], 1.0, tries=1)


def test_parameters_are_found_within_their_spreads(axis):
    _, _, result = axis
    truth = np.array(list(TRUTH.values()))
    assert np.abs(result.values / truth - 1.0).max() < 0.03
    assert (np.abs(result.values - truth) < 4.0 * result.spreads).all()
    assert (result.known.errors < 0.02).all()
    assert result.noise.sensors[0] == pytest.approx(1e-4, rel=0.3)


def test_held_out_parts_are_predicted_better_than_by_peers(axis):
    held = axis[2].held_out
    assert 5 * held.rms(held.plant)[0] < min(held.rms(held.arx)[0], held.rms(held.held)[0])


def test_only_a_ratio_is_seen(tmp_path):
    text = AXIS.replace('parameters:\n', 'parameters:\n  gain: {value: 0.9, fit: [0.2, 5]}\n') \
        .replace('(torque -', '(gain*torque -').replace(' - dry*sign(speed)', '') \
        .replace('  dry: {value: 0.1, fit: [0.0, 2.0]}\n', '') \
        .replace('drag: {value: 0.3, fit: [0.0, 3.0]}', 'drag: 0.0')
    u = torques(400, 0.02, np.random.default_rng(4))
    run = recorded(written(tmp_path, text), u)
    result = fit(load_free(written(tmp_path, text)), [run], 1.0, tries=1)
    assert 'only the ratio of gain and inertia is seen in this recording' in result.said
    assert np.isinf(result.spreads).all()
    assert result.values[1] / result.values[0] == pytest.approx(0.5 / 0.9, rel=0.01)


def test_an_offset_of_each_run_is_told_from_the_parameters(tmp_path):
    text = AXIS.replace(' - dry*sign(speed)', ' + load') \
        .replace('  dry: {value: 0.1, fit: [0.0, 2.0]}\n', '') \
        .replace('states:\n', 'states:\n  load: {slow: true, range: [-1, 1]}\n')
    truth = written(tmp_path, text, inertia=0.8, drag=0.6)
    random = np.random.default_rng(5)
    runs = [recorded(truth, torques(400, 0.02, random), x0=[load, 0.0, 0.0])
            for load in (-0.3, 0.2)]
    result = fit(load_free(written(tmp_path, text)), runs, 1.0, tries=1)
    assert result.values == pytest.approx([0.8, 0.6], rel=0.02)
    assert [o['load'] for o in result.offsets] == pytest.approx([-0.3, 0.2], abs=0.02)


def test_a_command_computed_from_a_sensor_is_said(tmp_path):
    here = Model(load_free(written(tmp_path)))
    random = np.random.default_rng(6)
    t = 0.01 * np.arange(1000)
    goal, noise = np.sin(0.7 * t) + 0.5 * np.sin(1.9 * t), 1e-3 * random.standard_normal(1000)
    angle, speed, y, u = 0.0, 0.0, np.zeros(1000), np.zeros(1000)
    for k in range(1000):
        y[k] = angle + noise[k]
        u[k] = 8.0 * (goal[k] - y[k])
        angle += 0.01 * speed
        speed += 0.01 * (u[k] - 2.0 * speed) / 0.8
    closed = Recording({'encoder': Track.of(t, y), 'torque': Track.of(t, u)})
    opened = recorded(written(tmp_path, **TRUTH), torques(500, 0.02, random))
    assert any('computed from encoder' in line for line in
               loops(cut([closed], here, 1.0), here.sensors, here.inputs))
    assert loops(cut([opened], here, 1.0), here.sensors, here.inputs) == []


def test_a_command_that_carries_the_sensor_is_said(tmp_path):
    text = AXIS.replace('torque: {unit: N m}', 'torque: {unit: N m}\n  goal: {unit: rad}') \
        .replace('(torque -', '(torque + 0*goal -')
    here = Model(load_free(written(tmp_path, text)))
    run = recorded(written(tmp_path, **TRUTH), torques(500, 0.02, np.random.default_rng(7)))
    run.tracks['goal'] = run.tracks['encoder']
    assert any('carries it' in line for line in
               loops(cut([run], here, 1.0), here.sensors, here.inputs))


def test_nothing_free_is_one_line(tmp_path):
    path = written(tmp_path, AXIS.replace(', fit: [0.1, 2.0]', '').replace(
        ', fit: [0.0, 3.0]', '').replace(', fit: [0.0, 2.0]', ''))
    with pytest.raises(BadInput, match=r'none has a key fit; give .*fit: \[0.1, 1.0\]'):
        load_free(path)


@pytest.mark.parametrize('ends, said', [
    ('[2.0, 0.1]', 'not below'), ('[0.6, 2.0]', 'not between'), ('3', 'two numbers'),
    ('[a, 2]', 'unknown name')])
def test_a_wrong_range_is_one_line(tmp_path, ends, said):
    with pytest.raises(BadInput, match=said):
        load_plant(written(tmp_path, AXIS.replace('[0.1, 2.0]', ends)))


def test_the_command_writes_the_file_back_with_its_comments(tmp_path, axis):
    ruamel = pytest.importorskip('ruamel.yaml')
    assert ruamel
    _, run, _ = axis
    table = tmp_path / 'run.csv'
    times = run.tracks['encoder'].times
    rows = zip(times, run.tracks['encoder'].values, run.tracks['torque'].values)
    table.write_text('time,encoder,torque\n' + ''.join(
        f'{t:.3f},{y!r},{u!r}\n' for t, y, u in ((t, float(y), float(u)) for t, y, u in rows)))
    path, out = written(tmp_path), tmp_path / 'fitted.yaml'
    for _ in range(2):  # what was written is a plant file for the next fit
        assert main([str(path), str(table), '--horizon', '0.5', '--tries', '1', '--to', '10',
                     '-o', str(out)]) == 0
        path = out
    text = out.read_text()
    for comment in ('# an axis, kept as it is', '# of the load', '# four lines a turn',
                    '#   fitted to run.csv, 0 s to 10 s'):
        assert text.count(comment) + (comment.endswith('10 s')) * (
            text.count('fitted to fitted') ) == 1, text
    plant = load_plant(out)
    assert plant.parameters['inertia'] == pytest.approx(0.8, rel=0.02)
    assert plant.spreads['inertia'] > 0.0 and plant.noise[0] > 0.0


def test_a_channel_that_is_missing_is_one_line(tmp_path, axis, capsys):
    table = tmp_path / 'run.csv'
    table.write_text('time,encoder\n0,1\n1,2\n2,3\n')
    assert main([str(axis[0]), str(table)]) == 2
    assert 'torque: this command of the plant is not in the recording' in capsys.readouterr().err
