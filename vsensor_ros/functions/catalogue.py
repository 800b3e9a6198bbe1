"""
The entries of the functions of the language.

Every value is finite for finite arguments of ordinary size: outside its domain a function
is continued, never NaN, and the continuation is monotone where the function is, so that an
observer that still converges is pulled back (the method, section 5). What no continuation
can mend is overflow: products and powers beyond 1e308 give inf as everywhere in numpy.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from vsensor_ros.functions.function import Bounds, constant, Function
from vsensor_ros.functions.interval import (
    add,
    ANY,
    around,
    cosine,
    INFINITY,
    Interval,
    inverse,
    negative,
    ONE,
    outward,
    RISING,
    shifted,
    size,
    times,
    UNIT,
    ZERO,
)
from vsensor_ros.functions.operators import odd_root, power_bounds

LOG_FLOOR = 1e-6    # below it log is continued along its tangent
EXP_CEILING = 700.0  # above it exp is constant; exp(709.8) overflows


def _kink(where: bool, slope: float) -> float:
    return float('nan') if where else slope


def _sign_bounds(x: Interval) -> Bounds:
    return (float(np.sign(x[0])), float(np.sign(x[1]))), (
        RISING if x[0] <= 0.0 <= x[1] else ZERO,)


def _sqrt_bounds(x: Interval) -> Bounds:
    value, (slope, _) = power_bounds(x, (0.5, 0.5))
    return value, (slope,)


def _abs_bounds(x: Interval) -> Bounds:
    return size(x), ((1.0 if x[0] >= 0.0 < x[1] else -1.0, -1.0 if x[1] <= 0.0 > x[0] else 1.0),)


def _tan_bounds(x: Interval) -> Bounds:
    near = cosine(x)
    if near[0] <= 0.0 <= near[1]:
        return ANY, (ANY,)
    value = around(math.tan(x[0]), math.tan(x[1]))
    least, most = size(value)
    return value, (outward(1.0 + least * least, 1.0 + most * most),)


def _asin(x: Any) -> Any:
    inside = np.minimum(np.maximum(x, -1.0), 1.0)
    return np.arcsin(inside) + (x - inside)


def _asin_bounds(x: Interval) -> Bounds:
    def value(a: float) -> float:
        inside = min(max(a, -1.0), 1.0)
        return math.asin(inside) + (a - inside)

    least, most = size(x)
    steepest = min(most, 1.0)
    low = 1.0 if most > 1.0 or least >= 1.0 else 1.0 / math.sqrt(1.0 - least * least)
    high = (1.0 if least > 1.0 else INFINITY) if steepest >= 1.0 else \
        1.0 / math.sqrt(1.0 - steepest * steepest)
    return around(value(x[0]), value(x[1])), (outward(low, high),)


def _atan_bounds(x: Interval) -> Bounds:
    least, most = size(x)
    return around(math.atan(x[0]), math.atan(x[1])), (
        around(1.0 / (1.0 + most * most), 1.0 / (1.0 + least * least)),)


def _atan2_bounds(y: Interval, x: Interval) -> Bounds:
    if x[0] <= 0.0 and y[0] <= 0.0 <= y[1]:  # the origin or the cut
        return (-math.pi, math.pi), (ANY, ANY)
    (x_least, x_most), (y_least, y_most) = size(x), size(y)
    over = inverse((x_least * x_least + y_least * y_least, x_most * x_most + y_most * y_most))
    value = around(*(math.atan2(a, b) for a in y for b in x))
    return value, (times(x, over), negative(times(y, over)))


def _tanh_bounds(x: Interval) -> Bounds:
    least, most = size(x)
    # 1 / cosh**2 and not 1 - tanh**2, which loses all digits far out
    return around(math.tanh(x[0]), math.tanh(x[1])), (
        around(*(float(np.cosh(min(a, 300.0))) ** -2 if a < 300.0 else 0.0
                 for a in (least, most))),)


def _exp_bounds(x: Interval) -> Bounds:
    ends = [math.exp(min(e, EXP_CEILING)) for e in x]
    value = around(*ends)
    return value, ((0.0 if x[1] > EXP_CEILING else value[0],
                    0.0 if x[0] > EXP_CEILING else value[1]),)


def _log(x: Any) -> Any:
    return np.log(np.maximum(x, LOG_FLOOR)) + np.minimum(x - LOG_FLOOR, 0.0) / LOG_FLOOR


def _log_bounds(x: Interval) -> Bounds:
    def value(a: float) -> float:
        return math.log(max(a, LOG_FLOOR)) + min(a - LOG_FLOOR, 0.0) / LOG_FLOOR
    return around(value(x[0]), value(x[1])), (
        around(1.0 / max(x[1], LOG_FLOOR), 1.0 / max(x[0], LOG_FLOOR)),)


def _min_bounds(a: Interval, b: Interval) -> Bounds:
    value = min(a[0], b[0]), min(a[1], b[1])
    if a[1] <= b[0] or b[1] <= a[0]:
        return value, (ONE, ZERO) if a[1] <= b[0] else (ZERO, ONE)
    return value, (UNIT, UNIT)


def _max_bounds(a: Interval, b: Interval) -> Bounds:
    value, slopes = _min_bounds(negative(a), negative(b))
    return negative(value), slopes


def _sat_bounds(x: Interval, low: Interval, high: Interval) -> Bounds:
    raised, (by_x, by_low) = _max_bounds(x, low)
    value, (by_raised, by_high) = _min_bounds(raised, high)
    return value, (times(by_raised, by_x), times(by_raised, by_low), by_high)


def _deadzone_bounds(x: Interval, width: Interval) -> Bounds:
    value, (by_x, by_low, by_high) = _sat_bounds(x, negative(width), width)
    return add(x, negative(value)), (
        (1.0 - by_x[1], 1.0 - by_x[0]), add(by_low, negative(by_high)))


_ALL = (
    Function(
        'sign', ('x',), '-1, 0 or 1; a term that is a sign alone is dry friction: at 0, whatever '
        'between -1 and 1 holds x there', np.sign,
        slopes=(lambda x: _kink(x == 0.0, 0.0),),
        bounds=_sign_bounds, slope_bounds=RISING, set_valued=True),
    Function(
        'sqrt', ('x',), 'square root', odd_root,
        slopes=(lambda x: 0.5 / abs(x) ** 0.5 if x else INFINITY,),
        bounds=_sqrt_bounds, slope_bounds=RISING,
        outside=lambda x: np.less(x, 0.0),
        domain='x >= 0', continuation='odd: sgn(x) sqrt(|x|)'),
    Function(
        'abs', ('x',), 'size', np.abs,
        slopes=(lambda x: _kink(x == 0.0, float(np.sign(x))),),
        bounds=_abs_bounds, slope_bounds=(-1.0, 1.0)),
    Function(
        'sin', ('x',), 'sine, x in rad', np.sin, slopes=(np.cos,),
        bounds=lambda x: (cosine(shifted(x, -math.pi / 2)), (cosine(x),)),
        slope_bounds=(-1.0, 1.0)),
    Function(
        'cos', ('x',), 'cosine, x in rad', np.cos, slopes=(lambda x: -np.sin(x),),
        bounds=lambda x: (cosine(x), (cosine(shifted(x, math.pi / 2)),)),
        slope_bounds=(-1.0, 1.0)),
    Function(
        'tan', ('x',), 'tangent, x in rad', np.tan, slopes=(lambda x: 1.0 + np.tan(x) ** 2,),
        bounds=_tan_bounds),
    Function(
        'asin', ('x',), 'arc sine, in rad', _asin,
        slopes=(lambda x: 1.0 / (1.0 - x * x) ** 0.5 if abs(x) < 1.0
                else (INFINITY if abs(x) == 1.0 else 1.0),),
        bounds=_asin_bounds, slope_bounds=(1.0, INFINITY),
        outside=lambda x: np.greater(np.abs(x), 1.0),
        domain='-1 <= x <= 1', continuation='straight on with slope 1'),
    Function(
        'atan', ('x',), 'arc tangent, in rad', np.arctan, slopes=(lambda x: 1.0 / (1.0 + x * x),),
        bounds=_atan_bounds, slope_bounds=UNIT),
    Function(
        'atan2', ('y', 'x'), 'angle of the point (x, y), in rad', np.arctan2,
        slopes=(lambda y, x: x / (x * x + y * y) if x or y else INFINITY,
                lambda y, x: -y / (x * x + y * y) if x or y else INFINITY),
        bounds=_atan2_bounds),
    Function(
        'tanh', ('x',), 'hyperbolic tangent', np.tanh, slopes=(lambda x: 1.0 - np.tanh(x) ** 2,),
        bounds=_tanh_bounds, slope_bounds=UNIT),
    Function(
        'exp', ('x',), 'e to the power of x', lambda x: np.exp(np.minimum(x, EXP_CEILING)),
        slopes=(lambda x: np.exp(x) if x < EXP_CEILING else 0.0,),
        bounds=_exp_bounds, slope_bounds=RISING,
        outside=lambda x: np.greater(x, EXP_CEILING),
        domain=f'x <= {EXP_CEILING:g}', continuation='constant'),
    Function(
        'log', ('x',), 'natural logarithm', _log, slopes=(lambda x: 1.0 / max(x, LOG_FLOOR),),
        bounds=_log_bounds, slope_bounds=(0.0, 1.0 / LOG_FLOOR),
        outside=lambda x: np.less(x, LOG_FLOOR),
        domain=f'x >= {LOG_FLOOR:g}', continuation='along its tangent there'),
    Function(
        'min', ('a', 'b'), 'the smaller one', np.minimum,
        slopes=(lambda a, b: _kink(a == b, float(a < b)),
                lambda a, b: _kink(a == b, float(b < a))),
        bounds=_min_bounds, slope_bounds=UNIT),
    Function(
        'max', ('a', 'b'), 'the larger one', np.maximum,
        slopes=(lambda a, b: _kink(a == b, float(a > b)),
                lambda a, b: _kink(a == b, float(b > a))),
        bounds=_max_bounds, slope_bounds=UNIT),
    Function(
        'sat', ('x', 'low', 'high'), 'x, but never below low nor above high',
        lambda x, lo, hi: np.minimum(np.maximum(x, lo), hi),
        slopes=(lambda x, lo, hi: _kink(x in (lo, hi), float(lo < x < hi)),
                lambda x, lo, hi: _kink(x == lo, float(x < lo < hi)),
                lambda x, lo, hi: _kink(x == hi, float(max(x, lo) > hi))),
        bounds=_sat_bounds, slope_bounds=UNIT,
        outside=lambda x, lo, hi: np.greater(lo, hi),
        kept_inside=lambda x, lo, hi: constant(lo, hi),
        domain='low <= high', continuation='high'),
    Function(
        'deadzone', ('x', 'width'), '0 while |x| <= width, else what goes beyond it',
        lambda x, width: x - np.minimum(np.maximum(x, -width), width),
        slopes=(lambda x, width: _kink(abs(x) == width, float(abs(x) > width)),
                lambda x, width: _kink(abs(x) == width,
                                       float(-np.sign(x)) if abs(x) > width else 0.0)),
        bounds=_deadzone_bounds, slope_bounds=UNIT,
        outside=lambda x, width: np.less(width, 0.0),
        kept_inside=lambda x, width: constant(width),
        domain='width >= 0', continuation='x - width'),
)

CATALOGUE: dict[str, Function] = {function.name: function for function in _ALL}
