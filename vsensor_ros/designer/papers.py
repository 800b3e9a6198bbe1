"""
The papers' own designs as named methods: Jordan and identification canonical form.

The default search finds whatever these find; they are kept because people know them. The order is
raised until one is stable with the loop closed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations
import warnings

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize

from vsensor_ros.designer.canonical import identification_rows, jordan_rows
from vsensor_ros.designer.existence import examine
from vsensor_ros.designer.noise import mean_rate
from vsensor_ros.designer.observer import build, Candidate, close_loop, knows_arguments, polished
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.sentences import say
from vsensor_ros.designer.subspaces import (
    in_row_space,
    left_kernel,
    measured_part,
    rank,
    solve_left,
)
from vsensor_ros.observers import Refusal, VirtualSensor
from vsensor_ros.observers.kinds.functional import decay_of
from vsensor_ros.reason import Reason

NOISE_FACTOR = 2.0  # the fastest within this factor of the quietest is taken
SPEEDS = (0.25, 0.5, 1.0, 2.0, 4.0)  # of the observer, against the plant's own mean rate
TRIES = 8  # random choices of what a canonical form leaves free
MOST_TERMS = 4  # up to so many free terms, every set of decoupled ones is tried


def least_order(problem: Problem, avoid: frozenset[int], method: str) -> VirtualSensor | Refusal:
    """Raise the order until a canonical form ('jordan' or 'identification') is stable."""
    existence = examine(problem, avoid)
    assert existence.quotient is not None
    candidate = close_loop(problem, np.zeros((0, len(problem.A))))
    found = build(problem, candidate, 'static') if candidate else None
    if found is not None:
        return found
    search = jordan if method == 'jordan' else identification
    rest = [i for i in range(len(problem.G)) if i not in existence.forced]
    sets = ([[], rest] if len(rest) > MOST_TERMS else
            [s for size in range(len(rest) + 1) for s in combinations(rest, size)])
    for k in range(1, existence.quotient.order + 1):
        for more in sets:
            sensors = search(problem, k, existence.forced | frozenset(more))
            if sensors:
                return _choose(sensors)
    return Refusal(problem.channel, problem.fault_set, say(Reason.of(
        'none in canonical form', order=existence.quotient.order, form=method,
        terms=tuple(t.short for t in problem.plant.terms))))


def _choose(sensors: list[VirtualSensor]) -> VirtualSensor:
    """Take the fastest among the virtual sensors that are nearly as quiet as the quietest."""
    limit = NOISE_FACTOR * min(v.noise_gain for v in sensors)
    return max((v for v in sensors if v.noise_gain <= limit),
               key=lambda v: decay_of(v.eigenvalues, v.sample_time))


def spectra(problem: Problem, k: int) -> list[np.ndarray]:
    """
    Return sets of k distinct real eigenvalues to try, slow to fast.

    They spread around the geometric mean of the plant's own rates, times each of SPEEDS.
    """
    mean, h = mean_rate(problem), problem.plant.sample_time
    spread = 1.5 ** (np.arange(k) - (k - 1) / 2) if k <= 8 else np.geomspace(1 / 6, 6, k)
    if h is None:
        return [-mean * speed * spread for speed in SPEEDS]
    return [np.exp(-mean * speed * spread * h) for speed in SPEEDS]


def jordan(problem: Problem, k: int, S: frozenset[int],
           eigenvalues: np.ndarray | None = None) -> list[VirtualSensor]:
    """
    Search designs of order k in Jordan canonical form that are decoupled from the terms in S.

    For each set of eigenvalues the rows ``w_i`` of ``V = sum w_i + Q C0`` solve a linear system,
    from which ``N = diag(eigenvalues) + g 1'`` with g the gain on v itself. First g = 0 is tried,
    then g is chosen for stability. Source: S (19), R (14), with the loop closed.
    """
    D = problem.decoupled(S)
    found = []
    for spectrum in spectra(problem, k) if eigenvalues is None else [eigenvalues]:
        candidates = list(_jordan_candidates(problem, D, spectrum))
        if not candidates:
            break  # solvability does not depend on the spectrum
        found += _built(problem, candidates, 'jordan')
    return found


@dataclass(frozen=True, eq=False)
class JordanFamily:
    """All solutions of ``V = sum_i a_i rows_i + Q C0``; x = base + free combinations."""

    problem: Problem
    spectrum: np.ndarray  # (k,)
    rows: list[np.ndarray]  # k of (s_i, n): a_i rows_i = w_i is the i-th row of Phi
    gains: list[np.ndarray]  # k of (s_i, l0) or, when v is fed back, (s_i, l0 + 1)
    fed_back: bool
    base: np.ndarray  # (sum s_i + l0,): the a_i one after the other, then Q
    free: np.ndarray  # (f, sum s_i + l0)

    def member(self, x: np.ndarray) -> Candidate:
        """Close the loop for one solution x."""
        *a, Q = np.split(x, np.cumsum([len(rows) for rows in self.rows]))
        Phi = np.vstack([ai @ rows for ai, rows in zip(a, self.rows)])
        J = np.vstack([ai @ gains for ai, gains in zip(a, self.gains)])
        ones = np.ones((1, len(Phi)))
        N, Q = np.diag(self.spectrum), Q[None, :]
        if self.fed_back:
            g = J[:, -1:]
            N, J = N + g @ ones, J[:, :-1] + g @ Q
        return Candidate(Phi, N, J @ self.problem.Y + Phi @ self.problem.F, ones,
                         Q @ self.problem.Y + self.problem.Qv)


def jordan_family(problem: Problem, D: np.ndarray, spectrum: np.ndarray,
                  fed_back: bool) -> JordanFamily | None:
    """Solve for all designs whose A_* has the given spectrum; None when there are none."""
    outputs = problem.C_star if fed_back else problem.C0
    solutions = [jordan_rows(problem.A, outputs, D, value) for value in spectrum]
    M = np.vstack([*(rows for rows, _ in solutions), problem.C0])
    if not in_row_space(M, problem.V):
        return None
    return JordanFamily(problem, spectrum, [rows for rows, _ in solutions],
                        [gains for _, gains in solutions], fed_back,
                        solve_left(M, problem.V)[0], left_kernel(M))


def _jordan_candidates(problem: Problem, D: np.ndarray,
                       spectrum: np.ndarray) -> Iterator[Candidate]:
    family = jordan_family(problem, D, spectrum, fed_back=False)
    if family is None:
        family = jordan_family(problem, D, spectrum, fed_back=True)
        if family is not None:
            yield family.member(_stabilised(problem, family))
        return
    x = _quietest(problem, family)  # the spectrum is as wanted
    yield family.member(x)
    if len(family.free) and not knows_arguments(problem, family.member(x).Phi):
        rng = np.random.default_rng(0)  # (E4) may hold for other members
        for _ in range(TRIES):
            yield family.member(x + rng.normal(size=len(family.free)) @ family.free)


def _quietest(problem: Problem, family: JordanFamily) -> np.ndarray:
    """Pick the member with the least gains J_i / rate_i and Q from the readings."""
    if not len(family.free):
        return family.base
    rates = (np.abs(family.spectrum) if problem.plant.sample_time is None
             else np.abs(1 - family.spectrum))
    gains = block_diag(*(g / rate for g, rate in zip(family.gains, rates)),
                       np.eye(len(problem.C0)))
    return family.base + (
        solve_left(family.free @ gains, -(family.base @ gains)[None, :]) @ family.free)[0]


def _stabilised(problem: Problem, family: JordanFamily) -> np.ndarray:
    """Move along the free directions until the closed loop decays as wanted, if it can."""
    discrete = problem.plant.sample_time is not None
    size = np.abs(family.spectrum)
    free, wanted = family.free, size.max() if discrete else size.min()

    def excess(theta: np.ndarray) -> float:
        eigenvalues = np.linalg.eigvals(family.member(family.base + theta @ free).N)
        if discrete:
            return max(0.0, np.abs(eigenvalues).max() - wanted)
        # fast enough, and no faster: the second part keeps the gains from running away
        return (max(0.0, eigenvalues.real.max() / wanted + 1.0)
                + 1e-2 * np.abs(eigenvalues).max() / wanted)

    if not len(free):
        return family.base
    rng = np.random.default_rng(0)
    starts = [np.zeros(len(free)), *(rng.normal(size=len(free)) for _ in range(2))]
    results = [minimize(excess, start, method='Nelder-Mead',
                        options={'maxiter': 100 * len(free), 'xatol': 1e-3, 'fatol': 1e-4})
               for start in starts]
    return family.base + min(results, key=lambda r: r.fun).x @ free


def identification(problem: Problem, k: int, S: frozenset[int]) -> list[VirtualSensor]:
    """
    Search designs of order k in identification canonical form, decoupled from the terms in S.

    Where a residual exists its gain K places the spectrum of the closed loop (the papers place
    that of A_* instead, R section 3). Source: R (9), S (14), D (21).
    """
    D = problem.decoupled(S)
    candidates: list[Candidate] = []
    rng = np.random.default_rng(0)
    for first in (problem.C0, None):
        solutions = identification_rows(problem.A, problem.C_star, D, k, first)
        mixes = [*np.eye(len(solutions)), *rng.normal(size=(TRIES, len(solutions)))]
        for mix in mixes if solutions else []:
            Phi = np.einsum('s,skn->kn', mix, np.array([p for p, _ in solutions]))
            if rank(Phi) < k or not knows_arguments(problem, Phi):
                continue
            candidate = close_loop(problem, Phi)
            if candidate is not None:
                candidates += [candidate, *with_residual(problem, candidate)]
    return _built(problem, candidates, 'identification')


def with_residual(problem: Problem, candidate: Candidate,
                  eigenvalues: np.ndarray | None = None) -> Iterator[Candidate]:
    """Add the feedback K of a residual ``r = R y0 - C_* z`` that places the spectrum of N."""
    from scipy.signal import place_poles  # which loads scipy.stats, too
    C_ = measured_part(candidate.Phi, problem.C0)
    if not len(C_):
        return
    R = solve_left(problem.C0, C_ @ candidate.Phi)
    k = len(candidate.N)
    for spectrum in (spectra(problem, k) if eigenvalues is None else [eigenvalues]):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter('ignore', UserWarning)  # robust enough after a few sweeps
                K = place_poles(candidate.N.T, C_.T, spectrum, maxiter=3).gain_matrix.T
        except (ValueError, np.linalg.LinAlgError):  # a mode that the residual does not show
            return
        yield Candidate(candidate.Phi, candidate.N - K @ C_, candidate.J + K @ R @ problem.Y,
                        candidate.Cv, candidate.Q)


def _built(problem: Problem, candidates: Iterable[Candidate], method: str) -> list[VirtualSensor]:
    sensors = (build(problem, polished(problem, c), method)
               for c in candidates if knows_arguments(problem, c.Phi))
    return [sensor for sensor in sensors if sensor is not None]
