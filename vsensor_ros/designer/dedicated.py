"""
Dedicated filters: observers that are there for their residual only.

A filter reads all sensors but some, and is blind to the unknown inputs. It is the Kalman filter on
the quotient that the noise floor stands on, and puts out that combination of its innovations in
which faults of all that it is to tell stand out most, in standard deviations. Source: method 3.13.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
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


@dataclass(frozen=True, eq=False)
class Innovations:
    """The steady Kalman filter that does not read some sensors, and what it does not expect."""

    found: Checks
    noise: NoiseModel
    L: np.ndarray  # (r, c) its gain
    spread: np.ndarray  # (c, c) covariance of the innovations of single readings

    def sharpness(self, wanted: Mapping[str, str]) -> dict[str, float]:
        """Return by how many standard deviations a fault of 1 shows at best, by sensor."""
        white = _white(self.spread)
        return dict(zip(wanted, np.linalg.norm(white.T @ _seen(self, wanted), axis=0).tolist()))


def innovations(plant: Plant, others: tuple[str, ...]) -> Innovations | None:
    """Return the filter that reads all but ``others``; None where there is no steady one."""
    found = checks(blind_to(plant, others))
    noise = noise_model(found.problem)
    steady = kalman(found.slopes, noise)
    spread = None if steady is None else _spread(found, noise, steady.L)
    return None if steady is None or spread is None else Innovations(
        found, noise, steady.L, spread)


def dedicated(of: Innovations, wanted: Mapping[str, str]) -> tuple[VirtualSensor, ...]:
    """
    Return filters whose outputs show faults of wanted sensors, of those it may read.

    ``wanted``: how the faults are to show, by sensor: 'strong' or 'weak'. One filter where one
    residual shows all; each has noise of standard deviation 1. Empty where none passes its checks.
    """
    others = of.found.problem.fault_set
    name = f'without {", ".join(others)}' if others else 'of all'
    filters: list[VirtualSensor] = []
    for i, row in enumerate(_rows(_seen(of, wanted), _white(of.spread))):
        made = _built(of, row, name if i == 0 else f'{name} ({i + 1})')
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


def _white(spread: np.ndarray) -> np.ndarray:
    """Return columns that make of the innovations uncorrelated ones of deviation 1 (c, c)."""
    values, vectors = np.linalg.eigh(spread)
    least = 1e-12 * max(values.max(initial=0.0), np.finfo(float).tiny)
    return np.asarray(vectors / np.sqrt(np.maximum(values, least)))


def _seen(of: Innovations, wanted: Mapping[str, str]) -> np.ndarray:
    """
    Return what a fault of 1 makes of the innovations (c, w): in the end, or while it is new.

    New: over the plant's mean time constant, where nothing is left in the end.
    """
    found, known, problem = of.found, of.found.slopes, of.found.problem
    rate, h = couplings(problem.plant).mean_rate, problem.plant.sample_time
    new = rate if h is None else np.exp(rate * h)
    N = known.A - of.L @ known.E
    columns = [np.zeros((len(known.R), 0))]
    for sensor, how in wanted.items():
        j = found.problem.healthy.index(sensor)
        s = problem.still if how == STRONG else new
        moved = np.linalg.solve(s * np.eye(known.order) - N,
                                known.J[:, [j]] + of.L @ known.R[:, [j]])
        columns.append((known.R[:, [j]] - known.E @ moved) / problem.y0_size[j])
    return np.hstack(columns)


def _rows(faults: np.ndarray, white: np.ndarray) -> list[np.ndarray]:
    """Return combinations (c,) of innovations of deviation 1 that show all faults (c, w)."""
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


def _built(of: Innovations, row: np.ndarray, name: str) -> VirtualSensor | None:
    """Build the filter whose output ``row (R y0 - E xi)`` is an estimate of nothing."""
    problem = replace(of.found.problem, channel=name)
    known = replace(of.found.known, v=np.zeros((1, of.found.known.order)),
                    q=np.zeros((1, len(problem.healthy))))
    candidate = filter_candidate(
        known, Filter(of.L, -row[None, :] @ known.E, row[None, :], np.nan), of.found.arguments)
    made = build(problem, candidate, 'dedicated filter')
    if made is None:
        return None
    return replace(started(problem, made), noise=Noise(1.0, 1.0, of.noise.assumed),
                   certificate=certify(problem.plant, made))
