"""
Power series in several variables about a point, cut off at an order, with balls for coefficients.

What of a smooth function is known near one point: enough to take its derivatives as often as the
order, and to divide by it where it is not 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
import itertools
from typing import Any

import numpy as np

from vsensor_ros.designer.algebra.derivative import NotSmooth
from vsensor_ros.designer.algebra.digits import ball, flint, fraction
from vsensor_ros.functions.expression import Name, Node, Number

Jet = np.ndarray  # (M,) of balls


class Jets:
    """Series in n variables up to an order; M coefficients."""

    def __init__(self, n: int, order: int) -> None:
        self.n, self.order = n, order
        exponents = [e for total in range(order + 1) for e in _exponents(n, total)]
        self._place = {e: i for i, e in enumerate(exponents)}
        self.exponents = exponents

    def __len__(self) -> int:
        return len(self.exponents)

    @cached_property
    def _pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        left, right, where = [], [], []
        for i, a in enumerate(self.exponents):
            room = self.order - sum(a)
            for j, b in enumerate(self.exponents):
                if sum(b) > room:
                    break
                left.append(i)
                right.append(j)
                where.append(self._place[tuple(map(sum, zip(a, b)))])
        order = np.argsort(where, kind='stable')
        starts = np.searchsorted(np.array(where)[order], np.arange(len(self)))
        return np.array(left)[order], np.array(right)[order], starts

    @cached_property
    def _shifts(self) -> list[list[tuple[int, int, int]]]:
        """By variable: (from, to, factor) of the derivative."""
        result = []
        for i in range(self.n):
            moves = []
            for k, e in enumerate(self.exponents):
                if e[i]:
                    lower = (*e[:i], e[i] - 1, *e[i + 1:])
                    moves.append((k, self._place[lower], e[i]))
            result.append(moves)
        return result

    def constant(self, x: Any) -> Jet:
        """Return a series that is a number."""
        result = np.array([flint().arb(0)] * len(self), dtype=object)
        result[0] = x
        return result

    def variable(self, i: int, x: Any) -> Jet:
        """Return the i-th variable about x."""
        result = self.constant(x)
        if self.order:
            result[self._place[tuple(int(j == i) for j in range(self.n))]] = flint().arb(1)
        return result

    def times(self, a: Jet, b: Jet) -> Jet:
        """Return the product."""
        left, right, starts = self._pairs
        return np.add.reduceat(a[left] * b[right], starts)

    def slope(self, a: Jet, i: int) -> Jet:
        """Return the derivative; its highest order is not known."""
        result = self.constant(flint().arb(0))
        for k, to, factor in self._shifts[i]:
            result[to] = a[k] * factor
        return result

    def of(self, coefficients: Sequence[Any], a: Jet) -> Jet:
        """Return sum_k c_k (a - a(0))^k."""
        inner = a.copy()
        inner[0] = flint().arb(0)
        result = self.constant(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            result = self.times(result, inner)
            result[0] = result[0] + c
        return result

    def inverse(self, a: Jet) -> Jet:
        """Return 1 / a."""
        return self.of(self._series('inv', a[0]), a)

    def value(self, node: Node, at: Mapping[str, Jet]) -> Jet:
        """Return the series of an expression; raises NotSmooth."""
        if isinstance(node, Number):
            return self.constant(ball(node.value))
        if isinstance(node, Name):
            return at[node.id]
        if node.function == '**' and isinstance(p := node.arguments[1], Number):
            return self._power(self.value(node.arguments[0], at), p.value)
        parts = [self.value(a, at) for a in node.arguments]
        a = parts[0]
        if node.function == '+':
            return a + parts[1]
        if node.function == '-':
            return a - parts[1]
        if node.function == 'neg':
            return -a
        if node.function == '*':
            return self.times(a, parts[1])
        if node.function == '/':
            return self.times(a, self.inverse(parts[1]))
        if node.function == 'sqrt':
            return self._power(a, 0.5)
        if node.function == 'atan2':  # but for a constant
            return self.of(self._series('atan', a[0] / parts[1][0]),
                           self.times(a, self.inverse(parts[1])))
        if node.function in ('abs', 'sign'):
            side = flint().arb(1 if a[0] > 0 else -1)
            return a * side if node.function == 'abs' else self.constant(side)
        if node.function == 'tanh':
            e = self.of(self._series('exp', 2 * a[0]), a * 2)
            one = self.constant(flint().arb(1))
            return self.times(e - one, self.inverse(e + one))
        if node.function in ('sin', 'cos', 'tan', 'exp', 'log', 'asin', 'atan'):
            return self.of(self._series(node.function, a[0]), a)
        raise NotSmooth(node.function)

    def _power(self, a: Jet, p: float) -> Jet:
        if p.is_integer():
            base = a if p >= 0 else self.inverse(a)
            result = self.constant(flint().arb(1))
            for _ in range(int(abs(p))):
                result = self.times(result, base)
            return result
        side = 1 if a[0] > 0 else -1  # continued oddly
        exponent = fraction(p)
        whole = flint().arb(flint().fmpq(exponent.numerator, exponent.denominator))
        logarithm = self.of(self._series('log', a[0] * side), a * side)
        return self.of(self._series('exp', logarithm[0] * whole), logarithm * whole) * side

    def _series(self, function: str, x: Any) -> list[Any]:
        """Return the Taylor coefficients of a function at x."""
        library = flint()
        before, library.ctx.cap = library.ctx.cap, self.order + 1
        try:
            series = getattr(library.arb_series([x, 1], self.order + 1), function)()
            return [series[k] for k in range(self.order + 1)]
        finally:
            library.ctx.cap = before


def _exponents(n: int, total: int) -> list[tuple[int, ...]]:
    result = []
    for bars in itertools.combinations(range(total + n - 1), n - 1):
        cuts = (-1, *bars, total + n - 1)
        result.append(tuple(b - a - 1 for a, b in zip(cuts, cuts[1:])))
    return result
