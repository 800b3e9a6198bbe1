"""Linear combinations and nonlinear terms as a person would write them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
import math
from typing import TypeGuard

import numpy as np

from vsensor_ros.functions.expression import (
    Apply,
    DIGITS,
    Name,
    names,
    negate,
    Node,
    Number,
    parse,
    substitute,
    to_words,
)
from vsensor_ros.functions.nonlinearity import argument_names, NonlinearTerm

CONSTANT = 'constant'  # the term that is 1: an offset of an equation
LONGEST = 32  # characters of a name that a sentence can hold
MOST_NAMED = 3  # quantities in a short name


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


def plain_name(function: Node, g: np.ndarray, states: Sequence[str]) -> str:
    """Return a nonlinear term over w1.. in the plant's names, 'sqrt(level1 - level2)'."""
    if not len(g) and function == Number(1.0):
        return CONSTANT
    arguments = {w: affine_node(row, states) for w, row in zip(argument_names(len(g)), g)}
    return to_words(_merged(substitute(function, arguments)))


def short_names(terms: Sequence[NonlinearTerm], G: Sequence[np.ndarray], states: Sequence[str],
                inputs: Sequence[str]) -> tuple[NonlinearTerm, ...]:
    """Return the terms, long ones with a short name for sentences: 'term 3 (of tr, ca)'."""
    named = []
    for i, (term, g) in enumerate(zip(terms, G)):
        short = term.name
        if len(term.name) > LONGEST:
            of = [state for state, moves in zip(states, np.any(g != 0.0, axis=0)) if moves]
            of += [name for name in names(parse(term.text)) if name in inputs]
            of[MOST_NAMED:] = ['..'] * (len(of) > MOST_NAMED)
            short = f'term {i + 1}' + f' (of {", ".join(of)})' * bool(of)
        named.append(replace(term, short=short))
    return tuple(named)


def _merged(node: Node) -> Node:
    """Multiply the numbers of a product: they come of arguments, which share them."""
    if not isinstance(node, Apply):
        return node
    factors = _factors(node)
    numbers = [part.value for part in factors if _is_plain(part)]
    if len(numbers) < 2:
        return replace(node, arguments=tuple(map(_merged, node.arguments)))
    whole = Number(float(f'{math.prod(numbers):.{DIGITS}g}'))
    rest = [_merged(part) for part in factors if not _is_plain(part)]
    return reduce(lambda a, b: Apply('*', (a, b)),
                  rest if rest and whole.value == 1.0 else [whole, *rest])


def _is_plain(node: Node) -> TypeGuard[Number]:
    return isinstance(node, Number) and node.written is None


def _factors(node: Node) -> list[Node]:
    if isinstance(node, Apply) and node.function == '*':
        return [part for argument in node.arguments for part in _factors(argument)]
    return [node]
