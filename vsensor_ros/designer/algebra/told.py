"""What is wanted as an expression of z and the healthy sensors: the output map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.designer.algebra import digits
from vsensor_ros.designer.algebra.derivative import (
    add,
    call,
    minus,
    negative,
    ONE,
    over,
    power,
    times,
    total,
    ZERO,
)
from vsensor_ros.designer.algebra.dictionary import Dictionary, scaled
from vsensor_ros.designer.algebra.fit import (
    Fitted,
    fitted,
    independent,
    Known,
    over_known,
    values_of,
)
from vsensor_ros.designer.algebra.model import Model
from vsensor_ros.designer.algebra.null_space import null_space
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import fold, Node, Number, substitute

_SMALL = 1e-7


@dataclass(frozen=True, eq=False)
class Told:
    """An expression for what is wanted; branch: the sign of a root in it, 0 where both occur."""

    fit: Fitted
    branch: int = 1


def output(model: Model, wanted: Node, known: Sequence[Known],
           exact: digits.Exact) -> Told | None:
    """Return wanted, over the states, as an expression of known quantities; None: not found."""
    positive = bool((_values(model, wanted) > 0.0).all())
    for level in ((1, False), (2, False), (2, True)):
        found = fitted(model, wanted, known, exact, (level,))
        if found is not None:
            return Told(found)
        if level == (2, False):
            continue
        for J in (1, 2):
            told = _relation(model, wanted, known, exact, level[0], J)
            if told is not None:
                return told
        if positive:
            for there, back in _MAPS:
                inner = fitted(model, there(wanted), known, exact, (level,))
                if inner is not None:
                    return Told(Fitted(back(inner.node), inner.exact))
    for degree in (3, 4):
        for J in (1, 2):
            told = _relation(model, wanted, known, exact, degree, J)
            if told is not None:
                return told
        found = fitted(model, wanted, known, exact, ((degree, False), (degree, True)))
        if found is not None:
            return Told(found)
    return None


_MAPS = ((lambda v: call('log', v), lambda w: call('exp', w)),
         (lambda v: over(ONE, v), lambda w: over(ONE, w)),
         (lambda v: call('exp', v), lambda w: call('log', w)),
         (lambda v: power(v, 3.0), lambda w: power(w, 1.0 / 3.0)))


def _values(model: Model, node: Node) -> np.ndarray:
    at = model.points(400, 51, declared=True)[:len(model.states)]
    with np.errstate(all='ignore'):
        return Equations([node], model.states).values(at)[0]


def _relation(model: Model, wanted: Node, known: Sequence[Known], exact: digits.Exact,
              degree: int, J: int) -> Told | None:
    """Return a root of sum_j a_j wanted^j = 0, the a_j polynomials of known quantities."""
    dictionary = over_known(model, known, degree, False)
    if dictionary is None:
        return None
    sizes = [sum(int(size) for size in _degrees(dictionary, k)) for k in range(len(dictionary))]
    at = model.points((J + 1) * len(dictionary) + 40, 53)
    with np.errstate(all='ignore'):
        v = Equations([wanted], model.variables).values(at)[0]
    m = dictionary.values(values_of(model, known, at))
    good = np.isfinite(m).all(axis=0) & np.isfinite(v)
    m, v = m[:, good].T, v[good]
    if not len(m):
        return None
    plain = independent(m / np.maximum(np.abs(m).max(axis=0), 1e-300))
    index = [(j, k) for j in range(J + 1) for k in plain if sizes[k] + j <= degree]
    columns = np.stack([v ** j * m[:, k] for j, k in index], axis=1)
    basis = null_space(columns, np.abs(columns))
    for c in sorted(basis.T, key=lambda c: int((c != 0.0).sum())):
        support = [i for i, own in enumerate(c)
                   if abs(own) * np.abs(columns[:, i]).max() > _SMALL * (
                       np.abs(c) * np.abs(columns).max(axis=0)).max()]
        if not any(index[i][0] == J for i in support):
            continue
        told = _root(model, wanted, known, exact, dictionary, [index[i] for i in support], J)
        if told is not None:
            return told
    return None


def _root(model: Model, wanted: Node, known: Sequence[Known], exact: digits.Exact,
          dictionary: Dictionary, support: list[tuple[int, int]], J: int) -> Told | None:
    inner = {k.name: k.node for k in known}
    text = {k.name: k.text for k in known}
    nodes = [times(substitute(dictionary.monomial(k), inner), power(wanted, float(j)))
             for j, k in support]
    if len(nodes) < 2:
        return None
    found = digits.solved(nodes[:-1], negative(nodes[-1]), model.variables,
                          model.points(len(nodes) + 12, 57), exact)
    if found is None:
        return None
    more = digits.by_float(found)
    numbers = [*map(float, found), 1.0]
    if not digits.vanishes([scaled(c, node) if c else ZERO for c, node in zip(numbers, nodes)],
                           model.variables, model.points(20, 59), {**exact, **more}):
        return None

    def part(power_of: int, over_states: bool) -> Node:
        return total([scaled(c, substitute(dictionary.monomial(k), inner if over_states else text))
                      for c, (j, k) in zip(numbers, support) if j == power_of and c])
    if J == 1:
        return Told(Fitted(over(negative(part(0, False)), part(1, False)), more))
    slope = add(times(times(Number(2.0), part(2, True)), wanted), part(1, True))
    signs = np.sign(_values(model, slope))
    branch = int(signs[0]) if (signs == signs[0]).all() else 0
    a, b, c = (part(j, False) for j in (2, 1, 0))
    if b == ZERO:
        if isinstance(a, Number) and a.value < 0.0:
            a, c, branch = Number(-a.value), negative(c), -branch
        root = call('sqrt', over(negative(c), a))
        node = negative(root) if branch < 0 else root
    else:
        root = call('sqrt', minus(power(b, 2.0), times(times(Number(4.0), a), c)))
        node = over(minus(negative(root) if branch < 0 else root, b), times(Number(2.0), a))
    return Told(Fitted(fold(node), more), branch)


def _degrees(dictionary: Dictionary, k: int) -> list[float]:
    return [abs(p) for p in dictionary.powers(k).values()]
