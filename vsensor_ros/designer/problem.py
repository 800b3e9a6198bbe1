"""The question put to the designer for one channel and one fault set, in scaled coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vsensor_ros.designer.natural_size import couplings, natural_sizes
from vsensor_ros.designer.stability import lasting
from vsensor_ros.designer.subspaces import complement, image, in_row_space, RANK_TOLERANCE
from vsensor_ros.plant import Plant


@dataclass(frozen=True, eq=False)
class Problem:
    """
    Estimate ``v = V x + Qv y0`` from ``y0``, of which ``Y y0 = C0 x`` is free of unknown inputs.

    The states are in their natural sizes (``x = scale * x_here``), the rows of C and V and the
    columns of D and P have length one: units chosen by the user do not decide ranks (method 3.8).
    Commands that
    sensors read directly are taken off beforehand. Where sensors read unknown inputs directly,
    ``y1 = C1 x + Cd1 rho`` with Cd1 of full row rank, rho is replaced by what they say of it:
    ``d x = (A - F C) x + F y0 + ..`` is then the plant, without these rows (this is what
    ``Phi D = J Cd0`` and ``Vd = Q Cd0`` come to).
    """

    plant: Plant
    fault_set: tuple[str, ...]
    channel: str
    healthy: tuple[str, ...]
    wanted: tuple[np.ndarray, np.ndarray, np.ndarray]  # v of x, u, rho: (p, n), (p, m), (p, d)
    A: np.ndarray  # (n, n)
    C0: np.ndarray  # (l, n), l <= l0
    V: np.ndarray  # (p, n)
    D: np.ndarray  # (n, d)
    P: np.ndarray  # (n, q)
    G: tuple[np.ndarray, ...]  # q of (r_i, n)
    F: np.ndarray  # (n, l0)
    Y: np.ndarray  # (l, l0)
    Qv: np.ndarray  # (p, l0)
    reads_unknown: bool  # v itself holds an unknown input that no healthy sensor reads
    scale: np.ndarray  # (n,)
    y0_size: np.ndarray  # (l0,): y0 = y0_size * y0_here
    v_size: np.ndarray  # (p,): v = v_size * v_here

    @property
    def modes(self) -> np.ndarray:
        """Eigenvalues of the plant (n,) complex."""
        return couplings(self.plant).modes

    @cached_property
    def stable(self) -> bool:
        """Whether the plant forgets every start by itself."""
        return not any(lasting(self.A_plant[np.ix_(part, part)], self.plant.sample_time)[1].any()
                       for part in couplings(self.plant).parts)

    @property
    def A_plant(self) -> np.ndarray:
        """The plant's A in the scaled states, before readings of unknown inputs are used."""
        return self.plant.A / self.scale[:, None] * self.scale

    @cached_property
    def speed(self) -> float:
        """Size of A, against which its rounding errors are measured."""
        return float(np.linalg.norm(self.A, 2))

    @property
    def still(self) -> float:
        """What A is of a state that rests: 1 where d is the shift."""
        return 0.0 if self.plant.sample_time is None else 1.0

    @property
    def C_star(self) -> np.ndarray:
        """Outputs that the papers' designs may use: the healthy ones and v itself (l + 1, n)."""
        return np.vstack([self.C0, self.V])

    def size_of(self, sensors: list[int]) -> np.ndarray:
        """Return the natural sizes of readings by the sensors' indices, in their units."""
        return _length(self.plant.C[sensors] * self.scale)

    def decoupled(self, S: frozenset[int]) -> np.ndarray:
        """Unknown inputs together with the columns of the nonlinear terms in S."""
        return np.hstack([self.D, self.P[:, sorted(S)]])


def pose(plant: Plant, fault_set: tuple[str, ...], channel: str,
         wanted: np.ndarray | None = None) -> Problem:
    """
    State the problem of replacing one channel of a plant when a set of sensors has failed.

    ``wanted`` (p, n): rows of a functional of the states, instead of the sensor ``channel``.
    """
    healthy = tuple(s for s in plant.sensors if s not in fault_set)
    rows = [plant.sensors.index(s) for s in healthy]
    if wanted is None:
        own = [plant.sensors.index(channel)]
        target = plant.C[own], plant.Cu[own], plant.Cd[own]
    else:
        target = (wanted, np.zeros((len(wanted), len(plant.inputs))),
                  np.zeros((len(wanted), len(plant.disturbances))))
    failed = [plant.sensors.index(s) for s in fault_set]
    scale = natural_sizes(plant, rows, failed, target[0])
    A, C = plant.A / scale[:, None] * scale, plant.C[rows] * scale
    V, Vd = target[0] * scale, target[2]
    y0_size, v_size = _length(C), _length(V)
    C, V = C / y0_size[:, None], V / v_size[:, None]
    D, Cd, Vd = plant.D / scale[:, None], plant.Cd[rows] / y0_size[:, None], Vd / v_size[:, None]
    size = np.where(D.any(axis=0), _length(D.T), _length(np.vstack([Cd, Vd]).T))
    D, Cd, Vd = D / size, Cd / size, Vd / size

    known = image(Cd.T)  # (d, r): combinations of rho that healthy sensors read
    Y = complement(image(Cd))
    read = np.linalg.pinv(Cd, rcond=RANK_TOLERANCE)
    F, Qv = D @ read, Vd @ read
    return Problem(
        plant, fault_set, channel, healthy, target, A - F @ C, Y @ C, V - Qv @ C,
        _unit_columns(D @ complement(known).T, RANK_TOLERANCE),
        _unit_columns(plant.P / scale[:, None]),
        tuple(g * scale / _length(g * scale)[:, None] for g in plant.G), F, Y, Qv,
        not in_row_space(Cd, Vd), scale, y0_size, v_size)


def _length(M: np.ndarray) -> np.ndarray:
    """Length of each row; 1 for a row of zeros."""
    length = np.linalg.norm(M, axis=1)
    return np.where(length > 0, length, 1.0)


def _unit_columns(M: np.ndarray, rounding: float = 0.0) -> np.ndarray:
    """Scale columns to length one; those of no more than ``rounding`` are zero."""
    M = np.where(np.linalg.norm(M, axis=0) > rounding, M, 0.0)
    return M / _length(M.T)
