"""A base whose heading is lost while it turns: simulated here, played through the engine."""

from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.observers import horizon
from vsensor_ros.recordings import Loss, Recording, replay, settings, Track, verdict

PLANT = Path(__file__).resolve().parents[2] / 'config' / 'base' / 'plant.yaml'
RATE = 50.0


def driven(seed, seconds=46.0):
    """Return a base that drives round and round, now one way, now the other, and its truth."""
    rng, h = np.random.default_rng(seed), 1.0 / RATE
    t = np.arange(round(seconds * RATE)) * h
    p = load_plant(PLANT).parameters
    turn = 0.6 * np.sign(np.sin(2 * np.pi * t / 25.0)) * p['track'] / (2 * p['radius'])
    left_set, right_set = 5.0 - turn, 5.0 + turn
    q = load_plant(PLANT).process_noise * np.sqrt(h)
    x, truth = np.array([0.0, 0.0, 0.0, 0.02, 5.0, 5.0]), np.empty((len(t), 6))
    for k in range(len(t)):
        truth[k] = x
        _, _, heading, bias, left, right = x
        speed, rate = p['radius'] / 2 * (left + right), p['radius'] / p['track'] * (right - left)
        middle = heading + rate * h / 2
        slip = q * rng.standard_normal(6)
        x = slip + np.array([x[0] + h * speed * np.cos(middle), x[1] + h * speed * np.sin(middle),
                    heading + h * rate, bias,
                    left_set[k] + (left - left_set[k]) * np.exp(-h / p['lag']),
                    right_set[k] + (right - right_set[k]) * np.exp(-h / p['lag'])])
    rate = p['radius'] / p['track'] * (truth[:, 5] - truth[:, 4])
    clean = [truth[:, 0], truth[:, 1], truth[:, 2], rate + truth[:, 3], truth[:, 4], truth[:, 5]]
    plant = load_plant(PLANT)
    said = {name: values + noise * rng.standard_normal(len(t))
            for name, values, noise in zip(plant.sensors, clean, plant.noise)}
    said |= {'left_set': left_set, 'right_set': right_set}
    return Recording({name: Track.of(t, v) for name, v in said.items()}), Track.of(t, truth[:, 2])


@pytest.fixture(scope='module')
def made():
    return design(load_plant(PLANT), [('yaw',), ('x', 'y', 'yaw')])


@pytest.mark.slow
@pytest.mark.parametrize('lost', [('yaw',), ('x', 'y', 'yaw')])
def test_a_heading_that_is_lost_while_turning_is_told_with_an_honest_deviation(made, lost):
    recording, truth = driven(1)
    heard = replay(settings(made, RATE), recording,
                   [Loss(lost, start, start + 15.0) for start in (10.0, 20.0, 30.0)])
    found = verdict([said['yaw'] for _, said in heard], truth)
    print(lost, found)
    assert found.served > 0.5 and found.covered >= 0.9
    assert found.rmse < 0.1 < found.held / 5


def test_for_how_long_a_heading_is_good_is_said(made):
    v = made[('x', 'y', 'yaw'), 'yaw']
    assert v.grade == 'temporary' and 5.0 < horizon(v, made.tolerance('yaw')) < 120.0
