"""H-infinity filters: they guard against the worst unknown input of bounded energy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.linalg import block_diag, LinAlgError, solve_continuous_are, solve_discrete_are

from vsensor_ros.designer.gain import peak_on_grid
from vsensor_ros.designer.noise import Filter, kalman
from vsensor_ros.designer.quotient import Quotient
from vsensor_ros.designer.relaxation import Disturbed
from vsensor_ros.observers.kinds.functional import decay_of

GUARDS = 5  # bisections of the bound that a filter is made for


def h_infinity_filters(known: Quotient, noise: Disturbed) -> Iterator[Filter]:
    """
    Yield H-infinity filters, for all noise and disturbance as one input of bounded energy.

    The bound is bisected between nothing and the worst gain of the Kalman filter.
    """
    h = noise.sample_time
    start = kalman(known, noise)
    if start is None or not len(known.E):
        return
    B, D = noise.drives(known)

    def worst(found: Filter) -> float:
        N = known.A - found.L @ known.E
        if decay_of(np.linalg.eigvals(N), h) <= 0:
            return np.inf
        return peak_on_grid(N, B - found.L @ D, found.Cv, -found.g @ D, h)[0]

    low, high = 0.0, worst(start)
    if not np.isfinite(high):
        return
    for _ in range(GUARDS):
        middle = 0.5 * (low + high)
        found = _h_infinity(known, B, D, start.g, middle, h)
        if found is None or worst(found) > 1.01 * middle:
            low = middle
        else:
            high = middle
            yield found


def _h_infinity(known: Quotient, B: np.ndarray, D: np.ndarray, g: np.ndarray, bound: float,
                sample_time: float | None) -> Filter | None:
    """Return the filter that hands on less than ``bound`` of unit inputs, if there is one."""
    E, v = known.E, known.v
    meter, cross = D @ D.T, B @ D.T
    meter = meter + 1e-12 * np.trace(meter) * np.eye(len(meter))
    both, mixed = np.vstack([E, v]), np.hstack([cross, np.zeros((len(B), len(v)))])
    weights = block_diag(meter, -bound**2 * np.eye(len(v)))
    try:
        if sample_time is None:
            X = solve_continuous_are(known.A.T, both.T, B @ B.T, weights, s=mixed)
            return Filter(np.linalg.solve(meter, (X @ E.T + cross).T).T, v, g, 0.0)
        X = solve_discrete_are(known.A.T, both.T, B @ B.T, weights, s=mixed)
        seen = E @ X @ E.T + meter
        g = np.linalg.solve(seen, E @ X @ v.T).T
        return Filter(np.linalg.solve(seen, (known.A @ X @ E.T + cross).T).T, v - g @ E, g, 0.0)
    except (LinAlgError, ValueError):  # no filter keeps below the bound
        return None
