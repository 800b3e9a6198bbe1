"""
How far a machine moves within windows, beside what it did while its thresholds were learnt.

What a model errs by is in proportion to the motion, so that thresholds have to be, too. The motion
of a channel is taken from its estimate, which does not read the channel: its own fault does not
look like motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.isolator.block_maxima import Floats
from vsensor_ros.isolator.detector import ENOUGH, GROWTH, SPAN

WINDOWS = (4, 16, 64, 256, 1024)  # samples
ROWS = 2 * len(WINDOWS)  # level and contrast of each, as the detector has them
CONTRASTS = slice(len(WINDOWS), ROWS)
LOOK = 128  # samples, after which motion is learnt; in between it is looked at when it counts
PEAK = 20.0  # s in which a peak is forgotten to 1/e
SPARE = 0.25  # of what was learnt is spared in the thresholds anyway
FAR = 2**40  # samples
WILD = 1e12  # what is not below it is no estimate

Bools = NDArray[np.bool_]


class Motion:
    """
    Of channels c. beyond (ROWS, c): motion beyond what was learnt, as a share of it.

    Share of the range of its own window, level or contrast.
    """

    _filled: NDArray[np.int64]  # samples since the start of the windows
    _streak: NDArray[np.int64]  # samples that were healthy without a gap

    def __init__(self, period: float, batch: int, count: int) -> None:
        self.period, self.batch = period, batch
        self.swings = np.full((2, ROWS, count), -np.inf)  # healthy: most, and least with sign -
        self.learnt = 0  # samples
        self._used = self.swings.copy()  # what the thresholds know of
        self._next = ENOUGH / period
        self._rows = LOOK // batch
        self._waiting = np.zeros((self._rows, count))  # sums of batches that are to be looked at
        self._sums = np.zeros((SPAN // batch + self._rows + 1, count))  # up to each batch
        self._count = 0  # batches that were looked at
        self.restart()

    def restart(self) -> None:
        """Forget the samples, not what was learnt."""
        count = self._sums.shape[1]
        self.beyond = np.zeros((ROWS, count))
        self._filled, self._streak = (np.zeros(count, dtype=np.int64) for _ in range(2))
        self._healthy = np.ones(count, dtype=bool)  # since the last block
        self._block = np.full(self.swings.shape, -np.inf)
        self._held = 0

    def step(self, estimates: Floats, learn: Bools | bool) -> None:
        """Take estimates (batch, c); learn, () or (c,): whether they count as healthy."""
        np.add.reduce(estimates, axis=0, out=self._waiting[self._held])
        self._held += 1
        if learn is not True:
            self._healthy &= learn
        if (self._count + self._held) % self._rows == 0:
            self.look()
            self._learn()

    def look(self) -> None:
        """Look at what came in, so that `beyond` is of now."""
        held, self._held = self._held, 0
        if not held:
            return
        totals = self._waiting[:held]
        wrong = ~(np.abs(totals) < WILD)
        self._filled += held * self.batch
        if wrong.any():
            totals[wrong] = 0.0
            since = np.argmax(wrong[::-1], axis=0) * self.batch
            self._filled = np.where(wrong.any(axis=0), since, self._filled)
        places = self._count + np.arange(1, held + 1)
        self._sums[places % len(self._sums)] = (
            self._sums[self._count % len(self._sums)] + totals.cumsum(axis=0))
        self._count += held
        shown = self._shown(places)
        np.maximum(self._block, shown, out=self._block)
        half = self._used.sum(axis=0) / 2
        known = half > 0.0
        share = np.zeros(half.shape)
        np.divide((shown - np.where(known, self._used, np.inf)).max(axis=0), half, out=share,
                  where=known)
        self.beyond *= np.exp(-held * self.batch * self.period / PEAK)
        np.maximum(self.beyond, share - SPARE, out=self.beyond)

    def _shown(self, places: NDArray[np.int64]) -> Floats:
        """Return the most, and the least with the other sign, of all windows (2, ROWS, c)."""
        shown = np.full(self.swings.shape, -np.inf)
        least = self._filled.min(initial=FAR)
        for w, window in enumerate(WINDOWS):
            length = window // self.batch
            at = places[places % max(1, length // 4) == 0]
            if not at.size:
                continue
            newest, middle, oldest = self._sums.take(
                at % len(self._sums) - [[0], [length], [5 * length]], axis=0, mode='wrap')
            tests = np.empty((2, *newest.shape))  # level and contrast
            np.subtract(newest, middle, out=tests[0])
            tests[0] /= window
            np.subtract(middle, oldest, out=tests[1])
            tests[1] /= 4 * window
            np.subtract(tests[0], tests[1], out=tests[1])
            rows = shown[:, w::len(WINDOWS)]
            np.maximum.reduce(tests, axis=1, out=rows[0])
            np.negative(np.minimum.reduce(tests, axis=1), out=rows[1])
            if least < 5 * window + (self._count - int(at[0])) * self.batch:
                filled = self._filled - (self._count - at)[:, None] * self.batch >= 5 * window
                for side, sign in enumerate((1.0, -1.0)):
                    rows[side] = np.where(filled, sign * tests, -np.inf).max(axis=1)
        return shown

    def _learn(self) -> None:
        """Keep what a block has shown, where the whole of its windows was healthy."""
        self._streak = np.where(self._healthy, self._streak + LOOK, 0)
        span = LOOK + 5 * np.tile(WINDOWS, 2)[:, None]
        np.maximum(self.swings, np.where(self._streak >= span, self._block, -np.inf),
                   out=self.swings)
        self.learnt += LOOK * bool(self._healthy.any())
        self._block[:] = -np.inf
        self._healthy[:] = True
        if self.learnt >= self._next:
            self._next = GROWTH * self.learnt
            self.use()

    def use(self) -> None:
        """Let all that was learnt be what motion is held against."""
        self._used = self.swings.copy()

    @property
    def range(self) -> Floats:
        """Half of the largest swing that is known (c,)."""
        half = self._used.sum(axis=0) / 2
        return np.where(np.isfinite(half), half, 0.0).max(axis=0)
