"""The designer's one entrance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any
import warnings

import numpy as np
from scipy.linalg import LinAlgWarning

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.designer import papers
from vsensor_ros.designer.bounded import alternative, least_sensitive
from vsensor_ros.designer.certificate import certify
from vsensor_ros.designer.exact import ExactVerdict, verdict
from vsensor_ros.designer.existence import (
    avoidable_signs,
    disturbed,
    examine,
    measured_signs,
)
from vsensor_ros.designer.isolate import isolated
from vsensor_ros.designer.order_noise import doubtful, search_orders
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.designer.sentences import say
from vsensor_ros.designer.singular_values import singular
from vsensor_ros.designer.start import started
from vsensor_ros.designer.subsystem import subsystem
from vsensor_ros.designer.temporary import temporary as for_a_time
from vsensor_ros.designer.tracking import tracked
from vsensor_ros.functions.expression import check_name
from vsensor_ros.observers import Design, Refusal, VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.reason import Reason

PREFERENCES = ('quiet', 'least')
FASTEST = 1e12  # 1/s
LARGEST = 1e100
METHODS = ('jordan', 'identification', 'svd')


def design(plant: Plant, fault_sets: Iterable[Iterable[str]] | None = None, *,
           up_to: int | None = None, wanted: Mapping[str, Any] | None = None,
           prefer: str = 'quiet', decay: float | None = None, bounded: bool = False,
           method: str | None = None, temporary: bool = True, isolate: bool = False,
           progress: Callable[[int, int, str], None] | None = None) -> Design:
    """
    Design a virtual sensor for every channel of every fault set, or say why there is none.

    ``fault_sets``: sets of sensor names that fail together; by default every single sensor, with
    ``up_to`` every set of so many. ``wanted``: functionals of the states to estimate besides, a
    row (n,) or rows (p, n) by name; alone, they are estimated from all sensors, as
    ``result[(), name]``. ``prefer``: 'quiet' takes the least order whose noise is within a factor
    of two of the best, 'least' the least there is. ``decay`` [1/s]: rate at which errors are to
    die out, by default as fast as noise allows. ``bounded``: where none can be decoupled from all
    unknown inputs, hand out the one that they disturb least, of grade 'bounded'. ``method``:
    'jordan' or 'identification' confines the search to the papers' canonical forms, 'svd' to the
    latter and, if bounded, to the papers' method of singular values. ``temporary``: where a mode
    stays that no healthy sensor sees, hand out one of grade 'temporary', which serves for a time
    after its channel was lost. ``isolate``: design, too, what tells whose fault it is, see
    ``Design.isolability``. ``progress`` is told what is done, of how many, and what is next.
    Raises BadInput for what is not a name of a sensor or a choice. Source: method, section 3.
    """
    _check(plant, prefer, decay, method, {'bounded': bounded, 'temporary': temporary,
                                          'isolate': isolate})
    if isolate:
        plain = partial(design, plant, prefer=prefer, decay=decay, bounded=bounded, method=method,
                        temporary=temporary, progress=progress)
        with _calmly():
            return isolated(plant, plain(fault_sets, up_to=up_to, wanted=wanted), plain, progress)
    functionals = _functionals(plant, wanted)
    sets = _fault_sets(plant, fault_sets, up_to, bool(functionals))
    entries: dict[tuple[tuple[str, ...], str], VirtualSensor | Refusal] = {}
    tasks = [(fault_set, channel) for fault_set in sets for channel in (*fault_set, *functionals)]
    for done, (fault_set, channel) in enumerate(tasks):
        if progress is not None:
            progress(done, len(tasks), f'{channel} without {", ".join(fault_set) or "a fault"}')
        with _calmly():
            part = subsystem(plant, fault_set, channel, functionals.get(channel))
            rows = functionals[channel][:, part.states] if channel in functionals else None
            problem = pose(part.plant, part.lost, channel, rows)
            entries[fault_set, channel] = _lost_before(
                entries, fault_set, problem) or part.entry_of_whole(_answer(
                    problem, prefer, decay, bounded, method, temporary))
    if progress is not None:
        progress(len(tasks), len(tasks), 'done')
    return Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                  dict(plant.units), plant.sample_time, entries, wanted=tuple(functionals),
                  Cu=plant.Cu if plant.Cu.any() else None, tolerances=dict(plant.tolerances),
                  ranges=plant.reading_ranges(), wrap=plant.angles(), curves=dict(plant.curves),
                  delays=plant.delays())


def _check(plant: Plant, prefer: str, decay: float | None, method: str | None,
           flags: Mapping[str, bool]) -> None:
    if not isinstance(plant, Plant):
        raise BadInput('design', 'plant', f'{shown(plant)} is not a Plant',
                       'make one with load_plant or Plant.from_matrices')
    if method is not None and method not in METHODS:
        raise BadInput('design', 'method', f'{shown(method)} is not a method',
                       f'use one of {", ".join(METHODS)}')
    if prefer not in PREFERENCES:
        raise BadInput('design', 'prefer', f'{shown(prefer)} is not a preference',
                       f'use one of {", ".join(PREFERENCES)}')
    if decay is not None and (isinstance(decay, bool) or not (
            isinstance(decay, (int, float)) and 0 < decay <= FASTEST)):
        raise BadInput('design', 'decay', f'{shown(decay)} is not a rate',
                       f'give a positive number up to {FASTEST:g}, in 1/s')
    for name, flag in flags.items():
        if not isinstance(flag, bool):
            raise BadInput('design', name, f'{shown(flag)} is neither True nor False',
                           'give one of them')


def _functionals(plant: Plant, wanted: Mapping[str, Any] | None) -> dict[str, np.ndarray]:
    """Return the wanted functionals as arrays (p, n)."""
    if wanted is None:
        return {}
    mend = f"give {{'v': row}} with rows of {len(plant.states)} numbers"
    if not isinstance(wanted, Mapping):
        raise BadInput('design', 'wanted', f'{shown(wanted)} is not a mapping', mend)
    functionals = {}
    for name, rows in wanted.items():
        check_name(name, 'design', 'wanted')
        for kind, taken in (('a sensor', plant.sensors), ('an input', plant.inputs),
                            ('an unknown input', plant.disturbances)):
            if name in taken:
                raise BadInput('design', 'wanted', f'{name} is {kind}', 'choose another name')
        try:
            array = np.atleast_2d(np.array(rows, dtype=float))
        except (TypeError, ValueError):
            raise BadInput('design', f'wanted.{name}', f'{shown(rows)} is not numbers',
                           mend) from None
        if array.ndim != 2 or array.shape[1] != len(plant.states) or not len(array):
            raise BadInput('design', f'wanted.{name}', f'has shape {array.shape}', mend)
        if not (np.abs(array) <= LARGEST).all() or not array.any(axis=1).all():
            raise BadInput('design', f'wanted.{name}', 'holds a row of zeros, or a number that is '
                           f'not finite or beyond {LARGEST:g}', mend)
        functionals[name] = array
    return functionals


def _fault_sets(plant: Plant, fault_sets: Iterable[Iterable[str]] | None, up_to: int | None,
                wanted: bool) -> list[tuple[str, ...]]:
    """Return the fault sets with their sensors in the plant's order, each set once."""
    mend = f'give a list of sets of names among {", ".join(plant.sensors)}'
    if up_to is not None:
        if fault_sets is not None:
            raise BadInput('design', 'up_to', 'stands beside fault_sets', 'give one of them')
        if isinstance(up_to, bool) or not isinstance(up_to, int) or up_to < 1:
            raise BadInput('design', 'up_to', f'{shown(up_to)} is not a number of sensors',
                           'give 1, 2, ..')
        sets: list[tuple[str, ...]] = [()] if wanted else []
        for size in range(1, min(up_to, len(plant.sensors)) + 1):
            sets += combinations(plant.sensors, size)
        return sets
    if fault_sets is None:
        return [()] if wanted else [(sensor,) for sensor in plant.sensors]
    if isinstance(fault_sets, str) or not isinstance(fault_sets, Iterable):
        raise BadInput('design', 'fault_sets', f'{shown(fault_sets)} is not a list of sets', mend)
    checked = []
    for names in fault_sets:
        chosen = [names] if isinstance(names, str) else names
        if not isinstance(chosen, Iterable):
            raise BadInput('design', 'fault_sets', f'{shown(names)} is not a set', mend)
        chosen = list(chosen)
        unknown = [name for name in chosen if name not in plant.sensors]
        if unknown or not (chosen or wanted):
            problem = f'{shown(unknown[0])} is not a sensor' if unknown else 'a set is empty'
            raise BadInput('design', 'fault_sets', problem, mend)
        checked.append(tuple(sensor for sensor in plant.sensors if sensor in chosen))
    if isinstance(fault_sets, Set):  # the order of a set differs from run to run
        checked.sort(key=lambda s: (len(s), [plant.sensors.index(name) for name in s]))
    return list(dict.fromkeys(checked))


def _lost_before(entries: Mapping[tuple[tuple[str, ...], str], VirtualSensor | Refusal],
                 fault_set: tuple[str, ...], problem: Problem) -> Refusal | None:
    """Return the refusal that holds already with fewer faults: less knowledge mends nothing."""
    for (fewer, of), entry in entries.items():
        if of == problem.channel and isinstance(entry, Refusal) \
                and set(fewer) < set(fault_set):
            # this one was lost by itself: what it would follow from stands before it
            return replace(
                entry, fault_set=fault_set,
                reason=say(Reason.of('already without', fault_set=fewer, reason=entry.reason)),
                # not the alternative of fewer faults: it may read a sensor that has failed now
                alternative=alternative(problem) if entry.alternative else '')
    return None


@contextmanager
def _calmly() -> Iterator[None]:
    """
    Keep BLAS to one thread, and numbers beyond use from warning.

    On many small matrices two threads are three times slower than one (without threadpoolctl the
    environment can say so: OPENBLAS_NUM_THREADS=1). Candidates beyond use are told by the check
    of their equations.
    """
    try:
        from threadpoolctl import threadpool_limits
        threads: AbstractContextManager[object] = threadpool_limits(1, user_api='blas')
    except ImportError:
        threads = nullcontext()
    with threads, np.errstate(all='ignore'), warnings.catch_warnings():
        warnings.simplefilter('ignore', LinAlgWarning)
        warnings.simplefilter('ignore', RuntimeWarning)
        yield


def _answer(problem: Problem, prefer: str, decay: float | None, bounded: bool,
            method: str | None, temporary: bool) -> VirtualSensor | Refusal:
    """Find the virtual sensor for one problem, preferably without friction unknown at rest."""
    existence, exact = examine(problem), referee(problem)
    doubts = doubtful(existence.gap, 'whether one exists', exact)
    obstruction = existence.obstruction
    if exact and obstruction is None and not all(exact.solvable):
        obstruction = disturbed(problem, existence.forced)
        doubts.append(say(Reason.of('exact: there is none')))
    elif exact and obstruction is not None and not existence.hidden and all(exact.solvable):
        doubts = [say(Reason.of('exact: one exists'))]
    if obstruction is not None:
        found: VirtualSensor | Refusal | None = None
        if bounded:
            found = singular(problem) if method == 'svd' else least_sensitive(
                problem, prefer, decay)
        hidden = existence.hidden and (exact is None or all(exact.solvable))
        if temporary and hidden and method is None and not isinstance(found, VirtualSensor):
            lasting = for_a_time(problem)
            if lasting is not None:
                return _warned(problem, lasting)
        if found is not None:
            return certified(problem, found)
        return Refusal(problem.channel, problem.fault_set, say(obstruction), tuple(doubts),
                       '' if bounded else alternative(problem))
    if exact and exact.forced != existence.forced:
        exact = None
    signs = avoidable_signs(problem)
    found = (search_orders(problem, existence, signs, prefer, decay, exact) if method is None
             else papers.least_order(problem, signs, 'jordan' if method == 'jordan'
                                     else 'identification'))
    return certified(problem, _warned(problem, found))


def _warned(problem: Problem, found: VirtualSensor | Refusal) -> VirtualSensor | Refusal:
    """Say of a virtual sensor that computes friction from a measured speed that it does."""
    risky = measured_signs(problem)
    if isinstance(found, VirtualSensor) and risky & set(found.active):
        unsure = Reason.of('unsure at rest',
                           terms=tuple(problem.plant.terms[i].name for i in sorted(risky)))
        found = replace(found, method=f'{found.method}; {say(unsure)}')
    return found


def certified(problem: Problem, entry: VirtualSensor | Refusal) -> VirtualSensor | Refusal:
    """Add how far its stability is proved, its start may be off, and how its channel tracks it."""
    if isinstance(entry, VirtualSensor):
        return replace(tracked(problem, started(problem, entry)),
                       certificate=entry.certificate or certify(problem.plant, entry))
    return entry


def referee(problem: Problem) -> ExactVerdict | None:
    """Ask exact arithmetic about a problem; None when its numbers are no typed decimals."""
    plant = problem.plant
    rows = [plant.sensors.index(s) for s in problem.healthy]
    return verdict(plant.A, plant.C[rows], problem.wanted[0], plant.D, Cd0=plant.Cd[rows],
                   Vd=problem.wanted[2], P=plant.P, G=plant.G)
