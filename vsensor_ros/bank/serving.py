"""
Which run of each virtual sensor serves.

While its channels are believed that is its own run. Afterwards it may be the free run, which goes
on from their last good readings: of the two the one with the smaller deviation.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
import math

import numpy as np

from vsensor_ros.bank.angle import ShortWay
from vsensor_ros.bank.deviations import Deviations
from vsensor_ros.bank.free_runs import FreeRuns
from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch

AT_A_TICK = 4  # flights of which it is looked at a tick who serves, but for new ones
OUT_OF_LINE = 4.0  # standard deviations: a residual beyond is a fault that nobody has named yet


class Serving:
    """
    Who serves for each output of a batch now; `past` is that of the bank.

    guards (T,): the longest guard [s] of each tracked one. period [s] of the grid. short_way: of
    residuals (.., O) that wrap.
    """

    def __init__(self, batch: Batch, runs: FreeRuns, past: deque[State], guards: Sequence[float],
                 period: float, short_way: ShortWay) -> None:
        self._batch, self._runs, self._past = batch, runs, past
        self.guards, self._period = guards, period
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

    def runs(self, output: int) -> bool:
        """Tell whether that runs now."""
        return bool(self._past and self._past[-1].running[self.row(output)])

    def age(self, output: int, state: State | None = None) -> float:
        """Return for how long [s] it has been running at a state; by now."""
        state = state or self._past[-1]
        return float(state.tick - state.since[self.row(output)]) * self._period

    def is_free(self, output: int) -> bool:
        """Tell whether it is a free run."""
        i = self.tracked.get(output)
        return i is not None and self.row(output) == self._batch.tracked[i].free

    def flies(self, i: int) -> bool:
        """Tell whether a free run goes on now without its channels."""
        return self._runs.seed(i) is not None and bool(
            self._past and self._past[-1].running[self._batch.tracked[i].free])

    def waiting(self, output: int) -> float:
        """Return the time [s] until the run that serves has forgotten its start."""
        if self.is_free(output):
            return 0.0 if self.flies(self.tracked[output]) else math.inf
        return self._batch.waiting(output, self._past[-1].z[:self._batch.size], self.age(output))

    def until_ready(self, output: int) -> float:
        """Return the time [s] until it may serve: 0 when it may, inf when it does not run."""
        alone = self.waiting(output) if self.runs(output) else math.inf
        return min(alone, self.until_tracked(output))

    def until_tracked(self, output: int) -> float:
        """Return the time [s] until there is a free run if the channels are lost then."""
        i = self.tracked.get(output)
        if i is None or not self._past or self._runs.lost(i):
            return math.inf
        return self._runs.waiting(i, self._past[-1])

    def choose(self, deviations: Deviations) -> None:
        """Let the run with the smaller deviation serve."""
        if not self._runs.flights or not self._past:
            return
        state, turns = self._past[-1], -(-len(self._runs.flights) // AT_A_TICK)
        for at, i in enumerate(self._runs.flights):
            if self._batch.tracked[i].temporary:
                continue
            for output in self._outputs[i]:
                # of many some at a time: they grow slowly. But who is new, or has stopped, at once
                if (at + state.tick) % turns == 0 or self._runs.is_fresh(i) or \
                        not self.runs(output):
                    self._choose(i, output, state, deviations)

    def _choose(self, i: int, output: int, state: State, deviations: Deviations) -> None:
        own, free = self._of[output], self._batch.tracked[i].free
        alone = freely = math.inf
        age = float(state.tick - state.since[own]) * self._period
        if state.running[own] and not self._batch.waiting(
                output, state.z[:self._batch.size], age):
            # it knows no more of where it is than the free run, that its terms bend as much
            alone = max(deviations.of_run(output, own), deviations.along(i, state))
        if state.running[free]:
            freely = deviations.of_run(output, free)
        proven = deviations.proven(output)
        agree = not proven or max(alone, freely) == math.inf or \
            self._apart(output, own, free, state) <= OUT_OF_LINE * math.hypot(alone, freely)
        self._runs.choose(i, alone, freely, proven, agree)

    def _apart(self, output: int, own: int, free: int, state: State) -> float:
        """Return by how much the independent and the free run of a tracked one differ now."""
        with np.errstate(all='ignore'):
            said = self._batch.estimate(output, state.z[[own, free]], state.told.y,
                                        state.told.held)
        return abs(float(self._short_way[output](said[1:] - said[:1])[0]))
