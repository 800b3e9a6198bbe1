"""
What residuals (reading - estimate) and readings have been like while all was well.

Filled block by block from states that nothing late can change any more, and believed with a
delay: what a fault did before it was isolated does not count. Nor do the worst few blocks: a lone
spike says nothing of the model.

What was measured while the start was dying out counts as well, until there is better: of its mean
square what four times the variance that was stated of the start does not explain. While little
was measured, a bound of it counts, by Student's distribution.
"""

from __future__ import annotations

from collections import deque
import math
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

DELAY = 1.0  # s
_SOON = 1.0  # s, the same of slopes: nothing is said of held readings without them
_MEMORY = 100.0  # s, or 30 time constants: at least so much is remembered
_TIME_CONSTANTS = 30.0
_ENOUGH = 10.0  # s, or 30 time constants: so much in motion, and what was measured counts alone
_PROVEN = 10.0  # time constants, and at least _ENOUGH
_BLOCKS = 128  # remembered of each virtual sensor
_WORST = 20  # one block in so many is left out
_BLOCK = 0.5  # s, at least 8 rows
_FIRST = 10  # blocks that are shorter, and believed as soon as the delay allows
_FEW = 5  # of fewer none is left out
_MOVED = 3.0  # times the design's figure: a channel that moved less says nothing of the model
_TOLD_APART = 0.2  # of the rms of a residual is the estimate's, at least
_LAG = 0.1  # s over which the slope of a reading, and the mean of a residual, is taken
_LATELY = 60.0  # s: the deviation is never less than these showed
_EXPLAINED = 2.0  # stated deviations of the start: what it may do is not the model's
_WITHIN = 2.0  # stated deviations
_TWO_SIDED = 0.97725  # two deviations of a normal distribution, on one side
_SLOPES = 20  # blocks over which an rms slope is taken
_LONG = 100  # times so many blocks: of these the largest slope counts


class Rehearsal(NamedTuple):
    """What a virtual sensor was like beside the sensor lately; in the unit of the channel."""

    mean: float  # of reading - estimate
    rms: float  # of the same
    worst: float  # of the same, without its sign
    error: float  # rms of the estimate's part of it, without lone spikes; NaN when not known
    within: float  # share of readings within two deviations, as stated then, and their own noise
    seconds: float  # for which they were compared, of about the last minute


class _Block(NamedTuple):
    """What is kept of blocks of time: sums over the seconds, and at last a maximum."""

    seconds: np.ndarray  # (V,) or (V, blocks), as all others
    first: np.ndarray  # the residual
    second: np.ndarray  # its square
    noise: np.ndarray  # the variance of reading noise
    own: np.ndarray  # the reading itself
    about: np.ndarray  # its square about its mean
    slow: np.ndarray  # the square of the residual's means over _LAG
    within: np.ndarray  # whether it was as stated
    young: np.ndarray  # whether something of the start was left
    start: np.ndarray  # the variance that was stated of that
    worst: np.ndarray  # residual, without its sign


class Record:
    """
    Centre and spread of V residuals, what of their rms is the estimate's, and L rms slopes.

    `slowest` (V,): time constants [s] of the virtual sensors; `own` (V,): the reading that each
    stands in for; `period` [s] of the grid; `error` (V,): the design's figure, NaN where there is
    none, and whether it is `assumed` (V,).
    """

    def __init__(self, slowest: np.ndarray, own: np.ndarray, readings: int, period: float,
                 error: np.ndarray, assumed: np.ndarray) -> None:
        self._block = max(8, round(_BLOCK / period))  # rows
        self._own, self._period, self._error, self._assumed = own, period, error, assumed
        self._lag = min(max(2, round(_LAG / period)), self._block // 2)
        constants = _TIME_CONSTANTS * np.minimum(slowest, 1e9)
        self._enough = np.maximum(_ENOUGH, constants)
        # blocks of slow virtual sensors are put together, so that the memory is long enough
        self._long = np.maximum(_MEMORY, constants) / _BLOCKS
        # the first of each is being filled
        self._blocks = np.zeros((len(_Block._fields), len(slowest), _BLOCKS))
        self._ends = np.zeros((len(slowest), _BLOCKS), dtype=np.int64)  # index of the last in each
        self._alike = np.maximum(np.minimum(slowest, 1e9), self._block * period)  # s, see `_bound`
        self._believed = 0  # blocks so far, to _FIRST
        self._slopes: deque[np.ndarray] = deque(maxlen=_SLOPES)
        self._peaks: deque[np.ndarray] = deque(maxlen=_LONG)
        self._since_peak = 0
        # by index, blocks (.., V)
        self._waiting: deque[tuple[int, np.ndarray]] = deque()
        # mean square slopes (L,), NaN where some reading was not there
        self._heard: deque[tuple[int, np.ndarray]] = deque()
        self.slope: np.ndarray = np.full(readings, np.nan)  # (L,), 1/s, NaN where nothing is known
        self._look()

    @property
    def block(self) -> int:
        """How many rows the next block should have; the first are short, to be known soon."""
        return self._block if self._believed >= _FIRST else max(8, self._block // 2)

    def add(self, index: int, residuals: np.ndarray, counts: np.ndarray, readings: np.ndarray,
            there: np.ndarray, start: np.ndarray, newest: int) -> None:
        """
        Take a block that ends at a grid index: residuals (T, V) that count, and readings (T, L).

        start (V,): standard deviation that was stated of what was left of the start; NaN: nothing
        was. newest: the grid index by now. What was taken long enough ago is believed from now on.
        """
        T = len(residuals)
        with np.errstate(all='ignore'):
            residuals = np.where(counts, residuals, 0.0)
            noise, slope = self._apart(readings)
            noise = np.where(there.all(axis=0), np.maximum(noise, 0.0), 0.0)[self._own]
            noise = np.where(counts.all(axis=0), np.minimum(
                noise, np.maximum(self._apart(residuals)[0], 0.0)), 0.0)
            own, n = np.where(counts, readings[:, self._own], 0.0), counts.sum(axis=0)
            about = np.where(counts, own - own.sum(axis=0) / np.maximum(n, 1), 0.0)
            young = np.where(np.isnan(start), 0, n)
            start = np.where(young > 0, start**2, 0.0)
            within = counts & (residuals**2 <= _WITHIN**2 * (
                self.in_steady_state()**2 + start + noise))
            block = np.array(_Block(
                n, residuals.sum(axis=0), (residuals**2).sum(axis=0), noise * T, own.sum(axis=0),
                (about**2).sum(axis=0), (self._slowly(residuals)**2).mean(axis=0) * n,
                within.sum(axis=0), young, start * np.maximum(n, 1),
                np.abs(residuals).max(axis=0)))
            block[:-1] *= self._period
        self._waiting.append((index, block))
        self._heard.append((index, np.where(there.all(axis=0), slope, np.nan)))
        # of the first few one learns as soon as the delay allows
        while self._waiting and (newest if self._believed < _FIRST else index) - \
                self._waiting[0][0] >= DELAY / self._period:
            self._believe(*self._waiting.popleft())
        while self._heard and index - self._heard[0][0] >= _SOON / self._period:
            self._slopes.append(self._heard.popleft()[1])
            self._since_peak += 1
        self._look()

    def _slowly(self, values: np.ndarray) -> np.ndarray:
        """Return the means (n, V) of columns (T, V) over the lag."""
        lag = max(1, round(_LAG / self._period))
        n = max(1, len(values) // lag)
        return np.asarray(values[-n * lag:].reshape(n, -1, values.shape[1]).mean(axis=1))

    def _apart(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Tell the variance of white noise in columns from their mean square slope [1/s^2].

        The noise adds as much to differences over one row as to those over the lag. So the slope
        may be found below 0 by chance.
        """
        near, far = (np.mean((values[n:] - values[:-n])**2, axis=0) for n in (1, self._lag))
        slope = (far - near) / (self._lag**2 - 1)
        return (near - np.maximum(slope, 0.0)) / 2, slope / self._period**2

    def _believe(self, index: int, new: np.ndarray) -> None:
        self._believed = min(self._believed + 1, _FIRST)
        full = self._blocks[0, :, 0] >= self._long
        self._blocks[:, full, 1:] = self._blocks[:, full, :-1]
        self._blocks[:, full, 0] = 0.0
        self._ends[full, 1:], self._ends[:, 0] = self._ends[full, :-1], index
        with np.errstate(all='ignore'):
            self._blocks[:-1, :, 0] += new[:-1]
        np.fmax(self._blocks[-1, :, 0], new[-1], out=self._blocks[-1, :, 0])

    def _look(self) -> None:
        with np.errstate(all='ignore'):
            self._look_at_residuals()
            if self._slopes:
                self._look_at_slopes()

    def _look_at_residuals(self) -> None:
        sums = _Block(*self._blocks)
        seconds, heard = sums.seconds, sums.seconds > 0.0
        there = heard & (sums.young == 0.0)
        mean, at = sums.first / seconds, sums.own / seconds
        self.centre = _median(mean, there)  # (V,), NaN where nothing is known
        c = self.centre[:, None]
        off = np.where(there, np.abs((sums.second - 2.0 * c * sums.first) / seconds + c**2),
                       np.inf)
        kept = _without_worst(off, there)
        known = there.any(axis=1)
        # the most of them, because motion comes and goes
        self.shown = np.sqrt(np.where(known, np.where(kept, off, 0.0).max(axis=1), np.nan))
        # of a channel that rests one learns nothing of the model
        far = (at - _median(at, there)[:, None])**2 + sums.about / seconds - sums.noise / seconds
        moves = _without_worst(off, there & (far > (_MOVED * self._error[:, None])**2))
        enough = moves.sum(axis=1) >= _FEW
        moving = np.where(moves, seconds, 0.0).sum(axis=1)
        in_motion = _rms(moves, seconds, sums.second, sums.noise)
        # in its motion alone, NaN where that was not enough
        self.alone = np.where(self._assumed & (moving >= self._enough), in_motion, np.nan)
        self.spread = np.where(np.isnan(self.alone), np.fmax(self.shown, self._error),
                               self.shown)
        # from here on the first blocks count, too, while there are few others
        excess = np.where(there, sums.second, sums.second - _EXPLAINED**2 * sums.start)
        there = there | (heard & (excess > 0.0) & (there.sum(axis=1) < _FEW)[:, None])
        off = np.where(there, excess / seconds, np.inf)
        kept = _without_worst(off, there)
        self.rms = np.fmax(
            self._bound(kept, seconds) * _rms(kept, seconds, excess, sums.noise),
            np.where(enough, self._bound(moves, seconds) * in_motion, np.nan))
        self.lately = _rms(_without_worst(off, there & self._latest()), seconds, excess,
                           sums.noise)
        self.slowly = _rms(kept, seconds, sums.slow, np.zeros_like(seconds))

    def _bound(self, kept: np.ndarray, seconds: np.ndarray) -> np.ndarray:
        """
        Return by how much (V,) an rms over these blocks may be too small.

        Two standard deviations then hold as many as of a normal distribution. Errors within a time
        constant are alike: they count once.
        """
        n = np.where(kept, seconds, 0.0).sum(axis=1) / self._alike
        return np.asarray(stdtrit(np.maximum(n, 1.0), _TWO_SIDED) / 2.0)

    def _latest(self) -> np.ndarray:
        """Tell which blocks (V, blocks) are of the last minute."""
        seconds = self._blocks[0]
        return np.asarray(np.cumsum(seconds, axis=1) - seconds < _LATELY)

    def rehearsal(self, row: int) -> Rehearsal | None:
        """Return what the last minute of a virtual sensor was like; None: nothing is known."""
        sums = _Block(*self._blocks[:, row])
        latest = self._latest()[row] & (sums.seconds > 0.0)
        if not latest.any():
            return None
        settled = latest & (sums.young == 0.0)
        latest = settled if settled.any() else latest
        blocks = self._blocks[:, row, latest]
        sums = _Block(*blocks.sum(axis=1))
        return Rehearsal(*(float(found) for found in (
            sums.first / sums.seconds, np.sqrt(sums.second / sums.seconds), blocks[-1].max(),
            self.lately[row], sums.within / sums.seconds, sums.seconds)))

    def proven(self, row: int) -> bool:
        """Tell whether a virtual sensor was compared for so long that its deviation is known."""
        return bool(self._blocks[0, row].sum() >= max(_ENOUGH, _PROVEN * self._alike[row]))

    def _look_at_slopes(self) -> None:
        slopes = np.array(self._slopes)
        slopes = np.sort(np.where(np.isfinite(slopes), slopes, np.inf), axis=0)
        known = np.isfinite(slopes).sum(axis=0)
        kept = np.arange(len(slopes))[:, None] < known - (known >= _FEW)
        recent = np.where(kept, slopes, 0.0).sum(axis=0) / kept.sum(axis=0)
        if self._since_peak >= _SLOPES:
            self._since_peak = 0
            self._peaks.append(recent)
        for peak in self._peaks:
            recent = np.fmax(recent, peak)
        self.slope = np.sqrt(np.maximum(recent, 0.0))

    def forget(self, rows: np.ndarray | None = None, readings: np.ndarray | None = None,
               since: float = math.inf) -> None:
        """
        Forget what is not yet believed of some virtual sensors and readings, or of all.

        since: the grid index from which on what is believed of these is forgotten, too.
        """
        if rows is None:
            self._waiting.clear()
            self._heard.clear()
        elif (late := rows[:, None] & (self._ends >= since) & (self._blocks[0] > 0.0)).any():
            self._blocks[:, late] = 0.0
            self._look()
        for _, block in self._waiting:
            block[:, rows] = 0.0
        for _, slopes in self._heard:
            slopes[readings] = np.nan

    def in_steady_state(self) -> np.ndarray:
        """
        Return the standard deviation (V,) of each estimate; infinite where not known.

        What was measured may raise the design's figure. Where that is assumed it counts until
        enough has been measured while the channel moved. It is never less than of late.
        """
        found = np.fmax(self.lately, np.where(
            np.isnan(self.alone), np.fmax(self._error, self.rms), self.alone))
        return np.where(np.isnan(found), np.inf, found)


def _median(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return the median of those that are there in each row; NaN where none is."""
    ordered = np.sort(np.where(there, values, np.inf), axis=1)
    n = there.sum(axis=1)[:, None]
    low, high = (np.take_along_axis(ordered, np.maximum(i, 0), axis=1)[:, 0]
                 for i in ((n - 1) // 2, n // 2))
    return np.where(n[:, 0] > 0, low + (high - low) / 2, np.nan)


def _without_worst(off: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return those that are there but the worst in each row."""
    n = there.sum(axis=1)
    out = np.where(n >= _FEW, np.maximum(n // _WORST, 1), 0)
    ordered = np.sort(np.where(there, off, -np.inf), axis=1)
    limit = np.take_along_axis(ordered, (off.shape[1] - out - 1)[:, None], axis=1)
    return there & (off <= limit)


def _rms(kept: np.ndarray, seconds: np.ndarray, second: np.ndarray,
         noise: np.ndarray) -> np.ndarray:
    """Return the rms of the estimate's part of residuals, NaN where nothing is kept."""
    weight, square, noise = (np.where(kept, x, 0.0).sum(axis=1) for x in (seconds, second, noise))
    # the reading's noise is not known so well that less could be told from it
    return np.sqrt(np.maximum(square - noise, _TOLD_APART**2 * square) / weight)
