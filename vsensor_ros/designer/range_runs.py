"""
Runs of a plant over its declared ranges, as the truth beside which the designer tries things.

The truth is the equations themselves, with parameters off by their spreads, noise as declared, and
commands that jump about their ranges. It begins anywhere in the ranges; what is outside of them
does not count.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse
from vsensor_ros.observers import Design, Model
from vsensor_ros.plant import Plant

HELD = 0.3  # s between jumps of the commands


class Moment(NamedTuple):
    """R runs at one time."""

    x: np.ndarray  # (n, R)
    u: np.ndarray  # (m,) what the commands have been since the moment before
    y: np.ndarray  # (R, L) readings, without curves
    inside: np.ndarray  # (R,) bool: was in the ranges all along


def names_of(plant: Plant) -> Design:
    """Return a design of a plant without virtual sensors, for which a kind makes its batch."""
    return Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                  dict(plant.units), plant.sample_time, {})


def range_runs(plant: Plant, m: Model, period: float, runs: int, random: np.random.Generator,
               steps: int, share: float = 1.0) -> Iterator[Moment]:
    """
    Yield so many runs at so many times, a period apart.

    share: of the way from the operating point to anywhere in the ranges, for start and commands.
    """
    root = 1.0 if m.sample_time else period**0.5  # white noise in continuous time, of one step
    f = Equations([parse(text) for text in m.equations],
                  (*m.states, *m.inputs, *m.unknown, *m.parameters),
                  [(name, parse(text)) for name, text in m.definitions])
    values = m.values[:, None] + m.spreads[:, None] * random.standard_normal(
        (len(m.values), runs))
    x = (m.initial + 3.0**0.5 * m.start * random.uniform(-1.0, 1.0, (runs, len(m.initial)))).T
    x = (1.0 - share) * plant.operating_point[:, None] + share * x
    middle = plant.operating_input
    low, high = plant.input_range.T
    known = np.isfinite(low) & np.isfinite(high)
    u, inside = middle.copy(), np.ones(runs, dtype=bool)
    for k in range(steps):
        if k % max(1, round(HELD / period)) == 0:
            u = u.copy()
            u[known] = (1.0 - share) * middle[known] + share * random.uniform(
                low[known], high[known])
        if k:
            pushed = (np.concatenate([m.input_noise, m.unknown_noise]) / root)[:, None] \
                * random.standard_normal((len(u) + len(m.unknown), runs))
            pushed[:len(u)] += u[:, None]
            x = _moved(f, m.sample_time is not None, period, x, np.concatenate([pushed, values]))
            x = x + root * m.process_noise[:, None] * random.standard_normal(x.shape)
        y = (m.C @ x + (m.Cu @ u)[:, None]).T + m.noise * random.standard_normal(
            (runs, len(m.C)))
        inside = inside & (np.clip(x.T, *plant.ranges.T) == x.T).all(axis=1)
        yield Moment(x, u, y, inside)


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
