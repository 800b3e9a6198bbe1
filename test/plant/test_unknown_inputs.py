"""Unknown inputs inside nonlinear addends, and sensors that no linear map can use."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer import design
from vsensor_ros.functions.expression import to_words
from vsensor_ros.observers import Refusal
from vsensor_ros.plant import load_plant
from vsensor_ros.plant.plant import measures_node
from vsensor_ros.simulate.simulate import readings, simulate

TANK = """
name: heated_tank
time: continuous
states: {V: {range: [0.5, 3], initial: 1}, T: {range: [20, 60], initial: 40}}
inputs: {P: {range: [0, 10], operating: 5}}
disturbances: {rho: {range: [0, 2], process_noise: 0.3}}
dynamics: {V: rho - 0.5*sqrt(V), T: (15 - T)*rho/V + P/V}
sensors: {level: V, thermometer: T}
"""
CRANE = """
name: crane
time: continuous
states: {v: {range: [-1, 1]}, th: {range: [-0.6, 0.6]}, q: {range: [-1, 1]}}
inputs: {F: }
disturbances: {rho: }
definitions: {vd: (F + rho + sin(th)*(q**2 + 9.81*cos(th)) + 0.2*q*cos(th))/(5 + sin(th)**2)}
dynamics: {v: vd, th: q, q: -vd*cos(th) - 9.81*sin(th) - 0.2*q}
sensors: {speed: v, sway: th, rate: q}
"""
PMSM = """
name: pmsm
time: continuous
states: {ia: , ib: , th: }
inputs: {ua: , ub: }
disturbances: {rho: }
dynamics:
  ia: (ua - 0.5*ia + 0.1*rho*sin(th))/0.01
  ib: (ub - 0.5*ib - 0.1*rho*cos(th))/0.01
  th: rho
sensors: {a: ia, b: ib, cosine: cos(th), sine: sin(th)}
"""
BATTERY = """
name: battery
time: continuous
states: {s: {range: [0.1, 0.9], initial: 0.5}, v1: {range: [-0.1, 0.1]}}
disturbances: {rho: }
dynamics: {s: -rho/3600, v1: -v1/40 + rho/2000}
sensors: {voltage: 3.2 + 0.6*s + 0.4*s**2 - v1, charge: s}
"""
# all but the linear addends are of one direction each: rho*(a + b) is the sum of the others
DEPENDENT = """
name: p
time: {unit}
states: {{a: {{}}, b: {{}}, c: {{}}}}
disturbances: {{rho: , tau: }}
dynamics: {{a: 2*rho*a, b: 3*rho*b - 2*b + tau, c: rho*(a + b) - c}}
sensors: {{ya: a, yc: c}}
"""


def loaded(tmp_path, text):
    path = tmp_path / 'plant.yaml'
    path.write_text(text)
    return load_plant(path)


def test_each_direction_is_an_unknown_input_of_its_own(tmp_path):
    plant = loaded(tmp_path, TANK)
    assert plant.unknown_inputs == ('rho',) and plant.disturbances == ('rho_in_V', 'rho_in_T')
    assert plant.D.tolist() == [[1, 0], [0, 1]] and not plant.Cd.any()
    assert plant.unknown.ranges == ((0.0, 2.0),) and plant.unknown.noise == (0.3,)
    [said] = plant.remarks
    assert 'rho pushes in 2 directions' in said and 'rho_in_V, rho_in_T' in said


@pytest.mark.parametrize('unit', [
    'continuous', '{sample_time: 0.1}', 'continuous\ntime_unit: min'])
def test_directions_are_those_of_the_span(tmp_path, unit):
    plant = loaded(tmp_path, DEPENDENT.format(unit=unit))
    assert plant.disturbances == ('tau', 'rho_in_a', 'rho_in_b')
    scale = 60.0 if 'min' in unit else 1.0
    assert np.allclose(plant.D, [[0, 1, 0], [1 / scale, 0, 1], [0, 1 / 2, 1 / 3]])
    x, rho = np.array([[1.0, -2.0], [3.0, 0.5], [0.2, 7.0]]), np.array([[5.0, -1.0], [2.0, 3.0]])
    a, b, c = x
    assert np.allclose(plant.rate_of_change(x, [], rho), np.array([
        2 * rho[0] * a, 3 * rho[0] * b - 2 * b + rho[1], rho[0] * (a + b) - c]) / scale)
    assert np.allclose(plant.rate_of_change(x, []), np.array([0 * a, -2 * b, -c]) / scale)


def test_one_that_pushes_one_way_keeps_its_name(tmp_path):
    plant = loaded(tmp_path, TANK.replace('V: rho -', 'V: 0 -').replace('P/V', 'P/V'))
    assert plant.disturbances == ('rho',) and plant.D.tolist() == [[0], [1]]
    assert plant.unknown is not None and not plant.remarks
    entry = design(plant)['level', 'level']
    assert not isinstance(entry, Refusal) and entry.grade == 'exact'


def test_it_runs_with_what_is_given(tmp_path):
    """Truth is another integrator, of the equations as they are written."""
    t = np.linspace(0.0, 5.0, 51)

    def rho(time):
        return [1.0 + np.sin(3 * time)]

    x = simulate(loaded(tmp_path, TANK), t, np.full((51, 1), 4.0), rho)
    truth = solve_ivp(lambda time, x: [
        rho(time)[0] - 0.5 * np.sqrt(x[0]), rho(time)[0] * (15 - x[1]) / x[0] + 4.0 / x[0]],
        (0.0, 5.0), [1.0, 40.0], t_eval=t, rtol=1e-11, atol=1e-11).y.T
    assert np.abs(x - truth).max() < 1e-7 and np.ptp(x[:, 1]) > 5.0


def test_sensors_show_what_they_measure(tmp_path):
    plant = loaded(tmp_path, BATTERY)
    assert plant.C.tolist() == [[0.6, -1.0], [1.0, 0.0]]
    assert plant.Cd.tolist() == [[0, 1], [0, 0]]
    assert plant.disturbances == ('rho', 'bend_of_voltage')
    x = np.array([[0.2, 0.05], [0.8, -0.03]])
    assert np.allclose(readings(plant, [0.0, 1.0], x), np.column_stack([
        3.2 + 0.6 * x[:, 0] + 0.4 * x[:, 0]**2 - x[:, 1], x[:, 0]]))
    assert to_words(measures_node(plant, 0)) == '0.6*s - v1 + (0.4*s**2 + 3.2)'


def test_a_sensor_that_shows_what_is_pushed_tells_of_it(tmp_path):
    """An accelerometer reads the unknown force as it acts, so that it is known."""
    plant = loaded(tmp_path, CRANE.replace('speed: v', 'speed: v, acceleration: vd'))
    assert plant.disturbances == ('rho_in_v', 'rho_in_q')
    assert plant.Cd.tolist() == [[0, 0], [1, 0], [0, 0], [0, 0]]
    entry = design(plant)['speed', 'speed']
    assert entry.grade == 'temporary' and entry.reads == ('acceleration',)


@pytest.mark.parametrize(('text', 'lost'), [
    (TANK, 'thermometer'), (CRANE, 'rate'), (PMSM, 'cosine'), (BATTERY, 'charge')])
def test_no_linear_map_is_free_of_them(tmp_path, text, lost):
    found = design(loaded(tmp_path, text), [(lost,)], method='jordan')
    assert isinstance(found[lost, lost], Refusal)


@pytest.mark.parametrize(('old', 'new', 'needle'), [
    ('(15 - T)*rho/V', '(15 - T)*rho/W', "dynamics.T: unknown name 'W'"),
    ('(15 - T)*rho/V', 'rho*T/(1 - 1)', 'dynamics.T: '),
    ('(15 - T)*rho/V', '+'.join(['rho*sin(V)'] * 60), 'nested'),
    ('thermometer: T', 'thermometer: {measures: T*V, wrap: 360}', 'is a curve, and wraps'),
    ('thermometer: T', 'thermometer: P**2', 'is a curve of commands alone'),
    ('disturbances: {', 'disturbances: {rho_in_T: , ', 'disturbances.rho_in_T: is the name of')])
def test_what_is_wrong_is_one_line(tmp_path, old, new, needle):
    assert old in TANK
    with pytest.raises(BadInput) as refusal:
        loaded(tmp_path, TANK.replace(old, new))
    line = str(refusal.value)
    assert needle in line and '\n' not in line and '; ' in line
