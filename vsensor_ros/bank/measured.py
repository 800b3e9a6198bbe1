"""What a bank has measured: residuals while all was well, and what it may have missed since."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vsensor_ros.bank.angle import ShortWay
from vsensor_ros.bank.record import Record
from vsensor_ros.observers import Batch, Told

_GAP = 3  # times the usual interval of a reading: what was missed then shows afterwards


class Measured:
    """
    The record of a batch, and gaps in the readings of L sensors; ticks are grid indices.

    `base` (O,): the standard deviation of each output in steady state, as far as it is known.
    """

    def __init__(self, batch: Batch, ages: Mapping[str, int], period: int,
                 Cu: np.ndarray | None, short_way: ShortWay) -> None:
        """
        Prepare for sensors with these max_ages [ns], and a grid of this period [ns].

        short_way: of residuals (T, O) that wrap.
        """
        self._batch, self._ages, self._period, self._Cu = batch, ages, period, Cu
        self._short_way = short_way
        self._seconds = period * 1e-9
        self._recent = np.array(list(ages.values())) * 0.5e-9
        self._warm = np.minimum(batch.warm_up / self._seconds, 1e18)  # steps
        self.record = Record(batch.slowest, batch.own, len(ages), self._seconds, batch.error,
                             batch.assumed)
        self.base = self.record.in_steady_state()
        self.reset()
        self.restart()

    def reset(self) -> None:
        """Forget how often readings usually come."""
        self._usual = dict.fromkeys(self._ages, 3 * self._period)  # ns between its readings

    def restart(self) -> None:
        """Forget what is not yet believed, and what gaps have left."""
        self.record.forget()
        # what gaps in the readings have left in the states (O,), when they ended last
        self._missed: np.ndarray = np.zeros(len(self._batch.keys))
        self._missed_at = 0

    def forget(self, lost: np.ndarray, stopped: np.ndarray) -> None:
        """Forget what is not yet believed of lost sensors (L,), and of who stopped (V,) bool."""
        own = self._batch.own
        self.record.forget(stopped[self._batch.of] | (lost[own] & (own >= 0)), lost)

    def add(self, ticks: np.ndarray, z: np.ndarray, running: np.ndarray, since: np.ndarray,
            told: Told, heard: np.ndarray) -> None:
        """
        Take T states that nothing can change any more, stacked along a first axis.

        heard (L,): tick of the last reading of each sensor. A value that is only held says
        nothing.
        """
        batch, of, own = self._batch, self._batch.of, self._batch.own
        there = told.there[:, :len(heard)] & (ticks[:, None] <= heard)
        with np.errstate(all='ignore'):
            estimates = batch.estimates(z, told.y, told.held)
            readings = told.y if self._Cu is None else told.y + told.held @ self._Cu.T
            counts = running[:, of] & there[:, own] & (own >= 0) \
                & (ticks[:, None] - since[:, of] >= 2.0 * self._warm)  # no start is left in it
            self.record.add(int(ticks[-1]), self._short_way(readings[:, own] - estimates), counts,
                            told.y, there)
        self.base = self.record.in_steady_state()

    def is_usual(self, name: str, interval: int) -> bool:
        """Tell whether a sensor's reading came about as soon [ns] after the last as always."""
        usual = self._usual[name]
        if interval > _GAP * usual:
            return False
        self._usual[name] = max(3 * self._period, usual + (interval - usual) // 8)
        return True

    def miss(self, name: str, interval: int, tick: int) -> None:
        """Note what outputs that went on may have missed in an unusually long interval [ns]."""
        if interval <= self._ages[name]:
            self._usual[name] = min(2 * self._usual[name], interval)
            ages = np.array([interval * 1e-9 * (s == name) for s in self._ages])
            slopes = np.nan_to_num(self.record.slope)
            with np.errstate(all='ignore'):
                more = self._batch.reach(slopes, ages, False)
            self._missed, self._missed_at = np.hypot(self._left_of_gaps(tick), more), tick

    def _left_of_gaps(self, tick: int) -> np.ndarray:
        """Return what gaps have left in the states (O,): it dies out as they do."""
        ages = max(0, tick - self._missed_at) * self._seconds
        return np.asarray(self._missed * np.exp(-ages / np.maximum(self._batch.slowest, 1e-9)))

    def unseen(self, tick: int, ages: np.ndarray) -> np.ndarray:
        """Return the standard deviations (O,) because readings of these ages [s] have moved."""
        slopes = self.record.slope
        # before slopes are known: nothing is said of readings that are far from silent
        slopes = np.where(np.isnan(slopes), np.where(ages > self._recent, np.inf, 0.0), slopes)
        with np.errstate(all='ignore'):
            held = self._batch.reach(slopes, ages)
        return np.hypot(held, self._left_of_gaps(tick)) if self._missed.any() else held
