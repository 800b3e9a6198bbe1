"""
Quadratic forms of an error system: whether one falls, and what a falling one proves.

A form is believed only after it has been put into the inequalities in plain floating point, with
a margin for rounding; what a solver says of itself counts for nothing (the method, 3.5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from vsensor_ros.designer.error_system import contraction, ErrorSystem, Slopes

ROUNDING = 1e-12  # relative, of the matrices of the error
EQUALITY = 1e-9  # relative, to which S p = -t g' must hold where a slope has no upper bound


@dataclass(frozen=True, eq=False)
class Form:
    """A quadratic form that was checked: V falls at twice the rate."""

    L: np.ndarray  # V = |L' e|^2
    rate: float  # 1/s
    bound: float


def falling_rate(error: ErrorSystem, L: np.ndarray, t: np.ndarray | None = None) -> float:
    """
    Return the rate [1/s] at which V = |L' e|^2 is certain to fall, or -inf.

    Slopes that are known to come together are judged in cells of their box. Else, up to
    MOST_CORNERS bounded slopes, every corner of their box is tried. More slopes are judged
    by the S-procedure with multipliers t (chosen here when None). A slope s that rises without
    bound needs S p = -t g' with t >= 0; it then makes the form fall by a further 2 t s (g e)^2.
    S solves that equation only up to rounding, for which a margin is kept; so is one for the
    rounding of the product L' N L'^-1, computed from the moduli of its factors.
    """
    if not np.all(np.isfinite(L)) or np.any(np.diag(L) == 0) or error.loose.feeding.radius.size:
        return -np.inf

    def turned(M: np.ndarray) -> np.ndarray:  # L' M L'^-1
        return solve_triangular(L, (L.T @ M).T, lower=True).T

    rising, fed = error.rising.feeding, error.bounded.feeding
    margin = ROUNDING
    if rising.radius.size:
        Sp, g = L @ (L.T @ rising.p), rising.g
        t = -np.sum(Sp * g.T, axis=0) / np.sum(g.T**2, axis=0)
        off = np.linalg.norm(Sp + t * g.T, axis=0)
        if error.sample_time is not None or np.any(t <= 0) or np.any(
                off > EQUALITY * np.linalg.norm(Sp, axis=0)):
            return -np.inf
        margin = 10 * EQUALITY
    inverse = np.abs(solve_triangular(L, np.eye(len(L)), lower=True).T)
    slack = (margin * np.linalg.norm(turned(error.N))
             + 4 * np.finfo(float).eps * len(L)
             * np.linalg.norm(np.abs(L.T) @ (
                 np.abs(error.N) if error.joint is None else error.joint.moduli()) @ inverse))
    if error.joint is not None:
        worst = error.joint.growth(L, error.sample_time)
    elif error.cornered:
        worst = max(_growth(turned(A), error.sample_time) for A in error.corners())
    else:
        worst = _growth_by_multipliers(turned(error.N), L.T @ fed.p,
                                       solve_triangular(L, fed.g.T, lower=True).T * (
                                           fed.radius[:, None]), error.sample_time, t)
    grows = float(worst + slack)
    if error.sample_time is None:
        return -grows
    return float(-np.log(max(grows, 1e-12)) / error.sample_time)


def _growth(M: np.ndarray, sample_time: float | None) -> float:
    # of |e|: logarithmic norm, or norm
    if sample_time is None:
        return float(np.linalg.eigvalsh(0.5 * (M + M.T))[-1])
    return float(np.linalg.norm(M, 2))


def _growth_by_multipliers(M: np.ndarray, p: np.ndarray, g: np.ndarray,
                           sample_time: float | None, t: np.ndarray | None) -> float:
    """Bound the growth for all slopes in [-1, 1] by the S-procedure (the method, 3.5)."""
    if t is None:
        t = np.linalg.norm(p, axis=0) / np.linalg.norm(g, axis=1)
    gain = g.T * t @ g
    if sample_time is None:
        return float(np.linalg.eigvalsh(0.5 * (M + M.T + gain + p / t @ p.T))[-1])
    inner = np.diag(t) - p.T @ p
    if np.linalg.eigvalsh(inner)[0] <= ROUNDING * t.max():
        return np.inf
    across = M.T @ p
    X = M.T @ M + gain + across @ np.linalg.solve(inner, across.T)
    return float(np.sqrt(max(np.linalg.eigvalsh(0.5 * (X + X.T))[-1], 0.0)))


def bound_on(error: ErrorSystem, L: np.ndarray, rate: float) -> float:
    """
    Bound |v - vhat| for readings off by 1 at most, from a checked form V = |L' e|^2.

    Everything that pushes e from outside gives |L' e| <= gain * sup |L' push|.

    A slope without upper bound needs more care. Its argument is wrong by up to d = |h|_1, because
    readings enter it. It can therefore hold e away from 0, along p, but no further than W p. So V
    is replaced by the squared distance of e from the points P w with |w_j| <= W_j. Let e_d be the
    difference to the nearest of them. The gradient 2 S e_d satisfies
    (g_j e_d) (g_j e - h_j n) >= 0, and the slope does no harm, if
    (p_j' S p_j) W_j - sum_{l != j} |p_j' S p_l| W_l >= t_j d_j. What is left to push is A P w.
    The bound is infinite where there are no such W.
    """
    rising, fed = error.rising, error.bounded
    if error.loose.radius.size or not np.all(rising.g.any(axis=1)):
        return np.inf
    columns = L.T @ error.J
    push = 0.0
    if columns.size:
        push = float(min(np.linalg.norm(columns, axis=0).sum(),
                         np.sqrt(columns.shape[1]) * np.linalg.norm(columns, 2)))
    push += float(np.linalg.norm(L.T @ fed.p, axis=0) @ (fed.radius * np.abs(fed.h).sum(axis=1)))
    edges = _held(L, rising)
    if edges is None:
        return np.inf
    push += float(np.linalg.norm(L.T @ error.N @ edges, axis=0).sum())
    push += float(np.linalg.norm(L.T @ fed.p, axis=0)
                  @ (fed.radius * np.abs(fed.g @ edges).sum(axis=1)))
    gain = contraction(rate, error.sample_time) * push
    return float(max(np.linalg.norm(solve_triangular(L, row, lower=True)) * gain
                     + np.abs(row @ edges).sum() + np.abs(q).sum()
                     for row, q in zip(error.Cv, error.Q)))


def _held(L: np.ndarray, rising: Slopes) -> np.ndarray | None:
    """
    Return the columns W_j p_j (k, c) of bound_on, parallel p taken together; None without any W.

    The W solve the conditions of bound_on, written with the comparison matrix of p' S p; that
    matrix must be an M-matrix.
    """
    ways: list[np.ndarray] = []
    least: list[float] = []
    for p, g, h in zip(rising.p.T, rising.g, rising.h):
        turned, error = L.T @ p, float(np.abs(h).sum())
        need = float(np.linalg.norm(L @ turned) / np.linalg.norm(g)) * error
        for i, way in enumerate(ways):
            other = L.T @ way
            share = float(other @ turned / (other @ other))
            if np.linalg.norm(turned - share * other) <= EQUALITY * np.linalg.norm(turned):
                least[i] = max(least[i], need / abs(share))
                break
        else:
            ways.append(p)
            least.append(need)
    if not any(least):
        return np.zeros((len(L), 0))
    P = np.array(ways).T
    gram = (L.T @ P).T @ (L.T @ P)
    comparison = 2.0 * np.diag(np.diag(gram)) - np.abs(gram)
    try:
        inverse = np.linalg.inv(comparison)
    except np.linalg.LinAlgError:
        return None
    if np.any(inverse < -ROUNDING * np.abs(inverse).max()):
        return None
    return P * (inverse @ least * (1 + EQUALITY))
