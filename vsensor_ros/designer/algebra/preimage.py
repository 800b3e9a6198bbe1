"""Whether known quantities leave a wanted one two values: a search for a second preimage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np

from vsensor_ros.designer.algebra.answer import Range
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Node

_BASES = 48    # points whose second preimage is looked for
_STARTS = 8    # of the search, for each
_STEPS = 14    # of Gauss and Newton
_REACHED = 1e-8
_APART = 1e-2  # of the spread of what is wanted


@dataclass(frozen=True, eq=False)
class Twins:
    """Two states (n,) with the same known quantities and another wanted one."""

    one: np.ndarray
    other: np.ndarray


def second_preimage(known: Sequence[Node], wanted: Sequence[Node], states: Mapping[str, Range],
                    angles: Sequence[str] = ()) -> Twins | None:
    """
    Return two states in their ranges that `known` does not tell apart, and `wanted` does.

    A search that finds none proves nothing.
    """
    names = tuple(states)
    low, high = np.array(list(states.values()), dtype=float).T[:, :, None]
    width = np.where(high > low, high - low, 1.0)
    circle = np.array([name in angles for name in names])[:, None]
    random = np.random.default_rng(31)
    base = np.repeat(low + (high - low) * random.random((len(names), _BASES)), _STARTS, axis=1)
    x = low + (high - low) * random.random(base.shape)
    both, goal = Equations(known, names), Equations(wanted, names)
    with np.errstate(all='ignore'):
        aim = both.values(base)
        size = np.nanmax(np.abs(aim), axis=1, keepdims=True, initial=1e-300)
        for _ in range(_STEPS):
            values, slopes = both.slopes(x)
            gap = (aim - values) / size
            if not np.isfinite(gap).all():
                gap = np.where(np.isfinite(gap), gap, 0.0)
            J = np.moveaxis(slopes * width[None] / size[:, None], 2, 0)
            step = (np.linalg.pinv(J, rcond=1e-10) @ gap.T[:, :, None])[:, :, 0].T
            longest = np.abs(step).max(axis=0)
            x = x + width * step / np.maximum(longest / 0.3, 1.0)
            x = np.where(circle, np.remainder(x + math.pi, 2.0 * math.pi) - math.pi,
                         np.clip(x, low - 0.2 * width, high + 0.2 * width))
        reached = (np.abs(aim - both.values(x)) / size).max(axis=0) < _REACHED
        inside = (circle | ((x >= low) & (x <= high))).all(axis=0)
        told = goal.values(base), goal.values(x)
        spread = np.ptp(told[0], axis=1)[:, None]
        apart = (np.abs(told[0] - told[1]) > _APART * np.maximum(spread, 1e-300)).any(axis=0)
    found = np.flatnonzero(reached & inside & apart)
    return Twins(base[:, found[0]], x[:, found[0]]) if len(found) else None
