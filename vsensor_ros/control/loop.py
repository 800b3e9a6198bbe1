"""A controller and the machine before it, closed: poles, sensitivity, noise of the commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov, solve_discrete_lyapunov

from vsensor_ros.control.sampling import Steps
from vsensor_ros.designer.gain import peak

WELL_POSED = 1e-9  # of what commands do to themselves within the same instant
STILL = 1e-8  # of the fastest rate: a pole so close to the limit of stability is on it


class IllPosed(Exception):
    """A command that depends on itself in the same instant, without a solution."""


@dataclass(frozen=True, eq=False)
class Law:
    """A controller in the order of the plant's m inputs and l sensors."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    sample_time: float | None


@dataclass(frozen=True, eq=False)
class Loop:
    """``d s = A s + B w + J n, u = U s + V w + R n``: w is added to the commands on their way."""

    A: np.ndarray
    B: np.ndarray
    J: np.ndarray
    U: np.ndarray
    V: np.ndarray
    R: np.ndarray
    W: np.ndarray  # covariance of what else moves s
    sample_time: float | None

    @property
    def poles(self) -> np.ndarray:
        """Eigenvalues, of s or of z."""
        return np.asarray(np.linalg.eigvals(self.A)) if len(self.A) else np.zeros(0)

    def sensitivity(self, i: int) -> tuple[float, float]:
        """
        Return the peak of the sensitivity at the command i, and its frequency [rad/s].

        The loop is cut there, after where virtual sensors hear it; the others stay closed. It must
        be stable.
        """
        return peak(self.A, self.B[:, [i]], self.U[[i]], 1.0 + self.V[[i]][:, [i]],
                    self.sample_time)

    def noise(self) -> np.ndarray:
        """Return standard deviations (m,) of the commands; the loop must be stable."""
        Q = self.W + self.J @ self.J.T
        X = (solve_continuous_lyapunov(self.A, -Q) if self.sample_time is None
             else solve_discrete_lyapunov(self.A, Q)) if len(self.A) else Q
        variance = np.einsum('ij,jk,ik->i', self.U, X, self.U) + np.sum(self.R**2, axis=1)
        return np.sqrt(np.maximum(variance, 0.0))


def close(before: Steps, law: Law) -> Loop:
    """
    Close a loop over a machine whose inputs are the commands, and once more what is added (2m).

    Raises IllPosed.
    """
    m = len(law.D)
    B, Bw = before.B[:, :m], before.B[:, m:]
    D, Dw = before.D[:, :m], before.D[:, m:]
    left = np.eye(m) - law.D @ D
    if np.linalg.svd(left, compute_uv=False).min(initial=1.0) < WELL_POSED:
        raise IllPosed
    own = np.linalg.inv(left)
    # u of machine, controller, what is added, and readings' errors
    U = own @ np.hstack([law.D @ before.C, law.C])
    V, R = own @ law.D @ Dw, own @ law.D @ before.M
    told = np.hstack([before.C, np.zeros((len(before.C), len(law.A)))]) + D @ U
    A = block_diag(before.A, law.A) + np.vstack([B @ U, law.B @ told])
    stir = own @ law.D @ before.E
    return Loop(
        A, np.vstack([Bw + B @ V, law.B @ (Dw + D @ V)]),
        np.vstack([before.J + B @ stir, law.B @ (before.E + D @ stir)]), U, V, R,
        block_diag(before.W, np.zeros(law.A.shape)), law.sample_time)


def rates(poles: np.ndarray, sample_time: float | None) -> np.ndarray:
    """Return at which rates [1/s] what the poles stand for grows."""
    if sample_time is None:
        return np.asarray(poles.real)
    return np.asarray(np.log(np.maximum(np.abs(poles), 1e-300)) / sample_time)


def limit(poles: np.ndarray, sample_time: float | None) -> float:
    """Return the rate [1/s] up to which a pole is taken to stay."""
    if sample_time is not None:
        return STILL / sample_time
    return max(STILL * float(np.abs(poles).max(initial=0.0)), 1e-12)
