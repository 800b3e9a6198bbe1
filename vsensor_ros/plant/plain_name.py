"""Linear combinations and nonlinear terms as a person would write them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
import math

import numpy as np

from vsensor_ros.functions.expression import (
    Apply,
    Name,
    negate,
    Node,
    Number,
    parse,
    substitute,
    to_text,
)
from vsensor_ros.functions.nonlinearity import argument_names

DIGITS = 6        # of the numbers in the name of a term


def affine_node(row: Sequence[float] | np.ndarray, names: Sequence[str],
                offset: float = 0.0) -> Node:
    """Return the expression sum_i row[i] * names[i] + offset, as a person would write it."""
    total: Node | None = None
    for factor, name in zip(row, names):
        if factor:
            size: Node = (Name(name) if abs(factor) == 1.0
                          else Apply('*', (Number(abs(float(factor))), Name(name))))
            if total is None:
                total = size if factor > 0.0 else negate(size)
            else:
                total = Apply('+' if factor > 0.0 else '-', (total, size))
    if total is None:
        return Number(float(offset))
    if offset:
        return Apply('+' if offset > 0.0 else '-', (total, Number(abs(float(offset)))))
    return total


def plain_name(text: str, g: np.ndarray, states: Sequence[str]) -> str:
    """Return a nonlinear term in the plant's names, 'sqrt(level1 - level2)', numbers rounded."""
    if not len(g) and text == '1':
        return 'constant'
    arguments = {w: affine_node(row, states) for w, row in zip(argument_names(len(g)), g)}
    return to_text(_rounded(substitute(parse(text), arguments)))


def _rounded(node: Node) -> Node:
    if isinstance(node, Apply):
        factors = _factors(node)
        numbers = [part.value for part in factors if isinstance(part, Number)]
        if len(numbers) > 1:  # they come of arguments, which share what they have in common
            whole = Number(float(f'{math.prod(numbers):.{DIGITS}g}'))
            rest = [_rounded(part) for part in factors if not isinstance(part, Number)]
            return reduce(lambda a, b: Apply('*', (a, b)),
                          rest if rest and whole.value == 1.0 else [whole, *rest])
        return Apply(node.function, tuple(map(_rounded, node.arguments)))
    return Number(float(f'{node.value:.{DIGITS}g}')) if isinstance(node, Number) else node


def _factors(node: Node) -> list[Node]:
    if isinstance(node, Apply) and node.function == '*':
        return [part for argument in node.arguments for part in _factors(argument)]
    return [node]
