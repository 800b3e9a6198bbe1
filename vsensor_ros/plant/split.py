"""
Split equations into A x + B u + D rho and nonlinear terms (the method, section 1).

An equation is a sum of addends. Those affine in the names give A, B and D. Any other addend
is a coefficient times a core; equal cores in several equations are one term with several
entries in its column of P. The largest parts of a core that are affine in the states become
its arguments w = G x; inputs, offsets and numbers stay in its text.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.affine import affine, OFFSET, plus
from vsensor_ros.functions.expression import (
    Apply,
    Closure,
    compile_node,
    fold,
    Name,
    names,
    Node,
    Number,
    substitute,
    to_text,
    to_words,
)
from vsensor_ros.functions.nonlinearity import (
    argument_names,
    evaluate,
    make_term,
    NonlinearTerm,
    slope_at,
)
from vsensor_ros.plant.plain_name import affine_node, CONSTANT

_ONE = Number(1.0)


@dataclass(frozen=True, eq=False)
class Split:
    """The equations as arrays: n states, m inputs, d disturbances, q terms."""

    A: np.ndarray                       # (n, n)
    B: np.ndarray                       # (n, m)
    D: np.ndarray                       # (n, d)
    P: np.ndarray                       # (n, q)
    G: tuple[np.ndarray, ...]           # q arrays (r_i, n)
    terms: tuple[NonlinearTerm, ...]    # q
    rest: tuple[tuple[Node, ...], ...] = ()  # n: nonlinear addends that hold a disturbance

    def slower(self, factor: float) -> Split:
        """Return it with every rate so many times smaller: per second instead of per minute."""
        if factor == 1.0:
            return self
        return replace(self, A=self.A / factor, B=self.B / factor, D=self.D / factor,
                       P=self.P / factor, rest=tuple(tuple(
                           fold(Apply('/', (node, Number(factor)))) for node in nodes)
                           for nodes in self.rest))


def split_equations(equations: Sequence[Node], states: Sequence[str], inputs: Sequence[str],
                    disturbances: Sequence[str], where: object, key: str = 'dynamics',
                    definitions: Mapping[str, Node] = MappingProxyType({})) -> Split:
    """
    Split one right-hand side a state; the only names left are states, inputs, disturbances.

    And those of definitions, which are no sums: terms name them as they were written, and so
    parameters and tables. No formal addend is taken out. Nonlinear addends with a disturbance
    in them are left as they are, see `plant/unknown_inputs.py`.
    """
    n, unknown = len(states), set(disturbances)
    rest: list[list[Node]] = [[] for _ in states]
    A, B, D = np.zeros((n, n)), np.zeros((n, len(inputs))), np.zeros((n, len(disturbances)))
    # a core, known by its text and rows -> its arguments G, its column of P, its name
    cores: dict[tuple[str, bytes], tuple[np.ndarray, np.ndarray, str]] = {}
    for i, equation in enumerate(equations):
        place = f'{key}.{states[i]}'
        linear, nonlinear = addends(equation, where, place, definitions)
        A[i] = [linear.get(name, 0.0) for name in states]
        B[i] = [linear.get(name, 0.0) for name in inputs]
        D[i] = [linear.get(name, 0.0) for name in disturbances]
        if OFFSET in linear:
            nonlinear.append((linear[OFFSET], _ONE))
        for factor, core in nonlinear:
            whole = substitute(core, definitions)
            if not unknown.isdisjoint(names(whole)):
                rest[i].append(whole if factor == 1.0 else Apply('*', (Number(factor), whole)))
                continue
            rows: list[np.ndarray] = []
            text = to_text(lifted(core, states, inputs, rows, definitions))
            G = np.array(rows).reshape(len(rows), n)
            name = CONSTANT if core == _ONE else to_words(core)
            _, column, _ = cores.setdefault((text, G.tobytes()), (G, np.zeros(n), name))
            column[i] += factor
    # a core whose addends cancel is no term
    kept = [(text, G, column, name) for (text, _), (G, column, name) in cores.items()
            if column.any()]
    terms = []
    for text, G, _, name in kept:
        terms.append(make_term(text, len(G), inputs, where, f'{key}: {name}', name))
    return Split(A, B, D, np.array([c for _, _, c, _ in kept]).reshape(len(kept), n).T,
                 tuple(G for _, G, _, _ in kept), tuple(terms), tuple(map(tuple, rest)))


def addends(node: Node, where: object, key: str, nonlinear_names: Container[str] = (),
            ) -> tuple[dict[str, float], list[tuple[float, Node]]]:
    """Return the affine part as by `affine`, and the other addends as (coefficient, core)."""
    nonlinear: list[tuple[float, Node]] = []
    linear = _collect(_reduced(node, where, key), 1.0, {}, nonlinear)
    for name in [name for name in linear if name in nonlinear_names]:
        nonlinear.append((linear.pop(name), Name(name)))
    return linear, nonlinear


def _reduced(node: Node, where: object, key: str) -> Node:
    # with a number for every part that depends on nothing, such as x - x + 4 or 0*sqrt(x)
    if not isinstance(node, Apply):
        return node
    parts = tuple(_reduced(argument, where, key) for argument in node.arguments)
    node = fold(replace(node, arguments=parts), where, key)
    form = affine(node)
    if form is not None and set(form) <= {OFFSET}:
        return Number(form.get(OFFSET, 0.0))
    return node if _scaled(node)[0] else Number(0.0)


def _collect(node: Node, factor: float, linear: dict[str, float],
             nonlinear: list[tuple[float, Node]]) -> dict[str, float]:
    # the affine part of factor * node added to linear; the other addends put in nonlinear
    form = affine(node)
    if form is not None:
        return plus(linear, form, factor)
    scale, core = _scaled(node)
    if isinstance(core, Apply) and core.function in ('+', '-'):
        left, right = core.arguments
        linear = _collect(left, factor * scale, linear, nonlinear)
        return _collect(right, factor * scale * (1.0 if core.function == '+' else -1.0),
                        linear, nonlinear)
    if factor * scale:
        nonlinear.append((factor * scale, core))
    return linear


def _scaled(node: Node) -> tuple[float, Node]:
    # node = number * core, with every number of a product taken out
    if isinstance(node, Number):
        return node.value, _ONE
    if isinstance(node, Apply) and node.function == 'neg':
        scale, core = _scaled(node.arguments[0])
        return -scale, core
    if isinstance(node, Apply) and node.function in ('*', '/'):
        (a, left), (b, right) = (_scaled(argument) for argument in node.arguments)
        if node.function == '*':
            core = right if left == _ONE else left if right == _ONE \
                else Apply('*', (left, right))
            return a * b, core
        if b:
            return a / b, left if right == _ONE else Apply('/', (left, right))
    return 1.0, node


def lifted(node: Node, states: Sequence[str], inputs: Sequence[str],
           rows: list[np.ndarray],
           definitions: Mapping[str, Node] = MappingProxyType({})) -> Node:
    """Return the core over w1.. and the inputs; the rows of G (.., n) are appended to rows."""
    if isinstance(node, Name) and node.id in definitions:
        return lifted(definitions[node.id], states, inputs, rows)
    form = affine(node)
    if form is None or not definitions.keys().isdisjoint(form):
        assert isinstance(node, Apply)
        return Apply(node.function, tuple(lifted(a, states, inputs, rows, definitions)
                                          for a in node.arguments))
    row = np.array([form.get(name, 0.0) for name in states])
    coefficients, variables = [form.get(name, 0.0) for name in inputs], list(inputs)
    if row.any():
        index, ratio = _place(row, rows)
        coefficients.insert(0, ratio)
        variables.insert(0, argument_names(index + 1)[index])
    return affine_node(coefficients, variables, form.get(OFFSET, 0.0))


def _place(row: np.ndarray, rows: list[np.ndarray]) -> tuple[int, float]:
    # a multiple of a row that is already there needs no argument of its own
    for index, known in enumerate(rows):
        first = int(np.flatnonzero(known)[0])
        ratio = float(row[first] / known[first])
        if ratio and np.array_equal(row, ratio * known):
            return index, ratio
    rows.append(row)
    return len(rows) - 1, 1.0


def with_addends(split: Split, point: np.ndarray, inputs: Sequence[str],
                 u: np.ndarray) -> Split:
    """
    Move the formal addends into A, so that A is the linearisation at (point, u).

    Slopes are 0 at kinks and outside a domain. Source: the method, 3.2; R, after (17).
    """
    A = split.A.copy()
    terms = []
    for term, G, column in zip(split.terms, split.G, split.P.T):
        slope = slope_at(term, G @ point, inputs, u)
        A += np.outer(column, slope @ G)
        terms.append(NonlinearTerm(term.name, term.text, slope))
    return replace(split, A=A, terms=tuple(terms))


def check_split(split: Split, equations: Sequence[Node], states: Sequence[str],
                inputs: Sequence[str], disturbances: Sequence[str], near: np.ndarray,
                where: object, key: str = 'dynamics') -> None:
    """
    Compare the split with the equations at random points around `near` (n,).

    Raises BadInput when they differ by more than 1e-9 of the size of their addends.
    """
    count = 32
    random = np.random.default_rng(0)
    spread = 1.0 + np.abs(near)[:, np.newaxis]
    x = near[:, np.newaxis] + spread * random.standard_normal((len(states), count))
    u = random.standard_normal((len(inputs), count))
    rho = random.standard_normal((len(disturbances), count))
    values = dict(zip((*states, *inputs, *disturbances), (*x, *u, *rho)))
    fetch: dict[str, Closure] = {name: _value(name) for name in values}
    with np.errstate(all='ignore'):
        linear = split.A @ x + split.B @ u + split.D @ rho
        size = 1.0 + abs(split.A) @ abs(x) + abs(split.B) @ abs(u) + abs(split.D) @ abs(rho)
        for term, G, column in zip(split.terms, split.G, split.P.T):
            psi = evaluate(term, G @ x, inputs, u)
            psi = np.broadcast_to(psi, (count,))
            linear = linear + np.outer(column, psi)
            size = size + abs(np.outer(column, abs(psi) + abs(term.slope) @ abs(G @ x)))
        for i, equation in enumerate(equations):
            truth = np.broadcast_to(compile_node(equation, fetch)(values), (count,))
            for node in split.rest[i] if split.rest else ():
                more = compile_node(node, fetch)(values)
                linear[i], size[i] = linear[i] + more, size[i] + abs(more)
            # an overflow says nothing of the split
            usable = np.isfinite(truth) & np.isfinite(linear[i])
            error = np.max(np.abs(truth - linear[i]) / size[i], where=usable, initial=0.0)
            if not usable.any() or error > 1e-9:
                raise BadInput(where, f'{key}.{states[i]}',
                               f'its matrix form differs from it by {error:.1e} relative'
                               if usable.any() else 'is not finite near the operating point',
                               'scale the equation, or write it as a plain sum of addends')


def _value(name: str) -> Closure:
    return lambda values: values[name]
