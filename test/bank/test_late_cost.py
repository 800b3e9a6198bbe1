"""What late data may cost: steps redone in the mean, and states kept."""

import numpy as np
import pytest

from vsensor_ros import design, Plant
from vsensor_ros.bank import Bank

MS = 10**6
START = 10**12


def make_bank(rate, max_age, monkeypatch):
    """Return a bank for x' = -x + u with two sensors, and the count of its steps."""
    plant = Plant.from_matrices([[-1, 1], [0, -2]], [0, 1], np.eye(2))
    bank = Bank(design(plant), rate, max_age)
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


def test_a_sensor_that_is_always_late_costs_a_bounded_number_of_steps(monkeypatch):
    bank, counted = make_bank(1000.0, 0.5, monkeypatch)
    run(bank, 3000, late=400)
    assert len(counted) < 3000 * 5 + 1001
    assert bank.estimate(('y2',), 'y2') is not None  # which reads y1


@pytest.mark.parametrize('late', [0, 3, 40])
def test_late_readings_end_up_in_the_estimate_all_the_same(monkeypatch, late):
    punctual, _ = make_bank(100.0, 2.0, monkeypatch)
    delayed, _ = make_bank(100.0, 2.0, monkeypatch)
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


def test_a_great_max_age_keeps_a_bounded_past(monkeypatch):
    bank, counted = make_bank(1000.0, 86400.0, monkeypatch)
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
