"""
Lookup tables: `table(x, x1, y1, x2, y2, ..)`, linear between its points, or `smooth_table`.

That one is the shape-preserving cubic of Fritsch and Carlson (PCHIP): it rises where the points
do, and never beyond them. Beyond the ends both go straight on. The points are numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from vsensor_ros.functions.function import Bounds, Function
from vsensor_ros.functions.interval import around, Interval, ZERO

MOST_POINTS = 100


@dataclass(frozen=True, eq=False)
class Pieces:
    """A cubic for each piece, and straight lines beyond: y = sum_k c[k] (x - from)^(3 - k)."""

    x: np.ndarray  # (N,), rising
    c: np.ndarray  # (4, N - 1)

    def __call__(self, x: Any) -> Any:
        """Return y, elementwise."""
        inside = np.minimum(np.maximum(x, self.x[0]), self.x[-1])
        i = np.clip(np.searchsorted(self.x, inside, side='right') - 1, 0, len(self.x) - 2)
        a, b, c, d = self.c[:, i]
        s = inside - self.x[i]
        return ((a * s + b) * s + c) * s + d + (x - inside) * ((3.0 * a * s + 2.0 * b) * s + c)

    def slope(self, x: float) -> float:
        """Return dy/dx, at a point of the table that of the piece after it."""
        inside = min(max(x, self.x[0]), self.x[-1])
        i = min(max(int(np.searchsorted(self.x, inside, side='right')) - 1, 0), len(self.x) - 2)
        a, b, c, _ = self.c[:, i]
        s = inside - self.x[i]
        return float((3.0 * a * s + 2.0 * b) * s + c)

    def bounds(self, x: Interval) -> tuple[Interval, Interval]:
        """Bound y and dy/dx over an interval of x."""
        ends = [min(max(end, self.x[0]), self.x[-1]) for end in x]
        values = [float(self(end)) for end in ends]
        for end, inside, value in zip(x, ends, list(values)):
            slope = self.slope(inside) if end <= self.x[0] else self._last_slope
            values.append(value + (slope * (end - inside) if end != inside and slope else 0.0))
        slopes = []
        for i, (low, high) in enumerate(zip(self.x, self.x[1:])):
            first, last = max(low, ends[0]), min(high, ends[1])
            # an end that is beyond is on the line that goes on from there
            if first < last or (first == last and (ends[0] == ends[1] or
                                                   first in (self.x[0], self.x[-1]))):
                a, b, c, _ = self.c[:, i]
                turn = low - b / (3.0 * a) if a else first
                for at in (first, last, min(max(turn, first), last)):
                    s = at - low
                    slopes.append((3.0 * a * s + 2.0 * b) * s + c)
        values += [float(self(at)) for at in self.x if ends[0] < at < ends[1]]
        return around(*values), around(*slopes)

    @property
    def _last_slope(self) -> float:
        a, b, c, _ = self.c[:, -1]
        s = self.x[-1] - self.x[-2]
        return float((3.0 * a * s + 2.0 * b) * s + c)


@lru_cache(maxsize=256)
def pieces(smooth: bool, points: tuple[float, ...]) -> Pieces:
    """Return the table of x1, y1, x2, y2, .."""
    x, y = np.array(points[::2]), np.array(points[1::2])
    if smooth:
        from scipy.interpolate import PchipInterpolator
        return Pieces(x, PchipInterpolator(x, y).c)
    return Pieces(x, np.vstack([np.zeros((2, len(x) - 1)), np.diff(y) / np.diff(x), y[:-1]]))


def wrong_points(points: Sequence[float]) -> str:
    """Return what is wrong with x1, y1, x2, y2, .., or ''."""
    x, y = points[::2], points[1::2]
    if len(x) != len(y) or not 2 <= len(x) <= MOST_POINTS:
        return f'does not have 2 to {MOST_POINTS} points'
    if not all(a < b for a, b in zip(x, x[1:])):
        return 'has points that do not rise in x'
    return ''


def _value(smooth: bool, x: Any, *points: float) -> Any:
    return pieces(smooth, tuple(map(float, points)))(x)


def _slope(smooth: bool, x: float, *points: float) -> float:
    return pieces(smooth, tuple(map(float, points))).slope(float(x))


def _bounds(smooth: bool, x: Interval, *points: Interval) -> Bounds:
    value, slope = pieces(smooth, tuple(low for low, _ in points)).bounds(x)
    return value, (slope, *[ZERO] * len(points))


def _entry(name: str, smooth: bool, meaning: str) -> Function:
    return Function(name, ('x', 'x1', 'y1', '..'), meaning, partial(_value, smooth),
                    slopes=(partial(_slope, smooth),), bounds=partial(_bounds, smooth))


TABLES = {'table': _entry('table', False, 'straight between points'),
          'smooth_table': _entry('smooth_table', True, 'a cubic that keeps their shape')}
