"""
What extremes a healthy machine shows, in bounded memory, and the thresholds that follow.

A *cell* is one test of one column. Its record is the maxima of equal blocks of time. When the
store is full, neighbours are merged, so that the whole history stays in it at half the resolution.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROOM = 128  # blocks of a cell; half of them are left after a merger
FEWEST = 16  # blocks that a tail can be fitted to
FEW = ROOM // 8  # excesses; a store that was full once never has less

Floats = NDArray[np.float64]


def tail(maxima: Floats, count: NDArray[np.int64]) -> tuple[Floats, Floats, Floats]:
    """
    Return of each cell the level that a quarter of its blocks pass, their mean excess, that share.

    maxima (ROOM, ..) of which the first `count` (..) are used, the others are -inf.
    """
    ordered = np.sort(maxima, axis=0)[::-1]
    above = np.maximum(count // 4, 1)
    start = np.take_along_axis(ordered, np.minimum(above, ROOM - 1)[None], 0)[0]
    used = np.arange(ROOM).reshape((-1,) + (1,) * count.ndim) < above
    start = np.where(np.isfinite(start), start, 0.0)
    excess = np.where(used & np.isfinite(ordered), ordered - start, 0.0).sum(0) / above
    return start, excess, above / np.maximum(count, 1)


def thresholds(maxima: Floats, count: NDArray[np.int64], blocks_per_alarm: Floats) -> Floats:
    """
    Return what a cell exceeds once in `blocks_per_alarm` blocks (..); inf where too few are known.

    maxima (ROOM, ..) and 0 or more. The tail of their squares is taken for exponential above the
    upper quartile, u + beta ln(k/m n), as that of Gaussian noise is. beta is made larger by the
    standard error of the mean of k excesses. Where k is small that is not enough, so far from
    what was seen: there the level is what the next block passes as seldom as wanted over all
    records of k excesses that might have been, E exp(-level/beta) = (1 + level/(k beta))^-k.
    """
    squares = np.where(np.isfinite(maxima), np.maximum(maxima, 0.0)**2, -np.inf)
    start, excess, share = tail(squares, count)
    k = np.maximum(share * count, 1.0)
    far = np.log(np.maximum(share * blocks_per_alarm, 1.0))
    farther = np.where(k < FEW, k * np.expm1(far / k), far * (1.0 + 1.0 / np.sqrt(k)))
    level = start + excess * farther
    return np.where(count >= FEWEST, np.sqrt(level), np.inf)


def beside(maxima: Floats, count: NDArray[np.int64]) -> Floats:
    """
    Return the middle between what is reached above and below (..): what maxima are counted from.

    maxima (ROOM, 2, ..), count (2, ..): above and, with the other sign, below.
    """
    known = np.where(np.isfinite(maxima), maxima, 0.0).sum(axis=0) / np.maximum(count, 1)
    return (known[0] - known[1]) / 2


class BlockMaxima:
    """The record of many cells: (rows, columns), each at a pace of its own."""

    def __init__(self, rows: int, columns: int) -> None:
        self.maxima = np.full((ROOM, rows, columns), -np.inf)
        self.count = np.zeros((rows, columns), dtype=np.int64)
        self.merged = np.ones((rows, columns), dtype=np.int64)  # base blocks in one stored block
        self.pending = np.full((rows, columns), -np.inf)  # of the block that is not full yet
        self.waiting = np.zeros((rows, columns), dtype=np.int64)  # base blocks in it

    def add(self, rows: slice, maxima: Floats, known: NDArray[np.bool_]) -> None:
        """Add one base block to rows; maxima (rows, columns), known (columns,) or as maxima."""
        pending, waiting, count = self.pending[rows], self.waiting[rows], self.count[rows]
        if known.all():
            np.maximum(pending, maxima, out=pending)
        else:
            np.maximum(pending, maxima, out=pending, where=known)
        waiting += known
        full = np.nonzero(waiting >= self.merged[rows])
        if not full[0].size:
            return
        stored, merged = self.maxima[:, rows], self.merged[rows]
        stored[(count[full], *full)] = pending[full]
        pending[full] = -np.inf
        waiting[full] = 0
        count[full] += 1
        row, column = (index[count[full] == ROOM] for index in full)
        if row.size:
            cells = stored[:, row, column]
            stored[:ROOM // 2, row, column] = np.maximum(cells[::2], cells[1::2])
            stored[ROOM // 2:, row, column] = -np.inf
            count[row, column] = ROOM // 2
            merged[row, column] *= 2

    def usual(self, row: int) -> Floats:
        """Return the mean of the upper quarter of each column (columns,); -inf: nothing known."""
        start, excess, _ = tail(self.maxima[:, row], self.count[row])
        return np.where(self.count[row] > 0, start + excess, -np.inf)
