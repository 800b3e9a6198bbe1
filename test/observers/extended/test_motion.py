"""How states move over a step, against Runge and Kutta written down once more."""

from dataclasses import replace

import numpy as np
import pytest

from vsensor_ros.functions.catalogue import CATALOGUE
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse
from vsensor_ros.observers import Model
from vsensor_ros.observers.kinds.extended.motion import Motion

H = 0.02


def pendulum(**changed):
    """Return a pendulum that a motor and an unknown pull drive."""
    given = {
        'states': ('a', 'w'), 'inputs': ('u', 'quiet'),
        'equations': ('w', '-g*sin(a)/l - c*w*abs(w) + u*cos(a) + pull + quiet'),
        'unknown': ('pull',), 'parameters': ('g', 'l', 'c'), 'values': np.array([9.81, 0.5, 0.3]),
        'spreads': np.array([0.0, 0.02, 0.1]), 'process_noise': np.array([0.0, 0.1]),
        'input_noise': np.array([0.3, 0.0]), 'unknown_noise': np.array([0.7]), 'C': np.eye(2),
        'Cu': np.zeros((2, 2)), 'noise': np.ones(2), 'lasts': np.zeros(2), 'initial': np.zeros(2),
        'start': np.ones(2), 'sample_time': None}
    return Model(**{**given, **changed})


@pytest.mark.parametrize('count', [1, 3, 30])
def test_it_is_runge_and_kutta_with_slopes_halfway(count):
    model, rng = pendulum(), np.random.default_rng(count)
    x, commands = rng.standard_normal((count, 2)), rng.standard_normal((3, 2))
    f = Equations([parse(text) for text in model.equations], (
        'a', 'w', 'u', 'quiet', 'pull', 'g', 'l', 'c'))

    def at(x, u):
        return np.vstack([x.T, np.tile(np.array([*u, 0.0, *model.values])[:, None], count)])
    begin, end, mean = commands
    k1 = f.values(at(x, begin)).T
    k2 = f.values(at(x + H / 2 * k1, mean)).T
    halfway = x + H / 2 * k2
    k3, slopes = f.slopes(at(halfway, mean))
    k4 = f.values(at(x + H * k3.T, end)).T
    motion = Motion(model, H)
    found = motion.step(x, commands)
    np.testing.assert_allclose(found[0], x + H / 6 * (k1 + 2 * k2 + 2 * k3.T + k4), rtol=1e-12)
    np.testing.assert_allclose(found[1], halfway, rtol=1e-12)
    # what has no noise drives nothing, and is left out
    slopes = slopes.transpose(2, 0, 1)[:, :, [0, 1, 2, 4, 5, 6, 7]]
    np.testing.assert_allclose(found[2], slopes, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(motion.slopes(halfway, mean), slopes, rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(motion.drive, [0.3, 0.7])


def test_in_discrete_time_it_is_the_map():
    model = pendulum(equations=('a + 0.1*w', 'w - 0.1*g*sin(a) + u'), sample_time=0.1)
    after, _, slopes = Motion(model, 0.1).step(np.array([[0.3, 1.0]]), np.array([[9.0, 9.0],
                                                                                 [9.0, 9.0],
                                                                                 [0.5, 0.0]]))
    np.testing.assert_allclose(after, [[0.4, 1.5 - 0.981 * np.sin(0.3)]])
    np.testing.assert_allclose(slopes[0, 1], [-0.981 * np.cos(0.3), 1.0, 1.0, 0.0,
                                              -0.1 * np.sin(0.3), 0.0, 0.0])


def test_values_and_slopes_share_what_they_have_in_common(monkeypatch):
    """Four stages take four sines, and the slopes none more: they go by the third."""
    taken = []
    monkeypatch.setitem(CATALOGUE, 'sin', replace(
        CATALOGUE['sin'], value=lambda x: taken.append(1) or np.sin(x)))
    Motion(pendulum(), H).step(np.ones((30, 2)), np.ones((3, 2)))
    assert len(taken) == 4
