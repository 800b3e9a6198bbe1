"""
Whether a virtual sensor exists at all, and if not, what stands in the way.

Source: method 3.1 to 3.3 (geometric test, forced closure, fixed modes).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import schur

from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.quotient import Quotient, quotient
from vsensor_ros.designer.stability import lasting
from vsensor_ros.designer.subspaces import (
    complement,
    conditioned_invariant,
    Gap,
    image,
    in_row_space,
    left_kernel,
    unobservable,
)
from vsensor_ros.functions.nonlinearity import set_valued
from vsensor_ros.reason import Reason


@dataclass(frozen=True, eq=False)
class Existence:
    """What the geometry says of a problem."""

    forced: frozenset[int]  # nonlinear terms that any virtual sensor must be decoupled from
    quotient: Quotient | None  # what can be known and whose error can be made to die out
    obstruction: Reason | None  # what stands in the way; None when a virtual sensor exists
    gap: Gap  # of the rank decisions

    @property
    def hidden(self) -> bool:
        """Whether a mode that stays stands in the way, no unknown input and no term."""
        return self.obstruction is not None and self.obstruction.code == 'mode stays'


def examine(problem: Problem, avoid: frozenset[int] = frozenset()) -> Existence:
    """
    Decide whether a decoupled virtual sensor with a stable linear part exists.

    ``avoid``: nonlinear terms that it is to be decoupled from in any case.
    """
    gap = Gap()
    if problem.reads_unknown:
        return Existence(avoid, None, _unread(problem), gap)
    while True:
        forced, T = forced_closure(problem, avoid, gap)
        Phi = complement(T)
        if not in_row_space(np.vstack([Phi, problem.C0]), problem.V, gap):
            return Existence(forced, None, disturbed(problem, forced), gap)
        known = quotient(problem, Phi, gap)
        lost, modes = hidden_unstable_modes(known, problem, gap)
        if not lost.shape[1]:
            return Existence(forced, known, None, gap)
        keep = left_kernel(lost) @ Phi
        rows = np.vstack([keep, problem.C0])
        if not in_row_space(rows, problem.V, gap):
            states = _strongest(problem.plant.states, np.linalg.lstsq(Phi, lost, rcond=None)[0])
            return Existence(forced, None, _mode_stays(problem, modes, states), gap)
        # a term whose argument went with a hidden mode must not act either
        avoid = forced | {i for i, g in enumerate(problem.G) if not in_row_space(rows, g)}
        if avoid == forced:
            return Existence(forced, quotient(problem, keep, gap), None, gap)


def measured_signs(problem: Problem) -> frozenset[int]:
    """
    Return the set-valued terms whose argument is measured.

    At rest dry friction takes any value that balances the other forces, and no reading tells
    which: (E4) holds for such a term, yet its value is not known. Only where the argument passes
    through z does the implicit step find it.
    """
    return frozenset(i for i, (term, g) in enumerate(zip(problem.plant.terms, problem.G))
                     if set_valued(term) and in_row_space(problem.C0, g))


def avoidable_signs(problem: Problem) -> frozenset[int]:
    """Return ``measured_signs`` where a virtual sensor that does without them exists, or none."""
    signs = measured_signs(problem)
    if signs and examine(problem, signs).obstruction is not None:
        return frozenset()
    return signs


def forced_closure(problem: Problem, forced: frozenset[int] = frozenset(),
                   gap: Gap | None = None) -> tuple[frozenset[int], np.ndarray]:
    """
    Return the nonlinear terms that must be decoupled and the subspace T* this leads to.

    A term whose argument cannot be known where it acts must not act on the observer; decoupling
    it enlarges T*, which may force further terms. Source: method 3.2.
    """
    while True:
        T = conditioned_invariant(problem.A, problem.C0, problem.decoupled(forced), gap)
        known = np.vstack([complement(T), problem.C0])
        grown = frozenset(i for i, g in enumerate(problem.G)
                          if i in forced or not in_row_space(known, g, gap))
        if grown == forced:
            return forced, T
        forced = grown


def hidden_unstable_modes(known: Quotient, problem: Problem, gap: Gap | None = None,
                          ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what no injection of a residual could make stable.

    Orthonormal columns (r, h) of the quotient and their modes (h,) complex. Source: method 3.3.
    """
    hidden = unobservable(known.A, known.E, gap)
    if known.order == len(problem.A) and problem.stable:
        return hidden[:, :0], np.zeros(0, complex)
    values, stays = lasting(hidden.T @ known.A @ hidden, problem.plant.sample_time,
                            problem.speed)
    if not stays.any():
        return hidden[:, :0], values[:0]
    T, Z, unstable = schur(hidden.T @ known.A @ hidden, output='complex',
                           sort=lambda s: bool(stays[np.argmin(np.abs(values - s))]))
    lost = hidden @ Z[:, :unstable]  # complex columns of a real subspace
    return image(np.hstack([lost.real, lost.imag])), np.diag(T)[:unstable]


def _strongest(states: tuple[str, ...], directions: np.ndarray) -> tuple[str, ...]:
    """Name the states that columns of directions (n, s) move most."""
    weight = np.abs(directions).max(axis=1, initial=0.0)
    return tuple(s for s, w in zip(states, weight) if w > 1e-3 * weight.max(initial=0.0))


def _unread(problem: Problem) -> Reason:
    row = problem.plant.Cd[problem.plant.sensors.index(problem.channel)]
    return Reason.of('reads unknown input', names=tuple(
        name for name, direct in zip(problem.plant.disturbances, row) if direct))


def disturbed(problem: Problem, forced: frozenset[int]) -> Reason:
    """Find which unknown input or which nonlinear term blocks the way."""
    plant = problem.plant

    def hides(D: np.ndarray) -> bool:
        known = complement(conditioned_invariant(problem.A, problem.C0, D))
        return not in_row_space(np.vstack([known, problem.C0]), problem.V)

    if hides(problem.D) or not forced:  # not forced: exact arithmetic knows better
        # an unknown input that is read directly has no column of its own left
        D = plant.D / problem.scale[:, None]
        culprits = tuple(name for i, name in enumerate(plant.disturbances)
                         if D[:, i].any() and hides(D[:, [i]] / np.linalg.norm(D[:, i])))
        culprits = culprits or plant.disturbances
        return Reason.of('unknown inputs', names=culprits, way=_way(problem, culprits),
                         healthy=problem.healthy)
    return Reason.of('terms', names=tuple(plant.terms[i].short for i in sorted(forced)),
                     healthy=problem.healthy)


def _way(problem: Problem, culprits: tuple[str, ...]) -> tuple[str, ...]:
    """
    Return the states that unknown inputs pass on their shortest way to v.

    Empty when they act on what v is made of, or when the sensors see all of the way.
    """
    plant, n = problem.plant, len(problem.A)
    acts = plant.A != 0
    for g, column in zip(plant.G, plant.P.T):
        acts |= np.outer(column != 0, g.any(axis=0))
    seen = {int(np.argmax(np.abs(row))) for row in problem.C0 if np.count_nonzero(row) == 1}
    goal = set(np.flatnonzero(np.abs(problem.V).max(axis=0) > 0).tolist())
    columns = [plant.disturbances.index(name) for name in culprits]
    before: dict[int, int | None] = {
        int(i): None for i in np.flatnonzero(plant.D[:, columns].any(axis=1))}
    queue = list(before)
    while queue:
        state = queue.pop(0)
        if state in goal:
            way = []
            at = before[state]
            while at is not None:
                way.append(plant.states[at])
                at = before[at]
            return tuple(reversed(way))
        for following in (i for i in range(n) if acts[i, state]):
            if following not in before and following not in seen:
                before[following] = state
                queue.append(following)
    return ()


def _mode_stays(problem: Problem, modes: np.ndarray, states: tuple[str, ...]) -> Reason:
    discrete = problem.plant.sample_time is not None
    size = float(np.abs(modes).max() if discrete else modes.real.max())
    if abs(size) < 1e-9 * problem.speed:
        size = 0.0
    return Reason.of('mode stays', size=size, discrete=discrete, states=states,
                     healthy=problem.healthy, terms=bool(problem.plant.terms))
