"""The entries of the operators: + - * / ** and the sign in front."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from vsensor_ros.functions.function import Bounds, constant, Function
from vsensor_ros.functions.interval import (
    add,
    ANY,
    around,
    INFINITY,
    Interval,
    inverse,
    MINUS_ONE,
    negative,
    ONE,
    raised,
    size,
    times,
    ZERO,
)


def _divide(a: Any, b: Any) -> Any:
    if isinstance(b, float):
        return a / b if b else 0.0 * a
    zero = np.equal(b, 0.0)
    if not np.any(zero):
        return a / b
    return np.where(zero, 0.0, a / np.where(zero, 1.0, b))


def _divide_bounds(a: Interval, b: Interval) -> Bounds:
    over = inverse(b)
    if b[0] <= 0.0 <= b[1]:
        return times(a, over), (over, ANY)
    return times(a, over), (over, negative(times(a, times(over, over))))


def odd_root(x: Any) -> Any:
    """Return sgn(x) sqrt(|x|), elementwise."""
    return np.copysign(np.sqrt(np.abs(x)), x)


def power(x: Any, p: Any) -> Any:
    """Return x**p, elementwise: odd in x for a fractional p; 0 to a negative power is 0."""
    if isinstance(p, float):
        if p == 2.0:
            return x * x
        if p == 0.5:
            return odd_root(x)
        if p < 0.0:
            return _divide(1.0, np.asarray(power(x, -p)))
        return np.power(x, p) if p.is_integer() else np.copysign(np.power(np.abs(x), p), x)
    length = np.power(np.abs(x), np.abs(p))
    length = np.where(np.less(p, 0.0), _divide(1.0, length), length)
    even = np.equal(np.mod(p, 2.0), 0.0)
    return np.where(even, length, np.copysign(length, x))


def power_bounds(x: Interval, p: Interval) -> Bounds:
    """Bound ``power`` and its slopes by x and by p."""
    if p[0] != p[1]:
        if x[0] <= 0.0:
            return ANY, (ANY, ANY)
        value = around(*(raised(a, b) for a in x for b in p))
        slope = around(*(raised(a, b - 1.0) for a in x for b in p))
        return value, (times(p, slope), times(value, around(*np.log(x))))
    c = p[0]
    if c == 0.0:
        return ONE, (ZERO, ANY)
    if c < 0.0 and x[0] <= 0.0 <= x[1]:
        return ANY, (ANY, ANY)
    least, most = size(x)
    if c % 2.0 == 0.0:  # even: |x|**c
        ends = [math.copysign(c * raised(abs(e), c - 1.0), e * c) for e in x]
        return around(raised(least, c), raised(most, c)), (around(*ends), ANY)
    value = around(*(math.copysign(raised(abs(e), c), e) for e in x))
    return value, (around(c * raised(least, c - 1.0), c * raised(most, c - 1.0)), ANY)


def _power_outside(x: Any, p: Any) -> Any:
    fractional = np.greater(np.mod(p, 1.0), 0.0)
    return (np.less(x, 0.0) & fractional) | (np.equal(x, 0.0) & np.less(p, 0.0))


def _power_slope(x: float, p: float) -> float:
    if p == 0.0:
        return 0.0
    if float(p).is_integer():
        return p * float(power(x, p - 1.0)) if x or p >= 1.0 else INFINITY
    return p * abs(x) ** (p - 1.0) if x else (0.0 if p > 1.0 else INFINITY)


def _power_exponent_slope(x: float, p: float) -> float:
    return float(power(x, p)) * np.log(x) if x > 0.0 else float('nan')


_ALL = (
    Function(
        '+', ('a', 'b'), 'sum', np.add,
        slopes=(lambda a, b: 1.0, lambda a, b: 1.0),
        bounds=lambda a, b: (add(a, b), (ONE, ONE)),
        precedence=1),
    Function(
        '-', ('a', 'b'), 'difference', np.subtract,
        slopes=(lambda a, b: 1.0, lambda a, b: -1.0),
        bounds=lambda a, b: (add(a, negative(b)), (ONE, MINUS_ONE)),
        precedence=1),
    Function(
        '*', ('a', 'b'), 'product', np.multiply,
        slopes=(lambda a, b: b, lambda a, b: a),
        bounds=lambda a, b: (times(a, b), (b, a)),
        precedence=2),
    Function(
        '/', ('a', 'b'), 'quotient', _divide,
        slopes=(lambda a, b: 1.0 / b if b else INFINITY,
                lambda a, b: -a / (b * b) if b else INFINITY),
        bounds=_divide_bounds,
        outside=lambda a, b: np.equal(b, 0.0) | np.zeros(np.shape(a), bool),
        kept_inside=lambda a, b: constant(b),
        domain='divisor not 0', continuation='0',
        precedence=2),
    Function(
        '**', ('x', 'p'), 'power', power,
        slopes=(_power_slope, _power_exponent_slope),
        bounds=power_bounds,
        outside=_power_outside,
        kept_inside=lambda x, p: constant(p) and p >= 0.0 and p.is_integer(),
        domain='base not negative, or a whole exponent; base not 0 if the exponent is < 0',
        continuation='odd: sgn(x) |x|**p for a fractional p; 0 to a negative power is 0',
        precedence=4),
    Function(
        'neg', ('x',), 'the same with the other sign', np.negative,
        slopes=(lambda x: -1.0,),
        bounds=lambda x: (negative(x), (MINUS_ONE,)),
        precedence=3),
)

OPERATORS: dict[str, Function] = {operator.name: operator for operator in _ALL}
