"""The entrance: a virtual sensor from the algebra of functions, or why there is none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from vsensor_ros.designer.algebra import digits, sentences
from vsensor_ros.designer.algebra.answer import (
    Answer,
    CERTIFIED,
    Observer,
    SAMPLED,
    System,
    TEMPORARY,
    Verdict,
)
from vsensor_ros.designer.algebra.coefficients import Function, next_of
from vsensor_ros.designer.algebra.contraction import ErrorSystem, Stability, stability
from vsensor_ros.designer.algebra.derivative import call, rebuilt
from vsensor_ros.designer.algebra.dictionary import build, Dictionary, state_atoms
from vsensor_ros.designer.algebra.fit import Fitted, fitted, Known, plant_atoms
from vsensor_ros.designer.algebra.forced import forced
from vsensor_ros.designer.algebra.invariant import evaluated, largest
from vsensor_ros.designer.algebra.measured import (
    gain,
    measured_functions,
    MOST_MEASURED,
    taken_off,
)
from vsensor_ros.designer.algebra.model import Model, read
from vsensor_ros.designer.algebra.null_space import ranks
from vsensor_ros.designer.algebra.preimage import second_preimage, Twins
from vsensor_ros.designer.algebra.reduction import beginnings, closed, Inside
from vsensor_ros.designer.algebra.residuals import relations, tied
from vsensor_ros.designer.algebra.told import output, Told
from vsensor_ros.designer.algebra.validity import conditions
from vsensor_ros.functions.expression import Name, names, Node, Number, substitute, to_text
from vsensor_ros.reason import Reason

# degree, negative powers, log and sqrt: the cheap ones first
LEVELS = ((1, False, False), (2, False, False), (2, True, False), (2, True, True),
          (3, False, False), (3, True, False), (3, True, True), (4, False, False))
_WIDER = (2, False, False)
_BEFORE_PROOF = 2  # levels, which are cheaper than to prove that there is nothing
_BEGINNINGS = 5  # functions tried, while the error of an observer of one may grow
AT_ONCE = Stability(CERTIFIED, math.inf, np.zeros((0, 0)))  # there is no state to be off
_SEPARATED = 4  # functions added at most so that the output map has one value


@dataclass(frozen=True, eq=False)
class Candidate:
    """An observer before anything is known of its error."""

    model: Model
    names: tuple[str, ...]
    functions: tuple[Function, ...]
    F: tuple[Fitted, ...]
    told: dict[str, Told]
    twins: Twins | None


def find(system: System, levels: Sequence[tuple[int, bool, bool]] = LEVELS) -> Answer:
    """
    Look for an observer z = phi(x) that no unknown input disturbs, in growing dictionaries.

    levels: (degree, negative powers, log and sqrt). Raises BadInput where the system cannot be
    read.
    """
    model = read(system)
    assert sentences
    wanted = ', '.join(system.wanted)
    if model.discrete and (short := image_rank(model)) < len(model.states):
        return Answer(Verdict.NOT_DECIDED, Reason.of(
            'functions not submersive', rank=short, states=len(model.states)))
    refused: Answer | None = None
    looked_at = (0, 0)
    for i, level in enumerate(levels):
        if i == min(_BEFORE_PROOF, len(levels) - 1):
            proof = forced(model, list(targets_of(model).values()))
            if proof is not None and proof.blocks:
                return Answer(Verdict.NO, Reason.of(
                    'functions impossible', wanted=wanted, dimension=proof.dimension,
                    states=len(model.states)))
        own = dictionary(model, *level)
        if own is None:
            continue
        looked_at = max(looked_at, (level[0], len(own)))
        inside = Inside(model, own, largest(model, own))
        if not inside.told():
            continue
        answer = attempt(inside, lambda inside=inside: _wider(inside))  # type: ignore[misc]
        if answer is None:
            continue
        if answer.observer is not None:
            return answer
        refused = answer if refused is None or refused.verdict is not Verdict.YES else refused
        if refused.verdict is Verdict.YES and (i + 1 >= len(levels) or levels[i + 1][0] > 2):
            break
    return refused or Answer(Verdict.NOT_DECIDED, Reason.of(
        'functions none found', wanted=wanted, count=looked_at[1], degree=looked_at[0]))


def dictionary(model: Model, degree: int, laurent: bool, curved: bool) -> Dictionary | None:
    """Return the monomials over the states up to a degree, or None when these are too many."""
    system = model.system
    nodes = (*model.f, *model.sensors.values(), *model.wanted.values())
    return build(model.states, [
        state_atoms(name, low > 0.0 or high < 0.0, nodes, laurent, curved and low > 0.0,
                    name in system.angles)
        for name, (low, high) in system.states.items()], degree)


def image_rank(model: Model) -> int:
    """Return in how many directions the next state moves with states, inputs and unknown ones."""
    slopes = evaluated(model, model.points(9, 3))[1]
    return int(ranks(slopes).max())


def _wider(inside: Inside) -> Inside:
    """Return gamma* among products of degree 2, unless it is so already."""
    own = dictionary(inside.model, *_WIDER)
    if own is None or len(own) <= len(inside.dictionary):
        return inside
    return Inside(inside.model, own, largest(inside.model, own))


def targets_of(model: Model) -> dict[str, Node]:
    """Return what must be told: of an angle its cosine and its sine."""
    result: dict[str, Node] = {}
    for name, node in model.wanted.items():
        if isinstance(node, Name) and node.id in model.system.angles:
            result[f'cos {name}'], result[f'sin {name}'] = call('cos', node), call('sin', node)
        else:
            result[name] = node
    return result


def attempt(inside: Inside, wider: Callable[[], Inside]) -> Answer | None:
    """
    Return an answer within gamma*, or None when the numbers did not hold.

    wider: gives gamma* of a dictionary that is large enough for what helps to converge.
    """
    first: Answer | None = None
    for begun in beginnings(inside, list(targets_of(inside.model).values()), _BEGINNINGS):
        found = attempt_from(inside, begun, wider)
        if found is None:
            return first
        if found.observer is not None and (first is None or found.observer.grade != TEMPORARY):
            return found  # that the error of 1/x stays says nothing where that of x grows
        first = first or found
        if found.reason is not None and found.reason.code != 'functions not stable':
            break  # another function tells no more
    return first


def attempt_from(inside: Inside, begun: Sequence[Function],
                 wider: Callable[[], Inside]) -> Answer | None:
    """Return an answer within gamma* that has functions to begin with."""
    candidate = candidate_in(inside, begun)
    if candidate is None or isinstance(candidate, Answer):
        return candidate
    signs = tuple((node, 1) for name, node in targets_of(inside.model).items()
                  if not candidate.told[name].branch)
    error = error_system(candidate, signs)
    known = stability(error) if candidate.functions else AT_ONCE
    phi = tuple(f.text for f in candidate.functions)
    if known.grade not in (CERTIFIED, SAMPLED) and candidate.twins is None:
        better = with_measured(wider(), candidate, error)
        if better is not None:
            own = error_system(better, signs)
            faster = stability(own)
            if faster.grade in (CERTIFIED, SAMPLED):
                candidate, error, known = better, own, faster
    if not known.grade:
        return Answer(Verdict.YES, Reason.of('functions not stable', phi=', '.join(phi),
                                             growth=-known.rate), None, phi)
    if candidate.twins is not None or signs:
        return Answer(Verdict.NOT_DECIDED, _many_valued(candidate), None, phi)
    phi = tuple(f.text for f in candidate.functions)
    if known.grade == TEMPORARY:
        candidate, zeros = with_residuals(wider(), candidate)
        error = error_system(candidate)
    else:
        zeros = ()
    return Answer(Verdict.YES, None, observer(candidate, error, known, zeros), phi)


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
    known = [*known, *(Known(f'u{i}', Name(name), Name(name), 0, 2)
                       for i, name in enumerate(model.inputs))]
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


def recovered(model: Model, chosen: Sequence[Function], known: Sequence[Known],
              exact: digits.Exact) -> list[Known]:
    """Return what is known, and which states follow from it, as they follow."""
    result = list(known)
    own = [k for k in known if not set(names(k.node)) & set(model.inputs)]
    inside = Inside(model, dictionary(model, 1, False, False) or _never(), np.zeros((0, 0)))
    for i, state in enumerate(model.states):
        if any(k.node == Name(state) for k in result) or inside.missing(chosen, [Name(state)]):
            continue
        found = output(model, Name(state), own, exact)
        if found is not None:
            result.append(Known(f'x{i}', Name(state), found.fit.node))
    return result


def _never() -> Dictionary:
    raise AssertionError('there are always monomials of degree 1')


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


def with_measured(inside: Inside, candidate: Candidate, error: ErrorSystem) -> Candidate | None:
    """Return the candidate with functions of measured quantities taken off, if it converges so."""
    model = inside.model
    known = known_of(model, candidate.names, candidate.functions)
    exact = exact_of(candidate.functions)
    own = [*known, *(Known(f'u{i}', Name(name), Name(name), 0, 2)
                     for i, name in enumerate(model.inputs))]
    measured, sides = [], []
    for w in measured_functions(inside):
        side = fitted(model, next_of(model, w.node), [*own, *plant_atoms(model, own)], exact)
        if side is not None and set(names(side.node)) & set(candidate.names):
            measured.append(w)
            sides.append(side.node)
        if len(measured) == MOST_MEASURED:
            break
    if not measured:
        return None
    K = gain(error, measured, sides)
    if K is None:
        return None
    functions = [taken_off(f, row, measured) for f, row in zip(candidate.functions, K)]
    found = completed(model, functions, None)
    return found if isinstance(found, Candidate) else None


def with_residuals(inside: Inside, candidate: Candidate) -> tuple[Candidate, tuple[Node, ...]]:
    """Return a candidate with functions that are tied to readings, and what is 0 in truth."""
    model = inside.model
    exact = exact_of(candidate.functions)
    known = known_of(model, candidate.names, candidate.functions)
    own = [*known, *(Known(f'u{i}', Name(name), Name(name), 0, 2)
                     for i, name in enumerate(model.inputs))]
    more = tied(inside, candidate.functions, own, exact)
    if more:
        functions = (*candidate.functions, *(f for f, _ in more))
        z = names_of_z(model, len(functions))
        candidate = Candidate(model, z, functions, (*candidate.F, *(side for _, side in more)),
                              candidate.told, None)
        known = known_of(model, z, functions)
    return candidate, tuple(relations(model, known, candidate.names, exact_of(
        candidate.functions)))


def error_system(candidate: Candidate, signs: tuple[tuple[Node, int], ...] = ()) -> ErrorSystem:
    """Return what the error of a candidate is judged by."""
    return ErrorSystem(candidate.model, candidate.names,
                       tuple(f.node for f in candidate.functions),
                       tuple(F.node for F in candidate.F), signs)


def observer(candidate: Candidate, error: ErrorSystem, known: Stability,
             zeros: Sequence[Node] = ()) -> Observer:
    """Return the answer's observer."""
    model = candidate.model
    out: dict[str, str] = {}
    nodes = [F.node for F in candidate.F]
    for name in model.wanted:
        if name in candidate.told:
            node = candidate.told[name].fit.node
        else:
            node = call('atan2', candidate.told[f'sin {name}'].fit.node,
                        candidate.told[f'cos {name}'].fit.node)
        nodes.append(node)
        out[name] = to_text(node)
    return Observer(
        candidate.names, tuple(f.text for f in candidate.functions),
        tuple(F.text for F in candidate.F), out, tuple(map(to_text, zeros)),
        conditions(error, nodes),
        tuple(error.ranges[name] for name in candidate.names), known.grade, known.rate,
        () if known.grade == TEMPORARY else
        tuple(tuple(map(float, row)) for row in known.metric), False,
        tuple(f.text for f in candidate.functions),
        bool(candidate.functions) and all(len(names(f.node)) == 1 for f in candidate.functions),
        digits.DIGITS,
        model.system.sample_time)


def _many_valued(candidate: Candidate) -> Reason:
    model = candidate.model
    wanted = ', '.join(model.wanted)
    if candidate.twins is None:
        return Reason.of('functions many-valued', wanted=wanted, one='one branch',
                         other='the other')

    def place(x: np.ndarray) -> str:
        return ', '.join(f'{name} = {value:.3g}' for name, value in zip(model.states, x))
    return Reason.of('functions many-valued', wanted=wanted, one=place(candidate.twins.one),
                     other=place(candidate.twins.other))

