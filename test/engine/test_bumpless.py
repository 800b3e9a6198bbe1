"""A change of source without a jump."""

import math

from hypothesis import given, strategies as st
import pytest

from vsensor_ros.engine import Bumpless
from vsensor_ros.engine.channel import Channel

SECOND = 1_000_000_000
VALUES = st.floats(-1e6, 1e6)


def test_the_offset_decays_as_the_time_constant_says():
    b = Bumpless(0.5).begin(10 * SECOND, 4.0)
    for age in (0.0, 0.25, 0.5, 1.0, 3.0):
        at = 10 * SECOND + round(age * SECOND)
        assert b.add(1.0, at) == pytest.approx(1.0 + 4.0 * math.exp(-age / 0.5), rel=1e-12)
        assert b.active(at)
    gone = 10 * SECOND + round(0.5 * math.log(1e3) * SECOND)
    assert b.active(gone - 1000) and not b.active(gone + 1000)
    assert b.add(1.0, gone + 1000) == 1.0  # exactly


def test_without_a_time_constant_there_is_no_offset():
    b = Bumpless(0.0).begin(0, 4.0)
    assert b.add(1.0, 0) == 1.0 and not b.active(0)


@pytest.mark.parametrize('offset', [math.nan, math.inf, -math.inf])
def test_an_offset_that_is_no_number_is_none(offset):
    b = Bumpless(0.5).begin(0, offset)
    assert b.add(1.0, 0) == 1.0 and not b.active(0)


@given(st.lists(st.tuples(st.integers(0, 3 * SECOND), VALUES), min_size=2, max_size=20))
def test_switches_in_a_row_make_no_step_and_add_nothing_up(switches):
    b, now, out, most = Bumpless(0.5), 0, switches[0][1], 0.0
    for wait, value in switches[1:]:  # of the new source, which stays until the next switch
        now += wait
        last = b.add(out, now)
        b = b.begin(now, last - value, last).sent(b.begin(now, last - value).add(value, now))
        assert b.add(value, now) == pytest.approx(last, abs=1e-9)
        assert abs(b.step) <= 1e-9
        most = max(most, abs(b.left(now)))
        assert abs(b.left(now)) <= most
        assert abs(b.left(now + 4 * SECOND)) == 0.0  # 8 time constants
        out = value
    assert b.steps == len(switches) - 1


def test_the_step_is_that_of_the_first_output():
    b = Bumpless(0.5)
    assert b.sent(3.0) is b and math.isnan(b.step)
    b = b.begin(0, 1.0, before=3.0)
    assert math.isnan(b.step)
    assert b.sent(math.nan) is b
    b = b.sent(3.25)
    assert b.step == 0.25 and b.sent(7.0) is b and b.steps == 1
    b = b.begin(SECOND, 1.0).sent(5.0)  # from nothing
    assert math.isnan(b.step) and b.steps == 2


def test_a_clock_that_was_set_back_does_not_freeze_it():
    b = Bumpless(0.5).begin(10 * SECOND, 4.0)
    assert b.add(0.0, 10 * SECOND - 1000) == 4.0  # the state's time is a little behind
    assert b.add(0.0, 5 * SECOND) == 0.0  # set back


def test_a_new_time_constant_makes_no_step():
    b = Bumpless(0.5).begin(0, 4.0)
    left = b.left(SECOND)
    b = b.with_time_constant(2.0, SECOND)
    assert b.left(SECOND) == left
    assert b.left(3 * SECOND) == pytest.approx(left / math.e)
    assert b.with_time_constant(0.0, SECOND).left(SECOND) == 0.0


@pytest.mark.parametrize('wrong', [-1.0, math.nan, math.inf])
def test_a_time_constant_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError, match=f'^time_constant: {wrong} is not a time'):
        Bumpless(wrong)


def test_a_surer_virtual_sensor_is_not_burdened_by_the_error_of_the_one_before():
    def carried_on(before, deviation, source='virtual', fault_set=('y', 'z'), above=None):
        """Return by how much too high the first output is, and one when `passing` is gone."""
        channel = Channel('y', SECOND, Bumpless(0.5))
        channel.serve(source, fault_set, 5.0, 0, None, before)
        return [channel.serve('virtual', ('y',), 4.0, now, above, deviation, 'free') - 4.0
                for now in (0, SECOND // 10)]
    tenth = math.exp(-0.2)  # of the time constant
    assert carried_on(0.17, 0.01) == pytest.approx([1.0, 0.01 * tenth])
    assert carried_on(2.0, 1.5) == pytest.approx([1.0, tenth])  # within what it may be off anyway
    assert carried_on(0.1, 0.2) == carried_on(math.inf, math.inf) == \
        pytest.approx([1.0, tenth])  # no surer: it knows no better
    assert carried_on(0.1, 0.2, fault_set=('y',)) == pytest.approx([1.0, 0.2 * tenth])  # a run
    assert carried_on(0.0, 0.2, 'real', ()) == pytest.approx([1.0, tenth])


@given(VALUES, VALUES, st.integers(0, SECOND))
def test_what_may_be_the_fault_makes_no_jump_and_passes_soon(usual, rest, age):
    b = Bumpless(0.5).begin(SECOND, usual, passing=rest)
    size = abs(usual) + abs(rest)
    assert b.left(SECOND) == pytest.approx(usual + rest, abs=1e-12 * size)
    left = b.left(SECOND + age)
    assert abs(left - usual * math.exp(-2e-9 * age)) <= abs(rest) * max(
        0.0, 1.0 - 1e-8 * age)**2 + 1e-9 * size
    other = b.with_time_constant(2.0, SECOND + age)
    assert other.left(SECOND + age) == left
