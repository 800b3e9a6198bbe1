"""From a design to one that isolates: what is missing is designed, pairs first, then filters."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import chain

from vsensor_ros.designer.dedicated import dedicated
from vsensor_ros.designer.existence import examine
from vsensor_ros.designer.gaps import gaps
from vsensor_ros.designer.isolability import distinctions
from vsensor_ros.designer.problem import pose
from vsensor_ros.designer.residuals import residual, residuals
from vsensor_ros.designer.sentences import say
from vsensor_ros.observers import (
    Design,
    Distinction,
    Isolability,
    NONE,
    Residual,
    STRENGTHS,
    WEAK,
)
from vsensor_ros.plant import Plant


def isolated(plant: Plant, designed: Design,
             again: Callable[[list[tuple[str, ...]]], Design],
             progress: Callable[[int, int, str], None] | None = None) -> Design:
    """
    Return a design whose residuals isolate all that its plant allows, and that says what it is.

    Faults of each sensor are to be told from none, from each other one, and from those of each
    fault set of the design. Where a virtual sensor of a pair would tell two, ``again`` designs the
    pair, which becomes a fault set of the design; dedicated filters do the rest.
    """
    sets = dict.fromkeys(((), *((s,) for s in plant.sensors), *designed.fault_sets))
    plant_allows = distinctions(plant, [s for s in sets if len(s) < len(plant.sensors)])
    pairs = _pairs(plant, designed, plant_allows)
    if pairs:
        designed = Design(**{**vars(designed),
                             'entries': {**designed.entries, **again(pairs).entries}})
    found = Isolability(_quietest(_agreed(residuals(plant, designed.each_once()), plant_allows)),
                        plant=plant_allows)
    for done, others in enumerate(sets):
        if progress is not None:
            progress(done, len(sets), f'a filter without {", ".join(others) or "a fault"}')
        missing = _missing(found, (d for d in plant_allows if d.others == others))
        if missing:
            filters = dedicated(plant, others, {d.sensor: d.strength for d in missing})
            more = _agreed((residual(plant, f) for f in filters), plant_allows)
            found = replace(found, residuals=(*found.residuals, *more),
                            filters={**found.filters, **{f.channel: f for f in filters}})
    if progress is not None:
        progress(len(sets), len(sets), 'done')
    found = replace(found, gaps=tuple(say(gap) for gap in gaps(plant, found)))
    return Design(**{**vars(designed), 'isolability': found})


def _missing(found: Isolability, wanted: Iterable[Distinction]) -> list[Distinction]:
    """Return what the plant allows and the residuals do not do."""
    return [d for d in wanted if STRENGTHS.index(d.strength) > STRENGTHS.index(
        found.by_residuals(d.sensor, d.others))]


def _pairs(plant: Plant, designed: Design,
           allowed: tuple[Distinction, ...]) -> list[tuple[str, ...]]:
    """Return the pairs whose virtual sensors tell one from the other, which nothing does yet."""
    found = Isolability(_agreed(residuals(plant, designed.each_once()), allowed))
    pairs: dict[tuple[str, ...], None] = {}
    for d in _missing(found, (d for d in allowed if len(d.others) == 1)):
        pair = tuple(s for s in plant.sensors if s in (d.sensor, *d.others))
        # one that serves for a time would read both while it tracks
        if pair not in designed.fault_sets and pair not in pairs and examine(
                pose(plant, pair, d.sensor)).obstruction is None:
            pairs[pair] = None
    return sorted(pairs, key=lambda pair: [plant.sensors.index(s) for s in pair])


def _agreed(made: Iterable[Residual], allowed: tuple[Distinction, ...]) -> tuple[Residual, ...]:
    """Take from residuals what the plant does not allow, which is rounding; drop empty ones."""
    none = {(d.sensor, d.others) for d in allowed if d.strength == NONE}
    weak = {(d.sensor, d.others) for d in allowed if d.strength == WEAK}
    agreed = []
    for r in made:
        gains = dict(zip(r.support, r.gains))
        apart = [d.others for d in allowed if not set(d.others) & set(r.support)]
        for s, others in set(chain.from_iterable(((s, o) for o in apart) for s in r.support)):
            if (s, others) in none:
                gains.pop(s, None)
            elif (s, others) in weak and s in gains:
                gains[s] = 0.0
        if gains:
            agreed.append(replace(r, support=tuple(gains), gains=tuple(gains.values())))
    return tuple(agreed)


def _quietest(made: tuple[Residual, ...]) -> tuple[Residual, ...]:
    """Return of residuals of one channel that feel the same only the quietest."""
    best: dict[object, Residual] = {}
    for r in sorted(made, key=lambda r: (r.noise, len(r.fault_set))):
        best.setdefault((r.channel, r.support, tuple(map(bool, r.gains))), r)
    return tuple(r for r in made if r in best.values())
