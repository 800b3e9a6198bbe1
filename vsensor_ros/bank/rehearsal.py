"""
How far free runs were off the channel while that was believed, by the age of the run.

As in the record, only what nothing late can change any more is taken, and believed with a delay:
what a fault did before it was isolated does not count. Nor do the worst few: a lone spike says
nothing of the model.
"""

from __future__ import annotations

from collections import deque
import math

import numpy as np
from scipy.special import stdtrit

from vsensor_ros.bank.angle import ShortWay
from vsensor_ros.bank.free_runs import AGES
from vsensor_ros.bank.record import DELAY
from vsensor_ros.observers import Batch, Told

_KEPT = 40  # rehearsals remembered of each age
_FEW = 3  # of fewer nothing is said
_WORST = 20  # one in so many is left out
_TOLD_APART = 0.2  # of the rms of a residual is the estimate's, at least
_MEDIAN = 0.954  # of the absolute difference of two normal ones, per standard deviation
# s from now that are looked at
_FROM_NOW = np.concatenate([[0.0], np.geomspace(1e-2, 1e6, 300)])
_TWO_SIDED = 0.97725  # two deviations of a normal distribution, on one side


class Growth:
    """
    The growth of the error of T free runs: the larger of computed and measured.

    Measured is the rms at AGES, less the noise of the reading; while few, a bound of it, by
    Student's distribution. Between ages it is a straight line, beyond the last it grows as
    computed.
    """

    def __init__(self, batch: Batch, period: float, short_way: ShortWay) -> None:
        """Prepare for a grid of this period [s]; short_way: of residuals (.., O) that wrap."""
        self._batch, tracked = batch, batch.tracked
        own = [t.own for t in tracked]
        # what an output of each says in flight, and the sensor that it is compared with
        self._output = np.array([np.flatnonzero(batch.of == row)[0] for row in own], dtype=int)
        self._short_way = short_way.of(self._output)
        self._sensor = batch.own[self._output] if own else np.zeros(0, dtype=int)
        self._free = np.array([t.free for t in tracked], dtype=int)
        self._rows = np.arange(batch.size)
        self._rows[own] = self._free
        ticks = [round(age / period) for age in AGES]
        self._ticks = np.array([t for t in ticks if t >= 1], dtype=int)
        self._ages = self._ticks * period
        self._delay = DELAY / period
        # squares of residuals, and variances of the noise in them; the latest first
        self._kept = np.full((2, len(tracked), len(self._ticks), _KEPT), np.nan)
        self._waiting: deque[tuple[int, np.ndarray]] = deque()  # by index (2, T, ages)
        self.measured: np.ndarray = np.full(self._kept.shape[1:3], np.nan)  # NaN: not known
        self._tables: dict[int, tuple[np.ndarray, np.ndarray, float] | None] = {}

    def add(self, ticks: np.ndarray, z: np.ndarray, running: np.ndarray, since: np.ndarray,
            told: Told, heard: np.ndarray) -> None:
        """Take S states that nothing can change any more; heard (S, L): it was really read."""
        free = self._free
        counts = running[:, free] & heard[:, self._sensor] & (self._sensor >= 0)
        ages = ticks[:, None] - since[:, free]
        hit = counts[:, :, None] & (ages[:, :, None] == self._ticks)  # (S, T, ages)
        if hit.any():
            off = self._short_way(told.y[:, self._sensor] - self._batch.estimates(
                z[:, self._rows], told.y, told.held)[:, self._output])
            new = np.full((2, *hit.shape[1:]), np.nan)
            at, which, age = np.nonzero(hit)
            new[0, which, age] = off[at, which]**2
            new[1, which, age] = self._noise(off, counts, since[:, free])[which]
            self._waiting.append((int(ticks[-1]), new))
        late = [new for index, new in self._waiting if ticks[-1] - index >= self._delay]
        for new in late:
            self._waiting.popleft()
            self._believe(new)
        if late:
            self._look()

    def _noise(self, off: np.ndarray, counts: np.ndarray, since: np.ndarray) -> np.ndarray:
        """Return the variance (T,) of what differs from one reading to the next."""
        pairs = counts[1:] & counts[:-1] & (since[1:] == since[:-1])
        steps = np.sort(np.where(pairs, np.abs(off[1:] - off[:-1]), np.inf), axis=0)
        n = pairs.sum(axis=0)
        middle = np.take_along_axis(steps, np.maximum(n // 2, 0)[None], axis=0)[0] \
            if len(steps) > 1 else np.full(len(n), np.inf)
        return np.where(np.isfinite(middle), (middle / _MEDIAN)**2, 0.0)

    def _believe(self, new: np.ndarray) -> None:
        _, which, age = np.nonzero(np.isfinite(new[:1]))
        self._kept[:, which, age, 1:] = self._kept[:, which, age, :-1]
        self._kept[:, which, age, 0] = new[:, which, age]

    def _look(self) -> None:
        squares, noise = self._kept
        n = np.isfinite(squares).sum(axis=2)
        ordered = np.sort(squares, axis=2)  # what is not there is last
        kept = np.arange(_KEPT) < (n - n // _WORST)[:, :, None]
        weight = np.maximum(kept.sum(axis=2), 1)
        square = np.where(kept, ordered, 0.0).sum(axis=2) / weight
        noise = np.where(np.isfinite(noise), noise, 0.0).sum(axis=2) / np.maximum(n, 1)
        rms = np.sqrt(np.maximum(square - noise, _TOLD_APART**2 * square))
        self.measured = np.where(
            n >= _FEW, rms * stdtrit(np.maximum(n, 1), _TWO_SIDED) / 2.0, np.nan)
        self._tables.clear()

    def forget(self, lost: np.ndarray) -> None:
        """Forget what is not yet believed of those (T,) that have read what is lost."""
        for _, new in self._waiting:
            new[:, lost] = np.nan

    def restart(self) -> None:
        """Forget what is not yet believed."""
        self._waiting.clear()

    def stated(self, i: int, age: float) -> float:
        """Return the standard deviation of a free run at an age [s]."""
        computed = float(self._batch.drift(i, np.array(age)))
        return max(computed, self._measured_at(i, age, computed))

    def shown(self, i: int, age: float) -> float:
        """Return what of it was measured; 0: nothing yet."""
        return self._measured_at(i, age, float(self._batch.drift(i, np.array(age))))

    def _measured_at(self, i: int, age: float, computed: float) -> float:
        table = self._table(i)
        if table is None:
            return 0.0
        at, measured, last = table
        found = float(np.interp(age, at, measured))
        if age > at[-1]:
            found *= max(1.0, computed / last if 0.0 < last < math.inf else age / float(at[-1]))
        return math.inf if math.isnan(found) else found

    def _table(self, i: int) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Return ages and what was measured there, and what is computed of the last; or None."""
        if i not in self._tables:
            known = np.isfinite(self.measured[i])
            at = self._ages[known]
            self._tables[i] = (at, self.measured[i, known], float(
                self._batch.drift(i, at[-1:])[0])) if known.any() else None
        return self._tables[i]

    def _stated_at(self, i: int, ages: np.ndarray) -> np.ndarray:
        """Return `stated` of many ages."""
        computed, table = self._batch.drift(i, ages), self._table(i)
        if table is None:
            return computed
        at, measured, last = table
        with np.errstate(all='ignore'):
            beyond = np.maximum(computed / last if 0.0 < last < np.inf else ages / at[-1], 1.0)
            found = np.interp(ages, at, measured) * np.where(ages > at[-1], beyond, 1.0)
        return np.maximum(computed, np.where(np.isnan(found), np.inf, found))

    def until(self, i: int, age: float, limit: float) -> float:
        """Return how long [s] after an age a free run's deviation passes a limit; inf: never."""
        after, stated = _FROM_NOW, self._stated_at(i, age + _FROM_NOW)
        beyond = np.flatnonzero(stated > limit)
        if not beyond.size or beyond[0] == 0:
            return 0.0 if beyond.size else np.inf
        at = int(beyond[0])
        low, high = stated[at - 1], stated[at]
        part = (limit - low) / (high - low) if np.isfinite(high) else 0.0
        return float(after[at - 1] + part * (after[at] - after[at - 1]))
