"""The question put to the designer for one channel and one fault set, in scaled coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import matrix_balance

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
    def C_star(self) -> np.ndarray:
        """Outputs that the papers' designs may use: the healthy ones and v itself (l0 + 1, n)."""
        return np.vstack([self.C0, self.V])

    def decoupled(self, S: frozenset[int]) -> np.ndarray:
        """Unknown inputs together with the columns of the nonlinear terms in S."""
        return np.hstack([self.D, self.P[:, sorted(S)]])


def pose(plant: Plant, fault_set: tuple[str, ...], channel: str) -> Problem:
    """State the problem of replacing one channel of a plant when a set of sensors has failed."""
    healthy = tuple(s for s in plant.sensors if s not in fault_set)
    rows = [plant.sensors.index(s) for s in healthy]
    scale = matrix_balance(plant.A, permute=False, separate=True)[1][0]
    C0 = plant.C[rows] * scale
    V = plant.C[[plant.sensors.index(channel)]] * scale
    y0_size, v_size = _length(C0), _length(V)
    G = tuple(g * scale for g in plant.G)
    return Problem(
        plant, fault_set, channel, healthy, plant.A / scale[:, None] * scale,
        C0 / y0_size[:, None], V / v_size[:, None],
        _unit_columns(plant.D / scale[:, None]), _unit_columns(plant.P / scale[:, None]),
        tuple(g / _length(g)[:, None] for g in G), scale, y0_size, float(v_size[0]))


def _length(M: np.ndarray) -> np.ndarray:
    """Length of each row; 1 for a row of zeros."""
    length = np.linalg.norm(M, axis=1)
    return np.where(length > 0, length, 1.0)


def _unit_columns(M: np.ndarray) -> np.ndarray:
    return M / _length(M.T)
