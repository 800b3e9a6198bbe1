"""How uncertain an estimate may be, and what is said of one that is beyond that."""

from dataclasses import replace
import math
from pathlib import Path
import sys

import pytest

sys.path.append(str(Path(__file__).parent))
from machine import Machine, PERIOD

from vsensor_ros.engine.limits import Limits
from vsensor_ros.observers.knowledge import Noise


@pytest.fixture
def exceeded(bench):
    """Return a function that judges an estimate whose design's figure is 0.01."""
    def exceeded(deviation, measured=math.nan, given=None, grows=False, assumed=False,
                 figure=0.01, share=1.0, **more):
        v = bench.virtual_sensor([[-1.0]], [[1.0]], noise=Noise(figure, figure, assumed))
        limits = Limits(replace(bench.design(v), **more), {'y1': given, 'y2': None})
        reason = limits.exceeded(v, 'y1', deviation, lambda: measured, grows, share)
        return '' if reason is None else str(reason)
    return exceeded


RANGE = {'ranges': {'y1': (-1.0, 2.0)}}
TOLERANCE = {**RANGE, 'tolerances': {'y1': 0.5}}


def test_by_default_the_tolerance_or_a_tenth_of_the_range(exceeded):
    assert exceeded(0.3, **RANGE) == ''
    assert exceeded(0.31, **RANGE) == \
        'its standard deviation 0.31 is above a tenth of the range, 0.3'
    assert exceeded(0.5, **TOLERANCE) == ''
    assert exceeded(0.51, **TOLERANCE) == 'its standard deviation 0.51 is above the tolerance 0.5'
    assert exceeded(1e9) == ''  # neither is known
    assert exceeded(math.inf, **TOLERANCE) == ''  # nor is the deviation


def test_ten_times_the_figure_that_it_was_designed_for(exceeded):
    assert exceeded(0.2, measured=0.09) == ''  # it was good: a reading is late, or it starts
    assert exceeded(0.2) == exceeded(0.09, measured=0.2) == ''
    assert exceeded(0.2, measured=0.11) == \
        'it erred by 0.11 beside the healthy sensor, more than 0.1: it was designed for 0.01'
    assert exceeded(0.2, measured=0.11, assumed=True) == ''
    assert exceeded(0.2, measured=0.11, figure=0.0) == ''  # the plant file says `noise: 0`
    assert exceeded(0.029, measured=0.029, figure=1e-9, **RANGE) == ''  # a hundredth of the range
    assert exceeded(0.031, measured=0.031, figure=1e-9, **RANGE) != ''


def test_a_number_counts_alone_and_0_is_none(exceeded):
    assert exceeded(0.4, measured=0.4, given=0.4, **RANGE) == ''
    assert exceeded(0.01, given=0.009, **RANGE) == \
        'its standard deviation 0.01 is above max_deviation 0.009'
    assert exceeded(math.inf, given=1e12) != ''
    assert exceeded(1e9, measured=1e9, given=0.0, **RANGE) == ''


@pytest.mark.parametrize('given', [None, 0.0])
def test_a_temporary_one_needs_a_limit(exceeded, given):
    def judged(deviation, **more):
        return exceeded(deviation, given=given, grows=True, **more)
    assert judged(0.2, measured=0.2, **RANGE) == ''  # it is bound to grow
    assert 'a tenth of the range' in judged(0.31, **RANGE)
    assert 'the tolerance' in judged(math.inf, **TOLERANCE)
    assert judged(0.001) == 'it would serve for a time only, and no limit says for how long'
    assert exceeded(0.001, given=0.1, grows=True) == ''
    assert exceeded(0.2, given=0.1, grows=True, **RANGE) != ''


@pytest.mark.parametrize('share', [1.0, 0.8])
def test_a_share_of_each_limit(exceeded, share):
    for limits, at in (({'given': 0.5}, 0.5), (RANGE, 0.3), (TOLERANCE, 0.5)):
        assert exceeded(0.99 * share * at, share=share, **limits) == ''
        assert exceeded(1.01 * share * at, share=share, **limits) != ''
    assert exceeded(0.099 * share, measured=1.0, share=share) == ''
    assert exceeded(0.101 * share, measured=1.0, share=share) != ''


def test_a_deviation_that_comes_and_goes_about_its_limit_does_not_whip_the_output(bench):
    """The other sensor pauses now and then: what it may have moved by is above the limit."""
    m, k = Machine(bench, max_deviation={'y1': 0.0, 'y2': 0.2}), 0

    def go_on(periods, every):
        nonlocal k
        for _ in range(periods):
            k, m.now = k + 1, m.now + PERIOD
            y1 = math.sin(0.05 * k)
            if k % every == 0:
                m.hear(0, y1)
            m.hear(1, 2.0 * y1)
            m.pass_time()
    go_on(1000, every=1)
    m.isolate('y2')
    assert m.state('y2').deviation < 0.1
    for _ in range(10):
        go_on(20, every=8)
        assert m.state('y2').source == 'none'
        go_on(20, every=1)
    assert m.state('y2').switches == 2
    go_on(40, every=1)
    assert m.state('y2').source == 'virtual' and m.state('y2').switches == 3
