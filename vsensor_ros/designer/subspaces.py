"""
Subspaces and the rank decisions behind them.

A subspace of states is held as orthonormal columns, a space of functionals as orthonormal rows.
The data are expected in the scaled coordinates of ``problem.py``, where sizes mean something.
Every decision is relative to RANK_TOLERANCE, and how clear it was is kept in a Gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RANK_TOLERANCE = 1e-9  # relative to the size of the data
DOUBT = 1e3  # a singular value within this factor of the tolerance is ambiguous (method 3.8)
ROUNDING = 1e-12  # of the largest: what arithmetic makes of a zero


@dataclass
class Gap:
    """How clear a row of rank decisions was: the relative singular values next to the limit."""

    zero: float = 0.0  # the largest that was taken for zero
    nonzero: float = np.inf  # the smallest that was not

    def note(self, sigma: np.ndarray) -> int:
        """Decide the rank of relative singular values, and keep those next to the limit."""
        kept = sigma > RANK_TOLERANCE
        self.zero = max(self.zero, float(sigma[~kept].max(initial=0.0)))
        self.nonzero = min(self.nonzero, float(sigma[kept].min(initial=np.inf)))
        return int(kept.sum())

    def join(self, other: Gap) -> None:
        """Take over the decisions of another row."""
        self.zero, self.nonzero = max(self.zero, other.zero), min(self.nonzero, other.nonzero)

    @property
    def doubtful(self) -> bool:
        """Whether a decision was so close that a little noise in the data would turn it."""
        return self.zero > RANK_TOLERANCE / DOUBT or self.nonzero < RANK_TOLERANCE * DOUBT


def _decompose(M: np.ndarray, size: float, gap: Gap | None,
               ) -> tuple[np.ndarray, int, np.ndarray]:
    """Return left singular vectors, rank and right singular vectors (as rows)."""
    U, sigma, Vt = np.linalg.svd(M, full_matrices=True)
    largest = max(float(sigma[0]), size, np.finfo(float).tiny) if sigma.size else 1.0
    return U, (gap or Gap()).note(sigma / largest), Vt


def rank(M: np.ndarray, gap: Gap | None = None) -> int:
    """Count the singular values above the tolerance."""
    return 0 if 0 in M.shape else _decompose(M, 0.0, gap)[1]


def image(M: np.ndarray, size: float = 0.0, gap: Gap | None = None) -> np.ndarray:
    """Orthonormal columns that span the columns of M, where |M| below ``size`` is rounding."""
    if 0 in M.shape:
        return np.zeros((M.shape[0], 0))
    U, r, _ = _decompose(M, size, gap)
    return U[:, :r]


def kernel(M: np.ndarray, size: float = 0.0, gap: Gap | None = None) -> np.ndarray:
    """Return orthonormal columns x with M x = 0, where |M| below ``size`` is rounding."""
    if 0 in M.shape:
        return np.eye(M.shape[1])
    _, r, Vt = _decompose(M, size, gap)
    return Vt[r:].conj().T


def left_kernel(M: np.ndarray, size: float = 0.0, gap: Gap | None = None) -> np.ndarray:
    """Orthonormal rows w with w M = 0."""
    return kernel(M.conj().T, size, gap).conj().T


def complement(T: np.ndarray) -> np.ndarray:
    """Orthonormal rows that complete orthonormal columns T to a basis; unit rows where they do."""
    n, t = T.shape
    if t == 0:
        return np.eye(n)
    # columns of the identity least covered by T first: structure of the plant stays visible
    rows = np.linalg.svd(T, full_matrices=True)[0][:, t:].T
    used = np.linalg.norm(rows, axis=0)
    whole = np.flatnonzero(used > 1.0 - 1e-14)
    if len(whole) == n - t:
        return np.eye(n)[whole]
    return rows


def solve_left(M: np.ndarray, R: np.ndarray, size: float = 0.0) -> np.ndarray:
    """Return the least X with X M = R by least squares; |M| below ``size`` is rounding."""
    none = np.zeros((R.shape[0], M.shape[0]))
    if 0 in M.shape or 0 in R.shape:
        return none
    if not size:
        return np.linalg.lstsq(M.T, R.T, rcond=RANK_TOLERANCE)[0].T
    largest = float(np.linalg.norm(M, 2))
    if largest <= RANK_TOLERANCE * size:
        return none
    return np.linalg.lstsq(M.T, R.T, rcond=RANK_TOLERANCE * max(1.0, size / largest))[0].T


def in_row_space(M: np.ndarray, R: np.ndarray, gap: Gap | None = None) -> bool:
    """Tell whether every row of R is a combination of rows of M."""
    size = np.linalg.norm(R, axis=1)
    if not size.any():
        return True
    residual = np.linalg.norm(R - solve_left(M, R) @ M, axis=1)[size > 0] / size[size > 0]
    # the rounding of a solution is a little larger than that of a singular value
    return (gap or Gap()).note(residual / 1e2) == 0


def conditioned_invariant(A: np.ndarray, C0: np.ndarray, D: np.ndarray,
                          gap: Gap | None = None) -> np.ndarray:
    """
    Return T*, the least subspace T that holds D and has A (T intersected with ker C0) inside T.

    A (n, n), C0 (l0, n), D (n, d); orthonormal columns (n, t). Source: method 3.1.
    """
    gap = gap or Gap()
    A = _of_size_one(A)
    T = image(D, gap=gap)
    C0 = image(C0.T, gap=gap).T
    seen = np.zeros((len(A), 0))
    while True:
        unseen = T @ kernel(C0 @ T, size=1.0, gap=gap)
        fresh = image(unseen - seen @ (seen.T @ unseen), size=1.0)
        moved = new_directions(A, fresh, T, gap)
        if moved.shape[1] == 0:
            return T
        T, seen = np.hstack([T, moved]), unseen


def new_directions(A: np.ndarray, X: np.ndarray, T: np.ndarray,
                   gap: Gap | None = None) -> np.ndarray:
    """
    Return orthonormal columns that A X adds to the orthonormal columns T.

    Each column of A X is measured against what it was summed from, so that a slow state of a
    stiff plant counts as much as a fast one; but not against rounding. A is of size one.
    """
    if 0 in X.shape or T.shape[1] == len(T):
        return np.zeros((len(T), 0))
    moved = A @ X / summed(A, X)
    for _ in range(2):  # twice is enough for orthogonality to working precision
        moved = moved - T @ (T.T @ moved)
    moved = image(moved, size=1.0, gap=gap)
    moved = moved - T @ (T.T @ moved)
    return np.linalg.qr(moved)[0]


def summed(A: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return the size (m,) that columns of A X are measured against, A of size one."""
    return np.maximum(np.linalg.norm(np.abs(A) @ np.abs(X), axis=0), ROUNDING / RANK_TOLERANCE)


def unobservable(A: np.ndarray, C: np.ndarray, gap: Gap | None = None) -> np.ndarray:
    """Orthonormal columns of the largest A-invariant subspace inside ker C."""
    A = _of_size_one(A)
    seen = fresh = image(C.T, size=1.0, gap=gap)
    while fresh.shape[1] and seen.shape[1] < len(A):
        fresh = new_directions(A.T, fresh, seen, gap)
        seen = np.hstack([seen, fresh])
    return complement(seen).T


def _of_size_one(A: np.ndarray) -> np.ndarray:
    return A / max(np.linalg.norm(A, 2) if A.size else 0.0, np.finfo(float).tiny)


def measured_part(Phi: np.ndarray, C0: np.ndarray) -> np.ndarray:
    """Rows C_* with C_* Phi inside the row space of C0: what a residual can show of z."""
    return left_kernel(np.vstack([Phi, -C0]))[:, :Phi.shape[0]]
