"""Exact discretisation of linear systems: the exponential and the phi functions of a matrix."""

import numpy as np
from scipy.linalg import expm


def phi_functions(N: np.ndarray, h: float) -> tuple[np.ndarray, ...]:
    """
    Return ``exp(N h), phi1(N h), phi2(N h), phi3(N h)``, each of the shape (..., k, k) of N.

    ``phi_j(M) = sum_i M^i / (i + j)!``, so that ``h phi1`` integrates a constant and ``h phi2``
    a ramp that reaches 1 at the time h [s] (method, section 5). One exponential of an augmented
    matrix gives them all, also where N is singular.
    """
    k = N.shape[-1]
    if k == 0:
        return (np.zeros(N.shape),) * 4
    augmented = np.zeros((*N.shape[:-2], 4 * k, 4 * k))
    augmented[..., :3 * k, k:] = np.eye(3 * k)
    augmented[..., :k, :k] = N * h
    result = expm(augmented)
    return tuple(result[..., :k, j * k:(j + 1) * k] for j in range(4))
