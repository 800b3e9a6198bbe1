"""Runs of repeats and gaps, beside one sample at a time; counted late, beside at once."""

import numpy as np
import pytest

from vsensor_ros.isolator.channels import Channels
from vsensor_ros.isolator.runs import follow, Runs

HABITS = ('repeats', 'again', 'pairs', 'longest', 'longest_gap', 'travel', 'run', 'gap')


def step_by_step(before, readings, estimates):
    """Return what `follow` does, of one channel."""
    rows = [tuple(before)]
    for reading, estimate in zip(readings, estimates):
        last, run, gap, begun = rows[-1]
        if np.isnan(reading):
            gap += 1
        else:
            run, gap, last = (run + 1 if reading == last else 0), 0, reading
        rows.append((last, run, gap, begun if run else estimate))
    return [np.array(column) for column in zip(*rows)]


def resting(count, seed, gaps):
    """Return readings that often repeat, and estimates; with gaps, some are missing."""
    random = np.random.default_rng(seed)
    readings = np.round(random.standard_normal((count, 6)) * [0.2, 0.5, 1.0, 2.0, 8.0, 1e6])
    if gaps:
        readings[random.random(readings.shape) < 0.2] = np.nan
        readings[40:60, 2] = np.nan
    return readings, random.standard_normal(readings.shape)


@pytest.mark.parametrize('gaps', [False, True])
@pytest.mark.parametrize('before', [
    Runs(np.nan, 0, 0, np.nan), Runs(0.0, 3, 0, 0.7), Runs(0.0, 0, 5, 0.2), Runs(1.0, 2, 4, -3.0)])
def test_runs_are_what_one_sample_after_another_gives(before, gaps):
    readings, estimates = resting(100, 1, gaps)
    found = follow(Runs(*(np.full(6, value) for value in before)), readings, estimates)
    for j in range(6):
        for rows, wanted in zip(found, step_by_step(before, readings[:, j], estimates[:, j])):
            np.testing.assert_array_equal(rows[:, j], wanted)


@pytest.mark.parametrize('gaps', [False, True])
def test_habits_are_of_the_runs_and_gaps_that_have_ended(gaps):
    readings, estimates = resting(1024, 2, gaps)
    channels = Channels(0.01, 4, 6)
    for k in range(0, len(readings), 4):
        part = slice(k, k + 4)
        channels.step(readings[part], readings[part], estimates[part], True)
    channels.settle()
    for j in range(6):
        _, run, gap, begun = step_by_step((np.nan, 0, 0, np.nan), readings[:, j], estimates[:, j])
        here = np.isfinite(readings[:, j])
        ended = np.where(here & (run[1:] == 0), run[:-1], 0)
        assert channels.pairs[j] == here.sum()
        assert channels.repeats[j] == ended.sum()
        assert channels.again[j] == np.maximum(ended - 1, 0).sum()
        assert channels.longest[j] == ended.max()
        assert channels.longest_gap[j] == np.where(here, gap[:-1], 0).max()
        went = np.abs(estimates[:-1, j] - begun[1:-1])
        assert channels.travel[j] == np.where(ended[1:] > 0, went, 0.0).max()


@pytest.mark.parametrize('gaps', [False, True])
@pytest.mark.parametrize('batch', [1, 4])
def test_what_is_counted_late_is_what_is_counted_at_once(batch, gaps):
    readings, estimates = resting(2048, 2, gaps)
    readings[:, :3] += 1e-3 * estimates[:, :3]  # these do not rest
    readings[1600:1640, 4] = readings[1600, 4]  # stuck
    late, at_once = Channels(0.01, batch, 6), Channels(0.01, batch, 6)
    stuck = 0
    for k in range(0, len(readings), batch):
        part, learn = slice(k, k + batch), k % 768 < 740
        if k == 900:
            late.restart()
            at_once.restart()
        for channels in (late, at_once):
            channels.step(readings[part], readings[part], estimates[part], learn)
        at_once.settle()
        found = late.stuck(estimates[k + batch - 1])
        assert (found == at_once.stuck(estimates[k + batch - 1])).all()
        assert (late.dropped() == at_once.dropped()).all()
        stuck += int(found[4])
    assert stuck
    for habit in HABITS:
        np.testing.assert_array_equal(getattr(late, habit), getattr(at_once, habit), habit)
