"""
What readings alone tell of their channel: stuck, dropped out, spiking, noisy, moving further.

Nothing here needs a model, but for the estimates beside which a quiet channel must move. How often
a channel repeats its value, how rough it is and how far it moves is learnt on the healthy machine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.isolator.block_maxima import BlockMaxima, Floats
from vsensor_ros.isolator.detector import ENOUGH
from vsensor_ros.isolator.steps import largest_step, least_step, STRIDE

CHANCE = 1e-9  # of a healthy channel to repeat its value as often as a stuck one
OFTEN = 0.3  # above this share of repeats, repeats alone say nothing
FEWEST_REPEATS = 5
FEWEST_RUNS = 10  # of repeats, before which it is not known how long a quiet channel rests
KNOWN = 1000  # samples, before which the habits of a channel are not known
MISSING = 0.2  # s without a reading, at least, before a channel has dropped out
ROUGH = 64  # samples of the window of roughness
ROUGHER = 2.0  # times the healthy roughness
ROUGHEST = 1.5  # times the roughest windows that the healthy machine showed
# times the healthy roughness three of four bends are above, of a noisy channel; healthy: 0.4
QUIET = 1.3
CAP = 3.0  # times the healthy roughness is what one bend counts as at most, so spikes are few
BLOCK = 128  # samples
PEAK = 20.0  # s in which a peak of motion is forgotten to 1/e
SPIKE = 10.0  # times the usual distance from the median of three
AFTER = 5.0  # s after a spike in which a channel counts as spiking
FAR = 2**40  # samples
NEARLY = 1.0 - 1e-9  # sums differ by their order
PART = 0.1  # of the range that an estimate must move beside a quiet channel that is stuck

Bools = NDArray[np.bool_]
Counts = NDArray[np.int64]


def _slopes(kept: Floats, new: Floats) -> Floats:
    """Put samples behind the last two that were kept; return their differences."""
    kept[:2] = kept[-2:]
    kept[2:] = new
    return kept[1:] - kept[:-1]


class Channels:
    """Any number of channels c, a batch of samples at a time."""

    range: Floats
    run: Counts
    gap: Counts
    _last: Floats
    _from: Floats
    _moved: Floats
    _reach: Floats
    _beyond: Floats
    _needed: Floats
    _cap: Floats
    _roughest: Floats
    _spike: Floats
    _step: Floats

    def __init__(self, period: float, batch: int, count: int) -> None:
        self.period, self.batch = period, batch
        # of readings above, and below; and of the roughness of a window
        self.motion = BlockMaxima(3, count)
        self.steps = BlockMaxima(1, count)
        self.repeats, self.again, self.pairs, self.longest, self.longest_gap, self.samples = (
            np.zeros(count, dtype=np.int64) for _ in range(6))
        self.travel, self.roughness, self.usual_spike = (np.zeros(count) for _ in range(3))
        self.range = np.full((2, count), np.nan)  # least and largest healthy reading
        self.spikes = np.zeros(count, dtype=np.int64)
        # drawn from the record: how far it reaches, upwards and downwards; repeats that are too
        # many, what is too rough and what is a spike
        self._usual = np.full((3, count), -np.inf)
        self._reach = np.full((2, count), np.nan)
        self._needed, self._cap, self._roughest, self._spike, self._step = (
            np.full(count, np.inf) for _ in range(5))
        self._count = 0  # batches
        self.spiked = False  # whether any did in the last batch
        self._fades = np.exp(-batch * period / PEAK)
        # of the block that runs: medians of three, distances from them, and bends
        self._middle, self._apart, self._bends = (np.empty((BLOCK, count)) for _ in range(3))
        self.restart()

    def restart(self) -> None:
        """Forget the last readings, not what was learnt."""
        count = len(self.spikes)
        self.run, self.gap = (np.zeros(count, dtype=np.int64) for _ in range(2))
        self._flows = False  # whether the last value of each channel was a new one
        self._last, self._from, self._moved = (np.full(count, np.nan) for _ in range(3))
        # readings, and the residuals of their virtual sensors
        self._raw, self._shown = (np.full((self.batch + 2, count), np.nan) for _ in range(2))
        self._window = np.full((ROUGH // self.batch, self.batch, count), np.nan)  # bends
        self._bent = np.full((ROUGH // self.batch, count), np.nan)  # their sums, by batch
        self._beyond = np.zeros(count)
        self._looked = self._count  # batches up to which that was drawn from the medians
        self._middle[:] = np.nan
        # batches that were the last that was not learnt, and the last with a spike
        self._broken = np.full(count, self._count, dtype=np.int64)
        self._spiked = np.full(count, self._count - FAR, dtype=np.int64)

    def step(self, readings: Floats, residuals: Floats, estimates: Floats, learn: Bools | bool,
             ) -> None:
        """
        Take a batch of samples (batch, c); NaN: no reading, or nobody to estimate it.

        residuals, estimates: of the virtual sensor of each channel. learn: () or (c,).
        """
        self._count += 1
        if learn is not True:
            self._broken[np.broadcast_to(np.logical_not(learn), self.run.shape)] = self._count
        raw = self._raw
        slopes, shown = _slopes(raw, readings), _slopes(self._shown, residuals)
        # the usual case; not NaN
        if self._flows and np.minimum.reduce(np.abs(slopes[1:]), axis=None) > 0.0:
            self._last[:], self._from[:] = readings[-1], estimates[-1]
            self.pairs += self.batch if learn is True else self.batch * learn
        else:
            self._repeat(raw, estimates, learn)
            self._flows = not (self.run.any() or self.gap.any())
        start = (self._count - 1) % (BLOCK // self.batch) * self.batch
        block = slice(start, start + self.batch)
        self._see_spikes(raw, self._middle[block], self._apart[block])
        self._roughen(slopes, shown, self._bends[block])
        if self._count % (BLOCK // self.batch) == 0:
            self._end_block()

    def _repeat(self, raw: Floats, estimates: Floats, learn: Bools | bool) -> None:
        """Count repeats and gaps of a batch. Row k is before sample k, row k + 1 after it."""
        missing = np.isnan(raw[2:])
        some = np.count_nonzero(missing) > 0
        last, begun = raw[1:].copy(), np.vstack([self._from, estimates])
        runs, gaps = (np.zeros(last.shape, dtype=np.int64) for _ in range(2))
        last[0], runs[0], gaps[0] = self._last, self.run, self.gap
        if some:
            for k, none in enumerate(missing):
                np.copyto(last[k + 1], last[k], where=none)
                gaps[k + 1] = (gaps[k] + 1) * none
        same = raw[2:] == last[:-1]
        stays = same | missing if some else same
        for k in range(self.batch):
            runs[k + 1] = (runs[k] + same[k]) * stays[k]
            np.copyto(begun[k + 1], begun[k], where=runs[k + 1] > 0)
        moved = np.abs(estimates - begun[1:])  # since the value was new
        if learn is True or np.any(learn):  # a gap or a run is part of a habit when it has ended
            fresh = ~missing & learn
            self.pairs += np.add.reduce(fresh, axis=0, dtype=np.int64)
            ended = runs[:-1] * (fresh & ~same)
            self.repeats += np.add.reduce(ended)
            self.again += np.add.reduce(np.maximum(ended - 1, 0))
            np.maximum(self.longest, np.maximum.reduce(ended), out=self.longest)
            np.maximum(self.longest_gap, np.maximum.reduce(gaps[:-1] * fresh),
                       out=self.longest_gap)
            went = np.vstack([self._moved, moved[:-1]])
            went[ended == 0] = 0.0
            np.fmax(self.travel, np.fmax.reduce(went), out=self.travel)
        self._last, self._from, self._moved = last[-1], begun[-1], moved[-1]
        self.run, self.gap = runs[-1], gaps[-1]

    def _see_spikes(self, raw: Floats, middle: Floats, apart: Floats) -> None:
        """Fill in the medians of three and how far readings are from them."""
        np.minimum(np.maximum(raw[:-2], raw[1:-1]), raw[2:], out=middle)
        np.maximum(np.minimum(raw[:-2], raw[1:-1]), middle, out=middle)  # NaN beside a gap
        np.subtract(raw[1:-1], middle, out=apart)
        np.abs(apart, out=apart)
        spiked = apart > self._spike
        self.spiked = np.count_nonzero(spiked) > 0
        if self.spiked:
            self.spikes += spiked.sum(axis=0)
            self._spiked[spiked.any(axis=0)] = self._count

    def _roughen(self, slopes: Floats, shown: Floats, bends: Floats) -> None:
        """Fill in how much both readings and residuals bend."""
        one, other = slopes[1:] - slopes[:-1], shown[1:] - shown[:-1]
        np.fmin(np.abs(one, out=one), np.abs(other, out=other), out=bends)
        place = self._count % len(self._window)
        np.minimum(bends, self._cap, out=self._window[place])
        np.add.reduce(self._window[place], axis=0, out=self._bent[place])

    @property
    def beyond(self) -> Floats:
        """How far readings went beyond what was learnt (c,); that is forgotten again."""
        behind = self._count - self._looked
        if behind:
            end = (self._count - 1) % (BLOCK // self.batch) + 1
            middle = self._middle.reshape(-1, self.batch, len(self._beyond))[end - behind:end]
            further = np.fmax(np.fmax.reduce(middle, axis=1) - self._reach[0],
                              -np.fmin.reduce(middle, axis=1) - self._reach[1])
            for row in further:
                self._beyond *= self._fades
                np.fmax(self._beyond, row, out=self._beyond)
            self._looked = self._count
        return self._beyond

    def _end_block(self) -> None:
        extremes = np.stack([np.fmax.reduce(self._middle), -np.fmin.reduce(self._middle)])
        known = (self._count - self._broken >= BLOCK // self.batch) \
            & np.isfinite(extremes).all(axis=0)
        stepped = largest_step(self._middle, STRIDE)
        self.steps.add(0, stepped, known & np.isfinite(stepped))
        before = self.motion.count.copy()
        for row in (0, 1):
            self.motion.add(row, extremes[row], known)
        bent = self._of_block(np.minimum(self._bends, self._cap))  # a jump is no roughness
        calm = known & np.isfinite(bent) & (
            self._count - self._spiked >= BLOCK // self.batch)
        self.motion.add(2, self.rough, calm)
        self.samples += BLOCK * calm
        apart = self._of_block(np.minimum(self._apart, self._spike / 2))
        share = BLOCK * calm / np.maximum(self.samples, 1)
        self.roughness += share * (np.where(calm, bent, 0.0) / BLOCK - self.roughness)
        self.usual_spike += share * (np.where(calm, apart, 0.0) / BLOCK - self.usual_spike)
        self._refresh(np.flatnonzero((self.motion.count != before).any(axis=1)).tolist())

    def _of_block(self, samples: Floats) -> Floats:
        return np.add.reduce(np.add.reduce(samples.reshape(-1, self.batch, samples.shape[1]), 1))

    def refresh(self) -> None:
        """Draw from the record how far a channel moves, and how many repeats are too many."""
        self._refresh([0, 1, 2])

    def _refresh(self, rows: list[int]) -> None:
        """Do so; rows: of the motion, in which there is something new."""
        self._beyond = self.beyond  # by what was known until now
        for row in rows:
            self._usual[row] = self.motion.usual(row)
        self._reach = np.where(np.isfinite(self._usual[:2]), self._usual[:2], np.nan)
        self.range = np.stack([-self._reach[1], self._reach[0]])
        share = (self.repeats + 1) / (self.pairs + 2)
        # of what rests now and then, repeats follow each other
        share = np.maximum(share, (self.again + share) / (self.repeats + 1))
        repeats = np.ceil(np.log(CHANCE) / np.log(share))
        self._needed = np.where((share < OFTEN) & (self.pairs >= KNOWN),
                                np.maximum(np.maximum(repeats, FEWEST_REPEATS), 2 * self.longest),
                                np.inf)
        known = self.samples >= KNOWN
        roughest = np.maximum(self._usual[2], self.roughness)
        self._cap = np.where(known, CAP * roughest, np.inf)
        self._roughest = np.where(known, np.maximum(ROUGHER * self.roughness,
                                                    ROUGHEST * roughest), np.inf)
        least = 0.02 * (self.range[1] - self.range[0])
        self._spike = np.where(known, np.fmax(SPIKE * self.usual_spike, least), np.inf)
        self._step = least_step(self.steps, BLOCK * self.period, ENOUGH)

    def stuck(self, estimates: Floats) -> Bools:
        """Tell which repeat their value for too long, by their habit or beside estimates (c,)."""
        if self._flows:
            return np.zeros(len(self.run), dtype=bool)
        stuck, late = self.run >= self._needed, self.run > self.longest
        if np.count_nonzero(late):
            quiet = late & np.isinf(self._needed) & (self.pairs >= KNOWN) & (
                self.repeats - self.again >= FEWEST_RUNS)
            enough = np.fmax(PART * (self.range[1] - self.range[0]), 2 * self.travel)
            stuck |= quiet & (np.abs(estimates - self._from) > enough)
        return stuck

    @property
    def rough(self) -> Floats:
        """Mean roughness of the last window (c,); NaN: not known."""
        return np.add.reduce(self._window, axis=(0, 1)) / ROUGH

    def spiking(self) -> Bools:
        """Tell which had a spike just now."""
        return (self._count - self._spiked) * self.batch * self.period < AFTER

    def stepped(self) -> Bools:
        """Tell which jumped within the last block, further than healthy ones do (c,)."""
        end = (self._count - 1) % (BLOCK // self.batch) + 1
        recent = np.roll(self._middle, -end * self.batch, axis=0)
        return largest_step(recent) > self._step

    def dropped(self) -> Bools:
        """Tell which have said nothing for too long."""
        if not np.count_nonzero(self.gap):
            return np.zeros(len(self.gap), dtype=bool)
        return self.gap > np.maximum(MISSING / self.period, 3 * self.longest_gap)

    def noisy(self) -> Bools:
        """Tell which are far rougher than the healthy machine."""
        noisy = np.add.reduce(self._bent) > NEARLY * ROUGH * self._roughest
        if np.count_nonzero(noisy):  # all bends are larger then, not those at spikes only
            noisy = self.rough > self._roughest
            quiet = np.quantile(self._window[:, :, noisy], 0.25, axis=(0, 1))
            noisy[noisy] = quiet > QUIET * self.roughness[noisy]
        return noisy
