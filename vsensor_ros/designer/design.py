"""The designer's one entrance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from concurrent.futures import Executor, Future
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.designer import papers
from vsensor_ros.designer.alternatives import (
    beside_filter,
    beside_scheduled,
    quiet_enough,
    quietest,
)
from vsensor_ros.designer.bounded import alternative, least_sensitive
from vsensor_ros.designer.by_functions import by_functions, is_worth_asking
from vsensor_ros.designer.calm import calmly
from vsensor_ros.designer.certificate import certify, on_declared_ranges
from vsensor_ros.designer.exact import ExactVerdict, verdict
from vsensor_ros.designer.existence import (
    avoidable_signs,
    disturbed,
    examine,
    Existence,
    measured_signs,
)
from vsensor_ros.designer.extended import extended as filtered, is_possible, of_angle
from vsensor_ros.designer.fault_size import sized
from vsensor_ros.designer.isolate import isolated
from vsensor_ros.designer.noise import usual_decay
from vsensor_ros.designer.order_noise import doubtful, search_orders
from vsensor_ros.designer.order_walk import LARGE
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.designer.scheduled_entry import over_the_ranges
from vsensor_ros.designer.sentences import say
from vsensor_ros.designer.singular_values import singular
from vsensor_ros.designer.start import started
from vsensor_ros.designer.subsystem import subsystem
from vsensor_ros.designer.sweep import as_made, begin, ended_with, Progress, swept
from vsensor_ros.designer.temporary import temporary as for_a_time
from vsensor_ros.designer.tracking import tracked
from vsensor_ros.designer.unfinished import name_of, Unfinished
from vsensor_ros.designer.work_file import fingerprint, WorkFile
from vsensor_ros.functions.expression import check_name
from vsensor_ros.observers import (
    Design,
    deviation_after,
    Entry,
    Key,
    NonlinearSensor,
    Refusal,
    ScheduledSensor,
    VirtualSensor,
)
from vsensor_ros.plant import Plant
from vsensor_ros.reason import Reason

PREFERENCES = ('quiet', 'least')
FASTEST = 1e12  # 1/s
LARGEST = 1e100
SLOWEST = 0.1  # times the usual decay: errors of scheduled ones die out no slower
METHODS = ('jordan', 'identification', 'svd', 'functions')


class Choices(NamedTuple):
    """What was chosen for all virtual sensors of a design, as `design` says."""

    prefer: str
    decay: float | None
    bounded: bool
    method: str | None
    temporary: bool
    scheduled: bool
    extended: bool
    spread: float | None

    @property
    def follows(self) -> bool:
        """Whether gains that follow the readings may be handed out."""
        return self.scheduled and self.method is None


def design(plant: Plant, fault_sets: Iterable[Iterable[str]] | None = None, *,
           up_to: int | None = None, wanted: Mapping[str, Any] | None = None,
           prefer: str = 'quiet', decay: float | None = None, bounded: bool = False,
           method: str | None = None, temporary: bool = True, scheduled: bool = True,
           extended: bool = True, spread: float | None = None, isolate: bool = False,
           progress: Progress | None = None,
           executor: Executor | None = None, work_file: str | Path | None = None) -> Design:
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
    latter and, if bounded, to the papers' method of singular values; 'functions' asks only for
    nonlinear functions of the states. ``temporary``: where a mode
    stays that no healthy sensor sees, hand out one of grade 'temporary', which serves for a time
    after its channel was lost. ``scheduled``: where nothing is proved where it works, hand out one
    whose injection follows the readings, if that is proved over the declared ranges.
    ``extended``: where that is not proved either, and the plant states how far off its parameters
    may be, or the channel is an angle of which cosine and sine are seen, hand out a Kalman filter
    on the equations, of grade 'filtered'. ``spread``: how far off
    those parameters are of which the plant says nothing, one standard deviation, as a share of
    their values. ``isolate``: design, too, what tells whose fault it is and how large, see
    ``Design.isolability`` and ``Design.fault_sizes``. ``progress`` is told what is done, of how
    many, and what is next. ``executor``: who does the work, with the same result
    (`designer/sweep.py`). ``work_file``: answers are kept there as they come, and those that it
    holds are not sought again. Raises
    BadInput for what is not a name of a sensor or a choice, Unfinished when some channels met an
    error or a worker that died. Source: method, section 3.
    """
    choices = Choices(prefer, decay, bounded, method, temporary, scheduled, extended, spread)
    _check(plant, prefer, decay, method, spread, {
        'bounded': bounded, 'temporary': temporary, 'scheduled': scheduled,
        'extended': extended, 'isolate': isolate})
    if not isinstance(executor, Executor | None):
        raise BadInput('design', 'executor', f'{shown(executor)} is not an executor',
                       'give a concurrent.futures.Executor, such as Client.get_executor() of Dask')
    if isolate:
        plain = partial(design, plant, prefer=prefer, decay=decay, bounded=bounded, method=method,
                        temporary=temporary, scheduled=scheduled, extended=extended, spread=spread,
                        progress=progress, executor=executor)
        asked = plain(fault_sets, up_to=up_to, wanted=wanted, work_file=work_file)
        with calmly():
            # the work file tells whose functionals it holds, and pairs have none
            return sized(plant, isolated(plant, asked, partial(
                plain, work_file=None if wanted else work_file), progress), progress)
    functionals = _functionals(plant, wanted)
    sets = chosen_sets(plant, fault_sets, up_to, bool(functionals))
    keys = [(fault_set, channel) for fault_set in sets for channel in (*fault_set, *functionals)]
    empty = Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                   dict(plant.units), plant.sample_time, {}, wanted=tuple(functionals),
                   Cu=plant.Cu if plant.Cu.any() else None, tolerances=dict(plant.tolerances),
                   ranges=plant.reading_ranges(), wrap=plant.angles(), curves=dict(plant.curves),
                   delays=plant.delays(), noise=plant.noises())
    own = None if executor is None else fingerprint(plant)

    def question(key: Key, lost: Refusal | None) -> tuple[Any, ...]:
        return _ask, own, plant, choices, key, functionals.get(key[1]), lost

    work = None if work_file is None else WorkFile(
        work_file, plant, {**choices._asdict(), 'wanted': functionals}, empty)
    # entered for each task it would cost milliseconds
    with calmly() if executor is None else nullcontext():
        found, failed = _answers(keys, question, executor, work, progress)
    result = replace(empty, entries={key: found[key] for key in keys if key in found})
    if failed:
        raise Unfinished(result, failed, len(keys)) from next(iter(failed.values()))
    return result


def _answers(keys: Sequence[Key], question: Callable[[Key, Refusal | None], tuple[Any, ...]],
             executor: Executor | None, work: WorkFile | None, progress: Progress | None,
             ) -> tuple[dict[Key, Entry | Refusal], dict[Key, BaseException]]:
    """Return what is found for fault sets and channels, and the errors where there were any."""
    found: dict[Key, Entry | Refusal] = {}
    failed: dict[Key, BaseException] = {}
    fewer = _fewer_faults(keys)

    def lost_before(i: int) -> Refusal | None:
        """Return the refusal with fewer faults, if any: less knowledge mends nothing."""
        entries = (found.get(keys[j]) for j in fewer[i])
        return next((entry for entry in entries if isinstance(entry, Refusal)), None)

    def kept(i: int) -> Entry | Refusal | None:
        return work.find(keys[i], lost_before(i)) if work is not None else None

    def start(i: int) -> Future[Any]:
        known = kept(i)
        return ended_with(known) if known is not None else begin(
            executor, *question(keys[i], lost_before(i)))

    with closing(swept(fewer, start, executor, progress, lambda i: name_of(keys[i]))) as tasks:
        for i, future in tasks:
            try:
                found[keys[i]] = future.result() if executor is None else as_made(future.result())
            except BadInput:
                raise
            except Exception as error:  # the others go on
                failed[keys[i]] = error
                continue
            if work is not None and kept(i) is None:
                work.add(found[keys[i]], lost_before(i))
    return found, dict(sorted(failed.items(), key=lambda one: keys.index(one[0])))


def _fewer_faults(keys: Sequence[Key]) -> list[list[int]]:
    """Return for each key those before it that have lost the same channel with fewer faults."""
    by_channel: dict[str, list[tuple[int, set[str]]]] = {}
    fewer = []
    for i, (fault_set, channel) in enumerate(keys):
        before = by_channel.setdefault(channel, [])
        own = set(fault_set)
        fewer.append([j for j, other in before if other < own])
        before.append((i, own))
    return fewer


_plants: dict[str, Plant] = {}  # of a process that works for others: what is known of one stays
MOST_PLANTS = 8


def _ask(fingerprint: str | None, plant: Plant, choices: Choices, key: Key,
         rows: np.ndarray | None, lost: Refusal | None) -> Entry | Refusal:
    """
    Answer for one fault set and channel, wherever this runs.

    ``fingerprint`` of the plant: None where it is the same object all along. ``rows`` (p, n) of a
    wanted functional. ``lost``: the refusal that holds already with fewer faults.
    """
    if fingerprint is not None:
        if fingerprint not in _plants and len(_plants) >= MOST_PLANTS:
            _plants.clear()
        plant = _plants.setdefault(fingerprint, plant)
    fault_set, channel = key
    with calmly():
        part = subsystem(plant, fault_set, channel, rows)
        if choices.method == 'functions':
            asked = by_functions(plant, fault_set, channel)
            return Refusal(channel, fault_set, say(asked)) if isinstance(asked, Reason) else asked
        problem = pose(part.plant, part.lost, channel,
                       None if rows is None else rows[:, part.states])
        found = (_lost_already(lost, fault_set, problem) if lost is not None else _answer(
            problem, choices.prefer, choices.decay, choices.bounded, choices.method,
            choices.temporary))
        entry = found if lost is not None else part.entry_of_whole(found)
        sought = partial(_scheduled, plant, key, choices, problem)
        if _proved(problem.plant, found):
            assert isinstance(entry, VirtualSensor)
            return quietest(plant, entry, sought) if choices.follows else entry
        over = sought() if choices.follows else None
        if isinstance(over, ScheduledSensor):
            return replace(over, why=beside_scheduled(found, choices.extended and is_possible(
                plant, fault_set, channel, choices.spread)))
        if lost is not None:
            over = None  # that with fewer faults has said it
        function = None if choices.method or lost is not None else _function(plant, key, found)
        if isinstance(function, NonlinearSensor) and function.grade != 'temporary':
            return function
        if choices.extended:
            instead = of_angle(plant, fault_set, channel, choices.spread) or filtered(
                plant, fault_set, channel, choices.spread)
            if instead is not None:
                return replace(instead, why=beside_filter(
                    found, over, choices.follows and lost is None))
        if isinstance(function, NonlinearSensor) and choices.temporary:
            return function
        for why in (over, function):
            if isinstance(why, Reason):
                entry = _nor(entry, why)
        return entry


def _check(plant: Plant, prefer: str, decay: float | None, method: str | None,
           spread: float | None, flags: Mapping[str, bool]) -> None:
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
    if spread is not None and (isinstance(spread, bool) or not (
            isinstance(spread, (int, float)) and 0 < spread < 1)):
        raise BadInput('design', 'spread', f'{shown(spread)} is not a share',
                       'give a number between 0 and 1, such as 0.05')
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


def chosen_sets(plant: Plant, fault_sets: Iterable[Iterable[str]] | None, up_to: int | None,
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


def _scheduled(plant: Plant, key: Key, choices: Choices, problem: Problem,
               ) -> ScheduledSensor | Reason | None:
    """Return one that follows the readings, or why there is none; None: not for such a plant."""
    rate = choices.decay or SLOWEST * usual_decay(problem)
    try:
        over = over_the_ranges(plant, *key, rate)
    except ImportError as error:
        return Reason.of('scheduled not sought', missing=str(error))
    return Reason.of('not scheduled', why=say(over)) if isinstance(over, Reason) else over


def _function(plant: Plant, key: Key,
              found: VirtualSensor | Refusal) -> NonlinearSensor | Reason | None:
    """
    Return a nonlinear function where no linear one is known to converge, or why there is none.

    None: not asked for, or no better than what is there.
    """
    refused = isinstance(found, Refusal)
    if plant.unknown is None and not is_worth_asking(plant, *key, refused):
        return None
    function = by_functions(plant, *key)
    if isinstance(found, Refusal):
        return function if isinstance(function, Reason) else replace(
            function, why=say(Reason.of('filter, none', reason=found.reason)))
    if plant.unknown is None and (isinstance(function, Reason) or not function.proved):
        return None  # of it no more is known than of the linear one
    if isinstance(function, Reason):
        return function
    if found.grade != 'temporary' and function.grade == 'temporary':
        return None
    if found.grade != 'temporary':
        return quiet_enough(function, found)
    if function.grade == 'temporary' and not _good_for_longer(function, found):
        return None
    return replace(function, why=say(Reason.of('linear, for a time', order=found.order)))


def _good_for_longer(function: NonlinearSensor, linear: VirtualSensor) -> bool:
    """Tell whether what healthy sensors say keeps a function better than the linear one is."""
    after = function.ages > 0.0
    return bool(function.residuals) and bool((
        function.drift[after] < deviation_after(linear, function.ages[after])).all())


def _nor(entry: VirtualSensor | Refusal, why: Reason) -> VirtualSensor | Refusal:
    """Say why what goes beyond constant gains would not do better."""
    nor = say(why)
    return (replace(entry, reason=f'{entry.reason}; {nor}') if isinstance(entry, Refusal)
            else replace(entry, method=f'{entry.method}; {nor}'))


def _proved(plant: Plant, entry: VirtualSensor | Refusal) -> bool:
    """Tell whether an answer is known to converge wherever the plant says that it works."""
    return isinstance(entry, VirtualSensor) and entry.grade != 'temporary' and (
        not entry.active or (entry.certificate is not None and on_declared_ranges(
            plant, entry, entry.certificate)))


def _lost_already(lost: Refusal, fault_set: tuple[str, ...], problem: Problem) -> Refusal:
    """Say of a larger fault set what was said of one with fewer faults."""
    return replace(
        lost, fault_set=fault_set,
        reason=say(Reason.of('already without', fault_set=lost.fault_set, reason=lost.reason)),
        # not the alternative of fewer faults: it may read a sensor that has failed now
        alternative=alternative(problem) if lost.alternative else '')


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
    if exact is None and existence.quotient is not None and existence.quotient.order > LARGE:
        exact = _as_given(problem, existence)
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
                           terms=tuple(problem.plant.terms[i].short for i in sorted(risky)))
        found = replace(found, method=f'{found.method}; {say(unsure)}')
    return found


def certified(problem: Problem, entry: VirtualSensor | Refusal) -> VirtualSensor | Refusal:
    """Add how far its stability is proved, its start may be off, and how its channel tracks it."""
    if isinstance(entry, VirtualSensor):
        return replace(tracked(problem, started(problem, entry)),
                       certificate=entry.certificate or certify(problem.plant, entry))
    return entry


def _as_given(problem: Problem, existence: Existence) -> ExactVerdict | None:
    """
    Ask exact arithmetic about the orders in a large plant, each number taken to its last digit.

    Staircases of a hundred steps leave no singular value that could be told from rounding. What
    was computed keeps its relations up to rounding only, so existence is decided as ever, and
    where exact arithmetic sees another quotient it is not heard.
    """
    exact = referee(problem, as_given=True)
    known = existence.quotient
    agreed = exact is not None and known is not None and all(exact.solvable) and (
        exact.forced, exact.largest) == (existence.forced, known.order)
    return exact if agreed else None


def referee(problem: Problem, as_given: bool = False) -> ExactVerdict | None:
    """
    Ask exact arithmetic about a problem; None when its numbers are no typed decimals.

    ``as_given``: they need not be, see ``verdict``.
    """
    plant = problem.plant
    rows = [plant.sensors.index(s) for s in problem.healthy]
    return verdict(plant.A, plant.C[rows], problem.wanted[0], plant.D, Cd0=plant.Cd[rows],
                   Vd=problem.wanted[2], P=plant.P, G=plant.G, as_given=as_given)
