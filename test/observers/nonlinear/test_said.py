"""What is said near a pole or the end of a root, against draws of the errors that are stated."""

from types import SimpleNamespace

import numpy as np
import pytest

from vsensor_ros.observers.kinds.nonlinear.motion import BLIND, Motion

DRAWS = 2000


def said(out, truth, P, noise, turn=0.0):
    """Return errors and deviations of draws about true z and readings."""
    k, L = len(P), len(noise)
    z, sensors = tuple(f'z{i + 1}' for i in range(k)), tuple(f'y{i + 1}' for i in range(L))
    entry = SimpleNamespace(
        z=z, F=('0',) * k, out=out, validity=(), residuals=(), tracks=(), grade='exact', turn=turn,
        noise_of=dict(zip(sensors, noise)), lasts={}, driven=(), process_noise=np.zeros(k),
        sample_time=None)
    motion = Motion(entry, sensors, (), 0.1)
    rng = np.random.default_rng(3)
    x = truth[:k] + rng.multivariate_normal(np.zeros(k), P, DRAWS) if k else np.zeros((DRAWS, 0))
    y = truth[k:] + rng.standard_normal((DRAWS, L)) * noise
    exact = float(motion.says(np.zeros((1, motion.width)) + motion.state(truth[:k], P),
                              truth[None, k:], np.zeros((1, 0)))[0])
    found = [motion.said(motion.state(a, P)[None], b, np.zeros(0))[0] for a, b in zip(x, y)]
    values, deviations = np.array(found)[:, [motion.value, motion.deviating]].T
    return values - exact, deviations


@pytest.mark.parametrize('far', [0.5, 1.0, 2.0, 3.0, 5.0, 30.0])
def test_next_to_a_pole_it_says_little_or_nothing(far):
    """Of what is beyond `useful`, 1 here, nothing is used."""
    error, deviation = said('y2/y1', np.array([far, 2.0 * far]) * 0.01, np.zeros((0, 0)),
                            np.array([0.01, 0.01]))
    spoken = deviation < 1.0
    assert (spoken & (np.abs(error) > 2.0 * deviation)).mean() < 0.1
    if far <= 1.0:
        assert spoken.mean() < 0.2
    if far >= 5.0:
        assert spoken.mean() > 0.7
    if far == 30.0:
        assert 0.9 < deviation.mean() / error.std() < 1.1


@pytest.mark.parametrize('far', [0.1, 0.3, 1.0, 3.0, 100.0])
def test_next_to_the_end_of_a_root_it_says_how_little_it_knows(far):
    error, deviation = said('sqrt(z1 - y1**2)', np.array([far + 1.0, 1.0]), np.array([[1.0]]),
                            np.array([1e-3]))
    assert (deviation < BLIND).all() and (np.abs(error) > 2.0 * deviation).mean() < 0.07
    if far <= 0.3:  # its own slope there is 0 or without end
        assert deviation.min() > 0.2 and np.median(deviation) < 2.0
    if far == 100.0:
        assert 0.9 < deviation.mean() / error.std() < 1.1


def test_an_angle_of_what_is_as_small_as_its_noise():
    error, deviation = said('atan2(z2, z1)', np.array([-1.0, 0.0]), np.eye(2), np.zeros(0),
                            2.0 * np.pi)
    error = np.remainder(error + np.pi, 2.0 * np.pi) - np.pi
    assert (np.abs(error) <= 2.0 * deviation).mean() > 0.9
