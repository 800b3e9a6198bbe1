"""
Quadratic forms of an error system that fall for all slopes of its terms, searched for and checked.

With n the error of the readings and s the difference quotients of the terms, within their
bounds, ``d e = (N + sum_j s_j p_j g_j) e - (J + sum_j s_j p_j h_j) n``, ``v - vhat = Cv e - Q n``.
A form is believed only after it has been put into the inequalities in plain floating point, with
a margin for rounding; what a solver says of itself counts for nothing (the method, 3.5).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
import warnings

import numpy as np
from scipy.linalg import (
    expm,
    matrix_balance,
    null_space,
    schur,
    solve_continuous_are,
    solve_continuous_lyapunov,
    solve_discrete_are,
    solve_discrete_lyapunov,
    solve_triangular,
)

LARGEST_ORDER = 14  # for matrix inequalities: their cost grows with the sixth power
MOST_CORNERS = 8  # slopes whose 2**8 corners are all put in; beyond, the S-procedure
LARGEST_INEQUALITY = 2500  # entries of all corners together in the search; beyond, the same
ROUNDING = 1e-12  # relative, of the matrices of the error
EQUALITY = 1e-9  # relative, to which S p = -t g' must hold where a slope has no upper bound
LARGEST_SPREAD = 1e12  # of the axes of V: a nearly defective N would have them ever longer
FAINT = 1e-4  # weight of what no error of a reading reaches, so that S stays regular
SMALL = 12  # states and slopes together: up to here
ACCURACY = 3e-4  # relative, of the largest rate, where that is cheap
COARSE, ROUGH = 0.03, 0.2  # the same where an inequality, or a Riccati equation, takes long
Solve = Callable[..., 'tuple[np.ndarray, np.ndarray | None] | None']


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes in centre + [-radius, radius], or centre + [0, inf); the centre lies in N and J."""

    p: np.ndarray  # (k, c)
    g: np.ndarray  # (c, k)
    h: np.ndarray  # (c, l0)
    radius: np.ndarray  # (c,)

    @property
    def feeding(self) -> Slopes:
        """Those that act on the error itself."""
        on = self.g.any(axis=1)
        return Slopes(self.p[:, on], self.g[on], self.h[on], self.radius[on])


@dataclass(frozen=True, eq=False)
class ErrorSystem:
    """The error system with its slopes: bounded, rising without bound, and without any bound."""

    N: np.ndarray
    J: np.ndarray
    Cv: np.ndarray
    Q: np.ndarray
    bounded: Slopes
    rising: Slopes
    loose: Slopes
    sample_time: float | None

    def corners(self) -> Iterator[np.ndarray]:
        """Yield N at all corners of the bounded slopes, the rising ones at their lower end."""
        fed = self.bounded.feeding
        for signs in product((-1.0, 1.0), repeat=len(fed.radius)):
            yield self.N + fed.p * (np.array(signs) * fed.radius) @ fed.g


@dataclass(frozen=True, eq=False)
class Form:
    """A quadratic form that was checked: V falls at twice the rate."""

    L: np.ndarray  # V = |L' e|^2
    rate: float  # 1/s
    bound: float


# ------------------------------------------------------------------------------ the check

def decay_rate(N: np.ndarray, sample_time: float | None) -> float:
    """Return the rate [1/s] of the slowest eigenvalue, negative when it grows."""
    values = np.linalg.eigvals(N)
    if sample_time is None:
        return float(-values.real.max())
    return float(-np.log(max(np.abs(values).max(), 1e-12)) / sample_time)


def _contraction(rate: float, sample_time: float | None) -> float:
    # gain of |e| over what is pushed in per second, or per step
    return 1.0 / rate if sample_time is None else float(-1.0 / np.expm1(-rate * sample_time))


def _rate(error: ErrorSystem, L: np.ndarray, t: np.ndarray | None = None) -> float:
    """
    Return the rate [1/s] at which V = |L' e|^2 is certain to fall, or -inf.

    All corners of the bounded slopes are tried up to MOST_CORNERS of them; beyond, the
    S-procedure with multipliers t (chosen here when None). Slopes that rise without bound need
    S p = -t g' with t >= 0: then the form falls by 2 t s (g e)^2 on their account. S is taken
    from the solutions of that equation, and a form that solves it exactly lies within rounding
    of S. The margin is the rounding of the product L' N L'^-1, from the moduli of its factors.
    """
    if not np.all(np.isfinite(L)) or np.any(np.diag(L) == 0) or error.loose.feeding.radius.size:
        return -np.inf

    def turned(M: np.ndarray) -> np.ndarray:  # L' M L'^-1
        return solve_triangular(L, (L.T @ M).T, lower=True).T

    rising, fed = error.rising.feeding, error.bounded.feeding
    margin = ROUNDING
    if rising.radius.size:
        Sp, g = L @ (L.T @ rising.p), rising.g
        t = -np.sum(Sp * g.T, axis=0) / np.sum(g.T**2, axis=0)
        off = np.linalg.norm(Sp + t * g.T, axis=0)
        if error.sample_time is not None or np.any(t <= 0) or np.any(
                off > EQUALITY * np.linalg.norm(Sp, axis=0)):
            return -np.inf
        margin = 10 * EQUALITY
    inverse = np.abs(solve_triangular(L, np.eye(len(L)), lower=True).T)
    slack = (margin * np.linalg.norm(turned(error.N))
             + 4 * np.finfo(float).eps * len(L)
             * np.linalg.norm(np.abs(L.T) @ np.abs(error.N) @ inverse))
    if len(fed.radius) <= MOST_CORNERS:
        worst = max(_growth(turned(A), error.sample_time) for A in error.corners())
    else:
        worst = _growth_by_multipliers(turned(error.N), L.T @ fed.p,
                                       solve_triangular(L, fed.g.T, lower=True).T * (
                                           fed.radius[:, None]), error.sample_time, t)
    grows = float(worst + slack)
    if error.sample_time is None:
        return -grows
    return float(-np.log(max(grows, 1e-12)) / error.sample_time)


def _growth(M: np.ndarray, sample_time: float | None) -> float:
    # of |e|: logarithmic norm, or norm
    if sample_time is None:
        return float(np.linalg.eigvalsh(0.5 * (M + M.T))[-1])
    return float(np.linalg.norm(M, 2))


def _growth_by_multipliers(M: np.ndarray, p: np.ndarray, g: np.ndarray,
                           sample_time: float | None, t: np.ndarray | None) -> float:
    """Bound the growth for all slopes in [-1, 1] by the S-procedure (the method, 3.5)."""
    if t is None:
        t = np.linalg.norm(p, axis=0) / np.linalg.norm(g, axis=1)
    gain = g.T * t @ g
    if sample_time is None:
        return float(np.linalg.eigvalsh(0.5 * (M + M.T + gain + p / t @ p.T))[-1])
    inner = np.diag(t) - p.T @ p
    if np.linalg.eigvalsh(inner)[0] <= ROUNDING * t.max():
        return np.inf
    across = M.T @ p
    X = M.T @ M + gain + across @ np.linalg.solve(inner, across.T)
    return float(np.sqrt(max(np.linalg.eigvalsh(0.5 * (X + X.T))[-1], 0.0)))


# ---------------------------------------------------------------------------- linear errors

def lyapunov(error: ErrorSystem) -> tuple[np.ndarray, float] | None:
    """
    Return L of a form V = |L' e|^2 and the rate it proves for N, all slopes at their centre.

    The rate asked for starts just below the spectrum's and is given up step by step until the
    form that the Lyapunov equation gives stands the check; None when none does.
    """
    N, step = error.N, error.sample_time
    bare = replace(error, bounded=_no_slopes(error), rising=_no_slopes(error))
    decay = decay_rate(N, step)
    if not decay > 0.0:
        return None
    best, best_rate = None, 0.0
    identity = np.eye(len(N))
    for size in (np.ones(len(N)), matrix_balance(N, permute=False, separate=True)[1][0]):
        scaled = N / size[:, None] * size
        for given_up in (1e-3, 1e-2, 0.1, 0.3, 0.6, 0.9):
            rate = (1.0 - given_up) * decay
            if best_rate >= rate:
                break
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter('ignore')  # of bad condition: what comes is checked
                    if step is None:
                        S = solve_continuous_lyapunov((scaled + rate * identity).T,
                                                      -decay * identity)
                    else:
                        S = solve_discrete_lyapunov(scaled.T * np.exp(rate * step), identity)
                L = np.linalg.cholesky(0.5 * (S + S.T)) / size[:, None]
            except (np.linalg.LinAlgError, ValueError):
                continue
            proved = _rate(bare, L)
            if proved > best_rate and np.diag(L).max() <= LARGEST_SPREAD * np.diag(L).min():
                best, best_rate = L, proved
        if best_rate >= 0.9 * decay:
            break
    return None if best is None else (best, best_rate)


def _no_slopes(error: ErrorSystem) -> Slopes:
    k, l0 = len(error.N), error.J.shape[1]
    return Slopes(np.zeros((k, 0)), np.zeros((0, k)), np.zeros((0, l0)), np.zeros(0))


def peak_bound(error: ErrorSystem, L: np.ndarray, rate: float) -> float:
    """
    Bound |v - vhat| for readings off by 1 at most, through peak gains of the centred system.

    L, rate: a form that N alone was checked with. What a bounded slope adds is an input of at
    most radius * peak of what it sees, g e - h n; these peaks bound each other, and the bounds
    close when the matrix of their gains has spectral radius below 1. Exact for a linear error.
    """
    seen = error.bounded
    if error.loose.radius.size or error.rising.radius.size:
        return np.inf
    l0 = error.J.shape[1]
    sources = np.hstack([error.J, seen.p * seen.radius])
    gains = np.array([_peak_gains(error.N, sources, row, L, rate, error.sample_time)
                      for row in np.vstack([error.Cv, seen.g])])
    of_v, of_seen = gains[:len(error.Cv)], gains[len(error.Cv):]
    loop = of_seen[:, l0:]
    if np.abs(np.linalg.eigvals(loop)).max(initial=0.0) >= 1 - ROUNDING:
        return np.inf
    peaks = np.linalg.solve(np.eye(len(loop)) - loop,
                            of_seen[:, :l0].sum(axis=1) + np.abs(seen.h).sum(axis=1))
    return float(np.max(of_v[:, :l0].sum(axis=1) + of_v[:, l0:] @ peaks
                        + np.abs(error.Q).sum(axis=1)))


def _peak_gains(N: np.ndarray, columns: np.ndarray, row: np.ndarray, L: np.ndarray, rate: float,
                sample_time: float | None) -> np.ndarray:
    """
    Bound int |row exp(N t) column| dt (or the discrete sum) for each column.

    Time is cut at points that double their distance every sixteen steps. On each step of length
    h, int |f| <= sqrt(h int f^2) (Cauchy and Schwarz), and the energy is a quadratic form that
    doubles its step exactly; the tail is bounded by L and the rate. All in Schur coordinates,
    where the exponentials of the diagonal are exact however stiff N is.
    """
    total = np.zeros(columns.shape[1])
    if not columns.any() or not row.any():
        return total
    steps = 16
    T, U = schur(N, output='complex')
    c, X = (row @ U)[None, :], U.conj().T @ columns
    if sample_time is None:
        h = 0.1 / max(float(np.linalg.norm(T, 1)), float(np.finfo(float).tiny))
        nodes, weights = np.polynomial.legendre.leggauss(4)
        at = [c @ expm(T * (0.5 * h * (1.0 + node))) for node in nodes]
        W = sum(0.5 * h * w * a.conj().T @ a for w, a in zip(weights, at))
        E = expm(T * h)
    else:
        h, E, W = 1.0, T, c.conj().T @ c
    tail = np.linalg.norm(solve_triangular(L, row, lower=True)) * _contraction(rate, sample_time)
    rest, diagonal = total, np.diag(E)
    for level in range(400):
        for _ in range(2 * steps if level == 0 else steps):
            energy = np.sum(X.conj() * (W @ X), axis=0).real
            total = total + np.sqrt(h * np.maximum(energy, 0.0))
            X = E @ X
        rest = tail * np.linalg.norm(L.T @ (U @ X).real, axis=0)
        if rest.sum() <= 1e-4 * total.sum():
            break
        W = W + E.conj().T @ W @ E
        diagonal = diagonal**2
        E = np.triu(E @ E, 1) + np.diag(diagonal)
        h *= 2.0
    return total + rest


# -------------------------------------------------------------------------- nonlinear errors

def search(error: ErrorSystem, wanted: float = 0.0) -> Form | None:
    """
    Find the quadratic form of the largest rate; None when none (above the wanted rate) is found.

    Raises ImportError when it would need cvxpy or clarabel and they are missing.
    """
    fed, rising = error.bounded.feeding, error.rising.feeding
    k = len(error.N)
    if error.loose.feeding.radius.size or (rising.radius.size and error.sample_time is not None):
        return None
    if np.any(np.sum(rising.p.T * rising.g, axis=1) >= 0):
        return None  # S p = -t g' with t > 0 needs g p = -p' S p / t
    ceiling = decay_rate(error.N, error.sample_time)
    if len(fed.radius) <= MOST_CORNERS:
        ceiling = min(ceiling, *(decay_rate(A, error.sample_time) for A in error.corners()))
    if not ceiling > wanted:
        return None
    nominal = lyapunov(error)
    if nominal is None:
        return None
    L = nominal[0]
    forms: list[Form] = []

    def weigh(L: np.ndarray, t: np.ndarray | None = None) -> float:
        rate = _rate(error, L, t)
        if rate > 0.0:
            forms.append(Form(L, rate, _bound(error, L, rate)))
        return rate

    least = weigh(L)
    if k > LARGEST_ORDER:
        if not rising.radius.size:
            _climb(_riccati(error, L), ceiling, max(least, 0.0), wanted, weigh, ROUGH)
    elif k > 1 and (least < (1 - ACCURACY) * ceiling or rising.h.any()):
        try:
            solve = _inequalities(error, L)
        except ImportError:
            if not forms:
                raise
        else:
            _climb(solve, ceiling, max(least, 0.0), wanted, weigh,
                   ACCURACY if k + len(fed.radius) <= SMALL else COARSE)
    best = max(forms, key=lambda form: form.rate, default=None)
    if best is None or best.rate < wanted:
        return None
    return replace(best, bound=min(peak_bound(error, *nominal), *(f.bound for f in forms)))


def _climb(solve: Solve, ceiling: float, low: float, wanted: float,
           weigh: Callable[..., float], accuracy: float) -> None:
    """Bisect for the largest rate up to the ceiling; every form met on the way is weighed."""
    def proved(rate: float, for_noise: bool = False) -> float:
        answer = solve(rate, for_noise)
        return -np.inf if answer is None else weigh(*answer)

    if low < max(wanted, 1e-3 * ceiling):
        low = proved(max(wanted, 1e-3 * ceiling))
        if not low >= wanted or low <= 0.0:
            return
    high, rate = ceiling, (1 - 0.5 * accuracy) * ceiling
    while high - low > accuracy * high:
        reached = proved(rate)
        low = max(low, reached)
        if not reached >= (1 - 0.5 * accuracy) * rate:  # with less, the interval would not close
            high = rate
        rate = 0.5 * (low + high)
    for share in (0.9, 0.6, 0.3):  # somewhat less than the largest rate bounds the noise better
        proved(share * low, for_noise=True)


def _inequalities(error: ErrorSystem, L: np.ndarray) -> Solve:
    """
    Pose the inequalities of the method, 3.5; return solve(rate, for_noise) -> (L, t) or None.

    Unknown are the coordinates of S in a basis of the symmetric matrices that satisfy
    S p = -t g' for all slopes without bound, and the multipliers t of the S-procedure where the
    corners are too many. In the coordinates L' e, where the Lyapunov form is the identity, and
    each inequality weighted by what it is there. Of all solutions the best conditioned is taken,
    or the one that errors of the readings move least (for_noise).
    """
    import cvxpy  # large, and needed here only
    if 'CLARABEL' not in cvxpy.installed_solvers():
        raise ImportError('clarabel')

    def right(M: np.ndarray) -> np.ndarray:  # M L'^-1
        return solve_triangular(L, M.T, lower=True).T

    k, step = len(L), error.sample_time
    N = L.T @ right(error.N)
    rising, fed = error.rising.feeding, error.bounded.feeding
    basis = _forms(L.T @ rising.p, right(rising.g))
    if not len(basis):
        return lambda rate, for_noise=False: None
    p, g = L.T @ fed.p, right(fed.g) * fed.radius[:, None]
    corners = len(fed.radius) <= MOST_CORNERS \
        and 2**len(fed.radius) * k * k <= LARGEST_INEQUALITY
    blocks: list[tuple[np.ndarray, np.ndarray]] = []  # X = sum x_i F_i + c sum x_i E_i <= 0
    if corners:
        for A in error.corners():
            blocks.append((_change(L.T @ right(A), basis, step), basis))
        multipliers = 0
    else:
        multipliers = len(fed.radius)
        size = k + multipliers
        F = np.zeros((len(basis) + multipliers, size, size))
        E = np.zeros_like(F)
        F[:len(basis), :k, :k], E[:len(basis), :k, :k] = _change(N, basis, step), basis
        mixed = basis @ p if step is None else N.T @ basis @ p
        F[:len(basis), :k, k:], F[:len(basis), k:, :k] = mixed, np.swapaxes(mixed, 1, 2)
        if step is not None:
            F[:len(basis), k:, k:] = p.T @ basis @ p
        for i in range(multipliers):
            F[len(basis) + i, :k, :k] = np.outer(g[i], g[i])
            F[len(basis) + i, k + i, k + i] = -1.0
        blocks.append((F, E))
    nominal = -(N + N.T) if step is None else np.eye(k) - N.T @ N
    try:
        weight = np.linalg.inv(np.linalg.cholesky(nominal))
    except np.linalg.LinAlgError:
        weight = np.eye(k)
    x = cvxpy.Variable(len(basis) + multipliers)
    condition, shift = cvxpy.Variable(), cvxpy.Parameter()
    S = cvxpy.reshape(basis.reshape(len(basis), -1).T @ x[:len(basis)], (k, k), order='C')
    constraints = []
    for F, E in blocks:
        size = F.shape[1]
        W = np.eye(size)
        W[:k, :k] = weight
        here, shifted = ((W @ M @ W.T).reshape(len(M), -1).T for M in (F, E))
        X = here @ x + cvxpy.multiply(shift, shifted @ x[:shifted.shape[1]])
        constraints.append(cvxpy.reshape(-X, (size, size), order='C') >> 0)
    steady = cvxpy.Problem(cvxpy.Minimize(condition), [
        *constraints, S >> np.eye(k), condition * np.eye(k) >> S])
    # the same with the least |Cv S^-.5| |S^.5 push|, by which errors of the readings are bounded
    push = L.T @ np.hstack([error.J, error.bounded.p * error.bounded.radius, error.N @ rising.p])
    push = push / (np.linalg.norm(push) or 1.0)
    said = right(error.Cv)
    said = said / (np.linalg.norm(said) or 1.0)
    quiet = cvxpy.Problem(
        cvxpy.Minimize(cvxpy.trace((push @ push.T + FAINT * np.eye(k)) @ S)),
        [*constraints, S >> said.T @ said + FAINT * np.eye(k)])

    def solve(rate: float, for_noise: bool = False) -> tuple[
            np.ndarray, np.ndarray | None] | None:
        shift.value = 2.0 * rate if step is None else -np.exp(-2.0 * rate * step)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter('ignore')  # of inaccuracy: what comes is checked
                (quiet if for_noise else steady).solve(solver='CLARABEL')
        except (cvxpy.error.SolverError, ArithmeticError, ValueError):
            return None
        if x.value is None or not np.all(np.isfinite(x.value)):
            return None
        found = np.tensordot(x.value[:len(basis)], basis, axes=1)
        try:
            inner = np.linalg.cholesky(0.5 * (found + found.T))
        except np.linalg.LinAlgError:
            return None
        t = x.value[len(basis):] if multipliers else None
        outer = L @ inner  # a product of lower triangular factors is one
        return outer, None if t is None or np.any(t <= 0) else t
    return solve


def _riccati(error: ErrorSystem, L: np.ndarray) -> Solve:
    """
    Pose the S-procedure with given multipliers: one Riccati equation, for large orders.

    Returns solve(rate) -> (L, t) or None as _inequalities does. The multipliers balance what
    each slope reads and what it moves in the coordinates of the Lyapunov form.
    """
    fed, step, identity = error.bounded.feeding, error.sample_time, np.eye(len(L))
    N = L.T @ solve_triangular(L, error.N.T, lower=True).T
    p = L.T @ fed.p
    g = solve_triangular(L, fed.g.T, lower=True).T * fed.radius[:, None]
    t = np.linalg.norm(p, axis=0) / np.linalg.norm(g, axis=1)
    gain = g.T * t @ g
    gain += 1e-4 * np.linalg.norm(gain) * identity

    def solve(rate: float, for_noise: bool = False) -> tuple[
            np.ndarray, np.ndarray | None] | None:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter('ignore')  # of bad condition: what comes is checked
                if step is None:
                    S = solve_continuous_are(N + rate * identity, p, gain, -np.diag(t))
                else:
                    grown = np.exp(rate * step)
                    S = solve_discrete_are(N * grown, p, gain * grown**2, -np.diag(t))
            return L @ np.linalg.cholesky(0.5 * (S + S.T)), t
        except (np.linalg.LinAlgError, ValueError):
            return None
    return solve


def _change(A: np.ndarray, basis: np.ndarray, sample_time: float | None) -> np.ndarray:
    # what e' S e becomes: its derivative, or its next value
    return A.T @ basis + basis @ A if sample_time is None else A.T @ basis @ A


def _forms(p: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Return a basis (b, k, k) of the symmetric S with S p_j = -t_j g_j' for some t."""
    k, c = p.shape
    basis = []
    for i in range(k):
        for j in range(i, k):
            one = np.zeros((k, k))
            one[i, j] = one[j, i] = 1.0 if i == j else np.sqrt(0.5)
            basis.append(one)
    symmetric = np.array(basis)
    if not c:
        return symmetric
    p, g = p / np.linalg.norm(p, axis=0), g / np.linalg.norm(g, axis=1)[:, None]
    equations = np.zeros((k, c, len(symmetric) + c))
    equations[:, :, :len(symmetric)] = np.moveaxis(symmetric @ p, 0, -1)
    for j in range(c):
        equations[:, j, len(symmetric) + j] = g[j]
    kernel = null_space(equations.reshape(k * c, -1), rcond=1e-11)
    return np.tensordot(kernel[:len(symmetric)].T, symmetric, axes=1)


def _bound(error: ErrorSystem, L: np.ndarray, rate: float) -> float:
    """
    Bound |v - vhat| for readings off by 1 at most, from a checked form V = |L' e|^2.

    |L' e| <= gain * sup |L' push|. A slope without upper bound whose argument reads the readings
    wrongly by at most d = |h|_1 can hold e at a distance along p, but no further than W p: V is
    then replaced by the squared distance of e from the points P w, |w_j| <= W_j, whose gradient
    2 S e_d satisfies (g_j e_d) (g_j e - h_j n) >= 0 if (p_j' S p_j) W_j - sum_l |p_j' S p_l| W_l
    >= t_j d_j, and what is left to push is A P w. Infinite where there are no such W.
    """
    rising, fed = error.rising, error.bounded
    if error.loose.radius.size or not np.all(rising.g.any(axis=1)):
        return np.inf
    columns = L.T @ error.J
    push = 0.0
    if columns.size:
        push = float(min(np.linalg.norm(columns, axis=0).sum(),
                         np.sqrt(columns.shape[1]) * np.linalg.norm(columns, 2)))
    push += float(np.linalg.norm(L.T @ fed.p, axis=0) @ (fed.radius * np.abs(fed.h).sum(axis=1)))
    edges = _held(L, rising)
    if edges is None:
        return np.inf
    push += float(np.linalg.norm(L.T @ error.N @ edges, axis=0).sum())
    push += float(np.linalg.norm(L.T @ fed.p, axis=0)
                  @ (fed.radius * np.abs(fed.g @ edges).sum(axis=1)))
    gain = _contraction(rate, error.sample_time) * push
    return float(max(np.linalg.norm(solve_triangular(L, row, lower=True)) * gain
                     + np.abs(row @ edges).sum() + np.abs(q).sum()
                     for row, q in zip(error.Cv, error.Q)))


def _held(L: np.ndarray, rising: Slopes) -> np.ndarray | None:
    """
    Return the columns W_j p_j (k, c) of _bound, parallel p taken together; None without any W.

    The W are those of the comparison matrix of p' S p, which must be an M-matrix.
    """
    ways: list[np.ndarray] = []
    least: list[float] = []
    for p, g, h in zip(rising.p.T, rising.g, rising.h):
        turned, error = L.T @ p, float(np.abs(h).sum())
        need = float(np.linalg.norm(L @ turned) / np.linalg.norm(g)) * error
        for i, way in enumerate(ways):
            other = L.T @ way
            share = float(other @ turned / (other @ other))
            if np.linalg.norm(turned - share * other) <= EQUALITY * np.linalg.norm(turned):
                least[i] = max(least[i], need / abs(share))
                break
        else:
            ways.append(p)
            least.append(need)
    if not any(least):
        return np.zeros((len(L), 0))
    P = np.array(ways).T
    gram = (L.T @ P).T @ (L.T @ P)
    comparison = 2.0 * np.diag(np.diag(gram)) - np.abs(gram)
    try:
        inverse = np.linalg.inv(comparison)
    except np.linalg.LinAlgError:
        return None
    if np.any(inverse < -ROUNDING * np.abs(inverse).max()):
        return None
    return P * (inverse @ least * (1 + EQUALITY))
