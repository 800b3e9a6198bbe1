"""Expressions to 50 digits, in balls that hold the true value (python-flint)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.algebra.derivative import negative
from vsensor_ros.functions.expression import Name, Node, Number

DIGITS = 50
_WORKING = 90  # digits: what is lost on the way must leave 50
_SIMPLE = 10 ** 6  # largest denominator of a number that is read as a fraction
_POINTS = 6

Exact = Mapping[float, Any]  # numbers of which more is known than their 16 digits


@lru_cache(maxsize=1)
def flint() -> Any:
    """Return the library; raises BadInput where it is missing."""
    try:
        import flint as library
    except ImportError:
        raise BadInput('functions', '', 'python-flint is missing, which confirms to 50 digits',
                       'install it: pip install python-flint') from None
    return library


@contextmanager
def precise() -> Iterator[None]:
    """Compute with enough digits inside, and as before outside."""
    context = flint().ctx
    before, context.dps = context.dps, _WORKING
    try:
        yield
    finally:
        context.dps = before


@lru_cache(maxsize=4096)
def fraction(x: float) -> Fraction:
    """Read a float as who wrote it meant it: 0.1 is a tenth, 1.4285714285714286 is 10/7."""
    simple = Fraction(x).limit_denominator(_SIMPLE)
    return simple if float(simple) == x else Fraction(repr(float(x)))


def ball(x: float, exact: Exact | None = None) -> Any:
    """Return a number to all digits."""
    if exact and x in exact:
        return exact[x]
    if exact and -x in exact:
        return -exact[-x]
    f = fraction(float(x))
    return flint().arb(flint().fmpq(f.numerator, f.denominator))


def by_float(numbers: Sequence[Any]) -> dict[float, Any]:
    """Return the sizes of balls or fractions to all digits, by the float that is written."""
    with precise():
        result = {}
        for number in numbers:
            if isinstance(number, Fraction):
                number = flint().arb(flint().fmpq(number.numerator, number.denominator))
            result[abs(float(number))] = abs(number)
        return result


class Program:
    """Expressions to be evaluated at points of balls; what they have in common, once."""

    def __init__(self, nodes: Sequence[Node], exact: Exact | None = None) -> None:
        """Prepare; exact: numbers of which more is known."""
        self._exact = exact
        self._places: dict[object, int] = {}
        self._order: list[Callable[[list[Any], Mapping[str, Any]], Any]] = []
        self._ends = [self._place(node) for node in nodes]

    def _place(self, node: Node) -> int:
        key: object
        if isinstance(node, Number):
            key = ('number', node.value)
        elif isinstance(node, Name):
            key = ('name', node.id)
        else:
            key = (node.function, *(self._place(a) for a in node.arguments))
            if node.function == '**' and isinstance(p := node.arguments[1], Number):
                key = ('**', key[1], p)
        if key not in self._places:
            self._places[key] = len(self._order)
            self._order.append(self._step(node, key))
        return self._places[key]

    def _step(self, node: Node, key: Any) -> Callable[[list[Any], Mapping[str, Any]], Any]:
        if isinstance(node, Number):
            constant = ball(node.value, self._exact)
            return lambda known, at: constant
        if isinstance(node, Name):
            return lambda known, at: at[node.id]
        if node.function == '**' and isinstance(p := node.arguments[1], Number):
            exponent = fraction(p.value)
            return lambda known, at: _power(known[key[1]], exponent)
        function, places = _FUNCTIONS[node.function], key[1:]
        return lambda known, at: function(*[known[i] for i in places])

    def at(self, point: Mapping[str, Any]) -> list[Any]:
        """Return the values at a point, by name."""
        known: list[Any] = []
        for step in self._order:
            known.append(step(known, point))
        return [known[end] for end in self._ends]


def points(names: Sequence[str], at: np.ndarray) -> list[dict[str, Any]]:
    """Return float points (V, N) as points of balls; these floats are meant exactly."""
    arb = flint().arb
    return [dict(zip(names, map(arb, map(float, column)))) for column in at.T]


def same(a: Node, b: Node, names: Sequence[str], at: np.ndarray,
         exact: Exact | None = None) -> bool:
    """Tell whether two expressions agree to 50 digits at points (V, N), enough of them."""
    return vanishes([a, negative(b)], names, at, exact)


def vanishes(terms: Sequence[Node], names: Sequence[str], at: np.ndarray,
             exact: Exact | None = None) -> bool:
    """Tell whether expressions sum to 0 at points (V, N), to 50 digits of the largest."""
    with precise():
        program = Program(terms, exact)
        tried = 0
        for point in points(names, at):
            values = program.at(point)
            if not all(v.is_finite() for v in values):
                continue
            size = max((abs(float(v)) for v in values), default=0.0)
            left = sum(values)
            if float(abs(left).upper()) > size * 10.0 ** -DIGITS:
                return False
            tried += 1
            if tried == _POINTS:
                return True
    return False


def solved(columns: Sequence[Node], target: Node, names: Sequence[str], at: np.ndarray,
           exact: Exact | None = None) -> list[Any] | None:
    """Return the coefficients, balls or simple fractions, with which columns sum to a target."""
    library = flint()
    with precise():
        program = Program([*columns, target], exact)
        rows, right = [], []
        for point in points(names, at):
            row = program.at(point)
            if all(entry.is_finite() for entry in row):
                rows.append(row[:-1])
                right.append(row[-1:])
            if len(rows) == len(columns):
                break
        if len(rows) < len(columns):
            return None
        try:
            found = library.arb_mat(rows).solve(library.arb_mat(right))
        except ZeroDivisionError:
            return None
        return [_simplest(found[i, 0]) for i in range(len(columns))]


def _simplest(x: Any) -> Any:
    library = flint()
    f = Fraction(float(x.mid())).limit_denominator(_SIMPLE)
    guess = library.arb(library.fmpq(f.numerator, f.denominator))
    close = abs(x - guess)
    return guess if float(close.upper()) <= 1e-30 * max(1.0, abs(float(x))) else x


def _power(a: Any, p: Fraction) -> Any:
    if p.denominator == 1:
        return a ** p.numerator if p >= 0 else 1 / a ** -p.numerator
    size = abs(a) ** flint().arb(flint().fmpq(p.numerator, p.denominator))
    return -size if a < 0 else size  # continued oddly


def _odd_root(a: Any) -> Any:
    return -(-a).sqrt() if a < 0 else a.sqrt()


def _sign(a: Any) -> Any:
    return flint().arb(1 if a > 0 else -1 if a < 0 else 0)


def _tanh(a: Any) -> Any:
    return a.tanh()


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    '+': lambda a, b: a + b, '-': lambda a, b: a - b, '*': lambda a, b: a * b,
    '/': lambda a, b: a / b, 'neg': lambda a: -a, '**': lambda a, b: a ** b,
    'sqrt': _odd_root, 'sin': lambda a: a.sin(), 'cos': lambda a: a.cos(),
    'tan': lambda a: a.tan(), 'asin': lambda a: a.asin(), 'atan': lambda a: a.atan(),
    'atan2': lambda a, b: flint().arb.atan2(a, b), 'tanh': _tanh, 'exp': lambda a: a.exp(),
    'log': lambda a: a.log(), 'abs': abs, 'sign': _sign,
    'min': lambda a, b: a if a < b else b, 'max': lambda a, b: a if a > b else b,
    'sat': lambda x, low, high: low if x < low else high if x > high else x,
    'deadzone': lambda x, w: x - w if x > w else x + w if x < -w else 0 * x,
}
