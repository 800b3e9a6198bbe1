"""The truth against the reference numbers, closed forms and a plain iteration."""

import json
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import load_plant, Plant
from vsensor_ros.simulate import simulate
from vsensor_ros.simulate.simulate import readings

ROOT = Path(__file__).parents[2]
REFERENCE = json.loads((ROOT / 'test' / 'reference.json').read_text())


def test_servo_slides_stops_and_breaks_away_as_in_the_reference():
    plant = load_plant(ROOT / 'config' / 'servo' / 'plant.yaml')
    samples = REFERENCE['a_servo']['sim_k7=-1']['samples']
    t = np.array([float(time) for time in samples])
    x = simulate(plant, t, lambda t: [2 * np.sin(t)], lambda t: [0.5 * np.sin(3 * t)], [0, 1, 0])
    expected = np.array([sample['x'] for sample in samples.values()])
    np.testing.assert_allclose(x, expected, atol=1e-6)     # printed to 7 digits
    at_rest = expected[:, 1] == 0.0
    assert at_rest.any()
    np.testing.assert_allclose(x[at_rest, 1], 0.0, atol=1e-10)


def test_tank_as_in_the_reference():
    plant = load_plant(ROOT / 'config' / 'three_tank' / 'plant.yaml')
    samples = REFERENCE['b_tank_continuous']['sim18_swapped_z0=(4,1)']['x2']
    t = np.array([float(time) for time in samples])
    x = simulate(plant, t, np.tile([0.5, 0.2], (len(t), 1)), x0=[5, 3, 1])
    np.testing.assert_allclose(x[:, 1], list(samples.values()), atol=1e-6)


def test_inputs_are_held_between_their_times():
    plant = Plant.from_matrices([[-2.0]], [[1.0]], [[1.0]])
    t, u = np.array([0.0, 0.3, 1.0, 1.1]), np.array([[1.0], [-3.0], [2.0], [9.0]])
    x = [0.5]
    for step, held in zip(np.diff(t), u[:, 0]):
        x.append(held / 2 + (x[-1] - held / 2) * np.exp(-2 * step))
    np.testing.assert_allclose(simulate(plant, t, u, x0=[0.5])[:, 0], x, rtol=1e-9)


def test_an_accelerometer_reads_the_force_and_the_unknown_one():
    # a mass on a spring, v' = -4 p + 2 u + rho, is measured as it is; from rest, u = rho = 1
    plant = Plant.from_matrices([[0, 1], [-4, 0]], [0, 2], [[-4, 0], [1, 0]], D=[0, 1],
                                Cu=[[2], [0]], Cd=[[1], [0]])
    t = np.linspace(0.0, 3.0, 31)
    x = simulate(plant, t, np.ones((31, 1)), lambda t: [1.0])
    y = readings(plant, t, x, np.ones((31, 1)), lambda t: [1.0])
    np.testing.assert_allclose(y[:, 0], 3 * np.cos(2 * t), atol=1e-8)
    np.testing.assert_allclose(y[:, 1], 0.75 * (1 - np.cos(2 * t)), atol=1e-8)
    # a command is read from the time on at which it begins; no input is zero
    u = (t > 1.0)[:, None] * 5.0
    np.testing.assert_allclose(readings(plant, t, 0 * x, u)[:, 0], 10.0 * (t > 1.0))
    np.testing.assert_allclose(readings(plant, t, x), x @ plant.C.T)
    with pytest.raises(ValueError, match='inputs must have shape'):
        readings(plant, t, x, np.ones((31, 2)))


def test_a_block_with_coulomb_friction_stops_and_stays():
    # v' = -sign(v) + u: stops at t = 1, stays while |u| < 1, leaves at t = 2 with v' = 0.5
    plant = Plant.from_matrices([[0.0]], [[1.0]], [[1.0]], P=[[-1.0]], G=[[1.0]],
                                nonlinearities=['sign(w1)'])
    t = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    u = np.array([[0.0], [0.0], [0.9], [-0.9], [1.5], [1.5], [1.5]])
    x = simulate(plant, t, u, x0=[1.0])[:, 0]
    np.testing.assert_allclose(x, [1.0, 0.5, 0.0, 0.0, 0.0, 0.25, 0.5], atol=1e-9)


def test_two_rubbing_blocks_come_to_rest_together():
    # each rubs on the other and the first on the ground: both rest, momentum is all friction's
    plant = Plant.from_matrices(np.zeros((2, 2)), None, np.eye(2), P=[[-1.0, -0.5], [0.0, 0.5]],
                                G=[[1.0, 0.0], [1.0, -1.0]], nonlinearities=['sign(w1)'] * 2)
    t = np.linspace(0.0, 6.0, 61)
    x = simulate(plant, t, x0=[2.0, 0.0])
    # by hand: v1' = -1.5, v2' = .5 until they meet at t = 1, v = .5; then both lose 1/2 a second
    np.testing.assert_allclose(x[10], [0.5, 0.5], atol=1e-9)
    np.testing.assert_allclose(x[15], [0.25, 0.25], atol=1e-9)
    np.testing.assert_allclose(x[21:], 0.0, atol=1e-9)


def test_repelling_sign_leaves_zero():
    plant = Plant.from_matrices([[-1.0]], None, [[1.0]], P=[[1.0]], G=[[1.0]],
                                nonlinearities=['sign(w1)'])
    t = np.array([0.0, 1.0, 30.0])
    x = simulate(plant, t, x0=[-0.1])[:, 0]
    np.testing.assert_allclose(x, [-0.1, -1 + 0.9 * np.exp(-1.0), -1.0], atol=1e-9)


def test_discrete_plant_is_iterated():
    plant = Plant.from_matrices([[0.5, 1.0], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]],
                                sample_time=0.1, D=[[1.0], [0.0]])
    t = 0.1 * np.arange(20)
    u, rho = np.sin(t)[:, None], np.cos(t)[:, None]
    x = [np.array([1.0, -1.0])]
    for k in range(19):
        x.append(plant.A @ x[-1] + plant.B @ u[k] + plant.D @ rho[k])
    np.testing.assert_allclose(simulate(plant, t, u, rho, x[0]), x, rtol=1e-12)
    with pytest.raises(ValueError, match='sample time'):
        simulate(plant, 0.2 * np.arange(3))


def test_inputs_of_another_shape_are_refused():
    plant = Plant.from_matrices([[-1.0]], [[1.0]], [[1.0]])
    with pytest.raises(ValueError, match='inputs must have shape'):
        simulate(plant, [0.0, 1.0], np.zeros((2, 2)))
