"""What the virtual sensors say, and how far readings are off it."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import math
from typing import NamedTuple

import numpy as np

from vsensor_ros.bank.angle import Angle
from vsensor_ros.bank.free_runs import FreeRuns
from vsensor_ros.bank.measured import Measured
from vsensor_ros.bank.serving import OUT_OF_LINE, Serving
from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch


class Disagreement(NamedTuple):
    """
    How far the last value of a source lies above that of another; in the unit of the channel.

    What is beyond the usual may be the fault for which the other takes over.
    """

    usual: float  # as far as they differed while all was well
    rest: float


class Estimates:
    """
    What the outputs of a batch say, each by the run that serves now; `past` is that of the bank.

    period [s] of the grid. angles: by sensor that wraps.
    """

    def __init__(self, batch: Batch, runs: FreeRuns, serving: Serving, measured: Measured,
                 past: deque[State], period: float, angles: Mapping[str, Angle]) -> None:
        self._batch, self._runs, self._serving = batch, runs, serving
        self._measured, self._past, self._period, self._angles = measured, past, period, angles
        # of which state and serving runs it is known what they say (O,)
        self._known: tuple[State, np.ndarray, np.ndarray] | None = None

    def at(self, state: State) -> np.ndarray:
        """Return what all say (O,) at a state."""
        rows, known = self._runs.rows, self._known
        if known is not None and known[0] is state and known[1] is rows:
            return known[2]
        with np.errstate(all='ignore'):
            said = self._batch.estimates(self._runs.serving(state.z), state.told.y,
                                         state.told.held)
        if state is self._past[-1]:
            self._known = state, rows, said
        return said

    def residual(self, output: int, reading: tuple[int, float] | None) -> float | None:
        """Return reading (tick, value) - estimate then; None when that is not known any more."""
        if reading is None or not self._past or not \
                self._past[0].tick <= reading[0] <= self._past[-1].tick:
            return None
        state = self._past[reading[0] - self._past[0].tick]
        if not state.running[self._serving.row(output)]:
            return None
        value = float(reading[1] - self.at(state)[output])
        if not math.isfinite(value):
            return None
        angle = self._angles.get(self._batch.keys[output][1])
        return value if angle is None else angle.shortest(value)

    def disagreement(self, output: int,
                     reading: tuple[int, float] | None) -> Disagreement | None:
        """
        Return that, as far as such were measured before, and what is beyond.

        Where it is out of line with what was measured or designed: the median of those measured.
        """
        if self._serving.is_free(output):
            centre = 0.0
            shown, spread = self._spreads_of_free(output, reading)
        else:
            record = self._measured.record
            centre, shown = float(record.centre[output]), float(record.shown[output])
            spread = self._batch.error[output] if math.isnan(centre) else record.spread[output]
        known = not math.isnan(centre)
        value = self.residual(output, reading)
        if value is None or not abs(value - (centre if known else 0.0)) <= OUT_OF_LINE * spread:
            return Disagreement(centre, 0.0) if known else None
        usual = max(centre - shown, min(value, centre + shown)) \
            if known and shown < math.inf else 0.0
        return Disagreement(usual, value - usual)

    def _spreads_of_free(self, output: int,
                         reading: tuple[int, float] | None) -> tuple[float, float]:
        """Return of readings - what is estimated the rms before, and what it may be by now."""
        i = self._serving.tracked[output]
        seed = self._runs.seed(i)
        if seed is None or reading is None:
            return math.nan, math.nan
        age = max(0.0, (reading[0] - seed.since) * self._period)
        return seed.spread, math.hypot(seed.spread, self._measured.growth.stated(i, age))
