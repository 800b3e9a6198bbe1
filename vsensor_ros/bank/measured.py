"""What a bank has measured: residuals while all was well, and what it may have missed since."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import math

import numpy as np

from vsensor_ros.bank.angle import ShortWay
from vsensor_ros.bank.elsewhere import Elsewhere
from vsensor_ros.bank.record import Record
from vsensor_ros.bank.rehearsal import Growth
from vsensor_ros.observers import Batch, Told

_GAPS = 100  # that are remembered
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
        self.growth = Growth(batch, self._seconds, short_way)
        # of temporary ones: what a gap has left in a free run stays there
        self._stays = np.isin(batch.of, [t.own for t in batch.tracked if t.temporary])
        self.base = self.record.in_steady_state()
        self.elsewhere = Elsewhere(batch, tuple(ages), self._seconds)
        self.all_trusted = True  # no sensor is isolated: what shows is usual
        self.reset()
        self.restart()

    def reset(self) -> None:
        """Forget how often readings usually come."""
        self._usual = dict.fromkeys(self._ages, 3 * self._period)  # ns between its readings

    def restart(self) -> None:
        """Forget what is not yet believed, and what gaps have left."""
        self.record.forget()
        self.elsewhere.restart()
        self.growth.restart()
        # what gaps in the readings have left in the states (O,), when they ended last
        self._missed: np.ndarray = np.zeros(len(self._batch.keys))
        self._missed_at = 0
        # when they ended, and what each left (O,)
        self._gaps: deque[tuple[int, np.ndarray]] = deque(maxlen=_GAPS)

    def forget(self, lost: np.ndarray, stopped: np.ndarray, since: int) -> None:
        """
        Forget what is not yet believed of lost sensors (L,), and of who stopped (R,) bool.

        since: the tick of the first fault; what was believed since is forgotten, too.
        """
        own = self._batch.own
        outputs = stopped[self._batch.of] | (lost[own] & (own >= 0))
        self.record.forget(outputs, lost, since)
        self.base = self.record.in_steady_state()
        self.elsewhere.forget(outputs)
        self.growth.forget(np.array([stopped[t.tracker] for t in self._batch.tracked], dtype=bool))

    def add(self, ticks: np.ndarray, z: np.ndarray, running: np.ndarray, since: np.ndarray,
            told: Told, heard: np.ndarray, newest: int) -> None:
        """
        Take T states that nothing can change any more, stacked along a first axis.

        heard (L,): tick of the last reading of each sensor. A value that is only held says
        nothing. newest: the tick by now.
        """
        there = told.there[:, :len(heard)] & (ticks[:, None] <= heard)
        if self._batch.tracked:
            with np.errstate(all='ignore'):
                self.growth.add(ticks, z, running, since, told, there)
        z, running, since = (part[:, :self._batch.size] for part in (z, running, since))
        residuals, counts = self._residuals(z, running, told, there)
        with np.errstate(all='ignore'):
            start = self._of_the_start(ticks[[0, -1]], z[-1], since[-1], told)
            self.record.add(int(ticks[-1]), residuals, counts, told.y, there, start, newest)
        self.base = self.record.in_steady_state()
        if self.all_trusted:
            self.elsewhere.note_usual(self.record.slowly, self.base)

    def look(self, ticks: np.ndarray, z: np.ndarray, running: np.ndarray, since: np.ndarray,
             told: Told, heard: np.ndarray) -> None:
        """Take T states, as above, to see where the machine is by now."""
        there = told.there[:, :len(heard)] & (ticks[:, None] <= heard)
        z, running, since = (part[:, :self._batch.size] for part in (z, running, since))
        residuals, counts = self._residuals(z, running, told, there)
        grown = ticks[:, None] - since[:, self._batch.of] >= 2.0 * self._warm
        self.elsewhere.take(residuals, counts & grown)

    def _residuals(self, z: np.ndarray, running: np.ndarray, told: Told, there: np.ndarray,
                   ) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals (T, O), and which of them count."""
        own = self._batch.own
        with np.errstate(all='ignore'):
            estimates = self._batch.estimates(z, told.y, told.held)
            readings = told.y if self._Cu is None else told.y + told.held @ self._Cu.T
            return self._short_way(readings[:, own] - estimates), \
                running[:, self._batch.of] & there[:, own] & (own >= 0)

    def _of_the_start(self, ticks: np.ndarray, z: np.ndarray, since: np.ndarray,
                      told: Told) -> np.ndarray:
        """Return what was stated (O,) of the start in a block between two ticks; NaN: nothing."""
        ages = np.maximum(ticks[:, None] - since[self._batch.of], 0)  # (2, O) steps
        found = np.full(len(self._warm), np.nan)
        last = Told(*(part[-1] for part in told))
        for o in np.flatnonzero(ages[0] < 2.0 * self._warm):
            first, end = (self._batch.deviation(int(o), z, last, age * self._seconds)
                          for age in ages[:, o].tolist())
            found[o] = math.hypot(first, end) / math.sqrt(2.0)
        return found

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
            self._gaps.append((tick, more))

    def take_off(self, i: int, since: int) -> None:
        """Note that a free run has gone on since a tick: what gaps have left since then stays."""
        of = self._stays & (self._batch.of == self._batch.tracked[i].own)
        left = np.sqrt(sum((more**2 for at, more in self._gaps if at > since),
                           np.zeros(len(of))))
        self._missed = np.where(of, left, self._missed)

    def _left_of_gaps(self, tick: int) -> np.ndarray:
        """Return what gaps have left in the states (O,): it dies out as they do."""
        ages = max(0, tick - self._missed_at) * self._seconds
        left = np.exp(-ages / np.maximum(self._batch.slowest, 1e-9))
        return np.asarray(self._missed * np.where(self._stays, 1.0, left))

    def unseen(self, tick: int, ages: np.ndarray, output: int | None = None) -> np.ndarray:
        """
        Return the standard deviations because readings of these ages [s] have moved.

        Of all outputs (O,), or of one (1,).
        """
        slopes = self.record.slope
        if np.isnan(slopes).any():
            # before slopes are known: nothing is said of readings that are far from silent
            slopes = np.where(np.isnan(slopes), np.where(ages > self._recent, np.inf, 0.0), slopes)
        with np.errstate(all='ignore'):
            held = self._batch.reach(slopes, ages, output=output)
        if not self._missed.any():
            return held
        left = self._left_of_gaps(tick)
        return np.hypot(held, left if output is None else left[output])
