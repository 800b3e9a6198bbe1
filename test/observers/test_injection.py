"""The steps of sliding modes against closed forms."""

import numpy as np
import pytest

from vsensor_ros.observers import Injection
from vsensor_ros.observers.injection import first_order, super_twisting

OF = Injection(np.array([[-2.0]]), np.ones(1), np.ones(1), 5.0, 2.0)
H = 0.01


def fed(step, size, residuals):
    """Return the states (T, size) of a mode that hears residuals (T,)."""
    states = [np.zeros(size)]
    for residual in residuals:
        states.append(step(states[-1], np.array(residual)))
    return np.array(states[1:])


def test_the_first_order_is_a_filtered_backward_difference_unless_it_saturates():
    size, step = first_order(OF, 0.3, H)
    residuals = 0.02 * np.random.default_rng(1).normal(size=400)
    told = fed(step, size, residuals)[:, -1]
    # held over a step an injection nu makes of e: a e + (1 - a)/2 nu
    a, before = np.exp(-2.0 * H), np.concatenate([[0.0], residuals[:-1]])
    difference = (residuals - a * before) * 2.0 / (1.0 - a)
    assert np.abs(difference).max() < OF.largest * 3.0
    small = residuals * 0.1
    expected, last = [], 0.0
    for value in 0.1 * difference:
        last += (1.0 - np.exp(-H / 0.3)) * (value - last)
        expected.append(last)
    assert np.allclose(fed(step, size, small)[:, -1], expected, atol=1e-12)
    # saturated: it injects no more than its largest, and is off the residual
    far = fed(step, size, np.full(20, 1.0))
    assert not np.allclose(far[:5, 0], 1.0, atol=0.1)
    assert far[:, -1].max() <= OF.largest * (1.0 - np.exp(-0.2 / 0.3)) + 1e-12
    assert np.isfinite(told).all()


def residual_of(fault):
    """Return what a fault (T,), held over each step, makes of the residual (T,)."""
    a, e, found = np.exp(-2.0 * H), 0.0, []
    for d in fault:
        e = a * e + (1.0 - a) / 2.0 * d
        found.append(e)
    return np.array(found)


def test_super_twisting_follows_any_fault_that_changes_no_faster_than_it_was_told():
    size, step = super_twisting(OF, H)
    t = np.arange(0.0, 8.0, H)
    fault = np.sin(1.5 * t)  # 1.5 /s at most, of 2
    states = fed(step, size, residual_of(fault))
    error = states[200:, -1] - fault[200:]
    assert np.abs(error).max() < 3.0 * OF.change * H
    assert np.abs(states[200:, 1]).max() < 1e-6  # on the residual, and it does not chatter
    slow = fed(*super_twisting(OF, H, np.array(0.3))[::-1], residual_of(fault))
    assert np.abs(slow[200:, -1] - fault[200:]).max() > 0.3


def test_super_twisting_tells_no_more_than_its_largest():
    size, step = super_twisting(OF, H)
    fault = 1.8 * np.arange(0.0, 6.0, H)  # to 10.8, more than twice the largest
    told = fed(step, size, residual_of(fault))[:, -1]
    assert told.max() == told[-1] == OF.largest


def test_at_rest_super_twisting_is_still():
    size, step = super_twisting(OF, H)
    states = fed(step, size, residual_of(np.full(600, 0.7)))
    assert states[-200:, -1] == pytest.approx(0.7, abs=1e-9)


def test_many_runs_at_once_are_as_one_after_the_other():
    residuals = np.random.default_rng(2).normal(size=(50, 3))
    for size, step in (first_order(OF, 0.2, H), super_twisting(OF, H)):
        state = np.zeros((3, size))
        for row in residuals:
            state = step(state, row)
        assert np.allclose(state, [fed(step, size, column)[-1] for column in residuals.T])
