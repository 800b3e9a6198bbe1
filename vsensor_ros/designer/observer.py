"""
From rows of Phi to a virtual sensor: close the loop, check every equation, judge stability.

A design of the papers feeds its own estimate back in place of the failed reading. The spectrum
that counts is therefore that of ``N = A_* + J_F Cv``, not that of A_* (method, section 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import matrix_balance

from vsensor_ros.designer.gain import peak
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.stability import lasting
from vsensor_ros.designer.subspaces import in_row_space, measured_part, RANK_TOLERANCE, solve_left
from vsensor_ros.functions.nonlinearity import set_valued, slope_at
from vsensor_ros.observers import VirtualSensor
from vsensor_ros.plant import Plant

EQUATION_TOLERANCE = 1e-9  # relative residual allowed in (E1) to (E4)
FAINT = 1e-10  # of its row: a gain on a reading that came of rounding


@dataclass(frozen=True, eq=False)
class Candidate:
    """A solution of the observer equations in the scaled coordinates of its problem."""

    Phi: np.ndarray  # (k, n)
    N: np.ndarray  # (k, k)
    J: np.ndarray  # (k, l0)
    Cv: np.ndarray  # (p, k)
    Q: np.ndarray  # (p, l0)


def close_loop(problem: Problem, Phi: np.ndarray) -> Candidate | None:
    """
    Solve (E1) and (E3) for given rows Phi (k, n); None when they have no solution.

    Where rows of Phi are measured the least N and J are taken.
    """
    known, k = np.vstack([Phi, problem.C0]), len(Phi)
    both = np.vstack([Phi @ problem.A, problem.V])
    if not in_row_space(known, both):
        return None
    NJ, CQ = np.split(solve_left(known, both), [k])
    return Candidate(Phi, NJ[:, :k], NJ[:, k:] @ problem.Y + Phi @ problem.F,
                     CQ[:, :k], CQ[:, k:] @ problem.Y + problem.Qv)


def knows_arguments(problem: Problem, Phi: np.ndarray) -> bool:
    """Tell whether (E4) holds: the argument of every term that acts on z is known."""
    known = np.vstack([Phi, problem.C0])
    return all(in_row_space(known, g)
               for g, acts in zip(problem.G, acting(problem, Phi)) if acts)


def acting(problem: Problem, Phi: np.ndarray) -> np.ndarray:
    """Tell for each nonlinear term whether it enters z = Phi x (q,)."""
    size = np.abs(Phi).max(initial=0.0)
    return np.abs(Phi @ problem.P).max(axis=0, initial=0.0) > 1e2 * RANK_TOLERANCE * size


def build(problem: Problem, candidate: Candidate, method: str,
          temporary: bool = False) -> VirtualSensor | None:
    """
    Turn a candidate into a virtual sensor in the user's coordinates.

    None when an equation fails on fresh arithmetic or the closed loop is not stable, which it need
    not be if it is to be ``temporary``.
    """
    plant = problem.plant
    candidate = _tidied(problem, candidate)
    eigenvalues, stays = lasting(candidate.N, plant.sample_time, problem.speed)
    if stays.any() and not temporary:
        return None
    acts = acting(problem, candidate.Phi)
    known, k = np.vstack([candidate.Phi, problem.C0]), len(candidate.Phi)

    Phi = candidate.Phi / problem.scale
    size = np.abs(Phi).max(axis=1, initial=0.0)
    if np.any(size == 0):
        return None
    Phi = Phi / size[:, None]
    N = candidate.N / size[:, None] * size
    J = candidate.J / size[:, None] / problem.y0_size
    Cv = problem.v_size[:, None] * candidate.Cv * size
    Q = problem.v_size[:, None] * candidate.Q / problem.y0_size

    rows = [plant.sensors.index(s) for s in problem.healthy]
    Cu = plant.Cu[rows]
    P = np.where(acts, Phi @ plant.P, 0.0)
    B = Phi @ plant.B - J @ Cu
    B = np.where(np.abs(B) < 1e-13 * (np.abs(Phi) @ np.abs(plant.B) + np.abs(J) @ np.abs(Cu)),
                 0.0, B)
    Gz, Gy = [], []
    for g, active in zip(plant.G, acts):
        split = np.zeros((len(g), len(known)))
        if active:
            split = _clean(solve_left(known, g * problem.scale))
        Gz.append(split[:, :k] * size)
        Gy.append(split[:, k:] @ problem.Y / problem.y0_size)

    # a first guess from what the sensors say of the states alone
    plain = np.logical_not(Cu.any(axis=1) | plant.Cd[rows].any(axis=1))
    C0 = plant.C[rows] * plain[:, None]
    to_states = np.linalg.pinv(C0 * problem.scale / problem.y0_size[:, None]) / problem.y0_size
    z0_gain = Phi @ (problem.scale[:, None] * to_states) * plain
    sensor = VirtualSensor(
        channel=problem.channel, fault_set=problem.fault_set, healthy=problem.healthy,
        inputs=plant.inputs, Phi=Phi, N=N, J=J, B=B, P=P, Cv=Cv, Q=Q,
        Gz=tuple(Gz), Gy=tuple(Gy), terms=plant.terms, sample_time=plant.sample_time,
        z0=Phi @ plant.initial - z0_gain @ (C0 @ plant.initial), z0_gain=z0_gain,
        eigenvalues=eigenvalues[np.lexsort([eigenvalues.imag, eigenvalues.real])],
        noise_gain=np.inf if temporary else peak(N, J, Cv, Q, plant.sample_time)[0],
        method=method, grade='temporary' if temporary else 'exact',
        Qu=problem.wanted[1] - Q @ Cu, Gu=tuple(-gy @ Cu for gy in Gy))
    if max(equation_residuals(problem, sensor).values()) > EQUATION_TOLERANCE:
        return None
    passes = leaves_one_branch if temporary else partial(stable_with_terms, plant)
    return sensor if passes(sensor) else None


def polished(problem: Problem, candidate: Candidate) -> Candidate:
    """Solve (E1) and (E3) once more to full precision where Phi alone decides them."""
    size = np.linalg.norm(candidate.Phi, axis=1)
    if not len(size) or np.any(size == 0) or len(measured_part(candidate.Phi, problem.C0)):
        return candidate
    Phi = candidate.Phi / size[:, None]
    known, k = np.vstack([Phi, problem.C0]), len(Phi)
    NJ, CQ = (np.linalg.lstsq(known.T, R.T, rcond=None)[0].T
              for R in (Phi @ problem.A, problem.V))
    return Candidate(Phi, NJ[:, :k], NJ[:, k:] @ problem.Y + Phi @ problem.F,
                     CQ[:, :k], CQ[:, k:] @ problem.Y + problem.Qv)


def _tidied(problem: Problem, candidate: Candidate) -> Candidate:
    """Scale the rows of Phi to length one and set rounding to zero, so that structure shows."""
    size = np.linalg.norm(candidate.Phi, axis=1)
    size = np.where(size > 0, size, 1.0)
    k = len(size)
    N, J = candidate.N / size[:, None] * size, candidate.J / size[:, None]
    # a part of Phi A, and judged against that, and against how fast its own row goes
    own = np.hstack([N - problem.still * np.eye(k), J])
    least = np.maximum(1e-13 * problem.speed, FAINT * np.abs(own).max(axis=1, initial=0.0))
    CQ = _clean(np.hstack([candidate.Cv * size, candidate.Q]))
    Q = np.where(np.abs(CQ[:, k:]) < FAINT * np.abs(CQ).max(axis=1, keepdims=True, initial=0.0),
                 0.0, CQ[:, k:])
    return Candidate(_clean(candidate.Phi / size[:, None]), N,
                     np.where(np.abs(J) < least[:, None], 0.0, J), CQ[:, :k], Q)


def stable_with_terms(plant: Plant, sensor: VirtualSensor) -> bool:
    """
    Tell whether nothing in the nonlinear terms speaks against stability at the operating point.

    Their slopes there are added to N. A certificate is more: see certificate.py.
    """
    if not sensor.active:
        return True  # judged already, in scaled coordinates
    if not leaves_one_branch(sensor):
        return False
    N = matrix_balance(linearised(plant, sensor)[0], permute=False)[0]
    return not lasting(N, sensor.sample_time)[1].any()


def leaves_one_branch(sensor: VirtualSensor) -> bool:
    """
    Tell whether each sign pushes its own argument towards zero in continuous time.

    Dry friction does. Otherwise the observer has two stable branches (the method, erratum 1,
    k7 = +1).
    """
    return sensor.sample_time is not None or not any(
        set_valued(sensor.terms[i]) and float(sensor.Gz[i][0] @ sensor.P[:, i]) > 0
        for i in sensor.active)


def linearised(plant: Plant, sensor: VirtualSensor, x: np.ndarray | None = None,
               u: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """
    Return N (k, k) and J (k, l0) with the terms' slopes at a point, by default the operating one.

    In continuous time a sign is left out: its slope is 0 or infinite.
    """
    N, J = sensor.N, sensor.J
    x, u = plant.operating_point if x is None else x, plant.operating_input if u is None else u
    for i in sensor.active:
        term = sensor.terms[i]
        if set_valued(term) and sensor.sample_time is None:
            continue
        slope = slope_at(term, plant.G[i] @ x, plant.inputs, u) - term.slope
        N = N + np.outer(sensor.P[:, i], slope @ sensor.Gz[i])
        J = J + np.outer(sensor.P[:, i], slope @ sensor.Gy[i])
    return N, J


def equation_residuals(problem: Problem, sensor: VirtualSensor) -> dict[str, float]:
    """
    Return the relative residuals of (E1) to (E4), from the plant's own matrices.

    Each row is measured in the scaled states against the data it is made of: |phi| |A|, |phi|
    and |J| (D with Cd and P have columns of length one), |V| and |G|.
    """
    plant, Phi = problem.plant, sensor.Phi
    rows = [plant.sensors.index(s) for s in problem.healthy]
    C0, Cd = plant.C[rows], plant.Cd[rows]
    V, _, Vd = problem.wanted

    def length(rows: np.ndarray) -> np.ndarray:
        return np.linalg.norm(rows * problem.scale, axis=1)

    def relative(residual: np.ndarray, size: np.ndarray) -> float:
        return float((np.linalg.norm(residual, axis=1) / np.maximum(size, 1e-300)).max(
            initial=0.0))

    n, J = len(plant.A), sensor.J * problem.y0_size
    D = np.vstack([plant.D / problem.scale[:, None], Cd / problem.y0_size[:, None]])
    D = D / np.maximum(np.linalg.norm(D, axis=0), 1e-300)
    Vd = Vd / np.maximum(np.linalg.norm(np.vstack([Vd, Cd]), axis=0), 1e-300)
    speed = max(float(np.linalg.norm(plant.A / problem.scale[:, None] * problem.scale, 2)),
                1e-300)
    unit_Cd = Cd / np.maximum(np.linalg.norm(np.vstack([problem.wanted[2], Cd]), axis=0), 1e-300)
    return {
        'E1': relative((Phi @ plant.A - sensor.N @ Phi - sensor.J @ C0) * problem.scale,
                       length(Phi) * speed),
        'E2': relative((Phi * problem.scale) @ D[:n] - J @ D[n:],
                       length(Phi) + np.linalg.norm(J, axis=1)),
        'E3': max(relative((V - sensor.Cv @ Phi - sensor.Q @ C0) * problem.scale,
                           np.where(V.any(axis=1), length(V), length(sensor.Q @ C0))),
                  relative(Vd - sensor.Q @ unit_Cd, 1.0 + np.linalg.norm(sensor.Q, axis=1))),
        'E4': max((relative((plant.G[i] - sensor.Gz[i] @ Phi - sensor.Gy[i] @ C0)
                            * problem.scale, length(plant.G[i]))
                   for i in sensor.active), default=0.0),
    }


def _clean(M: np.ndarray) -> np.ndarray:
    """Set to zero what is rounding in its row, so that structure shows."""
    return np.where(np.abs(M) < 1e-12 * np.abs(M).max(axis=-1, keepdims=True, initial=0.0),
                    0.0, M)
