"""The shape of a fault in a residual: since when, and whether it jumped or grows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vsensor_ros.isolator.block_maxima import Floats

BIAS, DRIFT = 'bias', 'drift'
FEWEST = 3  # samples after the onset
CLOSE = 1.05  # by how much a ramp must explain more than a step


class Shape(NamedTuple):
    """What a fault looks like at the end of a residual."""

    kind: str  # bias or drift
    samples: int  # since its onset
    size: float  # now, unit of the residual


def shape_of(residual: Floats) -> Shape:
    """
    Fit a step and a ramp, each with the best onset, to a residual (k,) that was 0 before.

    The one that explains more of the sum of squares is it. Raises ValueError below FEWEST samples.
    """
    if len(residual) < FEWEST:
        raise ValueError(f'{len(residual)} samples have no shape')
    backward = residual[::-1]  # item i is i samples ago
    length = np.arange(1.0, len(residual) + 1.0)  # samples since the onset
    sums = np.cumsum(backward)
    step = sums**2 / length
    # sum over i < n of (n - i) r_i, as the sums of sums
    moments = np.cumsum(sums)
    squares = length * (length + 1.0) * (2.0 * length + 1.0) / 6.0
    ramp = moments**2 / squares
    since = FEWEST - 1 + int(np.argmax(step[FEWEST - 1:]))
    grown = FEWEST - 1 + int(np.argmax(ramp[FEWEST - 1:]))
    if ramp[grown] > CLOSE * step[since]:
        return Shape(DRIFT, grown + 1, float(moments[grown] / squares[grown] * (grown + 1)))
    return Shape(BIAS, since + 1, float(sums[since] / (since + 1)))
