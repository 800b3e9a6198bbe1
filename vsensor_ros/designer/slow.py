"""What it is worth to learn slow offsets while a channel is still believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.observers import VirtualSensor
from vsensor_ros.plant import Plant


def unlearnt(plant: Plant, sensor: VirtualSensor) -> VirtualSensor | None:
    """
    Return a tracked virtual sensor as if its slow offsets were at their initial value when lost.

    Of each nothing is known then but the range that it may be anywhere in, evenly. None where
    there is no offset in it, or one without a range.
    """
    held = plant.slow & sensor.Phi.any(axis=0)
    low, high = plant.ranges[held].T
    if sensor.tracking is None or not held.any() or not np.isfinite(high - low).all():
        return None
    off = (high - low)**2 / 12 + ((high + low) / 2 - plant.initial[held])**2
    moved = sensor.Phi[:, held] * np.sqrt(off)
    P = sensor.tracking.P + moved @ moved.T
    return replace(sensor, tracking=replace(sensor.tracking, P=(P + P.T) / 2))
