"""Plants on which a first designer went wrong: stiff, in SI units, or misled by their terms."""

import numpy as np
import pytest
from scipy.linalg import expm

from vsensor_ros import design, load_plant, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.observers import Refusal, VirtualSensor


def only(plant, fault_set, channel, **choices):
    return design(plant, [fault_set], **choices)[fault_set, channel]


def test_a_weak_coupling_of_a_stiff_plant_is_not_taken_for_rounding():
    """Motor current (1 us) heats the winding (600 s); the voltage noise must not be lost."""
    A = [[-4 / 2.75e-6, 0], [8e-4, -1 / 600]]
    disturbed = Plant.from_matrices(A, [1 / 2.75e-6, 0], [[0, 1]], D=[1 / 2.75e-6, 0])
    refusal = only(disturbed, ('y1',), 'y1')
    assert isinstance(refusal, Refusal) and 'rho1' in refusal.reason
    # with the current measured it is exact, and really fed by it
    both = Plant.from_matrices(A, [1 / 2.75e-6, 0], np.eye(2), D=[1 / 2.75e-6, 0])
    sensor = only(both, ('y2',), 'y2')
    transfer = sensor.Cv @ np.linalg.solve(-sensor.N, sensor.J) + sensor.Q
    assert transfer[0, 0] == pytest.approx(8e-4 * 600, rel=1e-9)


@pytest.mark.parametrize('A', [[[-5e-8]], [[-1.45e6, 0], [0, -1e-3]]])
def test_slow_and_stiff_stable_plants_are_stable(A):
    n = len(A)
    plant = Plant.from_matrices(A, None, np.ones((1, n)))
    sensor = only(plant, ('y1',), 'y1')
    assert isinstance(sensor, VirtualSensor)
    assert sensor.eigenvalues.real.max() == pytest.approx(np.max(np.diag(A)), rel=1e-4)


@pytest.mark.parametrize('A', [[[0, 1], [0, 0]], [[0]], [[1e-14, 0], [0, -1]]])
def test_integrators_are_not(A):
    plant = Plant.from_matrices(A, None, np.eye(len(A)))
    assert isinstance(only(plant, plant.sensors, 'y1', temporary=False), Refusal)
    assert only(plant, plant.sensors, 'y1').grade == 'temporary'


@pytest.mark.parametrize('text', ['2*w1', 'tanh(3*w1)'])
def test_a_term_that_destabilises_is_counted(text):
    """Only x2 is left to see x1' = -x1 + x2 + f(x1), which runs away by itself."""
    plant = Plant.from_matrices([[-1, 0], [0, -3]], None, np.eye(2), P=[1, 0], G=[[1, 0]],
                                nonlinearities=[text])
    refusal = only(plant, ('y1',), 'y1')
    assert isinstance(refusal, Refusal) and text.replace('w1', 'x1') in refusal.reason


def test_friction_with_the_wrong_sign_is_not_handed_out():
    """Erratum 1: with k7 = +1 two estimates both stay, -1 and +1 apart from zero."""
    def servo(k7):
        return Plant.from_matrices(
            [[0, 1, 0], [0, -1, 1], [0, -1, -1]], [0, 0, 1], np.eye(3), D=[1, 0, 0],
            P=[0, k7, 0], G=[[0, 1, 0]], nonlinearities=['sign(w1)'],
            states=['angle', 'velocity', 'current'])
    assert isinstance(only(servo(-1.0), ('y2',), 'y2'), VirtualSensor)
    refusal = only(servo(1.0), ('y2',), 'y2')
    assert isinstance(refusal, Refusal) and 'sign(velocity)' in refusal.reason


def test_a_term_that_does_not_concern_the_channel_does_not_stand_in_its_way():
    plant = Plant.from_matrices(
        np.diag([-1.0, 1, -1, -2]), None, [[1, 0, 0, 0], [0, 0, 0, 1]], P=[0, 0, 1, 0],
        G=[[0, 1, 0, 0]], nonlinearities=['tanh(w1)'])
    sensor = only(plant, ('y1',), 'y1')
    assert isinstance(sensor, VirtualSensor) and sensor.order == 1 and sensor.active == ()


def test_units_do_not_change_the_answer():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(4, 4)) - 2 * np.eye(4)
    B, C, D = rng.normal(size=(4, 1)), rng.normal(size=(3, 4)), rng.normal(size=(4, 1))
    plain = design(Plant.from_matrices(A, B, C, D=D))
    s, c = np.array([1e-6, 1, 1e6, 1e3]), np.array([1e3, 1e-6, 1])
    scaled = design(Plant.from_matrices(
        A * s[:, None] / s, B * s[:, None] * 1e6, C / s * c[:, None], D=D * s[:, None] * 1e-6))
    for mine, theirs in zip(plain.entries.values(), scaled.entries.values()):
        assert mine.order == theirs.order
        np.testing.assert_allclose(np.sort(mine.eigenvalues.real),
                                   np.sort(theirs.eigenvalues.real), rtol=1e-6)


def test_refusals_read_well_when_no_sensor_is_left():
    integrator = Plant.from_matrices([[0]], None, [[1]], states=['angle'])
    assert only(integrator, ('y1',), 'y1', temporary=False).reason.startswith(
        'no sensor is left for the mode of real part 0 in angle')
    two = Plant.from_matrices([[-1]], None, [[1]], D=[[1, 2]], disturbances=['wind', 'load'])
    assert only(two, ('y1',), 'y1').reason == (
        'the unknown inputs wind and load act on it and no sensor is left to tell them apart')


@pytest.mark.parametrize('fault_sets', ['y1', 5, [5], [None], [['y1', ['y2']]], [[]]])
def test_fault_sets_that_are_none_get_one_line(fault_sets):
    plant = Plant.from_matrices(-np.eye(2), None, np.eye(2))
    with pytest.raises(BadInput) as caught:
        design(plant, fault_sets)
    assert 'fault_sets' in str(caught.value) and '\n' not in str(caught.value)


def test_a_set_of_fault_sets_gives_the_same_order_every_time():
    plant = Plant.from_matrices(-np.eye(3), None, np.eye(3))
    result = design(plant, {('y3',), ('y1',), ('y2', 'y1'), ('y2',)})
    assert result.fault_sets == (('y1',), ('y2',), ('y3',), ('y1', 'y2'))


def test_a_plant_file_s_name_is_not_a_plant():
    with pytest.raises(BadInput, match='load_plant'):
        design('plant.yaml')


def heat_rod():
    """Return 20 cells in a row that exchange heat, measured at cells 1, 5 and 10."""
    A = 0.04 * (np.eye(20, k=1) + np.eye(20, k=-1) - 2 * np.eye(20))
    return Plant.from_matrices(A, np.eye(20)[:, :1], np.eye(20)[[0, 4, 9]])


def test_a_copy_of_what_matters_serves_where_canonical_forms_do_not():
    sensor = only(heat_rod(), ('y3',), 'y3')
    assert sensor.order <= 15  # cells 6 to 20, driven by the one at cell 5
    assert sensor.eigenvalues.real.max() < 0
    assert sensor.noise_gain < 10.0


@pytest.mark.slow
def test_low_order_is_not_bought_with_noise():
    rod = heat_rod()
    sampled = Plant.from_matrices(expm(np.array(rod.A)), rod.B, rod.C, sample_time=1.0)
    quiet = only(rod, ('y3',), 'y3').noise_gain
    assert only(sampled, ('y3',), 'y3').noise_gain < 200 * quiet


def test_a_gain_that_moves_nothing(tmp_path):
    """A late sensor of a sampled tank whose inflow has no slope where both are level."""
    path = tmp_path / 'plant.yaml'
    path.write_text("""
name: tanks
time: {sample_time: 0.1}
states:
  h1: {range: [0.1, 4], initial: 1, process_noise: 0.001}
  h2: {range: [0.1, 4], initial: 1, process_noise: 0.001}
inputs: {f: {operating: 0.3}}
dynamics:
  h1: h1 + 0.1*(f - 0.3*sqrt(h1 - h2))
  h2: h2 + 0.1*(0.3*sqrt(h1 - h2) - 0.1*sqrt(h2))
sensors: {s1: {measures: h1, noise: 0.01}, s2: {measures: h2, noise: 0.01, delay: 0.3}}
""", encoding='utf-8')
    found = design(load_plant(path), [['s2']])[('s2',), 's2']
    assert isinstance(found, VirtualSensor) and np.abs(found.eigenvalues).max() < 1.0
