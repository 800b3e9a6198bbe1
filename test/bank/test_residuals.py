"""The residuals that isolation judges: when their observers count, and what they have read."""

from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.bank import Residuals
from vsensor_ros.simulate import simulate

PLANT = Path(__file__).parents[2] / 'config' / 'three_tank' / 'plant.yaml'
PERIOD = 10_000_000
OF_Y2 = 1  # the residual that reads y1; it takes 14.6 s to forget its start


@pytest.fixture(scope='module')
def tanks():
    """Return the design, its residuals, commands (T, 2) and readings (T, 2) of 100 Hz."""
    plant = load_plant(PLANT)
    found = design(plant, isolate=True)
    t = np.arange(1200) / 100
    u = np.column_stack((0.9 + 0.5 * np.sin(0.5 * t), 0.5 + 0.4 * np.sin(0.8 * t + 1.0)))
    return found, found.isolability.residuals, u, simulate(plant, t, u, None, [5, 3, 1])[:, 1:]


class Run:
    """Residuals of the tanks, step by step; of each step the estimates are kept."""

    def __init__(self, tanks):
        self.design, residuals, self.u, self.y = tanks
        assert residuals[OF_Y2].support == ('y1', 'y2') and residuals[OF_Y2].channel == 'y2'
        self.residuals = Residuals(self.design.isolating(), residuals, 100.0,
                                   dict.fromkeys(self.design.sensors, 0.5))
        self.k, self.said = 0, []

    def until(self, end, y1=0.0, y2=0.0):
        """Go on to a step; y1, y2: what is added to the readings."""
        for k in range(self.k, end):
            for name, value in zip(('u1', 'u2', 'y1', 'y2'), (
                    *self.u[k], self.y[k, 0] + y1, self.y[k, 1] + y2)):
                self.residuals.take(name, k * PERIOD, value)
            self.said += [found for _, _, found in self.residuals.at_least(1, k * PERIOD)]
        self.k = end
        return self

    def off(self, begin, end):
        """Return what the observer of y2 says above the truth; NaN where it does not count."""
        return np.array(self.said)[begin:end, OF_Y2] - self.y[begin:end, 1]


def test_what_has_read_a_fault_goes_on_from_its_tracker_when_that_is_over(tanks):
    run = Run(tanks).until(300)
    run.until(500, y1=0.8)
    run.residuals.blame({'y1'})
    run.until(600, y1=0.8).until(650)
    run.residuals.blame(())
    run.until(900)
    assert np.isnan(run.off(300, 652)).all()  # it has not forgotten its start yet
    # it has forgotten the fault within a few steps, and is right: y1 tells of level 3
    assert np.isfinite(run.off(655, 900)).all() and (np.abs(run.off(655, 900)) < 0.01).all()


def test_a_fault_of_its_own_channel_meanwhile_is_in_what_it_starts_from(tanks):
    """So that it starts anew, too, when that is over, though it does not read that channel."""
    run = Run(tanks).until(300)
    run.residuals.blame({'y1'})
    run.until(400, y1=0.8)
    run.residuals.blame(())
    run.until(450, y2=0.5)  # nobody knows of it
    shown = 0.5 - run.off(410, 450)
    assert (shown > 0.0).all() and shown[-1] > shown[0]  # it comes out by and by
    run.residuals.blame({'y2'})
    run.until(500, y2=0.5).until(520)
    run.residuals.blame(())
    run.until(600)
    assert (np.abs(run.off(525, 600)) < 0.01).all()


def test_it_does_not_start_from_who_is_blamed(tanks):
    run = Run(tanks).until(300)
    run.residuals.blame({'y1', 'y2'})
    run.until(400, y1=0.8, y2=0.5)
    run.residuals.blame({'y2'})
    run.until(500, y2=0.5)
    assert np.isnan(run.off(400, 500)).all()
    run.until(520)
    run.residuals.blame(())
    run.until(600)
    assert (np.abs(run.off(525, 600)) < 0.01).all()
