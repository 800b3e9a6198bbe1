"""
Virtual sensors of which a mode stays: they serve for a time after their channel was lost.

All that healthy sensors can correct they correct; the rest keeps its modes and starts from the
last good readings. Source: method 3.12.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vsensor_ros.designer import invariant_spaces
from vsensor_ros.designer.driven import driven
from vsensor_ros.designer.existence import forced_closure, measured_signs
from vsensor_ros.designer.natural_size import RELATIVE
from vsensor_ros.designer.noise import (
    FAINTEST,
    Filter,
    mean_rate,
    noise_model,
    NoiseModel,
    riccati,
    riccati_in_steps,
)
from vsensor_ros.designer.observer import acting, build, Candidate
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.quotient import argument, Quotient, quotient
from vsensor_ros.designer.stability import lasting
from vsensor_ros.designer.start import started
from vsensor_ros.designer.subspaces import complement, in_row_space, left_kernel, unobservable
from vsensor_ros.designer.tracking import tracked
from vsensor_ros.observers import deviation_after, VirtualSensor

FAR = 1e4  # times its noise is what a failed channel counts with in the filter
TIMES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # of the plant's mean time constant, at which to judge
QUIET = 2.0  # the least order is taken that deviates within this factor of the best
MOST_SPACES = 4
LITTLE = 4  # states: more are worth a search for what drives the modes that stay
LARGEST_FILTER = 60  # states, up to which the filter is tried besides


def temporary(problem: Problem) -> VirtualSensor | None:
    """
    Return a virtual sensor of a sensor's channel that need not be stable, with its tracking.

    None where (E1) to (E4) cannot be met, or its channels do not tell what stays.
    """
    if problem.channel not in problem.fault_set or problem.reads_unknown:
        return None
    signs = measured_signs(problem)
    for avoid in (signs, frozenset[int]()) if signs else (signs,):
        found = _least(problem, avoid)
        if found is not None:
            return found
    return None


def _least(problem: Problem, avoid: frozenset[int]) -> VirtualSensor | None:
    """Return the least order that deviates little more than the best, decoupled from terms."""
    Phi = complement(forced_closure(problem, avoid)[1])
    if not in_row_space(np.vstack([Phi, problem.C0]), problem.V):
        return None
    known, terms = quotient(problem, Phi), _arguments(problem, Phi)
    if terms is None:
        return None
    sensors = [s for candidate, method in _candidates(problem, known, terms)
               if (s := _judgeable(problem, candidate, method)) is not None]
    if not sensors:
        return None
    staying = [int(lasting(s.N, s.sample_time)[1].sum()) for s in sensors]
    sensors = [s for s, count in zip(sensors, staying) if count == min(staying)]
    after = np.array([deviation_after(s, np.array(TIMES) / mean_rate(problem)) for s in sensors])
    least = after.min(axis=0)  # which may be 0, or beyond numbers
    worst = np.where(after == least, 1.0, after / least).max(axis=1)
    return min((s for s, ratio in zip(sensors, worst) if ratio <= QUIET * worst.min()),
               key=lambda s: (s.order, len(s.reads)))


def _judgeable(problem: Problem, candidate: Candidate, method: str) -> VirtualSensor | None:
    sensor = build(problem, candidate, method, temporary=True)
    if sensor is None:
        return None
    sensor = tracked(problem, started(problem, sensor))
    return None if sensor.tracking is None else sensor


def _arguments(problem: Problem, Phi: np.ndarray) -> np.ndarray | None:
    """Return the arguments (s, r) of the terms that act, in the quotient's rows; None: hidden."""
    rows = [argument(problem, Phi, g)
            for g, acts in zip(problem.G, acting(problem, Phi)) if acts]
    told = [row for row in rows if row is not None]
    return np.vstack([np.zeros((0, len(Phi))), *told]) if len(told) == len(rows) else None


def _candidates(problem: Problem, known: Quotient,
                terms: np.ndarray) -> Iterator[tuple[Candidate, str]]:
    """Yield observers on small spaces as they are, and the filter less what it does not need."""
    rows = np.vstack([known.v, terms])
    spaces = [space for _, space in zip(range(MOST_SPACES), invariant_spaces.spaces(known, rows))]
    for space in spaces:
        yield invariant_spaces.plain_candidate(known, space), 'closed subspace'
    if not spaces or len(spaces[0].W) > LITTLE:
        behind = driven(problem, known)
        if behind is not None:
            yield behind, 'behind what drives it'
    if known.order <= LARGEST_FILTER or not spaces:
        filter_ = _filter(problem, known, terms)
        if filter_ is not None:
            yield filter_, 'filter'


def _filter(problem: Problem, known: Quotient, terms: np.ndarray) -> Candidate | None:
    """
    Return the Kalman filter on the healthy readings, and nearly nothing of the failed ones.

    These see what the healthy ones do not, so that there is a filter at all; then they are left
    out. What neither v nor a term needs is no part of it.
    """
    noise = noise_model(problem)
    hidden = unobservable(known.A, np.vstack([known.E, known.v, terms]))
    if hidden.shape[1]:
        W = left_kernel(hidden)
        known = replace(known, Phi=W @ known.Phi, A=W @ known.A @ W.T, J=W @ known.J,
                        E=known.E @ W.T, v=known.v @ W.T)
        terms = terms @ W.T
    B, D = noise.drives(known)
    E, meter, cross = _with_failed(problem, known, noise, D @ D.T, B @ D.T)
    drive = B @ B.T
    drive = drive + FAINTEST**2 * max(np.trace(drive) / len(drive), noise.usual**2) \
        * np.eye(len(drive))
    try:
        if noise.sample_time is None:
            X = riccati(known.A, E, drive, meter, cross)
            L = np.linalg.solve(meter, (X @ E.T + cross).T).T
        else:
            X = riccati_in_steps(known.A, E, drive, meter, cross)
            L = np.linalg.solve(E @ X @ E.T + meter, (known.A @ X @ E.T + cross).T).T
    except (np.linalg.LinAlgError, ValueError):
        return None
    own = Filter(L[:, :len(known.E)], known.v, np.zeros((1, len(known.E))), np.inf)
    return invariant_spaces.filter_candidate(known, own, terms) if np.isfinite(L).all() else None


def _with_failed(problem: Problem, known: Quotient, noise: NoiseModel, meter: np.ndarray,
                 cross: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add to E (c, r), the readings' noise and its cross terms what failed channels would say."""
    plant, sensors = problem.plant, problem.plant.sensors
    rows = [known.v]
    for i in (sensors.index(s) for s in problem.fault_set if s != problem.channel):
        row = plant.C[i:i + 1] * problem.scale
        size = np.linalg.norm(row)
        told = argument(problem, known.Phi, row / size) if size and not plant.Cd[i].any() else None
        rows += [] if told is None else [told]
    E = np.vstack(rows)
    far = np.eye(len(E)) * (FAR * RELATIVE)**2 * noise.interval
    meter = meter + FAINTEST**2 * np.trace(meter) * np.eye(len(meter))
    none = np.zeros((len(meter), len(E)))
    return (np.vstack([known.E, E]), np.block([[meter, none], [none.T, far]]),
            np.hstack([cross, np.zeros((len(cross), len(E)))]))
