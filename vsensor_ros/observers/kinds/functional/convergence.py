"""How a virtual sensor forgets the start that nobody knew, and how far readings reach into it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from vsensor_ros.observers.kinds.functional.virtual_sensor import VirtualSensor

_LEFT = 0.01  # of the largest: a start of which no more is left counts as forgotten
_SETTLED = 0.05  # of the largest: of which no more is left, that has settled
_DIED = 1e-4  # of the largest: no more need be left where one stops to look
_LONGER = 24  # octaves that are added for it, at most
_HORIZON = 50.0  # time constants that are looked at
_OCTAVES = 20  # of time before the horizon that are looked at, too
_PHASES = 8  # of half a turn
_SPEEDS = 16  # of modes that swing, at most, spread over all
_NEVER = 1e-12  # 1/s: a rate below it, 30 000 years, is none
_FREQUENCIES = 60
_LATE = 0.2  # s, of a reading


@dataclass(frozen=True, eq=False)
class Convergence:
    """
    What is left of an unknown start, as a standard deviation of vhat, over time.

    `left[i]` is the most at or after `times[i]` [s]; it never rises. Where the covariance of the
    start is not known it is infinite until `warm_up`, and then nothing.
    """

    warm_up: float  # s; inf: nothing dies out for certain
    times: np.ndarray  # (T,)
    left: np.ndarray  # (T,)
    known: bool  # the covariance of the start
    proved: bool  # not only at the operating point
    slowest: float  # s, the largest time constant, of what is left as of N

    def deviation(self, age: float) -> float:
        """Return the standard deviation that is left at an age [s]."""
        if not self.known:
            return np.inf if age < self.warm_up else 0.0
        return float(np.interp(age, self.times, self.left))


class Region(NamedTuple):
    """Where a certificate holds: ``low <= Gz z + Gy y0 + Gu u <= high``, R arguments."""

    Gz: np.ndarray  # (R, k)
    Gy: np.ndarray  # (R, l0)
    Gu: np.ndarray  # (R, m)
    low: np.ndarray  # (R,)
    high: np.ndarray  # (R,)


def region_of(v: VirtualSensor) -> Region | None:
    """Return where the certificate of a virtual sensor holds; None: everywhere, or nowhere."""
    limits = () if v.certificate is None else v.certificate.region
    k, l0, one = v.order, len(v.healthy), np.eye(len(v.inputs))
    inside = [(np.zeros(k), np.zeros(l0), one[j], low, high) if i is None else
              (v.Gz[i][j], v.Gy[i][j], v.Gu[i][j], low, high) for i, j, low, high in limits]
    return Region(*map(np.array, zip(*inside))) if inside else None


_UNKNOWN = Convergence(np.inf, np.zeros(1), np.full(1, np.inf), False, False, np.inf)


def converge(v: VirtualSensor) -> Convergence:
    """
    Work out how a virtual sensor of one row forgets its start.

    A linear error decays as ``Cv exp(N t)``. One that nonlinear terms feed decays at the rate of
    its certificate, ``|Cv e| <= |Cv S^-1/2| exp(-rate t) |S^1/2 e(0)|`` (method, 3.5), or, where
    there is none, is taken as linear, which nothing proves. Nor is anything proved where the start
    may lie outside its region: then the slower of both rates counts.

    It is warm when what is left is, and stays, no more than the noise of the estimate, or a
    hundredth of its largest value.
    """
    c, fed = v.certificate, any(v.Gz[i].any() for i in v.active)
    proved = not fed or (c is not None and c.status != 'none' and c.rate > 0.0)
    start = np.eye(v.order) if v.start is None else v.start
    region = region_of(v)
    within = True
    if proved and fed and region is not None and v.start is not None:
        # of two arguments in the region none is further from the other than it is wide
        off = np.sqrt(3.0 * np.einsum('ri,ij,rj->r', region.Gz, start, region.Gz))
        within = bool((off <= (region.high - region.low) * (1.0 + 1e-6)).all())
    if not v.order:
        return Convergence(0.0, np.zeros(1), np.zeros(1), True, True, 0.0)
    if fed and proved:
        assert c is not None
        rate = min(c.rate, 1e12) if within else min(c.rate, max(_slowest_rate(v), 0.0))
        if rate < _NEVER:
            return _UNKNOWN
        times = _times(rate, None)[0]
        reach = float(v.Cv[0] @ np.linalg.pinv(c.S) @ v.Cv[0]) * float(np.trace(c.S @ start))
        left = np.sqrt(max(reach, 0.0)) * np.exp(-rate * times)
    else:
        rate = _slowest_rate(v)
        if not _NEVER < rate < np.inf:
            return _UNKNOWN
        times, left = _linear_left(v, rate)
    if not np.isfinite(left).all():
        return _UNKNOWN
    noise = 0.0 if v.noise is None or v.start is None else v.noise.error
    warm_up = _first(v, times, left, max(noise, _LEFT * left[0]))
    # a chain of dead times has no slow mode, and yet takes its time
    slowest = max(1.0 / rate, _first(v, times, left, _SETTLED * left[0]) / -np.log(_SETTLED))
    return Convergence(warm_up, times, left, v.start is not None, proved and within, slowest)


def settling_time(v: VirtualSensor) -> float:
    """
    Return when [s] no more than 5 % of an error in the start is left; inf: it does not die out.

    Of the largest that there is in the estimate, of a linear error: by exp(N t) or the powers of
    N themselves, because a chain of lags or of dead times takes longer than its modes tell.
    """
    if not v.order:
        return 0.0
    rate = _slowest_rate(v)
    if not _NEVER < rate < np.inf:
        return np.inf
    settled = 0.0
    for row in v.Cv:
        times, left = _linear_left(replace(v, Cv=row[None, :]), rate)
        if not np.isfinite(left).all():
            return np.inf
        settled = max(settled, _first(v, times, left, _SETTLED * left[0]))
    return settled


def _linear_left(v: VirtualSensor, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] (T,), and what is the most at or after them of a linear error (T,)."""
    times, rows = _response(v, rate)
    left = np.linalg.norm(rows @ _root(v), axis=2).max(axis=1)
    return times, np.maximum.accumulate(left[::-1])[::-1]


def _root(v: VirtualSensor) -> np.ndarray:
    """Return a square root (k, k) of the covariance of the start."""
    values, vectors = np.linalg.eigh(np.eye(v.order) if v.start is None else v.start)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _slowest_rate(v: VirtualSensor) -> float:
    """Return the rate [1/s] of the slowest mode of N."""
    modes = np.linalg.eigvals(v.N)
    if v.sample_time is None:
        return float(-modes.real.max())
    return float(-np.log(max(np.abs(modes).max(), 1e-3))) / v.sample_time


def _response(v: VirtualSensor, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] (T,), and Cv exp(N t) then and within half a turn of it (T, .., k)."""
    times, octaves = _times(rate, v.sample_time)
    one = v.N if v.sample_time is not None else expm(v.N * times[1])
    turned, powers = _turned(v), _powers(one, octaves)
    rows = turned @ powers
    octave, last = powers[-8:], rows[-8:]
    for _ in range(_LONGER):
        if not np.abs(last).max() > _DIED * np.abs(rows).max():
            break
        octave = octave @ octave
        last = turned @ octave
        rows, times = np.concatenate([rows, last]), np.concatenate([times, 2.0 * times[-8:]])
    return times, rows


def _times(rate: float, sample_time: float | None) -> tuple[np.ndarray, int]:
    """Return times [s] that grow by an eighth to a sixteenth each, and their octaves after 7."""
    octaves, unit = _OCTAVES, _HORIZON / rate / 16 / 2**_OCTAVES
    if sample_time is not None:
        octaves, unit = int(max(0.0, np.ceil(np.log2(unit * 2**_OCTAVES / sample_time)))), \
            sample_time
    steps = [np.arange(8.0), *(np.arange(8.0, 16.0) * 2.0**i for i in range(octaves + 1))]
    return np.concatenate(steps) * unit, octaves


def _powers(one: np.ndarray, octaves: int) -> np.ndarray:
    """Return the powers 0..7, then 8..15 and so many octaves more, of a matrix (k, k)."""
    powers = [np.eye(len(one))]
    for _ in range(15):
        powers.append(powers[-1] @ one)
    found, octave = [np.array(powers)], np.array(powers[8:])
    for _ in range(octaves):
        octave = octave @ octave
        found.append(octave)
    return np.concatenate(found)


def _turned(v: VirtualSensor) -> np.ndarray:
    """
    Return Cv, and what it becomes within half a turn of each swinging mode (.., k).

    Of what swings faster than one looks, one is sure to see the peaks, too.
    """
    modes = np.linalg.eigvals(v.N)
    speeds = np.unique(np.abs(modes.imag if v.sample_time is None else np.angle(modes)))
    speeds = speeds[speeds > 0.0]
    if len(speeds) > _SPEEDS:
        speeds = speeds[np.linspace(0, len(speeds) - 1, _SPEEDS).round().astype(int)]
    shifts = np.unique([0.0, *(part * np.pi / speed for speed in speeds
                               for part in np.arange(1, _PHASES) / _PHASES)])
    if v.sample_time is None:
        return np.array([v.Cv[0] @ expm(v.N * shift) for shift in shifts])
    steps = np.unique(np.round(np.minimum(shifts, 1e9)).astype(int))
    return np.array([v.Cv[0] @ np.linalg.matrix_power(v.N, step) for step in steps])


def _first(v: VirtualSensor, times: np.ndarray, left: np.ndarray, enough: float) -> float:
    """Return the first time [s] at which what is left is enough; of a discrete one, a sample."""
    below = np.flatnonzero(left <= enough)
    if not below.size:
        return float('inf')
    i = int(below[0])
    if i == 0:
        return 0.0
    last, here = float(left[i - 1]), float(left[i])
    # as if it died out evenly; at once where nothing is left
    part = np.log(last / enough) / np.log(last / here) if here > 0.0 < enough else 1.0
    at = times[i - 1] + part * (times[i] - times[i - 1])
    if v.sample_time is None:
        return float(at)
    return float(np.ceil(at / v.sample_time * (1.0 - 1e-12))) * v.sample_time


def reading_gains(v: VirtualSensor) -> np.ndarray:
    """Return the peak over frequency of ``|Cv (s - N)^-1 J_j + Q_j|`` for each reading (l0,)."""
    direct = np.abs(v.Q[0])
    if not v.order or not len(v.healthy):
        return direct
    modes = np.abs(np.linalg.eigvals(v.N))
    if v.sample_time is None:
        known = modes[modes > 0.0]
        low, high = (known.min(), known.max()) if known.size else (1.0, 1.0)
        s = 1j * np.concatenate([[0.0], known, np.geomspace(low / 30, high * 30, _FREQUENCIES)])
    else:
        direct = np.zeros_like(direct)
        s = np.exp(1j * np.concatenate([np.linspace(0.0, np.pi, _FREQUENCIES),
                                        np.geomspace(1e-6, np.pi, _FREQUENCIES)]))
    try:
        left = np.linalg.solve((s[:, None, None] * np.eye(v.order) - v.N).swapaxes(1, 2),
                               np.broadcast_to(v.Cv[0][:, None], (len(s), v.order, 1)))[..., 0]
    except np.linalg.LinAlgError:  # a mode that never dies out
        return np.where(v.J.any(axis=0), np.inf, direct)
    return np.maximum(direct, np.abs(left @ v.J + v.Q[0]).max(axis=0))


def reading_pushes(v: VirtualSensor) -> np.ndarray:
    """
    Return the peak over time of ``|Cv exp(N t) J_j|`` [1/s] for each reading (l0,).

    Of a temporary one, where it may grow for ever: that over what a reading is late.
    """
    if not v.order or not len(v.healthy):
        return np.zeros(len(v.healthy))
    rate = _slowest_rate(v)
    if v.grade == 'temporary':
        rows = _first_response(v)
    elif not rate > 0.0:
        return np.where(v.J.any(axis=0), np.inf, 0.0)
    else:
        rows = _response(v, rate)[1]
    peak = np.abs(rows @ v.J).max(axis=tuple(range(rows.ndim - 1)))
    return np.asarray(peak if v.sample_time is None else peak / v.sample_time)


def _first_response(v: VirtualSensor) -> np.ndarray:
    """Return Cv exp(N t) over what a reading is late (T, k)."""
    if v.sample_time is None:
        return np.array([v.Cv[0] @ expm(v.N * t) for t in np.linspace(0.0, _LATE, 9)])
    return v.Cv[0] @ _powers(v.N, 0)[:max(2, min(16, round(_LATE / v.sample_time)))]
