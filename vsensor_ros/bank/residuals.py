"""
The observers of residuals, stepped for the isolation of faults, on the grid of a bank.

They read what every sensor says, whoever is believed: what is done about a fault changes nothing
of how it is found. A time of the grid is looked at once, when all sensors that speak have spoken
of it, so that no late reading changes it any more.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from vsensor_ros.bank.commands import End
from vsensor_ros.bank.steps import Steps
from vsensor_ros.observers import Design, FaultSize, Residual

FIRST = 10_000_000_000  # ns that a sensor may take to speak for the first time
LONGEST = 60.0  # s after which an observer has forgotten its start, if that is not known


class Residuals(Steps):
    """Readings and estimates of the residuals of a design, at each time of a grid."""

    def __init__(self, design: Design, residuals: Sequence[Residual | FaultSize], rate: float,
                 max_age: Mapping[str, float], jump_ahead: float | None = None,
                 command_ends: Mapping[str, End] = MappingProxyType({})) -> None:
        """
        Prepare, see `Steps`; raises BadInput.

        design: the observers of the residuals, see `Design.isolating`.
        """
        super().__init__(design, rate, max_age, jump_ahead, command_ends)
        output = {(frozenset(fault_set), channel): i
                  for i, (fault_set, channel) in enumerate(self._batch.keys)}
        at = [output.get((frozenset(r.fault_set), r.channel)) for r in residuals]
        self._there = np.array([i is not None for i in at], dtype=bool)
        self._outputs = np.array([i or 0 for i in at], dtype=int)
        # of what has no run that never reads its channels, the one that these correct
        batch, of = self._batch, self._batch.of[self._outputs]
        self._rows = np.arange(batch.size)
        warm_up = np.array(batch.warm_up[self._outputs])
        for t in batch.tracked:
            if t.temporary:
                self._rows[t.own] = t.tracker
                warm_up[of == t.own] = t.warm_up
        self._runs_of = self._rows[of]
        self._warm = np.ceil(np.minimum(warm_up, LONGEST) / (self.period * 1e-9))

    def reset(self) -> None:
        """Forget all."""
        self._looked: int | None = None  # last tick that was looked at
        self._waiting: int | None = None  # since when somebody has spoken, but not all
        # tick until which the observer of each residual may have read what was faulty
        self._spoilt: np.ndarray | int = np.iinfo(np.int64).min // 2
        super().reset()

    def forgive(self, names: Iterable[str]) -> None:
        """Take these sensors for healthy again; what has read them has to forget that first."""
        if self._looked is not None:
            new = [name in names for name in (*self.sensors, *self.inputs)]
            reads = self._batch.starts_on[self._runs_of][:, new].any(axis=1)
            self._spoilt = np.where(reads, self._looked, self._spoilt)

    def until(self, now: int) -> int | None:
        """Return the time [ns] up to which all who speak have spoken; None: nobody does."""
        last = self._told.last_stamps()
        if None in last:
            if self._waiting is None or now < self._waiting:
                self._waiting = now
            if now - self._waiting < FIRST:
                return None
        return min((stamp for stamp, age in zip(last, self._told.ages.values())
                    if stamp is not None and now - stamp <= age), default=None)

    def at_least(self, steps: int, now: int) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """
        Yield each new time [ns] of the grid, with readings (L,) and estimates (r,).

        Nothing while there are less than so many. NaN where there is none: an estimate is one only
        when its observer has forgotten its start, a reading only between two that are no further
        apart than its max_age. Both are of linear readings.
        """
        end = self.until(now)
        if end is None or self._origin is None:
            return
        if self._now is not None and end < self._now:
            return  # a sensor that was silent has spoken of earlier
        looked = self._looked
        if looked is not None and (end - self._at(looked)) // self.period < steps:
            return
        self.advance(end)
        new = [state for state in self._past if looked is None or state.tick > looked]
        for state in new:
            self._looked, time = state.tick, self._at(state.tick)
            said = self._batch.estimates(state.z[self._rows], state.told.y, state.told.held)
            since = np.maximum(state.since[self._runs_of], self._spoilt)
            warm = state.running[self._runs_of] & (state.tick - since >= self._warm)
            yield time, self._readings(time), np.where(
                self._there & warm, said[self._outputs], np.nan)

    def _readings(self, time: int) -> np.ndarray:
        found = np.full(len(self.sensors), np.nan)
        for i, (name, age) in enumerate(self._told.ages.items()):
            samples = self._told.samples[name]
            stamps = samples.stamps
            after = bisect_right(stamps, time)
            if after and (stamps[after - 1] == time or after < len(stamps)
                          and stamps[after] - stamps[after - 1] <= age):
                value = samples.interpolated(time, age)
                found[i] = np.nan if value is None else value
        return found

    def _settle(self) -> None:
        """Forget a block of states; nothing is measured here."""
        self._settled = []
        self._told.forget(self._at(self._past[0].tick))
