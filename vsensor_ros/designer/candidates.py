"""
Virtual sensors that may stand on a rung of the ladder, and what they are judged by.

Where they come from: the readings alone; all observers with one spectrum; subspaces that are
closed for what must be known; the Kalman filter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize

from vsensor_ros.designer import invariant_spaces
from vsensor_ros.designer.existence import examine, Existence
from vsensor_ros.designer.fixed_spectrum import (
    MOST_MODES,
    repeated,
    Solutions,
    with_polynomial,
    with_spectrum,
)
from vsensor_ros.designer.noise import Filter, kalman, mean_rate, NoiseModel
from vsensor_ros.designer.observer import acting, Candidate, knows_arguments
from vsensor_ros.designer.order import Family
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.quotient import argument, Quotient
from vsensor_ros.designer.stabilise import fixed_roots, margin, stable_members
from vsensor_ros.designer.subspaces import in_row_space, solve_left
from vsensor_ros.observers.kinds.functional import decay_of

SPEEDS = (0.5, 1.0, 2.0, 4.0, 8.0)  # of the observer, against the plant's own mean rate
MEMBERS = 3  # of a family without free spectrum
QUIETED_FREEDOM = 8  # such a family of so few coefficients is searched for the quietest
QUIETED_ORDER = 60  # in plants of so few states
MOST_TERMS = 4  # up to so many free terms, every set of decoupled ones is tried
MOST_SPACES = 8  # invariant spaces tried
FEW_SPACES = 2  # of several functionals in plants of more than LARGEST_CLOSED states
LARGEST_CLOSED = 100
SHIFTS = 5  # bisections, for a filter that decays as asked and no faster
TRIES = 8  # random members of a family, where arguments must be known


@dataclass(frozen=True, eq=False)
class Ground:
    """What the search for one problem stands on."""

    problem: Problem
    known: Quotient
    terms: np.ndarray  # (s, r) arguments of the terms that act on the quotient
    noise: NoiseModel
    decay: float  # 1/s, wanted

    @cached_property
    def filter(self) -> Filter | None:
        """Return the Kalman filter."""
        return kalman(self.known, self.noise)

    @cached_property
    def floor(self) -> float:
        """Return an error that none falls below, largest row; nan where none is known."""
        size, known, found = self.problem.v_size, self.known, self.filter
        if np.ptp(size):  # the row that is largest in its unit counts
            share = (size / size.max())[:, None]
            found = kalman(replace(known, v=share * known.v, q=share * known.q), self.noise)
        least = found.floor * size.max() ** 2 if found else np.nan
        return float(np.sqrt(max(least, 0.0))) if np.isfinite(least) else np.nan

    @cached_property
    def measured(self) -> bool:
        """Whether the readings alone give v."""
        return in_row_space(self.known.E, self.known.v)


@dataclass(frozen=True, eq=False)
class JudgedCandidate:
    """A candidate with its noise and decay."""

    candidate: Candidate
    method: str
    error: float  # standard deviation, in the unit of the channel
    decay: float  # 1/s

    @property
    def order(self) -> int:
        """Return the number of states."""
        return len(self.candidate.N)


def grounds(problem: Problem, existence: Existence, avoid: frozenset[int], noise: NoiseModel,
            decay: float) -> list[Ground]:
    """Return the ground for each set of terms to decouple from, the least set first."""
    first = examine(problem, avoid) if avoid else existence
    assert first.quotient is not None
    rest = [i for i in range(len(problem.G)) if i not in first.forced]
    sets = ([rest] if len(rest) > MOST_TERMS else
            [list(s) for size in range(1, len(rest) + 1) for s in combinations(rest, size)])
    quotients = {first.forced: first.quotient}
    for more in sets:
        further = examine(problem, first.forced | frozenset(more))
        if further.quotient is not None:
            quotients.setdefault(further.forced, further.quotient)
    return [Ground(problem, known, _arguments(problem, known), noise, decay)
            for known in quotients.values()]


def _arguments(problem: Problem, known: Quotient) -> np.ndarray:
    rows = [argument(problem, known.Phi, g)
            for g, acts in zip(problem.G, acting(problem, known.Phi)) if acts]
    return np.vstack([np.zeros((0, known.order)), *(row for row in rows if row is not None)])


def judged(ground: Ground, candidates: Iterable[Candidate], method: str) -> list[JudgedCandidate]:
    """Judge the stable candidates that know the arguments of their terms."""
    found = []
    for candidate in candidates:
        if not all(np.isfinite(part).all() for part in vars(candidate).values()):
            continue
        decay = decay_of(np.linalg.eigvals(candidate.N), ground.noise.sample_time)
        if decay > 0 and knows_arguments(ground.problem, candidate.Phi):
            error = ground.noise.error(ground.problem, candidate)
            if np.isfinite(error):
                found.append(JudgedCandidate(candidate, method, error, decay))
    return found


def static(ground: Ground) -> list[JudgedCandidate]:
    """Return the combination of healthy readings that gives v."""
    known = ground.known
    if not ground.measured:
        return []
    if len(known.v) == 1:
        found = with_spectrum(known, ground.noise, np.zeros(0))
        return judged(ground, [found.candidate(found.sparing())] if found else [], 'static')
    g = solve_left(known.E, known.v)
    return judged(ground, [Candidate(
        np.zeros((0, known.Phi.shape[1])), np.zeros((0, 0)),
        np.zeros((0, known.R.shape[1])), np.zeros((len(g), 0)), g @ known.R + known.q)], 'static')


def of_family(ground: Ground, family: Family) -> list[JudgedCandidate]:
    """Return virtual sensors whose characteristic polynomial is in a family."""
    k, f = len(family.M), len(family.F)
    if k > MOST_MODES:
        return []
    fixed = fixed_roots(family)
    if f + len(fixed) == k and not repeated(fixed, ground.known.still):
        if decay_of(fixed, ground.noise.sample_time) <= margin(
                family, ground.noise.sample_time):
            return []
        return of_spectra(ground, [np.concatenate([fixed, spectrum])
                                   for spectrum in _templates(ground, f)])
    members = stable_members(family, ground.noise.sample_time, ground.decay)[0][:MEMBERS]
    if members and 0 < f <= QUIETED_FREEDOM and ground.known.order <= QUIETED_ORDER:
        members.append(_quieted(ground, family, members))
    return _varied(ground, [_with_member(ground, family, theta) for theta in members])


def of_spectra(ground: Ground, spectra: Iterable[np.ndarray]) -> list[JudgedCandidate]:
    """Return the quietest virtual sensor of one functional for each spectrum."""
    return _varied(ground, [with_spectrum(ground.known, ground.noise, s) for s in spectra
                            if not repeated(s, ground.known.still)])


def _with_member(ground: Ground, family: Family, theta: np.ndarray) -> Solutions | None:
    roots = family.roots(theta)
    known, noise = ground.known, ground.noise
    solved = None if repeated(roots, known.still) else with_spectrum(known, noise, roots)
    return solved or with_polynomial(known, noise, family.member(theta))


def _varied(ground: Ground, spectra: Iterable[Solutions | None]) -> list[JudgedCandidate]:
    """Judge the quietest of each, one that reads little, and others for their arguments."""
    found = []
    for solved in spectra:
        if solved is None:
            continue
        candidates = [solved.candidate(solved.sparing()), solved.candidate(solved.best)]
        rng = np.random.default_rng(0)
        if not any(knows_arguments(ground.problem, c.Phi) for c in candidates) and len(solved.Z):
            candidates += [solved.candidate(
                solved.best + 10 * rng.normal(size=len(solved.Z)) @ solved.Z)
                for _ in range(TRIES)]
        found += judged(ground, candidates, 'modal')
    return found


def on_invariant_spaces(ground: Ground) -> list[JudgedCandidate]:
    """Return virtual sensors on invariant spaces that hold v and the arguments of terms."""
    known, found = ground.known, whole(ground)
    for rows in ([known.v] if not len(ground.terms)
                 else [known.v, np.vstack([known.v, ground.terms])]):
        tried = (MOST_SPACES if known.order <= LARGEST_CLOSED else
                 FEW_SPACES if len(known.v) > 1 else 0)
        for _, space in zip(range(tried), invariant_spaces.spaces(known, rows)):
            found += judged(ground, invariant_spaces.candidates(
                known, ground.noise, space, ground.decay), 'closed subspace')
    return found


def whole(ground: Ground) -> list[JudgedCandidate]:
    """Return observers of everything known but the readings: they exist whenever any does."""
    return judged(ground, invariant_spaces.candidates(
        ground.known, ground.noise, invariant_spaces.whole(ground.known), ground.decay,
        polish=False), 'reduced observer')


def stacked(ground: Ground, of_row: Callable[[Problem], Candidate | None],
            least: Sequence[int], most: float) -> list[JudgedCandidate]:
    """
    Return the observers of single rows of v side by side, each found by ``of_row``.

    ``least``: an order of each row below which it has none; ``most``: states, beyond which they
    are of no use.
    """
    problem, parts = ground.problem, []
    order = sum(least)
    for i in range(len(problem.V)):
        if order > most:
            return []
        one = replace(problem, V=problem.V[i:i + 1], Qv=problem.Qv[i:i + 1],
                      v_size=problem.v_size[i:i + 1],
                      wanted=(problem.wanted[0][i:i + 1], problem.wanted[1][i:i + 1],
                              problem.wanted[2][i:i + 1]))
        part = of_row(one)
        if part is None:
            return []
        order += len(part.N) - least[i]
        parts.append(part)
    if order > most:
        return []
    return judged(ground, [Candidate(
        np.vstack([p.Phi for p in parts]), block_diag(*(p.N for p in parts)),
        np.vstack([p.J for p in parts]), block_diag(*(p.Cv for p in parts)),
        np.vstack([p.Q for p in parts]))], 'single observers side by side')


def filters(ground: Ground, asked: bool = False) -> list[JudgedCandidate]:
    """
    Return the Kalman filter, and the quietest filters that decay as wanted.

    ``asked``: the rate was asked for, so that it is to be met at the least noise.
    """
    def shifted(shift: float) -> list[JudgedCandidate]:
        found = ground.filter if shift == 0 else kalman(ground.known, ground.noise, shift)
        return [] if found is None else judged(ground, [invariant_spaces.filter_candidate(
            ground.known, found, ground.terms)], 'filter')

    found = shifted(0.0)
    if found and found[0].decay >= ground.decay:
        return found
    found += shifted(ground.decay)
    # a mode that is slower than the shift is mirrored at it: that is more than is wanted
    low, high = 0.0, ground.decay
    for _ in range(SHIFTS if asked else 0):
        middle = 0.5 * (low + high)
        tried = shifted(middle)
        if tried and tried[0].decay >= ground.decay:
            found, high = found + tried, middle
        else:
            low = middle
    return found


def _quieted(ground: Ground, family: Family, members: list[np.ndarray]) -> np.ndarray:
    """Return a member of a family from which noise cannot be taken by small steps."""
    h = ground.noise.sample_time

    def cost(theta: np.ndarray) -> float:
        decay = decay_of(family.roots(theta), h)
        solved = _with_member(ground, family, theta) if decay > 0 else None
        if solved is None or solved.variance <= 0:
            return 1e3
        slow = max(1.0, ground.decay / decay)
        return float(0.5 * np.log(solved.variance) + 2.0 * np.log(slow))

    start = min(members, key=cost)
    steps = np.eye(len(start)) * 0.1 * max(float(np.linalg.norm(start)),
                                           0.1 * family.size)
    found = minimize(cost, start, method='Nelder-Mead', options={
        'initial_simplex': np.vstack([start, start + steps]), 'maxfev': 40 * (1 + len(start)),
        'fatol': 1e-2, 'xatol': 1e-6})
    return np.asarray(found.x)


def _templates(ground: Ground, count: int) -> list[np.ndarray]:
    """Return spectra of ``count`` eigenvalues: spread ones, and the filter's own."""
    if count == 0:
        return [np.zeros(0, complex)]
    mean, h = mean_rate(ground.problem), ground.noise.sample_time
    spread = (1.5 ** (np.arange(count) - (count - 1) / 2) if count <= 6
              else np.geomspace(1 / 3, 3, count))
    rates = [max(mean * speed, 1.05 * ground.decay / spread[0]) * spread for speed in SPEEDS]
    spectra = [(-r if h is None else np.exp(-r * h)).astype(complex) for r in rates]
    if ground.filter is not None and len(ground.known.E):
        N = ground.known.A - ground.filter.L @ ground.known.E
        values, right = np.linalg.eig(N)
        if np.linalg.cond(right) < 1e12:
            weight = np.abs(ground.known.v[0] @ right) * np.linalg.norm(
                np.linalg.solve(right, ground.noise.drives(ground.known)[0]), axis=1)
            spectra += _dominant(values, weight, count, ground.known.still)
    return spectra


def _dominant(values: np.ndarray, weight: np.ndarray, count: int,
              still: float) -> list[np.ndarray]:
    """Return the ``count`` eigenvalues of most weight, pairs kept together, if that works out."""
    chosen: list[complex] = []
    for i in np.argsort(-weight):
        value = complex(values[i])
        if value.imag < 0 or any(abs(value - c) < 1e-3 * abs(value - still)
                                 for c in chosen):
            continue
        pair = [value] if value.imag == 0 else [value, value.conjugate()]
        if len(chosen) + len(pair) <= count:
            chosen += pair
    return [np.array(chosen)] if len(chosen) == count else []
