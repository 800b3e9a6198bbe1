"""
What can be known of a plant: its quotient by what unknown inputs and hidden modes occupy.

In it the problem is a functional observer without unknown inputs, which the search works on: the
rows Phi of any virtual sensor are combinations of the rows of the quotient (method 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.subspaces import (
    complement,
    Gap,
    in_row_space,
    left_kernel,
    RANK_TOLERANCE,
    solve_left,
)


@dataclass(frozen=True, eq=False)
class Quotient:
    """
    ``xi = Phi x`` with ``d xi = A xi + J y0 + ..``, ``R y0 = E xi``, ``v = v xi + q y0``.

    r states, c combinations of readings that belong to it, l0 healthy sensors, p rows of v.
    A virtual sensor is ``W A = N W + j E``, ``v = Cv W + g E``, rows W (k, r).
    """

    Phi: np.ndarray  # (r, n), orthonormal rows
    A: np.ndarray  # (r, r)
    J: np.ndarray  # (r, l0)
    E: np.ndarray  # (c, r)
    R: np.ndarray  # (c, l0)
    v: np.ndarray  # (p, r)
    q: np.ndarray  # (p, l0)
    still: float = 0.0  # what A is of a state that rests: 1 where d is the shift

    @cached_property
    def spectrum(self) -> np.ndarray:
        """Return the eigenvalues of A."""
        return np.linalg.eigvals(self.A).astype(complex)

    @cached_property
    def speed(self) -> float:
        """Return the size of A."""
        return float(np.linalg.norm(self.A, 2)) if len(self.A) else 0.0

    @cached_property
    def motion(self) -> float:
        """Return the size of A less what rests: of what happens in a step."""
        return float(np.linalg.norm(self.A - self.still * np.eye(len(self.A)), 2)) \
            if len(self.A) else 0.0

    @property
    def order(self) -> int:
        """Return the number of states."""
        return len(self.A)


def quotient(problem: Problem, Phi: np.ndarray, gap: Gap | None = None) -> Quotient:
    """
    Reduce a problem to orthonormal rows Phi (r, n) that satisfy (E1) and hold v.

    ``Phi A = A_ Phi + J_ C0`` is solved with as little of J_ as there must be.
    """
    C0 = problem.C0
    hidden = complement(Phi.T).T  # columns of ker Phi
    seen = _seen(C0, hidden)
    R = left_kernel(seen, size=1.0, gap=gap) if hidden.shape[1] else np.eye(len(C0))

    def split(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        J = solve_left(seen, rows @ hidden)
        return (rows - J @ C0) @ Phi.T, J

    A, J = split(Phi @ problem.A)
    v, q = split(problem.V)
    E = R @ C0 @ Phi.T  # of unit rows: what is less than rounding is nothing
    E[np.linalg.norm(E, axis=1) < RANK_TOLERANCE] = 0.0
    return Quotient(Phi, A, J @ problem.Y + Phi @ problem.F, E, R @ problem.Y,
                    v, q @ problem.Y + problem.Qv, problem.still)


def argument(problem: Problem, Phi: np.ndarray, g: np.ndarray) -> np.ndarray | None:
    """
    Return the argument rows g (s, n) of a term as rows (s, r) of the quotient, less readings.

    None where the quotient and the readings do not hold them.
    """
    if not in_row_space(np.vstack([Phi, problem.C0]), g):
        return None
    hidden = complement(Phi.T).T
    return (g - solve_left(_seen(problem.C0, hidden), g @ hidden) @ problem.C0) @ Phi.T


def _seen(C0: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Return what readings of unit rows say of orthonormal columns: rounding is nothing."""
    seen = C0 @ hidden
    return seen if np.linalg.norm(seen) > RANK_TOLERANCE else np.zeros_like(seen)
