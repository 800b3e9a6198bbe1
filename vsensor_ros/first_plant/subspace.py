"""
A linear model of readings and commands alone, by a subspace method (PBSIDopt).

Source: Chiuso, The role of vector autoregressive modeling in predictor-based subspace
identification, Automatica 43 (2007). A long autoregression tells what the past says of the
future; of that as many directions are kept as there are states, those in which it says the most,
counted in deviations of the next reading. It holds in closed loops, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

LEAST = 1e-11  # singular value, of the largest, that is not rounding
INSIDE = 0.9999  # largest eigenvalue of a model that is stable
Run = tuple[np.ndarray, np.ndarray]  # commands (T, m) and readings (T, l) at even times


@dataclass(frozen=True, eq=False)
class Linear:
    """
    x' = A x + B u + K e, y = C x + D u + e.

    n states, m commands, l readings; e has the covariance R (l, l). sizes: singular values, by
    how much each direction of the past says of the future.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    K: np.ndarray
    R: np.ndarray
    sizes: np.ndarray

    def errors(self, run: Run, ahead: Sequence[int]) -> np.ndarray:
        """Return predicted less read (len(ahead), T, l), so many steps ahead; NaN where none."""
        u, y = run
        states, x = np.empty((len(y), len(self.A))), np.zeros(len(self.A))
        for k in range(len(y)):
            states[k] = x
            x = self.A @ x + self.B @ u[k] + self.K @ (y[k] - self.C @ x - self.D @ u[k])
        found = np.full((len(ahead), *y.shape), np.nan)
        for k in range(1, max(ahead) + 1):  # states[i] is then of k - 1 steps after reading i - 1
            if k in ahead:
                found[list(ahead).index(k), k - 1:] = \
                    states @ self.C.T + u[k - 1:] @ self.D.T - y[k - 1:]
            states = states[:-1] @ self.A.T + u[k - 1:len(y) - 1] @ self.B.T
        return found


def subspace(runs: Sequence[Run], order: int, past: int, direct: bool = False) -> Linear:
    """
    Return the model of so many states of runs whose means are 0.

    past: steps from which the next reading is told, at least `order`; direct: readings may show
    commands of the same step. It is stable: eigenvalues outside the unit circle are drawn in.
    """
    rows = [_rows(u, y, past) for u, y in runs]
    u, y, Z = (np.concatenate([r[i] for r in rows]) for i in range(3))
    m, shown, width = u.shape[1], y.shape[1], u.shape[1] + y.shape[1]
    told = np.hstack([Z, u]) if direct else Z
    weights = np.linalg.lstsq(told, y, rcond=LEAST)[0].T
    e = y - told @ weights.T
    scale = np.linalg.cholesky(e.T @ e / len(e) + 1e-24 * np.diag(y.var(axis=0) + 1e-300))
    future = np.zeros((past * shown, past * width))
    for j in range(past):  # what the past says of the reading j steps later
        future[j * shown:(j + 1) * shown, j * width:] = np.linalg.solve(
            scale, weights[:, :(past - j) * width])
    triangle = np.asarray(np.linalg.qr(Z, mode='r'))
    left, sizes, _ = np.linalg.svd(future @ triangle.T, full_matrices=False)
    states = [z @ future.T @ left[:, :order] / np.sqrt(sizes[:order]) for _, _, z in rows]
    x = np.concatenate(states)
    outputs = np.linalg.lstsq(np.hstack([x, u]) if direct else x, y, rcond=LEAST)[0].T
    C, D = outputs[:, :order], outputs[:, order:] if direct else np.zeros((shown, m))
    e = y - x @ C.T - u @ D.T
    now = np.concatenate([np.hstack([s, r[0]])[:-1] for s, r in zip(states, rows)])
    after = np.concatenate([s[1:] for s in states])
    ends = np.cumsum([len(s) for s in states]) - 1
    noise = np.delete(e, ends, axis=0)
    noise = np.where(np.abs(noise).max(axis=0) > 1e-9 * y.std(axis=0), noise, 0.0)
    moved = np.linalg.lstsq(np.hstack([now, noise]), after, rcond=LEAST)[0].T
    A, B, K = np.split(moved, [order, order + m], axis=1)
    return _stable(Linear(A, B, C, D, K, e.T @ e / len(e), sizes))


def _rows(u: np.ndarray, y: np.ndarray, past: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return commands, readings, and what was before (T - past, past (m + l)), oldest first."""
    z = np.hstack([u, y])
    count = len(z) - past
    return u[past:], y[past:], np.hstack([z[i:i + count] for i in range(past)])


def _stable(model: Linear) -> Linear:
    values, vectors = np.linalg.eig(model.A)
    far = np.abs(values) > INSIDE
    if not far.any():
        return model
    values = np.where(far, values / np.abs(values) * INSIDE, values)
    return replace(model, A=np.real(vectors @ np.diag(values) @ np.linalg.inv(vectors)))


def arx(runs: Sequence[Run], order: int, direct: bool = False) -> np.ndarray:
    """Return the next readings of so many before (l, order (m + l) [+ m]) by least squares."""
    rows = [_rows(u, y, order) for u, y in runs]
    told = np.concatenate([np.hstack([z, u]) if direct else z for u, _, z in rows])
    found = np.linalg.lstsq(told, np.concatenate([y for _, y, _ in rows]), rcond=LEAST)[0]
    return np.asarray(found.T)


def arx_errors(weights: np.ndarray, order: int, run: Run, ahead: Sequence[int]) -> np.ndarray:
    """Return predicted less read, as `Linear.errors` does."""
    u, y = run
    direct = weights.shape[1] > order * (u.shape[1] + y.shape[1])
    found = np.full((len(ahead), *y.shape), np.nan)
    rows = np.arange(order, len(y))
    told = [y[rows - i] for i in range(order, 0, -1)]
    for k in range(1, max(ahead) + 1):
        z = [part for i, t in enumerate(told) for part in (u[rows - order + i], t)]
        said = np.hstack([*z, u[rows]] if direct else z) @ weights.T
        if k in ahead:
            found[list(ahead).index(k), rows] = said - y[rows]
        rows, told = np.arange(order + k, len(y)), [*(t[:-1] for t in told[1:]), said[:-1]]
    return found
