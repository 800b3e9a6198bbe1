"""How much of a disturbance a stable linear system hands on: its peak gain over frequency."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigvals, matrix_balance, schur, solve_triangular

TOLERANCE = 1e-6  # relative, of a peak
GRID = 40  # frequencies from which a peak is sought
TRIANGULAR = 60  # states, beyond which N is made triangular before it is solved with


def peak(N: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray,
         sample_time: float | None) -> tuple[float, float]:
    """
    Return the peak over frequency of |C (s - N)^-1 B + D| and its frequency [rad/s].

    N (k, k) stable, B (k, d), C (p, k), D (p, d). The peak is not exceeded: a bound is raised
    until no gain that is found is above it, where gains are sought at and between all frequencies
    at which the gain may cross the bound (Bruinsma and Steinbuch 1990), to TOLERANCE.
    """
    if not D.size:
        return 0.0, 0.0
    if not len(N) or not B.any() or not C.any():
        return float(np.linalg.norm(D, 2)), 0.0
    N, (size, order) = matrix_balance(N, permute=False, separate=True)
    B, C = B / size[:, None], C * size
    gain, at = peak_on_grid(N, B, C, D, sample_time)
    for _ in range(30 if gain > 0 else 0):
        bound = (1 + TOLERANCE) * gain
        crossings = _crossings(N, B, C, D, sample_time, bound)
        tried = np.concatenate([crossings, np.sqrt(crossings[1:] * crossings[:-1]),
                                0.5 * (crossings[1:] + crossings[:-1])])
        gains = _gains(N, B, C, D, tried, sample_time)
        best = int(np.argmax(gains)) if len(gains) else 0
        if not len(gains) or gains[best] <= bound:
            break
        gain, at = float(gains[best]), float(tried[best])
    return (1 + TOLERANCE) * gain, at


def peak_on_grid(N: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray,
                 sample_time: float | None) -> tuple[float, float]:
    """Return the largest gain over a grid of frequencies, quickly, and where it is [rad/s]."""
    if not D.size:
        return 0.0, 0.0
    direct = float(np.linalg.norm(D, 2))
    if not len(N):
        return direct, 0.0
    poles = np.linalg.eigvals(N)
    if sample_time is not None:
        poles = np.log(np.where(np.abs(poles) > 1e-6, poles, 1e-6).astype(complex)) / sample_time
    corners = np.abs(poles[np.abs(poles) > 0])
    low, high = (corners.min(), corners.max()) if len(corners) else (1.0, 1.0)
    grid = np.concatenate([[0.0], corners, np.abs(poles.imag),
                           np.geomspace(low / 10, 10 * high, GRID)])
    if sample_time is not None:
        limit = np.pi / sample_time
        grid = np.concatenate([grid[grid < limit], np.linspace(limit / 10, limit, 10)])
    gains = _gains(N, B, C, D, grid, sample_time)
    best = int(np.argmax(gains))
    if sample_time is None and direct > gains[best]:
        return direct, np.inf
    return float(gains[best]), float(grid[best])


def _gains(N: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, omega: np.ndarray,
           sample_time: float | None) -> np.ndarray:
    """Return |C (s - N)^-1 B + D| at frequencies omega [rad/s]."""
    s = 1j * omega if sample_time is None else np.exp(1j * omega * sample_time)
    if len(N) > TRIANGULAR:
        T, Z = schur(N, output='complex')
        transfer = C @ Z @ np.array([_solved_triangle(at * np.eye(len(T)) - T, Z.conj().T @ B)
                                     for at in s]).reshape(len(s), *B.shape) + D
    else:
        shifted = s[:, None, None] * np.eye(len(N)) - N
        transfer = C @ _solved(shifted, np.broadcast_to(B, (len(s), *B.shape))) + D
    if 1 in D.shape:
        return np.asarray(np.sqrt(np.sum(np.abs(transfer) ** 2, axis=(1, 2))))
    return np.asarray(np.linalg.norm(transfer, 2, axis=(1, 2)))


def _solved_triangle(M: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Solve M X = R for an upper triangle M."""
    try:
        return np.asarray(solve_triangular(M, R, check_finite=False))
    except np.linalg.LinAlgError:
        return _solved(M, R)


def _solved(M: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Solve M X = R; where one is singular to the last bit, in the sense of least squares."""
    try:
        return np.linalg.solve(M, R)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(M) @ R


def _crossings(N: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray,
               sample_time: float | None, bound: float) -> np.ndarray:
    """
    Return frequencies [rad/s], ascending, among them all at which the gain crosses the bound.

    These are the eigenvalues on the limit of stability of what a system and its adjoint do when
    joined: with G x = bound y and G* y = bound x. It is left as a pencil, because the inverse of
    bound^2 - D'D that a Hamiltonian matrix needs is huge where the peak is next to infinity, and
    the frequencies of the other eigenvalues are returned, too: they need not be told apart.
    """
    k, (p, d) = len(N), D.shape
    b, c = np.abs(B).max(), np.abs(C).max()
    even = np.sqrt(b) * np.sqrt(c) / np.sqrt(bound)
    B, C, D = B / b * even, C / c * even, D / bound
    left, right = np.zeros((2, 2 * k + p + d, 2 * k + p + d))
    x, adjoint, w, y = np.split(np.arange(len(left)), np.cumsum([k, k, d]))
    left[np.ix_(x, x)], left[np.ix_(x, w)] = N, B
    right[x, x] = 1.0
    if sample_time is None:
        left[np.ix_(adjoint, adjoint)], left[np.ix_(adjoint, y)] = -N.T, -C.T
        right[adjoint, adjoint] = 1.0
    else:
        left[adjoint, adjoint] = 1.0
        right[np.ix_(adjoint, adjoint)], right[np.ix_(adjoint, y)] = N.T, C.T
    left[np.ix_(y, x)], left[np.ix_(y, w)], left[y, y] = C, D, -1.0
    left[np.ix_(w, adjoint)], left[np.ix_(w, y)], left[w, w] = B.T, D.T, -1.0
    values = eigvals(left, right)
    values = values[np.isfinite(values)]
    if sample_time is None:
        return np.unique(np.abs(values.imag))
    return np.unique(np.abs(np.angle(values))) / sample_time
