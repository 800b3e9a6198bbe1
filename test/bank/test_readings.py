"""Samples of one channel: order, value at any time, commands over a step."""

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
        assert less.held(time) == whole.held(time)


@given(TIMES, st.integers(0, 10**6 - 1), st.integers(1, 10**5))
def test_a_command_over_a_step_keeps_mean_and_first_moment(stamps, start, length):
    values = [float(np.cos(s)) for s in stamps]
    samples, end = filled(stamps, values), start + length
    first, last, mean = samples.over(start, end)
    if samples.held(start) is None:
        assert (first, last, mean) == (0.0, 0.0, 0.0)
        return
    edges = [start, *(s for s in stamps if start < s < end), end]
    pieces = [(a, b, samples.held(a)) for a, b in zip(edges, edges[1:])]
    area = sum((b - a) * v for a, b, v in pieces) / length
    moment = sum(v * ((b - start) ** 2 - (a - start) ** 2) / 2 for a, b, v in pieces) / length**2
    assert mean == pytest.approx(area, abs=1e-12)
    assert (first + last) / 2 == pytest.approx(area, abs=1e-12)
    assert first / 6 + last / 3 == pytest.approx(moment, abs=1e-12)
    if len(pieces) == 1:
        assert first == last == pieces[0][2]


def test_keeps_a_bounded_number():
    samples = filled(range(200_000), [0.0] * 200_000)
    assert len(samples.stamps) <= 2**16
    assert samples.stamps[-1] == 199_999
