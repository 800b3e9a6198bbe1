"""
From rows of Phi to a virtual sensor: close the loop, check every equation, judge stability.

A design of the papers feeds its own estimate back in place of the failed reading. The spectrum
that counts is therefore that of ``N = A_* + J_F Cv``, not that of A_* (method, section 2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.stability import lasting
from vsensor_ros.designer.subspaces import in_row_space, measured_part, RANK_TOLERANCE, solve_left
from vsensor_ros.nonlinearity import set_valued, slope_at
from vsensor_ros.plant import Plant
from vsensor_ros.virtual_sensor import VirtualSensor

EQUATION_TOLERANCE = 1e-9  # relative residual allowed in (E1) to (E4)
FREQUENCIES = 200  # grid points for the noise gain


@dataclass(frozen=True, eq=False)
class Candidate:
    """A solution of the observer equations in the scaled coordinates of its problem."""

    Phi: np.ndarray  # (k, n)
    N: np.ndarray  # (k, k)
    J: np.ndarray  # (k, l0)
    Cv: np.ndarray  # (1, k)
    Q: np.ndarray  # (1, l0)


def close_loop(problem: Problem, Phi: np.ndarray) -> Candidate | None:
    """
    Solve (E1) and (E3) for given rows Phi (k, n); None when they have no solution.

    Where rows of Phi are measured the least N and J are taken.
    """
    known = np.vstack([Phi, problem.C0])
    if not in_row_space(known, np.vstack([Phi @ problem.A, problem.V])):
        return None
    k = len(Phi)
    NJ, CQ = solve_left(known, Phi @ problem.A), solve_left(known, problem.V)
    return Candidate(Phi, NJ[:, :k], NJ[:, k:], CQ[:, :k], CQ[:, k:])


def knows_arguments(problem: Problem, Phi: np.ndarray) -> bool:
    """Tell whether (E4) holds: the argument of every term that acts on z is known."""
    known = np.vstack([Phi, problem.C0])
    return all(in_row_space(known, g)
               for g, acts in zip(problem.G, acting(problem, Phi)) if acts)


def acting(problem: Problem, Phi: np.ndarray) -> np.ndarray:
    """Tell for each nonlinear term whether it enters z = Phi x (q,)."""
    size = np.abs(Phi).max(initial=0.0)
    return np.abs(Phi @ problem.P).max(axis=0, initial=0.0) > 1e2 * RANK_TOLERANCE * size


def decay(eigenvalues: np.ndarray, sample_time: float | None) -> float:
    """Slowest rate [1/s] at which a linear error with these eigenvalues dies out."""
    if len(eigenvalues) == 0:
        return np.inf
    if sample_time is None:
        return float(-eigenvalues.real.max())
    return float(-np.log(max(np.abs(eigenvalues).max(), 1e-12)) / sample_time)


def build(problem: Problem, candidate: Candidate, method: str) -> VirtualSensor | None:
    """
    Turn a candidate into a virtual sensor in the user's coordinates.

    None when an equation fails on fresh arithmetic or the closed loop is not stable.
    """
    plant = problem.plant
    candidate = _tidied(problem, _polished(problem, candidate))
    eigenvalues, stays = lasting(candidate.N, plant.sample_time, problem.speed)
    if stays.any():
        return None
    Phi_scaled = candidate.Phi
    acts = acting(problem, Phi_scaled)
    known = np.vstack([Phi_scaled, problem.C0])
    k = len(Phi_scaled)

    Phi = Phi_scaled / problem.scale
    size = np.abs(Phi).max(axis=1, initial=0.0)
    if np.any(size == 0):
        return None
    Phi = Phi / size[:, None]
    N = candidate.N / size[:, None] * size
    J = candidate.J / size[:, None] / problem.y0_size
    Cv = problem.v_size * candidate.Cv * size
    Q = problem.v_size * candidate.Q / problem.y0_size

    P = np.where(acts, Phi @ plant.P, 0.0)
    B = Phi @ plant.B
    B = np.where(np.abs(B) < 1e-13 * (np.abs(Phi) @ np.abs(plant.B)), 0.0, B)
    Gz, Gy = [], []
    for g, active in zip(plant.G, acts):
        split = np.zeros((len(g), len(known)))
        if active:
            split = _clean(solve_left(known, g * problem.scale))
        Gz.append(split[:, :k] * size)
        Gy.append(split[:, k:] / problem.y0_size)

    to_states = np.linalg.pinv(problem.C0) / problem.y0_size
    z0_gain = Phi @ (problem.scale[:, None] * to_states)
    C0 = plant.C[[plant.sensors.index(s) for s in problem.healthy]]
    z0 = Phi @ plant.initial - z0_gain @ (C0 @ plant.initial)

    sensor = VirtualSensor(
        channel=problem.channel, fault_set=problem.fault_set, healthy=problem.healthy,
        inputs=plant.inputs, Phi=Phi, N=N, J=J, B=B, P=P, Cv=Cv, Q=Q,
        Gz=tuple(Gz), Gy=tuple(Gy), terms=plant.terms, sample_time=plant.sample_time, z0=z0,
        z0_gain=z0_gain, eigenvalues=eigenvalues[np.argsort(eigenvalues.real, kind='stable')],
        noise_gain=noise_gain(N, J, Cv, Q, plant.sample_time), method=method)
    if max(equation_residuals(problem, sensor).values()) > EQUATION_TOLERANCE:
        return None
    return sensor if stable_with_terms(plant, sensor) else None


def with_healthy(sensor: VirtualSensor, healthy: tuple[str, ...]) -> VirtualSensor:
    """Let the columns of J, Q and Gy stand for more sensors, which are not read."""
    columns = [healthy.index(name) for name in sensor.healthy]

    def widened(M: np.ndarray) -> np.ndarray:
        wide = np.zeros((len(M), len(healthy)))
        wide[:, columns] = M
        return wide

    return replace(sensor, healthy=healthy, J=widened(sensor.J), Q=widened(sensor.Q),
                   Gy=tuple(widened(g) for g in sensor.Gy), z0_gain=widened(sensor.z0_gain))


def _polished(problem: Problem, candidate: Candidate) -> Candidate:
    """Solve (E1) and (E3) once more to full precision where Phi alone decides them."""
    size = np.linalg.norm(candidate.Phi, axis=1)
    if not len(size) or np.any(size == 0) or len(measured_part(candidate.Phi, problem.C0)):
        return candidate
    Phi = candidate.Phi / size[:, None]
    known, k = np.vstack([Phi, problem.C0]), len(Phi)
    NJ, CQ = (np.linalg.lstsq(known.T, R.T, rcond=None)[0].T
              for R in (Phi @ problem.A, problem.V))
    return Candidate(Phi, NJ[:, :k], NJ[:, k:], CQ[:, :k], CQ[:, k:])


def _tidied(problem: Problem, candidate: Candidate) -> Candidate:
    """Scale the rows of Phi to length one and set rounding to zero, so that structure shows."""
    size = np.linalg.norm(candidate.Phi, axis=1)
    size = np.where(size > 0, size, 1.0)
    k = len(size)
    J = candidate.J / size[:, None]  # a part of Phi A, and judged against it
    CQ = _clean(np.hstack([candidate.Cv * size, candidate.Q]))
    return Candidate(
        _clean(candidate.Phi / size[:, None]), candidate.N / size[:, None] * size,
        np.where(np.abs(J) < 1e-13 * problem.speed, 0.0, J),
        CQ[:, :k], CQ[:, k:])


def stable_with_terms(plant: Plant, sensor: VirtualSensor) -> bool:
    """
    Tell whether nothing in the nonlinear terms speaks against stability at the operating point.

    Their slopes there are added to N; and in continuous time a sign must push its own argument
    towards zero, as dry friction does: otherwise the observer has two stable branches (the
    method, erratum 1, k7 = +1). No certificate: that is not in this generation.
    """
    N = sensor.N
    for i in sensor.active:
        term, gz = sensor.terms[i], sensor.Gz[i]
        if set_valued(term) and sensor.sample_time is None:
            if float(gz[0] @ sensor.P[:, i]) > 0:
                return False
            continue
        slope = slope_at(term, plant.G[i] @ plant.operating_point, plant.inputs,
                         plant.operating_input) - term.slope
        N = N + np.outer(sensor.P[:, i], slope @ gz)
    return not lasting(N, sensor.sample_time)[1].any()


def equation_residuals(problem: Problem, sensor: VirtualSensor) -> dict[str, float]:
    """
    Return the relative residuals of (E1) to (E4), from the plant's own matrices.

    Each row is measured in the scaled states against the data it is made of: |phi| |A|, |phi|
    (D and P have columns of length one), |V| and |G|.
    """
    plant, Phi = problem.plant, sensor.Phi
    C0 = plant.C[[plant.sensors.index(s) for s in problem.healthy]]
    V = plant.C[[plant.sensors.index(problem.channel)]]

    def relative(residual: np.ndarray, size: np.ndarray | float) -> float:
        return float((np.linalg.norm(residual, axis=1) / size).max(initial=0.0))

    def length(rows: np.ndarray) -> np.ndarray:
        return np.linalg.norm(rows * problem.scale, axis=1)

    return {
        'E1': relative((Phi @ plant.A - sensor.N @ Phi - sensor.J @ C0) * problem.scale,
                       length(Phi) * max(problem.speed, 1e-300)),
        'E2': relative((Phi * problem.scale) @ problem.D, length(Phi)),
        'E3': relative((V - sensor.Cv @ Phi - sensor.Q @ C0) * problem.scale,
                       max(float(length(V)[0]), 1e-300)),
        'E4': max((relative((plant.G[i] - sensor.Gz[i] @ Phi - sensor.Gy[i] @ C0)
                            * problem.scale, np.maximum(length(plant.G[i]), 1e-300))
                   for i in sensor.active), default=0.0),
    }


def noise_gain(N: np.ndarray, J: np.ndarray, Cv: np.ndarray, Q: np.ndarray,
               sample_time: float | None) -> float:
    """
    Return the peak over frequency of |Cv (s - N)^-1 J + Q|.

    By this factor at most is an error of the readings handed on, at any frequency; taken on a
    grid that holds zero, infinity and the frequencies of the poles.
    """
    if Q.shape[1] == 0:
        return 0.0
    if len(N) == 0:
        return float(np.linalg.norm(Q))
    poles = np.linalg.eigvals(N)
    if sample_time is None:
        corner = np.abs(poles[np.abs(poles) > 0])
        low, high = (corner.min(), corner.max()) if corner.size else (1.0, 1.0)
        grid = np.concatenate([[0.0], np.geomspace(low / 30, high * 30, FREQUENCIES), corner])
        s, feedthrough = 1j * grid, float(np.linalg.norm(Q))
    else:
        angles = np.concatenate([np.linspace(0.0, np.pi, FREQUENCIES), np.abs(np.angle(poles)),
                                 np.geomspace(1e-6, np.pi, FREQUENCIES)])
        s, feedthrough = np.exp(1j * angles), 0.0
    transfer = Cv @ np.linalg.solve(
        s[:, None, None] * np.eye(len(N)) - N, np.broadcast_to(J, (len(s), *J.shape))) + Q
    return float(max(feedthrough, np.linalg.norm(transfer[:, 0], axis=1).max()))


def _clean(M: np.ndarray) -> np.ndarray:
    """Set to zero what is rounding in its row, so that structure shows."""
    return np.where(np.abs(M) < 1e-12 * np.abs(M).max(axis=-1, keepdims=True, initial=0.0),
                    0.0, M)
