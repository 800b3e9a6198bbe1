"""How noisy proved virtual sensors are in simulation, one beside another on the same runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vsensor_ros.designer.extended import model_of
from vsensor_ros.designer.noise import INTERVAL
from vsensor_ros.designer.range_runs import names_of, range_runs
from vsensor_ros.observers import Batch, kind_named, ScheduledSensor, Told, VirtualSensor
from vsensor_ros.plant import Plant

RUNS = 2
SETTLED = 3.0  # of their slowest time constants: then their start is forgotten
LONGEST = 4000  # steps of a run
PER_TIME_CONSTANT = 2.0  # steps, of the fastest
SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)  # of the ranges, until the plant stays in them


def simulated_noise(plant: Plant, entries: Sequence[VirtualSensor | ScheduledSensor],
                    seed: int = 0) -> np.ndarray | None:
    """
    Return the rms error of each [unit of the channel] while the plant is in its ranges.

    They stand in for one channel in continuous time; None: the plant does not stay there.
    """
    rates = np.concatenate([np.abs(np.linalg.eigvals(entry.N)).ravel() for entry in entries])
    period = float(min(INTERVAL, 1.0 / (PER_TIME_CONSTANT * max(rates.max(initial=0.0), 1e-6))))
    settled = SETTLED / min(entry.decay for entry in entries) / period
    if not settled < LONGEST:
        return None
    model = model_of(plant, {})
    model = replace(model, **{name: np.nan_to_num(getattr(model, name)) for name in (
        'process_noise', 'unknown_noise')})  # what is not known counts for nothing
    own = plant.C[plant.sensors.index(entries[0].channel)]
    batches = [kind_named(entry.kind).batch([entry], names_of(plant), period, None)
               for entry in entries]
    there = np.ones(len(plant.sensors) + len(plant.inputs), dtype=bool)
    for share in SHARES:
        z: list[list[np.ndarray]] = []
        told: list[Told] = []
        errors = []
        for k, (x, u, y, inside) in enumerate(range_runs(
                plant, model, period, RUNS, np.random.default_rng(seed),
                2 * round(settled) + 200, share)):
            if not inside.all():
                break
            before, told = told, [Told(row, there, u, np.zeros(len(row))) for row in y]
            z = [[batch.start(one) for one in told] for batch in batches] if not before else [
                [batch.step(of_run, was, now, np.array([u, u, u]))[0]
                 for of_run, was, now in zip(of_kind, before, told)]
                for batch, of_kind in zip(batches, z)]
            if k >= settled:
                errors += [[_said(batch, of_kind[run], told[run]) - float(own @ x[:, run])
                            for batch, of_kind in zip(batches, z)] for run in range(RUNS)]
        else:
            return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))
    return None


def _said(batch: Batch, z: np.ndarray, told: Told) -> float:
    return float(batch.estimates(z[:batch.size], told.y, told.held)[0])
