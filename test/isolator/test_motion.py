"""How far estimates move, beside the direct form and beside what was learnt."""

import numpy as np
import pytest

from vsensor_ros.isolator.detector import ENOUGH
from vsensor_ros.isolator.motion import Motion, SPARE, WINDOWS

PERIOD = 0.01


def feed(motion, estimates, learn=True):
    for start in range(0, len(estimates), motion.batch):
        motion.step(estimates[start:start + motion.batch], learn)


def waves(seconds, size=1.0, rate=1.0):
    """Return motion of which 15 s are a period, or a third of that at thrice the rate."""
    phase = 2.0 * np.pi / 15.0 * rate * PERIOD * np.arange(round(seconds / PERIOD))
    return size * np.stack([np.sin(phase), np.cos(phase)], axis=1) + [0.0, 5.0]


@pytest.fixture(params=[1, 4])
def learnt(request):
    motion = Motion(PERIOD, request.param, 2)
    feed(motion, waves(ENOUGH + 60.0))
    return motion


def test_swings_are_the_extremes_of_means_over_windows():
    estimates = np.random.default_rng(0).standard_normal((12800, 2)).cumsum(axis=0)
    motion = Motion(PERIOD, 1, 2)
    feed(motion, estimates)
    for w, window in enumerate(WINDOWS):
        mean = np.stack([estimates[k - window:k].mean(axis=0) for k in range(window, 12801)])
        contrast = mean[4 * window:] - np.stack([
            estimates[k - 5 * window:k - window].mean(axis=0) for k in range(5 * window, 12801)])
        stride = max(1, window // 4)
        first = -(-(5 * window + 128) // 128) * 128 - 127  # of the first block that counts
        for row, tests, start in ((w, mean, window), (len(WINDOWS) + w, contrast, 5 * window)):
            ends = np.arange(start, 12801)
            due = tests[(ends % stride == 0) & (ends >= first)]
            assert motion.swings[0, row] == pytest.approx(due.max(axis=0))
            assert -motion.swings[1, row] == pytest.approx(due.min(axis=0))


def test_motion_as_learnt_is_not_beyond_and_tripled_motion_is_twice_beyond(learnt):
    levels = learnt.swings.sum(axis=0)[:len(WINDOWS)] / 2
    assert levels.max(axis=0) == pytest.approx([1.0, 1.0], abs=0.02)
    assert (learnt.range >= levels.max(axis=0)).all()
    learnt.beyond[:] = 0.0
    feed(learnt, waves(30.0))
    assert (learnt.beyond == 0.0).all()
    feed(learnt, waves(30.0, size=3.0), learn=False)
    assert learnt.beyond[:, 0].max() == pytest.approx(2.0 - SPARE, abs=0.35)


def test_a_faster_motion_of_the_same_range_is_beyond_and_is_forgotten(learnt):
    feed(learnt, waves(15.0, rate=3.0), learn=False)
    assert (learnt.beyond.max(axis=0) > 1.0).all()
    feed(learnt, waves(120.0), learn=False)
    assert (learnt.beyond < 0.1).all()


def test_what_came_in_since_the_last_block_counts_when_it_is_looked_at(learnt):
    learnt.beyond[:] = 0.0
    feed(learnt, waves(0.16) + np.array([5.0, 0.0]), learn=False)
    learnt.look()
    assert learnt.beyond[:, 0].max() > 1.0 and (learnt.beyond[:, 1] == 0.0).all()


def test_nothing_is_learnt_of_a_machine_that_is_not_healthy(learnt):
    before = learnt.swings.copy()
    feed(learnt, waves(60.0, size=3.0), learn=np.array([True, False]))
    assert (learnt.swings[:, :, 1] == before[:, :, 1]).all()
    assert (learnt.swings[:, :, 0] > 2.0 * before[:, :, 0]).any()


@pytest.mark.parametrize('wild', [np.nan, np.inf, 1e300])
def test_what_is_no_estimate_is_no_motion_and_does_not_stay(learnt, wild):
    learnt.beyond[:] = 0.0
    estimates = waves(30.0)
    estimates[1000, 0] = wild
    feed(learnt, estimates, learn=False)
    assert (learnt.beyond == 0.0).all()


def test_nothing_is_beyond_before_anything_was_learnt():
    motion = Motion(PERIOD, 4, 2)
    feed(motion, waves(60.0))
    assert (motion.beyond == 0.0).all() and (motion.range == 0.0).all()
