"""The benchmark's machines and virtual sensors agree where the parameters are right."""

import numpy as np
import pytest

from benchmark.isolator_plants import cases, checks_of, designed, Machines, Observers


@pytest.mark.parametrize('case', [c for c in cases() if c.name != 'tank'], ids=lambda c: c.name)
def test_residuals_of_a_right_model_are_as_noisy_as_designed_and_no_more(case):
    sensors, count = case.plant.sensors, 20
    checks = checks_of(designed(case))
    machines, observers = Machines(case, count, 0.0, 1), Observers(checks, sensors, count)
    observers.start(machines.x)
    own = [sensors.index(s.channel) for s in checks]
    residuals = []
    for _ in range(300):
        readings, commands = machines.step()
        residuals.append(readings[:, own] - observers.step(readings, commands))
    spread = np.std(residuals[100:], axis=(0, 1)) / case.noise[own]
    assert (spread > 0.9).all() and (spread < 2.5).all()  # some read noise of two sensors
