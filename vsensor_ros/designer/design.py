"""The designer's one entrance."""

from __future__ import annotations

from collections.abc import Iterable, Set
from dataclasses import replace
from itertools import combinations

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.designer import search
from vsensor_ros.designer.existence import examine, forced_closure, measured_signs
from vsensor_ros.designer.observer import decay, with_healthy
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.plant import Plant
from vsensor_ros.virtual_sensor import Design, Refusal, VirtualSensor

METHODS = ('jordan', 'identification')
TOO_NOISY = 100.0  # times the largest observer: a lower order is not worth it
SLOWER = 4.0  # the decay rate may fall by so much for reading fewer sensors
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
    if not isinstance(plant, Plant):
        raise BadInput('design', 'plant', f'{shown(plant)} is not a Plant',
                       'make one with load_plant or Plant.from_matrices')
    if method is not None and method not in METHODS:
        raise BadInput('design', 'method', f'{shown(method)} is not a method',
                       f'use one of {", ".join(METHODS)}')
    entries: dict[tuple[tuple[str, ...], str], VirtualSensor | Refusal] = {}
    for fault_set in _checked(plant, fault_sets):
        for channel in fault_set:
            entries[fault_set, channel] = _replace(pose(plant, fault_set, channel), method)
    return Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                  dict(plant.units), plant.sample_time, entries)


def _checked(plant: Plant, fault_sets: Iterable[Iterable[str]] | None,
             ) -> list[tuple[str, ...]]:
    """Return the fault sets with their sensors in the plant's order, each set once."""
    mend = f'give a list of sets of names among {", ".join(plant.sensors)}'
    if fault_sets is None:
        return [(sensor,) for sensor in plant.sensors]
    if isinstance(fault_sets, str) or not isinstance(fault_sets, Iterable):
        raise BadInput('design', 'fault_sets', f'{shown(fault_sets)} is not a list of sets', mend)
    checked = []
    for names in fault_sets:
        chosen = [names] if isinstance(names, str) else names
        if not isinstance(chosen, Iterable):
            raise BadInput('design', 'fault_sets', f'{shown(names)} is not a set', mend)
        chosen = list(chosen)
        unknown = [name for name in chosen if name not in plant.sensors]
        if unknown or not chosen:
            problem = f'{shown(unknown[0])} is not a sensor' if unknown else 'a set is empty'
            raise BadInput('design', 'fault_sets', problem, mend)
        checked.append(tuple(sensor for sensor in plant.sensors if sensor in chosen))
    if isinstance(fault_sets, Set):  # the order of a set differs from run to run
        checked.sort(key=lambda s: (len(s), [plant.sensors.index(name) for name in s]))
    return list(dict.fromkeys(checked))


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
    reserve = search.largest(problem, existence.Phi) if method is None else []
    bearable = TOO_NOISY * max((v.noise_gain for v in reserve), default=np.inf)
    for k in range(1, len(existence.Phi) + 1):
        sensors = [v for v in _of_order(problem, k, existence.forced, method)
                   if v.noise_gain <= bearable]
        if sensors:
            return _reading_less(problem, search.choose(sensors), existence.forced, method)
        sensors = [sensor for sensor in reserve if sensor.order == k]
        if sensors:
            return search.choose(sensors)
    terms = ', '.join(t.name for t in problem.plant.terms)
    return Refusal(
        problem.channel, problem.fault_set,
        f'the linear equations allow a virtual sensor of order up to {len(existence.Phi)}, but '
        + (f'none in {method} canonical form ' if method else 'none ')
        + ('was found that is stable together with ' + terms if terms else
           'was found that passes the check of its equations: the plant is ill-conditioned'))


def _of_order(problem: Problem, k: int, forced: frozenset[int],
              method: str | None) -> list[VirtualSensor]:
    """Search the canonical forms at one order."""
    for S in _decoupled_sets(problem, forced):
        sensors = search.jordan(problem, k, S) if method != 'identification' else []
        if method == 'identification' or (method is None and not sensors):
            sensors = search.identification(problem, k, S)
        if sensors:
            return sensors
    return []


def _reading_less(problem: Problem, found: VirtualSensor, forced: frozenset[int],
                  method: str | None) -> VirtualSensor:
    """
    Leave out readings that a virtual sensor of the same order can do without.

    What is not read can fail, too. The price in noise and in speed is bounded.
    """
    limit = search.NOISE_FACTOR * found.noise_gain
    speed = decay(found.eigenvalues, found.sample_time) / SLOWER
    left_out: frozenset[str] = frozenset()
    while True:
        for name in found.reads:
            fewer = pose(problem.plant, problem.fault_set, problem.channel, left_out | {name})
            if not forced_closure(fewer, forced)[0] <= forced:
                continue
            sensors = [v for v in _of_order(fewer, found.order, forced, method)
                       if v.noise_gain <= limit and decay(v.eigenvalues, v.sample_time) >= speed]
            if sensors:
                left_out |= {name}
                found = with_healthy(search.choose(sensors), problem.healthy)
                break
        else:
            return found


def _decoupled_sets(problem: Problem, forced: frozenset[int]) -> list[frozenset[int]]:
    """List the sets of nonlinear terms to decouple from, the least first."""
    rest = [i for i in range(len(problem.G)) if i not in forced]
    if len(rest) > MOST_TERMS:
        return [forced, forced | frozenset(rest)]
    return [forced | frozenset(more)
            for size in range(len(rest) + 1) for more in combinations(rest, size)]
