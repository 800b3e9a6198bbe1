"""
Plays a recording through the engine that runs on the machine, and loses sensors in it.

The engine is told what a node tells it, event by event: see `Replacer.poll`. At each loss it is
copied: the copy goes on without the sensors to the end of the loss, the engine itself with them.
So every loss is that of a machine on which all was well until then.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import deepcopy
import math
from typing import NamedTuple

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
from vsensor_ros.reason import Reason
from vsensor_ros.recordings.recording import BEGIN, Recording

ABSENT = Reason.of('not in the message', field='')


class Loss(NamedTuple):
    """Sensors of which nothing comes from `start` to `end` [s]; isolation says so at once."""

    names: tuple[str, ...]
    start: float
    end: float


class Said(NamedTuple):
    """What went out for a lost sensor, at each tick of the loss; NaN where nothing did."""

    times: np.ndarray  # (T,) s, of which the estimates are
    values: np.ndarray  # (T,)
    deviations: np.ndarray  # (T,), standard, as stated


class _Message(NamedTuple):
    stamp: int
    values: tuple[float | Reason, ...]
    foreign: bool = False


_Event = tuple[int, dict[str, float]]


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
           ) -> list[tuple[Loss, dict[str, Said]]]:
    """Return for each loss, in order of their starts, what went out for the lost sensors."""
    events = list(recording.events())
    stamps = np.array([stamp for stamp, _ in events])
    engine, told, found = Engine(setup), 0, []
    engine.look(int(stamps[0]), 0.0)
    engine.activate()
    for loss in sorted(losses, key=lambda loss: loss.start):
        start, end = (recording.origin + round(at * 1e9) for at in (loss.start, loss.end))
        until, last = np.searchsorted(stamps, (start, end)).tolist()
        _play(engine, setup, events[told:until])
        told = until
        found.append((loss, _said(loss, setup, _lose(
            deepcopy(engine), setup, events[until:last], loss.names, start))))
    return found


def _lose(engine: Engine, setup: Setup, events: Sequence[_Event], names: tuple[str, ...],
          now: int) -> list[Composition]:
    engine.look(now, now * 1e-9)
    made = engine.isolate(IsolationReport(
        dict.fromkeys(names, now), frozenset(setup.design.sensors)))
    for composition in made:
        engine.done(composition)
    return made + _play(engine, setup, events, names)


def _play(engine: Engine, setup: Setup, events: Sequence[_Event],
          lost: tuple[str, ...] = ()) -> list[Composition]:
    """Tell an engine what was said, but by the lost; return what it lets go out for them."""
    found = []
    for stamp, said in events:
        engine.look(stamp, stamp * 1e-9)
        for i, plan in enumerate(setup.streams):
            live = [name for name in plan.names if name in said and name not in lost]
            if live:
                message = _Message(stamp, tuple(
                    said[name] if name in live else math.nan if name in lost else ABSENT
                    for name in plan.names))
                engine.judge(i, message, stamp)
                engine.learn(i, message, stamp)
        for name in setup.design.inputs:
            if name in said:
                engine.command(name, said[name], stamp, stamp)
        for at in engine.ticks():
            for composition in engine.tick(at):
                engine.done(composition)
                found.append(composition)
    return found


def _said(loss: Loss, setup: Setup, made: Sequence[Composition]) -> dict[str, Said]:
    """Put what went out on the ticks of the loss."""
    ticks = np.arange(math.ceil(loss.start * setup.rate), math.ceil(loss.end * setup.rate))
    times = ticks / setup.rate
    found = {name: Said(times, np.full(len(ticks), np.nan), np.full(len(ticks), np.nan))
             for name in loss.names}
    for composition in made:
        tick = round((composition.time - BEGIN) * 1e-9 * setup.rate) - int(ticks[0])
        for i, field in composition.fields:
            name = setup.streams[composition.stream].names[i]
            if name in found and isinstance(field, Substitute) and field.fault_set is not None \
                    and 0 <= tick < len(ticks):
                found[name].values[tick] = field.value
                found[name].deviations[tick] = field.deviation
    return found
