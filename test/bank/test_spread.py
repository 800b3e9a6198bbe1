"""The covariance of a free run along its way: a linear flow, and a pendulum near the top."""

import numpy as np
from scipy.linalg import expm

from vsensor_ros.bank.spread import Spreads
from vsensor_ros.bank.state import State
from vsensor_ros.observers import Bent

P = np.array([[4e-4, 1e-4], [1e-4, 1e-3]])
W = np.diag([0.0, 1e-5])
ROW = np.array([1.0, 0.0])


class One:
    """A batch of one free run."""

    width, runs_on = 2, np.zeros((1, 0), dtype=bool)

    def __init__(self, step):
        self._step = step

    def bent(self, i):
        return Bent(P, W, ROW, 1e-6)

    def step_of(self, rows):
        return lambda z, *_: (self._step(z), np.zeros(len(z), dtype=bool))


def grown(step, z, steps):
    spreads = Spreads(One(step), np.array([0]))
    running, since = np.array([True]), np.array([0])
    state = spreads.begin(State(0, z, running, since, since, since, None))
    for k in range(steps):
        ended, _, spread = spreads.step((0,), k % 2 == 0, state, None, None)
        state = state._replace(tick=k + 1, z=ended, spread=spread)
    return spreads, state


def test_of_a_linear_flow_it_is_the_covariance():
    E, expected = expm(0.01 * np.array([[0.0, 1.0], [-9.0, -0.5]])), P
    spreads, state = grown(lambda z: z @ E.T, np.array([[0.3, 0.0]]), 200)
    for _ in range(200):
        expected = E @ expected @ E.T + W
    np.testing.assert_allclose(state.spread[0], expected, rtol=1e-9)
    assert abs(spreads.deviation(0, state) - np.sqrt(expected[0, 0] + 1e-6)) < 1e-12
    assert spreads.deviation(1, state) == 0.0


def test_it_grows_at_the_top_of_a_pendulum_and_not_at_the_bottom():
    def step(z):
        rate = z[:, 1] - 0.01 * 9.0 * np.sin(z[:, 0])
        return np.column_stack([z[:, 0] + 0.01 * rate, rate])
    hanging, top = (grown(step, np.array([[angle, 0.0]]), 60) for angle in (0.0, np.pi))
    assert top[0].deviation(0, top[1]) > 3 * hanging[0].deviation(0, hanging[1])


def test_what_cannot_be_told_is_infinite():
    with np.errstate(all='ignore'):
        spreads, state = grown(lambda z: z * 1e80, np.ones((1, 2)), 3)
    assert spreads.deviation(0, state) == np.inf
