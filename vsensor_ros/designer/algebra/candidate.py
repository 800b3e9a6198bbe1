"""Functions inside gamma* with their right-hand sides and the output map: an observer to judge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsensor_ros.designer.algebra import digits
from vsensor_ros.designer.algebra.answer import Answer, Verdict
from vsensor_ros.designer.algebra.coefficients import Function, next_of
from vsensor_ros.designer.algebra.contraction import ErrorSystem
from vsensor_ros.designer.algebra.derivative import call, derivative, rebuilt
from vsensor_ros.designer.algebra.fit import Fitted, fitted, Known, plant_atoms
from vsensor_ros.designer.algebra.invariant import products
from vsensor_ros.designer.algebra.model import Model
from vsensor_ros.designer.algebra.preimage import second_preimage, Twins
from vsensor_ros.designer.algebra.reduction import closed, Inside
from vsensor_ros.designer.algebra.told import output, Told
from vsensor_ros.functions.expression import Name, names, Node, Number, substitute
from vsensor_ros.reason import Reason

_SEPARATED = 4  # functions added at most so that the output map has one value
_SLOPES = ((1, False), (2, False), (2, True))


@dataclass(frozen=True, eq=False)
class Candidate:
    """An observer before anything is known of its error."""

    model: Model
    names: tuple[str, ...]
    functions: tuple[Function, ...]
    F: tuple[Fitted, ...]
    told: dict[str, Told]
    twins: Twins | None


def targets_of(model: Model) -> dict[str, Node]:
    """Return what must be told: of an angle its cosine and its sine."""
    result: dict[str, Node] = {}
    for name, node in model.wanted.items():
        if isinstance(node, Name) and node.id in model.system.angles:
            result[f'cos {name}'], result[f'sin {name}'] = call('cos', node), call('sin', node)
        else:
            result[name] = node
    return result


def candidate_in(inside: Inside, begun: Sequence[Function]) -> Candidate | Answer | None:
    """Return functions inside gamma*, their right-hand sides and the output map."""
    model = inside.model
    targets = targets_of(model)
    chosen = closed(inside, begun, list(targets.values()))
    twins = None
    for _ in range(_SEPARATED):
        if chosen is None:
            return None
        twins = second_preimage([*(f.node for f in chosen), *model.sensors.values()],
                                list(targets.values()), model.system.states, model.system.angles)
        if twins is None:
            break
        more = inside.component(chosen, list(targets.values()), twins)
        if more is None:
            break
        chosen = closed(inside, [*chosen, more], list(targets.values()))
    if chosen is None:
        return None
    return completed(model, chosen, twins)


def completed(model: Model, chosen: Sequence[Function],
              twins: Twins | None) -> Candidate | Answer:
    """Return a candidate of chosen functions: their right-hand sides and the output map."""
    targets = targets_of(model)
    phi = ', '.join(f.text for f in chosen)
    own_names = names_of_z(model, len(chosen))
    exact = exact_of(chosen)
    known = known_of(model, own_names, chosen)
    told: dict[str, Told] = {}
    for name, node in targets.items():
        found = output(model, node, known, exact)
        if found is None:
            return Answer(Verdict.NOT_DECIDED, Reason.of('functions no output map', wanted=name))
        told[name] = found
    F = right_sides(model, chosen, known, told, exact)
    if F is None:
        return Answer(Verdict.NOT_DECIDED, Reason.of('functions no right side', phi=phi))
    return Candidate(model, own_names, tuple(chosen), tuple(F), told, twins)


def known_of(model: Model, own_names: Sequence[str],
             chosen: Sequence[Function]) -> list[Known]:
    """Return z and what the healthy sensors show."""
    return [*(Known(name, f.node, Name(name)) for name, f in zip(own_names, chosen)),
            *(Known(f's{i}', node, Name(name), angle=isinstance(node, Name)
                    and node.id in model.system.angles)
              for i, (name, node) in enumerate(model.sensors.items()))]


def known_inputs(model: Model) -> list[Known]:
    """Return what is commanded."""
    return [Known(f'u{i}', Name(name), Name(name), 0, 2) for i, name in enumerate(model.inputs)]


def exact_of(chosen: Sequence[Function]) -> dict[float, Any]:
    """Return all numbers in functions of which more than 16 digits are known."""
    return {x: ball for f in chosen for x, ball in f.exact.items()}


def names_of_z(model: Model, k: int) -> tuple[str, ...]:
    """Return names for z that no sensor, input or state has."""
    taken = {*model.variables, *model.sensors}
    prefix = 'z'
    while any(f'{prefix}{i + 1}' in taken for i in range(k)):
        prefix += 'z'
    return tuple(f'{prefix}{i + 1}' for i in range(k))


def right_sides(model: Model, chosen: Sequence[Function], known: Sequence[Known],
                told: dict[str, Told], exact: digits.Exact) -> list[Fitted] | None:
    """Return the change of each function as an expression of what the run knows."""
    known = [*known, *known_inputs(model)]
    wanted = [*known, *(Known(f'v{i}', node, told[name].fit.node)
                        for i, (name, node) in enumerate(targets_of(model).items()))]
    more: list[Known] | None = None
    result = []
    for f in chosen:
        target = next_of(model, f.node)
        found = None
        for own in (known, wanted):
            found = found or fitted(model, target, [*own, *plant_atoms(model, own)], exact)
        if found is None:
            more = more or recovered(model, chosen, wanted, exact)
            found = fitted(model, target, [*more, *plant_atoms(model, more)], exact)
        if found is None:
            found = substituted(model, target, more or [], exact)
        if found is None:
            return None
        result.append(found)
    return result


def slopes_of(candidate: Candidate) -> tuple[tuple[str, ...], ...]:
    """Return dphi/dx (k, n) as expressions of what the run knows; () where one is none."""
    model = candidate.model
    known, exact = known_of(model, candidate.names, candidate.functions), exact_of(
        candidate.functions)
    known = [*known, *plant_atoms(model, known)]
    rows = []
    for f in candidate.functions:
        row = [fitted(model, derivative(f.node, state), known, exact, _SLOPES)
               for state in model.states]
        if None in row:
            return ()
        rows.append(tuple(found.text for found in row if found is not None))
    return tuple(rows)


def recovered(model: Model, chosen: Sequence[Function], known: Sequence[Known],
              exact: digits.Exact) -> list[Known]:
    """Return what is known, and which states follow from it, as they follow."""
    result = list(known)
    own = [k for k in known if not set(names(k.node)) & set(model.inputs)]
    states = products(model, 1, False, False)
    assert states is not None  # so few there may always be
    inside = Inside(model, states, np.zeros((0, 0)))
    for i, state in enumerate(model.states):
        if any(k.node == Name(state) for k in result) or inside.missing(chosen, [Name(state)]):
            continue
        found = output(model, Name(state), own, exact)
        if found is not None:
            result.append(Known(f'x{i}', Name(state), found.fit.node))
    return result


def substituted(model: Model, target: Node, known: Sequence[Known],
                exact: digits.Exact) -> Fitted | None:
    """Return a target with known states in it, what cannot matter at the middle of its range."""
    by_state = {k.node.id: k for k in known if isinstance(k.node, Name)}
    middle = {name: Number(0.5 * (low + high))
              for name, (low, high) in zip(model.variables, model.declared)}
    node = substitute(target, {name: by_state[name].text if name in by_state else middle[name]
                               for name in model.variables})
    inner = {name: by_state[name].node if name in by_state else middle[name]
             for name in model.variables}
    there = substitute(target, inner)
    if not digits.same(target, there, model.variables, model.points(20, 91), exact):
        return None
    return Fitted(rebuilt(node), {})


def error_system(candidate: Candidate, signs: tuple[tuple[Node, int], ...] = ()) -> ErrorSystem:
    """Return what the error of a candidate is judged by."""
    return ErrorSystem(candidate.model, candidate.names,
                       tuple(f.node for f in candidate.functions),
                       tuple(F.node for F in candidate.F), signs)
