"""The question put to the designer for one channel and one fault set, in scaled coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import matrix_balance
from scipy.sparse.csgraph import connected_components

from vsensor_ros.plant import Plant


@dataclass(frozen=True, eq=False)
class Problem:
    """
    Estimate ``v = V x`` from ``y0 = C0 x``; both are rows of the plant's C.

    The states are balanced (``x = scale * x_here``), the rows of C0 and V and the columns of D and
    P have length one: units chosen by the user do not decide ranks (method 3.8).
    """

    plant: Plant
    fault_set: tuple[str, ...]
    channel: str
    healthy: tuple[str, ...]
    A: np.ndarray  # (n, n)
    C0: np.ndarray  # (l0, n)
    V: np.ndarray  # (1, n)
    D: np.ndarray  # (n, d)
    P: np.ndarray  # (n, q)
    G: tuple[np.ndarray, ...]  # q of (r_i, n)
    scale: np.ndarray  # (n,)
    y0_size: np.ndarray  # (l0,): y0 = y0_size * y0_here
    v_size: float  # v = v_size * v_here

    @property
    def speed(self) -> float:
        """Size of A, against which its rounding errors are measured."""
        return float(np.linalg.norm(self.A, 2))

    @property
    def C_star(self) -> np.ndarray:
        """Outputs that the papers' designs may use: the healthy ones and v itself (l0 + 1, n)."""
        return np.vstack([self.C0, self.V])

    def decoupled(self, S: frozenset[int]) -> np.ndarray:
        """Unknown inputs together with the columns of the nonlinear terms in S."""
        return np.hstack([self.D, self.P[:, sorted(S)]])


def pose(plant: Plant, fault_set: tuple[str, ...], channel: str,
         without: frozenset[str] = frozenset()) -> Problem:
    """
    State the problem of replacing one channel of a plant when a set of sensors has failed.

    ``without``: healthy sensors that are not to be read either.
    """
    healthy = tuple(s for s in plant.sensors if s not in fault_set and s not in without)
    rows = [plant.sensors.index(s) for s in healthy]
    scale = _state_scale(plant.A)
    C0 = plant.C[rows] * scale
    V = plant.C[[plant.sensors.index(channel)]] * scale
    y0_size, v_size = _length(C0), _length(V)
    G = tuple(g * scale for g in plant.G)
    return Problem(
        plant, fault_set, channel, healthy, plant.A / scale[:, None] * scale,
        C0 / y0_size[:, None], V / v_size[:, None],
        _unit_columns(plant.D / scale[:, None]), _unit_columns(plant.P / scale[:, None]),
        tuple(g / _length(g)[:, None] for g in G), scale, y0_size, float(v_size[0]))


def _state_scale(A: np.ndarray) -> np.ndarray:
    """
    Choose units of the states (n,) in which the entries of A are of like size.

    Balancing does that where states act on each other both ways. Parts that act on each other in
    one direction only are scaled against each other so that the coupling is, in the sense of
    least squares, as large as the geometric mean of the two parts.
    """
    scale = matrix_balance(A, permute=False, separate=True)[1][0]
    balanced = np.abs(A / scale[:, None] * scale)
    count, part = connected_components(balanced > 0, directed=True, connection='strong')
    if count == 1:
        return scale
    member = np.eye(count)[:, part]
    blocks = np.sqrt(member @ balanced**2 @ member.T)
    typical = np.exp(np.mean(np.log(balanced[balanced > 0]))) if balanced.any() else 1.0
    own = np.where(np.diag(blocks) > 0, np.diag(blocks), typical)
    rows, columns = np.nonzero(blocks * (1 - np.eye(count)))
    # blocks[i, j] s_j / s_i = sqrt(own_i own_j), for the logarithms of s
    equations = np.eye(count)[columns] - np.eye(count)[rows]
    wanted = 0.5 * np.log(own[rows] * own[columns]) - np.log(blocks[rows, columns])
    if not len(rows):
        return scale
    logarithms = np.linalg.lstsq(equations, wanted, rcond=None)[0]
    return scale * np.exp(np.clip(logarithms, -100, 100))[part]


def _length(M: np.ndarray) -> np.ndarray:
    """Length of each row; 1 for a row of zeros."""
    length = np.linalg.norm(M, axis=1)
    return np.where(length > 0, length, 1.0)


def _unit_columns(M: np.ndarray) -> np.ndarray:
    return M / _length(M.T)
