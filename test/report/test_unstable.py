"""What the report shows of a plant that falls by itself: held, or its error alone."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from vsensor_ros import design, load_plant, Plant
from vsensor_ros.report import report_simulation
from vsensor_ros.report.hold import growth, holding_gain, linearised
from vsensor_ros.report.page import page
from vsensor_ros.report.report_simulation import disturbed, from_wrong_start

pytest.importorskip('matplotlib')
PENDULUM = """
name: pendulum
time: continuous
states:
  angle: {unit: rad, range: [-0.4, 0.4]}
  rate: {unit: rad/s, range: [-2, 2]}
inputs: {torque: {}}
disturbances: {gust: {}}
dynamics:
  angle: rate
  rate: 9.81*sin(angle) + %s - 0.2*rate + gust
sensors:
  protractor: {measures: angle, unit: rad, noise: 0.001}
  gyro: {measures: rate, unit: rad/s, noise: 0.001}
"""


def pendulum(folder, torque):
    (folder / 'plant.yaml').write_text(PENDULUM % torque)
    return load_plant(folder / 'plant.yaml')


def shown(monkeypatch, plant, result, *runs):
    """Return the report of what was run already."""
    for name, run in zip(('from_wrong_start', 'disturbed'), runs):
        monkeypatch.setattr(report_simulation, name, lambda *_, run=run: run)
    return page(plant, result)


def labels(text):
    return [t for svg in re.findall(r'<svg.*?</svg>', text, re.DOTALL)
            for t in ElementTree.fromstring(svg).itertext() if t.strip()]


@pytest.mark.slow
@pytest.mark.parametrize('torque', ['torque', '5*torque*cos(angle)'])
def test_an_unstable_plant_is_held(tmp_path, monkeypatch, torque):
    plant = pendulum(tmp_path, torque)
    result = design(plant, [('gyro',)], bounded=True)
    entry = result['gyro', 'gyro']
    runs = start, _ = from_wrong_start(plant, result, entry), disturbed(plant, result, entry)
    for run in runs:
        assert run.held and not run.runs_away
        assert np.abs(run.truth).max() < 5.0  # it was e**10 times what it began with
        assert np.abs(run.truth[-len(run.truth) // 4:]).max() < 2.0
    assert np.abs(start.error[-1]) < 1e-3 * np.abs(start.error[0])
    text = shown(monkeypatch, plant, result, *runs)
    assert 'from a wrong start, plant held' in labels(text) and 'truth' in labels(text)
    assert 'The plant is unstable by itself. Here a controller that knows' in text
    assert 'runs away' not in text


def test_a_discrete_plant_is_held():
    plant = Plant.from_matrices([[1.1, 0.1], [0, 0.8]], [[0], [1.0]], np.eye(2), D=[0, 1],
                                sample_time=0.1)
    result = design(plant, [('y2',)], bounded=True)
    run = from_wrong_start(plant, result, result['y2', 'y2'])
    assert run.held and np.abs(run.truth).max() < 5.0
    assert np.abs(run.error[-1]) < 1e-9


@pytest.mark.parametrize('commands', [None, [[1.0], [0.0]]])
def test_of_a_plant_that_cannot_be_held_only_the_error_is_shown(monkeypatch, commands):
    plant = Plant.from_matrices([[0.5, 1], [0, 0.3]], commands, np.eye(2))
    result = design(plant, [('y2',)])
    run = from_wrong_start(plant, result, result['y2', 'y2'])
    assert run.runs_away and not run.held
    text = shown(monkeypatch, plant, result, run)
    assert 'from a wrong start: the error' in labels(text)
    assert 'truth' not in labels(text) and '|error|' in labels(text)
    assert 'its commands do not hold it: only the error is drawn' in text
    assert ', while the truth runs away to ' in text


def test_commands_too_weak_to_hold_it_do_not_seem_to(tmp_path):
    plant = pendulum(tmp_path, 'sat(torque, -0.1, 0.1)')
    assert holding_gain(plant, 0.01, np.ones(2), np.ones(1)) is not None
    result = design(plant, [('gyro',)], bounded=True)
    assert from_wrong_start(plant, result, result['gyro', 'gyro']).runs_away


def test_a_stable_plant_is_left_alone():
    plant = Plant.from_matrices([[-1.0, 1], [0, -2]], [0, 1], np.eye(2))
    result = design(plant, [('y1',), ('y2',)])
    entry = next(v for v in result.virtual_sensors if v.order)
    run = from_wrong_start(plant, result, entry)
    assert not run.held and not run.runs_away
    assert not {'plant held', 'the error'} & set(' '.join(labels(page(plant, result))).split(', '))


def test_linearisation_is_that_of_the_equations(tmp_path):
    plant = pendulum(tmp_path, 'torque*cos(angle) + 0.3*torque**2 + sin(torque)*angle')
    A, B = linearised(plant)
    x, u, d = plant.operating_point, plant.operating_input, 1e-6
    for i, step in enumerate(d * np.eye(2)):
        difference = plant.rate_of_change(x + step, u) - plant.rate_of_change(x - step, u)
        assert A[:, i] == pytest.approx(difference / (2 * d), abs=1e-6)
    difference = plant.rate_of_change(x, u + d) - plant.rate_of_change(x, u - d)
    assert B[:, 0] == pytest.approx(difference / (2 * d), abs=1e-6)
    assert growth(plant) == pytest.approx(np.linalg.eigvals(A).real.max())
