"""
The functions and operators of the expression language: value, slope, domain.

Every value is finite for finite arguments of ordinary size: outside its domain a function
is continued, never NaN, and the continuation is monotone where the function is, so that an
observer that still converges is pulled back (the method, section 6). What no continuation
can mend is overflow: products and powers beyond 1e308 give inf as everywhere in numpy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

INFINITY = float('inf')
LOG_FLOOR = 1e-6    # below it log is continued along its tangent
EXP_CEILING = 700.0  # above it exp is constant; exp(709.8) overflows


@dataclass(frozen=True, eq=False)
class Function:
    """
    One function of the language.

    value: numpy, elementwise, continued outside the domain.
    slopes: partial derivatives, one an argument, of scalars; not finite at a kink.
    slope_bounds: (a, b) of all difference quotients in the first argument, the others
    fixed, over the whole line with the continuation; None when there are none.
    outside: elementwise, whether the arguments lie outside the domain, NaN being inside;
    None: no limit.
    """

    name: str
    arity: int
    value: Callable[..., Any]
    slopes: tuple[Callable[..., float], ...]
    slope_bounds: tuple[float, float] | None = None
    set_valued: bool = False
    outside: Callable[..., Any] | None = None
    domain: str = 'all numbers'
    continuation: str = ''


def _divide(a: Any, b: Any) -> Any:
    if isinstance(b, float):
        return a / b if b else 0.0 * a
    zero = np.equal(b, 0.0)
    if not np.any(zero):
        return a / b
    return np.where(zero, 0.0, a / np.where(zero, 1.0, b))


def _power(x: Any, p: Any) -> Any:
    if isinstance(p, float):
        if p == 2.0:
            return x * x
        if p == 0.5:
            return _sqrt(x)
        if p < 0.0:
            return _divide(1.0, np.asarray(_power(x, -p)))
        return np.power(x, p) if p.is_integer() else np.copysign(np.power(np.abs(x), p), x)
    size = np.power(np.abs(x), np.abs(p))
    size = np.where(np.less(p, 0.0), _divide(1.0, size), size)
    even = np.equal(np.mod(p, 2.0), 0.0)
    return np.where(even, size, np.copysign(size, x))


def _power_outside(x: Any, p: Any) -> Any:
    fractional = np.greater(np.mod(p, 1.0), 0.0)
    return (np.less(x, 0.0) & fractional) | (np.equal(x, 0.0) & np.less(p, 0.0))


def _power_slope(x: float, p: float) -> float:
    if p == 0.0:
        return 0.0
    if float(p).is_integer():
        return p * float(_power(x, p - 1.0)) if x or p >= 1.0 else INFINITY
    return p * abs(x) ** (p - 1.0) if x else (0.0 if p > 1.0 else INFINITY)


def _power_exponent_slope(x: float, p: float) -> float:
    return float(_power(x, p)) * np.log(x) if x > 0.0 else float('nan')


def _sqrt(x: Any) -> Any:
    return np.copysign(np.sqrt(np.abs(x)), x)


def _log(x: Any) -> Any:
    return np.log(np.maximum(x, LOG_FLOOR)) + np.minimum(x - LOG_FLOOR, 0.0) / LOG_FLOOR


def _asin(x: Any) -> Any:
    inside = np.minimum(np.maximum(x, -1.0), 1.0)
    return np.arcsin(inside) + (x - inside)


def _kink(where: bool, slope: float) -> float:
    return float('nan') if where else slope


_ALL = [
    Function('+', 2, np.add, (lambda a, b: 1.0, lambda a, b: 1.0)),
    Function('-', 2, np.subtract, (lambda a, b: 1.0, lambda a, b: -1.0)),
    Function('*', 2, np.multiply, (lambda a, b: b, lambda a, b: a)),
    Function('/', 2, _divide,
             (lambda a, b: 1.0 / b if b else INFINITY,
              lambda a, b: -a / (b * b) if b else INFINITY),
             outside=lambda a, b: np.equal(b, 0.0) | np.zeros(np.shape(a), bool),
             domain='divisor not 0', continuation='a/0 is 0'),
    Function('**', 2, _power, (_power_slope, _power_exponent_slope),
             outside=_power_outside,
             domain='base not negative, or a whole exponent; base not 0 if the exponent is < 0',
             continuation='sgn(x)*|x|**p for a fractional exponent; 0 to a negative power is 0'),
    Function('neg', 1, np.negative, (lambda x: -1.0,)),
    Function('sign', 1, np.sign, (lambda x: _kink(x == 0.0, 0.0),), (0.0, INFINITY),
             set_valued=True),
    Function('sqrt', 1, _sqrt, (lambda x: 0.5 / abs(x) ** 0.5 if x else INFINITY,),
             (0.0, INFINITY), outside=lambda x: np.less(x, 0.0),
             domain='x >= 0', continuation='odd: sgn(x)*sqrt(|x|)'),
    Function('abs', 1, np.abs, (lambda x: _kink(x == 0.0, float(np.sign(x))),), (-1.0, 1.0)),
    Function('sin', 1, np.sin, (np.cos,), (-1.0, 1.0)),
    Function('cos', 1, np.cos, (lambda x: -np.sin(x),), (-1.0, 1.0)),
    Function('tan', 1, np.tan, (lambda x: 1.0 + np.tan(x) ** 2,)),
    Function('asin', 1, _asin,
             (lambda x: 1.0 / (1.0 - x * x) ** 0.5 if abs(x) < 1.0
              else (INFINITY if abs(x) == 1.0 else 1.0),),
             (1.0, INFINITY), outside=lambda x: np.greater(np.abs(x), 1.0),
             domain='-1 <= x <= 1', continuation='straight on with slope 1'),
    Function('atan', 1, np.arctan, (lambda x: 1.0 / (1.0 + x * x),), (0.0, 1.0)),
    Function('atan2', 2, np.arctan2,
             (lambda y, x: x / (x * x + y * y) if x or y else INFINITY,
              lambda y, x: -y / (x * x + y * y) if x or y else INFINITY)),
    Function('tanh', 1, np.tanh, (lambda x: 1.0 - np.tanh(x) ** 2,), (0.0, 1.0)),
    Function('exp', 1, lambda x: np.exp(np.minimum(x, EXP_CEILING)),
             (lambda x: np.exp(x) if x < EXP_CEILING else 0.0,), (0.0, INFINITY),
             outside=lambda x: np.greater(x, EXP_CEILING),
             domain=f'x <= {EXP_CEILING:g}', continuation='constant'),
    Function('log', 1, _log, (lambda x: 1.0 / max(x, LOG_FLOOR),), (0.0, 1.0 / LOG_FLOOR),
             outside=lambda x: np.less(x, LOG_FLOOR),
             domain=f'x >= {LOG_FLOOR:g}', continuation='along its tangent there'),
    Function('min', 2, np.minimum,
             (lambda a, b: _kink(a == b, float(a < b)), lambda a, b: _kink(a == b, float(b < a))),
             (0.0, 1.0)),
    Function('max', 2, np.maximum,
             (lambda a, b: _kink(a == b, float(a > b)), lambda a, b: _kink(a == b, float(b > a))),
             (0.0, 1.0)),
    Function('sat', 3, lambda x, lo, hi: np.minimum(np.maximum(x, lo), hi),
             (lambda x, lo, hi: _kink(x in (lo, hi), float(lo < x < hi)),
              lambda x, lo, hi: _kink(x == lo, float(x < lo < hi)),
              lambda x, lo, hi: _kink(x == hi, float(max(x, lo) > hi))),
             (0.0, 1.0), outside=lambda x, lo, hi: np.greater(lo, hi),
             domain='low <= high', continuation='high'),
    Function('deadzone', 2, lambda x, width: x - np.minimum(np.maximum(x, -width), width),
             (lambda x, width: _kink(abs(x) == width, float(abs(x) > width)),
              lambda x, width: _kink(abs(x) == width,
                                     float(-np.sign(x)) if abs(x) > width else 0.0)),
             (0.0, 1.0), outside=lambda x, width: np.less(width, 0.0),
             domain='width >= 0', continuation='x - width'),
]

_OPERATOR_NAMES = ('+', '-', '*', '/', '**', 'neg')
OPERATORS: dict[str, Function] = {f.name: f for f in _ALL if f.name in _OPERATOR_NAMES}
CATALOGUE: dict[str, Function] = {f.name: f for f in _ALL if f.name not in _OPERATOR_NAMES}
