"""Which modes of a matrix die out for certain, given how well its eigenvalues are known."""

import numpy as np
from scipy.linalg import eig

_DATA = 1e-12  # relative accuracy of a matrix that came out of the designer's arithmetic
_WORST = 1e-7  # of the matrix: no eigenvalue is held to be less certain than this


def lasting(N: np.ndarray, sample_time: float | None, size: float = 0.0,
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the eigenvalues of N (k,) and for each whether it may fail to die out (k,).

    Each is judged against its own uncertainty: the accuracy of the data, ``size`` (the norm of
    what N was computed from, if larger than its own), times the eigenvalue's condition number.
    The fastest mode of a stiff plant therefore does not decide what is said of the slowest.
    """
    if not len(N):
        return np.zeros(0, complex), np.zeros(0, dtype=bool)
    values, left, right = eig(N, left=True, right=True)
    with np.errstate(divide='ignore'):
        condition = 1.0 / np.abs(np.sum(left.conj() * right, axis=0))
    margin = np.minimum(_DATA * condition, _WORST) * max(size, np.linalg.norm(N, 2))
    if sample_time is None:
        return values, values.real >= -margin
    return values, np.abs(values) >= 1.0 - margin
