"""How far from its start a virtual sensor's state may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.designer.noise import noise_model, RELATIVE
from vsensor_ros.designer.problem import Problem
from vsensor_ros.observers import VirtualSensor


def started(problem: Problem, sensor: VirtualSensor) -> VirtualSensor:
    """
    Add the covariance (k, k) of ``Phi x - z`` at the start to a virtual sensor that has states.

    A state is spread evenly over its range in the plant. One without a range differs from its
    initial value by a standard deviation of its natural size (see noise.py), of the initial value
    or of the operating point, whichever is most: 100 times the noise where nothing else is known.
    So give ranges: a state that is further off than that makes the estimate worse, while it
    converges, than its standard deviation says. What readings tell of it at the start is taken
    off, and their noise added.
    """
    if not sensor.order:
        return sensor
    plant, noise = problem.plant, noise_model(problem)
    rows = [plant.sensors.index(s) for s in problem.healthy]
    given = plant.noise[rows] / problem.y0_size
    natural = np.nanmedian(given) / RELATIVE if np.any(given > 0.0) else 1.0
    size = np.max([problem.scale * (natural or 1.0), np.abs(plant.initial),
                   np.abs(plant.operating_point)], axis=0)
    low, high = plant.ranges.T
    known = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    spread = np.where(known, ((high - low) / 2)**2 / 3, size**2)
    # one error of the whole start, not one for each state
    off = np.where(known, (high + low) / 2 - plant.initial, 0.0)
    unknown = sensor.Phi - sensor.z0_gain @ plant.C[rows]
    reading = (noise.reading * problem.y0_size)**2
    start = unknown @ (np.diag(spread) + np.outer(off, off)) @ unknown.T \
        + (sensor.z0_gain * reading) @ sensor.z0_gain.T
    return replace(sensor, start=(start + start.T) / 2)
