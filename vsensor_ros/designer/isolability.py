"""
Which sensor's fault can be told from which others, by any residuals that a plant allows.

A fault of j can be told from faults of others iff some residual reads j, reads none of the others,
and is not disturbed by unknown inputs: faults add to readings, so whom a residual does not read it
does not feel. All residuals that do not read the others are filtered innovations of one observer,
on the observable part of the quotient that the virtual sensors without the others stand on.
Source: method 3.13.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from vsensor_ros.designer import system_matrix
from vsensor_ros.designer.existence import forced_closure
from vsensor_ros.designer.observer import acting
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.designer.quotient import argument, Quotient, quotient
from vsensor_ros.designer.response import responds
from vsensor_ros.designer.subspaces import complement, in_row_space, solve_left, unobservable
from vsensor_ros.functions.nonlinearity import set_valued, slope_at
from vsensor_ros.observers import Distinction, NONE, STRONG, WEAK
from vsensor_ros.plant import Plant

ROUNDING = 1e-12  # of the largest, in scaled coordinates
SLOW = 1e-6  # of the plant's speed: what moves less may be at rest but for rounding


@dataclass(frozen=True, eq=False)
class Checks:
    """All residuals that do not read the fault set of a problem: ``R y0 - E xi``, filtered."""

    problem: Problem
    known: Quotient  # observable
    slopes: Quotient  # the same with the terms' slopes at the operating point in A and J
    arguments: np.ndarray  # (s, r) of the terms that act, in the rows of the quotient
    forced: frozenset[int]  # terms that must be kept out, because nobody tells their argument
    # (r, l0) more ways of readings into xi, through arguments of terms, whatever their slopes
    through_terms: np.ndarray

    def strengths(self) -> dict[str, str]:
        """Return for each sensor that may be read how its faults show in the best residual."""
        known, problem = self.slopes, self.problem
        h = problem.plant.sample_time
        ways = np.hstack([known.J, self.through_terms])
        R = np.hstack([known.R, np.zeros_like(known.R)])
        linear, by_terms = np.split(responds(known.A, ways, -known.E, R, h), 2)
        shows = linear | by_terms
        still = known.A - problem.still * np.eye(known.order)
        moving = np.linalg.norm(np.hstack([still, known.J]), 2) if known.order else 0.0
        size = max(float(moving), SLOW * problem.speed, np.finfo(float).tiny)
        rests = np.vstack([still / size, known.E]).T
        found = {}
        for j, sensor in enumerate(problem.healthy):
            # a constant fault that some constant xi explains is gone when that is reached
            goes = in_row_space(rests, np.append(known.J[:, j] / size, -known.R[:, j])[None, :])
            found[sensor] = NONE if not shows[j] else WEAK if goes else STRONG
        return found


def blind_to(plant: Plant, others: tuple[str, ...]) -> Problem:
    """Pose the problem of an estimate of nothing from all sensors but the others."""
    return pose(plant, others, '', np.zeros((1, len(plant.states))))


def checks(problem: Problem) -> Checks:
    """Return what all residuals of a problem's healthy sensors are made of."""
    hidden = np.zeros((len(problem.A), 0))
    while True:
        # a mode that no reading shows is in no residual: it is kept out as unknown inputs are
        posed = replace(problem, D=np.hstack([problem.D, hidden]))
        forced, T = forced_closure(posed)
        Phi = complement(T)
        known = _tidied(quotient(posed, Phi), problem.speed)
        slopes, arguments, through = _with_terms(posed, known)
        lost = unobservable(slopes.A, slopes.E)
        if not lost.shape[1]:
            return Checks(problem, known, slopes, arguments, forced, through)
        hidden = np.hstack([hidden, Phi.T @ lost])


def _tidied(known: Quotient, speed: float) -> Quotient:
    """Set what is rounding to zero: a reading that is multiplied by it is not read."""
    own = np.hstack([known.A - known.still * np.eye(known.order), known.J])
    least = ROUNDING * np.maximum(np.abs(own).max(axis=1, initial=0.0), speed)[:, None]
    return replace(known, J=np.where(np.abs(known.J) < least, 0.0, known.J),
                   E=np.where(np.abs(known.E) < ROUNDING, 0.0, known.E),
                   R=np.where(np.abs(known.R) < ROUNDING, 0.0, known.R))


def _with_terms(problem: Problem, known: Quotient,
                ) -> tuple[Quotient, np.ndarray, np.ndarray]:
    """Return the quotient with the slopes of its terms, their arguments, and who feeds them."""
    plant, Phi = problem.plant, known.Phi
    A, J = known.A, known.J
    through = np.zeros_like(J)
    arguments = [np.zeros((0, known.order))]
    for i, acts in enumerate(acting(problem, Phi)):
        if not acts:
            continue
        G = plant.G[i] * problem.scale
        Gz = argument(problem, Phi, G)
        assert Gz is not None  # else it were forced
        Gy = solve_left(problem.C0, G - Gz @ Phi) @ problem.Y
        P = Phi @ (plant.P[:, i] / problem.scale)
        arguments.append(Gz)
        through = through + np.outer(P, np.abs(Gy).sum(axis=0))
        slope = slope_of(plant, i)
        A, J = A + np.outer(P, slope @ Gz), J + np.outer(P, slope @ Gy)
    return replace(known, A=A, J=J), np.vstack(arguments), through


def slope_of(plant: Plant, i: int) -> np.ndarray:
    """Return the slope (r_i,) of a term at the operating point; of dry friction none is known."""
    term = plant.terms[i]
    if set_valued(term) and plant.sample_time is None:
        return np.zeros(len(term.slope))
    return slope_at(term, plant.G[i] @ plant.operating_point, plant.inputs,
                    plant.operating_input) - term.slope


def distinctions(plant: Plant, sets: Iterable[tuple[str, ...]]) -> tuple[Distinction, ...]:
    """
    Decide for each set of other sensors how well a fault of each sensor can be told from theirs.

    Of the empty set: whether it can be detected. Nonlinear terms count where their arguments are
    known, with their slopes at the operating point. Exact arithmetic has the last word where the
    plant is written in short decimals.
    """
    return tuple(Distinction(sensor, others, strength) for others in sets
                 for sensor, strength in _told(plant, others).items())


def _told(plant: Plant, others: tuple[str, ...]) -> dict[str, str]:
    found = checks(blind_to(plant, others))
    A = plant.A
    for i, (g, column) in enumerate(zip(plant.G, plant.P.T)):
        if i not in found.forced:
            A = A + np.outer(column, slope_of(plant, i) @ g)
    rows = [plant.sensors.index(s) for s in found.problem.healthy]
    D = np.hstack([plant.D, plant.P[:, sorted(found.forced)]])
    Cd = np.pad(plant.Cd[rows], ((0, 0), (0, len(found.forced))))
    exact = system_matrix.strengths(A, plant.C[rows], D, Cd, plant.sample_time)
    said = found.strengths()
    if exact is None:
        return said
    # dry friction is no slope: what only it lets through is not in these matrices
    return {s: said[s] if decided == NONE and found.through_terms.any() else decided
            for s, decided in zip(found.problem.healthy, exact)}
