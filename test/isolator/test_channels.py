"""What readings alone tell: stuck, dropped out, noisy; and idle sensors that are neither."""

import numpy as np
import pytest

from vsensor_ros.isolator.channels import Channels

PERIOD = 0.01


def feed(channels, readings, estimates=None, learn=True):
    """Return at which samples a channel was taken for stuck, dropped and noisy."""
    estimates = np.zeros_like(readings) if estimates is None else estimates
    stuck, dropped, noisy = [], [], []
    for k in range(0, len(readings) - len(readings) % 4, 4):
        part = slice(k, k + 4)
        channels.step(readings[part, None], readings[part, None] - estimates[part, None],
                      estimates[part, None], learn)
        for found, which in ((stuck, channels.stuck(estimates[part][-1:])),
                             (dropped, channels.dropped()), (noisy, channels.noisy())):
            if which[0]:
                found.append(k)
    return stuck, dropped, noisy


def noise(count, seed=0):
    return np.random.default_rng(seed).standard_normal(count)


def quantised(count, seed=0):
    """Return a slow idle signal in steps, such as of a ten bit converter: most samples repeat."""
    return np.round(2 * np.sin(np.arange(count) * 2e-3) + 0.1 * noise(count, seed))


def test_a_noisy_channel_that_stops_is_stuck_within_a_tenth_of_a_second():
    channels = Channels(PERIOD, 4, 1)
    assert feed(channels, noise(4000)) == ([], [], [])
    stuck, _, _ = feed(channels, np.full(40, 0.5), learn=False)
    assert 0 < stuck[0] * PERIOD <= 0.12


def test_a_coarse_channel_is_not_stuck_by_its_usual_repeats():
    readings = np.round(1.5 * noise(8000))  # repeats of 30 % and fewer are judged
    channels = Channels(PERIOD, 4, 1)
    assert feed(channels, readings)[0] == []
    assert feed(channels, np.round(1.5 * noise(8000, 1)), learn=False)[0] == []


def test_an_idle_quantised_channel_is_stuck_only_beside_an_estimate_that_moves():
    channels = Channels(PERIOD, 4, 1)
    readings = quantised(6000)
    assert feed(channels, readings, readings)[0] == []
    idle = np.full(1600, readings[-1])
    assert feed(channels, idle, idle, learn=False)[0] == []
    moving = readings[-1] + 3 * np.sin(np.arange(1600) * 2e-3)
    assert feed(channels, idle, moving, learn=False)[0]


def test_nothing_for_long_is_a_drop_out_and_slow_readings_are_none():
    channels = Channels(PERIOD, 4, 1)
    slow = np.full(4000, np.nan)
    slow[::10] = noise(400)
    assert feed(channels, slow)[1] == []
    gone = feed(channels, np.full(100, np.nan), learn=False)[1]
    assert 0.1 <= gone[0] * PERIOD <= 0.35


def test_noise_is_what_is_rougher_than_both_the_reading_and_the_residual_were():
    channels = Channels(PERIOD, 4, 1)
    feed(channels, noise(4000))
    assert feed(channels, noise(2000, 1) * 1.5, learn=False)[2] == []
    assert feed(channels, noise(200, 2) * 5.0, learn=False)[2][0] * PERIOD < 1.0
    # a motion that bends as much, which the model knows of
    channels = Channels(PERIOD, 4, 1)
    motion = 10 * np.sin(np.arange(4000) * 1.0)
    feed(channels, 0.1 * motion + noise(4000), 0.1 * motion)
    assert feed(channels, motion[:2000] + noise(2000, 3), motion[:2000], learn=False)[2] == []


def test_jumps_that_nobody_can_find_teach_no_roughness():
    channels, jumps = Channels(PERIOD, 4, 1), 300.0 * (np.arange(9000) // 300 % 2)
    assert feed(channels, noise(3000)) == ([], [], [])
    assert feed(channels, noise(9000, 1) + jumps)[2] == []
    _, _, noisy = feed(channels, 5.0 * noise(400, 2), learn=False)
    assert 0 < noisy[0] * PERIOD < 1.0


def test_motion_beyond_what_was_learnt_is_measured_and_forgotten_again():
    channels = Channels(PERIOD, 4, 1)
    wave = np.sin(np.arange(8000) * 0.01)
    feed(channels, wave)
    assert channels.beyond[0] < 0.05
    feed(channels, 3 * wave[:2000], learn=False)
    assert channels.beyond[0] == pytest.approx(2.0, rel=0.3)
    feed(channels, wave, learn=False)
    assert channels.beyond[0] < 0.1


def test_how_long_a_channel_rests_is_not_known_before_it_has_rested_some_times():
    channels = Channels(PERIOD, 4, 1)
    steps = np.repeat([0.0, 1.0, 0.0, 1.0], 800)  # as a sensor of a gate says
    assert feed(channels, steps, steps)[0] == []
    late = np.where(np.arange(3200) < 2800, 1.0, 0.4)
    assert feed(channels, np.ones(3200), late, learn=False)[0] == []


def test_a_channel_may_repeat_twice_as_often_as_it_ever_did():
    readings = noise(4000)
    readings[1::16] = readings[:-1:16]  # pairs, and once eight in a row
    readings[2001:2009] = readings[2000]
    channels = Channels(PERIOD, 4, 1)
    assert feed(channels, readings)[0] == [] and channels.longest[0] == 8
    held = noise(40, 1)
    held[8:21] = held[7]
    assert feed(channels, held, learn=False)[0] == []
    held[8:] = held[7]
    assert feed(channels, held, learn=False)[0] != []
