"""
What else there is beside the virtual sensor that is handed out, and what that would cover.

Constant gains that are proved where the plant works go before gains that follow the readings, and
these before a Kalman filter. But of what is proved the quieter one is taken. A function of the
states that is proved goes before a linear one of which nothing is, while it is not much noisier.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from vsensor_ros.designer.order_noise import QUIET
from vsensor_ros.designer.sentences import say
from vsensor_ros.designer.simulated_noise import simulated_noise
from vsensor_ros.observers import NonlinearSensor, Refusal, ScheduledSensor, VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.reason import Reason

QUIETER = 0.8  # times the noise: what simulation tells apart for sure
Scheduled = ScheduledSensor | Reason | None  # None: not for such a plant


def quietest(plant: Plant, entry: VirtualSensor, sought: Callable[[], Scheduled],
             ) -> VirtualSensor | ScheduledSensor:
    """
    Return one with constant gains that is proved, or what is sought if that is clearly quieter.

    It is sought only where it may be: no decoupled one is quieter than the floor.
    """
    if not entry.active or entry.noise is None or not entry.noise.floor < float('inf'):
        return entry
    if not entry.noise.ratio > QUIET:
        return replace(entry, why=say(Reason.of('proved, quiet', ratio=entry.noise.ratio)))
    over = sought()
    if not isinstance(over, ScheduledSensor):
        return replace(entry, why=say(_none(over)))
    if over.grade != entry.grade:
        return replace(entry, why=say(Reason.of('proved, decoupled')))
    noise = simulated_noise(plant, [entry, over])
    if noise is None:
        return replace(entry, why=say(Reason.of('proved, not simulated', order=over.order)))
    ours, theirs = noise.tolist()
    if theirs < QUIETER * ours:
        return replace(over, why=say(Reason.of(
            'scheduled, quieter', order=entry.order, ours=theirs, theirs=ours)))
    return replace(entry, why=say(Reason.of('proved, no noisier', ours=ours, theirs=theirs)))


def quiet_enough(function: NonlinearSensor, linear: VirtualSensor) -> NonlinearSensor | Reason:
    """
    Return a function instead of an unproved linear one, or why not: it is QUIET times as noisy.

    Both by what is stated at the operating point: simulation may not stay in the ranges, and a
    linear one that does not converge somewhere would be judged there.
    """
    ours = float(function.drift[-1])
    theirs = float('nan') if linear.noise is None else linear.noise.error
    if ours > QUIET * theirs:
        return Reason.of('function, noisier', phi=function.phi, ours=ours, theirs=theirs)
    return replace(function, why=say(Reason.of(
        'linear, unproved', order=linear.order, ours=ours, theirs=theirs)))


def beside_scheduled(found: VirtualSensor | Refusal, filtered: bool) -> str:
    """Say what there is beside gains that follow the readings; filtered: a filter is possible."""
    constant = _constant(found, '--no-scheduled --no-extended' if filtered else '--no-scheduled')
    if not filtered:
        return say(constant)
    return f"{say(constant)}; {say(Reason.of('scheduled, not filtered'))}"


def beside_filter(found: VirtualSensor | Refusal, over: Reason | None, asked: bool) -> str:
    """Say what there is beside a filter; over: why no scheduled one, if that was asked for."""
    constant = _constant(found, '--no-extended')
    return f'{say(constant)}; {say(_none(over))}' if asked else say(constant)


def _none(over: Reason | None) -> Reason:
    return over or Reason.of('scheduled, not for it')


def _constant(entry: VirtualSensor | Refusal, by: str) -> Reason:
    """Say what constant gains would be, and what hands them out."""
    if isinstance(entry, Refusal):
        return Reason.of('filter, none', reason=entry.reason)
    if entry.grade == 'temporary':
        return Reason.of('filter, for a time', order=entry.order, by=by)
    c = entry.certificate
    if c is not None and c.status == 'region':
        return Reason.of('filter, proved in part', order=entry.order, where=c.uncovered, by=by)
    return Reason.of('filter, unproved', order=entry.order, reason='' if c is None else c.reason,
                     by=by)
