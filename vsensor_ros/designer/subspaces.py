"""
Subspaces and the rank decisions behind them.

A subspace of states is held as orthonormal columns, a space of functionals as orthonormal rows.
The data are expected in the scaled coordinates of ``problem.py``, where sizes mean something.
"""

import numpy as np

RANK_TOLERANCE = 1e-9  # relative to the largest singular value


def _split(M: np.ndarray, size: float = 0.0) -> tuple[np.ndarray, int, np.ndarray]:
    """Return left singular vectors, rank and right singular vectors (as rows)."""
    U, sigma, Vt = np.linalg.svd(M, full_matrices=True)
    r = int(np.sum(sigma > RANK_TOLERANCE * max(sigma[0], size))) if sigma.size else 0
    return U, r, Vt


def rank(M: np.ndarray) -> int:
    """Count the singular values above the tolerance."""
    return 0 if 0 in M.shape else _split(M)[1]


def image(M: np.ndarray) -> np.ndarray:
    """Orthonormal columns that span the columns of M."""
    if 0 in M.shape:
        return np.zeros((M.shape[0], 0))
    U, r, _ = _split(M)
    return U[:, :r]


def kernel(M: np.ndarray, size: float = 0.0) -> np.ndarray:
    """Return orthonormal columns x with M x = 0, where |M| below ``size`` is rounding."""
    if 0 in M.shape:
        return np.eye(M.shape[1])
    _, r, Vt = _split(M, size)
    return Vt[r:].T


def left_kernel(M: np.ndarray) -> np.ndarray:
    """Orthonormal rows w with w M = 0."""
    return kernel(M.T).T


def intersection(S: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Orthonormal columns common to two column spaces given by orthonormal columns."""
    both = kernel(np.hstack([S, -T]))
    return image(S @ both[:S.shape[1]])


def solve_left(M: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Return the least X with X M = R in the sense of least squares."""
    if 0 in M.shape or 0 in R.shape:
        return np.zeros((R.shape[0], M.shape[0]))
    return np.linalg.lstsq(M.T, R.T, rcond=RANK_TOLERANCE)[0].T


def in_row_space(M: np.ndarray, R: np.ndarray) -> bool:
    """Tell whether every row of R is a combination of rows of M."""
    residual = R - solve_left(M, R) @ M
    size = np.linalg.norm(R, axis=1)
    return bool(np.all(np.linalg.norm(residual, axis=1) <= 1e2 * RANK_TOLERANCE * size))


def conditioned_invariant(A: np.ndarray, C0: np.ndarray, D: np.ndarray) -> np.ndarray:
    """
    Return T*, the least subspace T that holds D and has A (T intersected with ker C0) inside T.

    A (n, n), C0 (l0, n), D (n, d); orthonormal columns (n, t). Source: method 3.1.
    """
    A = A / max(np.linalg.norm(A, 2), np.finfo(float).tiny)
    ker_C0 = kernel(C0)
    D = T = image(D)
    while True:
        grown = image(np.hstack([D, A @ intersection(T, ker_C0)]))
        if grown.shape[1] <= T.shape[1]:
            return T
        T = grown


def measured_part(Phi: np.ndarray, C0: np.ndarray) -> np.ndarray:
    """Rows C_* with C_* Phi inside the row space of C0: what a residual can show of z."""
    return left_kernel(np.vstack([Phi, -C0]))[:, :Phi.shape[0]]
