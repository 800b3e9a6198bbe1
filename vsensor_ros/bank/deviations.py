"""How sure what the virtual sensors say is: standard deviations, each worked out once a state."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import math

import numpy as np

from vsensor_ros.bank.free_runs import FreeRuns
from vsensor_ros.bank.measured import Measured
from vsensor_ros.bank.spread import Spreads
from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch

_FEW = 2  # outputs, of which unseen motion is worked out one by one


class Deviations:
    """
    The deviations of the outputs of a batch; `past` is that of the bank, and now its last state.

    tracked: which of the tracked an output is of. period [s] of the grid. ages: the ages [s] of
    the readings (L,) at a tick. widening: by what factor an output is worse now than usual.
    """

    def __init__(self, batch: Batch, runs: FreeRuns, spreads: Spreads, measured: Measured,
                 past: deque[State], period: float, ages: Callable[[int], np.ndarray],
                 widening: Callable[[int], float]) -> None:
        self._batch, self._runs, self._spreads, self._measured = batch, runs, spreads, measured
        self._past, self._period, self._ages, self._widening = past, period, ages, widening
        tracked = {t.own: i for i, t in enumerate(batch.tracked)}
        self._tracked = [tracked.get(row) for row in batch.of.tolist()]
        self._state: State | None = None  # of which this is known:
        self._unseen: np.ndarray | None = None  # (O,), once many were asked for
        self._unseen_of: dict[int, float] = {}  # of the few that were, by output
        self._known: dict[tuple[int, int], float] = {}  # by output and run

    def of_run(self, output: int, row: int) -> float:
        """Return the deviation of what an output says now of one of its runs."""
        self._look()
        if (output, row) not in self._known:
            self._known[output, row] = self._of_run(
                output, row, self._past[-1], self.unseen(output))
        return self._known[output, row]

    def of_run_at(self, output: int, row: int, state: State) -> float:
        """Return the deviation of what it said at a state."""
        if state is self._past[-1]:
            return self.of_run(output, row)
        return self._of_run(output, row, state, float(self._unseen_at(state, output)[0]))

    def _of_run(self, output: int, row: int, state: State, unseen: float) -> float:
        age = float(state.tick - state.since[row]) * self._period
        i, wider = self._tracked[output], self._widening(output)
        if i is not None and row == self._batch.tracked[i].free:
            # what the model errs more now reaches it in time as much as the independent run
            more = 0.0 if self._batch.tracked[i].temporary or wider == 1.0 else \
                math.sqrt(wider**2 - 1.0) * self._measured.base[output]
            growth = self._measured.growth
            # of one that tells its own, what was computed for where the plant works says no more
            usual = growth.shown if self._batch.along(i, state.z[row]) else growth.stated
            found = math.hypot(unseen, more, wider * max(usual(i, age), self.along(i, state)))
        else:
            found = math.hypot(
                wider * self._measured.base[output], unseen, self._batch.deviation(
                    output, state.z[:self._batch.size], state.told, age))
        return math.inf if math.isnan(found) else found

    def along(self, i: int, state: State) -> float:
        """Return what came of a flight's error along its way; 0: as much as `drift` tells."""
        return max(self._spreads.deviation(i, state), self._batch.along(
            i, state.z[self._batch.tracked[i].free]))

    def lost(self, output: int, state: State) -> bool:
        """Tell whether nothing can be told of where a flight is by now."""
        i = self._tracked[output]
        assert i is not None
        return self.along(i, state) == math.inf

    def if_lost(self, output: int, guard: float) -> float:
        """Return the deviation of a tracked one if its channels were lost now; guard [s]."""
        i = self._tracked[output]
        assert i is not None
        return self._widening(output) * self._measured.growth.stated(i, guard)

    def until(self, output: int, age: float, unseen: float, limit: float) -> float:
        """Return the time [s] until a free run of an age [s] passes a limit; inf: never."""
        i, left = self._tracked[output], limit**2 - unseen**2
        assert i is not None
        return 0.0 if left <= 0.0 or age == math.inf else \
            self._measured.growth.until(i, age, math.sqrt(left))

    def proven(self, output: int) -> bool:
        """Tell whether it was compared for so long that its deviation is known."""
        return self._measured.record.proven(output)

    def unseen(self, output: int) -> float:
        """Return what readings may have moved an output by now since their last."""
        self._look()
        if self._unseen is None and output not in self._unseen_of:
            if len(self._unseen_of) < _FEW:
                self._unseen_of[output] = float(self._unseen_at(self._past[-1], output)[0])
            else:
                self._unseen = self._unseen_at(self._past[-1])
        return float(self._unseen_of[output] if self._unseen is None else self._unseen[output])

    def _unseen_at(self, state: State, output: int | None = None) -> np.ndarray:
        """Return that of one output (1,), or of all (O,)."""
        return self._measured.unseen(state.tick, self._ages(state.tick), output)

    def _look(self) -> None:
        """Forget what was known of another state."""
        if self._state is not self._past[-1]:
            self._state, self._unseen = self._past[-1], None
            self._unseen_of.clear()
            self._known.clear()
