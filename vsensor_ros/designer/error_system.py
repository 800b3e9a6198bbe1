"""
The error of a virtual sensor as a linear system with slopes that are known within bounds.

With e = Phi x - z, n the error of the readings and s the difference quotients of the nonlinear
terms, ``d e = (N + sum_j s_j p_j g_j) e - (J + sum_j s_j p_j h_j) n``, ``v - vhat = Cv e - Q n``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from vsensor_ros.designer.joint_slopes import JointSlopes

MOST_CORNERS = 8  # slopes whose 2**8 corners are all put in; beyond, the S-procedure


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes in centre + [-radius, radius], or centre + [0, inf); the centre lies in N and J."""

    p: np.ndarray  # (k, c)
    g: np.ndarray  # (c, k)
    h: np.ndarray  # (c, l0)
    radius: np.ndarray  # (c,)

    @property
    def feeding(self) -> Slopes:
        """The slopes that act on the error itself."""
        on = self.g.any(axis=1)
        return Slopes(self.p[:, on], self.g[on], self.h[on], self.radius[on])


@dataclass(frozen=True, eq=False)
class ErrorSystem:
    """The error system with its slopes: bounded, rising without bound, and without any bound."""

    N: np.ndarray
    J: np.ndarray
    Cv: np.ndarray
    Q: np.ndarray
    bounded: Slopes
    rising: Slopes
    loose: Slopes
    sample_time: float | None
    joint: JointSlopes | None = None  # which of the bounded slopes come together; None: all

    @property
    def cornered(self) -> bool:
        """Whether ``corners`` are few enough for all of them to be tried."""
        return self.joint is not None or len(self.bounded.feeding.radius) <= MOST_CORNERS

    def corners(self) -> Iterator[np.ndarray]:
        """
        Yield N at all corners of the bounded slopes, the rising ones at their lower end.

        Where it is known which slopes come together: N at points of their box.
        """
        if self.joint is not None:
            yield from self.joint.matrices(self.joint.at(self.joint.points()))
            return
        fed = self.bounded.feeding
        for signs in product((-1.0, 1.0), repeat=len(fed.radius)):
            yield self.N + fed.p * (np.array(signs) * fed.radius) @ fed.g


def no_slopes(error: ErrorSystem) -> Slopes:
    """Return slopes of no term, of the shape of this error system."""
    k, l0 = len(error.N), error.J.shape[1]
    return Slopes(np.zeros((k, 0)), np.zeros((0, k)), np.zeros((0, l0)), np.zeros(0))


def decay_rate(N: np.ndarray, sample_time: float | None) -> float:
    """Return the rate [1/s] of the slowest eigenvalue, negative when it grows."""
    values = np.linalg.eigvals(N)
    if sample_time is None:
        return float(-values.real.max())
    return float(-np.log(max(np.abs(values).max(), 1e-12)) / sample_time)


def contraction(rate: float, sample_time: float | None) -> float:
    """Return the gain of |e| over what is pushed in per second, or per step."""
    return 1.0 / rate if sample_time is None else float(-1.0 / np.expm1(-rate * sample_time))
