"""Why virtual sensors of a bank say nothing yet, or nothing that may be used."""

from __future__ import annotations

from collections import deque
import math

from vsensor_ros.bank.deviations import Deviations
from vsensor_ros.bank.flights import Flights
from vsensor_ros.bank.free_runs import FreeRuns
from vsensor_ros.bank.inputs import Inputs
from vsensor_ros.bank.serving import Serving
from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch
from vsensor_ros.reason import Reason


class Lacks:
    """What the outputs of a batch lack now; `past` is that of the bank, `told` what it reads."""

    def __init__(self, batch: Batch, runs: FreeRuns, flights: Flights, serving: Serving,
                 deviations: Deviations, told: Inputs, past: deque[State]) -> None:
        self._batch, self._runs, self._flights = batch, runs, flights
        self._serving, self._deviations, self._told, self._past = serving, deviations, told, past
        self._of: list[int] = batch.of.tolist()
        self._sensors = tuple(told.ages)

    def invalid(self, output: int) -> Reason | None:
        """Return why what a running one says is not to be used; None: it is."""
        state = self._past[-1]
        if self._serving.is_free(output) and self._deviations.lost(output, state):
            return Reason('lost on its way')
        return self._batch.invalid(output, self._runs.serving(state.z), state.told,
                                   self._serving.age(output))

    def reason(self, output: int, says: bool, now: int | None) -> Reason | None:
        """
        Return why there is no estimate that is ready, or None when there is one.

        says: whether there is one at all. now: the time [ns] by which readings are old.
        """
        i = self._serving.tracked.get(output)
        if self._serving.until_tracked(output) == 0.0:
            return self.invalid(output)
        if i is not None and self._batch.tracked[i].temporary and not self._serving.flies(i):
            return self._not_tracked(output, i, now)
        if says:
            wait = self._serving.until_ready(output)
            if wait == math.inf:
                return Reason.of('start unknown')
            return self.invalid(output) or (self._converging(output, wait) if wait else None)
        missing = self._told.missing(self._batch.starts_on[self._of[output]], now)
        if missing is not None:
            return missing
        return Reason.of('estimate not finite' if self._serving.runs(output) else 'about to start')

    def _not_tracked(self, output: int, i: int, now: int | None) -> Reason:
        """Return why a temporary one does not run freely, nor could."""
        tracked = self._batch.tracked[i]
        lack = self._told.missing(self._batch.starts_on[self._of[output]], now)
        if lack is not None or self._runs.lost(i):
            return lack or self._runs.why[i] or Reason.of(
                'catching up' if self._flights.behind(i) else 'track lost')
        lack = self._told.missing(self._batch.starts_on[tracked.tracker], now)
        if lack is not None:
            own = [self._sensors[c] for c in tracked.channels]
            isolated = lack.code == 'input isolated' and lack.fact('name') in own
            return Reason.of('not tracked yet') if isolated else lack
        wait = self._serving.until_tracked(output)
        return self._converging(output, wait) if 0.0 < wait < math.inf \
            else Reason.of('about to start')

    def _converging(self, output: int, wait: float) -> Reason:
        code = 'converging' if self._batch.proved[output] else 'converging, not proved'
        return Reason.of(code, seconds=wait)
