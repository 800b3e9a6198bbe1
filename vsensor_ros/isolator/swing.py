"""
How far channels swing within the length of each window, beside what they did while healthy.

A model that errs shows it where a machine moves faster, even within the range that it knows. The
swing of a channel over a window is the difference of two of its low-passes, one as late as the
mean of the window, one as late as that of the four windows before: its rate of change, so often
the window's length.
"""

from __future__ import annotations

import numpy as np

from vsensor_ros.isolator.block_maxima import BlockMaxima, Floats
from vsensor_ros.isolator.detector import Bools, WINDOWS

LOOKED_AT = 4  # batches, of which one mean is taken
SWINGS = WINDOWS[2:]  # shorter windows go by the first of these
BLOCK = 1024  # samples, in which a largest swing is kept
PEAK = 20.0  # s in which a peak is forgotten to 1/e, at least; and five windows


class Swing:
    """Of any number of channels c, a batch of samples at a time."""

    def __init__(self, period: float, batch: int, count: int) -> None:
        rows, self._taken = len(SWINGS), LOOKED_AT * batch
        length = np.array(SWINGS, dtype=float)[:, None]
        # gains of the low-passes, whose delays are half a window and three windows
        self._fast, self._slow = -np.expm1(-self._taken / (np.array([[[0.5]], [[3.0]]]) * length))
        self._fades = np.exp(-self._taken * period / np.maximum(PEAK, 5 * period * length))
        self.maxima = BlockMaxima(rows, count)
        self._usual = np.full((rows, count), np.inf)
        self._count = 0  # batches
        self.restart()

    def restart(self) -> None:
        """Forget the last readings, not what was learnt."""
        shape = self._usual.shape
        self.beyond = np.zeros(shape)  # how much further than learnt; it fades
        self._sum = np.zeros(shape[1])
        self._near, self._far = (np.full(shape, np.nan) for _ in range(2))
        self._largest = np.full(shape, -np.inf)
        self._streak = np.zeros(shape[1], dtype=np.int64)  # samples that were learnt

    def step(self, readings: Floats, learn: Bools | bool) -> bool:
        """
        Take a batch (batch, c), behind the median of three, NaN: none; tell whether `beyond` moved.

        learn: () or (c,).
        """
        self._count += 1
        self._sum += np.add.reduce(readings, axis=0)
        self._streak += len(readings)
        if learn is not True:
            self._streak *= learn
        if self._count % LOOKED_AT:
            return False
        mean = self._sum / self._taken
        self._sum[:] = 0.0
        missing = np.isnan(mean)
        begun = np.isnan(self._near[0]) & ~missing
        if begun.any():
            self._near[:, begun] = self._far[:, begun] = mean[begun]
        self._near += self._fast * np.where(missing, 0.0, mean - self._near)
        self._far += self._slow * np.where(missing, 0.0, mean - self._far)
        swing = np.nan_to_num(np.abs(self._near - self._far))
        np.maximum(self._largest, swing, out=self._largest)
        self.beyond *= self._fades
        np.maximum(self.beyond, swing - self._usual, out=self.beyond)
        if self._count % (BLOCK // self._taken * LOOKED_AT) == 0:
            for row, largest in enumerate(self._largest):
                self.maxima.add(row, largest, self._streak >= BLOCK)
            self._largest[:] = -np.inf
            self.refresh()
        return True

    def refresh(self) -> None:
        """Draw from the record how far channels swing."""
        usual = np.stack([self.maxima.usual(row) for row in range(len(SWINGS))])
        self._usual = np.where(np.isfinite(usual), usual, np.inf)

    def of_windows(self) -> Floats:
        """Return `beyond` of each window of the detector (windows, c)."""
        return self.beyond[np.maximum(np.arange(len(WINDOWS)) - 2, 0)]
