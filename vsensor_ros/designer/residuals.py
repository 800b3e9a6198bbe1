"""The residuals of a design: what each is made of, and what faults and noise make of it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.special import ndtri

from vsensor_ros.designer.noise import given_or, interval_of
from vsensor_ros.designer.observer import linearised
from vsensor_ros.designer.problem import pose
from vsensor_ros.designer.response import constant, responds
from vsensor_ros.observers import Entry, Refusal, Residual, VirtualSensor
from vsensor_ros.observers.kinds.functional.tracking import tracker
from vsensor_ros.plant import Plant

DAY = 86400.0  # s


def residuals(plant: Plant, entries: Iterable[Entry | Refusal]) -> tuple[Residual, ...]:
    """Return the residuals ``y - vhat`` of virtual sensors that no unknown input reaches."""
    return tuple(residual(plant, entry) for entry in entries
                 if not isinstance(entry, Refusal) and entry.grade != 'bounded'
                 and entry.channel in plant.sensors)


def residual(plant: Plant, entry: Entry) -> Residual:
    """
    Return the residual of a virtual sensor of a sensor's channel, or of a dedicated filter.

    Its support is what it feels, be it through a term alone; the gains are those of constant
    faults, terms with their slopes at the operating point.
    """
    own = entry.channel if entry.channel in plant.sensors else None
    apart = ', '.join(entry.fault_set)
    name = (f'{own} without {apart}' if own else entry.channel)
    if isinstance(entry, VirtualSensor):
        felt = _felt(plant, entry, own)
    else:  # of another kind nobody knows here what it does with its readings
        felt = dict.fromkeys((*entry.reads, *((own,) if own else ())), None)
    support = tuple(s for s in plant.sensors if s in felt)
    noise, assumed = _noise(plant, entry, own)
    return Residual(name, entry.fault_set, entry.channel, support,
                    tuple(felt[s] for s in support), noise, noise * _once_a_day(plant), assumed)


def _felt(plant: Plant, entry: VirtualSensor, own: str | None) -> dict[str, float | None]:
    """Return whom a residual feels, and what a constant fault of one makes of it in the end."""
    # while its channel is believed a temporary one tracks: its residual is an innovation
    v = tracker(entry) if entry.grade == 'temporary' else entry
    N, J = linearised(plant, v)
    h = v.sample_time
    through = sum((np.outer(v.P[:, i], np.abs(v.Gy[i]).sum(axis=0)) for i in v.active),
                  np.zeros_like(J))
    E, R = v.Cv[:1], v.Q[:1]
    if own is not None:
        E, R = -E, np.array([[float(s == own) for s in v.healthy]]) - R
    # in natural coordinates of z, so that no sum is rounding but by its own parts
    ways = np.hstack([J, through])
    moves = np.any(np.split(responds(N, ways, E, np.hstack([R, np.zeros_like(R)]), h), 2), axis=0)
    ends = constant(N, J, E, R, h)[0]
    felt: dict[str, float | None] = {
        s: float(end) for s, end, moved in zip(v.healthy, ends, moves.tolist()) if moved}
    if own is not None and own not in v.healthy:  # nothing but itself says what it says
        felt[own] = 1.0
    return felt


def _noise(plant: Plant, entry: Entry, own: str | None) -> tuple[float, bool]:
    """Return the standard deviation of a healthy residual, and whether defaults stand in it."""
    if own is None:
        return (1.0, True) if entry.noise is None else (entry.noise.error, entry.noise.assumed)
    i = plant.sensors.index(own)
    problem = pose(plant, entry.fault_set, own)
    size = problem.size_of([i])
    reading = float((given_or(plant.noise[[i]] / size) * size)[0])
    assumed = bool(np.isnan(plant.noise[i]))
    if isinstance(entry, VirtualSensor) and entry.grade == 'temporary':
        t = entry.tracking
        assert t is not None
        error = float(np.sqrt((t.C[0] @ t.P @ t.C[0]) + t.direct))
        return float(np.hypot(error, reading)), assumed or t.assumed
    if entry.noise is None:
        return reading, True
    return float(np.hypot(entry.noise.error, reading)), assumed or entry.noise.assumed


def _once_a_day(plant: Plant) -> float:
    """Return what of its deviation white noise exceeds once a day, either way."""
    step = interval_of(pose(plant, (), plant.sensors[0]))
    step = step if plant.sample_time is None else plant.sample_time
    return float(-ndtri(min(0.5, step / DAY) / 2.0))
