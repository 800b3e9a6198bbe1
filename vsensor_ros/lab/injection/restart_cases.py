"""Ends of the replacer itself, a second one, a full /dev/shm, and clocks that do not just run."""

from __future__ import annotations

import signal

from vsensor_ros.lab.injection.case import (
    BIAS,
    Case,
    fail_over,
    FULL_SHM,
    ONE,
    OURS,
    SIMULATED,
    UNDETECTED,
    WATCHED,
)
from vsensor_ros.lab.injection.case_context import (
    CaseContext,
    CONVERGED,
    GaveUp,
    STARTED,
    STATUS_PERIOD,
)
from vsensor_ros.lab.injection.message_cases import TOLD
from vsensor_ros.lab.injection.sensor_cases import start
from vsensor_ros.lab.injection.verdict import handovers_of, path_of

STILL = 6.0     # s in which a clock that stands still must have been told
DOWN = 0.5      # s between the end of a replacer and the start of the next
JUMP = 20.0     # s


def end_process(context: CaseContext, number: int) -> None:
    """End the replacer by a signal, which is meant; note how it did not end as it should."""
    process, context.process = context.process, None
    assert process is not None
    if trouble := context.end(process, number):
        context.wrong.append(trouble)


def _restart(context: CaseContext, number: int) -> None:
    """End the replacer while it replaces a sensor, and start it anew: it must know."""
    target = context.target
    context.fault('bias', size=BIAS * context.span(target))
    context.play(UNDETECTED)
    context.isolate(target)
    context.expect(target, 'virtual')
    context.play(0.3)
    with context.excused():
        end_process(context, number)
        context.machine.latest = {}
        context.play(DOWN)
        context.machine.heard.told.clear()
        context.process = context.start()
        if not context.expect(target, 'virtual', STARTED + CONVERGED):
            raise GaveUp
        context.play(0.2)
    context.play(WATCHED)
    path = path_of(context.machine.heard.told, target)
    context.seen.append('restarted: ' + ' > '.join(path))
    if path[-1:] != ['virtual'] or 'virtual' in path[:-1]:
        context.wrong.append(f'{target} went {" > ".join(path)} after the restart')
    context.heal()
    context.believe(target)


def two_replacers(context: CaseContext) -> None:
    """Start a second replacer on the same topics by mistake, and end it again."""
    output = context.tested.wiring.ports[context.target].output
    with context.excused(stamps=True), context.excused():
        with context.start() as second:
            context.until(lambda: context.machine.node.count_publishers(output) > 1, STARTED,
                          'a second publisher')
            context.told('publishes there too', within=TOLD)
            context.play(0.5)
            if trouble := context.end(second):
                context.wrong.append(f'the second one: {trouble}')
        # the last status may be that of the second one
        context.play(STATUS_PERIOD + 0.2)
    context.forget_path()
    fail_over(context, lambda: context.fault('freeze'))


def full_dev_shm(context: CaseContext) -> None:
    """Have no room in /dev/shm, where messages between processes of one computer usually go."""
    start(context)


def paused_clock(context: CaseContext) -> None:
    """
    Let the clock stand still while a sensor is replaced.

    Then nothing goes out, and the status says so: no valid source. Nobody else took over, so that
    this is no switch, and what was replaced goes on when time does.
    """
    target = context.target
    context.fault('freeze')
    context.play(UNDETECTED)
    context.isolate(target)
    context.expect(target, 'virtual')
    context.play(0.3)
    with context.excused():
        context.machine.paused = True
        context.expect(target, 'none', STILL)
        context.machine.paused = False
        context.expect(target, 'virtual')
    context.play(WATCHED)
    context.heal()
    context.believe(target)
    context.play(0.2)
    context.expect_path(target, 'real', 'virtual', 'none', 'virtual', 'real', switches=2)


def _jump(context: CaseContext, seconds: float, way: str) -> None:
    target = context.target

    def count() -> int:
        return int(context.machine.latest.get('replacer', {}).get(f'clock_{way}', '0'))

    before = count()    # the case may be tried again
    context.fault('bias', size=BIAS * context.span(target))
    context.play(UNDETECTED)
    context.isolate(target)
    context.expect(target, 'virtual')
    context.play(0.3)
    with context.excused(stamps=seconds < 0):
        context.machine.jump(seconds)
        context.play(0.6)
    context.expect(target, 'virtual', CONVERGED)
    if count() - before != 1:
        context.wrong.append(f'{count() - before} jumps {way} were counted, not 1')
    context.play(0.5)
    context.heal()
    context.believe(target)
    context.play(0.15)  # the last status
    # the virtual sensor of a larger set may converge first
    handed = handovers_of(context.machine.heard.told, target)
    context.expect_path(target, 'real', 'virtual', 'none', 'virtual', 'real', switches=4 + handed)


def clock_ahead(context: CaseContext) -> None:
    """Let the clock jump ahead while a sensor is replaced."""
    _jump(context, JUMP, 'forwards')


def clock_back(context: CaseContext) -> None:
    """Let the clock jump back while a sensor is replaced."""
    _jump(context, -JUMP, 'backwards')


RESTART_CASES = (
    Case('node_restart', 'ends with 0; back in virtual by itself',
         lambda context: _restart(context, signal.SIGTERM), 10.0, OURS),
    Case('kill_9', 'back in virtual by itself',
         lambda context: _restart(context, signal.SIGKILL), 10.0, OURS),
    Case('two_replacers', f'said; then {ONE}', two_replacers, 16.0, OURS),
    Case('full_dev_shm', 'works all the same', full_dev_shm, 3.5, FULL_SHM),
    Case('paused_clock', 'nothing meanwhile, said; then virtual', paused_clock, 6.0, SIMULATED),
    Case('clock_ahead', 'counted; virtual anew once converged', clock_ahead, 6.0, SIMULATED),
    Case('clock_back', 'counted; virtual anew once converged', clock_back, 6.0, SIMULATED),
)
