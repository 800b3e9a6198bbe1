"""Off the operating point healthy sensors show it, and the deviation grows."""

from dataclasses import replace

import numpy as np
import pytest

from vsensor_ros import design, Plant
from vsensor_ros.bank import Bank

RATE, LOST = 50.0, 15.0
NOISE = [0.005, 0.02]
KEY = ('y1',), 'y1'


@pytest.fixture(scope='module')
def made():
    """Design for a pendulum, which begins at rest, by the model that holds where it hangs."""
    model = Plant.from_matrices(
        [[0, 1], [-9.81, -0.3]], [[0], [1]], np.eye(2), noise=NOISE, process_noise=[0.001, 0.1],
        ranges=[[-1.0, 1.0]] * 2)
    plan = design(model, [('y1',), ('y2',), ('y1', 'y2')])
    return replace(plan, entries={
        key: replace(v, tracking=None, start=np.zeros((v.order, v.order)))
        for key, v in plan.entries.items()})


def pendulum(push):
    """Integrate the truth: angle'' = -9.81 sin(angle) - 0.3 angle' + push, held for a period."""
    def rate(x, u):
        return np.array([x[1], -9.81 * np.sin(x[0]) - 0.3 * x[1] + u])
    x, h, found = np.zeros(2), 1.0 / RATE, []
    for u in push:
        found.append(x)
        a = rate(x, u)
        b = rate(x + h / 2 * a, u)
        c = rate(x + h / 2 * b, u)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, u))
    return np.array(found)


def swing(made, size, seconds=30.0):
    """Push with 0.2, from LOST on with `size` and without y1; return (estimate - truth, sd)."""
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds * RATE)) / RATE
    u = np.where(t < LOST, 0.2, size) * np.sin(2.2 * t + np.sin(0.7 * t))
    y = pendulum(u + 0.1 * np.sqrt(RATE) * rng.standard_normal(len(t)))
    bank, found = Bank(made, RATE), np.full((2, len(t)), np.nan)
    for k, now in enumerate(t):
        if now == LOST:
            bank.distrust({'y1'})
        for name, value, sd in zip(('y1', 'y2'), y[k], NOISE):
            bank.take(name, k * bank.period, value + sd * rng.standard_normal())
        bank.take('u1', k * bank.period, u[k])
        bank.advance(k * bank.period)
        if now >= LOST - 1.0:
            found[:, k] = bank.estimate(*KEY) - y[k, 0], bank.deviation(*KEY)
    return found[:, (t >= LOST - 1.0) & (t < LOST)], found[:, t >= LOST + 2.0]


def test_it_covers_the_truth_where_the_model_does_not_hold(made):
    (_, before), (error, deviation) = swing(made, 2.6)
    assert (np.abs(error) <= 2 * before[-1]).mean() < 0.7  # or there is nothing to show
    assert (np.abs(error) <= 2 * deviation).mean() >= 0.9
    assert np.median(deviation) < 5 * np.sqrt(np.mean(error**2))


def test_it_hardly_grows_where_the_model_holds(made):
    (_, before), (error, deviation) = swing(made, 0.2)
    assert 0.999 < np.mean(deviation) / before[-1] < 1.2
    assert (np.abs(error) <= 2 * deviation).mean() >= 0.9


def test_without_anybody_to_tell_it_stays(made, bench):
    """A design without the pair: with y1 lost, nothing is compared any more."""
    alone = bench.design(*(v for v in made.virtual_sensors if len(v.fault_set) == 1),
                         inputs=('u1',))
    (_, before), (_, deviation) = swing(alone, 2.6)
    assert np.ptp(deviation) < 0.01 * before[-1]
