"""
The detector: means of residuals over windows, against what the healthy machine has shown.

Each column (a residual) goes through a median of three. Then on windows of 1, 4, 16, .. 1024
samples there are two tests: the *level* is the mean of the window, the *contrast* is that less the
mean of the four windows before it. Long windows are looked at every quarter of their length only.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.isolator.block_maxima import beside, BlockMaxima, Floats, thresholds

WINDOWS = (1, 4, 16, 64, 256, 1024)  # samples
BLOCKS = tuple(min(1024, max(128, 4 * window)) for window in WINDOWS)  # samples of a base block
TESTS = 4 * len(WINDOWS)  # of a column: level and contrast, above and below
SPAN = 5 * WINDOWS[-1]  # samples that are kept
ENOUGH = 300.0  # s of a healthy machine, before which its record is not trusted
AT_ONCE = 64  # columns whose thresholds are computed in one step
WIDER = 0.5  # times its width is a test widened, when what alarmed is taken for healthy,
WIDEST = 3.0  # but so never to more than so many times what the record says
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
        self.prior, self.limit, self._floor = prior, limit, -limit
        # when the sum of all squares is below it, no sample is unknown or beyond its limit
        self._tame = float(limit.min(initial=np.inf))**2
        length = np.array([max(1, window // batch) for window in WINDOWS])  # batches
        self._first = int(batch > 1)  # a window of one has its extremes within a batch
        self._ages = np.stack([length, 5 * length])[:, self._first:]
        # samples of which there are sums: powers of two, so that nothing is rounded by them
        self._samples = (batch * length).astype(float)[:, None, None, None]
        self._samples[:self._first] = 1.0
        strides = [max(1, window // (4 * batch)) for window in WINDOWS]
        # how many windows are looked at, by batch; a long one is only beside all that are shorter
        self._due = [sum(i % stride == 0 for stride in strides) for i in range(strides[-1])]
        self._blocks = [block // batch for block in BLOCKS]
        self._full = length[:, None] * batch + 2  # samples; and 2: the median needs them
        self._enough = (5 * self._full[:, 0]).tolist()  # for all tests of so many windows
        # samples, but of the run that goes on
        self._learnt: NDArray[np.int64] = np.zeros(n, dtype=np.int64)
        # rows: level above, level below, contrast above, contrast below; each by window
        self.maxima = BlockMaxima(TESTS, n)
        self.thresholds = np.tile(prior, (TESTS, 1))
        # by window, above and below (both as maxima), level and contrast: what is shown now, what
        # must not be passed, and the largest of the block; all are sums
        self._shown = np.zeros((count, 2, 2, n))
        self._limits = np.tile(prior, (count, 2, 2, 1)) * self._samples
        self._largest = np.full((count, 2, 2, n), -np.inf)
        self._passed = np.zeros((count, 2, 2, n), dtype=bool)
        self.high = np.zeros((count, 2, n), dtype=bool)  # tests that are passed now
        self._any_high = False
        self.taught = np.full((TESTS, n), -np.inf)  # that thresholds are never below
        self._count = 0  # batches
        # batches at which the windows were empty, and the last that was not learnt
        self._start, self._broken = (np.zeros(n, dtype=np.int64) for _ in range(2))
        self._youngest = 0  # start of all
        self._span = SPAN // batch + 1
        self._sums = np.zeros((self._span, n))  # of all samples up to each batch
        self._past = np.zeros((SPAN // batch, batch, n))  # behind the median of three
        self._raw = np.zeros((batch + 2, n))
        self._extreme = np.empty((batch, n))  # of two samples
        self._before = np.zeros(n)  # mean of the batch before
        self._jobs: list[tuple[int, slice]] = []
        self._next = ENOUGH / period  # learnt samples at which thresholds are computed anew

    def step(self, samples: Floats, learn: Bools | bool,
             widened: Callable[[int], Floats | float] = lambda due: 0.0) -> Bools:
        """
        Take a batch of samples (batch, n); return which columns alarm now (n,).

        samples: NaN starts the windows of a column anew. learn, () or (n,): whether the machine
        counts as healthy. widened: returns what is added to the thresholds of so many windows,
        () or (n,) or (.., n), 0 or more; it is asked only when it counts.
        """
        self._count += 1
        raw = self._raw
        raw[:2] = raw[-2:]
        new = raw[2:]
        new[:] = samples
        flat = new.reshape(-1)
        if not flat.dot(flat) < self._tame:
            np.maximum(samples, self._floor, out=new)
            np.minimum(new, self.limit, out=new)
            unknown = np.logical_or.reduce(np.isnan(new))
            raw[:, unknown] = 0.0
            if np.count_nonzero(unknown):
                self._empty(unknown)
        one, other = raw[:-2], raw[1:-1]
        middle = self._past[self._count % len(self._past)]
        np.minimum(np.maximum(one, other, out=self._extreme), new, out=middle)
        np.maximum(np.minimum(one, other, out=self._extreme), middle, out=middle)
        total = np.add.reduce(middle, axis=0)
        np.add(self._sums[(self._count - 1) % self._span], total,
               out=self._sums[self._count % self._span])
        due = self._due[self._count % len(self._due)]
        shown = self._tests(due, middle)
        np.multiply(total, 1.0 / self.batch, out=self._before)
        if (self._count - self._youngest) * self.batch < self._enough[due - 1]:
            for test, full in enumerate((self._full[:due], 5 * self._full[:due])):
                np.moveaxis(shown[:, :, test], 1, 0)[:, self.filled < full] = -np.inf
        self._learn(shown, due, learn)
        limits, passed = self._limits[:due], self._passed[:due]
        np.greater(shown, limits, out=passed)
        if np.count_nonzero(passed):
            np.greater((shown - limits) / self._samples[:due], widened(due), out=passed)
        elif not self._any_high:
            return np.zeros(len(self.prior), dtype=bool)
        np.logical_or(passed[:, 0], passed[:, 1], out=self.high[:due])
        self._any_high = bool(self.high.any())
        return np.logical_or.reduce(self.high, axis=(0, 1))

    def _tests(self, due: int, middle: Floats) -> Floats:
        """Return sums of the first windows, above and below, level and contrast (due, 2, 2, n)."""
        at, first, tests = self._count % self._span, self._first, due - self._first
        old = self._sums.take(at - self._ages[:, :tests], axis=0, mode='wrap')
        newest, above = self._sums[at], self._shown[first:due, 0]
        level, contrast = above[:, 0], old[1]
        np.subtract(newest, old[0], out=level)
        np.subtract(newest, contrast, out=contrast)  # the sum of five windows
        contrast -= level
        contrast *= 0.25
        np.subtract(level, contrast, out=above[:, 1])
        np.negative(above, out=self._shown[first:due, 1])
        if first:
            above, below = self._shown[0]
            least = np.minimum.reduce(middle, axis=0)
            np.maximum.reduce(middle, axis=0, out=above[0])
            np.negative(least, out=below[0])
            np.subtract(above[0], self._before, out=above[1])
            np.subtract(self._before, least, out=below[1])
        return self._shown[:due]

    def _learn(self, shown: Floats, due: int, learn: Bools | bool) -> None:
        """Keep the extremes of the blocks that run, and the record of those that end."""
        largest = self._largest[:due]
        np.maximum(largest, shown, out=largest)
        if learn is not True:
            broken = np.flatnonzero(~np.broadcast_to(learn, self._broken.shape))
            self._end_runs(broken, self._count - 1)
            self._broken[broken] = self._count
        if self._count % self._blocks[0] == 0:
            self._end_blocks(sum(self._count % block == 0 for block in self._blocks))
            most = float(self.learnt.max(initial=0))
            if most >= self._next and not self._jobs:
                self._next = GROWTH * most
                self._jobs = [(w, slice(i, i + AT_ONCE)) for w in range(len(WINDOWS))
                              for i in range(0, len(self.prior), AT_ONCE)]
        elif self._jobs:
            self._refresh(*self._jobs.pop())

    def _end_blocks(self, due: int) -> None:
        """Put the extremes of the blocks of the first windows on record."""
        blocks, windows = (np.array(of[:due])[:, None] for of in (BLOCKS, WINDOWS))
        learnt = (self._count - self._broken) * self.batch >= blocks
        for test, span in enumerate((windows, 5 * windows)):
            known = learnt & (self.filled >= blocks + span + 2)
            for side in (0, 1):
                row = (2 * test + side) * len(WINDOWS)
                largest = self._largest[:due, side, test] / self._samples[:due, 0, 0]
                self.maxima.add(slice(row, row + due), largest, known)
        self._largest[:due] = -np.inf

    @property
    def learnt(self) -> NDArray[np.int64]:
        """How many samples each column has learnt from (n,): of less than a block, none."""
        return self._learnt + self._run(self._count)

    @learnt.setter
    def learnt(self, samples: NDArray[np.int64]) -> None:
        self._learnt = samples.copy()
        self._broken[:] = self._count

    def _run(self, end: int) -> NDArray[np.int64]:
        """Return how many samples were learnt from up to a batch since the last that was not."""
        run = (end - np.maximum(self._broken, self._start)) * self.batch
        return run * (run >= BLOCKS[0])

    def _end_runs(self, columns: Bools | NDArray[np.int64], end: int) -> None:
        self._learnt[columns] += self._run(end)[columns]

    @property
    def filled(self) -> NDArray[np.int64]:
        """How many samples there are since the start of the windows (n,)."""
        return (self._count - self._start) * self.batch

    def _empty(self, columns: Bools | NDArray[np.int64]) -> None:
        """Start the windows of some columns anew."""
        self._end_runs(columns, self._count - 1)
        self._start[columns] = self._youngest = self._count

    def refresh(self, columns: slice | NDArray[np.int64] = slice(None)) -> None:
        """Compute thresholds anew from the record."""
        for w in range(len(WINDOWS)):
            self._refresh(w, columns)

    def _refresh(self, w: int, columns: slice | NDArray[np.int64]) -> None:
        trusted = self.learnt[columns] * self.period >= ENOUGH
        for test, row in enumerate((w, w + 2 * len(WINDOWS))):  # level, contrast
            both = slice(row, row + len(WINDOWS) + 1, len(WINDOWS))  # above and below
            maxima, count = self.maxima.maxima[:, both, columns], self.maxima.count[both, columns]
            middle = beside(maxima, count)
            off = np.stack([middle, -middle])
            block = self.period * BLOCKS[w] * self.maxima.merged[both, columns]
            found = np.add(off, thresholds(np.subtract(maxima, off), count,
                                           np.divide(1.0 / self.false_alarms, block)))
            found = np.where(trusted & np.isfinite(found), found, self.prior[columns])
            most = found + (WIDEST - 1.0) * found.mean(axis=0)
            self.thresholds[both, columns] = np.maximum(
                found, np.minimum(most, self.taught[both, columns]))
            self._limits[w][:, test][:, columns] = \
                self.thresholds[both, columns] * self._samples[w]

    def full(self, columns: NDArray[np.int64]) -> bool:
        """Tell whether all windows of these are full: only then is silence no loss of samples."""
        return bool((self.filled[columns] >= self._full[-1]).all())

    def width(self, due: int) -> Floats:
        """Return half of what is between the thresholds of the first windows (due, 1, 2, n)."""
        return (self._limits[:due] / self._samples[:due]).mean(axis=1, keepdims=True)

    def admit(self, columns: NDArray[np.int64]) -> None:
        """Take what alarmed for healthy: thresholds get wider by half."""
        wider = self._limits / self._samples + WIDER * self.width(len(WINDOWS))
        # rows of the record: level and contrast, each above and below, by window
        self.taught[:, columns] = wider.transpose(2, 1, 0, 3).reshape(TESTS, -1)[:, columns]
        self.refresh(columns)

    def restart(self, columns: Bools | NDArray[np.int64]) -> None:
        """Forget the samples of some columns, not what was learnt: their fault is over."""
        self._empty(columns)
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
