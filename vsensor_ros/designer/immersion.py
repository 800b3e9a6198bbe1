"""
Immersion: an angle under sin and cos becomes two states, its cosine and its sine.

With c' = -w s, s' = w c the equations are linear in c, s and in all that these move, while w and
the other factors do not depend on them: a filter then converges from every angle. It is so for
the heading of a base: x' = v c, y' = v s. Source: method 3.16.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import math

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import (
    Apply,
    fold,
    Name,
    names,
    negate,
    Node,
    parse,
    to_text,
)
from vsensor_ros.observers.kinds.extended.sensor import immersed_states, Model, on_circle

POINTS = 200  # random ones, where the equations are held beside those given
OFF = 1e-9  # relative, by which they may be off
SEEN = 1e-6  # relative: of smaller singular values nothing is seen
APART = 1e-3  # of a direction that is not seen: it has a part of a state
LASTING = 1e-6  # 1/s, or of what is left after a step: it does not die out
TRIES = 3  # random points at which it is looked who is seen


def immersed(model: Model, angle: str, healthy: Sequence[bool]) -> Model | None:
    """
    Return a model in which a state that is an angle became two; None where that is no gain.

    The angle may occur under sin and cos only, its rate not depend on what it moves, and all that
    must be linear in cosine and sine. healthy (L,): who reads. They must not read the angle, and
    see cosine and sine while it moves, and its rate and the factors without these, but for what
    dies out by itself.
    """
    at, taken = model.states.index(angle), (*model.states, *model.inputs, *model.unknown,
                                            *model.parameters)
    read, alone = np.array(healthy, dtype=bool), model.C[:, at] != 0.0
    if model.definitions or \
            not set(on_circle(angle)).isdisjoint(taken) or (read & alone).any() or \
            np.delete(model.C[alone], at, axis=1).any() or model.Cu[alone].any():
        return None
    given = [parse(text) for text in model.equations]
    found = _rewritten(given, at, angle, model.sample_time is not None)
    if found is None:
        return None
    states = immersed_states(model.states, angle)
    C = np.hstack([model.C, np.zeros((len(model.C), 1))])
    C[:, at] = 0.0
    noise = model.process_noise[at]
    try:
        made = replace(
            model, states=states, C=C, angle=angle, factors=model.C[:, at].copy(),
            equations=tuple(to_text(fold(node)) for node in found),
            process_noise=np.append(model.process_noise, noise),
            initial=np.append(_put(model.initial, at, 0.0), 0.0),
            start=np.append(_put(model.start, at, math.sqrt(0.5)), math.sqrt(0.5)))
        for text in made.equations:
            parse(text)
    except BadInput:  # too long to be written
        return None
    check(model, made)
    return made if _is_linear(found, made) and _is_seen(found, made, read) else None


def _put(values: np.ndarray, at: int, value: float) -> np.ndarray:
    found = values.copy()
    found[at] = value
    return found


# ------------------------------------------------------------------------------ the equations

def _rewritten(given: Sequence[Node], at: int, angle: str, discrete: bool) -> list[Node] | None:
    """Return the equations with the cosine's in place of the angle's, and the sine's last."""
    cos, sin = (Name(name) for name in on_circle(angle))
    if discrete:  # the angle's next value is the angle and how far it turns
        turned = [_expanded(Apply(of, (given[at],)), angle) for of in ('cos', 'sin')]
    else:
        rate = _expanded(given[at], angle)
        turned = [None, None] if rate is None else [
            Apply('*', (negate(rate), sin)), Apply('*', (rate, cos))]
    rest = [_expanded(node, angle) for node in given]
    found = [*rest[:at], turned[0], *rest[at + 1:], turned[1]]
    return None if any(node is None for node in found) else [n for n in found if n is not None]


def _expanded(node: Node, angle: str) -> Node | None:
    """Return a node over the cosine and sine of an angle; None where it is used otherwise."""
    if angle not in names(node):
        return node
    if not isinstance(node, Apply):
        return None
    if node.function in ('sin', 'cos'):
        parts = _apart(node.arguments[0], angle)
        if parts is None:
            return None
        sign, rest = parts
        cos, sin = (Name(name) for name in on_circle(angle))
        own: Node = sin if sign > 0 else negate(sin)
        if rest is None:
            return own if node.function == 'sin' else cos
        c, s = (Apply(of, (rest,)) for of in ('cos', 'sin'))
        if node.function == 'sin':
            return Apply('+', (Apply('*', (own, c)), Apply('*', (cos, s))))
        return Apply('-', (Apply('*', (cos, c)), Apply('*', (own, s))))
    parts_ = [_expanded(argument, angle) for argument in node.arguments]
    found = tuple(part for part in parts_ if part is not None)
    return replace(node, arguments=found) if len(found) == len(parts_) else None


def _apart(node: Node, angle: str) -> tuple[int, Node | None] | None:
    """Return the sign of the angle in a sum, and the rest of that; None where there is more."""
    if node == Name(angle):
        return 1, None
    if not isinstance(node, Apply) or node.function not in ('+', '-', 'neg'):
        return None
    inside = [i for i, part in enumerate(node.arguments) if angle in names(part)]
    if len(inside) != 1:
        return None
    found = _apart(node.arguments[inside[0]], angle)
    if found is None:
        return None
    sign, rest = found
    if node.function == 'neg':
        return -sign, None if rest is None else negate(rest)
    other = node.arguments[1 - inside[0]]
    if node.function == '+':
        return sign, other if rest is None else Apply('+', (rest, other))
    if inside[0] == 0:
        return sign, negate(other) if rest is None else Apply('-', (rest, other))
    return -sign, other if rest is None else Apply('-', (other, rest))


def check(before: Model, after: Model) -> None:
    """Hold the equations beside those given at random points; raise BadInput where they differ."""
    random = np.random.default_rng(0)
    others = (*before.inputs, *before.unknown, *before.parameters)
    x, u = (random.uniform(-2.0, 2.0, (n, POINTS)) for n in (len(before.states), len(others)))
    u[len(others) - len(before.parameters):] = before.values[:, None]
    at, (cos, sin) = before.states.index(after.angle), after.circle
    on = np.vstack([x, np.sin(x[at])])
    on[cos] = np.cos(x[at])
    with np.errstate(all='ignore'):
        truth = Equations([parse(text) for text in before.equations],
                          (*before.states, *others)).values(np.vstack([x, u]))
        said = Equations([parse(text) for text in after.equations],
                         (*after.states, *others)).values(np.vstack([on, u]))
        turned = truth[at].copy()
        truth = np.vstack([truth, np.sin(turned)])
        truth[cos] = np.cos(turned)
        if before.sample_time is None:
            truth[cos], truth[sin] = -np.sin(x[at]) * turned, np.cos(x[at]) * turned
        wrong = np.abs(said - truth) > OFF * np.maximum(1.0, np.abs(truth))
    if (wrong & np.isfinite(truth)).any():
        raise BadInput('immersion', 'dynamics', f'with {after.angle} as cosine and sine are off '
                       'those given at a random point', 'report this: they should be the same')


# ------------------------------------------------------------------------- what is linear, seen

def _moved(found: Sequence[Node], model: Model) -> set[str]:
    """Return the states that cosine and sine move, and these."""
    moved = set(on_circle(model.angle))
    for _ in model.states:
        moved |= {state for state, node in zip(model.states, found)
                  if not moved.isdisjoint(names(node))}
    return moved


def _is_linear(found: Sequence[Node], model: Model) -> bool:
    """Tell whether all that moves with the angle does so linearly, the rest being given."""
    moved = _moved(found, model)
    return all(_degree(node, moved) <= 1 for node in found)


def _degree(node: Node, moved: set[str]) -> float:
    """Return the degree of a polynomial in some names; infinite: it is none."""
    if moved.isdisjoint(names(node)):
        return 0.0
    if not isinstance(node, Apply):
        return 1.0
    degrees = [_degree(part, moved) for part in node.arguments]
    if node.function in ('+', '-', 'neg'):
        return max(degrees)
    if node.function == '*':
        return sum(degrees)
    return degrees[0] if node.function == '/' and not degrees[1] else math.inf


def _is_seen(found: Sequence[Node], model: Model, read: np.ndarray) -> bool:
    """Tell whether healthy sensors see cosine and sine somewhere, and what moves them without."""
    moved = _moved(found, model)
    by = {state: set(names(node)) & set(model.states)
          for state, node in zip(model.states, found)}
    given = set().union(*(by[state] for state in moved)) - moved
    for _ in model.states:
        given |= set().union(*(by[state] for state in given))
    random = np.random.default_rng(0)
    others = (*model.inputs, *model.unknown, *model.parameters)
    equations = Equations([parse(text) for text in model.equations], (*model.states, *others))
    n = len(model.states)
    for _ in range(TRIES):
        point = random.uniform(0.5, 2.0, (n + len(others), 1))
        if model.parameters:
            point[-len(model.parameters):, 0] = model.values
        turn = random.uniform(0.0, 2.0 * math.pi)
        point[list(model.circle), 0] = math.cos(turn), math.sin(turn)
        with np.errstate(all='ignore'):
            A = equations.slopes(point)[1][:, :n, 0]
        rows = model.C[read]
        free = [i for i, state in enumerate(model.states) if state not in moved]
        first = rows[~rows[:, [i for i in range(n) if i not in free]].any(axis=1)]
        if _sees(A, rows, model.states, set(on_circle(model.angle))) and _sees(
                A[np.ix_(free, free)], first[:, free], [model.states[i] for i in free], given,
                lambda values: bool((values.real < -LASTING).all() if model.sample_time is None
                                    else (np.abs(values) < 1.0 - LASTING).all())):
            return True
    return False


def _sees(A: np.ndarray, rows: np.ndarray, states: Sequence[str], wanted: set[str],
          dies_out: Callable[[np.ndarray], bool] = lambda values: False) -> bool:
    """Tell whether rows (r, n) of x' = A x tell some of the states, or the rest dies out."""
    if not wanted:
        return True
    if not np.isfinite(A).all():
        return False
    scale = max(1.0, float(np.abs(A).max(initial=0.0)))
    seen, power = [], rows / np.linalg.norm(rows, axis=1, keepdims=True).clip(1e-300)
    for _ in states:
        seen.append(power)
        power = power @ A / scale
    values, turned = np.linalg.svd(np.vstack([*seen, np.zeros((1, len(states)))]))[1:]
    hidden = turned[int((values > SEEN * values[0]).sum()):]
    parts = np.abs(hidden[:, [states.index(name) for name in wanted]])
    return not bool((parts > APART).any()) or dies_out(np.linalg.eigvals(hidden @ A @ hidden.T))
