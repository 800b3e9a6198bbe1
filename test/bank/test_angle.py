"""Readings that wrap: put next to one another inside, and into the driver's range outside."""

from dataclasses import replace
import math

from hypothesis import given, strategies as st
import numpy as np
import pytest

from vsensor_ros.bank import Bank
from vsensor_ros.bank.angle import Angle, Angles, samples_of, ShortWay
from vsensor_ros.designer import design
from vsensor_ros.plant import Plant

MS = 10**6
TURNS = st.sampled_from([math.tau, 360.0, 1.0, 4.0 * math.pi])
STEPS = st.lists(st.floats(-0.45, 0.45), min_size=1, max_size=40)  # of a turn
RANGES = st.sampled_from(['centred', 'positive', 'on and on'])


def said(angle, turn, how):
    """Return what a driver says of an angle."""
    if how == 'on and on':
        return angle
    low = -turn / 2 if how == 'centred' else 0.0
    return (angle - low) % turn + low


@given(TURNS, st.floats(-3.0, 3.0), STEPS, RANGES)
def test_readings_go_on_without_a_jump(turn, start, steps, how):
    truth = turn * (start + np.cumsum([0.0, *steps]))
    samples = Angles(Angle(turn), 500 * MS)
    for i, angle in enumerate(truth):
        assert samples.add(i * 10 * MS, float(said(angle, turn, how))) is None
    off = np.array(samples.values) - truth
    assert off == pytest.approx(np.full(len(truth), round(off[0] / turn) * turn), abs=1e-9 * turn)
    middle = samples.interpolated(5 * MS, 500 * MS)
    assert middle - off[0] == pytest.approx((truth[0] + truth[1]) / 2, abs=1e-9 * turn)


@given(TURNS, st.floats(-40.0, 40.0), st.floats(-40.0, 40.0))
def test_the_short_way(turn, a, b):
    """It is at most half a turn, and leads from one to the other."""
    a, b, angle = a * turn, b * turn, Angle(turn)
    short = angle.shortest(a - b)
    assert abs(short) <= turn * (0.5 + 1e-9)
    turns = (b + short - a) / turn
    assert turns == pytest.approx(round(turns), abs=1e-9)
    assert ShortWay([None, turn])(np.array([a - b, a - b])) == pytest.approx([a - b, short])
    near = angle.next_to(a, b)
    assert near - b == pytest.approx(short, abs=1e-9 * turn)


@given(TURNS, st.floats(-0.5, 0.5), st.floats(0.05, 0.2), RANGES, st.floats(-40.0, 40.0))
def test_what_goes_out_is_what_the_driver_would_say(turn, start, step, how, at):
    """The range is learnt from a few turns; before, it is half a turn either way."""
    angle, value = Angle(turn), at * turn
    first = angle.put(value)
    assert abs(first) <= turn * (0.5 + 1e-9)
    assert angle.shortest(first - value) == pytest.approx(0.0, abs=1e-9 * turn)
    for i in range(50):
        last = said((start + i * step) * turn, turn, how)
        angle.learn(last)
    out = angle.put(value, near=last)
    assert angle.shortest(out - value) == pytest.approx(0.0, abs=1e-9 * turn)
    if how == 'on and on':
        assert abs(out - last) <= turn * (0.5 + 1e-9)
    else:
        assert out == pytest.approx(said(value, turn, how), abs=1e-9 * turn) or \
            abs(out - said(value, turn, how)) == pytest.approx(turn)  # either end of the range


def test_a_number_far_away_teaches_nothing():
    angle = Angle(360.0)
    for reading in (10.0, 20.0, 8000.0, 8001.0, 21.0):
        angle.learn(reading)
    assert angle.put(350.0) == -10.0
    for reading in (0.0, 359.0):  # back over 0, as a compass says it
        angle.learn(reading)
    assert angle.put(-10.0) == 350.0
    angle.learn(-1.0)
    assert angle.put(-20.0, near=5.0) == -20.0


def test_what_is_no_angle():
    samples = Angles(Angle(1.0), 500 * MS)
    assert samples.add(0, 0.25) is None
    assert str(samples.add(1, 1e30)) == 'so many turns that its angle is lost'
    assert samples.stamps == [0]


def turned(*pairs):
    """Return the samples of two sensors of one angle: b is twice a, and runs back."""
    angles = {'a': Angle(math.tau), 'b': Angle(2 * math.tau)}
    found = samples_of({'a': math.tau, 'b': -2 * math.tau}, angles,
                       {'a': 500 * MS, 'b': 500 * MS})
    for name, stamp, value in pairs:
        assert found[name].add(stamp * MS, value) is None
    return found


def test_two_of_one_angle_begin_together():
    found = turned(('a', 0, 3.1), ('b', 1, 6.2))  # b: -6.2 + 4 pi
    assert found['b'].values == [pytest.approx(6.2 - 4 * math.pi)]
    alone = turned(('b', 1, 6.2))
    assert alone['b'].values == [6.2]


def test_after_a_gap_another_of_the_same_angle_knows_the_turns():
    turning = [('a', i, i * 0.02) for i in range(0, 1000, 10)]  # 20 rad/s: 3 turns
    gone = [('b', 0, 0.0), ('b', 985, -2 * (985 * 0.02 % math.tau))]
    found = turned(*sorted([*turning, *gone], key=lambda p: p[1]))
    assert found['b'].values[-1] == pytest.approx(-2 * 985 * 0.02, abs=0.5)
    alone = turned(*gone)
    assert alone['b'].values[-1] == gone[-1][2]  # nobody knows: as it came


def heading_and_wheel(bench, wrap):
    """Design the wheel of a base from its heading: the derivative, filtered."""
    v = bench.virtual_sensor([[-10.0]], [[-100.0]], Q=[[10.0]], fault_set=('wheel',),
                             healthy=('heading',), z0_gain=[[-10.0]])
    return replace(bench.design(v, names=('wheel', 'heading')), wrap=wrap)


@pytest.mark.parametrize('wraps', [True, False])
def test_a_heading_that_jumps_puts_no_wheel_out(bench, wraps):
    bank = Bank(heading_and_wheel(bench, ({'heading': math.tau},) if wraps else ()), 100.0)
    worst = 0.0
    for k in range(2000):  # two turns and more at 1 rad/s
        at = k * bank.period
        heading = 0.01 * k
        bank.take('heading', at, math.remainder(heading, math.tau))
        bank.take('wheel', at, 1.0)
        bank.advance(at)
        if k > 200:
            worst = max(worst, abs(bank.estimate(('wheel',), 'wheel') - 1.0))
    assert worst < 1e-3 if wraps else worst > 20.0


def test_residuals_go_the_short_way(bench):
    """The virtual sensor of a heading is a turn away from its readings; nobody minds."""
    v = bench.virtual_sensor([], [], Q=[[1.0]], fault_set=('a',), healthy=('b',))
    bank = Bank(replace(bench.design(v, names=('a', 'b')), wrap=({'a': math.tau}, )), 100.0)
    for k in range(3000):
        at = k * bank.period
        bank.take('a', at, math.remainder(0.01 * k + 0.02, math.tau))
        bank.take('b', at, 0.01 * k - 6 * math.pi)  # counts turns itself
        bank.advance(at)
    assert bank.residual(('a',), 'a') == pytest.approx(0.02, abs=1e-9)
    assert sum(bank.disagreement(('a',), 'a')) == pytest.approx(0.02, abs=1e-9)
    assert bank.deviation(('a',), 'a') < 0.1


def test_readings_of_an_isolated_sensor_are_put_next_to_one_another(bench):
    v = bench.virtual_sensor([], [], Q=[[1.0]], fault_set=('a',), healthy=('b',))
    bank = Bank(replace(bench.design(v, names=('a', 'b')),
                        wrap=({'a': math.tau, 'b': math.tau}, )), 100.0)
    isolated = range(300, 600)
    for k in range(900):
        at, heading = k * bank.period, 0.05 * k
        if k in (isolated[0], isolated[-1] + 1):
            bank.distrust(['a'] if k in isolated else [], at - 1)
        value = heading + 0.3 if k in isolated else heading
        bank.take('a', at, math.remainder(value, math.tau))
        bank.take('b', at, math.remainder(heading, math.tau))
        bank.advance(at)
        if k > 1:
            assert bank.residual(('a',), 'a') == pytest.approx(
                0.3 if k in isolated else 0.0, abs=1e-6)
            assert bank.estimate(('a',), 'a') == pytest.approx(heading, abs=1e-6)


def test_a_heading_that_was_tracked_is_known_for_a_time():
    """Its free run goes on from a reading; rehearsed through many jumps, it is known how well."""
    plant = Plant.from_matrices(
        [[0.0, 1.0], [0.0, -5.0]], [0.0, 5.0], [[180.0 / math.pi, 0.0], [0.0, 1.0]],
        process_noise=[0.0, 1.0], noise=[0.5, 0.01], wrap=[360.0, math.nan],
        sensors=['compass', 'gyro'])
    bank, key = Bank(design(plant, [('compass',)]), 100.0), (('compass',), 'compass')
    rng, heading, rate, off = np.random.default_rng(0), 3.0, 0.0, []
    for k in range(1900):
        at = k * bank.period
        bank.take('u1', at, 2.0)
        bank.take('gyro', at, rate + 0.01 * rng.normal())
        bank.take('compass', at, (math.degrees(heading) + 0.5 * rng.normal()) % 360.0)
        if k == 1500:
            assert bank.deviation(*key) < 1.0  # degrees
            bank.distrust(['compass'], at)
        bank.advance(at)
        if k >= 1500:
            off.append(math.remainder(bank.estimate(*key) - math.degrees(heading), 360.0)
                       / bank.deviation(*key))
        heading, rate = heading + 0.01 * rate, rate + 0.05 * (2.0 - rate)
    assert np.abs(off).max() < 3.0 and bank.deviation(*key) < 5.0
