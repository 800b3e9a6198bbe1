"""The designer asks for nonlinear functions by itself where no linear map does as well."""

import json

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank.bank import Bank
from vsensor_ros.designer.algebra.derivative import SMOOTH
from vsensor_ros.designer.by_functions import is_worth_asking
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse
from vsensor_ros.observers import Design, NonlinearSensor, Refusal, VirtualSensor
from vsensor_ros.simulate.simulate import readings, simulate

# its unknown input, the voltage over the field winding, is linear
MOTOR = """
name: motor
time: continuous
states:
  i: {range: [-5, 5], initial: 1, process_noise: 1e-4}
  w: {range: [1, 100], initial: 30, process_noise: 1e-4}
  flux: {range: [0.05, 1], initial: 0.4, process_noise: 1e-4}
inputs: {U: {range: [0, 50], operating: 20}}
disturbances: {field: }
dynamics: {i: (-i - flux*w + U)/0.05, w: (flux*i - 0.02*w)/0.01, flux: -2*flux + field}
sensors: {ammeter: {measures: i, noise: 0.01}, tacho: {measures: w, noise: 0.1}}
"""
# that T comes to what it should be is not sure where nothing flows in
TANK = """
name: tank
time: continuous
states:
  V: {range: [0.5, 3], initial: 1, process_noise: 1e-4}
  T: {range: [20, 60], initial: 40, process_noise: 1e-4}
inputs: {P: {range: [0, 10], operating: 5}, inflow: {range: [0, 2], operating: 0.5}}
dynamics: {V: inflow - 0.5*sqrt(V), T: inflow*(15 - T)/V + P/V}
sensors: {level: {measures: V, noise: 0.001}, thermometer: {measures: T, noise: 0.1}}
"""
# a level that is so exactly known that V*T is hardly noisier than what is linear
EXACT = TANK.replace('1e-4}\n  T', '1e-7}\n  T').replace('noise: 0.001', 'noise: 1e-6')
# the base slips, so that how fast it goes nobody knows; its gyro is a command
BASE = """
name: base
time: continuous
states:
  x: {range: [-50, 50], process_noise: 0.005}
  y: {range: [-50, 50], process_noise: 0.005}
  heading: {process_noise: 0.005}
inputs: {turn: {range: [-1, 1]}}
disturbances: {speed: {range: [-1, 1]}}
dynamics: {x: speed*cos(heading), y: speed*sin(heading), heading: turn}
sensors: {east: {measures: x, noise: 0.02}, north: {measures: y, noise: 0.02},
          compass: {measures: heading, noise: 0.02, wrap: 2*pi}}
"""


def made(tmp_path, text):
    path = tmp_path / 'plant.yaml'
    path.write_text(text, encoding='utf-8')
    return load_plant(path)


@pytest.mark.parametrize('text, lost, phi, why', [
    (MOTOR, 'tacho', 'w**2 + 5*i**2', 'other virtual sensors there are none'),
    (EXACT, 'thermometer', 'V*T', 'nothing is proved all over the declared ranges; at the')])
def test_it_is_asked_where_the_linear_search_finds_nothing_or_covers_less(
        tmp_path, text, lost, phi, why):
    plant = made(tmp_path, text)
    assert plant.unknown is None
    found = design(plant, [lost])[lost, lost]
    assert isinstance(found, NonlinearSensor) and found.phi == (phi,) and found.proved
    assert why in found.why
    linear = design(plant, [lost], method='jordan')[lost, lost]
    assert isinstance(linear, Refusal) or linear.certificate is not None


def test_one_that_is_much_noisier_than_what_is_linear_is_said_only(tmp_path):
    plant = made(tmp_path, TANK)
    found, alone = (design(plant, ['thermometer'], method=method)['thermometer', 'thermometer']
                    for method in (None, 'functions'))
    assert isinstance(found, VirtualSensor) and alone.phi == ('V*T',) and alone.proved
    assert alone.drift[-1] > 2.0 * found.noise.error
    assert 'V*T, but is 53.3 times as noisy' in found.method
    assert '--method functions hands it out' in found.method


def test_it_is_not_asked_where_all_is_proved(tmp_path):
    found = design(made(tmp_path, TANK.replace('inflow: {range: [0, 2]', 'inflow: {range: [1, 2]')
                        .replace('operating: 0.5', 'operating: 1.5')), ['thermometer'])
    linear = found['thermometer', 'thermometer']
    assert isinstance(linear, VirtualSensor) and 'V*T' not in linear.method


def test_what_is_not_smooth_is_not_asked_about_where_there_is_a_linear_one(tmp_path):
    assert 'abs' not in SMOOTH
    text = TANK.replace('+ P/V', '+ P/V - 0.001*abs(T - 30)')
    found = design(made(tmp_path, text), ['thermometer'])['thermometer', 'thermometer']
    assert not isinstance(found, NonlinearSensor)


def test_it_is_not_asked_where_no_healthy_sensor_is_left(tmp_path):
    plant = made(tmp_path, MOTOR)
    assert is_worth_asking(plant, ('tacho',), 'tacho', True)
    assert not is_worth_asking(plant, ('ammeter', 'tacho'), 'tacho', True)


def test_one_that_is_corrected_goes_before_a_linear_one_that_drifts(tmp_path):
    """Truth is simulated: a gyro is off by 5 mrad/s, which the way of the base tells."""
    plant = made(tmp_path, BASE)
    function = design(plant, ['compass'])
    assert isinstance(function['compass', 'compass'], NonlinearSensor)
    assert function['compass', 'compass'].grade == 'temporary'
    rate, count = 20, 800
    t = np.arange(count) / rate
    turn = 0.4 * np.sin(0.3 * t)
    x = simulate(plant, t, turn[:, None] + 0.005, lambda time: [np.sign(np.sin(0.7 * time)) + 0.3],
                 [0.0, 0.0, 0.4])
    y = readings(plant, t, x, turn[:, None]) + 0.02 * np.random.default_rng(2).standard_normal(
        (count, 3))
    bank, lost = Bank(function, rate), ('compass',)
    error = []
    for k in range(count):
        now = 10**9 + round(t[k] * 10**9)
        for j, sensor in enumerate(plant.sensors):
            if sensor not in lost or k < 100:
                bank.take(sensor, now, y[k, j])
        bank.take('turn', now, turn[k])
        bank.advance(now)
        if k == 100:
            bank.distrust(lost, now)
        if k > 100:
            error.append(bank.estimate(lost, 'compass') - x[k, 2])
    drifted = 0.005 * (t[-1] - t[100])  # what adding up the gyro comes to
    assert abs(np.array(error)[-100:]).max() < 0.5 * drifted


def test_what_noise_does_to_each_is_in_the_design(tmp_path):
    """One noise of the heading drives all three: with what it does to them it is in the file."""
    made_of = design(made(tmp_path, BASE), ['compass'])
    made_of.save(tmp_path / 'd.json')
    entry = Design.load(tmp_path / 'd.json')['compass', 'compass']
    assert entry.driven == made_of['compass', 'compass'].driven and not entry.process_noise.any()
    known = {'z1': 0.6, 'z2': 0.8, 'z3': 0.0, 'east': 2.0, 'north': 3.0, 'turn': 0.0}
    G = Equations([parse(text) for text in entry.driven], list(known)).values(
        np.array(list(known.values()))[:, None]).reshape(3, 3)
    # of sin, cos, and y cos - x sin, by x, y and the heading
    assert np.allclose(G, 0.005 * np.array([[0, 0, 0.8], [0, 0, -0.6],
                                            [-0.6, 0.8, -3.0 * 0.6 - 2.0 * 0.8]]))
    record = json.loads((tmp_path / 'd.json').read_text())
    record['entries'][0]['driven'].pop()
    (tmp_path / 'd.json').write_text(json.dumps(record))
    with pytest.raises(BadInput, match='driven: are not as many for each of 3 states'):
        Design.load(tmp_path / 'd.json')
