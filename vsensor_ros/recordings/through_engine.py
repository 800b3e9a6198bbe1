"""
Plays a recording through the engine that runs on the machine, and loses sensors in it.

The engine is told what a node tells it, event by event: see `Replacer.poll`. At each loss it is
copied: the copy goes on with faulty sensors to the end of the loss, the engine itself with healthy
ones. So every loss is that of a machine on which all was well until then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
import math
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from vsensor_ros.engine import (
    Composition,
    Engine,
    IsolationReport,
    Live,
    Policy,
    Setup,
    StreamPlan,
    Substitute,
)
from vsensor_ros.observers import Design
from vsensor_ros.reason import add_sentences, Reason
from vsensor_ros.recordings.fault import Fault, fault
from vsensor_ros.recordings.recording import Recording

ABSENT = Reason.of('not in the message', field='')
NONE: Mapping[str, Any] = MappingProxyType({})

add_sentences({'not blamed': '{name} is not blamed'})


class Loss(NamedTuple):
    """Sensors that are faulty from `start` to `end` [s], and who says so."""

    names: tuple[str, ...]
    start: float
    end: float
    kind: str = 'drop_out'  # of fault.KINDS
    sizes: Mapping[str, float] = NONE  # by sensor, in its unit; see `fault`
    told: float | None = 0.0  # s after the start when isolation says so; None: nobody does


class Said(NamedTuple):
    """What went out for a lost sensor, at each tick of the loss; NaN where nothing did."""

    times: np.ndarray  # (T,) s, of which the estimates are
    values: np.ndarray  # (T,)
    deviations: np.ndarray  # (T,), standard, as stated
    before: float = math.nan  # its last reading before the loss
    grade: str = ''  # of the virtual sensor that spoke last
    why: Reason | None = None  # nothing goes out at the end; None: something does
    found: float = math.nan  # s after the start when the engine's own isolator blamed all the lost
    blamed: tuple[str, ...] = ()  # by it at any time, though not lost


@dataclass
class Healthy:
    """What happened while all was well."""

    until: float = 0.0  # s
    alarms: list[tuple[float, tuple[str, ...]]] = field(default_factory=list)  # s, who was blamed


class _Message(NamedTuple):
    stamp: int
    values: tuple[float | Reason, ...]
    foreign: bool = False


_Event = tuple[int, dict[str, float]]
Done = Callable[[Loss], object]


def settings(design: Design, rate: float, together: Sequence[tuple[str, ...]] = (),
             max_age: float = 0.5) -> Setup:
    """Return an engine's settings, the defaults of a node; together: sensors of one message."""
    alone = [(name,) for name in design.sensors if not any(name in those for those in together)]
    streams = tuple(StreamPlan(names, f'{names[0]}_raw', names[0], True)
                    for names in (*together, *alone))
    return Setup(design, rate, dict.fromkeys(design.sensors, max_age), 10.0, streams, True,
                 Live('stop', 0.5, dict.fromkeys(design.sensors, Policy()),
                      dict.fromkeys(design.sensors, None)))


def replay(setup: Setup, recording: Recording, losses: Iterable[Loss],
           healthy: Healthy | None = None, done: Done | None = None,
           ) -> list[tuple[Loss, dict[str, Said]]]:
    """
    Return for each loss, in order of their starts, what went out for the lost sensors.

    healthy: takes what happened between them. done: is called after each.
    """
    events = list(recording.events())
    stamps = np.array([stamp for stamp, _ in events])
    engine, told, found = Engine(setup), 0, []
    healthy = Healthy() if healthy is None else healthy
    engine.look(int(stamps[0]), 0.0)
    engine.activate()
    for loss in sorted(losses, key=lambda loss: loss.start):
        until = int(np.searchsorted(stamps, _stamp(recording, loss.start)))
        last = int(np.searchsorted(stamps, _stamp(recording, loss.end)))
        _play(engine, setup, events[told:until], healthy=healthy, origin=recording.origin)
        told, healthy.until = until, loss.start
        copy = deepcopy(engine, {id(setup.design): setup.design})
        found.append((loss, _lose(copy, setup, recording, events[until:last], loss)))
        if done is not None:
            done(loss)
    return found


def _stamp(recording: Recording, time: float) -> int:
    return recording.origin + round(time * 1e9)


def _lose(engine: Engine, setup: Setup, recording: Recording, events: Sequence[_Event],
          loss: Loss) -> dict[str, Said]:
    """Let an engine go on with faulty sensors; return what goes out for them."""
    start = _stamp(recording, loss.start)
    before = {name: _before(recording, name, start) for name in loss.names}
    faults = {name: (start, fault(loss.kind, before[name], loss.sizes.get(name, 0.0),
                                  loss.end - loss.start, (i, start)))
              for i, name in enumerate(loss.names)}
    blame = _Blame(loss.names)
    if loss.told is None:
        made = _play(engine, setup, events, faults, blame=blame)
    else:
        told = _stamp(recording, loss.start + loss.told)
        split = next((i for i, (stamp, _) in enumerate(events) if stamp >= told), len(events))
        made = _play(engine, setup, events[:split], faults)
        if told < _stamp(recording, loss.end):
            made += _isolate(engine, setup, loss.names, start, told)
        made += _play(engine, setup, events[split:], faults)
    return _said(loss, setup, recording, made, before, engine, blame)


def _isolate(engine: Engine, setup: Setup, names: tuple[str, ...], since: int,
             now: int) -> list[Composition]:
    engine.look(now, now * 1e-9)
    made = engine.isolate(IsolationReport(
        dict.fromkeys(names, since), frozenset(setup.design.sensors)))
    for composition in made:
        engine.done(composition)
    return made


class _Blame:
    """When the engine's own isolator blames the lost, and whom else."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names, self.found, self.others = frozenset(names), 0, dict[str, None]()

    def look(self, engine: Engine, now: int) -> None:
        verdict = engine.verdict
        if verdict is not None and verdict.faulty:
            if not self.found and self.names <= set(verdict.faulty):
                self.found = now
            self.others.update(dict.fromkeys(n for n in verdict.faulty if n not in self.names))


def _play(engine: Engine, setup: Setup, events: Sequence[_Event],
          faults: Mapping[str, tuple[int, Fault]] = NONE, *, blame: _Blame | None = None,
          healthy: Healthy | None = None, origin: int = 0) -> list[Composition]:
    """Tell an engine what was said, by the faulty what they say; return what it lets go out."""
    found = []
    for stamp, true in events:
        engine.look(stamp, stamp * 1e-9)
        said = _faulty(true, faults, stamp) if faults else true
        for i, plan in enumerate(setup.streams):
            if any(said.get(name) is not None for name in plan.names):
                message = _Message(stamp, tuple([
                    ABSENT if name not in said else math.nan if (value := said[name]) is None
                    else value for name in plan.names]))
                engine.judge(i, message, stamp)
                engine.learn(i, message, stamp)
        for name in setup.design.inputs:
            if name in true:
                engine.command(name, true[name], stamp, stamp)
        for at in engine.ticks():
            for composition in engine.tick(at):
                engine.done(composition)
                found.append(composition)
        if blame is not None:
            blame.look(engine, stamp)
        elif healthy is not None and engine.verdict is not None and engine.verdict.faulty:
            healthy.alarms.append(((stamp - origin) * 1e-9, engine.verdict.faulty))
            for name in engine.verdict.faulty:  # somebody looks, and finds that all is well
                for composition in engine.clear(name):
                    engine.done(composition)
    return found


def _faulty(true: Mapping[str, float], faults: Mapping[str, tuple[int, Fault]],
            stamp: int) -> dict[str, float | None]:
    """Return what is said; None: nothing comes, or NaN where others come in the same message."""
    said: dict[str, float | None] = dict(true)
    for name, (start, say) in faults.items():
        if name in said:
            said[name] = say((stamp - start) * 1e-9, true[name])
    return said


def _before(recording: Recording, name: str, start: int) -> float:
    """Return the last reading of a sensor before a stamp; NaN when there is none."""
    track = recording.tracks[name]
    i = int(np.searchsorted(track.stamps, start)) - 1
    return float(track.values[i]) if i >= 0 else math.nan


def _said(loss: Loss, setup: Setup, recording: Recording, made: Sequence[Composition],
          before: Mapping[str, float], engine: Engine, blame: _Blame) -> dict[str, Said]:
    """Put what went out on the ticks of the loss."""
    ticks = np.arange(math.ceil(loss.start * setup.rate), math.ceil(loss.end * setup.rate))
    heard = {name: (ticks / setup.rate, np.full(len(ticks), np.nan), np.full(len(ticks), np.nan))
             for name in loss.names}
    grades = dict.fromkeys(loss.names, '')
    for composition in made:
        time = (composition.time - recording.origin) * 1e-9
        tick = round(time * setup.rate) - int(ticks[0])
        for i, told in composition.fields:
            name = setup.streams[composition.stream].names[i]
            if name in heard and isinstance(told, Substitute) and told.fault_set is not None \
                    and 0 <= tick < len(ticks):
                times, values, deviations = heard[name]
                times[tick], values[tick], deviations[tick] = time, told.value, told.deviation
                grades[name] = told.grade
    channels = {c.name: c for c in engine.snapshot(engine.now * 1e-9).channels}
    found = (blame.found - recording.origin) * 1e-9 - loss.start if blame.found else math.nan
    return {name: Said(*heard[name], before[name], grades[name],
                       None if channels[name].source == 'virtual' else
                       channels[name].reason or Reason.of('not blamed', name=name), found,
                       tuple(blame.others))
            for name in loss.names}
