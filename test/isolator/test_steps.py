"""A step stands out of a smooth course, and tells who at the moment a residual tells that."""

import numpy as np
import pytest
from three_sensors import of

from vsensor_ros.isolator.channels import BLOCK, Channels
from vsensor_ros.isolator.detector import ENOUGH
from vsensor_ros.isolator.steps import AFTER, largest_step

PERIOD = 0.01


def feed(channels, readings, learn=True):
    """Feed one channel; return after how many samples it seems to have stepped."""
    told = []
    for start in range(0, len(readings), 4):
        batch = readings[start:start + 4, None]
        channels.step(batch, np.zeros((4, 1)), np.zeros((4, 1)), learn)
        if not learn and channels.stepped()[0]:
            told.append(start + 4)
    return told


def test_a_step_on_a_smooth_course_has_its_size():
    time = np.linspace(-1.0, 1.0, 60)
    smooth = np.stack([3.0 * time**3 - time**2, 5.0 * time], axis=1)
    assert largest_step(smooth) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert largest_step(smooth + 0.7 * (time > 0.2)[:, None] * [1, 0]) == pytest.approx([0.7, 0.0])
    smooth[-AFTER:] = np.nan
    assert largest_step(smooth) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert np.isnan(largest_step(smooth[-AFTER - 30:])).all()


def test_what_steps_further_than_healthy_ones_is_seen_for_a_second_and_motion_is_not():
    channels, random, enough = Channels(PERIOD, 4, 1), np.random.default_rng(0), ENOUGH / PERIOD

    def moving(samples, far=1.0):  # by 20 sigma, once in two seconds
        return far * 20.0 * np.sin(np.pi * PERIOD * np.arange(samples)) \
            + random.standard_normal(samples)
    feed(channels, moving(8800))
    assert not channels.stepped().any() and np.isinf(channels._step).all()  # not known yet
    feed(channels, moving(round(enough) - 8800 + 1200))
    told = feed(channels, moving(400) + 8.0 * (np.arange(400) >= 100), learn=False)
    assert 100 < told[0] <= 100 + AFTER + 8 and told[-1] <= 100 + BLOCK + 4
    more = moving(2200, 3.0)
    feed(channels, more[:200], learn=False)  # it began with a bend
    assert feed(channels, more[200:], learn=False) == []
    feed(channels, moving(20) + 20.0, learn=False)
    assert channels.stepped().all()
    channels.restart()
    assert not channels.stepped().any()


@pytest.mark.parametrize('jumps', [True, False])
def test_a_step_tells_who_it_is_before_a_second_residual_does(machine, jumps):
    """Of two residuals that b is in, the other is blind here."""
    def estimates(readings):
        return np.array([readings[1], readings[1], readings[0]])
    verdict = machine.run(8.0, of('b', lambda reading, time, random: reading + (
        0.2 * (time > 2.0) if jumps else 0.03 * time)), estimates)
    if jumps:
        assert (verdict.state, verdict.faulty) == ('isolated', ('b',))
        assert verdict.faults[0].kind == 'bias'
    else:
        assert verdict.state == 'suspected' and verdict.candidates == (('a',), ('b',))
