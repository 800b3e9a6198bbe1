"""A model of recordings alone: simulated systems are found again, and the designer takes it."""

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.start import main
from vsensor_ros.first_plant.black_box import black_box, box_text
from vsensor_ros.first_plant.subspace import arx, arx_errors, Linear, subspace
from vsensor_ros.recordings import Recording, Track

A = np.array([[0.9, 0.2, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.0, 0.5]])
B = np.array([[0.0, 1.0], [1.0, 0.0], [0.3, 1.0]])
C = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]])
D = np.array([[0.0, 0.4], [0.0, 0.0]])


def simulated(count, seed, noise=0.0, driven=0.0, direct=0.0, feedback=0.0):
    """Return commands and readings of the system above."""
    random, x = np.random.default_rng(seed), np.zeros(3)
    u, y = random.standard_normal((count, 2)), np.empty((count, 2))
    for k in range(count):
        y[k] = C @ x + direct * D @ u[k] + noise * random.standard_normal(2)
        u[k] -= feedback * y[k]
        x = A @ x + B @ u[k] + driven * random.standard_normal(3)
    return u, y


def response(a, b, c, d, angles):
    return np.array([c @ np.linalg.solve(np.exp(1j * w) * np.eye(len(a)) - a, b) + d
                     for w in angles])


@pytest.mark.parametrize('direct', [False, True])
def test_poles_and_responses_are_exact_without_noise(direct):
    found = subspace([simulated(300, 1, direct=direct), simulated(200, 2, direct=direct)], 3, 6,
                     direct)
    assert np.sort_complex(np.linalg.eigvals(found.A)) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(A)), abs=1e-6)
    angles = np.linspace(0.0, np.pi, 20)
    assert response(found.A, found.B, found.C, found.D, angles) == pytest.approx(
        response(A, B, C, direct * D, angles), abs=1e-6)


@pytest.mark.parametrize('feedback', [0.0, 0.1])
def test_with_noise_the_frequency_response_is_near_in_a_closed_loop_too(feedback):
    found = subspace([simulated(6000, 3, 0.3, 0.1, feedback=feedback)], 3, 10)
    angles = np.linspace(0.02, np.pi, 40)
    true = response(A, B, C, 0.0 * D, angles)
    off = response(found.A, found.B, found.C, found.D, angles) - true
    assert np.abs(off).max() < 0.05 * np.abs(true).max()


def test_errors_ahead_are_those_of_predictions():
    model = Linear(A, B, C, D, np.full((3, 2), 0.1), np.eye(2), np.ones(3))
    u, y = simulated(60, 4, 0.2)
    found = model.errors((u, y), (1, 3))
    x = np.zeros(3)
    for k in range(20):
        x = A @ x + B @ u[k] + model.K @ (y[k] - C @ x - D @ u[k])
    assert found[0, 20] == pytest.approx(C @ x + D @ u[20] - y[20])
    for k in (20, 21):
        x = A @ x + B @ u[k]
    assert found[1, 22] == pytest.approx(C @ x + D @ u[22] - y[22])
    assert np.isnan(found[1, :2]).all()


def test_an_autoregression_is_exact_without_noise():
    runs = [simulated(200, 5)]
    assert np.nanmax(np.abs(arx_errors(arx(runs, 3), 3, simulated(50, 6), (1, 10)))) < 1e-6


def recorded(seed, count=2000, step=0.1):
    """Return a tank of two basins in deviations that the commands bring about, with offsets."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(0.0, 2.0, count // 20 + 1), 20)[:count]
    rates, x = np.array([[-0.5, 0.3], [0.2, -0.4]]), np.zeros(2)
    y = np.empty((count, 2))
    for k in range(count):
        y[k] = 3.0 + x + 0.02 * random.standard_normal(2)
        for _ in range(10):
            x = x + step / 10 * (rates @ x + np.array([u[k], 0.0]))
        x = x + 0.01 * random.standard_normal(2)
    t = step * np.arange(count)
    return Recording({'upper': Track.of(t, y[:, 0]), 'lower': Track.of(t, y[:, 1]),
                      'pump': Track.of(t, u)}, 'tank', {'upper': 'cm'})


def test_the_plant_file_has_the_poles_the_offsets_and_the_noise(tmp_path):
    box = black_box([recorded(1)], ['pump'])
    assert len(box.model.A) == 2
    assert (box.plant[-1] < box.held[-1] / 3).all()
    path = tmp_path / 'box.yaml'
    path.write_text(box_text(box, 'tank', 'tank.csv'))
    plant = load_plant(path)
    rates = np.array([[-0.5, 0.3], [0.2, -0.4]])
    assert np.sort(np.linalg.eigvals(plant.A)) == pytest.approx(
        np.sort(np.linalg.eigvals(rates)), rel=0.1)
    # what it shows at rest under a command of 1: 3 and the gain
    rest = np.linalg.solve(plant.A, -plant.B[:, 0])
    offsets = [plant.curves[name].offset for name in plant.sensors]
    assert offsets + plant.C @ rest == pytest.approx(
        3.0 - np.linalg.solve(rates, [1.0, 0.0]), rel=0.03)
    assert plant.noise == pytest.approx([0.02, 0.02], rel=0.3)
    driven = plant.C @ np.diag(plant.process_noise**2) @ plant.C.T
    assert np.sqrt(np.diag(driven)) == pytest.approx([0.01 / 0.1**0.5] * 2, rel=0.3)
    assert offsets + plant.C @ plant.initial == pytest.approx(box.means[1:], rel=1e-4)
    assert plant.units['upper'] == 'cm'
    assert {e.grade for e in design(plant).entries.values()} == {'exact'}


def test_the_command_writes_it_and_says_how_good_it_is(tmp_path, capsys):
    run, out = recorded(2), tmp_path / 'box.yaml'
    np.savetxt(tmp_path / 'run.csv', np.column_stack(
        [run.tracks['upper'].times, *(t.values for t in run.tracks.values())]), delimiter=',',
        comments='', header='t,upper,lower,pump')
    words = [str(tmp_path / 'run.csv'), '--black-box', 'auto', '--commands', 'pump',
             '-o', str(out)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert '2 states' in said and 'ARX' in said
    assert load_plant(out).inputs == ('pump',)
    assert main(words) == 2
    assert 'is there already' in capsys.readouterr().err
    before = (tmp_path / 'run.csv').read_text()
    assert main([*words[:-1], words[0], '--force']) == 2
    assert 'would be lost' in capsys.readouterr().err
    assert (tmp_path / 'run.csv').read_text() == before
    assert main(['--black-box', '2']) == 2
    assert '--black-box: is of no recording' in capsys.readouterr().err


def test_without_commands_all_channels_are_sensors():
    box = black_box([recorded(2)], (), 2)
    assert box.commands == () and set(box.sensors) == {'upper', 'lower', 'pump'}
    assert 'inputs' not in box_text(box, 'tank', 'a tank')


def test_steps_that_are_too_long_are_one_line():
    with pytest.raises(BadInput, match='is too short for steps of 1000 s'):
        black_box([recorded(3)], ['pump'], 2, step=1000.0)


@pytest.mark.parametrize(('commands', 'order', 'line'), [
    (['valve'], None, "--commands: 'valve' is not in tank; its channels are upper, lower, pump"),
    (['upper', 'lower', 'pump'], None, '--commands: no channel is left for a sensor'),
    (['pump'], 40, '--black-box: 40 states are too many for this recording; give at most 14')])
def test_what_cannot_be_found_is_one_line(commands, order, line):
    with pytest.raises(BadInput, match=line):
        black_box([recorded(3)], commands, order)


def test_options_of_a_black_box_alone_are_refused(capsys):
    assert main(['joint', '--commands', 'u']) == 2
    assert '--black-box' in capsys.readouterr().err
    assert main(['joint', 'tank']) == 2
    assert 'tank: is one too many' in capsys.readouterr().err
