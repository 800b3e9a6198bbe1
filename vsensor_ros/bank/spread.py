"""
The covariances of free runs along their way, where nonlinear terms bend the error (method, 8).

The steps of a pendulum near the top, or of an axis that sticks, do to an error what they do to a
state beside it. So each free run in flight is stepped from as many states beside its own as it
has, one standard deviation off, and what becomes of the distances is the new covariance. Dry
friction counts as it holds, not with a slope.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np

from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch, StepOfSome, Told

LARGEST = 1e100  # beyond it nothing is known


class _Beside(NamedTuple):
    """How the states beside some free runs are stepped, K beside each of n."""

    at: list[int]  # n, where their spreads stand
    rows: np.ndarray  # (n,)
    beside: int  # K, the largest order of them
    step: StepOfSome  # of n K states


class Spreads:
    """The spreads of T free runs in rows `free` (T,) of the states."""

    def __init__(self, batch: Batch, free: np.ndarray) -> None:
        """Prepare; some have none, for `drift` tells all of them."""
        bends = {i: b for i in range(len(free)) if (b := batch.bent(i)) is not None}
        n, k = len(bends), batch.width
        self._batch, self._rows = batch, free[list(bends)]
        self._at = {i: at for at, i in enumerate(bends)}
        self._orders = [len(b.row) for b in bends.values()]
        self._start, self._growth = np.zeros((n, k, k)), np.zeros((n, k, k))
        self._row = np.zeros((n, k))
        for at, (b, order) in enumerate(zip(bends.values(), self._orders)):
            self._start[at, :order, :order] = b.start
            self._growth[at, :order, :order] = b.growth
            self._row[at, :order] = b.row
        self._direct = [b.direct for b in bends.values()]
        self._prepared: dict[tuple[int, ...], _Beside | None] = {}  # by who flies, the last two

    def begin(self, state: State) -> State:
        """Return a state in which the spreads begin of those free runs that stand anew there."""
        if not self._at:
            return state
        new = state.running[self._rows] & (state.since[self._rows] == state.tick)
        old = self._start if state.spread is None else state.spread
        return state._replace(spread=np.where(new[:, None, None], self._start, old))

    def step(self, flights: tuple[int, ...], state: State, ended: np.ndarray, told: Told,
             commands: np.ndarray, others: np.ndarray | None = None) -> np.ndarray | None:
        """
        Return the spreads a step after a state; ended (R, k): where the runs come to by then.

        flights: which of the T fly. others: the spreads of those that do not. None: no flight has
        one.
        """
        who = self._beside(flights)
        if who is None:
            return others
        old = (self._start if state.spread is None else state.spread)[who.at]
        values, vectors = np.linalg.eigh(np.where(np.isfinite(old), old, 0.0))
        # (n, k, K), by column; what is left out is 0: states beyond the orders
        roots = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])[:, :, -who.beside:]
        n, k, K = roots.shape
        beside = state.z[who.rows][:, None, :] + roots.transpose(0, 2, 1)
        off = who.step(beside.reshape(n * K, k), state.told, told, commands)[0].reshape(
            n, K, k) - ended[who.rows][:, None, :]
        found = off.transpose(0, 2, 1) @ off + self._growth[who.at]
        lost = ~(np.abs(found) < LARGEST).all(axis=(1, 2)) | ~np.isfinite(old).all(axis=(1, 2))
        found[lost] = np.inf
        spread = (self._start if others is None else others).copy()
        spread[who.at] = found
        return spread

    def _beside(self, flights: tuple[int, ...]) -> _Beside | None:
        if flights not in self._prepared:
            while len(self._prepared) > 1:
                del self._prepared[next(iter(self._prepared))]
            self._prepared[flights] = self._prepare(flights)
        return self._prepared[flights]

    def _prepare(self, flights: Sequence[int]) -> _Beside | None:
        at = [self._at[i] for i in flights if i in self._at]
        most = max((self._orders[a] for a in at), default=0)
        if not most:
            return None
        rows = self._rows[at]
        return _Beside(at, rows, most, self._batch.step_of(np.repeat(rows, most)))

    def deviation(self, i: int, state: State) -> float:
        """Return the standard deviation of what a free run says; 0: it has no spread."""
        at = self._at.get(i)
        if at is None or state.spread is None:
            return 0.0
        row = self._row[at]
        variance = float(row @ state.spread[at] @ row)
        return math.sqrt(max(0.0, variance) + self._direct[at]) \
            if math.isfinite(variance) else math.inf
