"""The verdict, on runs whose errors are known."""

from dataclasses import replace

import numpy as np
import pytest

from vsensor_ros.simulate.fault import drop_out, freeze, Recorded
from vsensor_ros.simulate.judge import Heard, judge, replaced
from vsensor_ros.simulate.scenario import Scenario

TIME = np.linspace(0.0, 10.0, 101)
TRUTH = Recorded.of(TIME, np.sin(TIME))
RAW = drop_out(freeze(TRUTH, 4.0), 7.0)
SCENARIO = Scenario('sine', 'y', 'm', 4.0, 5.0, 1.0, 0.02, '', {'y': RAW}, TRUTH,
                    ((4.0, 'freeze'), (7.0, 'drop_out')))
STAMPS = np.arange(5.003, 10.0, 0.01)


def heard(value, time=STAMPS):
    """Return the forwarded messages up to the isolation, then those given."""
    before = TIME[TIME <= 5.0]
    return Heard(np.r_[before, time], np.r_[RAW.value[TIME <= 5.0], value],
                 np.r_[before, time] - 5.0)


def test_rmse_of_replacement_and_of_holding():
    run = heard(np.sin(STAMPS) + 0.01)
    verdict = judge(SCENARIO, run)
    assert verdict.rmse == pytest.approx(0.01, rel=0.1)     # the truth is interpolated
    expected = np.sqrt(np.mean((np.sin(3.9) - np.sin(STAMPS)) ** 2))
    assert verdict.rmse_hold == pytest.approx(expected, rel=1e-2)
    assert verdict.latency_ms == pytest.approx(3.0)
    assert verdict.passed
    assert not judge(SCENARIO, heard(np.sin(STAMPS) + 0.03)).passed


def test_frozen_messages_still_on_their_way_are_not_replacements():
    late = Heard(np.array([4.9, 5.0, 5.003]),
                 np.float32([RAW.value[49], RAW.value[50], np.sin(5.003)]).astype(float),
                 np.array([-0.1, 0.001, 0.002]))
    assert replaced(SCENARIO, late).tolist() == [False, False, True]


def test_a_replacement_on_the_stamp_of_a_reading_is_one():
    run = Heard(np.array([5.1]), np.array([np.sin(5.1)]), np.array([0.1]))
    assert replaced(SCENARIO, run).tolist() == [True]


def test_what_comes_after_the_end_does_not_count():
    assert judge(SCENARIO, heard(np.r_[np.sin(STAMPS), 99.0], np.r_[STAMPS, 10.2])).passed


def test_silence_and_nan_do_not_pass():
    nothing = judge(SCENARIO, heard([], []))
    assert (nothing.rmse, nothing.latency_ms, nothing.passed) == (None, None, False)
    half = STAMPS < 7.5
    assert not judge(SCENARIO, heard(np.sin(STAMPS[half]), STAMPS[half])).passed
    holes = np.where(np.arange(len(STAMPS)) == 100, np.nan, np.sin(STAMPS))
    assert not judge(SCENARIO, heard(holes)).passed


def test_the_bar_is_the_largest_rmse_allowed():
    run = heard(np.sin(STAMPS) + 0.01)
    rmse = judge(SCENARIO, run).rmse
    assert judge(replace(SCENARIO, bar=rmse), run).passed
    assert not judge(replace(SCENARIO, bar=0.999 * rmse), run).passed
