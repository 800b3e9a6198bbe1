"""Scenarios: what is sent, what is true, and what a wrong file is told."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
import yaml

from vsensor_ros import load_plant, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.simulate.scenario import load_scenario

CONFIG = Path(__file__).parents[2] / 'config'
LAG = Plant.from_matrices([[-1.0]], [[1.0]], [[1.0]], inputs=['u'], sensors=['y'],
                          units={'y': 'm'}, initial=[3.0])


def given():
    return {
        'title': 'a lag', 'failed_sensor': 'y', 'isolated_at': 1.5, 'speed': 1.0,
        'faults': [{'kind': 'freeze', 'start': 1.0}, {'kind': 'drop_out', 'start': 2.0}],
        'bar': {'rmse': 0.1, 'of': 'range'},
        'simulation': {'duration': 3.0, 'sensor_rate': 10.0, 'command_rate': 2.0,
                       'inputs': {'u': '1 + t'}}}


def load(tmp_path, content, plant=LAG):
    path = tmp_path / 'demo.yaml'
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return load_scenario(path, plant)


def test_simulated_scenario(tmp_path):
    scenario = load(tmp_path, given())
    x, expected = 3.0, [3.0]
    for k in range(6):      # the command is held for half a second
        u = 1.0 + 0.5 * k
        expected += [u + (x - u) * np.exp(-0.1 * i) for i in range(1, 6)]
        x = expected[-1]
    sent = scenario.channels['y']
    np.testing.assert_allclose(sent.value[:10], expected[:10], rtol=1e-8)
    np.testing.assert_array_equal(sent.value[10:], sent.value[9])
    np.testing.assert_array_equal(sent.sent, sent.time < 2.0)
    np.testing.assert_allclose(np.interp(sent.time, scenario.truth.time, scenario.truth.value),
                               expected, rtol=1e-8)
    np.testing.assert_allclose(scenario.channels['u'].value, 1.0 + 0.5 * np.arange(7))
    assert scenario.trusted == sent.value[9]
    assert scenario.bar == pytest.approx(0.1 * (3.0 - min(scenario.truth.value)))
    assert (scenario.start, scenario.end, scenario.failed_at) == (0.0, 3.0, 1.0)


def test_what_sensors_read_directly_is_in_what_they_say(tmp_path):
    plant = Plant.from_matrices(
        [[-1.0]], [[1.0]], [[1.0], [1.0]], inputs=['u'], sensors=['y', 'direct'], initial=[3.0],
        D=[[0.0]], Cu=[[0.0], [2.0]], Cd=[[0.0], [5.0]], disturbances=['rho'])
    content = given()
    content['simulation']['disturbances'] = {'rho': 'sin(t)'}
    channels = load(tmp_path, content, plant).channels
    t = channels['direct'].time
    np.testing.assert_allclose(
        channels['direct'].value[:10] - channels['y'].value[:10],
        (2.0 * (1.0 + np.floor(2.0 * t + 1e-9) / 2.0) + 5.0 * np.sin(t))[:10], rtol=1e-8)


def test_noise_is_on_the_readings_and_not_on_the_truth(tmp_path):
    content = given()
    content['simulation'] |= {'noise': {'y': 0.5}, 'sensor_rate': 100.0, 'initial': {'y': 1.0}}
    with pytest.raises(BadInput, match=r'simulation\.initial\.y'):
        load(tmp_path, content)     # y is a sensor, the state is x1
    content['simulation']['initial'] = {'x1': 1.0}
    scenario = load(tmp_path, content)
    sent = scenario.channels['y']
    noise = (sent.value - scenario.truth.value[::5])[sent.time < 1.0]
    assert 0.35 < noise.std() < 0.65
    assert scenario.truth.value[0] == 1.0


@pytest.mark.slow
@pytest.mark.parametrize('system', ['three_tank', 'servo'])
def test_the_shipped_scenarios_hold_what_they_promise(system):
    plant = load_plant(CONFIG / system / 'plant.yaml')
    scenario = load_scenario(CONFIG / system / 'demo.yaml', plant)
    if system == 'three_tank':  # its levels stay in order
        level3 = scenario.channels['y2'].value
        assert np.all(scenario.truth.value[::5] > level3) and np.all(level3 > 0)
    assert set(scenario.channels) == {*plant.sensors, *plant.inputs}
    after = scenario.truth.time > scenario.isolated_at
    hold = np.sqrt(np.mean((scenario.truth.value[after] - scenario.trusted) ** 2))
    assert hold > 50 * scenario.bar     # the last value held is visibly bad


def test_recorded_scenario(tmp_path, monkeypatch):
    y, u = np.arange(40.0), -np.arange(40.0)
    savemat(tmp_path / 'run.mat', {'y': y, 'u': u})
    monkeypatch.setenv('VSENSOR_DATA', str(tmp_path))
    content = given() | {'faults': [{'kind': 'drop_out', 'start': 15.0}], 'isolated_at': 15.5,
                         'bar': {'rmse': 2, 'of': 'unit'}, 'speed': 50}
    del content['simulation']
    content['recording'] = {
        'file': 'run.mat', 'url': 'http://127.0.0.1:9/run.mat', 'sample_time': 0.5, 'first': 20,
        'last': 39, 'columns': {'y': 'y', 'u': 'u'},
        'sha256': hashlib.sha256((tmp_path / 'run.mat').read_bytes()).hexdigest()}
    scenario = load(tmp_path, content)
    np.testing.assert_array_equal(scenario.truth.value, y[20:])
    np.testing.assert_array_equal(scenario.channels['u'].value, u[20:])
    assert (scenario.start, scenario.end, scenario.bar, scenario.trusted) == (10.0, 19.5, 2.0, 29)
    content['recording']['last'] = 40
    with pytest.raises(BadInput, match='20 to 40'):
        load(tmp_path, content)


WRONG = {
    'title': 3, 'failed_sensor': 'z', 'isolated_at': 0.5, 'speed': 0, 'bar': {'rmse': 1},
    'faults': [], 'simulation': None, 'extra': 1}


@pytest.mark.parametrize('key', WRONG)
def test_wrong_keys_are_named(tmp_path, key):
    with pytest.raises(BadInput, match=key) as refusal:
        load(tmp_path, given() | {key: WRONG[key]})
    assert '\n' not in str(refusal.value)


@pytest.mark.parametrize('fault', [
    {'kind': 'melt', 'start': 1.0}, {'kind': 'freeze'}, {'kind': 'bias', 'start': 1.0},
    {'kind': 'freeze', 'start': 1.0, 'size': 2.0}, {'kind': 'freeze', 'start': 'now'}, 3])
def test_wrong_faults_are_refused(tmp_path, fault):
    with pytest.raises(BadInput, match=r'faults\[0\]'):
        load(tmp_path, given() | {'faults': [fault]})


def test_a_sensor_that_never_moves_has_no_range(tmp_path):
    content = given()
    content['simulation'] |= {'inputs': {'u': 3}}
    with pytest.raises(BadInput, match='never moves'):
        load(tmp_path, content)


@pytest.mark.parametrize('text', ["__import__('os')", 'x + 1', 'log(0)*t', '1 +'])
def test_expressions_outside_the_language_are_refused(tmp_path, text):
    content = given()
    content['simulation']['inputs'] = {'u': text}
    with pytest.raises(BadInput, match=r'simulation\.inputs\.u'):
        load(tmp_path, content)


@pytest.mark.parametrize('text', ['', 'a: [', '!!python/object:os.system {}', '3'])
def test_what_is_no_scenario_is_refused(tmp_path, text):
    with pytest.raises(BadInput, match=r'demo\.yaml'):
        load(tmp_path, text)


@pytest.mark.parametrize('fault, told', [
    ({'kind': 'bias', 'start': 1.0}, r'faults\[0\].size: is missing; add it'),
    ({'kind': 'spikes', 'start': 1.0, 'size': 1.0}, r'faults\[0\].probability: is missing'),
    ({'kind': 'freeze', 'start': 1.0, 'size': 2.0},
     r'faults\[0\].size: is not known here; known are end, kind, start'),
    ({'start': 1.0}, r'faults\[0\].kind: is not a text')])
def test_a_fault_is_told_which_number_it_lacks_or_has_too_many(tmp_path, fault, told):
    with pytest.raises(BadInput, match=told):
        load(tmp_path, {**given(), 'faults': [fault]})


@pytest.mark.parametrize('fault, row, error', [
    ({'kind': 'spikes', 'start': 1.0, 'size': 2.0, 'probability': 1.0}, 15, 2.0),
    ({'kind': 'drift', 'start': 1.2, 'end': 2.45, 'rate': 8.0}, 24, 8.0 * 1.2)])
def test_each_number_of_a_fault_reaches_it(tmp_path, fault, row, error):
    said, healthy = (load(tmp_path, {**given(), 'faults': [each]}).channels['y'].value[row]
                     for each in (fault, {'kind': 'drop_out', 'start': 1.0}))
    assert abs(said - healthy) == pytest.approx(error)
