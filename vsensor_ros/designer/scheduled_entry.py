"""What a design holds of a scheduled virtual sensor that was proved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.scheduled import premises_from, scheduled, ScheduledObserver, SPREAD
from vsensor_ros.observers import ScheduledSensor
from vsensor_ros.plant import from_equations, Plant
from vsensor_ros.reason import Reason

MOST = 16  # submodels that a design tries
_LOOKED_AT = 200  # points of a curve


def over_the_ranges(plant: Plant, fault_set: tuple[str, ...], channel: str,
                    rate: float) -> ScheduledSensor | Reason | None:
    """
    Return one for a channel that has failed with others, proved over the plant's ranges.

    rate [1/s]: at which an error must die out at least. A reason where the ranges forbid it; None
    where the plant is not of this kind: equations in continuous time, with few products, that
    declare ranges and noise. Raises ImportError where the desk's solver is missing.
    """
    if channel not in fault_set or not plant.equations or plant.sample_time is not None or \
            plant.Cd.any() or plant.Cu.any() or plant.unknown is not None or \
            not np.isfinite(plant.noise).all():
        return None
    C0 = plant.C[[name not in fault_set for name in plant.sensors]]
    told = np.abs(np.linalg.pinv(C0) @ C0 - np.eye(len(plant.states))).max(axis=1, initial=0.0)
    try:
        made = from_equations(
            plant, [name for name, off in zip(plant.states, told) if off < 1e-9])
    except BadInput:  # a range is open, or there are too many products
        return None
    if not 1 < len(made.A) <= MOST:
        return None
    noise = _reading_noise(plant)
    answer = scheduled(made, fault_set, channel, rate=rate, noise=noise,
                       unknown=abs(plant.disturbance_range).max(axis=1),
                       box=np.vstack([plant.ranges, plant.input_range]))
    if isinstance(answer, Reason):
        return answer
    if not np.isfinite(plant.ranges[answer.Phi.any(axis=0)]).all():
        return None
    answer = replace(answer, half_width=answer.half_width + _driven(answer, plant))
    low, high = plant.reading_ranges().get(channel, (-np.inf, np.inf))
    if not answer.half_width < (high - low) / 2:
        return Reason.of('as wide as the range', half_width=answer.half_width, range=high - low)
    return scheduled_entry(answer, noise, plant.ranges)


def _reading_noise(plant: Plant) -> np.ndarray:
    """Return the noise of linear readings (l,), of a curve where it is flattest."""
    noise = plant.noise.copy()
    for name, curve in plant.curves.items():
        if curve.text:
            noise[plant.sensors.index(name)] /= min(
                map(curve.slope, np.linspace(curve.low, curve.high, _LOOKED_AT).tolist()))
    return noise


def _driven(observer: ScheduledObserver, plant: Plant) -> float:
    """Return how far off white noise that drives the states leaves it, as noise of readings is."""
    made, Phi, S = observer.plant, observer.Phi, observer.S
    moved = np.concatenate([
        np.broadcast_to(np.diag(plant.process_noise), (len(made.A), *made.A.shape[1:])),
        made.B * plant.input_noise, made.E * plant.disturbance_noise], axis=2)
    grows = (np.linalg.cholesky(S).T @ Phi @ np.nan_to_num(moved))**2  # of e' S e, in the mean
    size = float(grows.sum(axis=(1, 2)).max()) / (2.0 * observer.rate)
    return SPREAD * float(np.sqrt(size * (observer.Cv @ np.linalg.solve(S, observer.Cv.T))[0, 0]))


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
    used = observer.Phi.any(axis=0)
    if not np.isfinite(ranges[used]).all():
        raise BadInput(plant.name, 'ranges', 'are open', 'give low and high of each state')
    rows = [plant.sensors.index(name) for name in observer.reads]
    read = SPREAD * np.asarray(noise, dtype=float)[rows]
    from_readings, from_inputs = premises_from(plant, plant.C[rows])
    low, high = ranges[used].T
    # e' S e from the middle of a box is at most that of all its half sides in a row
    sides = np.linalg.cholesky(observer.S).T @ observer.Phi[:, used] * (high - low) / 2
    return ScheduledSensor(
        observer.channel, observer.fault_set, observer.reads, plant.inputs,
        'exact' if observer.decoupled else 'bounded', plant.premises, plant.ranges,
        plant.memberships, from_readings, from_inputs, observer.N, observer.J, observer.B,
        observer.a, observer.Cv, observer.Q, observer.S,
        observer.Phi[:, used] @ (low + high) / 2,
        max(1.0, float(np.linalg.norm(sides, axis=0).sum())**2),
        observer.rate, observer.half_width, float(abs(observer.Q[0]) @ read))
