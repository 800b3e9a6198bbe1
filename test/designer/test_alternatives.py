"""What is taken of several that are proved, and what is said of the others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant
from vsensor_ros.designer import alternatives
from vsensor_ros.designer.alternatives import quietest
from vsensor_ros.designer.simulated_noise import simulated_noise
from vsensor_ros.observers import Noise, ScheduledSensor
from vsensor_ros.reason import Reason
from vsensor_ros.report.design_answer import answer
from vsensor_ros.report.page import write_report

TANK = """
name: tank
time: continuous
parameters: {k: {value: 0.8, spread: 0.04}}
states: {level: {range: [0.2, 4]}, flow: {range: [0, 4]}}
inputs: {pump: {range: [0, 3], operating: 1}, valve: {range: [0.2, 1], operating: 0.5}}
disturbances: {leak: {range: [-0.1, 0.1]}}
dynamics: {level: pump - k*valve*level, flow: 4*valve*level - 5*flow + 0*leak}
sensors: {gauge: {measures: level, noise: 0.01}, meter: {measures: flow, noise: 0.01}}
"""


@pytest.fixture(name='tank', scope='module')
def _tank(tmp_path_factory):
    path = tmp_path_factory.mktemp('tank') / 'tank.yaml'
    path.write_text(TANK)
    return load_plant(path)


def submodel(J, half_width=0.3):
    """Return a scheduled sensor of the tank's level with two equal submodels: z = level."""
    half = np.array([[0.2, 1.0]])
    return ScheduledSensor(
        'gauge', ('gauge',), ('meter',), ('pump', 'valve'), 'exact', ('valve',), half,
        ('1 - (valve - 0.2)/0.8', '(valve - 0.2)/0.8'), np.zeros((1, 1)), np.array([[0.0, 1.0]]),
        np.array([[[-0.16 - J * 0.16]], [[-0.8 - J * 0.8]]]), np.full((2, 1, 1), J),
        np.tile([[[1.0, 0.0]]], (2, 1, 1)), np.zeros((2, 1)), np.ones((1, 1)), np.zeros((1, 1)),
        np.ones((1, 1)), np.zeros(1), 100.0, 0.1, half_width, 0.0)


def test_who_is_proved_says_that_no_other_could_be_much_quieter(tank, tmp_path):
    made = design(tank)
    gauge = made[('gauge',), 'gauge']
    assert gauge.kind == 'functional' and gauge.certificate.status in ('global', 'region')
    assert f'no more than {gauge.noise.ratio:.3g} times quieter' in gauge.why
    assert 'alternatives' in answer(made) and 'times quieter' in ' '.join(answer(made).split())
    made.save(tmp_path / 'design.json')
    assert Design.load(tmp_path / 'design.json')[('gauge',), 'gauge'].why == gauge.why
    page = write_report(tmp_path / 'report.html', tank, made)
    assert 'alternatives' in Path(page).read_text(encoding='utf-8')
    assert not design(tank, scheduled=False)[('gauge',), 'gauge'].why
    # a linear error has none to be beside
    assert not made[('meter',), 'meter'].why or made[('meter',), 'meter'].active


def test_of_two_that_are_proved_the_quieter_one_is_taken(tank, monkeypatch):
    gauge = design(tank)[('gauge',), 'gauge']
    noisy = replace(gauge, noise=Noise(0.1, 0.01, False))

    def asked(noise, over=None):
        monkeypatch.setattr(alternatives, 'simulated_noise', lambda *_: noise)
        return quietest(tank, noisy, lambda: over or submodel(0.1))
    quieter = asked(np.array([0.1, 0.05]))
    assert isinstance(quieter, ScheduledSensor) and 'off by 0.1 (rms)' in quieter.why
    alike = asked(np.array([0.1, 0.09]))
    assert alike.kind == 'functional' and 'by 0.09 (rms)' in alike.why
    assert 'nobody knows' in asked(None).why
    assert 'unknown inputs reach those' in asked(None, replace(submodel(0.1), grade='bounded')).why
    assert asked(None, Reason.of('premise not read', names=('x',))).why.startswith('no healthy')


def test_noise_is_simulated_on_the_same_runs(tank):
    """What corrects the level by the meter is off by its noise, and twice that with twice it."""
    gauge = design(tank)[('gauge',), 'gauge']
    loud = replace(tank, noise=2.0 * tank.noise)
    once, twice = (simulated_noise(plant, [gauge, gauge]) for plant in (tank, loud))
    assert once[0] == once[1]
    assert 1.6 * once[0] < twice[0] < 2.4 * once[0]
