"""Peak-to-peak gain: how far errors of the readings can put the estimate out, in the long run."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm, schur, solve_triangular

from vsensor_ros.designer.error_system import contraction, ErrorSystem
from vsensor_ros.designer.quadratic_form import ROUNDING


def peak_bound(error: ErrorSystem, L: np.ndarray, rate: float) -> float:
    """
    Bound |v - vhat| for readings off by 1 at most, through peak gains of the centred system.

    L, rate: a form that was checked for N alone. A bounded slope acts like one more input: its
    size is at most the radius times the peak of the argument g e - h n. Each argument's peak is
    bounded by the peaks of all inputs, these among them. The bounds hold together when the matrix
    of the gains from one argument to another has spectral radius below 1. Exact for a linear
    error.
    """
    seen = error.bounded
    if error.loose.radius.size or error.rising.radius.size:
        return np.inf
    l0 = error.J.shape[1]
    sources = np.hstack([error.J, seen.p * seen.radius])
    gains = np.array([_peak_gains(error.N, sources, row, L, rate, error.sample_time)
                      for row in np.vstack([error.Cv, seen.g])])
    of_v, of_seen = gains[:len(error.Cv)], gains[len(error.Cv):]
    loop = of_seen[:, l0:]
    if np.abs(np.linalg.eigvals(loop)).max(initial=0.0) >= 1 - ROUNDING:
        return np.inf
    peaks = np.linalg.solve(np.eye(len(loop)) - loop,
                            of_seen[:, :l0].sum(axis=1) + np.abs(seen.h).sum(axis=1))
    return float(np.max(of_v[:, :l0].sum(axis=1) + of_v[:, l0:] @ peaks
                        + np.abs(error.Q).sum(axis=1)))


def _peak_gains(N: np.ndarray, columns: np.ndarray, row: np.ndarray, L: np.ndarray, rate: float,
                sample_time: float | None) -> np.ndarray:
    """
    Bound int |row exp(N t) column| dt (or the discrete sum) for each column.

    Time is cut at points that double their distance every sixteen steps. On each step of length
    h, int |f| <= sqrt(h int f^2) (Cauchy and Schwarz), and the energy is a quadratic form that
    doubles its step exactly; the tail is bounded by L and the rate. All in Schur coordinates,
    where the exponentials of the diagonal are exact however stiff N is.
    """
    total = np.zeros(columns.shape[1])
    if not columns.any() or not row.any():
        return total
    steps = 16
    T, U = schur(N, output='complex')
    c, X = (row @ U)[None, :], U.conj().T @ columns
    if sample_time is None:
        h = 0.1 / max(float(np.linalg.norm(T, 1)), float(np.finfo(float).tiny))
        nodes, weights = np.polynomial.legendre.leggauss(4)
        at = [c @ expm(T * (0.5 * h * (1.0 + node))) for node in nodes]
        W = sum(0.5 * h * w * a.conj().T @ a for w, a in zip(weights, at))
        E = expm(T * h)
    else:
        h, E, W = 1.0, T, c.conj().T @ c
    tail = np.linalg.norm(solve_triangular(L, row, lower=True)) * contraction(rate, sample_time)
    rest, diagonal = total, np.diag(E)
    for level in range(400):
        for _ in range(2 * steps if level == 0 else steps):
            energy = np.sum(X.conj() * (W @ X), axis=0).real
            total = total + np.sqrt(h * np.maximum(energy, 0.0))
            X = E @ X
        rest = tail * np.linalg.norm(L.T @ (U @ X).real, axis=0)
        if rest.sum() <= 1e-4 * total.sum():
            break
        W = W + E.conj().T @ W @ E
        diagonal = diagonal**2
        E = np.triu(E @ E, 1) + np.diag(diagonal)
        h *= 2.0
    return total + rest
