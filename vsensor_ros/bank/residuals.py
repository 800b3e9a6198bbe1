"""
The observers of residuals, stepped for the isolation of faults, on the grid of a bank.

They read what every sensor says, whoever is believed: what is done about a fault changes nothing
of how it is found. A time of the grid is looked at once, when all sensors that speak have spoken
of it, so that no late reading changes it any more.

What has read who was blamed starts anew when that is healthy again. It need not forget its start
then: it goes on from the state of its tracker, which has forgotten its own much sooner.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Iterator, Mapping, Sequence
import math
from types import MappingProxyType

import numpy as np

from vsensor_ros.bank.commands import End
from vsensor_ros.bank.flights import stop
from vsensor_ros.bank.state import State
from vsensor_ros.bank.steps import Steps
from vsensor_ros.observers import Design, FaultSize, Residual

FIRST = 10_000_000_000  # ns that a sensor may take to speak for the first time
LONGEST = 60.0  # s after which an observer has forgotten its start, if that is not known
NEVER = np.iinfo(np.int64).min // 2  # a tick


class Residuals(Steps):
    """Readings and estimates of the residuals of a design, at each time of a grid."""

    def __init__(self, design: Design, residuals: Sequence[Residual | FaultSize], rate: float,
                 max_age: Mapping[str, float], jump_ahead: float | None = None,
                 command_ends: Mapping[str, End] = MappingProxyType({})) -> None:
        """
        Prepare, see `Steps`; raises BadInput.

        design: the observers of the residuals, see `Design.isolating`.
        """
        self._blamed: frozenset[str] = frozenset()
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
        names = (*self.sensors, *self.inputs)
        # by run that starts from its tracker: that, the steps until each has forgotten its start,
        # and whom the tracker reads. Its readings have to be in the support, too
        self._trackers: dict[int, tuple[int, int, int, frozenset[str]]] = {}
        for t in batch.tracked:
            reads = frozenset(n for n, does in zip(names, batch.starts_on[t.tracker]) if does)
            of_run = [r for r, run in zip(residuals, self._runs_of) if run == t.own]
            if not t.temporary and math.isfinite(t.warm_up) and all(
                    reads & set(self.sensors) <= set(r.support) for r in of_run
                    if isinstance(r, Residual)):
                self._trackers[t.own] = (
                    t.tracker, math.ceil(t.warm_up / (self.period * 1e-9)),
                    int(self._warm[self._runs_of == t.own].max(initial=0)), reads)

    def reset(self) -> None:
        """Forget all."""
        self._looked: int | None = None  # last tick that was looked at
        self._waiting: int | None = None  # since when somebody has spoken, but not all
        super().reset()
        runs = len(self._batch.runs_on)
        self._spoilt = np.full(runs, NEVER)  # tick until which each may have read what was faulty
        self._put = np.full(runs, NEVER)  # tick at which each was put where its tracker was
        self._anew: set[int] = set()  # runs that are to be

    def blame(self, names: Collection[str]) -> None:
        """Take these sensors, the complete set, for faulty; what has read others starts anew."""
        gone, self._blamed = self._blamed.difference(names), frozenset(names)
        if not gone or self._looked is None:
            return
        new = np.array([name in gone for name in (*self.sensors, *self.inputs)])
        reads = np.array(self._batch.starts_on[:, new].any(axis=1))
        for run, (_, _, warm, told) in self._trackers.items():
            reads[run] |= self._looked - self._put[run] < warm and not gone.isdisjoint(told)
        self._spoilt[reads] = self._looked
        self._anew |= self._trackers.keys() & set(np.flatnonzero(reads).tolist())
        stop(self._past, ~reads)
        self._runs.reset()  # of these nobody serves
        self._flights.reset()

    def _placed(self, state: State) -> State:
        """Put those where their trackers are that start anew, once these have forgotten theirs."""
        state = super()._placed(state)
        for run in sorted(self._anew):
            tracker, warm, _, reads = self._trackers[run]
            since = max(state.since[tracker], self._spoilt[tracker])
            if state.running[run] and state.running[tracker] and state.tick - since >= warm \
                    and reads.isdisjoint(self._blamed):
                z = state.z.copy()
                z[run], state = z[tracker], state._replace(z=z)
                self._put[run] = state.tick
                self._anew.remove(run)
        return state

    def _drop_after(self, tick: int) -> None:
        super()._drop_after(tick)
        self._anew |= set(np.flatnonzero(self._put > tick).tolist())
        self._put[self._put > tick] = NEVER

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
            since = np.maximum(state.since, self._spoilt)[self._runs_of]
            put = self._put[self._runs_of]
            warm = state.running[self._runs_of] & (
                (state.tick - since >= self._warm) | (since <= put) & (put <= state.tick))
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
