"""Functions of a dictionary's span with their coefficients as numbers a person would write."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
import math
from typing import Any

import numpy as np

from vsensor_ros.designer.algebra import digits
from vsensor_ros.designer.algebra.derivative import along, derivative, negative, times, total
from vsensor_ros.designer.algebra.dictionary import combination, Dictionary
from vsensor_ros.designer.algebra.model import Model
from vsensor_ros.functions.expression import Node, Number, substitute, to_text

_PLAIN = 10 ** 4   # largest numerator and denominator that a person would write
_NEAR = 1e-9
_LONGEST = 24   # monomials; what rounding alone let pass has nearly all


@dataclass(frozen=True, eq=False)
class Function:
    """A function of the states, the numbers in it to all digits, and how simple it is."""

    node: Node
    exact: Mapping[float, Any] = field(default_factory=dict)
    cost: float = 0.0

    @property
    def text(self) -> str:
        """The expression in the language."""
        return to_text(self.node)


def named(model: Model, dictionary: Dictionary, c: np.ndarray) -> Function | None:
    """
    Return the function of coefficients c (K,), scaled to plain numbers; None if not confirmed.

    That no unknown input reaches it at once is confirmed to 50 digits.
    """
    support = [int(k) for k in np.flatnonzero(c)]
    cost = float(dictionary.costs[support].sum())
    plain = _plain(c[support])
    if plain is not None:
        coefficients = np.zeros(len(dictionary))
        coefficients[support] = [float(own) for own in plain]
        more = digits.by_float(plain)
        node = combination(dictionary, _upward(model, dictionary, coefficients))
        if free(model, node, more):
            return Function(node, more, cost)
    if len(support) > _LONGEST:
        return None
    # the numbers are no simple fractions: the conditions themselves give all digits
    last = max(support, key=lambda k: (dictionary.costs[k], abs(c[k])))
    rest = [k for k in support if k != last]
    if not rest or not model.unknown:
        return None
    goal = negative(pushed(model, dictionary.monomial(last)))
    found = digits.solved([pushed(model, dictionary.monomial(k)) for k in rest], goal,
                          model.variables, model.points(3 * len(rest) + 10, 21))
    if found is None:
        return None
    coefficients = np.zeros(len(dictionary))
    coefficients[rest], coefficients[last] = [float(own) for own in found], 1.0
    node = combination(dictionary, _upward(model, dictionary, coefficients))
    more = digits.by_float(found)
    return Function(node, more, cost) if free(model, node, more) else None


def plain_combination(dictionary: Dictionary, c: np.ndarray) -> Node:
    """Return the function of coefficients c (K,), with plain numbers where these fit."""
    support = np.flatnonzero(c)
    plain = _plain(c[support])
    coefficients = np.zeros(len(dictionary))
    coefficients[support] = c[support] if plain is None else [float(own) for own in plain]
    return combination(dictionary, coefficients)


def pushed(model: Model, node: Node) -> Node:
    """Return how unknown inputs, mixed, change an expression's derivative or next value."""
    moved = next_of(model, node)
    return total([times(Number(1.0 + 0.37 * j), derivative(moved, name))
                  for j, name in enumerate(model.unknown)])


def next_of(model: Model, node: Node) -> Node:
    """Return the derivative of a function of the states, or its next value."""
    f = dict(zip(model.states, model.f))
    return substitute(node, f) if model.discrete else along(node, f)


def free(model: Model, node: Node, exact: digits.Exact) -> bool:
    """Tell, to 50 digits, whether no unknown input reaches a function at once."""
    at = model.points(20, 23)
    for name in model.unknown:
        if model.discrete:
            inner = dict(zip(model.states, model.f))
            terms = [times(substitute(derivative(node, state), inner), derivative(f, name))
                     for state, f in inner.items()]
        else:
            terms = [times(derivative(node, state), derivative(f, name))
                     for state, f in zip(model.states, model.f)]
        if not digits.vanishes(terms, model.variables, at, exact):
            return False
    return True


def _plain(c: np.ndarray) -> list[Fraction] | None:
    best: list[Fraction] | None = None
    least = math.inf
    for scale in c:
        own = [Fraction(float(x)).limit_denominator(_PLAIN) for x in c / scale]
        if all(abs(float(f) - x) <= _NEAR * abs(x) for f, x in zip(own, c / scale)):
            whole = math.lcm(*(f.denominator for f in own))
            if whole <= _PLAIN:
                divisor = math.gcd(*(int(f * whole) for f in own))
                integers = [f * whole / divisor for f in own]
                if max(map(abs, integers)) <= 1000:
                    own = integers
            size = sum(math.log(abs(f.numerator) * f.denominator) for f in own)
            if size < least - 1e-9:
                best, least = own, size
    return best


def _upward(model: Model, dictionary: Dictionary, c: np.ndarray) -> np.ndarray:
    """Return the coefficients with the sign that makes values, or what leads, positive."""
    at = model.points(200, 17, declared=True)[:len(model.states)]
    values = c @ dictionary.values(at)
    positive = float(np.mean(values[np.isfinite(values)] > 0.0))
    if 0.1 < positive < 0.9:
        positive = float(c[max(np.flatnonzero(c), key=lambda k: -dictionary.costs[k])] > 0.0)
    return -c if positive < 0.5 else c
