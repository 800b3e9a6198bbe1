"""
The slopes of all terms that feed an error, bounded together over one box of their arguments.

Terms that share an argument cannot have each any slope of its own. For two points of the box the
error moves by ``N0 + sum_j s_j p_j g_j`` with means s of slopes along the line between them. The
line crosses cells of the box; so s is a mean of slopes that these cells allow, and one quadratic
form that falls for the slopes of each cell falls for their means (the method, 3.5). Cells are
bounded by interval arithmetic, and halved where their bounds are too coarse to decide.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular

from vsensor_ros.designer.slopes import slopes_in
from vsensor_ros.functions.nonlinearity import NonlinearTerm

MOST_CELLS = 10000
CLOSE = 0.1  # of the growth at the middle of cells: so near is a bound close enough
MOST_SIDES = 6
GRID = 3  # points along each side where a search looks, or only the corners and the middle
MOST_ENTRIES = 2500  # of the matrices at all points together: an inequality takes no more


@dataclass(frozen=True, eq=False)
class SharedTerm:
    """A term of a box: which sides its arguments and inputs run along, and how often."""

    term: NonlinearTerm
    names: tuple[str, ...]  # arguments w1.., then inputs that it holds
    sides: tuple[int, ...]  # of the box, one for each name
    ratios: tuple[float, ...]  # what is named is this times the side
    slopes: tuple[tuple[int, int], ...]  # (argument, which slope of the system)


@dataclass(frozen=True, eq=False)
class JointSlopes:
    """``N0 + sum_j s_j p_j g_j`` with all slopes s that a box of d sides allows together."""

    N0: np.ndarray  # (k, k)
    p: np.ndarray  # (k, c)
    g: np.ndarray  # (c, k)
    box: np.ndarray  # (d, 2), finite
    terms: tuple[SharedTerm, ...]

    def at(self, points: np.ndarray) -> np.ndarray:
        """Return the slopes (m, c) at points (m, d) of the box."""
        low, high = self.within(np.stack([points, points], axis=2))
        return 0.5 * (low + high)

    def matrices(self, slopes: np.ndarray) -> np.ndarray:
        """Return (m, k, k) for slopes (m, c)."""
        return self.N0 + np.einsum('kc,mc,cl->mkl', self.p, slopes, self.g)

    def points(self) -> np.ndarray:
        """Return points (m, d) where a search looks: a grid, or corners and the middle."""
        if GRID**len(self.box) * self.N0.size <= MOST_ENTRIES:
            return np.array(list(product(*np.linspace(self.box[:, 0], self.box[:, 1], GRID).T)))
        return np.array([self.box.mean(axis=1), *product(*self.box)])

    def within(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bound the slopes, low and high (m, c), in cells (m, d, 2)."""
        low, high = np.zeros((2, len(cells), len(self.g)))
        for shared in self.terms:
            text, addend = shared.term.text, shared.term.slope
            arguments = shared.names[:len(addend)]
            ends = np.sort(cells[:, list(shared.sides)] * np.array(shared.ratios)[:, None])
            bounds = np.array([slopes_in(text, shared.names, tuple(cell), arguments)
                               for cell in ends.reshape(len(cells), -1).tolist()])
            for argument, of in shared.slopes:
                low[:, of], high[:, of] = bounds[:, argument].T - addend[argument]
        return low, high

    def moduli(self) -> np.ndarray:
        """Return a matrix (k, k) that no matrix of the box exceeds in any entry."""
        low, high = self.within(self.box[None])
        return np.abs(self.N0) + np.abs(self.p) * np.maximum(-low, high) @ np.abs(self.g)

    def growth(self, L: np.ndarray, sample_time: float | None) -> float:
        """
        Bound how |L' e| grows: its logarithmic norm, discrete its norm; inf: it may not fall.

        Rounding is left to the caller.
        """
        limit = 0.0 if sample_time is None else 1.0

        def turned(M: np.ndarray) -> np.ndarray:  # M L'^-1
            return solve_triangular(L, M.T, lower=True).T

        N0, p, g = turned(L.T @ self.N0), L.T @ self.p, turned(self.g)
        reach = np.linalg.norm(p, axis=0) * np.linalg.norm(g, axis=1)
        if sample_time is None:
            reach = 0.5 * (reach + np.abs(np.sum(p.T * g, axis=1)))

        def judged(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # middle, bound (m,)
            low, high = self.within(cells)
            M = N0 + np.einsum('kc,mc,cl->mkl', p, 0.5 * (low + high), g)
            middle = (np.linalg.eigvalsh(0.5 * (M + M.swapaxes(1, 2)))[:, -1]
                      if sample_time is None else np.linalg.norm(M, 2, axis=(1, 2)))
            return middle, middle + 0.5 * (high - low) @ reach

        # how much of the whole bound is due to each side
        flat = np.tile(self.box, (len(self.box), 1, 1))
        for side, cell in enumerate(flat):
            cell[side] = cell[side].mean()
        whole, without = (0.5 * (high - low) @ reach
                          for low, high in (self.within(self.box[None]), self.within(flat)))
        weight = np.maximum(whole - without, 1e-9 * whole) / np.ptp(self.box, axis=1)
        cells, done, worst, highest = self.box[None], 0, -np.inf, -np.inf
        while len(cells):
            middle, bound = judged(cells)
            highest = max(highest, float(middle.max()))
            if not highest < limit:
                return np.inf
            done += len(cells)
            allowed = highest + CLOSE * (limit - highest)
            coarse = bound > allowed
            if done + 2 * np.count_nonzero(coarse) > MOST_CELLS:
                allowed, coarse = np.inf, np.zeros(len(cells), dtype=bool)
            worst = max(worst, float(bound[~coarse].max(initial=-np.inf)))
            cells = _halved(cells[coarse], weight)
        return worst if worst < limit else np.inf


def _halved(cells: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Halve each cell across the side that matters most."""
    rows, sides = np.arange(len(cells)), np.argmax(np.ptp(cells, axis=2) * weight, axis=1)
    low, high = cells.copy(), cells.copy()
    low[rows, sides, 1] = high[rows, sides, 0] = cells[rows, sides].mean(axis=1)
    return np.concatenate([low, high])


def sides_of(rows: Iterable[np.ndarray]) -> tuple[list[np.ndarray], list[tuple[int, float]]]:
    """Return the directions of rows, multiples of one as one; of each row which, and how often."""
    found: list[np.ndarray] = []
    places: list[tuple[int, float]] = []
    for row in rows:
        first = int(np.flatnonzero(row)[0])
        for side, known in enumerate(found):
            if known[first] and np.allclose(row, row[first] / known[first] * known, 1e-12, 0.0):
                places.append((side, float(row[first] / known[first])))
                break
        else:
            found.append(row / row[first])
            places.append((len(found) - 1, float(row[first])))
    return found, places
