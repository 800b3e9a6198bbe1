"""
Between which bounds the slopes of a nonlinear term lie when its arguments stay in a box.

Interval arithmetic in forward mode over the expression tree: every part carries the interval of
its values and, for each argument w, the interval of its difference quotients along w with the
other arguments held. Both hold for the continuations outside the domains too. An interval is a
pair (low, high) of real numbers' bounds; the ends may be infinite, so 0 times infinity is 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
import math
import sys

import numpy as np

from vsensor_ros.functions.catalogue import EXP_CEILING, LOG_FLOOR
from vsensor_ros.functions.expression import Apply, fold, Name, names, Node, Number, parse
from vsensor_ros.functions.nonlinearity import argument_names, NonlinearTerm

Interval = tuple[float, float]
Extension = Callable[..., tuple[Interval, tuple[Interval, ...]]]

CELLS = 128  # into which a box is cut; w*abs(w) needs it cut at 0, exp(-w**2) finely
_ROUNDING = 1e-15  # relative, more than the rounding of any one operation
_INF = math.inf
_ANY = (-_INF, _INF)
_ZERO, _ONE, _UNIT, _RISING = (0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, _INF)


def slope_bounds_on(term: NonlinearTerm, box: np.ndarray, inputs: Sequence[str],
                    input_box: np.ndarray) -> tuple[Interval, ...]:
    """
    Bound the difference quotients of psi (the addend included) along each of its r arguments.

    box (r, 2) and input_box (m, 2), -inf and inf where nothing is known. Returns r pairs: for
    two points of the box and the same inputs, psi(w) - psi(w') = sum_j s_j (w_j - w'_j) with
    every s_j in its pair. (0, inf) is a term that never falls along that argument (sign, the odd
    square root at 0); (-inf, inf): nothing can be said. Source: the method, 3.5.
    """
    arguments = argument_names(len(term.slope))
    node = fold(parse(term.text, 'nonlinearity', term.name))
    ranges = {name: (float(low), float(high)) for name, (low, high)
              in zip((*arguments, *inputs), np.vstack([box, input_box]))}
    used = [name for name in names(node) if ranges[name][0] < ranges[name][1]]
    pieces = max(2, int(CELLS ** (1.0 / max(1, len(used)))))
    total: list[Interval] | None = None
    with np.errstate(all='ignore'):
        for cell in product(*(_cut(ranges[name], pieces) for name in used)):
            slopes = _ranged(node, {**ranges, **dict(zip(used, cell))}, arguments)[1]
            total = slopes if total is None else [_hull(a, b) for a, b in zip(total, slopes)]
    assert total is not None
    return tuple((low - float(s), high - float(s)) for (low, high), s in zip(total, term.slope))


def _cut(whole: Interval, pieces: int) -> list[Interval]:
    # evenly, or evenly in the arc tangent where it is infinite; always at 0, where kinks are
    low, high = whole
    if math.isinf(low) or math.isinf(high):
        ends = np.tan(np.linspace(math.atan(low), math.atan(high), pieces + 1))
    else:
        ends = np.linspace(low, high, pieces + 1)
    inner = sorted({0.0, *map(float, ends[1:-1])})
    points = [low, *(p for p in inner if low < p < high), high]
    return list(zip(points, points[1:]))


def _ranged(node: Node, ranges: Mapping[str, Interval],
            arguments: Sequence[str]) -> tuple[Interval, list[Interval]]:
    if isinstance(node, Number):
        return (node.value, node.value), [_ZERO] * len(arguments)
    if isinstance(node, Name):
        return ranges[node.id], [_ONE if node.id == a else _ZERO for a in arguments]
    parts = [_ranged(a, ranges, arguments) for a in node.arguments]
    value, outer = EXTENSIONS[node.function](*(value for value, _ in parts))
    slopes = [_ZERO] * len(arguments)
    for slope, (_, inner) in zip(outer, parts):
        slopes = [_add(total, _times(slope, one)) for total, one in zip(slopes, inner)]
    return value, slopes


# ------------------------------------------------------------------------------ arithmetic

def _outward(low: float, high: float) -> Interval:
    low = low * (1 + _ROUNDING) if low < 0 else min(low * (1 - _ROUNDING), sys.float_info.max)
    high = high * (1 + _ROUNDING) if high > 0 else max(high * (1 - _ROUNDING),
                                                       -sys.float_info.max)
    return low, high


def _sorted(*values: float) -> Interval:
    return _outward(float(min(values)), float(max(values)))


def _hull(a: Interval, b: Interval) -> Interval:
    return min(a[0], b[0]), max(a[1], b[1])


def _add(a: Interval, b: Interval) -> Interval:
    if a == _ZERO or b == _ZERO:
        return b if a == _ZERO else a
    return _outward(a[0] + b[0], a[1] + b[1])


def _negative(a: Interval) -> Interval:
    return -a[1], -a[0]


def _times(a: Interval, b: Interval) -> Interval:
    if a == _ONE or b == _ONE:
        return b if a == _ONE else a
    return _sorted(*(x * y if x and y else 0.0 for x in a for y in b))


def _size(a: Interval) -> Interval:
    # |a|
    if a[0] <= 0.0 <= a[1]:
        return 0.0, max(-a[0], a[1])
    return min(abs(a[0]), abs(a[1])), max(abs(a[0]), abs(a[1]))


def _inverse(a: Interval) -> Interval:
    # of 1/x, and 0 at 0 (the continuation)
    if a[0] < 0.0 < a[1]:
        return _ANY
    if a == _ZERO:
        return _ZERO
    if 0.0 in a:
        return (0.0, _INF) if a[1] > 0.0 else (-_INF, 0.0)
    return _sorted(1.0 / a[0], 1.0 / a[1])


def _raised(x: float, p: float) -> float:
    # x**p for x >= 0, infinity where a negative power meets 0
    if x == 0.0:
        return _INF if p < 0.0 else float(p == 0.0)
    return float(np.power(x, p))


# -------------------------------------------------- the functions: values, slopes by arguments

def _divide(a: Interval, b: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    inverse = _inverse(b)
    if b[0] <= 0.0 <= b[1]:
        return _times(a, inverse), (inverse, _ANY)
    return _times(a, inverse), (inverse, _negative(_times(a, _times(inverse, inverse))))


def _power(x: Interval, p: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    if p[0] != p[1]:
        if x[0] <= 0.0:
            return _ANY, (_ANY, _ANY)
        value = _sorted(*(_raised(a, b) for a in x for b in p))
        slope = _sorted(*(_raised(a, b - 1.0) for a in x for b in p))
        return value, (_times(p, slope), _times(value, _sorted(*np.log(x))))
    c = p[0]
    if c == 0.0:
        return _ONE, (_ZERO, _ANY)
    if c < 0.0 and x[0] <= 0.0 <= x[1]:
        return _ANY, (_ANY, _ANY)
    least, most = _size(x)
    if c % 2.0 == 0.0:  # even: |x|**c
        ends = [math.copysign(c * _raised(abs(e), c - 1.0), e * c) for e in x]
        return _sorted(_raised(least, c), _raised(most, c)), (_sorted(*ends), _ANY)
    value = _sorted(*(math.copysign(_raised(abs(e), c), e) for e in x))
    return value, (_sorted(c * _raised(least, c - 1.0), c * _raised(most, c - 1.0)), _ANY)


def _sign(x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    return (float(np.sign(x[0])), float(np.sign(x[1]))), (
        _RISING if x[0] <= 0.0 <= x[1] else _ZERO,)


def _abs(x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    return _size(x), ((1.0 if x[0] >= 0.0 < x[1] else -1.0, -1.0 if x[1] <= 0.0 > x[0] else 1.0),)


def _cosine(x: Interval) -> Interval:
    low, high = x[0] - 1e-12, x[1] + 1e-12
    if not high - low < 2.0 * math.pi or max(-low, high) > 1e6:  # no digits left further out
        return -1.0, 1.0

    def crosses(phase: float) -> bool:
        return math.floor((high - phase) / (2.0 * math.pi)) \
            >= math.ceil((low - phase) / (2.0 * math.pi))
    ends = [math.cos(x[0]), math.cos(x[1])]
    return (-1.0 if crosses(math.pi) else max(-1.0, min(ends) - 1e-15),
            1.0 if crosses(0.0) else min(1.0, max(ends) + 1e-15))


def _shifted(x: Interval, by: float) -> Interval:
    return x[0] + by, x[1] + by


def _tan(x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    cosine = _cosine(x)
    if cosine[0] <= 0.0 <= cosine[1]:
        return _ANY, (_ANY,)
    value = _sorted(math.tan(x[0]), math.tan(x[1]))
    least, most = _size(value)
    return value, (_outward(1.0 + least * least, 1.0 + most * most),)


def _asin(x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    def value(a: float) -> float:
        inside = min(max(a, -1.0), 1.0)
        return math.asin(inside) + (a - inside)

    least, most = _size(x)
    steepest = min(most, 1.0)
    low = 1.0 if most > 1.0 or least >= 1.0 else 1.0 / math.sqrt(1.0 - least * least)
    high = (1.0 if least > 1.0 else _INF) if steepest >= 1.0 else \
        1.0 / math.sqrt(1.0 - steepest * steepest)
    return _sorted(value(x[0]), value(x[1])), (_outward(low, high),)


def _sqrt(x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    return _power(x, (0.5, 0.5))[0], _power(x, (0.5, 0.5))[1][:1]


def _atan(x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    least, most = _size(x)
    return _sorted(math.atan(x[0]), math.atan(x[1])), (
        _sorted(1.0 / (1.0 + most * most), 1.0 / (1.0 + least * least)),)


def _atan2(y: Interval, x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    if x[0] <= 0.0 and y[0] <= 0.0 <= y[1]:  # the origin or the cut
        return (-math.pi, math.pi), (_ANY, _ANY)
    (x_least, x_most), (y_least, y_most) = _size(x), _size(y)
    inverse = _inverse((x_least * x_least + y_least * y_least, x_most * x_most + y_most * y_most))
    value = _sorted(*(math.atan2(a, b) for a in y for b in x))
    return value, (_times(x, inverse), _negative(_times(y, inverse)))


def _tanh(x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    least, most = _size(x)
    # 1 / cosh**2 and not 1 - tanh**2, which loses all digits far out
    return _sorted(math.tanh(x[0]), math.tanh(x[1])), (
        _sorted(*(float(np.cosh(min(a, 300.0))) ** -2 if a < 300.0 else 0.0
                  for a in (least, most))),)


def _exp(x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    ends = [math.exp(min(e, EXP_CEILING)) for e in x]
    value = _sorted(*ends)
    return value, ((0.0 if x[1] > EXP_CEILING else value[0],
                    0.0 if x[0] > EXP_CEILING else value[1]),)


def _log(x: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    def value(a: float) -> float:
        return math.log(max(a, LOG_FLOOR)) + min(a - LOG_FLOOR, 0.0) / LOG_FLOOR
    return _sorted(value(x[0]), value(x[1])), (
        _sorted(1.0 / max(x[1], LOG_FLOOR), 1.0 / max(x[0], LOG_FLOOR)),)


def _min(a: Interval, b: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    value = min(a[0], b[0]), min(a[1], b[1])
    if a[1] <= b[0] or b[1] <= a[0]:
        return value, (_ONE, _ZERO) if a[1] <= b[0] else (_ZERO, _ONE)
    return value, (_UNIT, _UNIT)


def _max(a: Interval, b: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    value, slopes = _min(_negative(a), _negative(b))
    return _negative(value), slopes


def _sat(x: Interval, low: Interval, high: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    raised, (by_x, by_low) = _max(x, low)
    value, (by_raised, by_high) = _min(raised, high)
    return value, (_times(by_raised, by_x), _times(by_raised, by_low), by_high)


def _deadzone(x: Interval, width: Interval) -> tuple[Interval, tuple[Interval, ...]]:
    value, (by_x, by_low, by_high) = _sat(x, _negative(width), width)
    return _add(x, _negative(value)), (
        (1.0 - by_x[1], 1.0 - by_x[0]), _add(by_low, _negative(by_high)))


EXTENSIONS: dict[str, Extension] = {
    '+': lambda a, b: (_add(a, b), (_ONE, _ONE)),
    '-': lambda a, b: (_add(a, _negative(b)), (_ONE, (-1.0, -1.0))),
    '*': lambda a, b: (_times(a, b), (b, a)),
    '/': _divide, '**': _power,
    'neg': lambda a: (_negative(a), ((-1.0, -1.0),)),
    'sign': _sign, 'sqrt': _sqrt, 'abs': _abs,
    'sin': lambda x: (_cosine(_shifted(x, -math.pi / 2)), (_cosine(x),)),
    'cos': lambda x: (_cosine(x), (_cosine(_shifted(x, math.pi / 2)),)),
    'tan': _tan, 'asin': _asin, 'atan': _atan, 'atan2': _atan2, 'tanh': _tanh, 'exp': _exp,
    'log': _log, 'min': _min, 'max': _max, 'sat': _sat, 'deadzone': _deadzone,
}


def jumps(term: NonlinearTerm) -> bool:
    """Tell whether a sign is in the term: its value may jump."""
    def inside(node: Node) -> bool:
        return isinstance(node, Apply) and (
            node.function == 'sign' or any(inside(a) for a in node.arguments))
    return inside(parse(term.text, 'nonlinearity', term.name))
