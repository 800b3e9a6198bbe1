"""What cannot be isolated, and what stands in the way: one reason each."""

from __future__ import annotations

from dataclasses import replace

from vsensor_ros.designer.isolability import blind_to, Checks, checks
from vsensor_ros.observers import Isolability, NONE, STRENGTHS, STRONG, WEAK
from vsensor_ros.plant import Plant
from vsensor_ros.reason import Reason


def gaps(plant: Plant, found: Isolability) -> tuple[Reason, ...]:
    """
    Return why faults of single sensors cannot be seen, or told from those of one other.

    What follows from less is left out: whose faults are not seen cannot be told from others.
    """
    allowed = {(d.sensor, d.others): d.strength for d in found.plant if len(d.others) < 2}
    every = checks(blind_to(plant, ()))
    reasons = [reason for s in plant.sensors
               if (reason := _of_one(plant, every, s, allowed[s, ()]))]
    for s in plant.sensors:
        if allowed[s, ()] == NONE:
            continue
        alike = [i for i in plant.sensors if allowed.get((s, (i,))) == NONE]
        both = [i for i in alike if allowed.get((i, (s,))) == NONE and allowed[i, ()] != NONE]
        reasons += [_of_two(plant, every, s, i) for i in both
                    if plant.sensors.index(s) < plant.sensors.index(i)]
        reasons += [_cause(plant, checks(blind_to(plant, (i,))), 'taken for', s, i)
                    for i in alike if i not in both]
        biased = tuple(i for i in plant.sensors if allowed.get((s, (i,))) == WEAK)
        if biased and allowed[s, ()] == STRONG:
            reasons.append(Reason.of('bias taken for', sensor=s, others=biased))
    return (*reasons, *_not_built(found))


def _of_one(plant: Plant, every: Checks, sensor: str, strength: str) -> Reason | None:
    if strength == NONE:
        return _cause(plant, every, 'not seen', sensor, '')
    return Reason.of('bias not seen', sensor=sensor) if strength == WEAK else None


def _of_two(plant: Plant, every: Checks, sensor: str, other: str) -> Reason:
    if len(every.known.R) == 1:
        return Reason.of('one residual', sensor=sensor, other=other)
    return _cause(plant, checks(blind_to(plant, (other,))), 'alike', sensor, other)


def _cause(plant: Plant, found: Checks, code: str, sensor: str, other: str) -> Reason:
    """Name the unknown inputs that alone are enough, else all; or terms that nobody can tell."""
    others = found.problem.fault_set
    alone = [name for i, name in enumerate(plant.disturbances)
             if checks(blind_to(_disturbed_by(plant, i), others)).strengths()[sensor] == NONE]
    terms = tuple(plant.terms[i].name for i in sorted(found.forced))
    names = tuple(alone) or (plant.disturbances if not terms else ())
    return Reason.of(code, sensor=sensor, other=other, names=names or terms, terms=not names)


def _disturbed_by(plant: Plant, i: int) -> Plant:
    return replace(plant, disturbances=plant.disturbances[i:i + 1], D=plant.D[:, [i]],
                   Cd=plant.Cd[:, [i]], disturbance_range=plant.disturbance_range[[i]])


def _not_built(found: Isolability) -> list[Reason]:
    """Return what the plant allows and no residual does, because none passed its checks."""
    return [Reason.of('not built', sensor=d.sensor, others=d.others, strength=has)
            for d in found.plant if STRENGTHS.index(d.strength) > STRENGTHS.index(
                has := found.by_residuals(d.sensor, d.others))]
