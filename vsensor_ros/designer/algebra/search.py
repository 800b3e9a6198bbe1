"""The entrance: a virtual sensor from the algebra of functions, or why there is none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
import math

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
from vsensor_ros.designer.algebra.candidate import (
    Candidate,
    candidate_in,
    error_system,
    slopes_of,
    targets_of,
)
from vsensor_ros.designer.algebra.coefficients import Function
from vsensor_ros.designer.algebra.contraction import ErrorSystem, Stability, stability
from vsensor_ros.designer.algebra.derivative import call
from vsensor_ros.designer.algebra.forced import forced
from vsensor_ros.designer.algebra.invariant import evaluated, largest, products
from vsensor_ros.designer.algebra.measured import with_measured
from vsensor_ros.designer.algebra.model import Model, read
from vsensor_ros.designer.algebra.null_space import ranks
from vsensor_ros.designer.algebra.reduction import beginnings, Inside
from vsensor_ros.designer.algebra.residuals import with_residuals
from vsensor_ros.designer.algebra.validity import conditions
from vsensor_ros.designer.calm import calmly
from vsensor_ros.functions.expression import names, Node, parse, to_text
from vsensor_ros.reason import Reason

# degree, negative powers, log and sqrt: the cheap ones first
LEVELS = ((1, False, False), (2, False, False), (2, True, False), (2, True, True),
          (3, False, False), (3, True, False), (3, True, True), (4, False, False))
_WIDER = (2, False, False)
_BEFORE_PROOF = 2  # levels, which are cheaper than to prove that there is nothing
_BEGINNINGS = 5  # functions tried, while the error of an observer of one may grow
AT_ONCE = Stability(CERTIFIED, math.inf, np.zeros((0, 0)))  # there is no state to be off


def find(system: System, levels: Sequence[tuple[int, bool, bool]] = LEVELS) -> Answer:
    """
    Look for an observer z = phi(x) that no unknown input disturbs, in growing dictionaries.

    levels: (degree, negative powers, log and sqrt). Raises BadInput where the system cannot be
    read.
    """
    assert sentences
    with calmly():
        return _found(read(system), levels)


def _found(model: Model, levels: Sequence[tuple[int, bool, bool]]) -> Answer:
    wanted = ', '.join(model.system.wanted)
    if model.discrete and (short := image_rank(model)) < len(model.states):
        return Answer(Verdict.NOT_DECIDED, Reason.of(
            'functions not submersive', rank=short, states=len(model.states)))
    best: Answer | None = None
    looked_at = (0, 0)
    for i, level in enumerate(levels):
        if i == min(_BEFORE_PROOF, len(levels) - 1):
            proof = forced(model, list(targets_of(model).values()))
            if proof is not None and proof.blocks:
                return Answer(Verdict.NO, Reason.of(
                    'functions impossible', wanted=wanted, dimension=proof.dimension,
                    states=len(model.states)))
        own = products(model, *level)
        if own is None:
            continue
        looked_at = max(looked_at, (level[0], len(own)))
        inside = Inside(model, own, largest(model, own))
        if not inside.told():
            continue
        answer = attempt(inside, cache(partial(_wider, inside)))
        best = _better(best, answer)
        if best is None or best.verdict is not Verdict.YES:
            continue
        if _settled(best) or i + 1 >= len(levels) or levels[i + 1][0] > 2:
            break
    return best or Answer(Verdict.NOT_DECIDED, Reason.of(
        'functions none found', wanted=wanted, count=looked_at[1], degree=looked_at[0]))


def _better(best: Answer | None, answer: Answer | None) -> Answer | None:
    """
    Return the better of two answers, the earlier one of two that are as good.

    That the error of 1/x stays says nothing where that of x grows: both tell the same.
    """
    if best is None or answer is None:
        return best or answer
    lasting = answer.observer is not None and answer.observer.grade != TEMPORARY
    same = len(best.gamma) == len(answer.gamma) == 1
    if lasting or best.verdict is not Verdict.YES:
        return answer if lasting or answer.verdict is Verdict.YES else best
    return answer if best.observer is None and answer.observer is not None and not same else best


def _settled(answer: Answer) -> bool:
    """
    Tell whether no other function will do better, or too many would have to be looked at.

    Where nothing acts on the error of one, nothing does in whatever other coordinate.
    """
    found = answer.observer
    return found is not None and (found.grade != TEMPORARY or len(answer.gamma) > 1
                                  or found.names[0] not in names(parse(found.F[0])))


def image_rank(model: Model) -> int:
    """Return in how many directions the next state moves with states, inputs and unknown ones."""
    slopes = evaluated(model, model.points(9, 3))[1]
    return int(ranks(slopes).max())


def _wider(inside: Inside) -> Inside:
    """Return gamma* among products of degree 2, unless it is so already."""
    own = products(inside.model, *_WIDER)
    if own is None or len(own) <= len(inside.dictionary):
        return inside
    return Inside(inside.model, own, largest(inside.model, own))


def attempt(inside: Inside, wider: Callable[[], Inside]) -> Answer | None:
    """
    Return an answer within gamma*, or None when the numbers did not hold.

    wider: gives gamma* of a dictionary that is large enough for what helps to converge.
    """
    best: Answer | None = None
    for begun in beginnings(inside, list(targets_of(inside.model).values()), _BEGINNINGS):
        found = attempt_from(inside, begun, wider)
        best = _better(best, found)
        if found is None or best is None or _settled(best) or (
                found.reason is not None and found.reason.code != 'functions not stable'):
            break  # another function tells no more
    return best


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
        tuple(tuple(map(float, row)) for row in known.metric),
        tuple(f.text for f in candidate.functions),
        bool(candidate.functions) and all(len(names(f.node)) == 1 for f in candidate.functions),
        digits.DIGITS, model.system.sample_time,
        # what drives several of them at once, and healthy sensors tell of one by another
        slopes_of(candidate) if zeros and not model.discrete else ())


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
