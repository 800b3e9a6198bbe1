"""What was at an earlier time, and states that are stepped anew. Truth: z' = u - z, solved."""

import math

import numpy as np
import pytest

from vsensor_ros.bank import Bank

SECOND = 10**9
PERIOD = SECOND // 100
KEY = ('y1',), 'y1'


def truth(time):
    """Return z for z(0) = 0 and u = 1."""
    return 1.0 - math.exp(-1e-9 * time)


def started(bench, until):
    sensor = bench.virtual_sensor([[-1.0]], [[1.0]], B=[[1.0]], z0=[0.0],
                                  inputs=('u',))
    bank = Bank(bench.design(sensor, inputs=('u',)), 100.0)
    bank.take('u', 0, 1.0)
    for now in range(0, until + 1, PERIOD):
        bank.take('y2', now, 0.0)
        bank.advance(now)
    return bank


def test_what_was_said_of_an_earlier_time(bench):
    bank = started(bench, SECOND)
    for time in (SECOND, SECOND - PERIOD, SECOND - 7 * PERIOD // 2, SECOND // 3):
        value, deviation, interval = bank.recall(*KEY, time)
        assert value == pytest.approx(truth(time), abs=2e-5) and interval is None
        assert deviation == pytest.approx(bank.deviation(*KEY), rel=1e-6)
    assert bank.recall(*KEY, SECOND)[0] == bank.estimate(*KEY)
    assert bank.recall(*KEY, SECOND + PERIOD)[0] == bank.estimate(*KEY)  # the last there is


def test_what_is_not_known_is_none(bench):
    bank = started(bench, 3 * SECOND)
    assert bank.recall(*KEY, SECOND) is None  # longer ago than states are kept
    assert bank.recall(('y2',), 'y2', 3 * SECOND) is None
    bank.distrust(['y2'])
    assert bank.recall(*KEY, 3 * SECOND) is None  # it reads what is not believed
    assert Bank(bench.design(bench.virtual_sensor([], [], Q=[[2.0]])), 100.0).recall(
        *KEY, 0) is None


def test_states_that_are_stepped_anew_are_the_same(bench):
    bank, other = started(bench, SECOND), started(bench, SECOND)
    assert bank.step_back(SECOND - 30 * PERIOD - 1) == SECOND - 31 * PERIOD
    assert bank.time == SECOND - 31 * PERIOD
    assert bank.estimate(*KEY) == other.recall(*KEY, bank.time)[0]
    for now in range(bank.time, SECOND + 20 * PERIOD, PERIOD):
        bank.take('y2', now + 31 * PERIOD, 0.0, now + 31 * PERIOD)
        bank.advance(now)
    other.advance(bank.time)
    assert bank.estimate(*KEY) == pytest.approx(other.estimate(*KEY), abs=1e-12)
    assert not bank.jumps and not bank.restarts
    assert bank.step_back(-SECOND) >= 0  # one is kept


def test_who_is_believed_again_is_so_from_now_on_however_old_the_state(bench):
    bank = started(bench, SECOND)
    bank.distrust(['y2'])
    bank.step_back(SECOND - 30 * PERIOD)
    bank.distrust([], SECOND)
    for stamp in np.arange(-10, 10) * PERIOD + SECOND:
        reason = bank.take('y2', int(stamp), 0.0, 2 * SECOND)
        assert (reason is None) == (stamp >= SECOND + PERIOD)
