"""What a fit finds of plants that are known, and what it says of those it cannot know."""

import numpy as np
from plants import AXIS, recorded, torques, TRUTH, written
import pytest

from vsensor_ros import load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.fit import main
from vsensor_ros.fitting import fit
from vsensor_ros.fitting.fit import resolution
from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.search import search
from vsensor_ros.fitting.suspicion import loops
from vsensor_ros.fitting.windows import averaging, cut
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


@pytest.mark.parametrize(('rows', 'value', 'horizon', 'line'), [
    (2, 0.1, None, '--horizon: .* shorter than three readings'),
    (500, 0.1, 1e-9, '--horizon: .* shorter than three readings'),
    (500, 0.0, None, 'no sensor of the plant moves in it')])
def test_what_cannot_be_fitted_is_one_line(axis, rows, value, horizon, line):
    path, run, _ = axis
    tracks = {name: Track(t.stamps[:rows], np.where(value, t.values[:rows], 0.0))
              for name, t in run.tracks.items()}
    with pytest.raises(BadInput, match=line):
        fit(load_free(path), [Recording(tracks)], horizon, tries=1)


def test_a_recording_is_not_written_over_and_what_is_no_reading_is_said(tmp_path, capsys):
    plant, table = written(tmp_path), tmp_path / 'run.csv'
    text = 't,encoder,torque\n' + ''.join(f'{k},1e200,{k}\n' for k in range(9))
    table.write_text(text)
    for output, line in ((table, 'would be lost'), (tmp_path, 'cannot be written'),
                         (tmp_path / 'none' / 'plant.yaml', 'cannot be written'),
                         (plant, 'encoder: has values beyond 1e100')):
        assert main([str(plant), str(table), '-o', str(output)]) == 2
        said = capsys.readouterr().err
        assert line in said and said.count('\n') == 1
    assert table.read_text() == text


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


def test_starts_do_not_bend_to_what_the_model_gets_wrong_later(tmp_path):
    text = AXIS.replace(' - dry*sign(speed)', '').replace(
        '  dry: {value: 0.1, fit: [0.0, 2.0]}\n', '')
    run = recorded(written(tmp_path, **TRUTH), torques(500, 0.02, np.random.default_rng(3)))
    result = fit(load_free(written(tmp_path, text)), [run], 1.0, tries=1)  # it knows no dry one
    model, windows = result.model, cut([run], result.model, 1.0)
    found = search(model, windows, result.values, 1)
    misfits = found.shot.misfits[:, 0]
    assert np.abs(misfits[0]).max() < 3e-3 < 0.2 * np.abs(misfits[-1]).max()
    sizes = found.shooting.sizes()[:, 0]
    assert sizes[0] < 0.5 * sizes[1] and (sizes[1:] == found.shooting.deviations[0]).all()


def test_starts_are_free_beside_an_unknown_input(tmp_path, axis):
    _, run, _ = axis
    text = AXIS.replace('dynamics:', 'disturbances:\n  push: {unit: N m}\ndynamics:').replace(
        '- dry*sign(speed))', '- dry*sign(speed) + push)')
    model = Model(load_free(written(tmp_path, text)))
    found = search(model, cut([run], model, 1.0), np.array([0.8, 0.5, 0.2]), 1)
    sizes = found.shooting.sizes()
    assert model.unknown and (sizes == found.shooting.deviations).all()


def test_a_state_that_adds_up_another_has_no_noise_of_its_own(tmp_path, axis):
    def driven(angle, speed=''):
        text = AXIS.replace('angle: {unit: rad}', f'angle: {{unit: rad{angle}}}').replace(
            'speed: {unit: rad/s}', f'speed: {{unit: rad/s{speed}}}')
        return load_free(written(tmp_path, text))
    assert Model(driven(', process_noise: 1e-6', ', process_noise: 1e-6')).told().tolist() == [
        True, False]
    assert Model(driven('')).told().tolist() == [False, False]
    given = driven(', process_noise: 1e-6')
    result = fit(given, [axis[1]], 1.0, tries=1)
    assert result.noise.driven[0] == pytest.approx(1e-6)
    assert result.noise.driven[1] != pytest.approx(1e-6)


def test_noise_is_that_of_one_reading_where_the_grid_lies_between_stamps(axis):
    model, random = axis[2].model, np.random.default_rng(2)
    t = np.cumsum(random.uniform(0.01, 0.03, 4000))
    run = Recording({'encoder': Track.of(t, random.standard_normal(4000)),
                     'torque': Track.of(t, np.zeros(4000))})
    windows = cut([run], model, 2.0)
    on_grid = np.nanstd(windows.readings)
    assert on_grid < 0.9
    assert on_grid / averaging([run], model, windows)[0] == pytest.approx(1.0, abs=0.05)


def test_rounding_is_no_step_of_a_sensor(axis):
    model, random = axis[2].model, np.random.default_rng(1)
    counts = np.round(np.cumsum(random.standard_normal(400)))
    values = 0.05 * counts + 1e-15 * random.standard_normal(400)
    run = Recording({'encoder': Track.of(0.01 * np.arange(400), values)})
    assert resolution(model, [run])[0] == pytest.approx(0.05 / np.sqrt(12.0))


def test_windows_that_would_judge_what_was_fitted_are_said(tmp_path, capsys):
    run = recorded(written(tmp_path, **TRUTH), torques(300, 0.02, np.random.default_rng(3)))
    t, y, u = run.tracks['encoder'].times, *(run.tracks[n].values for n in ('encoder', 'torque'))
    np.savetxt(tmp_path / 'run.csv', np.column_stack([t, y, u]), delimiter=',', comments='',
               header='time,encoder,torque')
    (tmp_path / 'axis.yaml').write_text(
        'recordings: [run.csv]\nwindows: {every: 1, length: 0.5, start: 4}\n')
    arguments = [str(written(tmp_path)), str(tmp_path / 'axis.yaml'), '--horizon', '0.5',
                 '--tries', '1']
    assert main([*arguments, '--to', '4']) == 0
    assert 'windows' not in capsys.readouterr().err
    assert main(arguments) == 0
    assert 'the windows of axis.yaml are in what is fitted to' in capsys.readouterr().err


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
    assert plant.sensor_rate[0] == 50.0


def test_a_channel_that_is_missing_is_one_line(tmp_path, axis, capsys):
    table = tmp_path / 'run.csv'
    table.write_text('time,encoder\n0,1\n1,2\n2,3\n')
    assert main([str(axis[0]), str(table)]) == 2
    assert 'torque: this command of the plant is not in the recording' in capsys.readouterr().err
