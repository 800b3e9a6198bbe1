"""
Whether a virtual sensor exists at all, and if not, what stands in the way.

Source: method 3.1 to 3.3 (geometric test, forced closure, fixed modes).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import schur

from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.stability import lasting
from vsensor_ros.designer.subspaces import (
    conditioned_invariant,
    image,
    in_row_space,
    kernel,
    left_kernel,
    measured_part,
    solve_left,
)
from vsensor_ros.nonlinearity import set_valued


@dataclass(frozen=True, eq=False)
class Existence:
    """What the geometry says of a problem."""

    forced: frozenset[int]  # nonlinear terms that any virtual sensor must be decoupled from
    Phi: np.ndarray  # (r, n) rows of the largest observer whose error can be made to die out
    obstruction: str | None  # one sentence, or None when a virtual sensor exists


def examine(problem: Problem, avoid: frozenset[int] = frozenset()) -> Existence:
    """
    Decide whether a decoupled virtual sensor with a stable linear part exists.

    ``avoid``: nonlinear terms that it is to be decoupled from in any case.
    """
    while True:
        forced, T = forced_closure(problem, avoid)
        Phi = left_kernel(T)
        if not in_row_space(np.vstack([Phi, problem.C0]), problem.V):
            return Existence(forced, Phi, _disturbed(problem, forced))
        Phi, modes, states = without_hidden_unstable_modes(problem, Phi)
        known = np.vstack([Phi, problem.C0])
        if not in_row_space(known, problem.V):
            return Existence(forced, Phi, _undetectable(problem, modes, states))
        # a term whose argument went with a hidden mode must not act either
        avoid = forced | {i for i, g in enumerate(problem.G) if not in_row_space(known, g)}
        if avoid == forced:
            return Existence(forced, Phi, None)


def measured_signs(problem: Problem) -> frozenset[int]:
    """
    Return the set-valued terms whose argument is measured.

    At rest dry friction takes any value that balances the other forces, and no reading tells
    which: (E4) holds for such a term, yet its value is not known. Only where the argument passes
    through z does the implicit step find it.
    """
    return frozenset(i for i, (term, g) in enumerate(zip(problem.plant.terms, problem.G))
                     if set_valued(term) and in_row_space(problem.C0, g))


def forced_closure(problem: Problem, forced: frozenset[int] = frozenset(),
                   ) -> tuple[frozenset[int], np.ndarray]:
    """
    Return the nonlinear terms that must be decoupled and the subspace T* this leads to.

    A term whose argument cannot be known where it acts must not act on the observer; decoupling
    it enlarges T*, which may force further terms. Source: method 3.2.
    """
    while True:
        T = conditioned_invariant(problem.A, problem.C0, problem.decoupled(forced))
        known = np.vstack([left_kernel(T), problem.C0])
        grown = frozenset(i for i, g in enumerate(problem.G)
                          if i in forced or not in_row_space(known, g))
        if grown == forced:
            return forced, T
        forced = grown


def without_hidden_unstable_modes(
        problem: Problem, Phi: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """
    Drop from the row space of Phi what no injection of a residual could make stable.

    Returns the remaining rows, the modes dropped (complex) and the states they live in.
    Source: method 3.3.
    """
    N = solve_left(np.vstack([Phi, problem.C0]), Phi @ problem.A)[:, :Phi.shape[0]]
    hidden = unobservable(N, measured_part(Phi, problem.C0))
    if hidden.shape[1] == 0:
        return Phi, np.zeros(0, complex), []
    inner = hidden.T @ N @ hidden
    values, stays = lasting(inner, problem.plant.sample_time, problem.speed)
    if not stays.any():
        return Phi, np.zeros(0, complex), []
    T, Z, unstable = schur(inner, output='complex',
                           sort=lambda s: bool(stays[np.argmin(np.abs(values - s))]))
    lost = hidden @ Z[:, :unstable]  # complex columns of a real subspace
    lost = image(np.hstack([lost.real, lost.imag]))
    keep = left_kernel(lost)
    directions = np.linalg.lstsq(Phi, lost, rcond=None)[0]
    weight = np.abs(directions).max(axis=1)
    states = [s for s, w in zip(problem.plant.states, weight) if w > 1e-3 * weight.max()]
    return keep @ Phi, np.diag(T)[:unstable], states


def unobservable(N: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Orthonormal columns of the largest N-invariant subspace inside ker C."""
    N = N / max(np.linalg.norm(N, 2) if N.size else 0.0, np.finfo(float).tiny)
    W = kernel(C)
    while True:
        kept = W @ kernel(N @ W - W @ (W.T @ N @ W), size=1.0)
        if kept.shape[1] == W.shape[1]:
            return W
        W = kept


def _disturbed(problem: Problem, forced: frozenset[int]) -> str:
    """Say which unknown input or which nonlinear term blocks the way."""
    plant = problem.plant
    T = conditioned_invariant(problem.A, problem.C0, problem.D)
    if not in_row_space(np.vstack([left_kernel(T), problem.C0]), problem.V):
        culprits = tuple(
            name for i, name in enumerate(plant.disturbances)
            if not in_row_space(np.vstack([left_kernel(conditioned_invariant(
                problem.A, problem.C0, problem.D[:, [i]])), problem.C0]), problem.V))
        culprits = culprits or plant.disturbances
        acts = (f'the unknown input{"s" * (len(culprits) > 1)} {_listed(culprits)} '
                f'act{"s" * (len(culprits) == 1)} on it')
        if not problem.healthy:
            return f'{acts} and no sensor is left to tell them apart'
        return f'{acts} and cannot be told apart from it by {_listed(problem.healthy)}'
    terms = tuple(plant.terms[i].name for i in sorted(forced))
    return (f'{_terms(terms)} on it with an argument that {_listed(problem.healthy)} cannot tell'
            if problem.healthy else f'{_terms(terms)} on it and no sensor is left')


def _undetectable(problem: Problem, modes: np.ndarray, states: list[str]) -> str:
    discrete = problem.plant.sample_time is not None
    size = np.abs(modes).max() if discrete else modes.real.max()
    if abs(size) < 1e-9 * problem.speed:
        size = 0.0
    kind = 'modulus' if discrete else 'real part'
    counted = ('; nonlinear terms count with their slope at the operating point'
               if problem.plant.terms else '')
    who = f'{_listed(problem.healthy)} cannot see' if problem.healthy else 'no sensor is left for'
    return (f'{who} the mode of {kind} {size:.3g} in {_listed(tuple(states))}, which does not '
            f'surely die out by itself: an initial error would stay{counted}')


def _terms(names: tuple[str, ...]) -> str:
    return f'the nonlinear term{"s" * (len(names) > 1)} {_listed(names)} ' + (
        'acts' if len(names) == 1 else 'act')


def _listed(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f'{", ".join(names[:-1])} and {names[-1]}'
