"""The running form against the direct form."""

from functools import partial

import numpy as np
import pytest

from vsensor_ros.isolator.detector import BLOCKS, Detector, ENOUGH, SPAN, WINDOWS

PERIOD = 0.01


def detector(batch=4, n=2, prior=3.0):
    return Detector(PERIOD, batch, 1e-7, np.full(n, prior), np.full(n, 1e6))


def feed(detector, samples, learn=True):
    for start in range(0, len(samples), detector.batch):
        alarms = detector.step(samples[start:start + detector.batch], learn)
    return alarms


@pytest.mark.parametrize('batch', [1, 4])
def test_tests_are_the_means_of_medians_over_windows(batch):
    samples = np.random.default_rng(0).standard_normal((6144, 2)).cumsum(axis=0) / 50
    running = detector(batch)
    feed(running, samples)
    tests = (running._tests(len(WINDOWS), np.zeros((batch, 2))) / running._samples)[:, 0]
    padded = np.vstack([np.zeros((2, 2)), samples])
    middle = np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0)
    for w, window in enumerate(WINDOWS):
        if window < batch:
            continue  # see the next test
        level = middle[-window:].mean(axis=0)
        assert tests[w, 0] == pytest.approx(level, abs=1e-9)
        before = middle[-5 * window:-window].mean(axis=0)
        assert tests[w, 1] == pytest.approx(level - before, abs=1e-9)


def test_windows_of_one_give_the_extremes_of_a_batch():
    running = detector(4, n=1)
    feed(running, np.array([1.0, 1, 1, 1, 1, 1, 2, 2, -3, -3, 5, 5])[:, None])
    middle = running._past[running._count % len(running._past)]
    running._before[:] = 1.25
    most, least = running._tests(len(WINDOWS), middle)[0, :, :, 0]
    assert (most[0], -least[0]) == (5.0, -3.0)
    assert (most[1], -least[1]) == (5.0 - 1.25, -3.0 - 1.25)  # medians before: 1 1 1 2


def test_a_window_alarms_only_when_it_is_filled():
    running = detector(4, n=1, prior=0.5)
    quiet = np.zeros((3 * SPAN, 1))
    feed(running, quiet)
    jump = np.ones((1024, 1))
    assert feed(running, jump).all() and running.high[-1, 0, 0]
    running.restart(np.array([0]))
    assert not feed(running, quiet[:8]).any()
    assert not running.high.any()


def test_nan_starts_the_windows_anew_and_wild_numbers_do_not_stay():
    running = detector(4)
    samples = np.zeros((2048, 2))
    samples[1000, 0], samples[1000, 1] = np.nan, 1e300
    feed(running, samples)
    assert running.filled.tolist() == [2048 - 1004, 2048]
    assert np.abs(running.level(1024)).max() < 1e-6


def test_thresholds_are_the_prior_until_enough_was_learnt_of_a_healthy_machine():
    random = np.random.default_rng(3)
    running, ignoring = detector(n=1, prior=50.0), detector(16, n=1, prior=50.0)
    samples = random.standard_normal((round(ENOUGH / PERIOD) + 4096, 1))
    feed(running, samples[:2000])
    running.refresh()
    assert (running.thresholds == 50.0).all()
    feed(running, samples[2000:])
    feed(ignoring, samples, learn=False)
    for one in (running, ignoring):
        one.refresh()
    assert (ignoring.thresholds == 50.0).all() and ignoring.maxima.count.sum() == 0
    above = running.thresholds[:len(WINDOWS), 0]
    assert 3.0 < above[0] < 9.0 and 0.02 < above[-1] < 0.5
    assert (np.diff(above) < 0.0).all()


def test_alarms_are_as_seldom_as_was_asked_for():
    random = np.random.default_rng(4)
    n, batch = 200, 16
    wanted = 1 / 3600.0  # one an hour of each column
    running = Detector(PERIOD, batch, wanted / 24, np.full(n, 50.0), np.full(n, 1e6))
    draw = partial(random.standard_normal, (batch, n))
    for _ in range(round(ENOUGH / PERIOD / batch) + 250):
        running.step(draw(), True)
    running.refresh()
    was, alarms = np.zeros(n, dtype=bool), 0
    for _ in range(250):
        now = running.step(draw(), False)
        alarms += int((now & ~was).sum())
        was = now
    hours = n * 250 * batch * PERIOD / 3600
    assert alarms <= 2 * hours  # 2.2 hours, so about 2


def test_the_past_is_given_oldest_first_and_from_the_last_start_on():
    running = detector(4, n=1)
    feed(running, np.arange(40.0)[:, None])
    assert running.past(0, 5).tolist() == [34.0, 35.0, 36.0, 37.0, 38.0]  # the median is late
    running.restart(np.array([0]))
    feed(running, np.full((8, 1), 7.0))
    assert running.past(0, 100).tolist() == [38.0, 7.0, 7.0, 7.0, 7.0, 7.0, 7.0, 7.0]


def test_what_says_nothing_or_too_little_for_a_block_is_not_learnt_from():
    running = detector(4, n=4)
    samples = np.zeros((2 * BLOCKS[0], 4))
    samples[:, 1] = np.nan
    samples[::BLOCKS[0] // 2, 2] = np.nan
    samples[:BLOCKS[0], 3] = np.nan
    feed(running, samples)
    assert running.learnt.tolist() == [2 * BLOCKS[0], 0, 0, BLOCKS[0]]
    feed(running, np.zeros((8, 4)), learn=np.array([True, True, True, False]))
    assert running.learnt.tolist() == [2 * BLOCKS[0] + 8, 0, 0, BLOCKS[0]]


def test_what_is_never_near_zero_does_not_alarm_while_its_windows_fill():
    random = np.random.default_rng(5)
    running = Detector(PERIOD, 4, 1e-7, np.full(1, 50.0), np.full(1, 1e6))
    feed(running, 5.0 + 0.1 * random.standard_normal((round(ENOUGH / PERIOD) + 4096, 1)))
    running.refresh()
    assert running.thresholds[len(WINDOWS), 0] < -4.0  # below it is an alarm
    running.restart(np.array([0]))
    alarms = [running.step(5.0 + 0.1 * random.standard_normal((4, 1)), False).any()
              for _ in range(SPAN // 4 + 100)]
    assert not any(alarms)
