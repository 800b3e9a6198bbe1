"""What is 0 in truth, of z and the healthy sensors: by it the run corrects what would stay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsensor_ros.designer.algebra import digits
from vsensor_ros.designer.algebra.candidate import (
    Candidate,
    exact_of,
    known_inputs,
    known_of,
    names_of_z,
)
from vsensor_ros.designer.algebra.coefficients import Function, next_of, plain_combination
from vsensor_ros.designer.algebra.fit import (
    Fitted,
    fitted,
    Known,
    over_known,
    plant_atoms,
    values_of,
)
from vsensor_ros.designer.algebra.invariant import constant_along
from vsensor_ros.designer.algebra.model import gradients, Model
from vsensor_ros.designer.algebra.null_space import kernels, null_space, ranks
from vsensor_ros.designer.algebra.reduction import Inside
from vsensor_ros.functions.expression import Apply, names, Node, substitute, walk

_DEGREE = 2
_SINGULAR = frozenset(('/', 'sqrt', 'log', '**', 'tan', 'asin'))
MOST_EXTRA = 3


def with_residuals(inside: Inside, candidate: Candidate) -> tuple[Candidate, tuple[Node, ...]]:
    """Return a candidate with functions that are tied to readings, and what is 0 in truth."""
    model = inside.model
    exact = exact_of(candidate.functions)
    known = known_of(model, candidate.names, candidate.functions)
    own = [*known, *known_inputs(model)]
    more = _tied(inside, candidate.functions, own, exact)
    if more:
        functions = (*candidate.functions, *(f for f, _ in more))
        z = names_of_z(model, len(functions))
        candidate = Candidate(model, z, functions, (*candidate.F, *(side for _, side in more)),
                              candidate.told, None)
        known = known_of(model, z, functions)
    return candidate, tuple(_relations(model, known, candidate.names, exact_of(
        candidate.functions)))


def _relations(model: Model, known: Sequence[Known], z: Sequence[str],
              exact: digits.Exact) -> list[Node]:
    """Return expressions that are 0 in truth and independent in z, over z and sensors."""
    dictionary = over_known(model, known, _DEGREE, False)
    if dictionary is None:
        return []
    columns = dictionary.values(values_of(model, known, model.points(
        len(dictionary) + 40, 301))).T
    basis = null_space(columns, np.abs(columns))
    inner = {k.name: k.node for k in known}
    text = {k.name: k.text for k in known}
    result: list[Node] = []
    at = values_of(model, known, model.points(9, 303))
    for i in sorted(range(basis.shape[1]), key=lambda i: float(
            dictionary.costs[basis[:, i] != 0.0].sum())):
        node = plain_combination(dictionary, basis[:, i])
        own = substitute(node, text)
        if not set(names(own)) & set(z):
            continue
        more = [*result, node]
        slopes = gradients(more, [k.name for k in known], at)[:, :len(z)]
        if not (ranks(slopes) == len(more)).all():
            continue
        terms = [substitute(part, inner) for part in _terms(node)]
        if digits.vanishes(terms, model.variables, model.points(20, 305), exact):
            result = more
    return [substitute(node, text) for node in result]


def _tied(inside: Inside, chosen: Sequence[Function], known: Sequence[Known],
         exact: digits.Exact) -> list[tuple[Function, Fitted]]:
    """
    Return more functions of gamma* that z and the healthy sensors tell, with their changes.

    Carried along they say nothing new at once; but what they should be is measured, and what they
    become depends on z: so they tell in time where z is.
    """
    model = inside.model
    x = model.points(len(inside.dictionary) + 20, 307)[:len(model.states)]
    with np.errstate(all='ignore'):
        K, d = kernels(gradients([*(f.node for f in chosen), *model.sensors.values()],
                                 model.states, x))
    span = constant_along(inside.dictionary, inside.gamma, x, K) if d else inside.gamma
    result: list[tuple[Function, Fitted]] = []
    atoms = [*known, *plant_atoms(model, known)]
    for f in inside.simplest_first(span):
        own = [*chosen, *(g for g, _ in result)]
        if len(result) == MOST_EXTRA or f.cost > _DEGREE + 4:
            break
        if not inside.missing(own, [f.node], sensors=False):
            continue
        side = fitted(model, next_of(model, f.node), atoms, exact, ((1, False), (2, False),
                                                                    (3, False)))
        if side is not None and not _singular(side.node) \
                and set(names(side.node)) & {k.text.id for k in known[:len(chosen)]}:  # type: ignore
            result.append((f, side))
    return result


def _singular(node: Node) -> bool:
    return any(isinstance(part, Apply) and part.function in _SINGULAR
               and not (part.function == '**' and not names(part.arguments[1]))
               for part in walk(node))


def _terms(node: Node) -> list[Node]:
    if isinstance(node, Apply) and node.function == '+':
        return [*_terms(node.arguments[0]), *_terms(node.arguments[1])]
    if isinstance(node, Apply) and node.function == '-':
        return [*_terms(node.arguments[0]),
                *(Apply('neg', (part,)) for part in _terms(node.arguments[1]))]
    return [node]
