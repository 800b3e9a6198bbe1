"""
How well parameters are determined: standard errors, and which of them only a combination is seen.

The covariance is that of the linear least squares problem at the end of a fit: the slopes of all
misfits by the parameters, with the starts of windows and the offsets of runs taken off. Misfits of
a simulation are alike from one reading to the next, so that they tell less than their count: their
autocorrelation says how much less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.fitting.search import bounds_of, Found

UNSEEN = 1e-4  # singular value of scaled slopes, of the largest: nothing tells this direction
CLOSE = 0.98  # correlation that is said
PART = 0.15  # of a direction's largest part: this parameter belongs to it
LOOSE = 0.5  # standard error, of the parameter's size: it is hardly determined


@dataclass(frozen=True, eq=False)
class Known:
    """
    Standard errors (P,), inf where nothing determines a parameter, and correlations (P, P).

    said: sentences on what the recording does not tell.
    """

    errors: np.ndarray
    correlations: np.ndarray
    said: tuple[str, ...]


def known(found: Found) -> Known:
    """Return how well the parameters of a fit are determined."""
    shooting, start = found.shooting, found.start
    slopes, independent = _projected(found)
    count = len(start.theta)
    # relative changes, so that directions are read as ratios; of 0, parts of the range
    low, high = bounds_of(shooting.model)
    scale = np.where(np.abs(start.theta) > 1e-3 * (high - low), start.theta, high - low)
    u, sizes, directions = np.linalg.svd(slopes[:, :count] * scale, full_matrices=False)
    seen = sizes > UNSEEN * sizes[0]
    # of the misfits as they were weighed: 1, but for what the weights left
    covariance = (directions[seen].T / sizes[seen]**2) @ directions[seen] / independent
    errors = np.sqrt(np.diag(covariance))
    names = shooting.model.parameters
    lost = directions[~seen]
    hidden = np.zeros(count, bool) if not len(lost) else (np.abs(lost) > PART).any(axis=0)
    with np.errstate(all='ignore'):
        correlations = covariance / np.outer(errors, errors)
    said = [unseen(direction, names, scale) for direction in lost]
    for i in range(count):
        for j in range(i):
            if not (hidden[i] or hidden[j]) and abs(correlations[i, j]) > CLOSE:
                said.append(f'{names[j]} and {names[i]} are correlated by '
                            f'{correlations[i, j] * np.sign(scale[i] * scale[j]):.3f}: one is '
                            'known only as well as the other')
        if not hidden[i] and errors[i] > LOOSE:
            said.append(f'{names[i]} is hardly determined: its standard error is '
                        f'{errors[i] * abs(scale[i]):.2g}, its value {start.theta[i]:.3g}')
    for i, name in enumerate(names):
        if start.theta[i] in (low[i], high[i]):
            said.append(f'{name} ended at a bound of its range: widen fit, or ask whether the '
                        'equations hold')
    return Known(np.where(hidden, np.inf, errors * np.abs(scale)), correlations, tuple(said))


def unseen(direction: np.ndarray, names: Sequence[str], scale: np.ndarray) -> str:
    """
    Say which combination of parameters nothing tells.

    direction (P,): of relative changes that change nothing.
    """
    parts = direction / np.abs(direction).max()
    of = np.flatnonzero(np.abs(parts) > PART)
    if len(of) == 1:
        return f'{names[of[0]]} is not seen in this recording'
    together = ', '.join(names[i] for i in of[:-1]) + f' and {names[of[-1]]}'
    if len(of) == 2:
        if np.abs(np.abs(parts[of]) - 1.0).max() < 0.05:
            what = 'ratio' if parts[of[0]] * parts[of[1]] > 0.0 else 'product'
            return f'only the {what} of {together} is seen in this recording'
        return f'only a combination of {together} is seen in this recording'
    if np.abs(np.abs(parts[of]) - 1.0).max() < 0.05 and (np.sign(parts[of]) == np.sign(
            parts[of[0]])).all():
        return f'only the ratios of {together} are seen in this recording'
    return f'only combinations of {together} are seen in this recording'


def _projected(found: Found) -> tuple[np.ndarray, float]:
    """Return the slopes (.., P) by parameters, the rest taken off, and the independent share."""
    shooting = found.shooting
    misfit, own, common = shooting.arrow(found.start, found.shot)
    if own.shape[2]:
        sizes = np.sqrt(np.einsum('wml,wml->wl', own, own))
        sizes = sizes.max(axis=0) + 1e-300
        u, s, _ = np.linalg.svd(own / sizes, full_matrices=False)
        u = u * (s > 1e-8 * s[:, :1])[:, None, :]
        common = common - u @ (np.swapaxes(u, 1, 2) @ common)
    flat = common.reshape(-1, common.shape[2])
    count = len(found.start.theta)
    drifting = np.flatnonzero(shooting.model.offsets())
    if drifting.size:
        runs = len(np.unique(shooting.windows.run))
        prior = np.zeros((runs * len(drifting), flat.shape[1]))
        prior[:, count:] = np.diag(np.tile(1.0 / shooting.spreads[drifting], runs))
        flat = np.concatenate([flat, prior])
        offsets = flat[:, count:]
        used = np.abs(offsets).max(axis=0) > 0.0
        q, _ = np.linalg.qr(offsets[:, used])
        flat = flat - q @ (q.T @ flat)
    return flat[:, :count], _independent(found.shot.misfits)


def _independent(misfits: np.ndarray) -> float:
    """Return the share of misfits (J, l, W) that are independent, by their autocorrelation."""
    shares = []
    for of_sensor in np.moveaxis(misfits, 1, 0):
        there = np.isfinite(of_sensor)
        values = np.where(there, of_sensor, 0.0)
        power = float(np.sum(values**2))
        total = 1.0
        for lag in range(1, len(values)):
            if not power:
                break
            like = float(np.sum(values[lag:] * values[:-lag])) / power
            if like <= 0.05:
                break
            total += 2.0 * like
        if there.any():
            shares.append(1.0 / total)
    return float(np.mean(shares))
