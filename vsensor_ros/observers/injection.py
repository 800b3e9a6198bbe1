"""
Steps of a sliding mode: what must be injected so that an observer stays on a residual.

Both are implicit in the sign, so that they do not chatter. That of the first order is a filtered
backward difference unless it saturates; super-twisting (semi-implicit: the root of what was, the
sign of what will be) needs no filter.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm

from vsensor_ros.observers.fault_size import Injection

Step = Callable[[np.ndarray, np.ndarray], np.ndarray]


def first_order(of: Injection, response: float, h: float) -> tuple[int, Step]:
    """
    Return the length of a state (.., k + 1), and its step of h [s] to the next residual (..).

    The last number of the state is the estimate, filtered with a time constant [s].
    """
    A, g, k = *_held(of, h), len(of.f)
    gain, pull = float(of.c @ g), -float(np.expm1(-h / response))

    def step(state: np.ndarray, residual: np.ndarray) -> np.ndarray:
        e = state[..., :k] @ A.T
        nu = np.clip((residual - e @ of.c) / gain, -of.largest, of.largest)
        last = state[..., k] + pull * (nu - state[..., k])
        return np.concatenate([e + nu[..., None] * g, last[..., None]], axis=-1)
    return k + 1, step


def super_twisting(of: Injection, h: float, change: np.ndarray | None = None) -> tuple[int, Step]:
    """
    Return the length of a state (.., k + 2), and its step of h [s] to the next residual (..).

    The last number of the state is the estimate. change (..): instead of the injection's own.
    """
    A, g, k = *_held(of, h), len(of.f)
    gain = float(of.c @ g)
    rate = np.asarray(of.change if change is None else change)
    root, turn = 1.5 * np.sqrt(rate), 1.1 * rate * h  # Levant's gains

    def step(state: np.ndarray, residual: np.ndarray) -> np.ndarray:
        e, off, w = state[..., :k] @ A.T, state[..., k], state[..., k + 1]
        ahead = residual - e @ of.c - gain * w
        most = root * np.sqrt(np.abs(off)) + turn
        # the sign of what will be: within [-1, 1] where that is 0
        sign = np.clip(ahead / (gain * most), -1.0, 1.0)
        w = np.clip(w + turn * sign, -of.largest, of.largest)
        nu = root * np.sqrt(np.abs(off)) * sign + w
        off = residual - e @ of.c - gain * nu
        return np.concatenate([e + nu[..., None] * g, off[..., None], w[..., None]], axis=-1)
    return k + 2, step


def _held(of: Injection, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what a step of h makes of e (k, k), and of an injection that is held (k,)."""
    k = len(of.f)
    moved = expm(np.block([[of.N, of.f[:, None]], [np.zeros((1, k + 1))]]) * h)
    return moved[:k, :k], moved[:k, k]
