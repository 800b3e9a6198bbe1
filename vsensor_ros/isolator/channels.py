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
        # drawn from the record: how far it reaches, upwards and downwards; repeats that are too
        # many, what is too rough and what is a spike
        self._usual = np.full((3, count), -np.inf)
        self._reach = np.full((2, count), np.nan)
        self._needed, self._cap, self._roughest, self._spike = (
            np.full(count, np.inf) for _ in range(4))
        self._count = 0
        self._fades = np.exp(-batch * period / PEAK)
        # of the block that runs: bends, distances from the median, and extremes of each batch
        self._bends, self._apart = (np.empty((BLOCK, count)) for _ in range(2))
        self._extremes = np.empty((BLOCK // batch, 2, count))
        self.restart()

    def restart(self) -> None:
        """Forget the last readings, not what was learnt."""
        count = len(self.spikes)
        self.run, self.gap = (np.zeros(count, dtype=np.int64) for _ in range(2))
        self._flows = False  # whether the last value of each channel was a new one
        self.beyond = np.zeros(count)  # how far readings went beyond what was learnt
        self._last, self._from, self._moved = (np.full(count, np.nan) for _ in range(3))
        # readings, and the residuals of their virtual sensors
        self._both = np.full((2, self.batch + 2, count), np.nan)
        self._window = np.full((ROUGH // self.batch, self.batch, count), np.nan)  # bends
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
        both = self._both
        both[:, :2] = both[:, -2:]
        both[0, 2:], both[1, 2:] = readings, residuals
        raw, slopes = both[0], both[:, 1:] - both[:, :-1]
        # the usual case; not NaN
        if self._flows and np.minimum.reduce(np.abs(slopes[0, 1:]), axis=None) > 0.0:
            self._last[:], self._from[:] = readings[-1], estimates[-1]
            self.pairs += self.batch if learn is True else self.batch * learn
        else:
            self._repeat(raw, estimates, learn)
            self._flows = not (self.run.any() or self.gap.any())
        low, high = np.minimum(raw[:-2], raw[1:-1]), np.maximum(raw[:-2], raw[1:-1])
        middle = np.maximum(low, np.minimum(high, raw[2:]))  # NaN beside a gap
        self._move(middle)
        self._roughen(slopes)
        self._see_spikes(raw, middle)
        if self._count % (BLOCK // self.batch) == 0:
            self._end_block()

    def _repeat(self, raw: Floats, estimates: Floats, learn: Bools | bool) -> None:
        """Count repeats and gaps of a batch; before each row stands what was so before it."""
        missing = np.isnan(raw[2:])
        last, run, gap, begun = ([value] for value in (self._last, self.run, self.gap, self._from))
        for reading, estimate, none in zip(raw[2:], estimates, missing):
            same = reading == last[-1]
            run.append((run[-1] + same) * (same | none))
            gap.append((gap[-1] + 1) * none)
            last.append(np.where(none, last[-1], reading))
            begun.append(np.where(run[-1] > 0, begun[-1], estimate))
        moved = np.vstack([self._moved, np.abs(estimates - begun[1:])])  # since it was new
        if np.any(learn):  # a gap or a run is part of a habit when it has ended
            same, runs, gaps = raw[2:] == last[:-1], np.array(run[:-1]), np.array(gap[:-1])
            fresh = ~missing & learn
            self.pairs += np.add.reduce(fresh, axis=0, dtype=np.int64)
            runs *= fresh & ~same
            gaps *= fresh
            self.repeats += runs.sum(axis=0)
            self.again += np.maximum(runs - 1, 0).sum(axis=0)
            np.maximum(self.longest, np.maximum.reduce(runs), out=self.longest)
            np.maximum(self.longest_gap, np.maximum.reduce(gaps), out=self.longest_gap)
            np.fmax(self.travel, np.fmax.reduce(np.where(runs > 0, moved[:-1], 0.0)),
                    out=self.travel)
        self._last, self.run, self.gap, self._from = last[-1], run[-1], gap[-1], begun[-1]
        self._moved = moved[-1]

    def _row(self) -> int:
        """Return the place of this batch in its block."""
        return (self._count - 1) % (BLOCK // self.batch)

    def _rows(self) -> slice:
        """Return the places of its samples."""
        start = self._row() * self.batch
        return slice(start, start + self.batch)

    def _move(self, middle: Floats) -> None:
        extremes = self._extremes[self._row()]
        np.fmax.reduce(middle, axis=0, out=extremes[0])
        np.negative(np.fmin.reduce(middle, axis=0), out=extremes[1])
        further = extremes - self._reach
        self.beyond *= self._fades
        np.fmax(self.beyond, np.fmax(further[0], further[1]), out=self.beyond)

    def _roughen(self, slopes: Floats) -> None:
        bends = np.abs(slopes[:, 1:] - slopes[:, :-1])
        least = np.fmin(bends[0], bends[1], out=self._bends[self._rows()])
        np.minimum(least, self._cap, out=self._window[self._count % len(self._window)])

    def _see_spikes(self, raw: Floats, middle: Floats) -> None:
        apart = self._apart[self._rows()]
        np.abs(raw[1:-1] - middle, out=apart)
        spiked = apart > self._spike
        if np.count_nonzero(spiked):
            self.spikes += spiked.sum(axis=0)
            self._spiked[spiked.any(axis=0)] = self._count

    @property
    def spiked(self) -> bool:
        """Whether any had a spike in the last batch."""
        return bool((self._spiked == self._count).any())

    def _end_block(self) -> None:
        extremes = np.fmax.reduce(self._extremes)
        known = (self._count - self._broken >= BLOCK // self.batch) \
            & np.isfinite(extremes).all(axis=0)
        before = self.motion.count.copy()
        for row in (0, 1):
            self.motion.add(row, extremes[row], known)
        bent = self._of_block(self._bends)
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

    def stuck(self, estimates: Floats) -> Bools:
        """Tell which repeat their value for too long, by their habit or beside estimates (c,)."""
        if self._flows:
            return np.zeros(len(self.run), dtype=bool)
        quiet = np.isinf(self._needed) & (self.pairs >= KNOWN)
        if not quiet.any():
            return self.run >= self._needed
        enough = np.fmax(PART * (self.range[1] - self.range[0]), 2 * self.travel)
        moved = (np.abs(estimates - self._from) > enough) & (self.run > self.longest)
        return (self.run >= self._needed) | (quiet & moved)

    @property
    def rough(self) -> Floats:
        """Mean roughness of the last window (c,); NaN: not known."""
        return np.add.reduce(self._window.reshape(ROUGH, -1)) / ROUGH

    def spiking(self) -> Bools:
        """Tell which had a spike just now."""
        return (self._count - self._spiked) * self.batch * self.period < AFTER

    def dropped(self) -> Bools:
        """Tell which have said nothing for too long."""
        if self._flows:
            return np.zeros(len(self.gap), dtype=bool)
        return self.gap > np.maximum(MISSING / self.period, 3 * self.longest_gap)

    def noisy(self) -> Bools:
        """Tell which are far rougher than the healthy machine."""
        noisy = self.rough > self._roughest
        if np.count_nonzero(noisy):  # all bends are larger then, not those at spikes only
            quiet = np.quantile(self._window[:, :, noisy], 0.25, axis=(0, 1))
            noisy[noisy] = quiet > QUIET * self.roughness[noisy]
        return noisy
