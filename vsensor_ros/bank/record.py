"""
What residuals (reading - estimate) and readings have been like while all was well.

Filled block by block from states that nothing late can change any more, and believed with a
delay: what a fault did before it was isolated does not count.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

DELAY = 1.0  # s
_MEMORY = 100.0  # s, or 30 time constants: after it the past counts for 1/e
_TIME_CONSTANTS = 30.0
_ENOUGH = 10.0  # s, or 30 time constants: so much, and what was measured counts alone
_TOLD_APART = 0.2  # of the rms of a residual is the estimate's, at least
_LAG = 0.1  # s over which the slope of a reading is taken


class _Sums(NamedTuple):
    """Weights [s], sums, sums of squares and of reading noise (4, V); of slopes (2, L)."""

    residuals: np.ndarray
    slopes: np.ndarray


class Record:
    """
    Mean and spread of V residuals, what of their rms is the estimate's, and L rms slopes.

    `slowest` (V,): time constants [s] of the virtual sensors; `own` (V,): the reading that each
    stands in for; `period` [s] of the grid.
    """

    def __init__(self, slowest: np.ndarray, own: np.ndarray, readings: int,
                 period: float) -> None:
        self.block = max(8, round(0.5 / period))  # rows of a block
        self._own, self._period = own, period
        self._lag = min(max(2, round(_LAG / period)), self.block // 2)
        constants = _TIME_CONSTANTS * np.minimum(slowest, 1e9)
        self._memory, self._enough = np.maximum(_MEMORY, constants), np.maximum(_ENOUGH, constants)
        self._sums = _Sums(np.zeros((4, len(slowest))), np.zeros((2, readings)))
        self._waiting: deque[tuple[int, _Sums]] = deque()
        self._look()

    def add(self, index: int, residuals: np.ndarray, counts: np.ndarray, readings: np.ndarray,
            there: np.ndarray) -> None:
        """
        Take a block that ends at a grid index: residuals (T, V) that count, and readings (T, L).

        What was taken long enough ago is believed from now on.
        """
        residuals = np.where(counts, residuals, 0.0)
        noise, slope = self._apart(readings)
        noise = np.where(there.all(axis=0), noise, 0.0)[self._own]
        noise = np.where(counts.all(axis=0), np.minimum(noise, self._apart(residuals)[0]), 0.0)
        sums = np.array([counts.sum(axis=0), residuals.sum(axis=0), (residuals**2).sum(axis=0),
                         noise * len(residuals)]) * self._period
        weight = there.all(axis=0) * len(readings) * self._period
        self._waiting.append((index, _Sums(sums, np.array([weight, weight * slope]))))
        while self._waiting and index - self._waiting[0][0] >= DELAY / self._period:
            self._believe(self._waiting.popleft()[1])
        self._look()

    def _apart(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Tell the variance of white noise in columns from their mean square slope [1/s^2].

        The noise adds as much to differences over one row as to those over the lag.
        """
        near, far = (np.mean((values[n:] - values[:-n])**2, axis=0) for n in (1, self._lag))
        slope = np.maximum(far - near, 0.0) / (self._lag**2 - 1)
        return np.maximum(near - slope, 0.0) / 2, slope / self._period**2

    def _believe(self, new: _Sums) -> None:
        old = self._sums
        keep = np.exp(-new.residuals[0] / self._memory), np.exp(-new.slopes[0] / _MEMORY)
        self._sums = _Sums(old.residuals * keep[0] + new.residuals,
                           old.slopes * keep[1] + new.slopes)

    def _look(self) -> None:
        with np.errstate(all='ignore'):
            seconds, first, second, noise = self._sums.residuals
            square = second / seconds
            self.mean = first / seconds  # (V,), NaN where nothing is known
            self.spread = np.sqrt(np.maximum(square - self.mean**2, 0.0))
            # of the estimate alone; the reading's noise is not known so well that less could be
            # told from it
            self.rms = np.sqrt(np.maximum(square - noise / seconds, _TOLD_APART**2 * square))
            self.enough = seconds >= self._enough
            self.slope = np.sqrt(self._sums.slopes[1] / self._sums.slopes[0])  # (L,), 1/s

    def forget(self, rows: np.ndarray | None = None, readings: np.ndarray | None = None) -> None:
        """Forget what is not yet believed of some virtual sensors and readings, or of all."""
        if rows is None:
            self._waiting.clear()
        for _, sums in self._waiting:
            sums.residuals[:, rows] = 0.0
            sums.slopes[:, readings] = 0.0

    def in_steady_state(self, error: np.ndarray, assumed: np.ndarray) -> np.ndarray:
        """
        Return the standard deviation (V,) of each estimate; infinite where not known.

        `error` (V,) is the design's figure, NaN where there is none: what was measured may raise
        it. Where it is assumed it counts until enough has been measured.
        """
        measured = np.where(assumed & self.enough, self.rms, np.fmax(error, self.rms))
        return np.where(np.isnan(measured), np.inf, measured)
