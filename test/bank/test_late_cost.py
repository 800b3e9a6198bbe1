"""What late data may cost: steps redone in the mean, and states kept."""

from functools import partial

import numpy as np
import pytest

from vsensor_ros.bank import Bank

MS = 10**6
START = 10**12


@pytest.fixture(name='make_bank')
def _make_bank(bench, monkeypatch):
    """Return a function that makes a bank and the list that counts its steps."""
    # x1' = -x1 + x2, x2' = -2 x2 + u, both measured; for y2, z = x2 - 8 x1
    d = bench.design(
        bench.virtual_sensor([[-1.0]], [[1.0]], inputs=('u1',)),
        bench.virtual_sensor([[-10.0]], [[-72.0]], B=[[1.0]], Q=[[8.0]], fault_set=('y2',),
                             healthy=('y1',), inputs=('u1',)), inputs=('u1',))
    return partial(counting_bank, d, monkeypatch)


def counting_bank(d, monkeypatch, rate, max_age):
    bank = Bank(d, rate, max_age)
    counted = []
    step = bank._next
    monkeypatch.setattr(bank, '_next', lambda state: counted.append(1) or step(state))
    return bank, counted


def run(bank, ticks, late):
    """Feed both sensors each period [ms], y1 late by so many periods; both follow sines."""
    period = bank.period
    bank.take('u1', START, 0.3)
    for k in range(ticks):
        bank.take('y2', START + k * period, np.sin(0.01 * k))
        if k >= late:
            bank.take('y1', START + (k - late) * period, np.cos(0.013 * (k - late)))
        bank.advance(START + k * period)


def test_a_sensor_that_is_always_late_costs_a_bounded_number_of_steps(make_bank):
    bank, counted = make_bank(1000.0, 0.5)
    run(bank, 3000, late=400)
    assert len(counted) < 3000 * 5 + 1001
    assert bank.estimate(('y2',), 'y2') is not None  # which reads y1


@pytest.mark.parametrize('late', [0, 3, 40])
def test_late_readings_end_up_in_the_estimate_all_the_same(make_bank, late):
    punctual, _ = make_bank(100.0, 2.0)
    delayed, _ = make_bank(100.0, 2.0)
    run(punctual, 600, late=0)
    run(delayed, 600, late=late)
    for k in range(600 - late, 600):  # what is missing arrives, then some ticks pass
        delayed.take('y1', START + k * delayed.period, np.cos(0.013 * k))
    for bank in (punctual, delayed):
        for k in range(600, 650):
            bank.take('y1', START + k * bank.period, np.cos(0.013 * k))
            bank.take('y2', START + k * bank.period, np.sin(0.01 * k))
            bank.advance(START + k * bank.period)
    assert delayed.estimate(('y2',), 'y2') == pytest.approx(
        punctual.estimate(('y2',), 'y2'), rel=1e-12)


def test_a_great_max_age_keeps_a_bounded_past(make_bank):
    bank, counted = make_bank(1000.0, 86400.0)
    run(bank, 1500, late=0)
    assert len(bank._past) <= 1002
    # y1 is silent for five seconds, and its return does not redo all of them
    for k in range(1500, 6500):
        bank.take('y2', START + k * bank.period, 0.0)
        bank.advance(START + k * bank.period)
    before = len(counted)
    bank.take('y1', START + 6500 * bank.period, 1.0)
    bank.advance(START + 6500 * bank.period)
    assert len(counted) - before <= 1002


def test_a_reading_that_is_too_old_to_count_redoes_nothing(make_bank):
    bank, counted = make_bank(100.0, 0.2)
    bank.take('y1', START, 1.0)
    for k in range(300):
        bank.take('y2', START + k * bank.period, 1.0)
        bank.advance(START + k * bank.period)
    before = len(counted)
    assert bank.take('y1', START + 100 * bank.period, 2.0) is None
    bank.advance(START + 299 * bank.period)
    assert len(counted) == before


def test_data_that_is_late_now_and_then_is_not_put_off(make_bank):
    bank, _ = make_bank(100.0, 0.5)
    put_off = 0
    bank.take('u1', START, 0.3)
    for k in range(600):  # y1 alone, at 10 Hz, 50 ms late: 1.5 steps redone a step
        if k % 10 == 5:
            bank.take('y1', START + (k - 5) * bank.period, np.cos(0.013 * (k - 5)))
        bank.advance(START + k * bank.period)
        put_off += bank._late.waits
    assert put_off == 0
