"""How far from its start a virtual sensor's state may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.designer.noise import noise_model
from vsensor_ros.designer.problem import Problem
from vsensor_ros.observers import VirtualSensor


def started(problem: Problem, sensor: VirtualSensor) -> VirtualSensor:
    """
    Add the covariance (k, k) of ``Phi x - z`` at the start to a virtual sensor that has states.

    A state with a range is taken to be anywhere in it, evenly. A state without one differs from
    its initial value by a standard deviation: the largest of its natural size (natural_size.py),
    its initial value and its operating point. So give ranges: if a state is further off than that,
    the estimate is worse, while it converges, than the stated deviation. What the readings tell at
    the start is taken off, and their noise is added.
    """
    if not sensor.order:
        return sensor
    plant, noise = problem.plant, noise_model(problem)
    rows = [plant.sensors.index(s) for s in problem.healthy]
    size = np.max([problem.scale, np.abs(plant.initial), np.abs(plant.operating_point)], axis=0)
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
