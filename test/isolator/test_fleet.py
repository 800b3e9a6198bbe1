"""The benchmark's machines and virtual sensors agree where the parameters are right."""

import numpy as np
import pytest

from benchmark.isolator_plants import bank_of, cases, Machines, Observers


@pytest.mark.parametrize('case', [c for c in cases() if c.name != 'tank'], ids=lambda c: c.name)
def test_residuals_of_a_right_model_are_as_noisy_as_designed_and_no_more(case):
    sensors, count = case.plant.sensors, 20
    checks, bank = bank_of(case)
    machines, observers = Machines(case, count, 0.0, 1), Observers(bank, sensors, count)
    observers.start(machines.x)
    own = np.array([sensors.index(i.channel) if i.channel in sensors else -1 for i in checks])
    residuals = []
    for _ in range(300):
        readings, commands = machines.step()
        read = np.where(own >= 0, readings[:, own], 0.0)
        residuals.append(read - observers.step(readings, commands))
    spread = np.std(residuals[100:], axis=(0, 1))
    assert (spread[own >= 0] > 0.9 * case.noise[own[own >= 0]]).all()  # that of the reading itself
    assert (spread < 1.5 * np.array([i.noise for i in checks])).all()
