"""Derivatives of expressions, and the arithmetic of expressions that drops what is 0 or 1."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from vsensor_ros.functions.expression import Apply, Name, Node, Number

ZERO = Number(0.0)
ONE = Number(1.0)
SMOOTH = frozenset(('+', '-', '*', '/', '**', 'neg', 'sqrt', 'sin', 'cos', 'tan', 'asin', 'atan',
                    'atan2', 'tanh', 'exp', 'log'))


class NotSmooth(ValueError):
    """A function without derivative everywhere stands in an expression; str() is its name."""


def add(a: Node, b: Node) -> Node:
    """Return a + b."""
    if a == ZERO or b == ZERO:
        return b if a == ZERO else a
    if isinstance(a, Number) and isinstance(b, Number):
        return Number(a.value + b.value)
    if isinstance(b, Apply) and b.function == 'neg':
        return Apply('-', (a, b.arguments[0]))
    if isinstance(b, Number) and b.value < 0.0:
        return Apply('-', (a, Number(-b.value)))
    return Apply('+', (a, b))


def negative(a: Node) -> Node:
    """Return -a."""
    if isinstance(a, Number):
        return Number(-a.value) if a.value else ZERO
    if isinstance(a, Apply) and a.function == 'neg':
        return a.arguments[0]
    if isinstance(a, Apply) and a.function == '-':
        return minus(a.arguments[1], a.arguments[0])
    if isinstance(a, Apply) and a.function == '+' and any(
            isinstance(part, Apply) and part.function == 'neg' for part in a.arguments):
        return minus(negative(a.arguments[0]), a.arguments[1])
    return Apply('neg', (a,))


def minus(a: Node, b: Node) -> Node:
    """Return a - b."""
    return add(a, negative(b)) if a != ZERO else negative(b)


def times(a: Node, b: Node) -> Node:
    """Return a b."""
    if ZERO in (a, b):
        return ZERO
    if a == ONE or b == ONE:
        return b if a == ONE else a
    if isinstance(b, Number) and not isinstance(a, Number):
        a, b = b, a
    if a == Number(-1.0):
        return negative(b)
    if isinstance(a, Number) and isinstance(b, Number):
        return Number(a.value * b.value)
    if isinstance(a, Number) and isinstance(b, Apply) and b.function == '*' \
            and isinstance(first := b.arguments[0], Number):
        return times(Number(a.value * first.value), b.arguments[1])
    for one, other in ((a, b), (b, a)):
        if isinstance(one, Apply) and one.function == 'neg':
            return negative(times(one.arguments[0], other))
    return Apply('*', (a, b))


def over(a: Node, b: Node) -> Node:
    """Return a / b."""
    if a == ZERO or b == ONE:
        return a
    if isinstance(b, Number) and b.value < 0.0:
        return over(negative(a), Number(-b.value))
    if isinstance(b, Apply) and b.function == 'neg':
        return over(negative(a), b.arguments[0])
    return Apply('/', (a, b))


def power(a: Node, p: float) -> Node:
    """Return a**p."""
    if p == 0.0:
        return ONE
    return a if p == 1.0 else Apply('**', (a, Number(p)))


def call(function: str, *arguments: Node) -> Node:
    """Return a function of the catalogue, applied."""
    return Apply(function, arguments)


def total(nodes: list[Node]) -> Node:
    """Return the sum."""
    result: Node = ZERO
    for node in nodes:
        result = add(result, node)
    return result


def derivative(node: Node, name: str) -> Node:
    """Return the partial derivative; raises NotSmooth where a function has none."""
    if isinstance(node, Number):
        return ZERO
    if isinstance(node, Name):
        return ONE if node.id == name else ZERO
    inner = [derivative(a, name) for a in node.arguments]
    if all(slope == ZERO for slope in inner):
        return ZERO
    a = node.arguments[0]
    if node.function == '+':
        return add(*inner)
    if node.function == '-':
        return minus(*inner)
    if node.function == 'neg':
        return negative(inner[0])
    if node.function == '*':
        return add(times(inner[0], node.arguments[1]), times(a, inner[1]))
    if node.function == '/':
        b = node.arguments[1]
        return minus(over(inner[0], b), over(times(a, inner[1]), power(b, 2.0)))
    if node.function == '**':
        p = node.arguments[1]
        slope = ZERO if inner[0] == ZERO else times(
            times(p, power(a, p.value - 1.0) if isinstance(p, Number)
                  else Apply('**', (a, minus(p, ONE)))), inner[0])
        return add(slope, times(times(node, call('log', a)), inner[1]))
    if node.function == 'atan2':
        b = node.arguments[1]
        return over(minus(times(b, inner[0]), times(a, inner[1])),
                    add(power(a, 2.0), power(b, 2.0)))
    outer = _SLOPES.get(node.function)
    if outer is None:
        raise NotSmooth(node.function)
    return times(outer(node, a), inner[0])


_SLOPES = {
    'sqrt': lambda node, a: over(Number(0.5), call('abs', node)),  # continued oddly
    'sin': lambda node, a: call('cos', a),
    'cos': lambda node, a: negative(call('sin', a)),
    'tan': lambda node, a: add(ONE, power(node, 2.0)),
    'asin': lambda node, a: over(ONE, call('sqrt', minus(ONE, power(a, 2.0)))),
    'atan': lambda node, a: over(ONE, add(ONE, power(a, 2.0))),
    'tanh': lambda node, a: minus(ONE, power(node, 2.0)),
    'exp': lambda node, a: node,
    'log': lambda node, a: over(ONE, a),
    'abs': lambda node, a: call('sign', a),
    'sign': lambda node, a: ZERO,
}


def along(node: Node, f: Mapping[str, Node]) -> Node:
    """Return the derivative of an expression along x' = f(x), by state."""
    return total([times(derivative(node, state), rate) for state, rate in f.items()])


def rebuilt(node: Node) -> Node:
    """Return an expression without what is 0 or 1 in it."""
    if not isinstance(node, Apply):
        return node
    arguments = tuple(map(rebuilt, node.arguments))
    plain = _PLAIN.get(node.function)
    if node.function == '**' and isinstance(p := arguments[1], Number):
        return power(arguments[0], p.value)
    return plain(*arguments) if plain else Apply(node.function, arguments, node.called)


_PLAIN: dict[str, Callable[..., Node]] = {'+': add, '-': minus, '*': times, '/': over,
                                          'neg': negative}
