"""
The least function that the unknown inputs do not reach and whose change can be told.

gamma_0 is free of the unknown inputs, gamma_(i+1) = gamma_i (+) m(gamma_i x h*), within the span
of a dictionary. Source: Symmetry 15, 993, Theorem 1; continuous time: the method's section on it.
Conditions hold or fail at random points; what follows from them is confirmed elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vsensor_ros.designer.algebra.dictionary import build, Dictionary, state_atoms
from vsensor_ros.designer.algebra.model import Model
from vsensor_ros.designer.algebra.null_space import kernels, null_space
from vsensor_ros.functions.equations import Equations

SPARE = 12  # points more than are needed
_FAINT = 1e-4
COMBINED = 3  # random combinations of an element's functions that stand for it, beyond n

Reads = Equations | None
Kernels = Callable[[np.ndarray], tuple[np.ndarray, int]]


def products(model: Model, degree: int, laurent: bool, curved: bool) -> Dictionary | None:
    """Return the monomials over the states up to a degree, or None when these are too many."""
    system = model.system
    nodes = (*model.f, *model.sensors.values(), *model.wanted.values())
    return build(model.states, [
        state_atoms(name, low > 0.0 or high < 0.0, nodes, laurent, curved and low > 0.0,
                    name in system.angles)
        for name, (low, high) in system.states.items()], degree)


def largest(model: Model, dictionary: Dictionary, reads: Reads = None) -> np.ndarray:
    """Return gamma*, coefficients (K, q); reads: h*, the healthy sensors by default."""
    gamma = free_of_unknown(model, dictionary)
    while gamma.shape[1]:
        inner = foreseen(model, dictionary, gamma, kernels_of(model, dictionary, gamma, reads))
        if inner.shape[1] == gamma.shape[1]:
            return gamma
        gamma = inner
    return gamma


def free_of_unknown(model: Model, dictionary: Dictionary) -> np.ndarray:
    """Return gamma_0, coefficients (K, q): what no unknown input changes at once."""
    K, n, s = len(dictionary), len(model.states), len(model.unknown)
    if not s:
        return np.eye(K)
    at = model.points(-(-(K + SPARE) // s) + SPARE, 1)
    values, slopes = evaluated(model, at)
    where = values if model.discrete else at[:n]
    gradients = dictionary.gradients(where)  # (K, n, N)
    pushes = slopes[:, -s:]                  # (n, s, N)
    rows = np.einsum('KiN,isN->NsK', gradients, pushes).reshape(-1, K)
    sizes = np.einsum('KiN,isN->NsK', np.abs(gradients), rough(pushes, at[:n])).reshape(-1, K)
    return null_space(rows, sizes)


def foreseen(model: Model, dictionary: Dictionary, within: np.ndarray,
             kernel: Kernels) -> np.ndarray:
    """
    Return what of the span `within` (K, q) has a change that a known function tells.

    kernel: of that function's differential, at points. It is m of it, (+) the span.
    """
    n, q = len(model.states), within.shape[1]
    at = model.points(q + SPARE, 2)
    K, d = kernel(at[:n])
    if not d:
        return within
    at, K = at[:, :(few := -(-(q + SPARE) // d) + SPARE)], K[:few]
    values, slopes = evaluated(model, at)
    by_state = slopes[:, :n]
    rows, sizes = [], []
    if model.discrete:
        gradients = dictionary.gradients(values)
    for v in np.moveaxis(K, 2, 0):
        v = v.T
        if model.discrete:
            moved = np.einsum('ijN,jN->iN', by_state, v)
            size = np.einsum('ijN,jN->iN', np.abs(by_state), rough(v, at[:n]))
            rows.append(np.einsum('KiN,iN->NK', gradients, moved))
            sizes.append(np.einsum('KiN,iN->NK', np.abs(gradients), size))
        else:
            row, size = dictionary.along(at[:n], values, by_state, v, rough(v, at[:n]))
            rows.append(row.T)
            sizes.append(size.T)
    all_rows, all_sizes = np.concatenate(rows), np.concatenate(sizes)
    good = np.isfinite(all_rows).all(axis=1) & np.isfinite(all_sizes).all(axis=1)
    inner = null_space(all_rows[good] @ within, all_sizes[good] @ np.abs(within))
    return within @ inner


def rough(v: np.ndarray, at: np.ndarray) -> np.ndarray:
    """
    Return the sizes of directions (n, .., N) at points (n, N), of none less than a share of all.

    A component that is 0 but for rounding must not set the scale of what it meets.
    """
    scale = np.abs(at).max(axis=1).reshape(-1, *[1] * (v.ndim - 1))
    scale = np.where(scale > 0.0, scale, 1.0)
    return np.maximum(np.abs(v), _FAINT * scale * (np.abs(v) / scale).max(axis=0))


def constant_along(dictionary: Dictionary, within: np.ndarray, at: np.ndarray,
                   K: np.ndarray) -> np.ndarray:
    """Return what of the span (K, q) does not change along kernels (N, n, d) at points (n, N)."""
    gradients = dictionary.gradients(at)
    rows = np.einsum('KiN,Nid->NdK', gradients, K).reshape(-1, len(dictionary))
    size = np.stack([rough(v.T, at) for v in np.moveaxis(K, 2, 0)], axis=1)
    sizes = np.einsum('KiN,idN->NdK', np.abs(gradients), size).reshape(-1, len(dictionary))
    return within @ null_space(rows @ within, sizes @ np.abs(within))


def kernels_of(model: Model, dictionary: Dictionary, gamma: np.ndarray,
               reads: Reads = None) -> Kernels:
    """Return the kernels of d(gamma x reads) at points; a few combinations stand for gamma."""
    n = len(model.states)
    mix = np.random.default_rng(3).standard_normal((gamma.shape[1], n + COMBINED))
    few = gamma if gamma.shape[1] <= n + COMBINED else gamma @ mix

    def kernel(at: np.ndarray) -> tuple[np.ndarray, int]:
        return kernels(np.concatenate([element_gradients(dictionary, few, at),
                                       (reads or model.h0).slopes(at)[1]]))
    return kernel


def element_gradients(dictionary: Dictionary, gamma: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the gradients (q, n, N) of the functions of coefficients (K, q), scaled rows."""
    return np.einsum('Kq,KiN->qiN', gamma, dictionary.gradients(at))


def evaluated(model: Model, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return f (n, N) and its gradients (n, n + m + s, N) at points (n + m + s, N)."""
    with np.errstate(all='ignore'):
        return model.dynamics.slopes(at)
