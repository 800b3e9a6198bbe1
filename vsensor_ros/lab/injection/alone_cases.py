"""Faults that nobody tells the replacer of: its own isolator has to find them, or must not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
import signal
from typing import Any

import numpy as np

from vsensor_ros.lab.injection.alone_context import AloneContext, CALM
from vsensor_ros.lab.injection.blame import HEALTHY, ISOLATED
from vsensor_ros.lab.injection.case import (
    BIAS,
    Case,
    FULL_SHM,
    ONE,
    OURS,
    SIMULATED,
    WATCHED,
)
from vsensor_ros.lab.injection.case_context import CONVERGED, GaveUp, Skipped, SOON, STARTED
from vsensor_ros.lab.injection.message_cases import (
    burst,
    disorder,
    garbage,
    lengths,
    wrong_type,
)
from vsensor_ros.lab.injection.restart_cases import (
    clock_ahead,
    clock_back,
    DOWN,
    end_process,
    paused_clock,
    two_replacers,
)
from vsensor_ros.lab.injection.sensor_cases import (
    DRIFT,
    other_of,
    relapse,
    second_fault,
    SPIKE,
    without_design,
)
from vsensor_ros.lab.injection.verdict import path_of

FADED = 0.8         # s until what a reading that was always wrong leaves behind is gone
UNSEEN = 2.0        # s of a fault of which nobody must be blamed
NOISIER = 24 ** 0.5     # times its own is added, so that the noise is five times as large
LATE = 0.2          # s by which messages come late
AWAY = 0.7          # s, beside its max_age, that a driver is dead
ALL = 'as the design tells of each sensor'


def _of(kind: str, **parts: float) -> Callable[[AloneContext], None]:
    """Return what lets each sensor fail in turn; parts: of its range, but for a probability."""
    def act(context: AloneContext) -> None:
        for name in context.tested.plant.sensors:
            _fail(context, name, kind, **{key: value if key == 'probability' else
                                          value * context.span(name)
                                          for key, value in parts.items()})
        _expect_paths(context)
        context.fresh = False   # what reads a sensor that has failed begins anew
    return act


def noise(context: AloneContext) -> None:
    """Let each sensor in turn be five times as noisy."""
    for name in context.tested.plant.sensors:
        _fail(context, name, 'noise', size=NOISIER * context.machine.truth.noise[name])
    _expect_paths(context)
    context.fresh = False


def _single(context: AloneContext, name: str) -> None:
    """Leave single ones of its spikes: two in three readings could as well be a bias."""
    healthy, channel = (said[name] for said in (
        context.machine.truth.said, context.machine.channels))
    hit = np.flatnonzero(channel.value != healthy.value)
    value = channel.value.copy()
    second = hit[1:][np.diff(hit) <= 2]
    value[second] = healthy.value[second]
    context.machine.channels[name] = replace(channel, value=value)


def _fail(context: AloneContext, name: str, kind: str, **size: float) -> None:
    """Let a sensor fail, be found and replaced, or not, and come back."""
    context.await_reserve(name)
    context.play(0.2)
    context.fault(kind, name, **size)
    if kind == 'spikes':
        _single(context, name)
    if context.injected[-1].kind:
        context.isolate(name)
        context.expect(name, context.tested.serves([name], name))
        context.play(WATCHED)
        context.heal()
        context.believe(name)
    else:
        context.play(UNSEEN)
        context.heal()
        context.await_state(HEALTHY, CALM)


def _expect_paths(context: AloneContext) -> None:
    """Note if a sensor was not replaced once for each time that it has been blamed."""
    for name in context.tested.plant.sensors:
        source = context.tested.serves([name], name)
        times = sum(fault.sensor == name and fault.awaited for fault in context.injected)
        context.expect_path(name, 'real', *[source, 'real'] * times)
    context.seen.clear()    # what became of each fault says it


def learning(context: AloneContext) -> None:
    """Let the healthy machine be learnt."""
    context.learn()
    _expect_paths(context)


def clear_early(context: AloneContext) -> None:
    """Clear a sensor that is still faulty."""
    target = context.target
    context.play(0.2)
    context.fault('freeze')
    context.isolate(target)
    context.expect(target, 'virtual')
    context.play(WATCHED)
    context.clear(target)
    context.injected[-1].over = math.inf    # it is faulty all the while
    context.isolate(target)
    context.expect(target, 'virtual')
    context.play(WATCHED)
    # the time in between may have been too short to be told, or for a message to be sent on
    path = path_of(context.machine.heard.told, target)
    again = ('virtual', 'real') if path.count('virtual') > 1 else ()
    switches = 4 if context.switched(target) > 1 else 2
    context.heal()
    context.believe(target)
    context.expect_path(target, 'real', 'virtual', 'real', *again, switches=switches)


def silence(context: AloneContext) -> None:
    """Let a healthy sensor fall silent that the virtual sensor reads."""
    target, reads = context.target, context.tested.virtual.reads
    if not reads:
        raise Skipped('the virtual sensor reads no sensor')
    needed = reads[0]
    context.await_reserve(target)
    context.fault('bias', size=BIAS * context.span(target))
    context.isolate(target)
    context.expect(target, 'virtual')
    context.play(context.apart)
    context.fault('drop_out', needed)
    context.isolate(needed)
    _expect_set(context, target, needed)
    context.play(WATCHED)
    context.heal()
    context.believe(needed, target)


def simultaneous(context: AloneContext) -> None:
    """Let two sensors jump in the same instant."""
    names = (context.target, other_of(context))
    told = context.expected(dict.fromkeys(names, 'bias'))
    if told is None:
        raise Skipped('the design does not say what both together lead to')
    state, blamed = told
    for name in names:
        context.fault('bias', name, size=BIAS * context.span(name))
    context.isolate(*blamed)
    context.await_state(state, SOON)
    context.seen.append(state)
    if state == ISOLATED:
        _expect_set(context, *names)
    context.play(WATCHED)
    context.heal()
    context.believe(*blamed)
    context.await_state(HEALTHY, CALM)
    context.fresh = False


def frozen_together(context: AloneContext) -> None:
    """Let two sensors freeze in the same instant."""
    _freeze(context, (context.target, other_of(context)))


def unknown_set(context: AloneContext) -> None:
    """Let a set of sensors freeze that there is no design for."""
    _freeze(context, without_design(context), 'no valid source')


def _freeze(context: AloneContext, names: tuple[str, ...], *told: str) -> None:
    for name in names:
        context.fault('freeze', name)
    context.isolate(*names)
    _expect_set(context, *names)
    context.play(WATCHED)
    if told:
        context.told(*told, within=SOON)
    context.heal()
    context.believe(*names)


def _expect_set(context: AloneContext, *names: str) -> None:
    for name in names:
        source = context.tested.serves(names, name)
        context.expect(name, source, CONVERGED if source == 'virtual' else SOON)
    context.fresh = False     # what reads one of them begins anew


def wrong_length(context: AloneContext) -> None:
    """Let the target's element be left out of its array now and then, and then always."""
    driver = context.machine.driver_of(context.target)
    driver.garble, names = lengths(context)
    for name in names:
        context.undetected(name)
    context.play(UNSEEN)
    driver.garble, _ = lengths(context, emptied=True)
    for name in names:
        context.note('drop_out', name)
    context.isolate(*names)
    _expect_set(context, *names)
    context.play(WATCHED)
    context.heal()
    context.believe(*names)
    _expect_paths(context)


def late(context: AloneContext) -> None:
    """Let all messages of the target's driver come late, while healthy and while replaced."""
    driver, machine = context.machine.driver_of(context.target), context.machine
    if not driver.stamped:
        raise Skipped('its messages have no stamps, so that nobody knows when they are late')
    waiting: list[tuple[float, Any]] = []

    def garble(message: Any) -> list[Any]:
        waiting.append((machine.now + LATE, message))
        due = [m for at, m in waiting if at <= machine.now]
        waiting[:] = waiting[len(due):]
        return due

    driver.garble = garble
    context.play(UNSEEN)
    context.fault('bias', size=BIAS * context.span(context.target))
    context.isolate(context.target)
    context.expect(context.target, 'virtual')
    context.play(WATCHED)
    context.heal()
    context.believe(context.target)
    _expect_paths(context)


def publisher_restart(context: AloneContext) -> None:
    """Let the driver be dead for longer than the max_age of its sensors, and come back."""
    driver, node = context.machine.driver_of(context.target), context.machine.node
    names = [port.name for port in driver.ports]
    with context.excused():
        for name in names:
            context.undetected(name)
            context.note('drop_out', name)
        driver.close(node)
        context.play(AWAY + max(context.tested.max_age[name] for name in names))
        driver.open(node)
        context.until(lambda: driver.heard, SOON, 'a listener again')
        context.isolate(*names)
        context.heal()
        context.believe(*names)
    context.fresh = False


def _restart(context: AloneContext, number: int, kind: str, **parts: float) -> None:
    """End the replacer while it replaces a sensor, and start it anew: it must find it again."""
    target = context.target
    context.fault(kind, **{key: value * context.span(target) for key, value in parts.items()})
    context.isolate(target)
    context.expect(target, 'virtual')
    context.play(0.3)
    with context.excused():
        end_process(context, number)
        context.forget()
        context.undetected(target)
        context.play(DOWN)
        context.process = context.start()
        context.restarted()
        if not context.until(lambda: target in context.machine.verdict.kinds,
                             STARTED + CONVERGED, f'{target} blamed again'):
            raise GaveUp
        context.isolate(target)
        context.expect(target, 'virtual', CONVERGED)
        context.play(FADED)
    context.play(WATCHED)
    context.heal()
    context.believe(target)


def node_restart(context: AloneContext) -> None:
    """
    End the replacer by SIGTERM, which keeps what it has learnt, and start it anew.

    Of a sensor that is stuck from the start nothing but the record tells that it ever moved.
    """
    _restart(context, signal.SIGTERM, 'freeze')


def kill_9(context: AloneContext) -> None:
    """End the replacer by SIGKILL, which keeps nothing, and start it anew."""
    _restart(context, signal.SIGKILL, 'bias', size=BIAS)
    context.to_learn = None


def jump(case: Callable[[AloneContext], None]) -> Callable[[AloneContext], None]:
    """Return what lets the clock jump; the observers of the residuals start anew then."""
    def act(context: AloneContext) -> None:
        case(context)
        context.restarted()
    return act


def full_dev_shm(context: AloneContext) -> None:
    """Have no room in /dev/shm, where messages between processes of one computer usually go."""
    context.learn()
    _fail(context, context.target, 'freeze')
    _expect_paths(context)


LEARN = Case('learning', 'nobody blamed', learning, 16.0)
ALONE_CASES = (
    LEARN,
    Case('freeze', ALL, _of('freeze'), 4.0, each=True),
    Case('drop_out', ALL, _of('drop_out'), 4.5, each=True),
    Case('bias', ALL, _of('bias', size=BIAS), 4.0, each=True),
    Case('drift', ALL, _of('drift', rate=DRIFT), 4.0, each=True),
    Case('noise', ALL, noise, 5.0, each=True),
    Case('nan', ALL, _of('not_a_number'), 4.5, each=True),
    Case('infinity', ALL, _of('infinity'), 4.5, each=True),
    Case('spikes', 'nobody blamed, real goes on',
         _of('spikes', size=SPIKE, probability=0.1), 3.0, each=True),
    Case('relapse', f'until it is cleared: {ONE}', relapse, 6.0),
    Case('clear_early', 'found again at once', clear_early, 6.0),
    Case('silence', 'each as the set of both is designed', silence, 14.0),
    Case('second_fault', 'each as the set of both is designed', second_fault, 16.0),
    Case('frozen_together', 'each as the set of both is designed', frozen_together, 6.0),
    Case('unknown_set', 'no valid source, said; then real', unknown_set, 6.0),
    Case('wrong_length', f'nobody blamed; when it never is there: {ONE}', wrong_length, 6.0),
    Case('wrong_type', f'said; {ONE}', wrong_type, 10.0),
    Case('burst', ONE, burst, 6.0),
    Case('disorder', f'nobody blamed; {ONE}', disorder, 5.0),
    Case('late', f'nobody blamed; {ONE}', late, 6.0),
    Case('publisher_restart', 'drop-out of all its sensors; then real', publisher_restart, 8.0),
    Case('garbage', f'nothing of it is used; {ONE}', garbage, 12.0),
    # the last before another process: for five minutes its alarms are the model's at first
    Case('simultaneous', 'what both together lead to by the design', simultaneous, 20.0),
    Case('node_restart', 'found again by the record that it kept', node_restart, 12.0,
         OURS),
    Case('kill_9', 'found again without a record', kill_9, 14.0, OURS),
    Case('two_replacers', f'said; then {ONE}', two_replacers, 18.0, OURS),
    Case('full_dev_shm', ONE, full_dev_shm, 20.0, FULL_SHM),
    Case('paused_clock', 'nothing meanwhile, said; then virtual', paused_clock, 8.0,
         SIMULATED),
    Case('clock_ahead', 'counted; virtual anew once converged', jump(clock_ahead), 8.0,
         SIMULATED),
    Case('clock_back', 'counted; virtual anew once converged', jump(clock_back), 8.0,
         SIMULATED),
)
