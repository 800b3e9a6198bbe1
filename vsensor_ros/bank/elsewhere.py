"""
How far the machine is from where its virtual sensors are known to be good.

Off the operating point a model errs more than it did while the failed sensor was compared with it.
The healthy sensors that a virtual sensor reads have virtual sensors, too. Where these read no
failed sensor either, they go on being compared, and by as much as their residuals exceed what is
usual of them the deviation is widened. A single residual says nothing under its noise, so their
means over a while are looked at.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np

from vsensor_ros.observers import Batch

WHILE = 0.1  # s over which a mean is taken
_MEANS = 5  # whose rms counts
# of both the larger is still usual; found on simulated pendulums of one and two links and random
# linear plants: there the deviation grows by 4 % in the mean where the model holds
_OF_MEANS = 2.0  # times the rms that such means had while all was healthy
_OF_DEVIATION = 0.5  # times the deviation


class Elsewhere:
    """
    Means of O residuals lately, beside what is usual; ticks are grid indices.

    `sensors`: names of the L sensors; `period` [s] of the grid.
    """

    def __init__(self, batch: Batch, sensors: tuple[str, ...], period: float) -> None:
        reads, own = batch.runs_on[batch.of][:, :len(sensors)], batch.own
        failed = np.array([[s in fault_set for s in sensors] for fault_set, _ in batch.keys],
                          dtype=bool).reshape(reads.shape)
        # [i, j]: j stands for a sensor that i reads, and goes on when those that fail i's have
        tells = reads[:, own] & ~((failed.astype(int) @ reads.T.astype(int)) > 0) \
            & ~reads[np.arange(len(own)), own] & (own >= 0)
        self._tells = tells
        self._rows = max(1, round(WHILE / period))
        self._usual: np.ndarray = np.full(len(own), np.inf)  # (O,)
        self.told_of: list[bool] = tells.any(axis=1).tolist()  # anybody tells of an output
        self.restart()

    def restart(self) -> None:
        """Forget the means."""
        self._squares: deque[np.ndarray] = deque(maxlen=_MEANS)  # (O,), NaN where nothing is known
        self._done: float = -np.inf  # the last tick that is in a mean
        # by output: by what factor its deviation is larger than was known, 1 or more
        self.widening: list[float] = [1.0] * len(self.told_of)

    def forget(self, outputs: np.ndarray) -> None:
        """Forget those of some outputs (O,) bool."""
        for squares in self._squares:
            squares[outputs] = np.nan
        self._compare()

    def note_usual(self, slowly: np.ndarray, deviation: np.ndarray) -> None:
        """Note rms means (O,), NaN where not known, and standard deviations (O,) as usual."""
        slowly = np.where(np.isnan(slowly), deviation, slowly)
        self._usual = np.fmax(_OF_MEANS * slowly, _OF_DEVIATION * deviation)

    def due(self, oldest: int, newest: int) -> Iterator[tuple[int, int]]:
        """Yield (first, end) of the ticks whose mean can be taken: later, readings may lack."""
        last = newest - self._rows
        done = int(max(self._done, last - _MEANS * self._rows, oldest - 1))
        while last - done >= self._rows:
            yield done + 1, done + 1 + self._rows
            done += self._rows
            self._done = done

    def take(self, residuals: np.ndarray, counts: np.ndarray) -> None:
        """Take the residuals (T, O) of such ticks; a mean counts when all of them do."""
        with np.errstate(all='ignore'):
            self._squares.append(np.where(
                counts.all(axis=0), residuals.mean(axis=0)**2, np.nan))
        self._compare()

    def _compare(self) -> None:
        """Compare the means with what is usual."""
        if not self._squares:
            return
        squares = np.array(self._squares)
        known = np.isfinite(squares)
        with np.errstate(all='ignore'):
            off = np.sqrt(np.where(known, squares, 0.0).sum(axis=0) / known.sum(axis=0)) \
                / self._usual
            self.widening = np.fmax(1.0, np.where(self._tells, off, 0.0)).max(axis=1).tolist()
