"""The suite: sessions of one replacer each, the cases in them, the table and the report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack, suppress
from dataclasses import dataclass
from itertools import groupby
import os
from pathlib import Path
import time

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from vsensor_ros.lab.demo_failover import reserved_domain
from vsensor_ros.lab.injection.case_context import GaveUp, Skipped, Stage, STARTED
from vsensor_ros.lab.injection.cases import (
    ALONE,
    Case,
    CASES,
    FULL_SHM,
    PLAIN,
    SIMULATED,
    START,
)
from vsensor_ros.lab.injection.hostile import HOSTILE
from vsensor_ros.lab.injection.process import no_private_shm, Process
from vsensor_ros.lab.injection.restart_cases import ENDS
from vsensor_ros.lab.injection.rig import Exhausted, Rig
from vsensor_ros.lab.injection.setup import Setup
from vsensor_ros.lab.injection.truth import make_world, World

LATE = 0.05         # s that the machine may be played late, else a case that fails is tried again
LONGEST = 200.0     # s of the machine's time in one session
MARGIN = 25.0       # s of it for convergence and what takes longer than it should
DOWN = 1.0          # s in which a replacer that has ended disappears from the graph

ALL = (*CASES, *HOSTILE, *ENDS)


@dataclass(frozen=True)
class Result:
    """What became of one case."""

    case: str
    expected: str
    seen: str
    outcome: str    # 'PASS', 'FAIL' or 'skipped'
    seconds: float


Say = Callable[[Result], None]


def run_suite(setup: Setup, scenario: Path | None, cases: Sequence[Case], work: Path,
              running: bool, say: Say) -> list[Result]:
    """Run the cases, each session in its turn; raise BadInput and RuntimeError, one line."""
    sessions = list(_sessions(setup, cases, running))
    longest = max((seconds for _, _, seconds in sessions), default=0.0)
    world = make_world(setup.plant, scenario, longest)
    results: list[Result] = []
    with ExitStack() as stack:
        domain = int(os.environ.get('ROS_DOMAIN_ID') or 0)
        if not running:
            domain = stack.enter_context(reserved_domain())
            os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        for kind, members, _ in sessions:
            why = no_private_shm() if kind == FULL_SHM else ''
            if running and kind != PLAIN:
                why = 'the replacer that runs is not ours to end or to start'
            if why:
                for case in members:
                    results.append(Result(case.name, case.expected, why, 'skipped', 0.0))
                    say(results[-1])
                continue
            with _session(setup, world, domain, work, kind, running) as stage:
                results += _play(stage, members, say)
    return results


def _sessions(setup: Setup, cases: Sequence[Case], running: bool,
              ) -> Iterator[tuple[str, list[Case], float]]:
    """Group the cases into sessions: kind, cases, seconds of the machine's time."""
    dwell = max(policy.dwell for policy in setup.policies.values())

    def kind(case: Case) -> str:
        return PLAIN if case.session == ALONE and not running else case.session

    for name, members in groupby(cases, kind):
        seconds = START.seconds + MARGIN + dwell
        group: list[Case] = []
        for case in members:
            more = case.seconds + 2.0 * dwell
            if group and seconds + more > LONGEST:
                yield name, group, seconds
                seconds, group = START.seconds + MARGIN + dwell, []
            group.append(case)
            seconds += more
        yield name, group, seconds


@contextmanager
def _session(setup: Setup, world: World, domain: int, work: Path, kind: str,
             running: bool) -> Iterator[Stage]:
    processes: list[Process] = []

    def start() -> Process:
        more = ['-p', 'use_sim_time:=true'] if kind == SIMULATED else []
        processes.append(Process(setup.arguments(*more), domain, work / 'replacer.log',
                                 kind == FULL_SHM))
        return processes[-1]

    context = Context()
    rclpy.init(context=context, domain_id=domain, args=['--ros-args', *setup.ros_args[1:]]
               if setup.ros_args else None, signal_handler_options=SignalHandlerOptions.NO)
    nodes: list[Node] = []
    try:
        process = None if running else start()
        nodes += [rclpy.create_node(name, context=context)
                  for name in ('fault_injection', 'fault_injection_services')]
        rig = Rig(nodes[0], setup.wiring, world, 'replacer', kind == SIMULATED)
        yield Stage(setup, rig, nodes[1], process, start)
    finally:
        for ours in processes:
            if ours.alive:
                ours.end()
        for node in nodes:
            node.destroy_node()
        rclpy.shutdown(context=context)
        time.sleep(0.0 if running else DOWN)


def _play(stage: Stage, cases: Sequence[Case], say: Say) -> Iterator[Result]:
    """Play the cases on one replacer, each from a state in which all sensors are real."""
    rig = stage.rig
    stage.begin()
    with suppress(GaveUp):
        stage.until(lambda: all(d.publisher is not None and d.publisher.get_subscription_count()
                                for d in rig.drivers) and rig.statuses > 0, STARTED,
                    'a replacer that hears all topics and tells its status')
    if stage.wrong or not rig.statuses:
        why = '; '.join(stage.wrong) or 'the replacer has died'
        for case in cases:
            yield _said(say, Result(case.name, case.expected, why, 'FAIL', 0.0))
        return
    stage.play(0.5)
    started = False
    for case in cases:
        # where there is no room in /dev/shm, to start is all there is to try
        if case.session != FULL_SHM and not (stage.fresh and started):
            result = _try_in_time(stage, START)
            if not started or result.outcome == 'FAIL':
                say(result)
                yield result
            started = True
        yield _said(say, _try_in_time(stage, case))


def _said(say: Say, result: Result) -> Result:
    say(result)
    return result


def _try_in_time(stage: Stage, case: Case) -> Result:
    """Try a case, twice if it failed and the machine was late: then it was another machine."""
    result = _try(stage, case)
    rig = stage.rig
    if result.outcome == 'FAIL' and rig.late > LATE and rig.now < rig.world.end - MARGIN:
        result = _try(stage, case)
    return result


def _try(stage: Stage, case: Case) -> Result:
    began = time.monotonic()
    stage.begin()
    skipped = ''
    try:
        case.act(stage)
    except Skipped as reason:
        skipped = str(reason)
    except (GaveUp, Exhausted) as reason:
        stage.wrong += [str(reason)] if str(reason) else []
    wrong = [] if skipped else stage.finish()
    _settle(stage)
    seconds = time.monotonic() - began
    if skipped:
        return Result(case.name, case.expected, skipped, 'skipped', seconds)
    seen = '; '.join(wrong) if wrong else '; '.join(stage.seen) or 'as expected'
    return Result(case.name, case.expected, seen, 'FAIL' if wrong else 'PASS', seconds)


def _settle(stage: Stage) -> None:
    """Have all sensors healthy and believed, whatever a case has left."""
    try:
        stage.heal()
        if stage.rig.isolator is None:
            stage.rig.open_isolator()
        if stage.process is not None and not stage.process.alive:
            stage.process = stage.start()
            stage.fresh = False
        if stage.wrong:     # it was not in the states that it should have been in
            stage.fresh = False
            stage.believe(*stage.setup.plant.sensors)
        stage.rig.paused = False
    except (GaveUp, Exhausted):
        stage.fresh = False
