"""All that is looked at in a sample: the residuals of the checks, and the channels themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.isolator.block_maxima import Floats
from vsensor_ros.isolator.channels import Channels
from vsensor_ros.isolator.detector import Bools, Detector, ENOUGH, WINDOWS
from vsensor_ros.isolator.motion import CONTRASTS, Motion

PRIOR = 8.0  # times the designed noise is the threshold until enough was learnt
WILD = 1e6  # times the designed noise is what a residual counts as at most
FARTHEST = 3.0  # times the motion that was learnt is what motion beyond counts as at most
SHORTEST = 16  # samples of a check that counts
LASTING = 2  # the window against whose thresholds a median is held
FAST = 0.02  # s; up to this period four samples are taken at a time

Ints = NDArray[np.int64]


def batch_of(period: float) -> int:
    """Return how many samples are looked at together: a delay of 60 ms at most."""
    return 4 if period <= FAST else 1


def _table(rows: Sequence[Sequence[int] | Ints], none: int) -> Ints:
    """Return rows of equal length, filled by what is in them already; none: of an empty one."""
    most = max([1, *(len(row) for row in rows)])
    return np.array([np.resize(row, most) if len(row) else np.full(most, none)
                     for row in rows], dtype=np.int64).reshape(len(rows), most)


class Watch:
    """
    Detector and channels side by side, of one machine or of many.

    own (n,): the channel of each check's virtual sensor, -1: its output is a residual itself.
    supports (n, c): who may be at fault. gains (n, c): what a check shows of a constant fault of
    each channel. noise (n,): standard deviation of its residual, as designed. best (c,): the check
    that shows a channel, -1: none. wraps (n,): what a residual counts modulo, inf: nothing.
    """

    def __init__(self, period: float, own: Ints, supports: Bools, gains: Floats, noise: Floats,
                 best: Ints, false_alarms: float, model_error: float,
                 wraps: Floats | None = None) -> None:
        self.batch = batch_of(period)
        self.own, self.best, self.model_error = own, best, model_error
        self.supports = supports
        self.gains = np.abs(gains)
        # of most checks one gain only counts, that of the own channel
        alone = (self.gains > 0.0).sum(axis=1) <= 1
        self._single = self.gains.argmax(axis=1) if alone.all() else None
        self.gain = self.gains.max(axis=1, initial=0.0)
        self.detector = Detector(period, self.batch, false_alarms, PRIOR * noise, WILD * noise)
        self.channels = Channels(period, self.batch, len(best))
        self.motion = Motion(period, self.batch, len(best))
        # of each channel the estimate that is least noisy; any: of what has none
        order = np.argsort(noise, kind='stable')[::-1]
        self._quietest = np.zeros(len(best), dtype=np.int64)
        self._quietest[own[order][own[order] >= 0]] = order[own[order] >= 0]
        # of each check the channels that have to move: its own, whose estimate does not read it;
        # of a dedicated filter all that may be at fault: a fault moves estimates of others only
        movers = [[channel] if channel >= 0 else np.flatnonzero(row & (best >= 0))
                  for channel, row in zip(own, supports)]
        self._movers = _table(movers, len(best))
        self._read = _table([np.flatnonzero(row & (best >= 0)) if channel >= 0 else []
                             for channel, row in zip(own, supports)], len(best))
        self._unseen = np.flatnonzero(best < 0) if (best < 0).any() else None
        self._told = None if (own >= 0).all() else own >= 0
        self._wraps = wraps if wraps is not None and np.isfinite(wraps).any() else None

    def step(self, readings: Floats, estimates: Floats, learn: Bools | bool,
             learn_channels: Bools | bool) -> Bools:
        """
        Take a batch of readings (batch, c) and of estimates (batch, n); return who alarms (n,).

        learn, () or (n,), and learn_channels, () or (c,): who counts as healthy.
        """
        if self._told is None:
            residuals = readings.take(self.own, axis=1)
            residuals -= estimates
        else:
            residuals = np.where(self._told, readings[:, self.own], 0.0) - estimates
        if self._wraps is not None:
            residuals -= np.where(np.isfinite(self._wraps), self._wraps, 0.0) * np.round(
                residuals / self._wraps)
        shown, said = residuals.take(self.best, axis=1), estimates.take(self.best, axis=1)
        self.motion.step(estimates.take(self._quietest, axis=1), learn_channels)
        if self._unseen is not None:
            shown[:, self._unseen] = said[:, self._unseen] = np.nan
        self.channels.step(readings, shown, said, learn_channels)
        self.said = said[-1]
        alarms = self.detector.step(residuals, learn, self._widened)
        if np.count_nonzero(alarms):  # what spikes leave behind is nobody's fault
            spiking = self.channels.spiking()
            for i in np.flatnonzero(alarms & self.supports[:, spiking].any(axis=1)):
                alarms[i] = self._lasts(int(i))
        return alarms

    def _lasts(self, check: int) -> bool:
        """Tell whether a check would alarm by its median, which spikes do not move."""
        past = self.detector.past(check, 2 * WINDOWS[LASTING])
        above, below = self.detector.thresholds[[LASTING, len(WINDOWS) + LASTING], check]
        return len(past) > 0 and not -below <= float(np.median(past)) <= above

    def _widened(self, due: int) -> Floats:
        """
        Return by how much motion beyond what was learnt moves the thresholds.

        (n,), or of the first windows (due, 1, 2, n): level and contrast.
        """
        channels, detector = self.channels, self.detector
        widened = self._of_checks(channels.beyond)
        fresh = detector.learnt * detector.period < ENOUGH
        if fresh.any():
            span = np.nan_to_num(channels.range[1] - channels.range[0])
            widened = widened + fresh * self._of_checks(span)
        widened *= self.model_error
        self.motion.look()
        share = self._share()
        if share.any():
            most = self.model_error * self._of_checks(self.motion.range)
            return widened + share * np.minimum(detector.width(due), most)
        return widened

    def _share(self) -> Floats:
        """
        Return by which share of what was learnt the motion in each check is beyond it (n,).

        That of the own channel counts over all windows. The others that are read count by
        contrasts only: a constant fault of theirs moves the estimates of each other, too, but out
        of a contrast that passes.
        """
        beyond = np.minimum(np.pad(self.motion.beyond, ((0, 0), (0, 1))), FARTHEST)
        return np.maximum(beyond.max(axis=0)[self._movers].min(axis=1),
                          beyond[CONTRASTS].max(axis=0)[self._read].max(axis=1))

    def _of_checks(self, motion: Floats) -> Floats:
        """Return what motion of the channels (c,) is in the residuals (n,)."""
        if self._single is not None:
            return motion[self._single] * self.gain
        return self.gains @ motion

    def running(self) -> Bools:
        """Tell which checks have been fed for a while (n,)."""
        return self.detector.filled > SHORTEST

    def restart(self) -> None:
        """Forget all samples, not what was learnt."""
        self.detector.restart(np.arange(len(self.own)))
        self.channels.restart()
        self.motion.restart()

    def centre(self, column: int) -> float:
        """Return the mean of a healthy residual."""
        above, below = self.detector.thresholds[[len(WINDOWS) - 1, 2 * len(WINDOWS) - 1], column]
        return float(above - below) / 2
