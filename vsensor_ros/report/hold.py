"""
Hold an unstable plant at its operating point, so that a picture shows more than its fall.

The error of a virtual sensor does not care where the plant goes: what its commands are, it knows.
The controller knows the true state; it stands for whatever keeps the real machine upright.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from vsensor_ros.plant import Plant
from vsensor_ros.plant.linear import linearised
from vsensor_ros.simulate import simulate

EVERY = 4  # steps of the run of a continuous plant pass between two commands
FALLEN = 10.0  # sizes of a state from the operating point: no longer held


def growth(plant: Plant) -> float:
    """Return the rate [1/s] at which the plant leaves its operating point, negative: returns."""
    values = np.linalg.eigvals(linearised(plant)[0]).astype(complex)
    if plant.sample_time is None:
        return float(values.real.max())
    return float(np.log(max(np.abs(values).max(), 1e-12)) / plant.sample_time)


def holding_gain(plant: Plant, period: float, state: np.ndarray,
                 command: np.ndarray) -> np.ndarray | None:
    """
    Return K (m, n) of u = -K x that holds the plant, or None when its commands cannot.

    period [s]: for which a command is held (of a discrete plant: its sample time); state (n,) and
    command (m,): what is much of each. Source: the linear-quadratic regulator.
    """
    A, B = linearised(plant)
    n, m = B.shape
    if not m:
        return None
    if plant.sample_time is None:
        both = expm(period * np.block([[A, B], [np.zeros((m, n + m))]]))
        A, B = both[:n, :n], both[:n, n:]
    B = B * command
    A, B = A / state[:, None] * state, B / state[:, None]
    try:
        X = solve_discrete_are(A, B, np.eye(n), np.eye(m))
        K = np.linalg.solve(np.eye(m) + B.T @ X @ B, B.T @ X @ A)
    except (np.linalg.LinAlgError, ValueError):
        return None
    if not np.abs(np.linalg.eigvals(A - B @ K)).max(initial=0.0) < 1.0:
        return None
    return np.asarray(command[:, None] * K / state)


def held(plant: Plant, time: np.ndarray, commands: np.ndarray,
         rho: Callable[[float], np.ndarray], start: np.ndarray, sizes: np.ndarray,
         effort: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Run the held plant; None when it falls all the same.

    time (T,) in equal steps; commands (T, m), to which those that hold it are added; sizes (n,)
    and effort (m,) as of ``holding_gain``. Returns its states (T, n) and all commands (T, m).
    """
    every = EVERY if plant.sample_time is None else 1
    K = holding_gain(plant, every * time[1], sizes, effort)
    if K is None:
        return None
    x, given = np.empty((len(time), len(start))), commands.copy()
    x[0] = start
    for first in range(0, len(time) - 1, every):
        off = x[first] - plant.operating_point
        if not np.all(np.abs(off) <= FALLEN * sizes):
            return None
        last = min(first + every, len(time) - 1)
        given[first:last + 1] = commands[first] - K @ off
        x[first:last + 1] = simulate(plant, time[first:last + 1], given[first:last + 1], rho,
                                     x[first])
    return x, given
