"""Samples of one channel: order, and the value at any time."""

from hypothesis import given, strategies as st
import numpy as np
import pytest

from vsensor_ros.bank.readings import Samples

TIMES = st.lists(st.integers(0, 10**6), min_size=1, max_size=30, unique=True).map(sorted)


def filled(stamps, values):
    samples = Samples()
    for stamp, value in zip(stamps, values):
        assert samples.add(stamp, value) is None
    return samples


def test_refuses_what_is_not_later():
    samples = filled([10, 20], [1.0, 2.0])
    assert str(samples.add(20, 3.0)) == 'duplicate stamp'
    assert str(samples.add(15, 3.0)) == 'stamp runs backwards'
    assert samples.stamps == [10, 20]


@given(TIMES, st.integers(-10, 10**6 + 10), st.integers(1, 10**6))
def test_interpolates_where_the_next_is_known_and_near(stamps, time, max_age):
    values = [float(np.sin(s)) for s in stamps]
    got = filled(stamps, values).interpolated(time, max_age)
    before = [i for i, s in enumerate(stamps) if s <= time]
    if not before:
        assert got is None
        return
    i = before[-1]
    if i + 1 < len(stamps) and stamps[i + 1] - stamps[i] <= max_age:
        assert got == pytest.approx(np.interp(time, stamps, values), abs=1e-12)
    elif time - stamps[i] <= max_age:
        assert got == values[i]
    else:
        assert got is None


@given(TIMES, st.integers(0, 10**6))
def test_forgetting_changes_no_later_value(stamps, before):
    values = [float(s % 7) for s in stamps]
    whole, less = filled(stamps, values), filled(stamps, values)
    less.forget(before)
    for time in range(before, 10**6 + 100, 99_991):
        assert less.interpolated(time, 10**5) == whole.interpolated(time, 10**5)


def test_keeps_a_bounded_number():
    samples = filled(range(200_000), [0.0] * 200_000)
    assert len(samples.stamps) <= 2**16
    assert samples.stamps[-1] == 199_999
