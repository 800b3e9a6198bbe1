"""
A virtual sensor that follows its channel while that is believed, and how it drifts off after.

Source: method 3.12. Letters are those of virtual_sensor.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from vsensor_ros.observers.kinds.functional.virtual_sensor import Tracking, VirtualSensor
from vsensor_ros.observers.knowledge import Noise

__all__ = ['Tracking', 'deviation_after', 'horizon', 'tracker']

_FINEST = 2.0**-20  # s: times are rounded to about a microsecond
_OCTAVES = 50  # of it that are looked at: 34 years; of steps as many


def tracker(v: VirtualSensor) -> VirtualSensor:
    """
    Return the observer that v is while its channels are believed: it reads them, too.

    Its fault set is what of that of v does not track; its `healthy` are those of v, then the
    channels. It starts where their first readings say. Raises ValueError where v has no tracking.
    """
    t = _tracking(v)
    N = v.N - t.L @ t.C
    error = float(deviation_after(v, 0.0))
    K, start = _first_correction(v, t)

    def widened(gain: np.ndarray) -> np.ndarray:
        return np.hstack([gain, np.zeros((len(gain), len(t.channels)))])

    return replace(
        v, fault_set=tuple(name for name in v.fault_set if name not in t.channels),
        healthy=(*v.healthy, *t.channels), N=N, J=np.hstack([v.J - t.L @ t.Q, t.L]),
        B=v.B - t.L @ t.Qu, Q=widened(v.Q), Gy=tuple(widened(g) for g in v.Gy),
        z0=v.z0 - K @ t.C @ v.z0, z0_gain=np.hstack([v.z0_gain - K @ (t.C @ v.z0_gain + t.Q), K]),
        start=start, eigenvalues=np.linalg.eigvals(N).astype(complex),
        grade='exact' if v.grade == 'temporary' else v.grade,
        noise=Noise(error, error, t.assumed), proof=None, ladder=(), certificate=None,
        tracking=None)


def _first_correction(v: VirtualSensor, t: Tracking) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the gain (k, f) of the channels' first readings, and the start's covariance then."""
    K = np.zeros_like(t.L)
    if v.start is None or t.noise is None:
        return K, v.start
    plain = ~t.Qu.any(axis=1)  # at the start no command is looked at
    C, R = t.C[plain], np.diag(t.noise[plain]**2)
    K[:, plain] = v.start @ C.T @ np.linalg.pinv(C @ v.start @ C.T + R, hermitian=True)
    left = np.eye(v.order) - K @ t.C
    start = left @ v.start @ left.T + (K * t.noise**2) @ K.T
    return K, (start + start.T) / 2


def deviation_after(v: VirtualSensor, times: ArrayLike) -> np.ndarray:
    """
    Return the standard deviation of vhat at times [s] after its channels were lost.

    Shape and order are those of the times; a discrete plant has moved by whole steps, at least so
    long. Beyond numbers it is infinite. Raises ValueError where v has no tracking.
    """
    t, unit = _tracking(v), v.sample_time or _FINEST
    given = np.asarray(times, dtype=float)
    count = np.rint(given / unit) if v.sample_time is None else np.ceil(given / unit - 1e-9)
    left = np.minimum(np.maximum(count, 0.0), 2.0**_OCTAVES - 1).astype(np.int64).ravel()
    row = np.repeat(v.Cv[:1], len(left), axis=0)  # Cv exp(N t), of all times
    variance = np.full(len(left), t.direct)
    with np.errstate(all='ignore'):
        for E, V in _octaves(v, int(left.max(initial=0)).bit_length()):
            now = (left & 1).astype(bool)
            variance[now] += _squared(row[now], V)
            row[now] = row[now] @ E
            left >>= 1
        deviation = np.sqrt(variance + _squared(row, t.P))
    return np.where(np.isfinite(deviation), deviation, np.inf).reshape(given.shape)


def horizon(v: VirtualSensor, tolerance: float) -> float:
    """
    Return for how long [s] after the loss of its channels the deviation of vhat is tolerable.

    0 when it is never, inf when it is for 30 years. Raises ValueError where v has no tracking.
    """
    t, unit = _tracking(v), v.sample_time or _FINEST
    row, variance, count = v.Cv[:1], t.direct, 0
    limit = tolerance**2
    with np.errstate(all='ignore'):
        steps = list(_octaves(v, _OCTAVES))
        if not variance + _squared(row, t.P)[0] <= limit:
            return 0.0
        # the deviation never falls: take the largest steps that are still tolerable
        for octave in range(_OCTAVES - 1, -1, -1):
            E, V = steps[octave]
            further, grown = row @ E, variance + _squared(row, V)[0]
            if grown + _squared(further, t.P)[0] <= limit:  # not where it is not a number
                row, variance, count = further, grown, count + 2**octave
    return float('inf') if count == 2**_OCTAVES - 1 else count * unit


def _tracking(v: VirtualSensor) -> Tracking:
    if v.tracking is None:
        raise ValueError(f'{v.channel} of {{{", ".join(v.fault_set)}}} has no tracking')
    return v.tracking


def _octaves(v: VirtualSensor, count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield for t = 1, 2, 4, .. units ``E = exp(N t)`` and ``V = int exp(N s) W exp(N' s)``."""
    t, k = _tracking(v), v.order
    N = v.N if t.slopes is None else t.slopes
    E, V = N, t.W
    if v.sample_time is None:
        both = expm(np.block([[-N, t.W], [np.zeros((k, k)), N.T]]) * _FINEST)
        E = both[k:, k:].T
        V = E @ both[:k, k:]
    for _ in range(count):
        yield E, V
        E, V = E @ E, V + E @ V @ E.T


def _squared(rows: np.ndarray, M: np.ndarray) -> np.ndarray:
    """Return ``c M c'`` of each row c."""
    return np.einsum('ti,ij,tj->t', rows, M, rows)
