"""
Arithmetic of intervals, with which the functions say between which bounds they stay.

An interval is a pair (low, high). Its ends may be infinite; they bound real numbers, so 0 times
infinity is 0. Results are rounded outward.
"""

from __future__ import annotations

import math
import sys

import numpy as np

Interval = tuple[float, float]

INFINITY = math.inf
ANY: Interval = (-INFINITY, INFINITY)
ZERO: Interval = (0.0, 0.0)
ONE: Interval = (1.0, 1.0)
MINUS_ONE: Interval = (-1.0, -1.0)
UNIT: Interval = (0.0, 1.0)
RISING: Interval = (0.0, INFINITY)
_ROUNDING = 1e-15  # relative, more than the rounding of any one operation


def outward(low: float, high: float) -> Interval:
    """Return an interval that is wider by more than rounding."""
    low = low * (1 + _ROUNDING) if low < 0 else min(low * (1 - _ROUNDING), sys.float_info.max)
    high = high * (1 + _ROUNDING) if high > 0 else max(high * (1 - _ROUNDING),
                                                       -sys.float_info.max)
    return low, high


def around(*values: float) -> Interval:
    """Return the interval from the least to the largest value."""
    return outward(float(min(values)), float(max(values)))


def hull(a: Interval, b: Interval) -> Interval:
    """Return the interval that holds both."""
    return min(a[0], b[0]), max(a[1], b[1])


def add(a: Interval, b: Interval) -> Interval:
    """Bound a + b."""
    if a == ZERO or b == ZERO:
        return b if a == ZERO else a
    return outward(a[0] + b[0], a[1] + b[1])


def negative(a: Interval) -> Interval:
    """Return -a."""
    return -a[1], -a[0]


def times(a: Interval, b: Interval) -> Interval:
    """Bound a b."""
    if a == ONE or b == ONE:
        return b if a == ONE else a
    return around(*(x * y if x and y else 0.0 for x in a for y in b))


def size(a: Interval) -> Interval:
    """Return |a|."""
    if a[0] <= 0.0 <= a[1]:
        return 0.0, max(-a[0], a[1])
    return min(abs(a[0]), abs(a[1])), max(abs(a[0]), abs(a[1]))


def inverse(a: Interval) -> Interval:
    """Bound 1/a, where 1/0 is continued by 0."""
    if a[0] < 0.0 < a[1]:
        return ANY
    if a == ZERO:
        return ZERO
    if 0.0 in a:
        return (0.0, INFINITY) if a[1] > 0.0 else (-INFINITY, 0.0)
    return around(1.0 / a[0], 1.0 / a[1])


def raised(x: float, p: float) -> float:
    """Return x**p for a number x >= 0, and infinity where a negative power meets 0."""
    if x == 0.0:
        return INFINITY if p < 0.0 else float(p == 0.0)
    return float(np.power(x, p))


def shifted(x: Interval, by: float) -> Interval:
    """Move both ends, without rounding outward."""
    return x[0] + by, x[1] + by


def cosine(x: Interval) -> Interval:
    """Bound cos x."""
    low, high = x[0] - 1e-12, x[1] + 1e-12
    if not high - low < 2.0 * math.pi or max(-low, high) > 1e6:  # no digits left further out
        return -1.0, 1.0

    def crosses(phase: float) -> bool:
        return math.floor((high - phase) / (2.0 * math.pi)) \
            >= math.ceil((low - phase) / (2.0 * math.pi))
    ends = [math.cos(x[0]), math.cos(x[1])]
    return (-1.0 if crosses(math.pi) else max(-1.0, min(ends) - 1e-15),
            1.0 if crosses(0.0) else min(1.0, max(ends) + 1e-15))
