"""
What a filter on the equations does where its plant may be: runs over the declared ranges.

Nothing is proved of such a filter, so it is tried, beside runs as in `range_runs`. Readings of the
channels tell for a while, then they are lost.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.designer.extended import model_of
from vsensor_ros.designer.noise import INTERVAL
from vsensor_ros.designer.range_runs import names_of, range_runs
from vsensor_ros.observers import Design, ExtendedSensor, Model, Told, Tried
from vsensor_ros.observers.kinds.extended.batch import make_batch
from vsensor_ros.observers.kinds.extended.filter import LOST
from vsensor_ros.plant import Plant

RUNS = 40
SECONDS = 2.0  # after the loss, and as long, at least, before it
SURE = 2.0  # standard deviations that ought to hold 95 %


def with_trials(plant: Plant, design: Design) -> Design:
    """Return a design whose filters have been tried."""
    return replace(design, entries={key: replace(entry, tried=tried(plant, entry)) if isinstance(
        entry, ExtendedSensor) else entry for key, entry in design.entries.items()})


def tried(plant: Plant, entry: ExtendedSensor, truth: Model | None = None,
          runs: int = RUNS, seed: int = 0) -> Tried:
    """Return how far off a filter is after the loss, and how often it knows; truth: its model."""
    made = entry.model
    m = truth or model_of(plant, dict(zip(made.parameters, made.spreads)))
    period, own = m.sample_time or INTERVAL, plant.sensors.index(entry.channel)
    batch = make_batch([entry], names_of(plant), period, None)
    before, after = (batch.filter.of(np.full(runs, row)) for row in (
        batch.tracked[0].tracker, batch.tracked[0].own))
    there = np.ones(len(plant.sensors) + len(m.inputs), dtype=bool)
    loss = max(1, round(max(SECONDS, min(entry.warm_up, 10.0 * SECONDS)) / period))
    z, errors, stated, gone, seen = None, [], [], np.zeros(runs, dtype=bool), 0
    for k, (x, u, y, inside) in enumerate(range_runs(
            plant, m, period, runs, np.random.default_rng(seed),
            loss + max(1, round(SECONDS / period)))):
        told = Told(y, there, u)
        z = before.start(told) if z is None else (before if k < loss else after).step(
            z, told, np.array([u, u, u]))
        if k >= loss:
            gone |= inside & (z[:, -1] > LOST)
            deviation = np.array([batch.along(0, one) for one in z])
            says, seen = inside & ~gone & (deviation < np.inf), seen + int(inside.sum())
            off = batch.estimate(0, z, y, u) - (m.C[own] @ x + m.Cu[own] @ u)
            if made.angle:  # the short way
                turn = 2.0 * np.pi * abs(made.factors[own])
                off = np.remainder(off + turn / 2, turn) - turn / 2
            errors.append(abs(off[says]))
            stated.append(deviation[says])
    off, deviation = np.concatenate(errors), np.concatenate(stated)
    return Tried(runs, SECONDS, float(np.sqrt(np.mean(off**2))) if len(off) else 0.0,
                 float(np.mean(off <= SURE * deviation)) if len(off) else 0.0,
                 float(gone.mean()), len(off) / max(seen, 1))
