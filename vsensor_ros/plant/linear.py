"""A plant about its operating point: terms give way to their slopes there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsensor_ros.functions.expression import gradient, parse
from vsensor_ros.functions.nonlinearity import argument_names, NonlinearTerm, outside_domain
from vsensor_ros.plant.plant import Plant


def slopes_of(term: NonlinearTerm, w: np.ndarray, inputs: Sequence[str],
              u: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """
    Return d psi/dw (r,) and d psi/du (m,) at a point, the addend included, and whether all are so.

    Where f has a kink or no finite slope, or outside its domain, its slope is taken as 0.
    """
    arguments = argument_names(len(term.slope))
    if outside_domain(term, w, inputs, u).any():
        return -term.slope, np.zeros(len(inputs)), False
    at = {**dict(zip(inputs, map(float, u))), **dict(zip(arguments, map(float, w)))}
    slope = gradient(parse(term.text), at, (*arguments, *inputs))[1]
    finite = np.isfinite(slope)
    slope = np.where(finite, slope, 0.0)
    return slope[:len(arguments)] - term.slope, slope[len(arguments):], bool(finite.all())


def linearised(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """Return A (n, n) and B (n, m) at the operating point; terms have slope 0 at their kinks."""
    A, B = plant.A.copy(), plant.B.copy()
    for term, G, column in zip(plant.terms, plant.G, plant.P.T):
        w, u, _ = slopes_of(term, G @ plant.operating_point, plant.inputs, plant.operating_input)
        A += np.outer(column, w @ G)
        B += np.outer(column, u)
    return A, B
