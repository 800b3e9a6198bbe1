"""Functions of the states live: the heated tank on topics, its thermometer fails."""

import math
from pathlib import Path
import re

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
import pytest
from sensor_msgs.msg import Range, Temperature
from std_msgs.msg import Float64
import yaml

from vsensor_ros import load_plant
from vsensor_ros.command.designer import main as designer
from vsensor_ros.engine import Policy
from vsensor_ros.node.accessor import get_stamp
from vsensor_ros.node.cdr import decode
from vsensor_ros.node.diagnostics import channel_facts, describe, Scene
from vsensor_ros.simulate.simulate import readings, simulate

TANK = Path(__file__).parents[2] / 'config/heated_tank'
RATE, FROZEN, ISOLATED, SILENT, END = 100, 200, 220, 300, 600  # Hz, and periods
OUT = '/tank/temperature'


def flat(section, before=''):
    """Return nested parameters by their full names."""
    return {name: value for key, part in section.items() for name, value in (
        flat(part, f'{before}{key}.') if isinstance(part, dict) else {f'{before}{key}': part}
    ).items()}


@pytest.fixture(name='plant', scope='module')
def _plant():
    return load_plant(TANK / 'plant.yaml')


@pytest.fixture(name='design_file', scope='module')
def _design_file(tmp_path_factory):
    path = tmp_path_factory.mktemp('tank') / 'design.json'
    assert designer([str(TANK / 'plant.yaml'), '--fault-set', 'thermometer',
                     '-o', str(path)]) == 0
    return path


def played(plant):
    """Return what is commanded (T,), what both sensors read and what is true (T, 2)."""
    t = np.arange(END + 1) / RATE
    heater = 5.0 + 3.0 * np.sin(0.5 * t)

    def inflow(time):  # from an almost closed valve to twice what flows out
        return [0.65 + 0.55 * np.sign(np.sin(1.3 * time))]
    x = simulate(plant, t, heater[:, None], inflow, [1.5, 45.0])
    truth = readings(plant, t, x, heater[:, None], inflow)
    return heater, truth + plant.noise * np.random.default_rng(3).standard_normal(
        truth.shape), truth


def test_the_heated_tank_is_warm_as_the_simulator_says(rig, plant, design_file):
    parameters = flat(yaml.safe_load((TANK / 'replacer.yaml').read_text())['/**'][
        'ros__parameters'])
    r = rig({**parameters, 'design_file': str(design_file)})
    heard = r.listen('sensor_msgs/msg/Temperature', OUT)
    heater, read, truth = played(plant)
    began, period = r.now, round(1e9 / RATE)
    for k in range(END + 1):
        messages = [('/tank/level_raw', Range(range=read[k, 0], min_range=0.0, max_range=9.0))]
        if k < SILENT:
            warm = Temperature(temperature=read[min(k, FROZEN), 1])
            warm.header.frame_id = 'probe'
            messages.append((f'{OUT}_raw', warm))
        if k == ISOLATED:
            r.publisher(DiagnosticArray, '/isolation').publish(DiagnosticArray(status=[
                DiagnosticStatus(name='thermometer', level=b'\x02')]))
            assert r.spin_until(lambda: r.reported == {'thermometer'})
        count = r.taken['/tank/heater']
        r.publisher(Float64, '/tank/heater').publish(Float64(data=heater[k]))
        assert r.spin_until(lambda count=count: r.taken['/tank/heater'] > count)
        r.step(*messages)

    state = next(c for c in r.replacer.snapshot().channels if c.name == 'thermometer')
    assert (state.source, state.grade, state.fault_set, state.outside_region) == (
        'virtual', 'exact', ('thermometer',), False)
    scene = Scene('/replacer', r.replacer.settings.design, {'thermometer': Policy()},
                  ('thermometer',), {'thermometer': ()}, {'thermometer': 1})
    assert re.search(r'virtual \(isolated\), from level, P, good to 0\.00\d+ degC', describe(
        state, scene, set(plant.sensors)).message)
    facts = channel_facts(state, scene, 0.0)
    assert (facts['grade'], facts['method']) == ('exact', 'a function of the states: V*(T - 15)')

    sent = [decode(Temperature, raw) for raw in heard]
    assert {message.header.frame_id for message in sent} == {'probe'}
    at = np.array([get_stamp(message) - began for message in sent]) / period - 1.0
    spoken = at > ISOLATED + 0.5
    assert spoken.sum() > 0.9 * (END - ISOLATED) / 2 and np.diff(at).max() < 5.0
    said, stated = np.array([(message.temperature, math.sqrt(message.variance))
                             for message in sent])[spoken].T
    true = np.interp(at[spoken], np.arange(END + 1), truth[:, 1])
    assert abs(read[FROZEN, 1] - true).max() > 3.0  # what a sensor that is stuck is off by
    error = said - true
    # 0.0123 is the study's figure of a level as noisy, of one that shows the volume
    assert np.sqrt(np.mean(error**2)) < 2 * 0.0123 and (abs(error) < 3.0 * stated).all()
    # it says where the tank is: with a fuller one noise of the level matters less
    assert 0.7 < np.sqrt(np.mean(stated**2) / np.mean(error**2)) < 1.5
    assert stated.max() > 2.0 * stated.min()
    assert abs(np.diff(error)).max() < 0.1  # from the first on it moves as the tank does
