"""The designer's one entrance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer import search
from vsensor_ros.designer.existence import examine, measured_signs
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.plant import Plant
from vsensor_ros.virtual_sensor import Design, Refusal, VirtualSensor

METHODS = ('jordan', 'identification')
MOST_TERMS = 4  # up to so many free terms, every set of decoupled ones is tried


def design(plant: Plant, fault_sets: Iterable[Iterable[str]] | None = None, *,
           method: str | None = None) -> Design:
    """
    Design a virtual sensor for every channel of every fault set, or say why there is none.

    ``fault_sets``: sets of sensor names that fail together; by default every single sensor.
    ``method``: 'jordan' or 'identification' confines the search to that canonical form; by
    default both are tried at each order, and last the largest observer there is.
    Raises BadInput for a name that is not a sensor or not a method. Source: method, section 3,
    with the designs of section 2 at each order.
    """
    if method is not None and method not in METHODS:
        raise BadInput('design', 'method', f'{method!r} is not a method',
                       f'use one of {", ".join(METHODS)}')
    if fault_sets is None:
        fault_sets = [(sensor,) for sensor in plant.sensors]
    entries: dict[tuple[tuple[str, ...], str], VirtualSensor | Refusal] = {}
    for names in fault_sets:
        fault_set = _ordered(plant, names)
        for channel in fault_set:
            entries[fault_set, channel] = _replace(pose(plant, fault_set, channel), method)
    return Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                  dict(plant.units), plant.sample_time, entries)


def _ordered(plant: Plant, names: Iterable[str]) -> tuple[str, ...]:
    chosen = {names} if isinstance(names, str) else set(names)
    unknown = sorted(chosen - set(plant.sensors))
    if unknown or not chosen:
        raise BadInput('design', 'fault_sets',
                       f'{", ".join(unknown)} is not a sensor' if unknown else 'a set is empty',
                       f'use names among {", ".join(plant.sensors)}')
    return tuple(sensor for sensor in plant.sensors if sensor in chosen)


def _replace(problem: Problem, method: str | None) -> VirtualSensor | Refusal:
    """Find the virtual sensor for one problem, preferably without friction unknown at rest."""
    signs = measured_signs(problem)
    found = _least_order(problem, signs, method)
    if signs and isinstance(found, Refusal):
        found = _least_order(problem, frozenset(), method)
        if isinstance(found, VirtualSensor) and signs & set(found.active):
            names = ', '.join(problem.plant.terms[i].name for i in sorted(signs))
            found = replace(found, method=f'{found.method}; at rest unsure of {names}')
    return found


def _least_order(problem: Problem, avoid: frozenset[int],
                 method: str | None) -> VirtualSensor | Refusal:
    """Raise the order until a stable virtual sensor is found."""
    existence = examine(problem, avoid)
    if existence.obstruction is not None:
        return Refusal(problem.channel, problem.fault_set, existence.obstruction)
    found = search.static(problem)
    if found is not None:
        return found
    for k in range(1, len(existence.Phi) + 1):
        for S in _decoupled_sets(problem, existence.forced):
            sensors = []
            if method in (None, 'jordan'):
                sensors = search.jordan(problem, k, S)
            if method == 'identification' or (method is None and not sensors):
                sensors = search.identification(problem, k, S)
            if sensors:
                return search.choose(sensors)
    sensors = search.largest(problem, existence.Phi) if method is None else []
    if sensors:
        return search.choose(sensors)
    return Refusal(problem.channel, problem.fault_set,
                   f'no stable design was found up to order {len(existence.Phi)}'
                   + (f' in {method} canonical form' if method else ''))


def _decoupled_sets(problem: Problem, forced: frozenset[int]) -> list[frozenset[int]]:
    """List the sets of nonlinear terms to decouple from, the least first."""
    rest = [i for i in range(len(problem.G)) if i not in forced]
    if len(rest) > MOST_TERMS:
        return [forced, forced | frozenset(rest)]
    return [forced | frozenset(more)
            for size in range(len(rest) + 1) for more in combinations(rest, size)]
