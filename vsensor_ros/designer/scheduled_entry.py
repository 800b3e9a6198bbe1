"""What a design holds of a scheduled virtual sensor that was proved."""

from __future__ import annotations

import itertools

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.scheduled import ROUNDING, ScheduledObserver, SPREAD
from vsensor_ros.observers import ScheduledSensor


def scheduled_entry(observer: ScheduledObserver, noise: np.ndarray,
                    ranges: np.ndarray) -> ScheduledSensor:
    """
    Return the entry of a design that runs it.

    noise (l,): standard deviations of the readings, as they were for the proof; ranges (n, 2): of
    the states, from whose middle it starts. Raises BadInput for a range that is open, and for a
    plant in steps.
    """
    plant = observer.plant
    if plant.sample_time is not None:
        raise BadInput(plant.name, 'time', 'is discrete', 'give a plant in continuous time')
    if not np.isfinite(ranges).all():
        raise BadInput(plant.name, 'ranges', 'are open', 'give low and high of each state')
    rows = [plant.sensors.index(name) for name in observer.reads]
    C0, read = plant.C[rows], SPREAD * np.asarray(noise, dtype=float)[rows]
    of_states = np.linalg.pinv(C0, rcond=ROUNDING)  # x, where the readings tell it
    from_readings = np.zeros((len(plant.premises), len(rows)))
    from_inputs = np.zeros((len(plant.premises), len(plant.inputs)))
    for i, name in enumerate(plant.premises):
        if name in plant.states:
            from_readings[i] = of_states[plant.states.index(name)]
        else:
            from_inputs[i, plant.inputs.index(name)] = 1.0
    half = (ranges[:, 1] - ranges[:, 0]) / 2
    signs = np.array(list(itertools.product((-1, 1), repeat=len(half))))
    corners = observer.Phi @ (half * signs).T
    return ScheduledSensor(
        observer.channel, observer.fault_set, observer.reads, plant.inputs,
        'exact' if observer.decoupled else 'bounded', plant.premises, plant.ranges,
        plant.memberships, from_readings, from_inputs, observer.N, observer.J, observer.B,
        observer.a, observer.Cv, observer.Q, observer.S, observer.Phi @ ranges.mean(axis=1),
        max(1.0, float(np.einsum('kc,kl,lc->c', corners, observer.S, corners).max())),
        observer.rate, observer.half_width, float(abs(observer.Q[0]) @ read))
