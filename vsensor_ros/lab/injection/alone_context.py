"""What a case acts on where nobody isolates: the replacer's own isolator has to find out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
import math
import time

from vsensor_ros.lab.injection.blame import (
    BY_READINGS,
    BY_RESIDUALS,
    expected,
    Found,
    found_of,
    HEALTHY,
    Injected,
    ISOLATED,
    judge_blame,
)
from vsensor_ros.lab.injection.case_context import CaseContext, CONVERGED, SOON
from vsensor_ros.lab.injection.under_test import UnderTest
from vsensor_ros.lab.injection.verdict import PART, Said, SIGMAS
from vsensor_ros.observers import Isolability

LEARNING = 1200     # readings of a healthy machine, before which its habits are not known
WARM = 60.0         # s that the slowest observer has at most to forget its start
DECAYED = 12.0      # time constants in which it has for certain
UP = 4.0            # s until a process that was started hears all
FOUND = 10.0        # s in which a fault must have been found, beside the max_age of its sensor
WINDOW = 64         # readings in which noise is looked for
JUDGED = 0.3        # s until what was read last has been judged
RETURNED = 3.0      # s in which a residual must have come back
CALM = 30.0         # s in which a suspicion must have passed


@dataclass
class AloneContext(CaseContext):
    """A replacer whom nobody tells who has failed."""

    to_learn: float | None = None   # s that may be left to learn; None: it has just started
    started: float = field(default_factory=time.monotonic)  # when the residuals' observers did

    apart = 6.0     # all that alarms within 5 s is one fault

    def begin(self) -> None:
        """Begin a case: what was heard before is forgotten."""
        super().begin()
        self.machine.faulty &= self.machine.verdict.kinds.keys()
        self.machine.heard.said.append(self.machine.verdict._replace(arrival=time.monotonic()))
        self.injected: list[Injected] = []
        self.found: list[Found] = []    # what became of them, when the case is over

    def finish(self) -> list[str]:
        """End a case: judge all that was heard; return what was wrong."""
        heard = self.machine.heard
        wrong = super().finish()
        self.found = self.aside(lambda: [
            found_of(fault, heard, self.machine.truth) for fault in self.injected])
        self.seen[:0] = [str(found) for found in self.found]
        return wrong + judge_blame(heard.said, self.injected, heard.begun)

    # ------------------------------------------------------------------------------ faults

    def expected(self, faults: Mapping[str, str]) -> tuple[str, frozenset[str]] | None:
        """Return the state that new faults by sensor lead to, and who must be blamed."""
        return expected(self._isolability, self.tested.plant.sensors, faults)

    @property
    def _isolability(self) -> Isolability:
        found = self.tested.design.isolability
        assert found is not None
        return found

    def fault(self, kind: str, name: str = '', /, **size: float) -> None:
        """Let a sensor, by default the target, fail from now on."""
        name = name or self.target
        super().fault(kind, name, **size)
        self.note(kind, name)

    def note(self, kind: str, name: str) -> None:
        """Note that a sensor fails from now on."""
        if name in self.machine.faulty:     # one that was blamed goes on
            for fault in self.injected:
                fault.healed = math.inf if fault.sensor == name else fault.healed
            return
        found = self.expected({name: kind}) == (ISOLATED, frozenset({name}))
        self.injected.append(Injected(
            name, kind, (BY_READINGS | BY_RESIDUALS)[kind] if found else '', time.monotonic()))

    def heal(self) -> None:
        """Let all sensors measure again."""
        super().heal()
        for fault in self.injected:
            fault.healed = min(fault.healed, time.monotonic())

    def forget(self) -> None:
        """Forget what the replacer said: it is another one."""
        self.machine.latest, self.machine.faulty = {}, frozenset()
        self.machine.verdict = Said(time.monotonic(), '', {})

    def restarted(self) -> None:
        """Note that the observers of the residuals start anew."""
        self.started, self.fresh = time.monotonic(), False

    def unready(self) -> float:
        """Return how long [s] it takes until these have forgotten their starts."""
        return max(0.0, self.started + UP + forgetting_time(self.tested) - time.monotonic())

    # --------------------------------------------------------------------------- isolation

    def isolate(self, *names: str) -> None:
        """Wait until these have been found, too; those found before stay so until cleared."""
        for name in names:
            if name not in self.machine.faulty:
                self.until(partial(self._blames, name), FOUND + self.tested.max_age[name],
                           f'{name} blamed')
                for fault in self.injected:
                    fault.awaited |= fault.sensor == name
        super().isolate(*dict.fromkeys([*self.machine.faulty, *names]))

    def believe(self, *names: str, others: tuple[str, ...] = ()) -> None:
        """Clear sensors that are healthy again, once that shows."""
        for name in names:
            if name in self.machine.verdict.kinds:
                self._await_return(name)
                self.clear(name)
                self.until(partial(self._blames, name, False), RETURNED, f'{name} cleared')
            self.expect(name, 'real')

    def _blames(self, name: str, does: bool = True) -> bool:
        return (name in self.machine.verdict.kinds) is does

    def clear(self, name: str) -> None:
        """Have the isolator forget what it has against a sensor."""
        for fault in self.injected:
            if fault.sensor == name and fault.awaited:
                fault.over = min(fault.over, time.monotonic() + JUDGED)
        self.machine.faulty -= {name}
        if any(f.sensor == name and f.healed == math.inf for f in self.injected):
            self.undetected(name)
        latched = self.tested.beliefs[name].recovery == 'latched'
        if not self.call('reset' if latched else f'{name}/clear'):
            self.wrong.append(f'{name} could not be cleared')
        self.fresh &= not latched

    def _await_return(self, name: str) -> None:
        """Wait until what a healed sensor reads is near its estimate again, as ~/status says."""
        healed = time.monotonic()
        self.play(JUDGED)
        if any(f.sensor == name and f.fault == 'noise' for f in self.injected):
            self.play(WINDOW / self.tested.parameters.general('rate'))

        def near() -> bool:
            if not self.machine.heard.told:     # nothing new since a case was judged
                return False
            status = self.machine.heard.told[-1]
            facts = status.facts.get(name, {})
            residual, deviation = _number(facts, 'residual'), _number(facts, 'deviation')
            bar = max(PART * self.span(name), SIGMAS * (deviation or 0.0))
            return status.arrival > healed + JUDGED and (
                facts.get('source') != 'virtual' or residual is None or abs(residual) <= bar)
        self.until(near, RETURNED, f'{name} near its estimate')

    def await_state(self, state: str, within: float) -> None:
        """Play until the isolator is in a state; note if it is not in time."""
        self.until(lambda: self.machine.verdict.state == state, within,
                   f'the isolator {state}, but {self.machine.verdict.state or "silent"}:')

    def learn(self) -> None:
        """Let the healthy machine be learnt; nobody is suspected, all can be replaced."""
        known = LEARNING / self.tested.parameters.general('rate')
        self.until(lambda: math.isfinite(self.machine.verdict.learning), SOON, 'its isolator')
        self.await_state(HEALTHY, CALM)
        self.play(self.unready())
        if self.to_learn is None:
            self.to_learn = max(0.0, self.machine.verdict.learning - known)
        self.until(lambda: self.machine.verdict.learning <= (self.to_learn or 0.0),
                   learning_time(self.tested), 'enough learnt')
        self.await_reserve(self.target)
        self.fresh = True

    def await_reserve(self, name: str) -> None:
        """Play until a sensor that can be replaced could be now."""
        if self.tested.serves([name], name) == 'virtual':
            self.until(lambda: self.machine.latest.get(name, {}).get('reserve') != 'not ready',
                       CONVERGED, f'a reserve for {name}')


def learning_time(tested: UnderTest) -> float:
    """Return how long it takes until enough is learnt of a healthy machine [s]."""
    return UP + LEARNING / tested.parameters.general('rate') + forgetting_time(tested)


def forgetting_time(tested: UnderTest) -> float:
    """Return how long the slowest observer of a residual takes to forget its start [s]."""
    found = tested.design.isolability
    entries = [*tested.design.virtual_sensors, *(found.filters.values() if found else ())]
    slowest = min((entry.decay for entry in entries), default=0.0)
    return min(WARM, DECAYED / max(slowest, 1e-3))


def _number(facts: Mapping[str, str], key: str) -> float | None:
    """Return a finite number that a status has; None where it has none."""
    try:
        number = float(facts.get(key, ''))
    except ValueError:
        return None
    return number if math.isfinite(number) else None
