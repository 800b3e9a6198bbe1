"""A machine whose three sensors show the same: each pair of them is a residual."""

import numpy as np

from vsensor_ros.isolator import Isolator, Settings
from vsensor_ros.observers import Residual

PERIOD = 0.1  # s
NOISE = 0.01
SENSORS = ('a', 'b', 'c')
PAIRS = (('a', 'b'), ('b', 'c'), ('c', 'a'))
RESIDUALS = tuple(Residual(f'{one} from {other}', (one,), one, tuple(sorted((one, other))),
                           (1.0, 1.0), NOISE * 1.5, 6.0 * NOISE) for one, other in PAIRS)


class Machine:
    """It moves, and its isolator looks on."""

    def __init__(self, residuals=RESIDUALS, seed=0, **settings):
        self.isolator = Isolator(Settings(**settings), SENSORS, residuals, PERIOD,
                                 units={'b': 'rad/s'})
        self.random = np.random.default_rng(seed)
        self.others = [SENSORS.index(PAIRS[RESIDUALS.index(r)][1]) for r in residuals]
        self.tick = 0
        self.phase = 0.0

    def run(self, seconds, fault=None, estimates=None, until=None, motion=1.0,
            speed=1.0):
        """Go on; fault(readings, s, random) says what the drivers say. Returns the verdict."""
        verdict = None
        for k in range(round(seconds / PERIOD)):
            self.tick += 1
            self.phase += 0.05 * speed * PERIOD
            truth = motion * np.sin(self.phase)
            readings = truth + NOISE * self.random.standard_normal(3)
            if fault is not None:
                readings = fault(readings, k * PERIOD, self.random)
            said = readings[self.others] if estimates is None else estimates(readings)
            said = np.where(np.isnan(said), truth, said)  # a bank goes on for a while
            verdict = self.isolator.step(self.tick * round(PERIOD * 1e9), readings, said)
            if until is not None and until(verdict):
                break
        return verdict


def of(sensor, change):
    """Return the fault that changes one reading by change(reading, s, random)."""
    def fault(readings, time, random):
        readings = readings.copy()
        readings[SENSORS.index(sensor)] = change(readings[SENSORS.index(sensor)], time, random)
        return readings
    return fault
