"""
A stable member of a family of polynomials, or the proof that there is none.

One free coefficient is decided exactly: the values at which a root crosses the boundary of
stability are the zeros of a rational function. With more, none is excluded by a linear program
over conditions that any stable polynomial meets; a member is found by descent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import block_diag, eig
from scipy.optimize import linprog, minimize

from vsensor_ros.designer.order import Family
from vsensor_ros.designer.subspaces import unobservable
from vsensor_ros.observers.kinds.functional import decay_of
from vsensor_ros.reason import Reason

STARTS = 6  # descents from different points
LINES = 40  # looked along where descents found nothing
CLEAR = 1e-7  # conditions of length one that cannot be met by so much are in contradiction
FAR = 1e6  # times the size of the matrix: coefficients beyond are no use, or infinite
CERTAIN = 12  # up to such a degree the linear program is trusted to exclude
WORK = 3e7  # operations, in cubes of the degree, that one family is worth
SIMPLEX = 3  # up to so many free coefficients a simplex helps over the kinks
_SAMPLES = 60  # real points at which the linear program looks


@dataclass(frozen=True)
class NoStableMember:
    """Why a family of polynomials has no stable member, or why none is known."""

    proved: bool  # that there is none; else none was found
    why: Reason


@lru_cache(maxsize=4)  # who finds none asks again why
def stable_members(family: Family, sample_time: float | None,
                   wanted: float) -> tuple[list[np.ndarray], NoStableMember | None]:
    """
    Return theta (f,) of members that decay, the fastest first, and what is known if none does.

    ``wanted`` [1/s]: a decay rate beyond which nothing is sought.
    """
    f, least = len(family.F), margin(family, sample_time)
    if f == 0:
        points = [np.zeros(0)]
        none = NoStableMember(True, Reason.of(
            'one polynomial', root=_worst(family.roots(points[0]), sample_time)))
    elif f == 1:
        points = _along(family, np.zeros(1), np.ones(1), sample_time)
        points += [_better(family, sample_time, wanted, p) for p in points]
        none = NoStableMember(True, Reason.of('one free coefficient'))
    else:
        none = (NoStableMember(False, Reason.of('any spectrum')) if family.free
                else _excluded(family, sample_time))
        points = [] if none.proved else _descents(family, sample_time, wanted)
    rates = [decay_of(family.roots(theta), sample_time) for theta in points]
    if points and max(rates) <= least and f > 1:
        points = _lines(family, sample_time, points[int(np.argmax(rates))])
        points += [_better(family, sample_time, wanted, p) for p in points]
        rates = [decay_of(family.roots(theta), sample_time) for theta in points]
    order = sorted(range(len(points)), key=lambda i: -rates[i])
    stable = [points[i] for i in order if rates[i] > least]
    return stable, None if stable else none


def margin(family: Family, sample_time: float | None) -> float:
    """Return the decay rate [1/s] below which a root may be on the limit of stability."""
    return 1e-10 * (family.speed if sample_time is None else 1.0 / sample_time)


def _worst(roots: np.ndarray, sample_time: float | None) -> complex:
    return complex(roots[np.argmax(roots.real if sample_time is None else np.abs(roots))])


def fixed_roots(family: Family) -> np.ndarray:
    """Return the roots that all members share."""
    if family.free:
        return np.zeros(0, complex)
    hidden = unobservable(family.M, family.F)
    return np.linalg.eigvals(hidden.T @ family.M @ hidden).astype(complex)


def _along(family: Family, base: np.ndarray, direction: np.ndarray,
           sample_time: float | None) -> list[np.ndarray]:
    """
    Return one theta from each interval of a line between crossings of the limit of stability.

    Exact but for rounding: within an interval the number of unstable roots is constant.
    """
    k = len(family.M)
    # with row c, t c (s - A)^-1 b = 1 at a root s of the member base + t direction
    A, b, c, d = (family.member(base), np.eye(k)[:, -1:], (direction @ family.F)[None, :],
                  np.zeros((1, 1)))
    size = max(np.linalg.norm(A - family.still * np.eye(k), 2), np.finfo(float).tiny)
    if sample_time is not None:  # z = (1 + s)/(1 - s) takes the unit circle to the imaginary axis
        if np.linalg.cond(A + np.eye(k)) > 1e12:
            A = A + 1e-9 * np.linalg.norm(A, 2) * np.eye(k)
        inverse = np.linalg.inv(A + np.eye(k))
        A, b, c, d = (inverse @ (A - np.eye(k)), np.sqrt(2) * inverse @ b,
                      np.sqrt(2) * c @ inverse, d - c @ inverse @ b)
    # on the axis the function is real where G(s) - G(-s) = 0, a system of order 2 k
    both = block_diag(A, -A)
    pencil = np.block([[both, np.vstack([b, b])], [np.hstack([c, c]), np.zeros((1, 1))]])
    zeros = eig(pencil, block_diag(np.eye(2 * k), np.zeros((1, 1))), right=False)
    zeros = zeros[np.isfinite(zeros)]
    inner = max(np.linalg.norm(A, 2), np.finfo(float).tiny)
    on_axis = zeros[(np.abs(zeros.real) < 1e-6 * np.maximum(np.abs(zeros), 1e-3 * inner))
                    & (np.abs(zeros) < 1e6 * inner)]
    crossings = [] if d[0, 0] == 0 else [1.0 / d[0, 0]]
    for omega in (0.0, *np.abs(on_axis.imag)):
        try:
            value = (c @ np.linalg.solve(1j * omega * np.eye(k) - A, b) + d)[0, 0]
        except np.linalg.LinAlgError:  # a root of the base itself is on the limit
            crossings.append(0.0)
            continue
        if abs(value.real) > 1e-9 * abs(value) > 0:
            crossings.append(1.0 / value.real)
    # a crossing far beyond all else is one at infinity, moved by rounding
    limits = np.unique([t for t in crossings if abs(t) < FAR * size])
    wide = max(np.abs(limits).max(initial=0.0), size)
    steps = [*(0.5 * (limits[:-1] + limits[1:])), *(limits[:1] - 0.1 * wide), *(limits[:1] - wide),
             *(limits[-1:] + 0.1 * wide), *(limits[-1:] + wide), 0.0]
    return [base + t * direction for t in steps]


def _better(family: Family, sample_time: float | None, wanted: float,
            theta: np.ndarray) -> np.ndarray:
    """Move a stable member to where it decays as wanted, but no farther."""
    if decay_of(family.roots(theta), sample_time) <= 0:
        return theta
    size = max(family.size, float(np.finfo(float).tiny))

    def cost(t: np.ndarray) -> float:
        roots = family.roots(t)
        return (-min(decay_of(roots, sample_time), wanted) / max(wanted, 1e-300)
                + 1e-3 * float(np.abs(roots - family.still).max()) / size)

    return np.asarray(minimize(cost, theta, method='Nelder-Mead',
                               options={'maxiter': 60 * len(theta)}).x)


def _lines(family: Family, sample_time: float | None, base: np.ndarray) -> list[np.ndarray]:
    """Look along random lines through the best member, each decided exactly."""
    rng = np.random.default_rng(0)
    rate = decay_of(family.roots(base), sample_time)
    for _ in range(int(min(LINES, 0.1 * WORK / len(family.M) ** 3))):
        points = _along(family, base, rng.normal(size=len(base)), sample_time)
        rates = [decay_of(family.roots(p), sample_time) for p in points]
        best = int(np.argmax(rates))
        if rates[best] > 0:
            return [points[best]]
        if rates[best] > rate:
            base, rate = points[best], rates[best]
    return []


def _descents(family: Family, sample_time: float | None, wanted: float) -> list[np.ndarray]:
    """Descend on the slowest root from several starts, and stop where all decay as wanted."""
    size = max(family.size, float(np.finfo(float).tiny))
    enough = (-wanted if sample_time is None else np.expm1(-wanted * sample_time)) / size

    spent = 0

    def worst(theta: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal spent
        spent += 1
        values, right = np.linalg.eig(family.member(size * theta))
        measure = (values.real if sample_time is None else np.abs(values) - 1.0) / size
        i = int(np.argmax(measure))
        try:
            left = np.linalg.solve(right.T, np.eye(len(values))[i])  # left @ right = unit row i
        except np.linalg.LinAlgError:
            return float(measure[i]), np.zeros(len(theta))
        moved = left[-1] * (family.F @ right[:, i])
        slope = moved.real if sample_time is None else (
            np.conj(values[i]) * moved).real / max(abs(values[i]), 1e-12)
        # a light pull keeps the coefficients from running away
        return (float(measure[i]) + 1e-6 * float(theta @ theta), slope + 2e-6 * theta)

    rng = np.random.default_rng(0)
    found = []
    few = len(family.F) <= SIMPLEX
    budget = max(WORK / len(family.M) ** 3, 30.0)
    for attempt in range(STARTS):
        if spent > budget:
            break
        theta = (np.zeros(len(family.F)) if attempt == 0
                 else rng.normal(size=len(family.F)) * 10.0 ** rng.uniform(-2, 0.5))
        for _ in range(4):  # the function has kinks: go on where the line search gives up
            before = worst(theta)[0]
            theta = minimize(worst, theta, jac=True, method='BFGS',
                             options={'maxiter': int(min(60, budget))}).x
            if few:
                theta = minimize(lambda t: worst(t)[0], theta, method='Nelder-Mead', options={
                    'maxiter': 40 * len(theta), 'xatol': 1e-6, 'fatol': 1e-9}).x
            value = worst(theta)[0]
            if value < enough or value > before - 1e-3 * abs(before) or spent > budget:
                break
            theta = theta + 1e-3 * rng.normal(size=len(theta)) * np.linalg.norm(theta)
        found.append(size * theta)
        if value < enough:
            break
    return found


def _excluded(family: Family, sample_time: float | None) -> NoStableMember:
    """Exclude stable members by a linear program, if that is possible."""
    k = len(family.M)
    shared = fixed_roots(family)
    if decay_of(shared, sample_time) <= margin(family, sample_time):
        return NoStableMember(True, Reason.of('shared roots', root=_worst(shared, sample_time)))
    unknown = NoStableMember(False, Reason.of('not found among', free=len(family.F)))
    # p(s) > 0 at real s beyond the boundary, and with it all derivatives (Gauss and Lucas):
    # p(s) = det(s - M) (1 - theta F (s - M)^-1 e_k)
    size = max(family.size, 1e-300)
    grid = size * np.concatenate([[0.0], np.geomspace(1e-4, 1e3, _SAMPLES)])
    rows, bounds = [], []
    sides = ((1.0, grid),) if sample_time is None else ((1.0, 1.0 + grid), (-1.0, -1.0 - grid))
    for _, side in sides:
        for s in side:
            sign, _ = np.linalg.slogdet(s * np.eye(k) - family.M)
            sign *= 1.0 if s >= 0 else (-1.0) ** k
            if sign == 0:
                continue
            value = family.F @ np.linalg.solve(s * np.eye(k) - family.M, np.eye(k)[:, -1])
            rows.append(sign * value)
            bounds.append(sign)
    if k > CERTAIN:
        return unknown
    coefficients, moves = _coefficients(family)
    if sample_time is None:
        rows += list(-moves.T)
        bounds += list(coefficients)
    # the most by which all can be met at once, by theta = size * unknown within reason
    A, b = size * np.array(rows), np.array(bounds)
    length = np.maximum(np.linalg.norm(A, axis=1), np.abs(b))
    A, b = A / length[:, None], b / length
    found = linprog(np.append(np.zeros(len(family.F)), -1.0),
                    A_ub=np.column_stack([A, np.ones(len(A))]), b_ub=b,
                    bounds=[*[(-1e6, 1e6)] * len(family.F), (None, 1.0)], method='highs')
    if found.status == 0 and found.x[-1] < -CLEAR:
        return NoStableMember(True, Reason.of('not positive'))
    return unknown


def _coefficients(family: Family) -> tuple[np.ndarray, np.ndarray]:
    """
    Return coefficients (k,) of the base polynomial, and how theta moves them (f, k).

    In powers of s/r, each scaled by its largest; from values on a circle of radius r. All are
    positive when the polynomial is Hurwitz.
    """
    k = len(family.M)
    roots = np.linalg.eigvals(family.M)
    size = np.linalg.norm(family.M, 2)
    # near the mean modulus of the roots, but not on one
    r = max(1.37 * float(np.exp(np.mean(np.log(np.abs(roots) + 1e-3 * size)))), 1e-300)
    circle = r * np.exp(2j * np.pi * np.arange(k + 1) / (k + 1))
    base = np.array([np.prod((s - roots) / r) for s in circle])
    moved = np.array([np.linalg.solve(s * np.eye(k) - family.M, np.eye(k)[:, -1])
                      for s in circle]).T * base
    values = np.vstack([base, -family.F @ moved])
    powers = np.fft.fft(values, axis=1).real / (k + 1)
    scale = np.maximum(np.abs(powers).max(axis=0), 1e-300)
    return (powers[0] / scale)[:k], (powers[1:] / scale)[:, :k]
