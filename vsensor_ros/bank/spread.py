"""
The covariances of free runs along their way, where nonlinear terms bend the error (method, 8).

The steps of a pendulum near the top, or of an axis that sticks, do to an error what they do to a
state beside it. So each free run is stepped from as many states beside its own as it has, one
standard deviation off, and what becomes of the distances is the new covariance. Dry friction
counts as it holds, not with a slope.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch

LARGEST = 1e100  # beyond it nothing is known


class Spreads:
    """The spreads of T free runs in rows `free` (T,) of the states."""

    def __init__(self, batch: Batch, free: np.ndarray) -> None:
        """Prepare; `bent` tells which have a spread."""
        found = [batch.bent(i) for i in range(len(free))]
        self.bent = [i for i, b in enumerate(found) if b is not None]
        self._rows = free[self.bent]
        n, k = len(self.bent), batch.width
        self._at = {i: at for at, i in enumerate(self.bent)}
        self._start = np.array([b.start for b in found if b is not None]).reshape(n, k, k)
        self._growth = np.array([b.growth for b in found if b is not None]).reshape(n, k, k)
        self._row = np.array([b.row for b in found if b is not None]).reshape(n, k)
        self._direct = [b.direct for b in found if b is not None]

    def begin(self, before: State, placed: State) -> State:
        """Return a state in which the spreads begin of those free runs that stand anew there."""
        new = placed.running[self._rows] & (placed.since[self._rows] == placed.tick)
        old = self._start if before.spread is None else before.spread
        return placed._replace(spread=np.where(new[:, None, None], self._start, old))

    def step(self, state: State, ended: np.ndarray,
             step: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Return the spreads a step later; ended (R, k): where the states come to by `step`."""
        old = self._start if state.spread is None else state.spread
        values, vectors = np.linalg.eigh(np.where(np.isfinite(old), old, 0.0))
        roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]  # (.., k, k), by column
        off = np.empty_like(roots)
        for j in range(roots.shape[2]):
            beside = state.z.copy()
            beside[self._rows] += roots[:, :, j]
            off[:, :, j] = (step(beside) - ended)[self._rows]
        found = off @ off.transpose(0, 2, 1) + self._growth
        lost = ~(np.abs(found) < LARGEST).all(axis=(1, 2)) | ~np.isfinite(old).all(axis=(1, 2))
        found[lost] = np.inf
        return np.asarray(found)

    def deviation(self, i: int, state: State) -> float:
        """Return the standard deviation of what a free run says; 0: it has no spread."""
        at = self._at.get(i)
        if at is None or state.spread is None:
            return 0.0
        spread = state.spread[at]
        if not np.isfinite(spread).all():
            return np.inf
        return float(np.sqrt(max(0.0, self._row[at] @ spread @ self._row[at]) + self._direct[at]))
