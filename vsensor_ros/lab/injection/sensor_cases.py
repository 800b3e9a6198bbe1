"""Faults of sensors, and what isolation says of them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

from vsensor_ros.lab.injection.case import BIAS, Case, fail_over, ONE, UNDETECTED, WATCHED
from vsensor_ros.lab.injection.case_context import CaseContext, CONVERGED, Skipped, SOON
from vsensor_ros.lab.injection.verdict import path_of

SPIKE, DRIFT = 2.0, 0.8     # of the range; of the range in a second
HALF = 0.5          # s of half a period at 1 Hz


def _of(kind: str, **parts: float) -> Callable[[CaseContext], None]:
    def act(context: CaseContext) -> None:
        span = context.span(context.target)
        sizes = {key: value if key == 'probability' else value * span
                 for key, value in parts.items()}
        fail_over(context, lambda: context.fault(kind, '', **sizes))
    return act


def start(context: CaseContext) -> None:
    """Isolate a sensor that is healthy, from the beginning."""
    target = context.target
    if context.process is None:
        context.call('reset')     # its virtual sensors converged to another machine
        context.play(0.2)
    context.expect(target, 'real', 10.0)
    context.isolate(target)
    context.expect(target, 'virtual', CONVERGED)
    switches = context.switched(target)
    # the time without a source may have been too short to be told, but is counted
    path = ('real', 'none', 'virtual') if 'none' in path_of(
        context.machine.heard.told, target) else ('real', 'virtual')
    context.play(0.3)
    context.believe(target)
    context.fresh = True
    context.expect_path(target, *path, 'real', switches=3 if switches == 2 else None)
    # the next case needs a reserve, which may have served only from the last good readings
    context.until(lambda: context.machine.latest[target].get('reserve') != 'not ready', CONVERGED,
                  f'a reserve for {target}')


def handover(context: CaseContext) -> None:
    """Isolate a sensor that is healthy, and give it back."""
    fail_over(context, lambda: None)
    context.expect_no_step(context.target)


def toggle(context: CaseContext) -> None:
    """Let isolation change its mind at 1 Hz."""
    target, belief = context.target, context.tested.beliefs[context.target]
    if belief.recovery == 'automatic' and belief.dwell < 2.0 * HALF:
        raise Skipped(f'the dwell of {target} is {belief.dwell:g} s, shorter than a period')
    context.fault('bias', size=BIAS * context.span(target))
    context.play(UNDETECTED)
    for _ in range(4):
        context.isolate(target)
        context.play(HALF)
        context.isolate()
        context.play(HALF)
    context.isolate(target)
    context.heal()
    context.believe(target)
    context.expect_path(target, 'real', 'virtual', 'real')


def relapse(context: CaseContext) -> None:
    """Let a sensor be healthy for less than its dwell, and fail again."""
    target, belief = context.target, context.tested.beliefs[context.target]
    if belief.recovery == 'automatic' and belief.dwell < 0.6:
        raise Skipped(f'the dwell of {target} is only {belief.dwell:g} s')
    context.fault('freeze')
    context.play(UNDETECTED)
    context.isolate(target)
    context.expect(target, 'virtual')
    context.heal()
    context.isolate()
    context.play(0.5 * min(belief.dwell, 2.0))
    context.isolate(target)
    context.fault('bias', size=-BIAS * context.span(target))
    context.play(WATCHED)
    context.heal()
    context.believe(target)
    context.expect_path(target, 'real', 'virtual', 'real')


def second_fault(context: CaseContext) -> None:
    """Let another sensor fail while the first is replaced, and recover before it."""
    target, other = context.target, other_of(context)
    span = context.machine.truth.span
    context.fault('bias', size=BIAS * span[target])
    context.play(UNDETECTED)
    context.isolate(target)
    context.expect(target, 'virtual')
    context.play(context.apart)
    context.fault('bias', other, size=-BIAS * span[other])
    context.play(UNDETECTED)
    context.isolate(target, other)
    _expect_set(context, target, other)
    context.play(0.8)
    context.heal()
    context.fault('bias', size=BIAS * span[target])   # it is not well yet
    context.believe(other, others=(target,))
    context.expect(target, context.tested.serves([target], target), CONVERGED)
    context.play(0.5)
    context.heal()
    context.believe(target)


def simultaneous(context: CaseContext) -> None:
    """Let two sensors fail in the same instant, and recover in the same."""
    _together(context, (context.target, other_of(context)))


def unknown_set(context: CaseContext) -> None:
    """Let a set of sensors fail that there is no design for."""
    _together(context, without_design(context), 'no valid source')


def without_design(context: CaseContext) -> tuple[str, ...]:
    """Return a set of sensors that there is no design for; raises Skipped when all have one."""
    sensors, tested = context.tested.plant.sensors, context.tested
    sets = [names for size in range(len(sensors), 0, -1) for names in combinations(sensors, size)
            if all(tested.serves(names, name) == 'none' for name in names)]
    if not sets:
        raise Skipped('every set of sensors has a design')
    return sets[0]


def silence(context: CaseContext) -> None:
    """Let a healthy sensor fall silent that the virtual sensor reads."""
    target, reads = context.target, context.tested.virtual.reads
    if not reads:
        raise Skipped('the virtual sensor reads no sensor')
    needed = reads[0]
    counts = context.tested.beliefs[needed].silent_is_faulty
    context.fault('bias', size=BIAS * context.span(target))
    context.play(UNDETECTED)
    context.isolate(target)
    context.expect(target, 'virtual')
    context.play(0.3)
    context.fault('drop_out', needed)
    if context.tested.serves([target, needed], target) == 'none' or not counts:
        context.expect(target, 'none', context.tested.max_age[needed] + SOON)
    context.play(0.8)
    context.heal()
    context.fault('bias', size=BIAS * context.span(target))
    context.expect(target, 'virtual', CONVERGED + context.tested.beliefs[needed].dwell)
    context.play(0.5)
    context.heal()
    context.believe(target)


def other_of(context: CaseContext) -> str:
    """Return the sensor that fails besides, one that has a virtual sensor if there is."""
    others = [s for s in context.tested.plant.sensors if s != context.target]
    if not others:
        raise Skipped('there is one sensor only')
    return next((s for s in others if context.tested.serves([s], s) == 'virtual'), others[0])


def _together(context: CaseContext, names: tuple[str, ...], *told: str) -> None:
    for name in names:
        context.fault('bias', name, size=BIAS * context.span(name))
    context.play(UNDETECTED)
    context.isolate(*names)
    _expect_set(context, *names)
    context.play(0.8)
    if told:
        context.told(*told, within=SOON)
    context.heal()
    context.believe(*names)


def _expect_set(context: CaseContext, *names: str) -> None:
    for name in names:
        source = context.tested.serves(names, name)
        context.expect(name, source, CONVERGED if source == 'virtual' else SOON)
        context.seen.append(f'{name} {source}')
    context.fresh = False     # what reads one of them begins anew


START = Case('start', 'replaced once converged, not before', start, 4.0)
SENSOR_CASES = (
    Case('handover', f'{ONE}, no step', handover, 2.5),
    Case('freeze', ONE, _of('freeze'), 2.5),
    Case('drop_out', ONE, _of('drop_out'), 2.5),
    Case('bias', ONE, _of('bias', size=BIAS), 2.5),
    Case('drift', ONE, _of('drift', rate=DRIFT), 2.5),
    Case('spikes', ONE, _of('spikes', size=SPIKE, probability=0.3), 2.5),
    Case('nan', ONE, _of('not_a_number'), 2.5),
    Case('infinity', ONE, _of('infinity'), 2.5),
    Case('toggle', ONE, toggle, 5.0),
    Case('relapse', ONE, relapse, 4.0),
    Case('silence', 'nothing without a basis; then virtual', silence, 5.0),
    Case('second_fault', 'each as the set of both is designed', second_fault, 5.0),
    Case('simultaneous', 'each as the set of both is designed', simultaneous, 3.5),
    Case('unknown_set', 'no valid source, said; then real', unknown_set, 3.5),
)
