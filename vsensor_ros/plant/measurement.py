"""
What a sensor shows, taken apart: a linear reading, and an offset or a known curve of it.

A curve is f(w) + a u: f rises or falls with one linear combination w of states, inputs and unknown
inputs; besides it there are only commands, which are known. So it can be inverted where readings
come in. The linear reading is k w + a u, k being the slope at the operating point. What is no such
curve is kept as it stands: beside its linear part, a sensor shows what no linear map knows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.functions.affine import affine
from vsensor_ros.functions.curve import Curve
from vsensor_ros.functions.expression import (
    Apply,
    gradient,
    Name,
    Node,
    Number,
    substitute,
    to_text,
    to_words,
)
from vsensor_ros.plant.plain_name import affine_node
from vsensor_ros.plant.split import addends, lifted

PARALLEL = 1e-9  # relative
FLAT = 1e-6  # of its mean slope: it shows nothing there


class Measured(NamedTuple):
    """What a sensor shows."""

    row: np.ndarray  # (n + m + d,) of the linear reading
    curve: Curve | None = None  # what is shown of that; None: itself
    rest: tuple[Node, ...] = ()  # what is added to it, where it is no curve of one combination
    why: str = ''  # it is none


def measurement(node: Node, text: object, groups: Sequence[Sequence[str]], ranges: np.ndarray,
                point: np.ndarray, where: object, key: str) -> Measured:
    """
    Take apart what a sensor shows.

    groups: names of states, inputs and unknown inputs; ranges (n + m + d, 2) and point
    (n + m + d,), of all of them, where they live and where they work. Raises BadInput.
    """
    names = tuple(name for group in groups for name in group)
    form = affine(node)
    if form is not None:
        row, offset = np.array([form.get(name, 0.0) for name in names]), form.get('', 0.0)
        if not row.any():
            raise BadInput(where, key, f'{shown(text)} holds no state, input, disturbance',
                           'write a sum of states, inputs, disturbances with factors, such as '
                           'level1 - level2')
        return Measured(row, Curve(offset) if offset else None)
    linear, cores = addends(node, where, key)
    try:
        return Measured(*_inverted(linear, cores, text, groups, ranges, point, where, key))
    except _NoCurve as error:
        offset = linear.get('', 0.0)
        return Measured(
            np.array([linear.get(name, 0.0) for name in names]),
            rest=(*(core if factor == 1.0 else Apply('*', (Number(factor), core))
                    for factor, core in cores),
                  *[Number(offset)] * bool(offset)), why=f'{error.problem}; {error.mend}')


class _NoCurve(BadInput):
    """It cannot be inverted."""


def _inverted(linear: Mapping[str, float], cores: Sequence[tuple[float, Node]], text: object,
              groups: Sequence[Sequence[str]], ranges: np.ndarray, point: np.ndarray,
              where: object, key: str) -> tuple[np.ndarray, Curve]:
    """Return the row of the linear reading, and the curve of it that is shown."""
    states, inputs, disturbances = groups
    names = (*states, *inputs, *disturbances)
    rows: list[np.ndarray] = []
    curve: Node = Number(linear.get('', 0.0))
    for factor, core in cores:
        curve = Apply('+', (curve, Apply('*', (Number(factor), lifted(core, names, (), rows)))))
    beside = np.array([linear.get(name, 0.0) for name in names])
    command = np.array([name in inputs for name in names])
    if not any(row[~command].any() for row in rows):
        raise BadInput(where, key, f'{shown(text)} is a curve of commands alone', 'leave the '
                       'sensor out: what is commanded is known')
    if len(rows) != 1:
        raise _NoCurve(where, key, f'{shown(text)} is no curve of one linear combination of '
                       f'states, but of {len(rows)} quantities', 'bring it into one function of '
                       'one sum; only commands may be added to that')
    w = rows[0]
    share = float(beside @ np.where(command, 0.0, w)) / float(w[~command] @ w[~command])
    beside = beside - share * w
    left = np.abs(beside[~command]) > PARALLEL * np.abs(share * w[~command]).max() + PARALLEL * (
        np.abs(beside).max(initial=0.0))
    if left.any():
        name = np.array(names)[~command][left][0]
        raise _NoCurve(where, key, f'{shown(text)} cannot be inverted: {name} is added to a '
                       f'curve of {to_words(affine_node(w, names))}, and is not known when a '
                       'reading comes in', 'make what the curve shows a state in place of '
                       f'{to_words(affine_node(w, names))}, or write a straight line for it')
    beside[~command] = 0.0
    curve = Apply('+', (curve, Apply('*', (Number(share), Name('w1'))))) if share else curve
    low, high = _span(w, ranges)
    if not -np.inf < low < high < np.inf:
        open_names = [n for n, factor, ends in zip(names, w, ranges)
                      if factor and not np.isfinite(ends).all()]
        raise _NoCurve(where, key, f'{shown(text)} is a curve, and {", ".join(open_names)} has no '
                       'range in which to invert it', 'give it one: range: [low, high]')
    slope = float(gradient(curve, {'w1': float(w @ point)}, ('w1',))[1][0])
    first, last = (gradient(curve, {'w1': end}, ('w1',))[0] for end in (low, high))
    mean = (last - first) / (high - low)
    found = _scaled(curve, 1.0, low, high)
    try:
        found.check(where, key)
    except BadInput as error:
        raise _NoCurve(where, key, error.problem, error.mend) from error
    if not np.isfinite(slope) or abs(slope) < FLAT * abs(mean):
        raise _NoCurve(where, key, f'{shown(text)} has no slope at the operating point',
                       'give an operating_point where it rises or falls')
    scaled = _scaled(curve, slope, low, high, {
        name: float(gain) for name, gain in zip(names, beside) if gain})
    return slope * w + beside, scaled


def _scaled(curve: Node, k: float, low: float, high: float,
            beside: dict[str, float] | None = None) -> Curve:
    """Return the curve over k w instead of w."""
    ends = sorted((k * low, k * high))
    w = Name('w1') if k == 1.0 else Apply('/', (Name('w1'), Number(k)))
    return Curve(0.0, to_text(substitute(curve, {'w1': w})), ends[0], ends[1], beside or {})


def _span(w: np.ndarray, ranges: np.ndarray) -> tuple[float, float]:
    of = np.flatnonzero(w)
    low, high = np.sort(w[of, None] * ranges[of], axis=1).sum(axis=0)
    return float(low), float(high)
