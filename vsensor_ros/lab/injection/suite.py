"""The suite: sessions of one replacer each, the cases in them, and what became of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack, suppress
from dataclasses import dataclass, replace
from itertools import groupby
import os
import shutil
import subprocess
import sys
import time

from vsensor_ros.bad_input import BadInput
from vsensor_ros.lab.domain import open_nodes, reserved_domain, stay_on_this_computer
from vsensor_ros.lab.injection.alone_cases import ALONE_CASES, LEARN
from vsensor_ros.lab.injection.alone_context import AloneContext, learning_time
from vsensor_ros.lab.injection.blame import Found
from vsensor_ros.lab.injection.case import Case, FULL_SHM, OURS, PLAIN, SIMULATED
from vsensor_ros.lab.injection.case_context import CaseContext, GaveUp, Skipped, STARTED
from vsensor_ros.lab.injection.machine import Exhausted, Machine
from vsensor_ros.lab.injection.message_cases import MESSAGE_CASES
from vsensor_ros.lab.injection.restart_cases import RESTART_CASES
from vsensor_ros.lab.injection.sensor_cases import SENSOR_CASES, START
from vsensor_ros.lab.injection.truth import compute_truth, Truth
from vsensor_ros.lab.injection.under_test import UnderTest
from vsensor_ros.lab.process import Process

TRIES = 3           # of a case that fails while this computer is too busy
LONGEST = 200.0     # s of the machine's time in one session
MARGIN = 25.0       # s of it for convergence and what takes longer than it should
DOWN = 1.0          # s in which a replacer that has ended disappears from the graph
TINY = 16           # kB of a /dev/shm that is as good as full

ALL = (START, *SENSOR_CASES, *MESSAGE_CASES, *RESTART_CASES)
QUICK = frozenset({  # half of them: some of each kind, those that take the least time
    'start', 'handover', 'freeze', 'drop_out', 'bias', 'nan', 'simultaneous', 'unknown_set',
    'wrong_length', 'burst', 'disorder', 'isolator_restart', 'kill_9', 'paused_clock'})
ALONE_QUICK = frozenset({'learning', 'freeze', 'bias'})


@dataclass(frozen=True)
class CaseResult:
    """What became of one case."""

    case: str
    expected: str
    seen: str
    outcome: str    # 'PASS', 'FAIL' or 'skipped'
    seconds: float
    faults: tuple[Found, ...] = ()  # those injected where nobody isolates


Say = Callable[[CaseResult], None]


def choose(only: str, quick: bool, alone: bool = False) -> list[Case]:
    """Return the cases that are asked for, all by default; raise BadInput."""
    names = [name.strip() for name in only.split(',')] if only else []
    cases, few = (ALONE_CASES, ALONE_QUICK) if alone else (ALL, QUICK)
    known = [case.name for case in cases]
    for name in names:
        if name not in known:
            raise BadInput('', '--only', f'there is no case {name}',
                           f'choose from {", ".join(known)}')
    return [case for case in cases if (not names or case.name in names)
            and (not quick or case.name in few)]


def truth_for(tested: UnderTest, cases: Sequence[Case]) -> Truth:
    """Return a truth that is long enough for each session of the cases; raise BadInput."""
    longest = max(LONGEST + _lasts(tested, _first(tested)),
                  *(_seconds(tested, [case]) for case in cases))
    return compute_truth(tested.plant, tested.scenario, min(_seconds(tested, cases), longest),
                         tested.alone)


def run_suite(tested: UnderTest, truth: Truth, cases: Sequence[Case], running: bool,
              say: Say) -> list[CaseResult]:
    """Run the cases, each session in its turn; raise BadInput and Failed, one line."""
    results: list[CaseResult] = []

    def note(result: CaseResult) -> None:
        results.append(result)
        say(result)

    with ExitStack() as stack:
        domain = None
        if not running:
            domain = stack.enter_context(reserved_domain())
            stay_on_this_computer()
        for kind, members in groupby(cases, lambda case: PLAIN if case.session == OURS
                                     and not running else case.session):
            left, tries = list(members), Counter[str]()
            why = _no_private_shm() if kind == FULL_SHM else ''
            if running and kind != PLAIN:
                why = 'the replacer that runs is not ours to end or to start'
            if why:
                for case in left:
                    note(CaseResult(case.name, case.expected, why, 'skipped', 0.0))
                continue
            while left:     # one session after the other
                with _session(tested, truth, domain, kind, running) as context:
                    _play(context, left, tries, note)
    return results


def _seconds(tested: UnderTest, cases: Sequence[Case]) -> float:
    """Return how long the machine must run in a session of some cases [s]."""
    return _lasts(tested, _first(tested)) + MARGIN + sum(_lasts(tested, case) for case in cases)


def _lasts(tested: UnderTest, case: Case) -> float:
    if case is LEARN:
        return learning_time(tested)
    seconds = case.seconds + 2.0 * tested.dwell
    if case.each:
        seconds += case.seconds * (len(tested.plant.sensors) - 1)
    if tested.alone and case.session in (OURS, SIMULATED):  # it may be found only by then
        seconds += learning_time(tested)
    return seconds


def _first(tested: UnderTest) -> Case:
    """Return what has to be passed before other cases."""
    return LEARN if tested.alone else START


@contextmanager
def _session(tested: UnderTest, truth: Truth, domain: int | None, kind: str,
             running: bool) -> Iterator[CaseContext]:
    simulated = kind == SIMULATED or tested.parameters.simulated
    tested.record.unlink(missing_ok=True)
    processes: list[Process] = []

    def start() -> Process:
        assert domain is not None
        processes.append(Process(
            'the replacer', ['vsensor_ros.command.replacer', *tested.arguments(simulated)],
            domain, tested.work / 'replacer.log', _tiny_shm() if kind == FULL_SHM else ()))
        return processes[-1]

    try:
        process = None if running else start()
        with open_nodes('fault_injection', 'fault_injection_services', domain=domain,
                        ros_args=tested.parameters.ros_args) as (node, services):
            machine = Machine(node, tested.wiring, truth, tested.parameters.node, simulated,
                              not tested.alone)
            kind_of = AloneContext if tested.alone else CaseContext
            yield kind_of(tested, machine, services, process, start)
    finally:
        for ours in processes:
            if ours.alive:
                ours.end()
    time.sleep(0.0 if running else DOWN)


def _play(context: CaseContext, left: list[Case], tries: Counter[str], note: Say) -> None:
    """
    Play cases on one replacer, each from a state in which all sensors are real.

    Those that are over are taken from `left`; the others are for another session, because the
    truth that was computed would not last.
    """
    machine, tested = context.machine, context.tested
    first = _first(tested)
    if why := _not_there(context):
        for case in left:
            note(CaseResult(case.name, case.expected, why, 'FAIL', 0.0))
        left.clear()
        return
    context.play(0.5)
    started = False
    while left and (not started or machine.now + context.unready() + _lasts(tested, left[0])
                    + MARGIN <= machine.truth.end):
        case = left[0]
        # where there is no room in /dev/shm, to start is all there is to try
        if case.session != FULL_SHM and not (started and context.fresh):
            result = _attempt(context, first, tries)
            if result is None:
                continue
            if not started or result.outcome == 'FAIL':
                note(result)
            started = True
        if case is first:
            left.pop(0)
        elif result := _attempt(context, case, tries):
            note(result)
            left.pop(0)
            started = True


def _not_there(context: CaseContext) -> str:
    """Wait for the replacer; return what was wrong, '' if nothing. Raise BadInput."""
    machine = context.machine
    context.begin()
    with suppress(GaveUp):
        context.until(lambda: all(d.heard for d in machine.drivers) and machine.statuses > 0,
                      STARTED, 'a replacer that hears all topics and tells its status')
    if machine.clock is not None and machine.node.count_publishers('/clock') > 1:
        raise BadInput('', '/clock', 'somebody else publishes it',
                       'end that, or try a replacer without use_sim_time')
    if context.process is not None and not context.process.alive:
        return f'the replacer has died: {context.process.last_words()}'
    return '; '.join(context.wrong)


def _attempt(context: CaseContext, case: Case, tries: Counter[str]) -> CaseResult | None:
    """Try a case; None if it is to be tried again, because this computer was too busy to tell."""
    result = _try(context, case)
    tries[case.name] += 1
    if result.outcome == 'FAIL' and context.busy:
        if tries[case.name] < TRIES:
            return None
        result = replace(result, outcome='skipped',
                         seen=f'this computer is too busy ({context.busy}): {result.seen}')
    del tries[case.name]
    return result


def _try(context: CaseContext, case: Case) -> CaseResult:
    began = time.monotonic()
    context.begin()
    skipped = ''
    try:
        case.act(context)
    except Skipped as reason:
        skipped = str(reason)
    except (GaveUp, Exhausted) as reason:
        context.wrong += [str(reason)] if str(reason) else []
    wrong = [] if skipped else context.finish()
    _settle(context)
    seconds = time.monotonic() - began
    faults = tuple(context.found) if isinstance(context, AloneContext) else ()
    if skipped:
        return CaseResult(case.name, case.expected, skipped, 'skipped', seconds)
    seen = '; '.join(wrong) if wrong else '; '.join(context.seen) or 'as expected'
    return CaseResult(case.name, case.expected, seen, 'FAIL' if wrong else 'PASS', seconds,
                      faults)


def _settle(context: CaseContext) -> None:
    """Have all sensors healthy and believed, whatever a case has left."""
    context.machine.paused = False
    try:
        context.heal()
        if context.machine.isolator is None and not context.tested.alone:
            context.machine.open_isolator()
        if context.process is not None and not context.process.alive:
            context.process = context.start()
            context.fresh = False
        if context.wrong:   # it was not in the states that it should have been in
            context.fresh = False
            context.believe(*context.tested.plant.sensors)
    except (GaveUp, Exhausted):
        context.fresh = False


def _no_private_shm() -> str:
    """Return why a /dev/shm of its own cannot be made for a process, '' if it can."""
    if sys.platform != 'linux' or not shutil.which('unshare'):
        return 'there is no unshare'
    tried = subprocess.run([*_tiny_shm(), 'true'], stdin=subprocess.DEVNULL, capture_output=True,
                           text=True)
    return '' if tried.returncode == 0 else 'no mount namespace can be made here: ' + (
        tried.stderr.strip().splitlines() or ['refused'])[-1]


def _tiny_shm() -> list[str]:
    """Return the beginning of a command that runs where /dev/shm has room for nothing."""
    user = [] if os.geteuid() == 0 else ['--user', '--map-root-user']
    return ['unshare', *user, '--mount', '--propagation', 'private', 'sh', '-c',
            f'mount -t tmpfs -o size={TINY}k tmpfs /dev/shm && exec "$@"', 'sh']
