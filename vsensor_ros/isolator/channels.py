"""
What readings alone tell of their channel: stuck, dropped out, spiking, noisy, moving further.

Nothing here needs a model, but for the estimates beside which a quiet channel must move. How often
a channel repeats its value, how rough it is and how far it moves is learnt on the healthy machine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.isolator.block_maxima import BlockMaxima, Floats

CHANCE = 1e-9  # of a healthy channel to repeat its value as often as a stuck one
OFTEN = 0.3  # above this share of repeats, repeats alone say nothing
FEWEST_REPEATS = 5
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
PART = 0.1  # of the range that an estimate must move beside a quiet channel that is stuck

Bools = NDArray[np.bool_]


class Channels:
    """Any number of channels c, a batch of samples at a time."""

    range: Floats
    _last: Floats
    _from: Floats
    _moved: Floats
    _needed: Floats
    _cap: Floats
    _roughest: Floats
    _spike: Floats

    def __init__(self, period: float, batch: int, count: int) -> None:
        self.period, self.batch = period, batch
        # of readings above, and below; and of the roughness of a window
        self.motion = BlockMaxima(3, count)
        self.repeats, self.again, self.pairs, self.longest, self.longest_gap, self.samples = (
            np.zeros(count, dtype=np.int64) for _ in range(6))
        self.travel, self.roughness, self.usual_spike = (np.zeros(count) for _ in range(3))
        self.range = np.full((2, count), np.nan)  # least and largest healthy reading
        self.spikes = np.zeros(count, dtype=np.int64)
        # drawn from the record: repeats that are too many, what is too rough and what is a spike
        self._needed, self._cap, self._roughest, self._spike = (
            np.full(count, np.inf) for _ in range(4))
        self._count = 0
        self._fades = np.exp(-batch * period / PEAK)
        self.restart()

    def restart(self) -> None:
        """Forget the last readings, not what was learnt."""
        count = len(self.spikes)
        self.run, self.gap, self._streak = (np.zeros(count, dtype=np.int64) for _ in range(3))
        self._rests = False  # somebody repeats a value, or says nothing
        self.beyond = np.zeros(count)  # how far readings went beyond what was learnt
        self._last, self._from, self._moved = (np.full(count, np.nan) for _ in range(3))
        # readings, and the residuals of their virtual sensors
        self._both = np.full((2, self.batch + 2, count), np.nan)
        self._window = np.full((ROUGH // self.batch, self.batch, count), np.nan)  # bends
        self._extremes = np.full((2, count), -np.inf)
        self._bent, self._apart = np.zeros(count), np.zeros(count)  # sums of the block
        self._calm = np.full(count, FAR, dtype=np.int64)  # samples since the last spike

    def step(self, readings: Floats, residuals: Floats, estimates: Floats, learn: Bools | bool,
             ) -> None:
        """
        Take a batch of samples (batch, c); NaN: no reading, or nobody to estimate it.

        residuals, estimates: of the virtual sensor of each channel. learn: () or (c,).
        """
        self._count += 1
        learn = np.broadcast_to(np.asarray(learn), self.run.shape)
        both = self._both
        both[:, :2] = both[:, -2:]
        both[0, 2:], both[1, 2:] = readings, residuals
        raw = both[0]
        if not self._rests and (raw[1:-1] != raw[2:]).all() and not np.isnan(raw[1:].sum()):
            self._last, self._from = readings[-1].copy(), estimates[-1].copy()
            self.pairs += self.batch * learn
        else:
            for reading, estimate in zip(readings, estimates):
                self._repeat(reading, estimate, learn)
            self._rests = bool(self.run.any() or self.gap.any())
        low, high = np.minimum(raw[:-2], raw[1:-1]), np.maximum(raw[:-2], raw[1:-1])
        middle = np.maximum(low, np.minimum(high, raw[2:]))  # NaN beside a gap
        self._move(middle, learn)
        self._roughen(both, middle)
        if self._count % (BLOCK // self.batch) == 0:
            self._end_block()

    def _repeat(self, reading: Floats, estimate: Floats, learn: Bools) -> None:
        missing = reading != reading
        same = reading == self._last
        if learn.any():  # a gap or a run is part of a habit when it has ended
            fresh = learn & ~missing
            ended = fresh & ~same
            self.pairs += fresh
            self.repeats += ended * self.run
            self.again += ended * np.maximum(self.run - 1, 0)
            np.maximum(self.longest, ended * self.run, out=self.longest)
            np.maximum(self.longest_gap, fresh * self.gap, out=self.longest_gap)
            np.fmax(self.travel, np.where(ended & (self.run > 0), self._moved, 0.0),
                    out=self.travel)
        self.gap += 1
        self.gap *= missing
        self.run += same
        self.run *= same | missing
        self._last = np.where(missing, self._last, reading)
        self._from = np.where(self.run > 0, self._from, estimate)
        self._moved = np.abs(estimate - self._from)  # since the value was new

    def _move(self, middle: Floats, learn: Bools) -> None:
        low, high = self.range
        most, least = np.fmax.reduce(middle), np.fmin.reduce(middle)
        self.beyond *= self._fades
        np.fmax(self.beyond, np.fmax(most - high, low - least), out=self.beyond)
        np.fmax(self._extremes[0], most, out=self._extremes[0])
        np.fmax(self._extremes[1], -least, out=self._extremes[1])
        self._streak += self.batch
        self._streak *= learn

    def _roughen(self, both: Floats, middle: Floats) -> None:
        slopes = both[:, 1:] - both[:, :-1]
        bends = np.fmin.reduce(np.abs(slopes[:, 1:] - slopes[:, :-1]), axis=0)
        self._bent += bends.sum(axis=0)
        np.minimum(bends, self._cap, out=bends)
        self._window[self._count % len(self._window)] = bends
        apart = np.abs(both[0, 1:-1] - middle)
        spiked = apart > self._spike
        self._calm += self.batch
        if spiked.any():
            self.spikes += spiked.sum(axis=0)
            self._calm[spiked.any(axis=0)] = 0
        self._apart += np.minimum(apart, self._spike / 2).sum(axis=0)

    def _end_block(self) -> None:
        known = (self._streak >= BLOCK) & np.isfinite(self._extremes).all(axis=0)
        for row in (0, 1):
            self.motion.add(row, self._extremes[row], known)
        calm = known & np.isfinite(self._bent) & (self._calm >= BLOCK)
        self.motion.add(2, self.rough, calm)
        self.samples += BLOCK * calm
        share = BLOCK * calm / np.maximum(self.samples, 1)
        self.roughness += share * (np.where(calm, self._bent, 0.0) / BLOCK - self.roughness)
        self.usual_spike += share * (np.where(calm, self._apart, 0.0) / BLOCK - self.usual_spike)
        self._extremes[:] = -np.inf
        self._bent[:] = self._apart[:] = 0.0
        self.refresh()

    def refresh(self) -> None:
        """Draw from the record how far a channel moves, and how many repeats are too many."""
        usual = np.stack([-self.motion.usual(1), self.motion.usual(0)])
        self.range = np.where(np.isfinite(usual), usual, np.nan)
        share = (self.repeats + 1) / (self.pairs + 2)
        # of what rests now and then, repeats follow each other
        share = np.maximum(share, (self.again + share) / (self.repeats + 1))
        repeats = np.ceil(np.log(CHANCE) / np.log(share))
        self._needed = np.where((share < OFTEN) & (self.pairs >= KNOWN),
                                np.maximum(np.maximum(repeats, FEWEST_REPEATS), 2 * self.longest),
                                np.inf)
        known = self.samples >= KNOWN
        roughest = np.maximum(self.motion.usual(2), self.roughness)
        self._cap = np.where(known, CAP * roughest, np.inf)
        self._roughest = np.where(known, np.maximum(ROUGHER * self.roughness,
                                                    ROUGHEST * roughest), np.inf)
        least = 0.02 * (self.range[1] - self.range[0])
        self._spike = np.where(known, np.fmax(SPIKE * self.usual_spike, least), np.inf)

    def stuck(self, estimates: Floats) -> Bools:
        """Tell which repeat their value for too long, by their habit or beside estimates (c,)."""
        quiet = np.isinf(self._needed) & (self.pairs >= KNOWN)
        if not quiet.any():
            return self.run >= self._needed
        enough = np.fmax(PART * (self.range[1] - self.range[0]), 2 * self.travel)
        moved = (np.abs(estimates - self._from) > enough) & (self.run > self.longest)
        return (self.run >= self._needed) | (quiet & moved)

    @property
    def rough(self) -> Floats:
        """Mean roughness of the last window (c,); NaN: not known."""
        return self._window.mean(axis=(0, 1))

    def spiking(self) -> Bools:
        """Tell which had a spike just now."""
        return self._calm * self.period < AFTER

    def dropped(self) -> Bools:
        """Tell which have said nothing for too long."""
        return self.gap > np.maximum(MISSING / self.period, 3 * self.longest_gap)

    def noisy(self) -> Bools:
        """Tell which are far rougher than the healthy machine."""
        noisy = self.rough > self._roughest
        if noisy.any():  # all bends are larger then, not those at spikes only
            quiet = np.quantile(self._window[:, :, noisy], 0.25, axis=(0, 1))
            noisy[noisy] = quiet > QUIET * self.roughness[noisy]
        return noisy
