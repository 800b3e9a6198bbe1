"""
How readings of the failed channels correct a virtual sensor while they are still believed.

The steady Kalman filter of its error, noise as in noise.py. Source: method 3.12.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_lyapunov, solve_discrete_lyapunov

from vsensor_ros.designer.noise import (
    FAINTEST,
    given_or,
    lasts_of,
    noise_model,
    NoiseModel,
    riccati,
    riccati_in_steps,
)
from vsensor_ros.designer.observer import EQUATION_TOLERANCE, linearised
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.stability import lasting
from vsensor_ros.designer.subspaces import RANK_TOLERANCE
from vsensor_ros.observers import Tracking, VirtualSensor


def tracked(problem: Problem, sensor: VirtualSensor) -> VirtualSensor:
    """Add to a virtual sensor how its channels track it; none where they cannot, or need not."""
    if sensor.channel not in sensor.fault_set or not sensor.order:
        return sensor
    plant, noise = problem.plant, noise_model(problem)
    N, J = linearised(plant, sensor)
    channels, C, Q, Qu = _told(problem, sensor)
    rows = [plant.sensors.index(s) for s in channels]
    reading = noise.reading * problem.y0_size
    given = plant.noise[rows]
    own = given_or(given / problem.size_of(rows)) * problem.size_of(rows)
    W = growth(problem, noise, sensor.Phi, J)
    h, variance = lasts_of(problem, rows, noise.interval), reading**2 * noise.lasts
    meter = np.diag(own**2 * h) + (Q * variance) @ Q.T
    solved = _steady(N, C, W, meter, (J * variance) @ Q.T, sensor.sample_time,
                     np.linalg.norm(sensor.Phi * problem.scale, axis=1) * noise.usual)
    if solved is None:
        return sensor
    L, P = solved
    return replace(sensor, tracking=Tracking(
        channels, L, C, Q, Qu, P, W, float(np.sum((sensor.Q[0] * reading)**2)),
        bool(noise.assumed or np.isnan(given).any()), own,
        None if np.array_equal(N, sensor.N) else N))


def growth(problem: Problem, noise: NoiseModel, Phi: np.ndarray, J: np.ndarray) -> np.ndarray:
    """
    Return the rate of covariance (k, k) [1/s, or per step] of ``Phi x - z`` by noise.

    In the user's units: what moves the states, the noise of single readings, and, in continuous
    time, how far a reading that is moved may be from the straight line between two samples, of
    mean square ``q^2 h / 6`` and with what it does to z ``q^2 h^2 / 12`` a second.
    """
    plant, h = problem.plant, noise.lasts
    process, reading = noise.process * problem.scale, noise.reading * problem.y0_size
    moved = (J * reading) * np.sqrt(h)
    parts = [Phi * process, moved]
    if noise.sample_time is None:
        rows = [plant.sensors.index(s) for s in problem.healthy]
        parts.append((J * (h / np.sqrt(12.0))) @ (plant.C[rows] * process))
    both = np.hstack(parts)
    return np.asarray(both @ both.T)


def _told(problem: Problem, sensor: VirtualSensor,
          ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]:
    """Return the channels that z and y0 tell, the own one first, and C, Q, Qu of them."""
    plant, k = problem.plant, sensor.order
    rows = [plant.sensors.index(s) for s in problem.healthy]
    read = np.hstack([plant.C[rows] * problem.scale, plant.Cd[rows]]) / problem.y0_size[:, None]
    z = np.hstack([sensor.Phi * problem.scale, np.zeros((k, plant.Cd.shape[1]))])
    size = np.linalg.norm(z, axis=1)
    known = np.vstack([z / size[:, None], read])
    names, C, Q = [sensor.channel], [sensor.Cv[0]], [sensor.Q[0]]
    for name in sensor.fault_set:
        i = plant.sensors.index(name)
        row = np.hstack([plant.C[i] * problem.scale, plant.Cd[i]])
        if name == sensor.channel or not row.any():
            continue
        found = np.linalg.lstsq(known.T, row, rcond=RANK_TOLERANCE)[0]
        found[np.abs(found) < 1e-12 * np.abs(found).max()] = 0.0
        if np.linalg.norm(row - found @ known) <= EQUATION_TOLERANCE * np.linalg.norm(row):
            names.append(name)
            C.append(found[:k] / size)
            Q.append(found[k:] / problem.y0_size)
    failed = [plant.sensors.index(s) for s in names]
    return tuple(names), np.array(C), np.array(Q), plant.Cu[failed] - np.array(Q) @ plant.Cu[rows]


def _steady(N: np.ndarray, C: np.ndarray, W: np.ndarray, meter: np.ndarray, cross: np.ndarray,
            sample_time: float | None, usual: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Return the steady Kalman gain (k, f) and its covariance (k, k); None where none is stable.

    ``usual`` (k,): what drives z at the least, times FAINTEST, so that each mode is corrected.
    """
    size = usual
    unit = np.sqrt(np.diag(meter))
    A, E = N / size[:, None] * size, C / unit[:, None] * size
    drive = W / size / size[:, None] + FAINTEST**2 * np.eye(len(N))
    R, S = meter / unit / unit[:, None], cross / unit / size[:, None]
    R = R + FAINTEST**2 * np.eye(len(R))
    try:
        if sample_time is None:
            P = riccati(A, E, drive, R, S)
            L = np.linalg.solve(R, (P @ E.T + S).T).T
        else:
            P = riccati_in_steps(A, E, drive, R, S)
            L = np.linalg.solve(E @ P @ E.T + R, (A @ P @ E.T + S).T).T
        closed = A - L @ E
        if not np.isfinite(L).all() or lasting(closed, sample_time)[1].any():
            return None
        # of the gain as it is, so that rounding in it does not show
        driven = drive + L @ R @ L.T - L @ S.T - S @ L.T
        P = (solve_continuous_lyapunov(closed, -driven) if sample_time is None
             else solve_discrete_lyapunov(closed, driven))
    except (LinAlgError, ValueError):
        return None
    values, vectors = np.linalg.eigh(0.5 * (P + P.T))
    P = (vectors * np.maximum(values, 0.0)) @ vectors.T * size * size[:, None]
    return L * size[:, None] / unit, 0.5 * (P + P.T)
