"""The papers' condition for convergence, in Lipschitz constants: computed for comparison."""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

from vsensor_ros.designer.error_in_box import Bounds, feeding_terms, INFINITE_SLOPE
from vsensor_ros.designer.error_system import MOST_CORNERS
from vsensor_ros.designer.stability import lasting
from vsensor_ros.observers import VirtualSensor


def lipschitz(sensor: VirtualSensor, bounds: Bounds) -> tuple[float, float] | None:
    """
    Return (M_*, lambda_min(W) / (2 lambda_max(X))) with N' X + X N = -W, W = I.

    M_* is the Lipschitz constant, by z, of the sum of P_i psi_i. For a discrete plant, where
    the papers give no formula, the right side is the M that keeps V = e' X e from rising:
    lambda_max(X) M^2 + 2 |N' X| M = 1. None where a term has no Lipschitz constant or N is not
    stable.
    """
    parts = [(np.outer(sensor.P[:, i], row), low, high)
             for i in feeding_terms(sensor)
             for row, (low, high) in zip(sensor.Gz[i], bounds[i]) if row.any()]
    if any(max(-low, high) > INFINITE_SLOPE for _, low, high in parts):
        return None
    if lasting(sensor.N, sensor.sample_time)[1].any():
        return None
    if len(parts) <= MOST_CORNERS:
        left = max(float(np.linalg.norm(sum((s * M for s, (M, _, _) in zip(ends, parts)),
                                            np.zeros_like(sensor.N)), 2))
                   for ends in product(*((low, high) for _, low, high in parts)))
    else:
        left = float(sum(max(-low, high) * np.linalg.norm(M, 2) for M, low, high in parts))
    identity = np.eye(len(sensor.N))
    try:
        if sensor.sample_time is None:
            X = solve_continuous_lyapunov(sensor.N.T, -identity)
            right = 0.5 / np.linalg.eigvalsh(0.5 * (X + X.T))[-1]
        else:
            X = solve_discrete_lyapunov(sensor.N.T, identity)
            a, b = np.linalg.eigvalsh(0.5 * (X + X.T))[-1], np.linalg.norm(sensor.N.T @ X, 2)
            right = 1.0 / (b + np.sqrt(b * b + a))
    except (np.linalg.LinAlgError, ValueError):
        return None
    return left, max(float(right), 0.0)
