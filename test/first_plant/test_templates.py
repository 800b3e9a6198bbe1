"""Templates: they load, what they ask can be set, and the designer has an answer for each."""

from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.start import main
from vsensor_ros.first_plant import filled, templates, write_plant
from vsensor_ros.plant import read_yaml
from vsensor_ros.recordings import Loss, Recording, replay, settings, Track, verdict
from vsensor_ros.simulate.simulate import readings, simulate

FOLDER = Path(__file__).resolve().parents[2] / 'config' / 'templates'
FOUND = {  # what the designer hands out when each sensor is lost alone
    'ackermann': {'x': 'filtered', 'y': 'filtered', 'yaw': 'filtered', 'gyro': 'filtered',
                  'odometer': 'exact', 'steering': 'exact'},
    'dc_motor': {'encoder': 'temporary', 'tacho': 'exact', 'ammeter': 'exact'},
    'differential_drive': {'x': 'filtered', 'y': 'filtered', 'yaw': 'filtered',
                           'gyro': 'filtered', 'wheel_left': 'exact', 'wheel_right': 'exact'},
    'joint': {'encoder': 'filtered', 'tacho': 'exact'},
    'quadrotor_axis': {'attitude': 'temporary', 'gyro': 'temporary'},
    'tank': {'inflow_meter': 'exact', 'gauge': 'exact', 'outflow_meter': 'exact'},
    'thermal_network': {'T1': 'exact', 'T2': 'exact', 'T_housing': 'exact'},
    'two_mass_drive': {'motor_encoder': 'exact', 'motor_tacho': 'exact', 'load_encoder': 'exact'},
}


SLOW = {'ackermann', 'differential_drive'}


@pytest.mark.parametrize('name', [
    pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in FOUND])
def test_the_designer_answers_for_every_sensor_of_a_template(name):
    plant = load_plant(FOLDER / f'{name}.yaml')
    assert {key[1]: entry.grade for key, entry in design(plant).entries.items()} == FOUND[name]


def test_each_template_is_complete_and_known():
    assert templates(FOLDER).keys() == FOUND.keys()
    for name in FOUND:
        plant, content = load_plant(FOLDER / f'{name}.yaml'), read_yaml(FOLDER / f'{name}.yaml')
        assert plant.name == name and not np.isnan(plant.noise).any()
        assert not np.isnan(plant.process_noise).any() and len(plant.tolerances) == len(
            plant.sensors)
        assert all(plant.units[key] for key in (*plant.states, *plant.inputs, *plant.sensors))
        for entry in content['parameters'].values():
            assert 'fit' not in entry or entry['fit'][0] <= entry['value'] <= entry['fit'][1]
        # its operating point is where it stays, but for what only turns or drives on
        rate = plant.rate_of_change(plant.operating_point, plant.operating_input)
        still = [i for i, state in enumerate(plant.states) if state not in (
            'x', 'y', 'angle', 'heading') and name != 'thermal_network']
        scale = 1e-6 + np.abs(plant.A) @ np.abs(plant.operating_point)
        assert (np.abs(rate) <= 0.05 * scale)[still].all(), rate


def test_an_estimate_follows_a_simulated_drive_whose_load_encoder_is_lost():
    plant, rate = load_plant(FOLDER / 'two_mass_drive.yaml'), 200.0
    t, rng = np.arange(0.0, 12.0, 1.0 / rate), np.random.default_rng(1)
    u = 0.6 * np.sign(np.sin(0.9 * t))[:, None]
    x = simulate(plant, t, u, x0=[0.0, 0.0, 0.0, 0.0, 0.3])
    said = readings(plant, t, x, u) + plant.noise * rng.standard_normal((len(t), 3))
    recording = Recording({name: Track.of(t, values) for name, values in zip(
        (*plant.sensors, *plant.inputs), (*said.T, *u.T))})
    made = design(plant, [('load_encoder',)])
    [(_, heard)] = replay(settings(made, rate), recording, [Loss(('load_encoder',), 6.0, 11.0)])
    found = verdict([heard['load_encoder']], Track.of(t, x[:, 2]))
    assert found.served == 1.0 and found.rmse < 0.001 and found.held > 100 * found.rmse


def test_what_is_set_is_in_the_file_and_all_else_as_it_was(tmp_path, capsys):
    path = tmp_path / 'plant.yaml'
    assert main(['joint', '--name', 'shoulder', '--set', 'inertia=0.02', '--set', 'weight=0',
                 '-o', str(path)]) == 0
    plant = load_plant(path)
    assert plant.name == 'shoulder' and plant.parameters['inertia'] == 0.02
    assert plant.spreads['inertia'] == pytest.approx(0.001)
    before = (FOLDER / 'joint.yaml').read_text().splitlines()
    after = path.read_text().splitlines()
    changed = [new for old, new in zip(before, after, strict=True) if old != new]
    assert changed == [
        'name: shoulder',
        '  inertia: {value: 0.02, unit: kg m^2, fit: [0.004, 0.08], spread: 0.001}',
        '  weight: {value: 0.0, unit: N m, fit: [0.0, 20.0], spread: 0.3}']
    assert main(['tank', '-o', str(path)]) == 2  # it is there
    assert 'is there already' in capsys.readouterr().err
    assert load_plant(path).name == 'shoulder'
    assert main(['tank', '-o', str(path), '--force']) == 0 and load_plant(path).name == 'tank'


@pytest.mark.parametrize(('arguments', 'said'), [
    (['jont'], "there is no template 'jont'; did you mean joint?"),
    (['joint', '--set', 'inetia=1'], "'inetia' is no parameter of joint; did you mean inertia?"),
    (['joint', '--set', 'inertia=heavy'], "--set inertia: 'heavy' is not a number"),
    (['joint', '--set', 'inertia=nan'], "--set inertia: 'nan' is not a number"),
    (['joint', '--set', 'inertia=-1'], '--set inertia: -1 has not the sign of 0.5'),
    (['joint', '--set', 'inertia'], '--set: inertia sets nothing'),
    (['joint', '--set', 'inertia=1', '--set', 'inertia=2'], 'is there twice'),
    (['joint', '--set', 'creep=0'], 'dynamics.velocity'),
    (['joint', '--name', 'my joint: {'], "--name: 'my joint: {' is not a name"),
    (['joint', '-o', 'nowhere/plant.yaml'], 'cannot be written'),
])
def test_what_cannot_be_is_one_line(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    line = capsys.readouterr().err
    assert said in line and line.count('\n') == 1 and line.startswith('start: ')
    assert list(tmp_path.iterdir()) == []


def test_without_arguments_it_lists_what_there_is(capsys):
    assert main([]) == 0
    listed = capsys.readouterr().out
    assert all(f'\n{name} ' in listed for name in FOUND)


def test_between_what_a_parameter_is_sought_is_two_numbers_that_rise(tmp_path):
    text = filled(FOLDER, 'joint')
    for wrong in ('[2.0, 0.1]', '0.5', '[0.1]', '[1, 1]'):
        with pytest.raises(BadInput, match=r'parameters\.inertia\.fit: .*write \[low, high\]'):
            write_plant(text.replace('[0.1, 2.0]', wrong), tmp_path / 'plant.yaml')
