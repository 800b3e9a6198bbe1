"""Dictionaries: products of powers of atoms, each atom a function of one variable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import itertools

import numpy as np

from vsensor_ros.designer.algebra.derivative import (
    call,
    derivative,
    negative,
    ONE,
    over,
    power,
    SMOOTH,
    times,
    total,
)
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Apply, Name, names, Node, Number, walk

MOST = 700  # monomials


@dataclass(frozen=True)
class Atom:
    """A function of one variable, and the powers of it that are looked at."""

    node: Node
    least: int = 0
    most: int = 9
    cost: int = 0  # how much less simple than a power of the variable


@dataclass(frozen=True, eq=False)
class Dictionary:
    """K monomials over n variables; `factors`: by variable, its products of powers of atoms."""

    variables: tuple[str, ...]
    factors: tuple[tuple[Node, ...], ...]
    chosen: np.ndarray  # (K, n) of the factors
    costs: np.ndarray   # (K,) the simpler the less

    def __len__(self) -> int:
        return len(self.chosen)

    @cached_property
    def _tables(self) -> list[Equations]:
        result = []
        for name, factors in zip(self.variables, self.factors):
            slopes = [derivative(node, name) for node in factors]
            result.append(Equations([*factors, *slopes, *(derivative(s, name) for s in slopes)],
                                    [name]))
        return result

    def _logarithmic(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return values (K, N), and g'/g and g''/g (K, n, N) by variable, at points (n, N)."""
        K, n = self.chosen.shape
        value = np.ones((K, at.shape[1]))
        first, second = np.zeros((2, K, n, at.shape[1]))
        with np.errstate(all='ignore'):
            for i, (table, factors) in enumerate(zip(self._tables, self.factors)):
                g = table.values(at[i:i + 1]).reshape(3, len(factors), -1)[:, self.chosen[:, i]]
                value *= g[0]
                first[:, i], second[:, i] = g[1] / g[0], g[2] / g[0]
        return value, first, second

    @cached_property
    def _plain(self) -> list[Equations]:
        return [Equations(factors, [name]) for name, factors in zip(self.variables, self.factors)]

    def values(self, at: np.ndarray) -> np.ndarray:
        """Return the monomials (K, N) at points (n, N)."""
        value = np.ones((len(self), at.shape[1]))
        with np.errstate(all='ignore'):
            for i, table in enumerate(self._plain):
                value *= table.values(at[i:i + 1])[self.chosen[:, i]]
        return value

    def gradients(self, at: np.ndarray) -> np.ndarray:
        """Return the gradients (K, n, N)."""
        value, first, _ = self._logarithmic(at)
        return first * value[:, None]

    def along(self, at: np.ndarray, f: np.ndarray, slopes: np.ndarray,
              v: np.ndarray, rough: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the derivative along v of the derivative along f, (K, N), and its size.

        f, v (n, N); slopes (n, n, N): df/dx; rough: the size of v. The size sums absolute values.
        """
        value, first, second = self._logarithmic(at)
        turned = np.einsum('ijN,jN->iN', slopes, v)
        bend = second - first * first

        def summed(f: np.ndarray, v: np.ndarray, turned: np.ndarray, first: np.ndarray,
                   bend: np.ndarray) -> np.ndarray:
            by_f, by_v, by_turned = (np.einsum('KiN,iN->KN', first, w) for w in (f, v, turned))
            return by_f * by_v + np.einsum('KiN,iN->KN', bend, f * v) + by_turned

        around = np.einsum('ijN,jN->iN', np.abs(slopes), rough)
        return value * summed(f, v, turned, first, bend), np.abs(value) * summed(
            np.abs(f), rough, around, np.abs(first), np.abs(bend))

    def powers(self, k: int) -> dict[Node, float]:
        """Return one as powers of its atoms."""
        result: dict[Node, float] = {}
        for factors, i in zip(self.factors, self.chosen[k]):
            for part in _parts(factors[i]):
                base, p = part, 1.0
                if isinstance(part, Apply) and part.function == '**' \
                        and isinstance(exponent := part.arguments[1], Number):
                    base, p = part.arguments[0], exponent.value
                result[base] = result.get(base, 0.0) + p
        return result

    def monomial(self, k: int) -> Node:
        """Return one as an expression."""
        return product(self.powers(k))


def build(variables: Sequence[str], atoms: Sequence[Sequence[Atom]], degree: int,
          most: int = MOST) -> Dictionary | None:
    """Return all products up to a degree, the simplest first; None when too many, > most."""
    factors: list[list[tuple[Node, int, int]]] = []  # node, degree, cost
    for own in atoms:
        found: list[tuple[Node, int, int]] = []
        for powers in itertools.product(*(range(max(a.least, -degree), min(a.most, degree) + 1)
                                          for a in own)):
            size = sum(map(abs, powers))
            if size <= degree:
                node: Node = ONE
                for atom, p in zip(own, powers):
                    node = times(node, power(atom.node, float(p))) if p else node
                found.append((node, size, sum(abs(p) * a.cost + (p < 0)
                                              for a, p in zip(own, powers))))
        factors.append(sorted(found, key=lambda item: item[1]))
    combos: list[tuple[tuple[int, ...], int, int]] = [((), 0, 0)]
    for own_factors in factors:
        combos = [((*chosen, i), size + d, cost + c) for chosen, size, cost in combos
                  for i, (_, d, c) in enumerate(own_factors) if size + d <= degree]
        if len(combos) > most:
            return None
    combos.sort(key=lambda item: (item[1] + item[2], item[1]))
    return Dictionary(tuple(variables), tuple(tuple(node for node, _, _ in own)
                                              for own in factors),
                      np.array([c for c, _, _ in combos]).reshape(len(combos), len(factors)),
                      np.array([1.0 + size + cost for _, size, cost in combos]))


def state_atoms(name: str, positive: bool, plant: Sequence[Node], laurent: bool = False,
                curved: bool = False, angle: bool = False) -> list[Atom]:
    """
    Return the atoms of a variable: itself, unless an angle, and what the plant makes of it.

    plant: expressions in which functions of it alone stand; laurent: negative powers too;
    curved: with log and sqrt. Both only where it is positive, or negative, all over its range.
    """
    x = Name(name)
    atoms = [] if angle else [Atom(x, -2 if laurent and positive else 0)]
    waves: list[Node] = [x] if angle else []
    others: list[Node] = []
    for node in plant:
        for part in walk(node):
            if isinstance(part, Apply) and set(names(part)) == {name} \
                    and part.function in SMOOTH - {'+', '-', '*', '/', 'neg'}:
                if part.function in ('sin', 'cos'):
                    waves.append(part.arguments[0])
                elif not (part.function == '**' and isinstance(p := part.arguments[1], Number)
                          and p.value.is_integer()) and curved:
                    others.append(part)
    for inner in dict.fromkeys(waves):
        atoms += [Atom(call('cos', inner), 0, 1, not angle),
                  Atom(call('sin', inner), 0, 9, not angle)]
    if curved and positive:
        others += [call('log', x), call('sqrt', x)]
    least = -1 if laurent else 0
    return atoms + [Atom(node, least if node == call('sqrt', x) else 0, 1, 1)
                    for node in dict.fromkeys(others)]


def combination(dictionary: Dictionary, coefficients: np.ndarray) -> Node:
    """Return a linear combination as an expression; what all have in common is put in front."""
    terms = [(k, float(c)) for k, c in enumerate(coefficients) if c]
    terms.sort(key=lambda term: -dictionary.costs[term[0]])
    powers = [dictionary.powers(k) for k, _ in terms]
    common = {}
    for base in powers[0] if len(terms) > 1 else ():
        all_p = [own.get(base, 0.0) for own in powers]
        if min(all_p) > 0.0 or max(all_p) < 0.0:
            common[base] = min(all_p, key=abs)
    sums = [scaled(c, product({base: p - common.get(base, 0.0) for base, p in own.items()}))
            for (_, c), own in zip(terms, powers)]
    if len(sums) > 1 and _leads_with_minus(sums[0]):
        sums.sort(key=_leads_with_minus)
    above = {base: p for base, p in common.items() if p > 0.0}
    below = {base: -p for base, p in common.items() if p < 0.0}
    whole = times(product(above), total(sums))
    return over(whole, product(below)) if below else whole


def product(powers: Mapping[Node, float]) -> Node:
    """Return the product of powers as an expression, a quotient where some are negative."""
    above: Node = ONE
    below: Node = ONE
    for base, p in powers.items():
        if p > 0.0:
            above = times(above, power(base, p))
        elif p < 0.0:
            below = times(below, power(base, -p))
    return over(above, below)


def scaled(c: float, node: Node) -> Node:
    """Return c times an expression."""
    if c < 0.0:
        return negative(scaled(-c, node))
    if isinstance(node, Apply) and node.function == '/':
        return over(scaled(c, node.arguments[0]), node.arguments[1])
    return times(Number(c), node)


def _leads_with_minus(node: Node) -> bool:
    return isinstance(node, Apply) and node.function == 'neg'


def _parts(node: Node) -> list[Node]:
    if isinstance(node, Apply) and node.function == '*':
        return [*_parts(node.arguments[0]), *_parts(node.arguments[1])]
    return [] if node == ONE else [node]
