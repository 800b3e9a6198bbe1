"""The simulation of a fit: the simulator's, and its derivatives those of differences."""

import numpy as np
from plants import AXIS, torques, TRUTH, written
import pytest

from vsensor_ros import load_plant
from vsensor_ros.fitting.model import Model, Moved
from vsensor_ros.plant.free import load_free
from vsensor_ros.simulate.simulate import simulate


def model(tmp_path):
    return Model(load_free(written(tmp_path, AXIS)))


def test_an_axis_with_dry_friction_moves_as_in_the_simulator(tmp_path):
    path = written(tmp_path, **TRUTH)
    here, plant = Model(load_free(path)), load_plant(path)
    step = 0.002
    u = torques(1000, step, np.random.default_rng(1), 1.0)  # often below the friction: it rests
    truth = simulate(plant, step * np.arange(1000), u[:, None])
    assert (truth[:, 1] == 0.0).mean() > 0.05
    x, theta = here.start(np.zeros((2, 1))), np.array(list(TRUTH.values()))
    found = [x.value[:, 0]]
    for now in u[:-1]:
        x = here.step(here.start(x.value), np.array([[now]]), theta, step)
        found.append(x.value[:, 0])
    assert np.abs(np.array(found) - truth).max() < 0.005 * np.abs(truth[:, 1]).max()


@pytest.mark.parametrize('speed, torque', [
    (1.0, 0.5), (-1.0, 0.5), (0.002, 0.0), (0.0, 0.1)],
    ids=['goes', 'goes back', 'stops', 'rests'])
def test_derivatives_of_a_step_are_exact(tmp_path, speed, torque):
    here = model(tmp_path)
    theta, u = np.array([0.8, 0.6, 0.4]), np.array([[torque]])
    at = np.array([[0.3], [speed]])

    def ahead(x, theta):
        return here.step(here.start(x), u, theta, 0.01).value[:, 0]
    found = here.step(here.start(at), u, theta, 0.01).slopes[0]
    eps = 1e-6
    for i in range(2):
        move = eps * np.eye(2)[:, i:i + 1]
        numeric = (ahead(at + move, theta) - ahead(at - move, theta)) / (2 * eps)
        assert numeric == pytest.approx(found[:, i], abs=1e-6)
    for i in range(3):
        move = eps * np.eye(3)[i]
        numeric = (ahead(at, theta + move) - ahead(at, theta - move)) / (2 * eps)
        assert numeric == pytest.approx(found[:, 2 + i], abs=1e-6)


def test_what_moved_before_moves_on(tmp_path):
    here = model(tmp_path)
    theta, u = np.array([0.8, 0.6, 0.4]), np.array([[0.5]])
    x = here.start(np.array([[0.3], [1.0]]))
    twice = here.step(here.step(x, u, theta, 0.01), u, theta, 0.01)
    assert isinstance(twice, Moved)
    eps, end = 1e-6, []
    for sign in (1.0, -1.0):
        moved = theta + sign * eps * np.eye(3)[0]
        at = here.step(here.start(x.value), u, moved, 0.01)
        end.append(here.step(here.start(at.value), u, moved, 0.01).value[:, 0])
    assert (end[0] - end[1]) / (2 * eps) == pytest.approx(twice.slopes[0, :, 2], abs=1e-7)
