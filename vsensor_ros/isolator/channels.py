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
from vsensor_ros.isolator.runs import Counts, follow, Runs
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


def _medians(samples: Floats) -> Floats:
    """Return the medians of three (n, c) in samples (n + 2, c); NaN beside a gap."""
    one, other, third = samples[:-2], samples[1:-1], samples[2:]
    return np.maximum(np.minimum(one, other), np.minimum(np.maximum(one, other), third))


class Channels:
    """Any number of channels c, a batch of samples at a time."""

    range: Floats
    _runs: Runs
    _reach: Floats
    _beyond: Floats
    _needed: Floats
    _soonest: Floats
    _cap: Floats
    _roughest: Floats
    _loud: Floats
    _spike: Floats
    _jolt: Floats
    _fresh: Floats
    _step: Floats
    _middle: Floats

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
        self._needed, self._cap, self._roughest, self._loud, self._spike, self._jolt = (
            np.full(count, np.inf) for _ in range(6))
        self._step = np.full(count, np.inf)  # above that it is none of a healthy channel
        # repeats before which none is stuck, and before which no channel is
        self._soonest, self._earliest = np.ones(count), 1.0
        self._count = self._settled = 0  # batches, and those whose repeats and gaps were counted
        self.spiked = False  # whether any did in the last batch
        self._fades = np.exp(-batch * period / PEAK)
        # of the block that runs: readings and residuals, behind the last two of the block before;
        # estimates, behind the last one; and bends
        self._raw = np.empty((BLOCK + 2, 2, count))
        self._estimates = np.empty((BLOCK + 1, count))
        self._bends = np.empty((BLOCK, count))
        self._within = np.arange(1 - batch, 1)[:, None]  # samples of a batch, the last is 0
        self.restart()

    def restart(self) -> None:
        """Forget the last readings, not what was learnt."""
        self.settle()
        count = len(self.spikes)
        self._runs = Runs.none(count)
        self._plain = True  # no value has been repeated since, and no reading missed
        self._most = np.inf  # repeats that may be the last of any channel; of each, see _fresh
        # the last sample before which a value surely was no repeat
        self._fresh = np.full(count, float(self._count * self.batch))
        self._raw[:] = self._estimates[:] = np.nan
        self._middle = np.full((BLOCK, count), np.nan)  # medians of three of the block before
        self._window = np.full((ROUGH // self.batch, self.batch, count), np.nan)  # bends
        self._bent = np.full((ROUGH // self.batch, count), np.nan)  # their sums, by batch
        self._beyond = np.zeros(count)
        self._looked = self._count  # batches up to which that was drawn from the medians
        # batches that were the last that was not learnt, and the last with a spike
        self._broken = np.full(count, self._count, dtype=np.int64)
        self._spiked = np.full(count, self._count - FAR, dtype=np.int64)

    def step(self, readings: Floats, residuals: Floats, estimates: Floats, learn: Bools | bool,
             ) -> None:
        """
        Take a batch of samples (batch, c); NaN: no reading, or nobody to estimate it.

        residuals, estimates: of the virtual sensor of each channel. learn: () or (c,).
        """
        if learn is not True:
            self.settle()
            self._broken[np.broadcast_to(np.logical_not(learn), self._broken.shape)] = \
                self._count + 1
        start = self._count % (BLOCK // self.batch) * self.batch
        if not start:
            self._raw[:2], self._estimates[0] = self._raw[-2:], self._estimates[-1]
        self._count += 1
        raw = self._raw[start:start + self.batch + 2]
        raw[2:, 0], raw[2:, 1] = readings, residuals
        self._estimates[start + 1:start + 1 + self.batch] = estimates
        slopes = raw[1:] - raw[:-1]
        bends = slopes[1:] - slopes[:-1]
        np.abs(bends, out=bends)
        self._see_spikes(raw[:, 0], bends[:, 0])
        self._roughen(np.fmin(bends[:, 0], bends[:, 1],
                              out=self._bends[start:start + self.batch]))
        self._see_repeats(slopes[1:, 0], learn)
        if self._count % (BLOCK // self.batch) == 0:
            self._end_block()

    def _see_repeats(self, slopes: Floats, learn: Bools | bool) -> None:
        """Note whether a batch has repeats (b, c); they are counted when that matters."""
        steps, now = np.abs(slopes), self._count * self.batch
        least = float(np.minimum.reduce(steps, axis=None, initial=np.inf))
        if least > 0.0:
            self._most = 0
        elif np.minimum.reduce(np.maximum.reduce(steps), initial=np.inf) > 0.0:
            self._most = self.batch - 1  # all have changed within the batch
        else:
            changed = now + np.where(slopes, self._within, -now).max(axis=0)
            self._fresh = np.maximum(changed, np.maximum(
                self._fresh, now - self.batch - self._most))
            self._most = np.inf
        self._plain &= least > 0.0
        if learn is not True or np.isnan(least):
            self.settle(learn)

    def settle(self, learn: Bools | bool = True) -> None:
        """Count the repeats and gaps that were not counted yet; learn: () or (c,)."""
        count = (self._count - self._settled) * self.batch
        if not count:
            return
        end, self._settled = self._end(), self._count
        raw = self._raw[end - count + 1:end + 2, 0]
        estimates = self._estimates[end - count:end + 1]
        learnt = np.ones(self.pairs.shape, dtype=bool)
        learnt &= learn
        self.pairs += count * learnt
        before, (run, gap) = self._runs, np.zeros((2, len(learnt)), dtype=np.int64)
        self._runs = Runs(raw[-1].copy(), run, gap, estimates[-1].copy())
        if not self._plain:
            flow = np.minimum.reduce(np.abs(raw[1:] - raw[:-1])) > 0.0
            which = np.flatnonzero(~(flow & (before.run == 0)))
            self._count_repeats(which, before.of(which),
                                raw[1:, which], estimates[:, which], learnt[which])
            self._plain = not np.count_nonzero(self._runs.run)
            self._expect()
        self._most = np.inf
        self._fresh = self._count * self.batch - self._runs.run.astype(float)

    def _count_repeats(self, which: NDArray[np.intp], before: Runs, readings: Floats,
                       estimates: Floats, learn: Bools) -> None:
        """Count those of some channels; estimates from one sample earlier on."""
        runs = follow(before, readings, estimates[1:])
        for all_of, rows in zip(self._runs, runs):
            all_of[which] = rows[-1]
        missing = runs.gap[1:] > 0
        self.pairs[which] -= np.add.reduce(missing & learn, axis=0, dtype=np.int64)
        ended = runs.run[:-1] * ((runs.run[1:] == 0) & learn)  # only then it is part of a habit
        self.repeats[which] += np.add.reduce(ended)
        self.again[which] += np.add.reduce(np.maximum(ended - 1, 0))
        self.longest[which] = np.maximum(self.longest[which], np.maximum.reduce(ended))
        self.longest_gap[which] = np.maximum(
            self.longest_gap[which], np.maximum.reduce(runs.gap[:-1] * (~missing & learn)))
        went = np.abs(estimates[:-1] - runs.begun[:-1])
        went[ended == 0] = 0.0
        self.travel[which] = np.fmax(self.travel[which], np.fmax.reduce(went))

    def _expect(self) -> None:
        """Note how many repeats it takes until a channel may be stuck."""
        self._soonest = np.where(np.isinf(self._needed), self.longest + 1, self._needed)
        self._earliest = float(self._soonest.min(initial=np.inf))

    def _end(self) -> int:
        """Return how many samples of the block that runs are there."""
        return (self._count - 1) % (BLOCK // self.batch) * self.batch + self.batch

    @property
    def run(self) -> Counts:
        """How often each channel has repeated its value (c,)."""
        self.settle()
        return self._runs.run

    @property
    def gap(self) -> Counts:
        """For how many samples each channel has said nothing (c,)."""
        self.settle()
        return self._runs.gap

    def _see_spikes(self, raw: Floats, bends: Floats) -> None:
        """Count the spikes of a batch; bends (b, c) are those of the readings."""
        self.spiked = np.count_nonzero(bends > self._jolt) > 0
        if self.spiked:  # there may be one: it bends by twice its height
            spiked = np.abs(raw[1:-1] - _medians(raw)) > self._spike
            self.spiked = np.count_nonzero(spiked) > 0
            self.spikes += spiked.sum(axis=0)
            self._spiked[spiked.any(axis=0)] = self._count

    def _roughen(self, bends: Floats) -> None:
        """Keep how much both readings and residuals bend."""
        place = self._count % len(self._window)
        np.minimum(bends, self._cap, out=self._window[place])
        np.add.reduce(self._window[place], axis=0, out=self._bent[place])

    @property
    def beyond(self) -> Floats:
        """How far readings went beyond what was learnt (c,); that is forgotten again."""
        behind = (self._count - self._looked) * self.batch
        if behind:
            end = self._end()
            self._look(_medians(self._raw[end - behind:end + 2, 0]))
        return self._beyond

    def _look(self, middle: Floats) -> None:
        """Take into `beyond` the medians (n, c) that came in since it was drawn from them."""
        self._looked = self._count
        middle = middle.reshape(-1, self.batch, middle.shape[1])
        further = np.fmax(np.fmax.reduce(middle, axis=1) - self._reach[0],
                          -np.fmin.reduce(middle, axis=1) - self._reach[1])
        for row in further:
            self._beyond *= self._fades
            np.fmax(self._beyond, row, out=self._beyond)

    def _end_block(self) -> None:
        self.settle()
        middle = self._middle = _medians(self._raw[:, 0])
        apart = np.abs(self._raw[1:-1, 0] - middle)
        extremes = np.stack([np.fmax.reduce(middle), -np.fmin.reduce(middle)])
        if self._looked < self._count:
            if np.count_nonzero(self._beyond) or np.count_nonzero(extremes > self._reach):
                self._look(middle[(self._looked - self._count) * self.batch:])
            self._looked = self._count
        known = (self._count - self._broken >= BLOCK // self.batch) \
            & np.isfinite(extremes).all(axis=0)
        stepped = largest_step(middle, STRIDE)
        self.steps.add(slice(0, 1), stepped[None], known & np.isfinite(stepped))
        before = self.motion.count.copy()
        self.motion.add(slice(0, 2), extremes, known)
        bent = self._of_block(np.minimum(self._bends, self._cap))  # a jump is no roughness
        calm = known & np.isfinite(bent) & (
            self._count - self._spiked >= BLOCK // self.batch)
        self.motion.add(slice(2, 3), self.rough[None], calm)
        self.samples += BLOCK * calm
        apart = self._of_block(np.minimum(apart, self._spike / 2))
        share = BLOCK * calm / np.maximum(self.samples, 1)
        self.roughness += share * (np.where(calm, bent, 0.0) / BLOCK - self.roughness)
        self.usual_spike += share * (np.where(calm, apart, 0.0) / BLOCK - self.usual_spike)
        self._refresh(np.flatnonzero((self.motion.count != before).any(axis=1)).tolist())

    def _of_block(self, samples: Floats) -> Floats:
        return np.add.reduce(np.add.reduce(samples.reshape(-1, self.batch, samples.shape[1]), 1))

    def refresh(self) -> None:
        """Draw from the record how far a channel moves, and how many repeats are too many."""
        self._beyond = self.beyond  # by what was known until now
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
        self._expect()
        known = self.samples >= KNOWN
        roughest = np.maximum(self._usual[2], self.roughness)
        self._cap = np.where(known, CAP * roughest, np.inf)
        self._roughest = np.where(known, np.maximum(ROUGHER * self.roughness,
                                                    ROUGHEST * roughest), np.inf)
        self._loud = NEARLY * ROUGH * self._roughest
        least = 0.02 * (self.range[1] - self.range[0])
        self._spike = np.where(known, np.fmax(SPIKE * self.usual_spike, least), np.inf)
        self._jolt = 1.9 * self._spike
        self._step = least_step(self.steps, BLOCK * self.period, ENOUGH)

    def stuck(self, estimates: Floats) -> Bools:
        """Tell which repeat their value for too long, by their habit or beside estimates (c,)."""
        none = np.zeros(len(self.spikes), dtype=bool)
        if self._most < self._earliest or not np.count_nonzero(
                self._count * self.batch - self._fresh >= self._soonest):
            return none
        stuck, late = self.run >= self._needed, self.run > self.longest
        if np.count_nonzero(late):
            quiet = late & np.isinf(self._needed) & (self.pairs >= KNOWN) & (
                self.repeats - self.again >= FEWEST_RUNS)
            enough = np.fmax(PART * (self.range[1] - self.range[0]), 2 * self.travel)
            stuck |= quiet & (np.abs(estimates - self._runs.begun) > enough)
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
        end = self._end()
        recent = np.concatenate([self._middle[end:], _medians(self._raw[:end + 2, 0])])
        return largest_step(recent) > self._step

    def dropped(self) -> Bools:
        """Tell which have said nothing for too long."""
        # where something is not counted yet, all readings have come
        if self._settled < self._count or not np.count_nonzero(self._runs.gap):
            return np.zeros(len(self.spikes), dtype=bool)
        return self._runs.gap > np.maximum(MISSING / self.period, 3 * self.longest_gap)

    def noisy(self) -> Bools:
        """Tell which are far rougher than the healthy machine."""
        noisy = np.add.reduce(self._bent) > self._loud
        if np.count_nonzero(noisy):  # all bends are larger then, not those at spikes only
            noisy = self.rough > self._roughest
            quiet = np.quantile(self._window[:, :, noisy], 0.25, axis=(0, 1))
            noisy[noisy] = quiet > QUIET * self.roughness[noisy]
        return noisy
