"""
Quadratic bounds of a blended discrete error: the least form that it never leaves.

The error is e+ = (M_i - K_i R) (e, w), blended over i, with w'w <= 1. V = e' P e never leaves
V <= 1 once it is there if |P^1/2 (M_i - K_i R) D^-1/2| <= 1 with D = diag((1 - a) P, a I), for all
i: the norm is convex, so blends follow. It is the paper's inequality without what is redundant in
it: its U is P, and its gains follow from P. A solver's word counts for nothing: the norm is found
afterwards, and a margin must be left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, null_space

from vsensor_ros.designer.semidefinite import answered, solver

MARGINS = (1e-6, 3e-6, 1e-5, 3e-5)  # that are asked of the solver in turn, which may fail at one,
LEFT = 1e-9  # and that must be left of the norm


def inflated(S: np.ndarray, w: int, alpha: float) -> np.ndarray:
    """Return the inverse of D for P = S^-1 and w bounded numbers; at alpha 0 the covariance."""
    return block_diag(S / (1.0 - alpha), np.eye(w) / (alpha or 1.0))


@dataclass(frozen=True, eq=False)
class Found:
    """A form that was checked, with the gains and the T that go with it."""

    T: np.ndarray  # (N, n + l)
    K: np.ndarray  # (V, N, l)
    P: np.ndarray  # (N, N)
    norm: float


@dataclass(frozen=True, eq=False)
class Inequalities:
    """M_i = T G_i, gains on R, and the rows of e whose intervals are to be small."""

    G: np.ndarray  # (V, n + l, N + w)
    R: np.ndarray  # (l, N + w)
    rows: np.ndarray  # of e

    def gains(self, T: np.ndarray, P: np.ndarray, alpha: float) -> np.ndarray:
        """Return the gains (V, N, l) that make the norm least for T and P."""
        D = inflated(np.linalg.inv(P), self.G.shape[2] - len(P), alpha)
        M = T @ self.G
        return M @ D @ self.R.T @ np.linalg.inv(self.R @ D @ self.R.T)

    def norm(self, T: np.ndarray, K: np.ndarray, P: np.ndarray, alpha: float) -> float:
        """Return the largest norm over the submodels; infinite where P is no form."""
        try:
            L = np.linalg.cholesky((P + P.T) / 2.0)
        except np.linalg.LinAlgError:
            return np.inf
        w = self.G.shape[2] - len(P)
        back = block_diag(np.linalg.inv(L.T) / np.sqrt(1.0 - alpha), np.eye(w) / np.sqrt(alpha))
        return float(np.linalg.norm(L.T @ (T @ self.G - K @ self.R) @ back, 2, (1, 2)).max())

    def solve(self, alpha: float, T: np.ndarray, S: np.ndarray, free: np.ndarray | None = None,
              K: np.ndarray | None = None) -> Found | None:
        """
        Return the form with the least sum of squared half-widths of the rows; None: none.

        S (N, N): an error covariance, whose size becomes the unit. free (q, n + l): directions in
        which T may move. K (V, N, l): gains that are fixed; else they follow from the form.
        Raises ImportError, with what to install.
        """
        return next((found for margin in MARGINS if (found := self._solve(
            alpha, T, S, free, K, margin)) is not None), None)

    def _solve(self, alpha: float, T: np.ndarray, S: np.ndarray, free: np.ndarray | None,
               K: np.ndarray | None, margin: float) -> Found | None:
        cvxpy = solver()
        N, w = len(S), self.G.shape[2] - len(S)
        L = np.linalg.cholesky(S)
        turn = block_diag(L, np.eye(w))
        M, R = np.linalg.solve(L, T @ self.G) @ turn, self.R @ turn
        seen = null_space(R / np.linalg.norm(R, axis=1)[:, None])
        P = cvxpy.Variable((N, N), symmetric=True)
        said = L[self.rows] / np.sqrt(np.diag(S)[self.rows])[:, None]
        width = cvxpy.Variable((len(said), len(said)), symmetric=True)
        if free is not None and len(free):
            Y = cvxpy.Variable((N, len(free)))
            moving = free @ self.G @ turn
        if K is not None:
            M, seen = M - np.linalg.solve(L, K @ self.R) @ turn, np.eye(N + w)
        e, d = seen[:N], seen[N:]
        rest = (1.0 - alpha) * (e.T @ P @ e) + alpha * (d.T @ d)
        asked = [cvxpy.bmat([[P, said.T], [said, width]]) >> 0]
        for i, m in enumerate(M):
            ahead = P @ (m @ seen)
            if free is not None and len(free):
                ahead = ahead + Y @ (moving[i] @ seen)
            asked.append(cvxpy.bmat([[rest, ahead.T], [ahead, P]])
                         >> margin * np.eye(N + seen.shape[1]))
        problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.trace(width)), asked)
        if not answered(problem, P):
            return None
        try:
            if free is not None and len(free):
                T = T + L @ np.linalg.solve(P.value, Y.value) @ free
            back = np.linalg.inv(L)
            form = back.T @ P.value @ back
            form = (form + form.T) / 2.0
            gains = self.gains(T, form, alpha) if K is None else K
        except np.linalg.LinAlgError:
            return None
        norm = self.norm(T, gains, form, alpha)
        return Found(T, gains, form, norm) if norm <= 1.0 - LEFT else None
