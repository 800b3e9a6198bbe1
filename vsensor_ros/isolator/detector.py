"""
The detector: means of residuals over windows, against what the healthy machine has shown.

Each column (a residual) goes through a median of three. Then on windows of 1, 4, 16, .. 1024
samples there are two tests: the *level* is the mean of the window, the *contrast* is that less the
mean of the four windows before it. Long windows are looked at every quarter of their length only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.isolator.block_maxima import beside, BlockMaxima, Floats, thresholds

WINDOWS = (1, 4, 16, 64, 256, 1024)  # samples
BLOCKS = tuple(min(1024, max(128, 4 * window)) for window in WINDOWS)  # samples of a base block
TESTS = 4 * len(WINDOWS)  # of a column: level and contrast, above and below
SPAN = 5 * WINDOWS[-1]  # samples that are kept
ENOUGH = 300.0  # s of a healthy machine, before which its record is not trusted
AT_ONCE = 64  # columns whose thresholds are computed in one step
GROWTH = 1.25  # of what was learnt, until thresholds are computed anew

Bools = NDArray[np.bool_]


class Detector:
    """
    The running form, of any number of columns n; a step takes a few samples (batch: 1 or 4).

    false_alarms: wanted a second and a test. prior (n,): thresholds until enough was learnt. limit
    (n,): what a sample counts as at most, so that one wild number does not stay in the sums.
    """

    def __init__(self, period: float, batch: int, false_alarms: float, prior: Floats,
                 limit: Floats) -> None:
        n, count = len(prior), len(WINDOWS)
        self.period, self.batch, self.false_alarms = period, batch, false_alarms
        self.prior, self._limit = prior, limit
        self._length = np.array([max(1, window // batch) for window in WINDOWS])  # batches
        self._strides = [max(1, window // (4 * batch)) for window in WINDOWS]
        self._blocks = [block // batch for block in BLOCKS]
        self._full = self._length[:, None] * batch + 2  # samples; and 2: the median needs them
        self.learnt = np.zeros(n, dtype=np.int64)  # samples
        # rows: level above, level below, contrast above, contrast below; each by window
        self.maxima = BlockMaxima(TESTS, n)
        self.thresholds = np.tile(prior, (TESTS, 1))
        self.high = np.zeros((2, count, n), dtype=bool)  # tests that are passed now
        self.filled = np.zeros(n, dtype=np.int64)  # samples since the start of the windows
        self._streak = np.zeros(n, dtype=np.int64)  # samples that were learnt without a gap
        self._span = SPAN // batch + 1
        self._sums = np.zeros((self._span, n))  # of all samples up to each batch
        self._past = np.zeros((SPAN // batch, batch, n))  # behind the median of three
        self._raw = np.zeros((batch + 2, n))
        self._before = np.zeros(n)  # mean of the batch before
        # by how many windows are due: batches back from which sums are taken, what turns them
        # into means, and room for the tests
        first = int(batch > 1)
        dues = {due: self._length[first:due] for due in range(1, count + 1)}
        self._places = {due: np.concatenate([w, 5 * w]) for due, w in dues.items()}
        self._scales = {due: 1.0 / (batch * np.stack([w, 4 * w])[:, :, None])
                        for due, w in dues.items()}
        self._above, self._below = (
            {due: np.zeros((2, due, n)) for due in dues} for _ in range(2))
        self._largest = np.full((2, count, n), -np.inf)
        self._least = np.full((2, count, n), np.inf)
        self._count = 0  # batches
        self._jobs: list[tuple[int, slice]] = []
        self._next = ENOUGH / period  # learnt samples at which thresholds are computed anew

    def step(self, samples: Floats, learn: Bools | bool, widened: Floats | float = 0.0) -> Bools:
        """
        Take a batch of samples (batch, n); return which columns alarm now (n,).

        samples: NaN starts the windows of a column anew. learn, () or (n,): whether the machine
        counts as healthy. widened, () or (n,): added to all thresholds of a column.
        """
        self._count += 1
        raw = self._raw
        raw[:2] = raw[-2:]
        np.clip(samples, -self._limit, self._limit, out=raw[2:])
        self.filled += self.batch
        if np.isnan(raw.sum()):
            unknown = np.isnan(raw).any(axis=0)
            raw[:, unknown] = 0.0
            self.filled[unknown] = 0
        low, high = np.minimum(raw[:-2], raw[1:-1]), np.maximum(raw[:-2], raw[1:-1])
        middle = self._past[self._count % len(self._past)]
        np.minimum(high, raw[2:], out=middle)
        np.maximum(low, middle, out=middle)
        total = np.add.reduce(middle, axis=0)
        np.add(self._sums[(self._count - 1) % self._span], total,
               out=self._sums[self._count % self._span])
        due = sum(self._count % stride == 0 for stride in self._strides)
        above, below = self._tests(due, middle)
        np.divide(total, self.batch, out=self._before)
        if self.filled.min(initial=SPAN) < 5 * self._full[due - 1]:
            for test, full in enumerate((self._full[:due], 5 * self._full[:due])):
                above[test][self.filled < full] = below[test][self.filled < full] = 0.0
        self._learn(above, below, due, learn)
        limits = self.thresholds.reshape(2, 2, len(WINDOWS), -1)[:, :, :due]
        above -= limits[:, 0]
        below += limits[:, 1]
        passed = self.high[:, :due]
        np.greater(above, widened, out=passed)
        passed |= below < np.negative(widened)
        if not self.high.any():
            return np.zeros(len(self.prior), dtype=bool)
        return np.logical_or.reduce(self.high, axis=(0, 1))

    def _tests(self, due: int, middle: Floats) -> tuple[Floats, Floats]:
        """Return level and contrast of the first windows (2, due, n), above and below."""
        first = int(self.batch > 1)  # a window of one has its extremes within a batch
        places, scale = self._places[due], self._scales[due]
        above, below = self._above[due], self._below[due]
        tests = above[:, first:]
        taken = self._sums.take(self._count - places, axis=0, mode='wrap')
        np.subtract(self._sums[self._count % self._span], taken, out=taken)
        taken = taken.reshape(tests.shape)
        taken[1] -= taken[0]
        np.multiply(taken, scale, out=tests)
        np.subtract(tests[0], tests[1], out=tests[1])
        below[:, first:] = tests
        if first:
            np.maximum.reduce(middle, axis=0, out=above[0, 0])
            np.minimum.reduce(middle, axis=0, out=below[0, 0])
            np.subtract(above[0, 0], self._before, out=above[1, 0])
            np.subtract(below[0, 0], self._before, out=below[1, 0])
        return above, below

    def _learn(self, above: Floats, below: Floats, due: int, learn: Bools | bool) -> None:
        """Keep the extremes of the blocks that run, and the record of those that end."""
        largest, least = self._largest[:, :due], self._least[:, :due]
        np.maximum(largest, above, out=largest)
        np.minimum(least, below, out=least)
        self._streak += self.batch
        if learn is True:
            self.learnt += self.batch
        else:
            self._streak *= learn
            self.learnt += self.batch * np.asarray(learn)
        if self._count % self._blocks[0] == 0:
            for w, block in enumerate(self._blocks):
                if self._count % block == 0:
                    self._end_block(w)
            most = float(self.learnt.max(initial=0))
            if most >= self._next and not self._jobs:
                self._next = GROWTH * most
                self._jobs = [(w, slice(i, i + AT_ONCE)) for w in range(len(WINDOWS))
                              for i in range(0, len(self.prior), AT_ONCE)]
        elif self._jobs:
            self._refresh(*self._jobs.pop())

    def _end_block(self, w: int) -> None:
        learnt = self._streak >= BLOCKS[w]
        for test, span in enumerate((WINDOWS[w], 5 * WINDOWS[w])):
            known = learnt & (self.filled >= BLOCKS[w] + span + 2)
            row = 2 * test * len(WINDOWS) + w
            self.maxima.add(row, self._largest[test, w], known)
            self.maxima.add(row + len(WINDOWS), -self._least[test, w], known)
        self._largest[:, w] = -np.inf
        self._least[:, w] = np.inf

    def refresh(self) -> None:
        """Compute all thresholds anew from the record."""
        for w in range(len(WINDOWS)):
            self._refresh(w, slice(None))

    def _refresh(self, w: int, columns: slice) -> None:
        trusted = self.learnt[columns] * self.period >= ENOUGH
        for row in (w, w + 2 * len(WINDOWS)):  # level, contrast
            both = slice(row, row + len(WINDOWS) + 1, len(WINDOWS))  # above and below
            maxima, count = self.maxima.maxima[:, both, columns], self.maxima.count[both, columns]
            middle = beside(maxima, count)
            off = np.stack([middle, -middle])
            block = self.period * BLOCKS[w] * self.maxima.merged[both, columns]
            found = np.add(off, thresholds(np.subtract(maxima, off), count,
                                           np.divide(1.0 / self.false_alarms, block)))
            self.thresholds[both, columns] = np.where(trusted & np.isfinite(found), found,
                                                      self.prior[columns])

    def restart(self, columns: Bools | NDArray[np.int64]) -> None:
        """Forget the samples of some columns, not what was learnt: their fault is over."""
        self.filled[columns] = 0
        self.high[:, :, columns] = False

    def past(self, column: int, samples: int) -> Floats:
        """Return the last samples of a column behind the median of three, oldest first."""
        samples = int(min(samples, self.filled[column], SPAN))
        batches = -(-samples // self.batch)
        places = (self._count - np.arange(batches - 1, -1, -1)) % len(self._past)
        return self._past[places, :, column].reshape(-1)[batches * self.batch - samples:]

    def level(self, samples: int) -> Floats:
        """Return the mean of the last samples of all columns (n,), as far as they are filled."""
        batches = np.minimum(self.filled, samples) // self.batch
        newest, n = self._sums[self._count % self._span], np.arange(len(batches))
        return (newest - self._sums[(self._count - batches) % self._span, n]) / (
            self.batch * np.maximum(batches, 1))
