"""For how long channels have repeated their value, or said nothing, sample by sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.isolator.block_maxima import Floats

Counts = NDArray[np.int64]


class Runs(NamedTuple):
    """
    How channels were after each sample (.., c).

    last: reading that was there, NaN: none yet. run: how often it has been repeated since. gap:
    samples without a reading. begun: what was estimated when the reading was new.
    """

    last: Floats
    run: Counts
    gap: Counts
    begun: Floats

    @classmethod
    def none(cls, count: int) -> Runs:
        """Return how channels (count,) are before their first sample."""
        unknown, zero = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
        return cls(unknown, zero, zero, unknown)

    def of(self, which: NDArray[np.intp]) -> Runs:
        """Return how some of the channels were."""
        return Runs(self.last[..., which], self.run[..., which], self.gap[..., which],
                    self.begun[..., which])


def follow(before: Runs, readings: Floats, estimates: Floats) -> Runs:
    """Return (1 + n, c), the first row of which is before; readings (n, c), NaN: none came."""
    place = np.arange(len(readings) + 1)[:, None]
    last = np.vstack([before.last, readings])
    missing = np.isnan(last)
    missing[0] = False
    if np.count_nonzero(missing):
        here = np.maximum.accumulate(np.where(missing, 0, place))  # the reading that holds
        last = np.take_along_axis(last, here, 0)
        gap = place - here + (here == 0) * before.gap
    else:
        gap = np.zeros(last.shape, dtype=np.int64)
        gap[0] = before.gap
    same = readings == last[:-1]
    total = np.vstack([before.run, same]).cumsum(axis=0)
    changed = np.zeros(last.shape, dtype=bool)
    np.logical_or(same, missing[1:], out=changed[1:])
    np.logical_not(changed[1:], out=changed[1:])
    run = total - np.maximum.accumulate(total * changed)
    new = np.maximum.accumulate(place * (run == 0))
    begun = np.take_along_axis(np.vstack([before.begun, estimates]), new, 0)
    return Runs(last, run, gap, begun)
