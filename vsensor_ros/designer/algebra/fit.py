"""An expression of known quantities for a quantity that is a function of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import qr

from vsensor_ros.designer.algebra import digits
from vsensor_ros.designer.algebra.dictionary import (
    Atom,
    build,
    combination,
    Dictionary,
    state_atoms,
)
from vsensor_ros.designer.algebra.model import Model
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import (
    Apply,
    fold,
    Name,
    names,
    Node,
    Number,
    substitute,
    to_text,
    walk,
)

LEVELS = ((1, False), (2, False), (2, True), (3, False), (3, True), (4, False), (4, True))
_MOST = 420   # monomials
_FITS = 1e-9  # of the largest value: below it nothing is left over
_INDEPENDENT = 1e-9


@dataclass(frozen=True)
class Known:
    """A quantity that the run knows: over the states and inputs, and as the run has it."""

    name: str
    node: Node          # over the variables of the plant
    text: Node          # over z, sensors and inputs
    least: int = 0      # powers that are looked at
    most: int = 9
    angle: bool = False


def plant_atoms(model: Model, known: Sequence[Known]) -> list[Known]:
    """Return what stands in the equations as a function of known quantities alone."""
    by_state = {k.node.id: k for k in known if isinstance(k.node, Name)}
    found: dict[Node, Known] = {}
    for node in (*model.f, *model.sensors.values()):
        for part in walk(node):
            if not isinstance(part, Apply):
                continue
            if part.function == '/':
                part, least, most = part.arguments[1], -1, 0
                if not isinstance(part, Apply) or part.function in ('*', '**', '/', 'neg'):
                    continue
            elif part.function in ('+', '-', '*', '/', 'neg') or (
                    part.function == '**' and _whole(part)):
                continue
            else:
                least, most = (-1 if part.function == 'sqrt' else 0), 1
            inside = names(part)
            if not inside or not set(inside) <= set(by_state):
                continue
            if part.function in ('sin', 'cos') and isinstance(part.arguments[0], Name):
                continue  # the variable's own atoms hold these
            text = substitute(part, {name: by_state[name].text for name in inside})
            old = found.get(part)
            found[part] = Known(f'a{len(found)}', part, text, min(least, old.least if old else 0),
                                max(most, old.most if old else 0))
    return list(found.values())


@dataclass(frozen=True, eq=False)
class Fitted:
    """An expression over z, sensors and inputs, and the numbers in it to all digits."""

    node: Node
    exact: Mapping[float, Any]

    @property
    def text(self) -> str:
        """The expression in the language."""
        return to_text(self.node)


def fitted(model: Model, target: Node, known: Sequence[Known], exact: digits.Exact,
           levels: Sequence[tuple[int, bool]] = LEVELS) -> Fitted | None:
    """
    Return an expression that equals a target over the plant's variables, confirmed.

    exact: numbers in `target` and in `known` of which more than 16 digits are known.
    """
    for degree, laurent in levels:
        dictionary = over_known(model, known, degree, laurent)
        if dictionary is None:
            continue
        found = _in(model, dictionary, target, known, exact)
        if found is not None:
            return found
    return None


def over_known(model: Model, known: Sequence[Known], degree: int,
               laurent: bool) -> Dictionary | None:
    """Return the monomials over known quantities, or None when these are too many."""
    at = model.points(200, 7, declared=True)
    values = Equations([k.node for k in known], model.variables).values(at)
    atoms = []
    for k, value in zip(known, values):
        if (k.least, k.most) != (0, 9):
            atoms.append([Atom(Name(k.name), k.least if laurent or k.most < 1 else 0, k.most, 1)])
            continue
        waves = [part for node in model.f for part in walk(node)
                 if isinstance(part, Apply) and part.function in ('sin', 'cos')
                 and part.arguments[0] == k.node]
        atoms.append(state_atoms(k.name, bool((value > 0).all() or (value < 0).all()),
                                 [Apply('sin', (Name(k.name),))] if waves or k.angle else [],
                                 laurent, angle=k.angle))
    return build([k.name for k in known], atoms, degree, _MOST)


def values_of(model: Model, known: Sequence[Known], at: np.ndarray) -> np.ndarray:
    """Return known quantities (E, N) at points of the plant's variables."""
    with np.errstate(all='ignore'):
        return Equations([k.node for k in known], model.variables).values(at)


def _in(model: Model, dictionary: Dictionary, target: Node, known: Sequence[Known],
        exact: digits.Exact) -> Fitted | None:
    at = model.points(len(dictionary) + 30, 5)
    with np.errstate(all='ignore'):
        goal = Equations([target], model.variables).values(at)[0]
    columns = dictionary.values(values_of(model, known, at))
    good = np.isfinite(columns).all(axis=0) & np.isfinite(goal)
    columns, goal = columns[:, good].T, goal[good]
    if len(goal) < len(dictionary) + 5:
        return None
    size = np.abs(goal).max()
    if size == 0.0:
        return Fitted(Number(0.0), {})
    scale = np.abs(columns).max(axis=0)
    scale[scale == 0.0] = 1.0
    chosen = independent(columns / scale)
    c, *_ = np.linalg.lstsq(columns[:, chosen] / scale[chosen], goal / size, rcond=1e-14)
    if np.abs(columns[:, chosen] / scale[chosen] @ c - goal / size).max() > _FITS:
        return None
    support = [k for k, own in zip(chosen, c) if abs(own) > 1e-8]
    inner = {k.name: k.node for k in known}
    nodes = [substitute(dictionary.monomial(k), inner) for k in support]
    fresh = model.points(len(support) + 12, 11)
    sums = digits.solved(nodes, target, model.variables, fresh, exact)
    if sums is None:
        return None
    coefficients = np.zeros(len(dictionary))
    coefficients[support] = [float(own) for own in sums]
    node = combination(dictionary, coefficients)
    more = digits.by_float(sums)
    if not digits.same(target, substitute(node, inner), model.variables, model.points(20, 13),
                       {**exact, **more}):
        return None
    return Fitted(fold(substitute(node, {k.name: k.text for k in known})), more)


def independent(columns: np.ndarray) -> list[int]:
    """Return which columns (N, K) are independent of those before them."""
    R = qr(columns, mode='r')[0]
    size = np.linalg.norm(columns, axis=0)
    K = columns.shape[1]
    return [k for k in range(min(K, len(R))) if abs(R[k, k]) > _INDEPENDENT * size[k]]


def _whole(part: Apply) -> bool:
    p = part.arguments[1]
    return isinstance(p, Number) and p.value.is_integer()
