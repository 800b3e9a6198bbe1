"""Definitions as they are written down one after the other, and vectors of expressions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from vsensor_ros.functions.expression import Apply, Name, negate, Node, Number, to_text

Vector = list[Node]  # 3
ZERO, ONE = Number(0.0), Number(1.0)
_AXES = 'xyz'


class Sheet:
    """Definitions by name; each name ends with a sign that no other name ends with."""

    END = '_'

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}

    def let(self, name: str, node: Node) -> Node:
        """Write a definition down where it is more than a number or a name; return what it is."""
        if isinstance(node, (Number, Name)):
            return node
        self.texts[f'{name}{self.END}'] = to_text(node)
        return Name(f'{name}{self.END}')

    def let_vector(self, name: str, vector: Sequence[Node]) -> Vector:
        """Write down the components of a vector."""
        return [self.let(name + axis, node) for axis, node in zip(_AXES, vector)]


def add(a: Node, b: Node) -> Node:
    """Return a + b, short where one is 0, negative, or both are numbers."""
    if isinstance(a, Number) and isinstance(b, Number):
        return Number(a.value + b.value)
    if a == ZERO:
        return b
    if b == ZERO:
        return a
    if isinstance(b, Number) and b.value < 0.0:
        return Apply('-', (a, Number(-b.value)))
    if isinstance(b, Apply) and b.function == 'neg':
        return Apply('-', (a, b.arguments[0]))
    if isinstance(a, Apply) and a.function == 'neg':
        return Apply('-', (b, a.arguments[0]))
    return Apply('+', (a, b))


def minus(a: Node) -> Node:
    """Return -a."""
    return a.arguments[0] if isinstance(a, Apply) and a.function == 'neg' else negate(a)


def times(a: Node, b: Node) -> Node:
    """Return a * b, short where one is 0, 1 or -1, or both are numbers; a sign goes outside."""
    if isinstance(a, Number) and isinstance(b, Number):
        return Number(a.value * b.value)
    if isinstance(b, Number):
        a, b = b, a
    if isinstance(a, Number) and a.value <= 0.0:
        return ZERO if a.value == 0.0 else minus(times(Number(-a.value), b))
    if a == ONE:
        return b
    for one, other in ((a, b), (b, a)):
        if isinstance(one, Apply) and one.function == 'neg':
            return minus(times(one.arguments[0], other))
    return Apply('*', (a, b))


def total(nodes: Sequence[Node]) -> Node:
    """Return the sum."""
    found: Node = ZERO
    for node in nodes:
        found = add(found, node)
    return found


def vector(values: Iterable[float]) -> Vector:
    """Return numbers as a vector."""
    return [Number(float(v)) for v in values]


def plus(*vectors: Sequence[Node]) -> Vector:
    """Return the sum of vectors."""
    return [total(parts) for parts in zip(*vectors)]


def scaled(factor: Node, of: Sequence[Node]) -> Vector:
    """Return a vector times a factor."""
    return [times(factor, node) for node in of]


def cross(a: Sequence[Node], b: Sequence[Node]) -> Vector:
    """Return a x b."""
    return [add(times(a[i - 2], b[i - 1]), minus(times(a[i - 1], b[i - 2]))) for i in range(3)]


def turned(matrix: np.ndarray, of: Sequence[Node]) -> Vector:
    """Return a matrix (3, 3) of numbers times a vector."""
    return [total([times(Number(float(v)), node) for v, node in zip(row, of)]) for row in matrix]


def product(rows: Sequence[Sequence[Node]], of: Sequence[Node]) -> Vector:
    """Return a matrix (3, 3) times a vector."""
    return [total([times(a, b) for a, b in zip(row, of)]) for row in rows]
