"""
The virtual sensor that the unknown inputs of a relaxed problem disturb least.

Candidates are Kalman filters, H-infinity filters, and smaller observers whose free gain is
descended on. The least disturbed is taken whose noise stays within the limit.
Source: method 2 (SVD fallback) and 3.6; D section 3.2.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.designer import invariant_spaces
from vsensor_ros.designer.candidates import Ground, judged, JudgedCandidate, static
from vsensor_ros.designer.disturbance import graded
from vsensor_ros.designer.h_infinity import h_infinity_filters
from vsensor_ros.designer.observer import build
from vsensor_ros.designer.order_noise import SLUGGISH
from vsensor_ros.designer.relaxation import grounds_of, judged_filters, Relaxed, swept
from vsensor_ros.designer.sentences import say
from vsensor_ros.observers import Noise, Rung, VirtualSensor
from vsensor_ros.reason import Reason

WORTH = 1.2  # the least order is taken whose disturbance is within this factor of the least
ALIKE = 1.02  # within this factor of the least disturbance, the quietest is taken
MOST_SPACES = 4  # invariant spaces tried


def least_disturbed(relaxed: Relaxed, prefer: str, decay: float | None) -> VirtualSensor | None:
    """Return the least order that is disturbed nearly as little as any."""
    where = grounds_of(relaxed, decay)
    pool: list[tuple[float, JudgedCandidate]] = []
    for ground in where:
        noise = relaxed.noise(ground.noise, 1.0)
        pool += [(noise.gain(c.candidate), c) for c in _candidates(relaxed, ground)
                 if c.error <= relaxed.limit]
    if not pool:
        return None
    enough = SLUGGISH * min(where[0].decay, max(c.decay for _, c in pool))
    pool = [(gain, c) for gain, c in pool if c.decay >= enough]
    rungs = {}
    for k in sorted({c.order for _, c in pool}):
        found_here = _built(relaxed, [f for f in pool if f[1].order == k])
        if found_here is not None:
            rungs[k] = found_here
    if not rungs:
        return None
    least = min(sensor.disturbance_gain for _, sensor in rungs.values())
    k = next(k for k, (_, sensor) in sorted(rungs.items())
             if prefer == 'least' or sensor.disturbance_gain <= WORTH * least)
    candidate, sensor = rungs[k]
    ladder = tuple(Rung(order, c.error, v.noise_gain, c.decay, say(Reason.of(
        'disturbed rung', method=c.method, gain=v.disturbance_gain)))
        for order, (c, v) in sorted(rungs.items()))
    return replace(sensor, ladder=ladder,
                   noise=Noise(candidate.error, min(relaxed.floor, candidate.error),
                               where[0].noise.assumed))


def _candidates(relaxed: Relaxed, ground: Ground) -> list[JudgedCandidate]:
    """Return all virtual sensors that are tried on one ground."""
    kalman_filters = swept(relaxed, ground, relaxed.floor)
    found = [*judged_filters(ground, [ground.filter]), *(c for _, c in kalman_filters),
             *static(ground)]
    if not kalman_filters:
        return found
    inside = [n for n, c in kalman_filters if c.error <= relaxed.limit] or [kalman_filters[0][0]]
    last = max(inside, key=lambda n: float(n.weight.max()))
    for factor in (0.1, 1.0, 10.0):
        noise = replace(last, weight=factor * last.weight)
        found += judged_filters(ground, list(h_infinity_filters(ground.known, noise)),
                                'H-infinity filter')
    rows = ([ground.known.v] if not len(ground.terms)
            else [ground.known.v, np.vstack([ground.known.v, ground.terms])])
    for outputs in rows:
        for _, space in zip(range(MOST_SPACES), invariant_spaces.spaces(ground.known, outputs)):
            found += judged(ground, invariant_spaces.candidates(
                ground.known, last, space, ground.decay), 'closed subspace')
    return found


def _built(relaxed: Relaxed, pool: list[tuple[float, JudgedCandidate]],
           ) -> tuple[JudgedCandidate, VirtualSensor] | None:
    """Build the quietest of the candidates that are disturbed least, or None."""
    while pool:
        least = min(gain for gain, _ in pool)
        best = min((f for f in pool if f[0] <= ALIKE * least), key=lambda f: f[1].error)
        sensor = build(relaxed.problem, best[1].candidate, best[1].method)
        if sensor is not None:
            return best[1], graded(relaxed.original, sensor)
        pool = [f for f in pool if f is not best]
    return None
