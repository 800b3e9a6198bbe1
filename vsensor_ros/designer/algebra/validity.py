"""Where an observer's expressions are singular: conditions of its run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsensor_ros.designer.algebra.answer import Condition
from vsensor_ros.designer.algebra.contraction import ErrorSystem
from vsensor_ros.designer.algebra.derivative import call, minus, negative, power
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Apply, names, Node, Number, to_text, walk
from vsensor_ros.reason import Reason

_HALF = 0.5    # of the least size over the ranges: below it a divisor is too near to 0
_LEAST = 0.05  # of the largest size over the ranges, where these hold 0
_ROOT = 0.01


def conditions(error: ErrorSystem, nodes: Sequence[Node]) -> tuple[Condition, ...]:
    """Return what must hold so that none of the expressions meets a pole or leaves its domain."""
    known, _ = error.points(2000, 81, 0.0)
    found: dict[Node, Condition] = {}
    for node in nodes:
        for part in walk(node):
            if not isinstance(part, Apply):
                continue
            if part.function == '/' and names(part.arguments[1]):
                _away(error, part.arguments[1], known, found)
            elif part.function == '**' and isinstance(p := part.arguments[1], Number) \
                    and p.value < 0.0:
                _away(error, part.arguments[0], known, found)
            elif part.function in ('sqrt', 'log') and names(part.arguments[0]):
                _positive(error, part.arguments[0], known, found)
    return tuple(found.values())


def _away(error: ErrorSystem, divisor: Node, known: np.ndarray,
          found: dict[Node, Condition]) -> None:
    if isinstance(divisor, Apply) and divisor.function in ('*', '/'):
        for part in divisor.arguments[:None if divisor.function == '*' else 1]:
            _away(error, part, known, found)
        return
    if isinstance(divisor, Apply) and divisor.function in ('**', 'sqrt', 'neg'):
        _away(error, divisor.arguments[0], known, found)
        return
    if not names(divisor) or divisor in found:
        return
    values = _values(error, divisor, known)
    sign = float(np.sign(values[0])) if len(values) else 1.0
    size = np.abs(values)
    one_sided = bool((np.sign(values) == sign).all()) and size.min() > 0.01 * size.max()
    floor = float(f'{_HALF * size.min() if one_sided else _LEAST * size.max():.2g}')
    own = (divisor if sign > 0.0 else negative(divisor)) if one_sided else call('abs', divisor)
    found[divisor] = beyond(own, divisor, floor)


def beyond(size: Node, part: Node, floor: float) -> Condition:
    """Return that the size of a part of an expression must be above a floor."""
    return Condition(to_text(minus(size, Number(floor))),
                     Reason.of('functions singular', part=to_text(part), floor=floor))


def _positive(error: ErrorSystem, inner: Node, known: np.ndarray,
              found: dict[Node, Condition]) -> None:
    key = power(inner, 0.5)
    values = _values(error, inner, known)
    if key in found or inner in found or not (values >= 0.0).all():
        return  # continued on both sides: it was found with both
    floor = float(f'{_ROOT * values.min():.2g}')
    found[key] = Condition(to_text(minus(inner, Number(floor)) if floor else inner),
                           Reason.of('functions root', part=to_text(inner)))


def _values(error: ErrorSystem, node: Node, known: np.ndarray) -> np.ndarray:
    with np.errstate(all='ignore'):
        values = Equations([node], error.variables).values(known)[0]
    return values[np.isfinite(values)]
