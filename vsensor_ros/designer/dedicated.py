"""
Dedicated filters: observers that are there for their residual only.

A filter reads all sensors but some, and is blind to the unknown inputs. It is the Kalman filter on
the quotient that the noise floor stands on, and puts out that combination of its innovations in
which faults of all that it is to tell stand out most, in standard deviations. Source: method 3.13.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

from vsensor_ros.designer.certificate import certify
from vsensor_ros.designer.invariant_spaces import filter_candidate
from vsensor_ros.designer.isolability import blind_to, Checks, checks
from vsensor_ros.designer.natural_size import couplings
from vsensor_ros.designer.noise import Filter, kalman, noise_model, NoiseModel
from vsensor_ros.designer.observer import build
from vsensor_ros.designer.start import started
from vsensor_ros.observers import Noise, STRONG, VirtualSensor
from vsensor_ros.plant import Plant

APART = 0.2  # of what the best combination for one fault makes of it: enough in a common one
MOST_SIGNS = 8  # faults of which all signs are tried


def dedicated(plant: Plant, others: tuple[str, ...],
              wanted: Mapping[str, str]) -> tuple[VirtualSensor, ...]:
    """
    Return filters that do not read ``others``, whose outputs show faults of wanted sensors.

    ``wanted``: how the faults are to show, by sensor: 'strong' or 'weak'. One filter where one
    residual shows all; each has noise of standard deviation 1. Empty where none passes its checks.
    """
    found = checks(blind_to(plant, others))
    noise = noise_model(found.problem)
    steady = kalman(found.slopes, noise)
    if steady is None:
        return ()
    spread = _spread(found, noise, steady.L)
    if spread is None:
        return ()
    faults = _seen(found, steady.L, wanted) @ np.diag(
        noise.reading[[found.problem.healthy.index(s) for s in wanted]])
    name = f'without {", ".join(others)}' if others else 'of all'
    filters: list[VirtualSensor] = []
    for i, row in enumerate(_rows(faults, spread)):
        made = _built(found, noise, steady.L, row, name if i == 0 else f'{name} ({i + 1})')
        filters += [] if made is None else [made]
    return tuple(filters)


def _spread(found: Checks, noise: NoiseModel, L: np.ndarray) -> np.ndarray | None:
    """Return the covariance (c, c) of the innovations of single readings."""
    known = found.slopes
    direct = known.R * noise.reading
    S = direct @ direct.T
    if known.order:
        B, D = noise.drives(known)
        N, drive = known.A - L @ known.E, B - L @ D
        try:
            P = (solve_continuous_lyapunov(N, -drive @ drive.T) if noise.sample_time is None
                 else solve_discrete_lyapunov(N, drive @ drive.T))
        except (np.linalg.LinAlgError, ValueError):
            return None
        S = S + known.E @ P @ known.E.T
    return S if np.isfinite(S).all() else None


def _seen(found: Checks, L: np.ndarray, wanted: Mapping[str, str]) -> np.ndarray:
    """
    Return what faults of one make of the innovations (c, w): in the end, or while they are new.

    New: over the plant's mean time constant, where nothing is left in the end.
    """
    known, h = found.slopes, found.problem.plant.sample_time
    rate = couplings(found.problem.plant).mean_rate
    still = found.problem.still
    new = rate if h is None else np.exp(rate * h)
    columns = []
    for sensor, how in wanted.items():
        j = found.problem.healthy.index(sensor)
        s = still if how == STRONG else new
        drive = known.J[:, j] + L @ known.R[:, j]
        N = known.A - L @ known.E
        columns.append(known.R[:, j] - known.E @ np.linalg.solve(
            s * np.eye(known.order) - N, drive))
    return np.stack(columns, axis=1)


def _rows(faults: np.ndarray, spread: np.ndarray) -> list[np.ndarray]:
    """Return combinations (c,) of innovations of deviation 1 that show all faults (c, w)."""
    values, vectors = np.linalg.eigh(spread)
    values = np.maximum(values, 1e-12 * max(values.max(initial=0.0), np.finfo(float).tiny))
    white = vectors / np.sqrt(values)  # q = white p has deviation |p|
    u = white.T @ faults
    u = u / np.maximum(np.linalg.norm(u, axis=0), np.finfo(float).tiny)
    rows = []
    while u.shape[1]:
        p = max(_mixed(u), key=lambda p: float(np.abs(p @ u).min()))
        told = np.abs(p @ u) >= APART
        if not told.any():
            p, told[0] = u[:, 0], True
        rows.append(white @ p)
        u = u[:, ~told]
    return rows


def _mixed(u: np.ndarray) -> list[np.ndarray]:
    """Return unit vectors (c,) that may be near to all unit columns of u at once."""
    count = u.shape[1]
    signs = (np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=count - 1)])
             if count <= MOST_SIGNS else np.ones((1, count)))
    mixed = [*(u @ s for s in signs), *(np.linalg.pinv(u.T) @ s for s in signs), *u.T]
    return [p / size for p in mixed if (size := np.linalg.norm(p)) > 1e-9]


def _built(found: Checks, noise: NoiseModel, L: np.ndarray, row: np.ndarray,
           name: str) -> VirtualSensor | None:
    """Build the filter whose output ``row (R y0 - E xi)`` is an estimate of nothing."""
    problem, l0 = replace(found.problem, channel=name), len(found.problem.healthy)
    known = replace(found.known, v=np.zeros((1, found.known.order)), q=np.zeros((1, l0)))
    candidate = filter_candidate(
        known, Filter(L, -row[None, :] @ known.E, row[None, :], np.nan), found.arguments)
    made = build(problem, candidate, 'dedicated filter')
    if made is None:
        return None
    return replace(started(problem, made), noise=Noise(1.0, 1.0, noise.assumed),
                   certificate=certify(problem.plant, made))
