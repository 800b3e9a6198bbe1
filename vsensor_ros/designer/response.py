"""What a linear system makes of its inputs: whether anything at all, and of constant ones."""

from __future__ import annotations

import numpy as np

ROUNDING = 1e-9  # of what a number was summed from
_ASIDE = (0.37, 1.41, 2.93)  # times a rate of the system: where a transfer function is looked at


def responds(N: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray,
             sample_time: float | None) -> np.ndarray:
    """
    Tell for each input whether ``C (s - N)^-1 B + D`` is not identically zero (m,).

    N (k, k), B (k, m), C (c, k), D (c, m). A rational function that is not zero has few zeros: it
    is looked at in a few places off the axes, each near a rate of the system.
    """
    found = np.zeros(D.shape[1], dtype=bool)
    for s in _places(N, sample_time):
        value, size = _at(s, N, B, C, D)
        found |= (np.abs(value) > ROUNDING * size).any(axis=0)
    return found


def constant(N: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray,
             sample_time: float | None) -> np.ndarray:
    """Return what is left of constant inputs (c, m), zero where it is rounding; N is stable."""
    value, size = _at(0.0 if sample_time is None else 1.0, N, B, C, D)
    return np.where(np.abs(value) > ROUNDING * size, value.real, 0.0)


def _places(N: np.ndarray, sample_time: float | None) -> list[complex]:
    if not len(N):
        return [1.0]
    turns = np.exp(0.7j), np.exp(-0.4j), np.exp(1.2j)
    if sample_time is not None:
        return [aside * turn for aside, turn in zip(_ASIDE, turns)]
    sizes = np.abs(np.linalg.eigvals(N))
    sizes = sizes[sizes > 1e-12 * sizes.max()] if sizes.max() > 0.0 else np.ones(1)
    rates = sizes.min(), float(np.exp(np.log(sizes).mean())), sizes.max()
    return [rate * aside * turn for rate in rates for aside, turn in zip(_ASIDE, turns)]


def _at(s: complex, N: np.ndarray, B: np.ndarray, C: np.ndarray,
        D: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the transfer function at s (c, m), and the size of what it is summed from."""
    if not len(N):
        return D + 0j, np.abs(D)
    X = np.linalg.solve(s * np.eye(len(N)) - N, B)
    return C @ X + D, np.abs(C) @ np.abs(X) + np.abs(D)
