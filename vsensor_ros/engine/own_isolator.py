"""
The engine's own isolation: the isolator, and the observers whose residuals it judges.

Both look at what every sensor says, whatever the engine does about it. What the isolator has
learnt is kept by whoever runs the engine.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import Residuals
from vsensor_ros.engine.events import IsolationReport
from vsensor_ros.engine.fault_sizes import Sizes
from vsensor_ros.engine.settings import Setup
from vsensor_ros.isolator import Isolator, load, save, Verdict
from vsensor_ros.isolator.verdict import MODEL
from vsensor_ros.reason import Reason

NOBODY = IsolationReport({}, frozenset())
SOURCE = 'isolator'  # what it is called beside others who isolate


@dataclass(frozen=True)
class Learnt:
    """What an isolator had learnt at a time, to be saved; it does not change any more."""

    isolator: Isolator

    def save(self, path: str | Path, design_hash: str) -> None:
        """Write it, whole or not at all; raises BadInput."""
        save(self.isolator, path, design_hash)


class OwnIsolator:
    """Finds out which sensors have failed. Times are in ns."""

    def __init__(self, setup: Setup) -> None:
        """Prepare; raises BadInput."""
        design, settings = setup.design, setup.isolator
        found = design.isolability
        assert settings is not None
        if found is None or not found.residuals:
            raise BadInput('', 'isolator.mode', f'is {settings.mode}, but the design says nothing '
                           'of whose fault it is' if found is None else
                           f'is {settings.mode}, but no residual tells of a fault',
                           'design with designer --isolate' if found is None else
                           'set it to off, or add a sensor: designer --isolate --locate')
        self.acts = settings.mode == 'act'
        turns = {name: abs(turn) for angle in design.wrap for name, turn in angle.items()}
        sizes = () if design.fault_sizes is None else design.fault_sizes.found
        self._residuals = Residuals(design.isolating(), (*found.residuals, *sizes), setup.rate,
                                    setup.max_age, setup.jump_ahead, setup.command_ends)
        self._count = len(found.residuals)
        self.sizes = Sizes(sizes, design.sensors, self._residuals.period * 1e-9, turns)
        self._isolator = Isolator(settings, design.sensors, found.residuals,
                                  self._residuals.period * 1e-9, turns, design.units)
        self._batch = self._isolator.watch.batch
        self.verdict = Verdict(0)
        self._seen: tuple[object, ...] = ()

    def take(self, name: str, stamp: int, value: float, now: int) -> None:
        """Take a reading or a command of a time."""
        self._residuals.take(name, stamp, value, now)

    def spoil(self, name: str, time: int) -> None:
        """Note that a command came that could not be read."""
        self._residuals.spoil(name, time)

    def restart(self) -> None:
        """Forget what came in, after the clock jumped; what was learnt and found stays."""
        self._residuals.reset()
        self.sizes.restart()

    def step(self, now: int) -> bool:
        """Judge what is complete by now; tell whether the verdict says something else."""
        for time, readings, estimates in self._residuals.at_least(self._batch, now):
            self.verdict = self._isolator.step(time, readings, estimates[:self._count])
            self.sizes.step(time, readings, estimates[self._count:])
        self._residuals.blame(self.verdict.faulty)
        return self._changed()

    def news(self) -> list[tuple[Reason, object]]:
        """Return what people should hear of the verdict, each with what it is about."""
        told: list[tuple[Reason, object]] = [
            (fault.reason(self.verdict.time), (SOURCE, fault.sensor, fault.kind))
            for fault in self.verdict.faults]
        told += [(why, (SOURCE, why.code)) for why in self.verdict.reasons
                 if why.code in ('fault ambiguous', 'fault of model')]
        if not any(why.code == 'fault learning' for why in self.verdict.notes):
            told += [(why, (SOURCE, why)) for why in self._isolator.too_small()]
        return told

    def clear(self, names: tuple[str, ...]) -> bool:
        """
        Believe sensors again; tell whether one was blamed.

        While the model is blamed and no sensor, any of them tells that the machine is healthy.
        """
        blamed = [name for name in names if name in self.verdict.faulty]
        model = self.verdict.state == MODEL and not self.verdict.faulty
        for name in names[:1] if model else blamed:
            self._isolator.clear(name)
        self.verdict = self._isolator.verdict
        self._residuals.blame(self.verdict.faulty)
        return self._changed() or bool(blamed)

    def _changed(self) -> bool:
        verdict = self.verdict
        seen = (verdict.state, tuple((f.sensor, f.kind) for f in verdict.faults),
                verdict.candidates, tuple(note.code for note in verdict.notes))
        before, self._seen = self._seen, seen
        return seen != before

    def report(self) -> IsolationReport:
        """Return whom it blames, and since when they are faulty, if that is to be acted on."""
        return NOBODY if not self.acts else IsolationReport(
            {fault.sensor: fault.onset for fault in self.verdict.faults}, frozenset())

    def learnt(self) -> Learnt:
        """Return what it has learnt by now."""
        return Learnt(deepcopy(self._isolator))

    def go_on(self, path: str | Path, design_hash: str) -> None:
        """Go on from what was learnt before; raises BadInput, and is as it was then."""
        load(self._isolator, path, design_hash)
