"""
Between which bounds the slopes of a nonlinear term lie when its arguments stay in a box.

Interval arithmetic in forward mode over the expression tree: every part carries the interval of
its values and, for each argument w, the interval of its difference quotients along w with the
other arguments held. What a single function does to intervals stands in its entry; all hold for
the continuations outside the domains too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import product
import math

import numpy as np

from vsensor_ros.functions.expression import (
    Apply,
    fold,
    function_of,
    Name,
    names,
    Node,
    Number,
    parse,
    walk,
)
from vsensor_ros.functions.interval import add, hull, Interval, ONE, times, ZERO
from vsensor_ros.functions.nonlinearity import argument_names, NonlinearTerm

CELLS = 128  # into which a box is cut; w*abs(w) needs it cut at 0, exp(-w**2) finely


def slope_bounds_on(term: NonlinearTerm, box: np.ndarray, inputs: Sequence[str],
                    input_box: np.ndarray) -> tuple[Interval, ...]:
    """
    Bound the difference quotients of psi (the addend included) along each of its r arguments.

    box (r, 2) and input_box (m, 2), -inf and inf where nothing is known. Returns r pairs: for
    two points of the box and the same inputs, psi(w) - psi(w') = sum_j s_j (w_j - w'_j) with
    every s_j in its pair. (0, inf) is a term that never falls along that argument (sign, the odd
    square root at 0); (-inf, inf): nothing can be said. Source: the method, 3.5.
    """
    slopes = _over(term.text, argument_names(len(term.slope)), tuple(inputs),
                   tuple(np.vstack([box, input_box]).ravel().tolist()))
    return tuple((low - float(s), high - float(s)) for (low, high), s in zip(slopes, term.slope))


@lru_cache(maxsize=1024)
def _over(text: str, arguments: tuple[str, ...], inputs: tuple[str, ...],
          box: tuple[float, ...]) -> tuple[Interval, ...]:
    node = _tree(text)
    ranges = dict(zip((*arguments, *inputs), zip(box[::2], box[1::2])))
    used = [name for name in names(node) if ranges[name][0] < ranges[name][1]]
    pieces = max(2, int(CELLS ** (1.0 / max(1, len(used)))))
    total: list[Interval] | None = None
    with np.errstate(all='ignore'):
        for cell in product(*(_cut(ranges[name], pieces) for name in used)):
            slopes = _ranged(node, {**ranges, **dict(zip(used, cell))}, arguments)[1]
            total = slopes if total is None else [hull(a, b) for a, b in zip(total, slopes)]
    assert total is not None
    return tuple(total)


@lru_cache(maxsize=1 << 16)
def slopes_in(text: str, sides: tuple[str, ...], cell: tuple[float, ...],
              arguments: tuple[str, ...]) -> tuple[Interval, ...]:
    """
    Bound the slopes of f, without the addend, in one cell that is not divided.

    ``cell``: low and high of each of the names ``sides``, which are all that the text holds.
    """
    with np.errstate(all='ignore'):
        return tuple(_ranged(_tree(text), dict(zip(sides, zip(cell[::2], cell[1::2]))),
                             arguments)[1])


@lru_cache(maxsize=256)
def _tree(text: str) -> Node:
    return fold(parse(text, 'nonlinearity', text))


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
        return (node.value, node.value), [ZERO] * len(arguments)
    if isinstance(node, Name):
        return ranges[node.id], [ONE if node.id == a else ZERO for a in arguments]
    parts = [_ranged(a, ranges, arguments) for a in node.arguments]
    value, outer = function_of(node).bounds(*(value for value, _ in parts))
    slopes = [ZERO] * len(arguments)
    for slope, (_, inner) in zip(outer, parts):
        slopes = [add(total, times(slope, one)) for total, one in zip(slopes, inner)]
    return value, slopes


def jumps(term: NonlinearTerm) -> bool:
    """Tell whether the value may jump: a function that does so, such as a sign, is in the term."""
    return any(isinstance(part, Apply) and function_of(part).set_valued
               for part in walk(parse(term.text, 'nonlinearity', term.name)))
