"""Ends of the replacer itself, a second one, a full /dev/shm, and clocks that do not just run."""

from __future__ import annotations

import signal
import time

from vsensor_ros.lab.injection.case_context import CONVERGED, GaveUp, Stage, STARTED
from vsensor_ros.lab.injection.cases import (
    ALONE,
    BIAS,
    Case,
    fail_over,
    FULL_SHM,
    ONE,
    SIMULATED,
    start,
    UNDETECTED,
    WATCHED,
)
from vsensor_ros.lab.injection.hostile import TOLD
from vsensor_ros.lab.injection.process import PATIENCE
from vsensor_ros.lab.injection.verdict import path_of

DOWN = 0.5      # s between the end of a replacer and the start of the next
JUMP = 20.0     # s


def _restart(stage: Stage, number: int) -> None:
    """End the replacer while it replaces a sensor, and start it anew: it must know."""
    target = stage.target
    stage.fault('bias', size=BIAS * stage.rig.world.span[target])
    stage.play(UNDETECTED)
    stage.isolate(target)
    stage.expect(target, 'virtual')
    stage.play(0.3)
    with stage.excused():
        process, stage.process = stage.process, None    # its end is meant
        assert process is not None
        process.popen.send_signal(number)
        end = time.monotonic() + PATIENCE
        while process.alive and time.monotonic() < end:
            stage.play(0.02)
        if trouble := process.trouble(number):
            stage.wrong.append(trouble)
        stage.rig.latest = {}
        stage.play(DOWN)
        stage.rig.heard.told.clear()
        stage.process = stage.start()
        if not stage.expect(target, 'virtual', STARTED + CONVERGED):
            raise GaveUp
        stage.play(0.2)
    stage.play(WATCHED)
    path = path_of(stage.rig.heard.told, target)
    stage.seen.append('restarted: ' + ' > '.join(path))
    if path[-1:] != ['virtual'] or 'virtual' in path[:-1]:
        stage.wrong.append(f'{target} went {" > ".join(path)} after the restart')
    stage.heal()
    stage.believe(target)


def two_replacers(stage: Stage) -> None:
    """Start a second replacer on the same topics by mistake, and end it again."""
    output = stage.setup.wiring.ports[stage.target].output
    with stage.excused(stamps=True), stage.excused():
        second = stage.start()
        try:
            stage.until(lambda: stage.rig.node.count_publishers(output) > 1, STARTED,
                        'a second publisher')
            stage.told('publishes there too', within=TOLD)
            stage.play(0.5)
        finally:
            trouble = second.end()
        if trouble:
            stage.wrong.append(f'the second one: {trouble}')
        stage.play(0.3)
    stage.forget_path()
    fail_over(stage, lambda: stage.fault('freeze'))


def full_dev_shm(stage: Stage) -> None:
    """Have no room in /dev/shm, where messages between processes of one computer usually go."""
    start(stage)


def paused_clock(stage: Stage) -> None:
    """Let the clock stand still while a sensor is replaced."""
    def begin() -> None:
        stage.fault('freeze')
        stage.play(UNDETECTED)
        stage.isolate(stage.target)
        stage.expect(stage.target, 'virtual')
        with stage.excused():
            stage.rig.paused = True
            stage.play(1.5)
            stage.rig.paused = False
    fail_over(stage, begin)


def _jump(stage: Stage, seconds: float, way: str) -> None:
    target = stage.target
    stage.fault('bias', size=BIAS * stage.rig.world.span[target])
    stage.play(UNDETECTED)
    stage.isolate(target)
    stage.expect(target, 'virtual')
    stage.play(0.3)
    with stage.excused(stamps=seconds < 0):
        stage.rig.jump(seconds)
        stage.play(0.6)
    stage.expect(target, 'virtual', CONVERGED)
    count = stage.rig.latest.get('replacer', {}).get(f'clock_{way}', '0')
    if count != '1':
        stage.wrong.append(f'{count} jumps {way} were counted, not 1')
    stage.play(0.5)
    stage.heal()
    stage.believe(target)
    stage.expect_path(target, 'real', 'virtual', 'none', 'virtual', 'real')


ENDS = (
    Case('node_restart', 'ends with 0; back in virtual by itself',
         lambda stage: _restart(stage, signal.SIGTERM), 10.0, ALONE),
    Case('kill_9', 'back in virtual by itself',
         lambda stage: _restart(stage, signal.SIGKILL), 10.0, ALONE),
    Case('two_replacers', f'said; then {ONE}', two_replacers, 16.0, ALONE),
    Case('full_dev_shm', 'works all the same', full_dev_shm, 3.5, FULL_SHM),
    Case('paused_clock', f'nothing meanwhile; {ONE}', paused_clock, 5.0, SIMULATED),
    Case('clock_ahead', 'counted; virtual anew once converged',
         lambda stage: _jump(stage, JUMP, 'forwards'), 6.0, SIMULATED),
    Case('clock_back', 'counted; virtual anew once converged',
         lambda stage: _jump(stage, -JUMP, 'backwards'), 6.0, SIMULATED),
)
