"""Faults of sensors, and what isolation says of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from vsensor_ros.lab.injection.case_context import CONVERGED, Skipped, SOON, Stage

UNDETECTED = 0.3    # s from a fault to its isolation
WATCHED = 0.9       # s that a replacement is watched
BIAS, SPIKE, DRIFT = 0.5, 2.0, 0.8  # of the range; of the range in a second
HALF = 0.5          # s of half a period at 1 Hz

PLAIN, ALONE, FULL_SHM, SIMULATED = 'plain', 'alone', 'full_shm', 'simulated'


@dataclass(frozen=True)
class Case:
    """One thing that can go wrong."""

    name: str
    expected: str       # in a few words
    act: Callable[[Stage], None]
    seconds: float      # of the machine's time, about, besides dwell and convergence
    session: str = PLAIN    # ALONE: in a plain one, with a process of ours


def fail_over(stage: Stage, begin: Callable[[], None]) -> None:
    """Let a fault begin, isolate it, watch, and let the sensor come back."""
    target = stage.target
    stage.play(0.2)
    begin()
    stage.play(UNDETECTED)
    stage.isolate(target)
    stage.expect(target, 'virtual')
    stage.play(WATCHED)
    stage.heal()
    stage.believe(target)
    stage.play(0.2)
    stage.expect_path(target, 'real', 'virtual', 'real')


def _of(kind: str, **parts: float) -> Callable[[Stage], None]:
    def act(stage: Stage) -> None:
        span = stage.rig.world.span[stage.target]
        sizes = {key: value if key == 'probability' else value * span
                 for key, value in parts.items()}
        fail_over(stage, lambda: stage.fault(kind, '', **sizes))
    return act


def start(stage: Stage) -> None:
    """Isolate a sensor that is healthy, from the beginning."""
    target = stage.target
    if stage.process is None:
        stage.call('reset')     # its virtual sensors converged to another machine
        stage.play(0.2)
    stage.expect(target, 'real', 10.0)
    stage.isolate(target)
    stage.expect(target, 'virtual', CONVERGED)
    stage.play(0.3)
    stage.believe(target)
    stage.fresh = True
    stage.expect_path(target, *_path_to_virtual(stage), 'real')


def _path_to_virtual(stage: Stage) -> tuple[str, ...]:
    """Return what was told up to the virtual sensor; the first statuses may have been missed."""
    sources = [t.facts.get(stage.target, {}).get('source', '') for t in stage.rig.heard.told]
    return ('real', 'none', 'virtual') if 'none' in sources else ('real', 'virtual')


def handover(stage: Stage) -> None:
    """Isolate a sensor that is healthy, and give it back."""
    fail_over(stage, lambda: None)
    stage.expect_no_step(stage.target)


def infinity(stage: Stage) -> None:
    """Let the readings be infinite."""
    def begin() -> None:
        stage.undetected(stage.target)
        said = stage.rig.channels[stage.target]
        stage.rig.channels[stage.target] = replace(said, value=np.full_like(said.value, np.inf))
    fail_over(stage, begin)


def toggle(stage: Stage) -> None:
    """Let isolation change its mind at 1 Hz."""
    target, policy = stage.target, stage.setup.policies[stage.target]
    if policy.recovery == 'automatic' and policy.dwell < 2.0 * HALF:
        raise Skipped(f'the dwell of {target} is {policy.dwell:g} s, shorter than a period')
    stage.fault('bias', size=BIAS * stage.rig.world.span[target])
    stage.play(UNDETECTED)
    for _ in range(4):
        stage.isolate(target)
        stage.play(HALF)
        stage.isolate()
        stage.play(HALF)
    stage.isolate(target)
    stage.heal()
    stage.believe(target)
    stage.expect_path(target, 'real', 'virtual', 'real')


def relapse(stage: Stage) -> None:
    """Let a sensor be healthy for less than its dwell, and fail again."""
    target, policy = stage.target, stage.setup.policies[stage.target]
    if policy.recovery == 'automatic' and policy.dwell < 0.6:
        raise Skipped(f'the dwell of {target} is only {policy.dwell:g} s')
    stage.fault('freeze')
    stage.play(UNDETECTED)
    stage.isolate(target)
    stage.expect(target, 'virtual')
    stage.heal()
    stage.isolate()
    stage.play(0.5 * min(policy.dwell, 2.0))
    stage.isolate(target)
    stage.fault('bias', size=-BIAS * stage.rig.world.span[target])
    stage.play(WATCHED)
    stage.heal()
    stage.believe(target)
    stage.expect_path(target, 'real', 'virtual', 'real')


def second_fault(stage: Stage) -> None:
    """Let another sensor fail while the first is replaced, and recover before it."""
    target, other = stage.target, _other(stage)
    span = stage.rig.world.span
    stage.fault('bias', size=BIAS * span[target])
    stage.play(UNDETECTED)
    stage.isolate(target)
    stage.expect(target, 'virtual')
    stage.play(0.5)
    stage.fault('bias', other, size=-BIAS * span[other])
    stage.play(UNDETECTED)
    stage.isolate(target, other)
    _expect_set(stage, target, other)
    stage.play(0.8)
    stage.heal()
    stage.fault('bias', size=BIAS * span[target])   # it is not well yet
    stage.believe(other, others=(target,))
    stage.expect(target, stage.setup.serves([target], target), CONVERGED)
    stage.play(0.5)
    stage.heal()
    stage.believe(target)


def simultaneous(stage: Stage) -> None:
    """Let two sensors fail in the same instant, and recover in the same."""
    _together(stage, (stage.target, _other(stage)))


def unknown_set(stage: Stage) -> None:
    """Let a set of sensors fail that there is no design for."""
    sensors, setup = stage.setup.plant.sensors, stage.setup
    sets = [names for size in range(len(sensors), 0, -1) for names in combinations(sensors, size)
            if all(setup.serves(names, name) == 'none' for name in names)]
    if not sets:
        raise Skipped('every set of sensors has a design')
    _together(stage, sets[0], 'no valid source')


def silence(stage: Stage) -> None:
    """Let a healthy sensor fall silent that the virtual sensor reads."""
    target, reads = stage.target, stage.setup.virtual.reads
    if not reads:
        raise Skipped('the virtual sensor reads no sensor')
    needed = reads[0]
    counts = stage.setup.policies[needed].silent_is_faulty
    stage.fault('bias', size=BIAS * stage.rig.world.span[target])
    stage.play(UNDETECTED)
    stage.isolate(target)
    stage.expect(target, 'virtual')
    stage.play(0.3)
    stage.fault('drop_out', needed)
    if stage.setup.serves([target, needed], target) == 'none' or not counts:
        stage.expect(target, 'none', stage.setup.max_age[needed] + SOON)
    stage.play(0.8)
    stage.heal()
    stage.fault('bias', size=BIAS * stage.rig.world.span[target])
    stage.expect(target, 'virtual', CONVERGED + stage.setup.policies[needed].dwell)
    stage.play(0.5)
    stage.heal()
    stage.believe(target)


def _other(stage: Stage) -> str:
    """Return the sensor that fails besides, one that has a virtual sensor if there is."""
    others = [s for s in stage.setup.plant.sensors if s != stage.target]
    if not others:
        raise Skipped('there is one sensor only')
    return next((s for s in others if stage.setup.serves([s], s) == 'virtual'), others[0])


def _together(stage: Stage, names: tuple[str, ...], *told: str) -> None:
    for name in names:
        stage.fault('bias', name, size=BIAS * stage.rig.world.span[name])
    stage.play(UNDETECTED)
    stage.isolate(*names)
    _expect_set(stage, *names)
    stage.play(0.8)
    if told:
        stage.told(*told, within=SOON)
    stage.heal()
    stage.believe(*names)


def _expect_set(stage: Stage, *names: str) -> None:
    for name in names:
        source = stage.setup.serves(names, name)
        stage.expect(name, source, CONVERGED if source == 'virtual' else SOON)
        stage.seen.append(f'{name} {source}')
    stage.fresh = False     # what reads one of them begins anew


ONE = 'real > virtual > real, one switch each'
START = Case('start', 'replaced once converged, not before', start, 4.0)
CASES = (
    Case('handover', f'{ONE}, no step', handover, 2.5),
    Case('freeze', ONE, _of('freeze'), 2.5),
    Case('drop_out', ONE, _of('drop_out'), 2.5),
    Case('bias', ONE, _of('bias', size=BIAS), 2.5),
    Case('drift', ONE, _of('drift', rate=DRIFT), 2.5),
    Case('spikes', ONE, _of('spikes', size=SPIKE, probability=0.3), 2.5),
    Case('nan', ONE, _of('not_a_number'), 2.5),
    Case('infinity', ONE, infinity, 2.5),
    Case('toggle', ONE, toggle, 5.0),
    Case('relapse', ONE, relapse, 4.0),
    Case('silence', 'nothing without a basis; then virtual', silence, 5.0),
    Case('second_fault', 'each as the set of both is designed', second_fault, 5.0),
    Case('simultaneous', 'each as the set of both is designed', simultaneous, 3.5),
    Case('unknown_set', 'no valid source, said; then real', unknown_set, 3.5),
)
