"""
Which orders one functional can be had at, and with which characteristic polynomials.

The method (3.4) asks for ``sum_j p_j v A^j`` in the span of ``E, E A, .., E A^k``. Powers of A
lose all digits, so both sides are held in orthonormal bases (Arnoldi and staircase), and the
polynomials in the basis that belongs to them: p is then the characteristic polynomial of a
Hessenberg matrix with its last row changed. Ranks become sines of angles.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vsensor_ros.designer.quotient import Quotient
from vsensor_ros.designer.subspaces import (
    Gap,
    image,
    in_row_space,
    kernel,
    new_directions,
    RANK_TOLERANCE,
    summed,
)

CLEARLY = 1e-4  # so far outside, a vector is not looked at more closely


@dataclass(frozen=True, eq=False)
class Family:
    """
    All characteristic polynomials of virtual sensors of order k, as matrices ``M + e_k theta F``.

    Each polynomial is the characteristic one of such a matrix. M (k, k); F (f, k) with orthonormal
    rows, f = k when the spectrum is free; e_k is the last unit column and theta (f,) any row.
    """

    M: np.ndarray
    F: np.ndarray
    speed: float  # size of the plant's A, against which rounding is measured
    still: float = 0.0  # the root of what rests: 1 where d is the shift

    @property
    def free(self) -> bool:
        """Whether any spectrum can be had."""
        return len(self.F) == len(self.M)

    @cached_property
    def size(self) -> float:
        """Return the size of M less what rests."""
        return float(np.linalg.norm(self.M - self.still * np.eye(len(self.M)), 2))

    def member(self, theta: np.ndarray) -> np.ndarray:
        """Return the matrix (k, k) whose eigenvalues are the roots of one polynomial."""
        N = self.M.copy()
        N[-1] += theta @ self.F
        return N

    def roots(self, theta: np.ndarray) -> np.ndarray:
        """Return the roots (k,) of one polynomial."""
        return np.linalg.eigvals(self.member(theta)).astype(complex)


def families(known: Quotient, freedom: Sequence[int | None] | None = None,
             ) -> Iterator[tuple[int, Family | None, Gap]]:
    """
    Yield for k = 1, 2, .. the polynomials of order k of the one row ``known.v``, or None.

    With them the gap of the rank decisions; ends at the order of the quotient. ``v`` must not be
    a combination of the rows of E (that is order 0). ``freedom``: how many coefficients are free
    at order 0, 1, .. (None: no polynomial), where exact arithmetic knows. Source: method 3.4.
    """
    speed = max(known.speed, float(np.finfo(float).tiny))
    A = known.A / speed
    gap = Gap()
    seen = fresh = image(known.E.T, size=1.0, gap=gap)  # columns of E', E' and (E A)', ..
    krylov = [start_row(known)[0]]
    both = np.column_stack([seen, krylov[0]])  # of what was seen and of v, v A, ..
    H = np.zeros((1, 0))
    found = False
    for k in range(1, known.order + 1):
        fresh = new_directions(A.T, fresh, seen, gap)
        seen = np.hstack([seen, fresh])
        H = _arnoldi_step(A, krylov, H)
        here = Gap()
        here.join(gap)
        if not found and (freedom is None or k >= len(freedom) or freedom[k] is None):
            both = _extended(both, fresh)
            rest = _off(both, krylov[-1][:, None])
            far = float(np.linalg.norm(rest))
            if far > CLEARLY or (freedom is not None and k < len(freedom)):
                both = _extended(both, krylov[-1][:, None])
                here.nonzero = min(here.nonzero, max(far, float(np.finfo(float).tiny)))
                gap.join(here)
                yield k, None, here
                continue
        Q = np.array(krylov)
        outside = Q - (Q @ seen) @ seen.T
        null = kernel(outside.T, size=1.0, gap=here).T  # (s, k + 1): rows of coefficients
        if freedom is not None and k < len(freedom) and freedom[k] is not None:
            null = np.linalg.svd(outside.T)[2][k - int(freedom[k] or 0):]
        leading = null[:, -1] if len(null) else np.zeros(0)
        if np.linalg.norm(leading) < RANK_TOLERANCE:
            if not found:  # outside after all: the next is to be held against it, too
                both = _extended(both, krylov[-1][:, None])
            yield k, None, here
            continue
        found = True
        base = leading @ null / (leading @ leading)
        free = kernel(leading[None, :]).T @ null
        M = H[:k].T.copy()
        M[-1] -= H[k, k - 1] * base[:k]
        F = image(free[:, :k].T).T
        yield k, Family(speed * M, F, speed, known.still), here


def first_orders(known: Quotient,
                 freedom: Sequence[Sequence[int | None]] | None = None) -> list[int]:
    """
    Return for each functional the first order at which it has a characteristic polynomial.

    ``freedom``: of each, as of ``families``.
    """
    if freedom is not None:
        return [next(k for k, free in enumerate(row) if free is not None) for row in freedom]

    def first(one: Quotient) -> int:
        if in_row_space(one.E, one.v):
            return 0
        return next((k for k, family, _ in families(one) if family is not None), one.order)

    return [first(replace(known, v=v[None, :])) for v in known.v]


def sure_order(freedom: Sequence[int | None]) -> int:
    """Return the first order where all is free but the fixed modes, as of ``families``."""
    fixed = len(freedom) - 1 - (freedom[-1] or 0)
    return next(order for order, free in enumerate(freedom)
                if free is not None and free == order - fixed)


def _off(basis: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return what orthonormal columns leave of the columns of X."""
    X = X - basis @ (basis.T @ X)
    return np.asarray(X - basis @ (basis.T @ X))


def _extended(basis: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return orthonormal columns that span those of a basis and of X."""
    return np.hstack([basis, image(_off(basis, X), size=1.0)])


def start_row(known: Quotient) -> tuple[np.ndarray, float]:
    """Return what the readings leave of v, (r,) of length one, and its length."""
    E = image(known.E.T, size=1.0)
    row = known.v[0] - E @ (E.T @ known.v[0])
    size = float(np.linalg.norm(row))
    return row / max(size, np.finfo(float).tiny), size


def _arnoldi_step(A: np.ndarray, krylov: list[np.ndarray], H: np.ndarray) -> np.ndarray:
    """Append the next row of the Krylov space of krylov[0] to it, and a column to H."""
    k = len(krylov)
    grown = np.zeros((k + 1, k))
    grown[:k, :k - 1] = H
    last = krylov[-1]
    moved = last @ A
    basis = np.array(krylov)
    for _ in range(2):
        along = basis @ moved
        grown[:k, k - 1] += along
        moved = moved - along @ basis
    length = np.linalg.norm(moved)
    if length <= RANK_TOLERANCE * summed(A.T, last[:, None])[0]:
        # the space is invariant: a polynomial of degree k takes v to zero, and so do s p, s^2 p
        grown[k, k - 1] = 1.0
        krylov.append(np.zeros_like(last))
    else:
        grown[k, k - 1] = length
        krylov.append(moved / length)
    return grown
