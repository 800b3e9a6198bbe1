"""
The covariances of free runs along their way, where nonlinear terms bend the error (method, 8).

The steps of a pendulum near the top, or of an axis that sticks, do to an error what they do to a
state beside it. So each free run in flight is stepped from states beside its own, two standard
deviations off to either side of it along each axis of the covariance; what becomes of the larger
distances is the new one. So it is told that an estimate says nothing when a state that is likely
falls down on the other side. Dry friction counts as it holds, not with a slope.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np

from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch, StepOfSome, Told

LARGEST = 1e100  # beyond it nothing is known
OFF = 2.0  # standard deviations between a free run and the states beside it
# runs at most with which states beside some of them are stepped in one call: it costs more than
# its numbers. The matrices of more are dear to copy
TOGETHER = 300


Where = slice | np.ndarray | None


class _Along(NamedTuple):
    """How some runs are stepped, and beside them the states that tell n spreads."""

    at: Where  # n, where the spreads stand; None: there are none
    rows: Where  # n of their runs
    own: Where  # n, where these are among the runs that are stepped
    most: int  # K, the largest order of them: 2 K states are beside each
    step: StepOfSome  # of all runs to be stepped, and of the 2 n K states if it takes them
    apart: StepOfSome | None  # of the 2 n K states, if that does not; None: it does


class Spreads:
    """The spreads of T free runs in rows `free` (T,) of the states."""

    def __init__(self, batch: Batch, free: np.ndarray) -> None:
        """Prepare; some have none, for `drift` tells all of them."""
        bends = {i: b for i in range(len(free)) if (b := batch.bent(i)) is not None}
        # no wider than these: states of other kinds may be far longer
        n, k = len(bends), max((len(b.row) for b in bends.values()), default=0)
        self._batch, self._free, self._rows = batch, free, free[list(bends)]
        self._at = {i: at for at, i in enumerate(bends)}
        self._orders = [len(b.row) for b in bends.values()]
        self._start, self._growth = np.zeros((n, k, k)), np.zeros((n, k, k))
        self._row, self._sizes = np.zeros((n, k)), np.ones((n, k))
        for at, (b, order) in enumerate(zip(bends.values(), self._orders)):
            self._start[at, :order, :order] = b.start
            self._growth[at, :order, :order] = b.growth
            self._row[at, :order] = b.row
            usual = np.sqrt(np.diagonal(b.start + b.growth))
            self._sizes[at, :order] = np.where(usual > 0.0, usual, 1.0)
        self._direct = [b.direct for b in bends.values()]
        self._all = np.arange(len(batch.runs_on))
        # by who flies, and whether nobody else is stepped: the last two
        self._prepared: dict[tuple[tuple[int, ...], bool], _Along] = {}

    def begin(self, state: State) -> State:
        """Return a state in which the spreads begin of those free runs that stand anew there."""
        if not self._at:
            return state
        new = state.running[self._rows] & (state.since[self._rows] == state.tick)
        old = self._start if state.spread is None else state.spread
        return state._replace(spread=np.where(new[:, None, None], self._start, old))

    def step(self, flights: tuple[int, ...], alone: bool, state: State, told: Told,
             commands: np.ndarray, others: np.ndarray | None = None,
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """
        Step all runs, or alone those of the T that fly, and the spreads of these.

        others: spreads of those that do not fly. Return the states (n, k), who saw an argument
        outside of a function's domain (n,), and the spreads; None: nobody has one.
        """
        way = self._along(flights, alone)
        z = state.z[self._free[list(flights)]] if alone else state.z
        if way.at is None:
            return *way.step(z, state.told, told, commands), others
        old = (self._start if state.spread is None else state.spread)[way.at]
        known = all(map(math.isfinite, old[:, 0, 0].tolist()))  # else all of it is infinite
        values, vectors = np.linalg.eigh(old if known else np.where(np.isfinite(old), old, 0.0))
        # (n, k, K), by column; what is left out is 0: states beyond the orders
        roots = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])[:, :, -way.most:]
        n, k, K = roots.shape
        off = OFF * np.concatenate((roots, -roots), axis=2).transpose(0, 2, 1)  # (n, 2 K, k)
        beside = np.repeat(state.z[way.rows], 2 * K, axis=0)
        beside[:, :k] += off.reshape(2 * n * K, k)
        if way.apart is None:
            ended, outside = way.step(np.concatenate((z, beside)), state.told, told, commands)
            ended, beside, outside = ended[:len(z)], ended[len(z):], outside[:len(z)]
        else:
            ended, outside = way.step(z, state.told, told, commands)
            beside = way.apart(beside, state.told, told, commands)[0]
        off = (beside[:, :k].reshape(n, 2 * K, k) - ended[way.own, :k][:, None, :]) / OFF
        far = ((off / self._sizes[way.at][:, None, :])**2).sum(axis=2, keepdims=True)
        off = np.where(far[:, :K] >= far[:, K:], off[:, :K], off[:, K:])
        found = off.transpose(0, 2, 1) @ off + self._growth[way.at]
        if not (known and found.max() < LARGEST):  # which is on the diagonal
            found[~((np.abs(found) < LARGEST) & np.isfinite(old)).all(axis=(1, 2))] = np.inf
        spread = (self._start if others is None else others).copy()
        spread[way.at] = found
        return ended, outside, spread

    def _along(self, flights: tuple[int, ...], alone: bool) -> _Along:
        if (flights, alone) not in self._prepared:
            while len(self._prepared) > 1:
                del self._prepared[next(iter(self._prepared))]
            self._prepared[flights, alone] = self._prepare(flights, alone)
        return self._prepared[flights, alone]

    def _prepare(self, flights: tuple[int, ...], alone: bool) -> _Along:
        at = [self._at[i] for i in flights if i in self._at]
        most = max((self._orders[a] for a in at), default=0)
        stepped, step_of = self._free[list(flights)] if alone else self._all, self._batch.step_of
        rows, together = self._rows[at], len(stepped) <= TOGETHER
        beside = np.repeat(rows, 2 * most)
        step = step_of(np.concatenate((stepped, beside))) if most and together else \
            step_of(stepped) if alone else self._batch.step
        if not most:
            return _Along(None, None, None, 0, step, None)
        own = [int(np.flatnonzero(stepped == row)[0]) for row in rows]
        return _Along(_where(at), _where(rows), _where(own), most, step,
                      None if together else step_of(beside))

    def deviation(self, i: int, state: State) -> float:
        """Return the standard deviation of what a free run says; 0: it has no spread."""
        at = self._at.get(i)
        if at is None or state.spread is None:
            return 0.0
        spread, row = state.spread[at], self._row[at]
        if not math.isfinite(spread[0, 0]):  # nor is anything of it
            return math.inf
        return math.sqrt(max(0.0, float(row @ spread @ row)) + self._direct[at])


def _where(indices: Sequence[int] | np.ndarray) -> slice | np.ndarray:
    """Return indices as a slice where they follow each other: that is cheaper."""
    found = np.array(indices)
    follow = (np.diff(found) == 1).all()
    return slice(int(found[0]), int(found[-1]) + 1) if follow else found
