"""When a time is confirmed, and what a stamp is measured against."""

import numpy as np

from vsensor_ros import design, Plant
from vsensor_ros.bank import Bank

SECOND = 10**9


def make_bank():
    plant = Plant.from_matrices([[-1, 1], [0, -2]], [0, 1], np.eye(2))
    return Bank(design(plant), rate=10.0, max_age=0.5)


def test_a_time_is_confirmed_once_every_live_sensor_has_spoken():
    bank = make_bank()
    assert bank.confirmed(SECOND)  # nobody is expected yet
    bank.take('y1', SECOND, 1.0)
    bank.take('y2', SECOND - 1, 1.0)
    assert not bank.confirmed(SECOND)
    assert bank.confirmed(SECOND - 1)
    assert bank.confirmed(SECOND, without={'y2'})
    assert bank.confirmed(2 * SECOND)  # both are silent by then: nobody is waited for


def test_a_stamp_is_ahead_of_the_present_not_of_the_last_step():
    bank = make_bank()
    bank.advance(SECOND)
    assert str(bank.take('y1', 5 * SECOND, 1.0)) == 'stamp ahead of the clock'
    assert bank.take('y1', 5 * SECOND, 1.0, now=5 * SECOND) is None


def test_the_later_of_two_commands_at_one_time_counts():
    bank = make_bank()
    for name in ('y1', 'y2', 'u1'):
        assert bank.take(name, SECOND, 0.0) is None
    assert bank.take('u1', SECOND, 1.0) is None
    assert str(bank.take('y1', SECOND, 1.0)) == 'duplicate stamp'
    for t in (0.1, 0.2, 0.3):  # x2' = -2 x2 + 1, x1' = -x1 + x2, both from 0
        x1 = 0.5 - np.exp(-t) + 0.5 * np.exp(-2 * t)
        bank.take('y1', SECOND + round(t * SECOND), x1)
        bank.advance(SECOND + round(t * SECOND))
        truth = 0.5 * (1 - np.exp(-2 * t))
        assert abs(bank.estimate(('y2',), 'y2') - truth) < 0.01 * truth
