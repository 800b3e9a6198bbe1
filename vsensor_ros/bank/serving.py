"""
Which run of each virtual sensor serves, and how sure what it says is.

While its channels are believed that is its own run. Afterwards it may be the free run, which goes
on from their last good readings: of the two the one with the smaller deviation.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
import math

import numpy as np

from vsensor_ros.bank.angle import ShortWay
from vsensor_ros.bank.free_runs import FreeRuns
from vsensor_ros.bank.measured import Measured
from vsensor_ros.bank.spread import Spreads
from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch

OUT_OF_LINE = 4.0  # standard deviations: a residual beyond is a fault that nobody has named yet


class Serving:
    """
    Who serves for each output of a batch.

    guards (T,): the longest guard [s] of each tracked one. period [s] of the grid. short_way: of
    residuals (.., O) that wrap. widening: by what factor an output is worse now than usual.
    """

    def __init__(self, batch: Batch, runs: FreeRuns, spreads: Spreads, measured: Measured,
                 guards: list[float], period: float, short_way: ShortWay,
                 widening: Callable[[int], float]) -> None:
        self._batch, self._runs, self._spreads, self._measured = batch, runs, spreads, measured
        self.guards, self._period, self._widening = guards, period, widening
        self._of: list[int] = batch.of.tolist()
        tracked = {t.own: i for i, t in enumerate(batch.tracked)}
        # by output: which of the tracked it is of
        self.tracked: Mapping[int, int] = {
            output: tracked[row] for output, row in enumerate(self._of) if row in tracked}
        self._outputs: list[list[int]] = [[] for _ in batch.tracked]
        for output, i in self.tracked.items():
            self._outputs[i].append(output)
        self._short_way = {o: short_way.of([o]) for o in self.tracked}

    def row(self, output: int) -> int:
        """Return the run that serves for an output."""
        return int(self._runs.rows[self._of[output]])

    def is_free(self, output: int) -> bool:
        """Tell whether that is a free run."""
        i = self.tracked.get(output)
        return i is not None and self.row(output) == self._batch.tracked[i].free

    def flies(self, i: int, past: deque[State]) -> bool:
        """Tell whether a free run goes on now without its channels."""
        return self._runs.seed(i) is not None and bool(
            past and past[-1].running[self._batch.tracked[i].free])

    def until_tracked(self, output: int, past: deque[State]) -> float:
        """Return the time [s] until there is a free run if the channels are lost then."""
        i = self.tracked.get(output)
        if i is None or not past or self._runs.lost(i):
            return math.inf
        return self._runs.waiting(i, past[-1], self.guards[i])

    def deviation(self, output: int, row: int, state: State, unseen: float) -> float:
        """Return the deviation of what an output says of one of its runs; unseen: a part of it."""
        age = float(state.tick - state.since[row]) * self._period
        i, wider = self.tracked.get(output), self._widening(output)
        if i is not None and row == self._batch.tracked[i].free:
            # what the model errs more now reaches it in time as much as the independent run
            more = 0.0 if self._batch.tracked[i].temporary or wider == 1.0 else \
                math.sqrt(wider**2 - 1.0) * self._measured.base[output]
            found = math.hypot(unseen, more, wider * max(
                self._measured.growth.stated(i, age), self._spreads.deviation(i, state)))
        else:
            found = math.hypot(
                wider * self._measured.base[output], unseen, self._batch.deviation(
                    output, state.z[:self._batch.size], state.told, age))
        return math.inf if math.isnan(found) else found

    def choose(self, state: State, deviation: Callable[[int, int], float]) -> bool:
        """
        Let the run with the smaller deviation serve; tell whether another one does now.

        deviation: that of an output of a run, at this state.
        """
        changed = False
        for i in self._runs.flights:
            if not self._batch.tracked[i].temporary:
                for output in self._outputs[i]:
                    changed |= self._choose(i, output, state, deviation)
        return changed

    def _choose(self, i: int, output: int, state: State,
                deviation: Callable[[int, int], float]) -> bool:
        own, free = self._of[output], self._batch.tracked[i].free
        alone = freely = math.inf
        age = float(state.tick - state.since[own]) * self._period
        if state.running[own] and not self._batch.waiting(
                output, state.z[:self._batch.size], age):
            # it knows no more of where it is than the free run, that its terms bend as much
            alone = max(deviation(output, own), self._spreads.deviation(i, state))
        if state.running[free]:
            freely = deviation(output, free)
        proven = self._measured.record.proven(output)
        agree = not proven or max(alone, freely) == math.inf or \
            self._apart(output, own, free, state) <= OUT_OF_LINE * math.hypot(alone, freely)
        return self._runs.choose(i, alone, freely, proven, agree)

    def _apart(self, output: int, own: int, free: int, state: State) -> float:
        """Return by how much the independent and the free run of a tracked one differ now."""
        with np.errstate(all='ignore'):
            said = self._batch.estimate(output, state.z[[own, free]], state.told.y,
                                        state.told.held)
        return abs(float(self._short_way[output](said[1:] - said[:1])[0]))
