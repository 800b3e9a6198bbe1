"""A plant about its operating point: terms give way to their slopes there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsensor_ros.functions.expression import gradient, parse
from vsensor_ros.functions.nonlinearity import (
    argument_names,
    evaluate,
    NonlinearTerm,
    outside_domain,
)
from vsensor_ros.plant.plant import Plant

SIDES = (1e-4, 1e-5)  # to each side of a point, of its size: these slopes are compared
ALIKE, FLAT = 0.1, 0.01  # of the largest of them, and of the slope over all of that size


def slopes_of(term: NonlinearTerm, w: np.ndarray, inputs: Sequence[str],
              u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return d psi/dw (r,) and d psi/du (m,) at a point, the addend included.

    Where f has a kink or no finite slope, or outside its domain, its slope is taken as 0.
    """
    arguments = argument_names(len(term.slope))
    if outside_domain(term, w, inputs, u).any():
        return -term.slope, np.zeros(len(inputs))
    at = {**dict(zip(inputs, map(float, u))), **dict(zip(arguments, map(float, w)))}
    slope = gradient(parse(term.text), at, (*arguments, *inputs))[1]
    slope = np.where(np.isfinite(slope), slope, 0.0)
    return slope[:len(arguments)] - term.slope, slope[len(arguments):]


def kinked(term: NonlinearTerm, w: np.ndarray, inputs: Sequence[str], u: np.ndarray) -> bool:
    """Tell whether a term has no slope at a point: nearer to it, or beyond it, it is another."""
    here = float(evaluate(term, w, inputs, u))
    for i, value in enumerate(w):
        steps = (1.0 + abs(value)) * np.array([1.0, *SIDES, *(-side for side in SIDES)])
        around = np.repeat(w[:, None], len(steps), axis=1)
        around[i] += steps
        far, *near = (evaluate(term, around, inputs, np.repeat(
            np.reshape(u, (-1, 1)), len(steps), axis=1)) - here) / steps
        apart = max(near) - min(near)
        if apart > ALIKE * max(map(abs, near)) and apart > FLAT * abs(far):
            return True
    return False


def linearised(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """Return A (n, n) and B (n, m) at the operating point; terms have slope 0 at their kinks."""
    A, B = plant.A.copy(), plant.B.copy()
    for term, G, column in zip(plant.terms, plant.G, plant.P.T):
        w, u = slopes_of(term, G @ plant.operating_point, plant.inputs, plant.operating_input)
        A += np.outer(column, w @ G)
        B += np.outer(column, u)
    return A, B
