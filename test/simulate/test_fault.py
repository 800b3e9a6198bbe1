"""Faults change what they say, when they say, and nothing else."""

import numpy as np
from numpy.testing import assert_array_equal
import pytest

from vsensor_ros.simulate.fault import (
    bias,
    drift,
    drop_out,
    freeze,
    infinity,
    noise,
    not_a_number,
    Recorded,
    spikes,
)

TIME = np.arange(10.0)
CHANNEL = Recorded.of(TIME, TIME ** 2)


def test_freeze_repeats_the_last_reading_before():
    frozen = freeze(CHANNEL, 3.0, 6.0)
    assert_array_equal(frozen.value, [0, 1, 4, 4, 4, 4, 36, 49, 64, 81])
    assert frozen.sent.all()
    assert np.isnan(freeze(CHANNEL, 0.0).value).all()   # there was none


def test_freeze_repeats_what_was_sent_last():
    assert freeze(drop_out(CHANNEL, 1.0, 3.0), 3.0).value[5] == 0.0


def test_drop_out_sends_nothing_and_leaves_the_values():
    silent = drop_out(CHANNEL, 3.5)
    assert_array_equal(silent.sent, TIME < 3.5)
    assert_array_equal(silent.value, CHANNEL.value)


def test_nan_is_sent():
    bad = not_a_number(CHANNEL, 2.0, 4.0)
    assert_array_equal(np.isnan(bad.value), (TIME >= 2) & (TIME < 4))
    assert bad.sent.all()


def test_infinity_is_sent():
    assert_array_equal(np.isinf(infinity(CHANNEL, 2.0, 4.0).value), (TIME >= 2) & (TIME < 4))


def test_noise_is_white_and_as_large_as_asked_for():
    long = Recorded.of(np.arange(20000.0), np.zeros(20000))
    added = noise(long, 10000.0, size=3.0).value
    assert not added[:10000].any()
    assert abs(np.std(added[10000:]) - 3.0) < 0.1
    assert abs(np.corrcoef(added[10000:-1], added[10001:])[0, 1]) < 0.05


def test_bias_and_drift():
    assert_array_equal(bias(CHANNEL, 8.0, size=2.0).value - CHANNEL.value, [0] * 8 + [2, 2])
    assert_array_equal(drift(CHANNEL, 7.0, 9.0, rate=3.0).value - CHANNEL.value,
                       [0] * 7 + [0, 3, 0])


def test_spikes_are_rare_and_the_same_again():
    long = Recorded.of(np.arange(10000.0), np.zeros(10000))
    spiked = spikes(long, 5000.0, size=4.0, probability=0.01).value
    assert set(np.unique(spiked)) == {-4.0, 0.0, 4.0}
    assert not spiked[:5000].any()
    assert 20 < np.count_nonzero(spiked) < 90
    assert_array_equal(spiked, spikes(long, 5000.0, size=4.0, probability=0.01).value)


@pytest.mark.parametrize('fault', [freeze, drop_out, not_a_number])
def test_faults_are_pure(fault):
    before = CHANNEL.value.copy(), CHANNEL.sent.copy()
    fault(CHANNEL, 2.0)
    assert_array_equal(CHANNEL.value, before[0])
    assert_array_equal(CHANNEL.sent, before[1])
