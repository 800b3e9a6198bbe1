"""
Steps: how far readings jump off the smooth course that they were on.

What a sensor measures moves smoothly; a fault need not. So a step tells *who*, at the moment when
a residual tells *that*. A cubic is fitted to 32 samples, and with it a step before the last eight.
What of motion the cubic does not follow is learnt, as all else is, from the healthy machine.
"""

from __future__ import annotations

import numpy as np

from vsensor_ros.isolator.block_maxima import BlockMaxima, Floats, thresholds

BEFORE, AFTER, DEGREE = 24, 8, 3  # samples, samples, of the polynomial
STRIDE = 4  # places, of which one is learnt from: a step stands out at its own place only
RARE = STRIDE * 86400.0  # s in which a healthy channel seems to step once, at the places learnt


def _fit() -> Floats:
    """Return what the samples count for in the size of the step (BEFORE + AFTER,)."""
    time = np.arange(-BEFORE, AFTER) / BEFORE
    columns = [*(time**k for k in range(DEGREE + 1)), time >= 0.0]
    return np.linalg.pinv(np.stack(columns, axis=1).astype(float))[-1]


WEIGHTS = _fit()


def largest_step(samples: Floats, stride: int = 1) -> Floats:
    """
    Return the largest step of each channel (c,) in its samples (k, c); NaN: not known.

    stride: places from one that is looked at to the next.
    """
    windows = np.lib.stride_tricks.sliding_window_view(samples, len(WEIGHTS), axis=0)
    return np.fmax.reduce(np.abs(windows[::-stride] @ WEIGHTS))


def least_step(record: BlockMaxima, block: float, enough: float) -> Floats:
    """
    Return above what a step is none of a healthy channel (c,); inf: not known yet.

    block: s of a base block of the record. enough: s that must be known.
    """
    maxima, count, span = record.maxima[:, 0], record.count[0], block * record.merged[0]
    return np.where(count * span >= enough, thresholds(maxima, count, RARE / span), np.inf)
