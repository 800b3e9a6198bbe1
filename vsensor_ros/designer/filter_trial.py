"""
What a filter on the equations does where its plant may be: runs over the declared ranges.

Nothing is proved of such a filter, so it is tried. The truth is the equations themselves, with
parameters off by their spreads, noise as declared, and commands that jump about their ranges. It
begins anywhere in the ranges; readings of the channels tell for a while, then they are lost. What
is outside of the ranges does not count.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.designer.noise import INTERVAL
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse
from vsensor_ros.observers import Design, ExtendedSensor, Model, Told, Tried
from vsensor_ros.observers.kinds.extended.filter import Filter, LOST
from vsensor_ros.plant import Plant

RUNS = 40
SECONDS = 2.0  # after the loss, and as long, at least, before it
HELD = 0.3  # s between jumps of the commands
SURE = 2.0  # standard deviations that ought to hold 95 %


def with_trials(plant: Plant, design: Design) -> Design:
    """Return a design whose filters have been tried."""
    return replace(design, entries={key: replace(entry, tried=tried(plant, entry)) if isinstance(
        entry, ExtendedSensor) and entry.model.states == plant.states else entry
        for key, entry in design.entries.items()})


def tried(plant: Plant, entry: ExtendedSensor, truth: Model | None = None,
          runs: int = RUNS, seed: int = 0) -> Tried:
    """Return how far off a filter is after the loss, and how often it knows; truth: its model."""
    m, random = truth or entry.model, np.random.default_rng(seed)
    period = m.sample_time or INTERVAL
    root = 1.0 if m.sample_time else period**0.5  # white noise in continuous time, of one step
    own = m.C[plant.sensors.index(entry.channel)]
    reads = np.array([name in entry.reads for name in plant.sensors])
    tracks = reads | np.array([name in entry.fault_set for name in plant.sensors]) \
        & m.C.any(axis=1)
    each = np.tile(reads, (runs, 1))
    before = Filter(entry.model, period, np.tile(tracks, (runs, 1)), each & False)
    after = Filter(entry.model, period, each, each)
    f = Equations([parse(text) for text in m.equations],
                  (*m.states, *m.inputs, *m.unknown, *m.parameters),
                  [(name, parse(text)) for name, text in m.definitions])
    values = m.values[:, None] + m.spreads[:, None] * random.standard_normal(
        (len(m.values), runs))
    x = (m.initial + 3.0**0.5 * m.start * random.uniform(-1.0, 1.0, (runs, len(m.initial)))).T
    low, high = plant.input_range.T
    known = np.isfinite(low) & np.isfinite(high)
    u, there = plant.operating_input.copy(), np.ones(len(reads) + len(m.inputs), dtype=bool)
    loss = max(1, round(max(SECONDS, min(entry.warm_up, 10.0 * SECONDS)) / period))
    z, counts = None, np.ones(runs, dtype=bool)
    errors, stated, gone, seen = [], [], np.zeros(runs, dtype=bool), 0
    for k in range(loss + max(1, round(SECONDS / period))):
        if k % max(1, round(HELD / period)) == 0:
            u[known] = random.uniform(low[known], high[known])
        if k:
            pushed = (np.concatenate([m.input_noise, m.unknown_noise]) / root)[:, None] \
                * random.standard_normal((len(u) + len(m.unknown), runs))
            pushed[:len(u)] += u[:, None]
            x = _moved(f, m.sample_time is not None, period, x, np.concatenate([pushed, values]))
            x = x + root * m.process_noise[:, None] * random.standard_normal(x.shape)
        y = (m.C @ x + (m.Cu @ u)[:, None]).T + m.noise * random.standard_normal(
            (runs, len(reads)))
        told = Told(y, there, u)
        z = before.start(told) if z is None else (before if k < loss else after).step(
            z, told, np.array([u, u, u]))
        counts &= (np.clip(x.T, *plant.ranges.T) == x.T).all(axis=1)
        if k >= loss:
            gone |= counts & (z[:, -1] > LOST)
            says, seen = counts & ~gone, seen + int(counts.sum())
            off = abs((z[:, :len(x)] - x.T) @ own)
            errors.append(off[says])
            stated.append(np.array([after.deviation(own, one) for one in z[says]]))
    off, deviation = np.concatenate(errors), np.concatenate(stated)
    return Tried(runs, SECONDS, float(np.sqrt(np.mean(off**2))) if len(off) else 0.0,
                 float(np.mean(off <= SURE * deviation)) if len(off) else 0.0,
                 float(gone.mean()), len(off) / max(seen, 1))


def _moved(f: Equations, discrete: bool, h: float, x: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return states (n, N) a period on, by Runge and Kutta in two steps."""
    def slope(x: np.ndarray) -> np.ndarray:
        return f.values(np.concatenate([x, rest]))
    if discrete:
        return slope(x)
    for _ in range(2):
        half = h / 2
        k1 = slope(x)
        k2 = slope(x + half / 2 * k1)
        k3 = slope(x + half / 2 * k2)
        x = x + half / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + half * k3))
    return x
