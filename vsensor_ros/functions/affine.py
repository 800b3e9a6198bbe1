"""Which expressions are affine in their names, and with which coefficients."""

from __future__ import annotations

from collections.abc import Mapping

from vsensor_ros.functions.expression import Name, Node, Number

OFFSET = ''    # the key of the constant in an affine form; no name is empty


def affine(node: Node) -> dict[str, float] | None:
    """Return the coefficients by name, the offset under '', or None when not affine."""
    if isinstance(node, Number):
        return {OFFSET: node.value} if node.value else {}
    if isinstance(node, Name):
        return {node.id: 1.0}
    parts = [affine(argument) for argument in node.arguments]
    forms = [form for form in parts if form is not None]
    if len(forms) < len(parts):
        return None
    if node.function == 'neg':
        return plus({}, forms[0], -1.0)
    if node.function in ('+', '-'):
        return plus(forms[0], forms[1], 1.0 if node.function == '+' else -1.0)
    if node.function == '*':
        for one, other in (forms, forms[::-1]):
            if set(one) <= {OFFSET}:
                return plus({}, other, one.get(OFFSET, 0.0))
    if node.function == '/' and set(forms[1]) == {OFFSET}:
        return {key: value / forms[1][OFFSET] for key, value in forms[0].items()}
    return None


def plus(a: Mapping[str, float], b: Mapping[str, float], factor: float) -> dict[str, float]:
    """Return the affine form a + factor * b."""
    total = dict(a)
    for key, value in b.items():
        total[key] = total.get(key, 0.0) + factor * value
    return {key: value for key, value in total.items() if value}
