"""
One Lyapunov matrix over the whole range of a scheduled observer's error, and what it proves.

The error is e' = (N_i - K_i R) e + (G_i + K_i H) w, blended over i, with w'w <= 1. A form
V = e' S e with V' <= 2 a (w'w - V) never leaves V <= 1 once it is there. It is found by linear
matrix inequalities with a margin, in coordinates in which the first answer is the identity. What a
solver says counts for nothing: the matrices are put into the inequalities again, in plain floating
point, at the vertices and at random points between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from vsensor_ros.designer.semidefinite import answered, solver

MARGIN = 1e-5  # of a rate, that is asked of the solver,
LEFT = 1e-7  # and that must be left
RATES = 7  # that are tried between the least and the fastest
UNSEEN = 1e-7  # singular value, beside the size of the pair, of a mode that is not seen
_BETWEEN = 200  # random points between the vertices
_STARTS = 6  # of the search for an undetectable pair


@dataclass(frozen=True, eq=False)
class Blend:
    """An error's vertices before the gains: e' = (N_i - K_i R) e + (G_i + K_i H) w, v = Cv e."""

    N: np.ndarray  # (V, k, k)
    R: np.ndarray  # (r, k)
    G: np.ndarray  # (V, k, w)
    H: np.ndarray  # (r, w)
    Cv: np.ndarray  # (1, k)
    sample_time: float | None  # s

    def turned(self, L: np.ndarray) -> Blend:
        """Return it in the coordinates L' e."""
        back = np.linalg.inv(L.T)
        return Blend(L.T @ self.N @ back, self.R @ back, L.T @ self.G, self.H, self.Cv @ back,
                     self.sample_time)


@dataclass(frozen=True, eq=False)
class Proof:
    """Gains and a form that were checked."""

    K: np.ndarray  # (V, k, r)
    S: np.ndarray  # (k, k)
    rate: float  # 1/s, at which V falls to where w holds it
    half_width: float  # of v, for ever once V <= 1
    left: float  # of the margin, as a share of the rate


def hidden(blend: Blend, h: np.ndarray, rate: float) -> float:
    """
    Return how nearly a slow mode is hidden at weights h (V,); infinite without slow ones.

    Slow: it dies out no faster than the rate [1/s]. At 0 no gain can move it, so there is no proof
    over a range with these weights in it.
    """
    N = np.tensordot(h, blend.N, axes=1)
    modes = np.linalg.eigvals(N)
    slow = modes.real > -rate if blend.sample_time is None \
        else abs(modes) > np.exp(-rate * blend.sample_time)
    size = np.linalg.norm(np.vstack([N, blend.R])) or 1.0
    return min((np.linalg.svd(np.vstack([N - mode * np.eye(len(N)), blend.R]),
                              compute_uv=False)[-1] / size for mode in modes[slow]),
               default=np.inf)


def nearest_undetectable(blend: Blend, weights_at: Callable[[np.ndarray], np.ndarray],
                         points: np.ndarray, ranges: np.ndarray,
                         rate: float) -> tuple[np.ndarray, float]:
    """
    Search from points (p, N) within ranges (p, 2) for the pair nearest to hiding a slow mode.

    weights_at: returns (V, N) at points. Returns the premises (p,) and how near, as `hidden`.
    """
    def near(at: np.ndarray) -> float:
        inside = np.clip(at, *ranges.T)
        found = hidden(blend, weights_at(inside[:, None])[:, 0], rate)
        return found if np.isfinite(found) else 1e3
    values = np.array([near(at) for at in points.T])
    best, least = points[:, values.argmin()], float(values.min())
    if not len(ranges):
        return best, least
    for start in np.argsort(values)[:_STARTS]:
        found = minimize(near, points[:, start], method='Nelder-Mead', options={
            'xatol': 1e-10, 'fatol': 1e-14, 'maxiter': 400, 'initial_simplex': np.vstack([
                points[:, start], points[:, start] + 0.05 * np.diag(np.diff(ranges)[:, 0])])})
        if found.fun < least:
            best, least = np.clip(found.x, *ranges.T), float(found.fun)
    return best, least


def prove(blend: Blend, rate: float) -> Proof | None:
    """
    Return the gains with the least half-width, among rates from this one [1/s] up; None: none.

    Raises ImportError, with what to install.
    """
    if blend.sample_time is None:
        fastest = 10.0 * max(abs(np.linalg.eigvals(blend.N)).max(), rate)
    else:
        fastest = -np.log(0.02) / blend.sample_time
    rates = np.geomspace(rate, max(fastest, rate), RATES)
    found = [_prove(blend, a) for a in rates]
    widths = [proof.half_width if proof else np.inf for proof in found]
    best = rates[int(np.argmin(widths))]
    if np.isfinite(min(widths)):
        step = rates[1] / rates[0]
        found += [_prove(blend, a) for a in (best / step**0.5, best * step**0.5) if a >= rate]
    return min((proof for proof in found if proof), key=lambda p: p.half_width, default=None)


def _prove(blend: Blend, rate: float) -> Proof | None:
    L = np.eye(blend.N.shape[1])
    proof = None
    for _ in range(3):  # each answer is the next one's unit
        answer = _solve(blend.turned(L), rate)
        if answer is None:
            return proof
        S, Y = answer
        try:
            turn = np.linalg.cholesky(S)
            K = np.linalg.solve(L.T, np.linalg.solve(S, Y))
        except np.linalg.LinAlgError:
            return proof
        L = L @ turn
        if (left := margin_left(blend, K, L @ L.T, rate)) >= LEFT:
            width = float(np.linalg.norm(np.linalg.solve(L, blend.Cv.T)))
            before = proof.half_width if proof else np.inf
            if width < before:
                proof = Proof(K, L @ L.T, rate, width, left)
            if width > 0.99 * before:
                break
    return proof


def margin_left(blend: Blend, K: np.ndarray, S: np.ndarray, rate: float, seed: int = 0) -> float:
    """
    Put gains K (V, k, r) and a form into the inequalities; return what is left, of the rate.

    At all vertices and at random points between them; negative where they do not hold, and -inf
    where S is no form.
    """
    try:
        L = np.linalg.cholesky((S + S.T) / 2.0)
    except np.linalg.LinAlgError:
        return -np.inf
    if not np.isfinite(K).all():
        return -np.inf
    V = len(blend.N)
    mixed = np.random.default_rng(seed).dirichlet(np.full(V, 0.5), _BETWEEN)
    b = blend.turned(L)
    closed, driven = b.N - L.T @ K @ b.R, b.G + L.T @ K @ b.H
    least = np.inf
    for h in np.vstack([np.eye(V), mixed]):
        A, G = np.tensordot(h, closed, axes=1), np.tensordot(h, driven, axes=1)
        worst, slack = _worst(A, G, rate, b.sample_time)
        least = min(least, -worst - slack)
    return float(least)


def _worst(A: np.ndarray, G: np.ndarray, rate: float,
           sample_time: float | None) -> tuple[float, float]:
    """Return the largest eigenvalue of the inequality where S = 1, and what rounding may do."""
    k, w = G.shape
    if sample_time is None:
        M = np.block([[(A + A.T) / (2 * rate) + np.eye(k), G / (2 * rate)],
                      [G.T / (2 * rate), -np.eye(w)]])
    else:
        fall = -np.expm1(-2.0 * rate * sample_time)
        both = np.hstack([A, G])
        rest = np.diag([1.0 - fall] * k + [fall] * w)
        M = (both.T @ both - rest) / fall
    return float(np.linalg.eigvalsh(M)[-1]), 1e-13 * float(np.linalg.norm(M)) * len(M)


def _solve(blend: Blend, rate: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return S (k, k) and S K_i (V, k, r) as a solver has them; None without an answer."""
    cvxpy = solver()
    k, w = blend.G.shape[1:]
    r, h = len(blend.R), blend.sample_time
    S, width = cvxpy.Variable((k, k), symmetric=True), cvxpy.Variable((1, 1))
    Y = [cvxpy.Variable((k, r)) if r else np.zeros((k, 0)) for _ in blend.N]
    unit = float(np.linalg.norm(blend.Cv)) or 1.0
    said = blend.Cv / unit
    asked = [cvxpy.bmat([[S, said.T], [said, width]]) >> 0]
    for N, G, y in zip(blend.N, blend.G, Y):
        A, D = S @ N, S @ G
        if r:
            A, D = A - y @ blend.R, D + y @ blend.H
        if h is None:
            M = cvxpy.bmat([[(A + A.T) / (2 * rate) + S, D / (2 * rate)],
                            [D.T / (2 * rate), -np.eye(w)]])
            asked.append(M << -MARGIN * np.eye(k + w))
        else:
            fall = -np.expm1(-2.0 * rate * h)
            M = cvxpy.bmat([[(1.0 - fall) * S, np.zeros((k, w)), A.T],
                            [np.zeros((w, k)), fall * np.eye(w), D.T], [A, D, S]])
            asked.append(M >> MARGIN * fall * np.eye(2 * k + w))
    problem = cvxpy.Problem(cvxpy.Minimize(width[0, 0]), asked)
    if not answered(problem, S):
        return None
    gains = np.array([getattr(y, 'value', y) for y in Y])  # without R they are no variables
    return (S.value + S.value.T) / 2.0, gains
