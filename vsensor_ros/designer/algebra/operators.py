"""
The operators of the algebra of functions, each on its own.

An element is a vector function of the states, up to equivalence. Answers have three values: what
holds by ranks at random points, and where no second preimage speaks against it, is *yes* within
the ranges; what a dictionary does not hold is *not decided*. Source: Symmetry 15, 993, Appendix A.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vsensor_ros.designer.algebra.answer import Range, Verdict
from vsensor_ros.designer.algebra.coefficients import Function, next_of, plain_combination
from vsensor_ros.designer.algebra.derivative import rebuilt
from vsensor_ros.designer.algebra.dictionary import Atom, build, Dictionary
from vsensor_ros.designer.algebra.forced import closure_of_kernels
from vsensor_ros.designer.algebra.invariant import constant_along, foreseen
from vsensor_ros.designer.algebra.model import gradients, Model
from vsensor_ros.designer.algebra.null_space import kernels, null_space
from vsensor_ros.designer.algebra.preimage import second_preimage
from vsensor_ros.designer.algebra.reduction import Inside
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Name, Node, Number, parse, substitute, to_text
from vsensor_ros.reason import Reason

Element = tuple[Node, ...]

_POINTS = 9
_CLOSE = (1e-11, 1e-7)  # of the largest singular value: neither 0 nor clearly not
_COMMANDS = (0.0, 1.0, -1.0, 0.5, 2.0)  # values of all inputs, then random ones


@dataclass(frozen=True)
class Decision:
    """An answer with its reason; None with a plain yes."""

    verdict: Verdict
    reason: Reason | None = None

    def __bool__(self) -> bool:
        raise TypeError('an answer has three values: compare its verdict')


@dataclass(frozen=True)
class Result:
    """An element, and whether it is known to be all there is."""

    element: Element
    complete: Decision

    @property
    def texts(self) -> tuple[str, ...]:
        """The components as text."""
        return tuple(map(to_text, self.element))


@dataclass(frozen=True)
class Space:
    """The states with their ranges; angles wrap."""

    states: Mapping[str, Range]
    angles: Sequence[str] = field(default=())

    def points(self, seed: int = 1, count: int = _POINTS) -> np.ndarray:
        """Return points (n, count)."""
        low, high = np.array(list(self.states.values()), dtype=float).T[:, :, None]
        draw = np.random.default_rng(seed).random((len(low), count))
        return low + (high - low) * draw


YES = Decision(Verdict.YES)


def space_of(model: Model) -> Space:
    """Return the states of a model."""
    return Space(model.system.states, model.system.angles)


def element(space: Space, *texts: str) -> Element:
    """Read an element; raises BadInput."""
    return tuple(parse(text, 'element', text, list(space.states)) for text in texts)


def at_most(space: Space, a: Element, b: Element) -> Decision:
    """
    Tell whether a <= b: whether b is a function of a, over the ranges.

    Valid for components that are smooth but on thin sets; a kink at a random point is unlikely.
    """
    at, names = space.points(), tuple(space.states)
    alone = gradients(a, names, at)
    known = _clear_ranks(alone)
    both = _clear_ranks(np.concatenate([alone, gradients(b, names, at)]))
    if known is None or both is None:
        return Decision(Verdict.NOT_DECIDED, Reason.of('functions rank close'))
    if (both > known).any():
        return Decision(Verdict.NO, Reason.of('functions independent', rank=int(known.max()),
                                              more=int(both.max())))
    twins = second_preimage(a, b, space.states, space.angles) if a and b else None
    if twins is not None:
        return Decision(Verdict.NO, Reason.of(
            'functions many-valued', wanted=', '.join(map(to_text, b)),
            one=_place(names, twins.one), other=_place(names, twins.other)))
    return YES


def equivalent(space: Space, a: Element, b: Element) -> Decision:
    """Tell whether each of a and b is a function of the other."""
    forth = at_most(space, a, b)
    return forth if forth.verdict is not Verdict.YES else at_most(space, b, a)


def product(space: Space, a: Element, b: Element) -> Element:
    """Return a x b, the greatest element at most a and b: all components but those that follow."""
    result: Element = ()
    for node in (*a, *b):
        if at_most(space, result, (node,)).verdict is not Verdict.YES:
            result = (*result, node)
    return result


def oplus(space: Space, a: Element, b: Element, degree: int = 2) -> Result:
    """
    Return a (+) b, the least element that is at least a and b.

    It holds all p(a) = q(b) with polynomials p and q up to a degree. It is complete where it has
    as many components as the closure of ker da + ker db leaves room for.
    """
    names = tuple(space.states)
    if not a or not b:
        return Result((), YES)
    over_a, over_b = (build([f'c{i}' for i in range(len(own))],
                            [[Atom(Name(f'c{i}'))] for i in range(len(own))], degree, 10 ** 6)
                      for own in (a, b))
    assert over_a is not None and over_b is not None
    K = len(over_a) + len(over_b)
    at = space.points(3, 2 * K + 20)
    with np.errstate(all='ignore'):
        left, right = (own.values(Equations(nodes, names).values(at)) for own, nodes in (
            (over_a, a), (over_b, b)))
    columns = np.concatenate([left[1:], right]).T  # one constant is enough
    basis = null_space(columns, np.abs(columns))
    found: Element = ()
    inner = {f'c{i}': node for i, node in enumerate(a)}
    order = sorted(range(basis.shape[1]), key=lambda i: float(over_a.costs[1:][
        basis[:len(over_a) - 1, i] != 0.0].sum()))
    for i in order:
        c = basis[:, i] / np.abs(basis[:, i]).max()
        coefficients = np.array([0.0, *c[:len(over_a) - 1]])
        if not coefficients.any():
            continue
        node = substitute(plain_combination(over_a, coefficients), inner)
        if at_most(space, found, (node,)).verdict is not Verdict.YES:
            found = (*found, node)
    room = closure_of_kernels(names, a, b, space.points(5, 1)[:, 0])
    rank = _clear_ranks(gradients(found, names, space.points())) if found else np.zeros(1)
    if room is not None and rank is not None and int(rank.max()) == room:
        return Result(found, YES)
    return Result(found, Decision(Verdict.NOT_DECIDED, Reason.of('functions beyond dictionary')))


def delta(model: Model, a: Element, b: Element) -> Decision:
    """
    Tell whether (a, b) is in Delta: whether a and the inputs tell what becomes of b.

    Continuous time: b is a function of a, and so is its derivative, beside the inputs; without the
    first clause the relation does not compose. Unknown inputs count as inputs here.
    """
    space = space_of(model)
    if not model.discrete:
        first = at_most(space, a, b)
        if first.verdict is not Verdict.YES:
            return first
    inside = Inside(_driven(model), _ones(model), np.zeros((0, 0)))
    known = inside.gradients(a, False)
    more = inside.gradients([next_of(model, node) for node in b])
    few = np.s_[:, :, :_POINTS]
    alone, both = _clear_ranks(known[few]), _clear_ranks(np.concatenate([known, more])[few])
    if alone is None or both is None:
        return Decision(Verdict.NOT_DECIDED, Reason.of('functions rank close'))
    if (both > alone).any():
        return Decision(Verdict.NO, Reason.of('functions independent', rank=int(alone.max()),
                                              more=int(both.max())))
    return YES


def M(model: Model, b: Element) -> Element:
    """Return the greatest element that tells what becomes of b: its change at enough inputs."""
    space = space_of(model)
    result: Element = () if model.discrete else product(space, b, ())
    random = np.random.default_rng(11)
    commands = [dict.fromkeys(model.variables[len(model.states):], value) for value in _COMMANDS]
    commands += [{name: float(np.round(random.uniform(low, high), 3)) for name, (low, high) in zip(
        model.variables[len(model.states):], model.declared[len(model.states):])}
        for _ in range(3)]
    inner = Inside(_driven(model), _ones(model), np.zeros((0, 0)))
    for command in commands:
        numbers = {name: Number(value) for name, value in command.items()}
        for node in b:
            found = rebuilt(substitute(next_of(model, node), numbers))
            if _finite(space, found):
                result = product(space, result, (found,))
        if not inner.missing([Function(node) for node in result],
                             [next_of(model, node) for node in b], sensors=False):
            break
    return result


def m(model: Model, a: Element, dictionary: Dictionary) -> Result:
    """
    Return the least element whose change a and the inputs tell, within a dictionary.

    Discrete time: f must reach an open set (`search.image_rank`), else what is found says nothing.
    """
    driven = _driven(model)
    names = model.states

    def kernel(at: np.ndarray) -> tuple[np.ndarray, int]:
        return kernels(gradients(a, names, at))
    within = np.eye(len(dictionary))
    if not model.discrete:
        at = model.points(len(dictionary) + 20, 31)[:len(names)]
        K, d = kernel(at)
        if d:
            within = constant_along(dictionary, within, at, K)
    span = foreseen(driven, dictionary, within, kernel)
    found: Element = ()
    space = space_of(model)
    for f in Inside(driven, dictionary, span).simplest_first(span):
        if at_most(space, found, (f.node,)).verdict is not Verdict.YES:
            found = (*found, f.node)
    return Result(found, Decision(Verdict.NOT_DECIDED, Reason.of('functions beyond dictionary'))
                  if len(found) < len(names) else YES)


def _driven(model: Model) -> Model:
    """Return a model whose unknown inputs count as inputs."""
    system = replace(model.system, inputs={**model.system.inputs, **model.system.unknown},
                     unknown={})
    return replace(model, system=system)


def _ones(model: Model) -> Dictionary:
    found = build(model.states, [[Atom(Name(name))] for name in model.states], 1)
    assert found is not None
    return found


def _finite(space: Space, node: Node) -> bool:
    with np.errstate(all='ignore'):
        values = Equations([node], tuple(space.states)).values(space.points())
    return bool(np.isfinite(values).all())


def _clear_ranks(rows: np.ndarray) -> np.ndarray | None:
    """Return the ranks (N,) of gradients (E, n, N), or None where one is not clear."""
    if not rows.shape[0]:
        return np.zeros(rows.shape[2], dtype=int)
    at = np.moveaxis(rows, 2, 0)
    if not np.isfinite(at).all():
        return None
    size = np.linalg.norm(at, axis=2, keepdims=True)
    values = np.linalg.svd(at / np.where(size > 0.0, size, 1.0), compute_uv=False)
    share = values / np.maximum(values[:, :1], 1e-300)
    if ((share > _CLOSE[0]) & (share < _CLOSE[1])).any():
        return None
    return np.asarray((share >= _CLOSE[1]).sum(axis=1))


def _place(names: Sequence[str], x: np.ndarray) -> str:
    return ', '.join(f'{name} = {value:.3g}' for name, value in zip(names, x))
