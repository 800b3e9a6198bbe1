"""What a case is, and what most of them do."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

from vsensor_ros.lab.injection.case_context import CaseContext

UNDETECTED = 0.3    # s from a fault to its isolation
WATCHED = 0.9       # s that a replacement is watched
BIAS = 0.5          # of the range
ONE = 'real > virtual > real, one switch each'

PLAIN, OURS, FULL_SHM, SIMULATED = 'plain', 'ours', 'full_shm', 'simulated'


@dataclass(frozen=True)
class Case:
    """One thing that can go wrong."""

    name: str
    expected: str       # in a few words
    act: Callable[[Any], None]  # on a CaseContext, or an AloneContext
    seconds: float      # of the machine's time, about, besides dwell and convergence
    session: str = PLAIN    # OURS: in a plain one, with a process of ours
    each: bool = False      # its seconds are of each sensor


def fail_over(context: CaseContext, begin: Callable[[], None], in_order: bool = True) -> None:
    """
    Let a fault begin, isolate it, watch, and let the sensor come back.

    in_order: the driver's stamps increase. What is only sent on has them as they are.
    """
    target = context.target
    with nullcontext() if in_order else context.excused(stamps=True):
        context.play(0.2)
        begin()
        context.play(UNDETECTED)
        context.isolate(target)
    context.expect(target, 'virtual')
    context.play(WATCHED)
    with nullcontext() if in_order else context.excused(stamps=True):
        context.heal()
        context.believe(target)
        context.play(0.2)
    context.expect_path(target, 'real', 'virtual', 'real')
