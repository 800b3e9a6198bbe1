"""Null spaces of conditions at random points: QR, then the singular values of what is left."""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr

CLEAR = 1e-10  # of the largest singular value, and of 1: below it is nothing but rounding
KEPT = 1e-8    # of the largest entry of a basis vector: below it is 0


def null_space(conditions: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """
    Return the coefficients (r, q) with conditions (R, r) @ coefficients = 0, sparse.

    sizes (R, r): the sum of the absolute values of what each entry was summed from. A column
    that is 0 up to rounding must not be blown up, so it is scaled by these, never by its norm.
    """
    r = conditions.shape[1]
    rows = sizes.max(axis=1, initial=0.0)
    good = np.isfinite(conditions).all(axis=1) & np.isfinite(rows) & (rows > 0.0)
    if not good.any():
        return np.eye(r)
    conditions = conditions[good] / rows[good, None]
    scale = (sizes[good] / rows[good, None]).max(axis=0)
    scale[scale == 0.0] = 1.0
    scaled = conditions / scale
    if len(scaled) > r:
        scaled = qr(scaled, mode='r')[0][:r]
    _, values, Vt = np.linalg.svd(scaled, full_matrices=True)
    rank = int((values > CLEAR * max(values[0], 1.0)).sum())
    return echelon(Vt[rank:].T) / scale[:, None]


def echelon(basis: np.ndarray) -> np.ndarray:
    """Return another basis (K, q) of the same span with as few entries, found by pivoting."""
    if not basis.shape[1]:
        return basis
    _, _, order = qr(basis.T, mode='economic', pivoting=True)
    chosen = order[:basis.shape[1]]
    result = np.linalg.solve(basis[chosen].T, basis.T).T
    result[chosen] = np.eye(len(chosen))
    result[np.abs(result) < KEPT * np.abs(result).max(axis=0)] = 0.0
    return result


def ranks(rows: np.ndarray, tolerance: float = 1e-8) -> np.ndarray:
    """Return the rank (N,) at each point of gradients (E, n, N), rows scaled."""
    if not rows.shape[0]:
        return np.zeros(rows.shape[2], dtype=int)
    at = _scaled(rows)
    values = np.linalg.svd(at, compute_uv=False)
    return (values > tolerance * np.maximum(values[:, :1], 1e-300)).sum(axis=1)


def kernels(rows: np.ndarray) -> tuple[np.ndarray, int]:
    """Return orthonormal kernels (N, n, d) of gradients (E, n, N), and their dimension d."""
    n = rows.shape[1]
    if not rows.shape[0]:
        return np.broadcast_to(np.eye(n), (rows.shape[2], n, n)), n
    at = _scaled(rows)
    _, values, Vt = np.linalg.svd(at, full_matrices=True)
    rank = int((values > 1e-8 * np.maximum(values[:, :1], 1e-300)).sum(axis=1).max())
    return np.swapaxes(Vt[:, rank:], 1, 2), n - rank


def _scaled(rows: np.ndarray) -> np.ndarray:
    at = np.moveaxis(rows, 2, 0)
    at = np.where(np.isfinite(at), at, 0.0)
    size = np.linalg.norm(at, axis=2, keepdims=True)
    return at / np.where(size > 0.0, size, 1.0)
