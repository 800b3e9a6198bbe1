"""
Search for the quadratic form of an error system that falls fastest for all slopes of its terms.

A Lyapunov equation for a linear error; matrix inequalities, or for large orders one Riccati
equation, for slopes within bounds (the method, 3.5). Every form that is found is checked in
``quadratic_form.py`` before it counts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import warnings

import numpy as np
from scipy.linalg import (
    matrix_balance,
    null_space,
    solve_continuous_are,
    solve_continuous_lyapunov,
    solve_discrete_are,
    solve_discrete_lyapunov,
    solve_triangular,
)

from vsensor_ros.designer.error_system import decay_rate, ErrorSystem, no_slopes
from vsensor_ros.designer.peak_to_peak import peak_bound
from vsensor_ros.designer.quadratic_form import bound_on, falling_rate, Form
from vsensor_ros.designer.semidefinite import answered, solver

LARGEST_ORDER = 14  # for matrix inequalities: their cost grows with the sixth power
LARGEST_INEQUALITY = 2500  # entries of all corners together in the search; beyond, the same
LARGEST_SPREAD = 1e12  # of the axes of V: a nearly defective N would have them ever longer
FAINT = 1e-4  # weight of what no error of a reading reaches, so that S stays regular
SMALL = 12  # states and slopes together: up to here
ACCURACY = 3e-4  # relative, of the largest rate, where that is cheap
COARSE, ROUGH = 0.03, 0.2  # the same where an inequality, or a Riccati equation, takes long
Solve = Callable[..., 'tuple[np.ndarray, np.ndarray | None] | None']


def lyapunov(error: ErrorSystem) -> tuple[np.ndarray, float] | None:
    """
    Return L of a form V = |L' e|^2 and the rate it proves for N, all slopes at their centre.

    The rate asked for starts just below the spectrum's and is given up step by step until the
    form that the Lyapunov equation gives stands the check; None when none does.
    """
    N, step = error.N, error.sample_time
    bare = replace(error, bounded=no_slopes(error), rising=no_slopes(error), joint=None)
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
            proved = falling_rate(bare, L)
            if proved > best_rate and np.diag(L).max() <= LARGEST_SPREAD * np.diag(L).min():
                best, best_rate = L, proved
        if best_rate >= 0.9 * decay:
            break
    return None if best is None else (best, best_rate)


def search(error: ErrorSystem, wanted: float = 0.0) -> Form | None:
    """
    Find the quadratic form of the largest rate; None when none (above the wanted rate) is found.

    Raises ImportError when it would need cvxpy or clarabel and they are missing.
    """
    highest = ceiling(error)
    if not highest > wanted:
        return None
    fed, rising, k = error.bounded.feeding, error.rising.feeding, len(error.N)
    nominal = lyapunov(error)
    if nominal is None:
        return None
    L = nominal[0]
    forms: list[Form] = []

    def weigh(L: np.ndarray, t: np.ndarray | None = None) -> float:
        rate = falling_rate(error, L, t)
        if rate > 0.0:
            forms.append(Form(L, rate, bound_on(error, L, rate)))
        return rate

    least = weigh(L)
    if k > LARGEST_ORDER:
        if not rising.radius.size:
            _climb(_riccati(error, L), highest, max(least, 0.0), wanted, weigh, ROUGH)
    elif k > 1 and (least < (1 - ACCURACY) * highest or rising.h.any()):
        try:
            solve = _inequalities(error, L)
        except ImportError:
            if not forms:
                raise
        else:
            _climb(solve, highest, max(least, 0.0), wanted, weigh,
                   ROUGH if error.joint is not None else
                   ACCURACY if k + len(fed.radius) <= SMALL else COARSE)
    best = max(forms, key=lambda form: form.rate, default=None)
    if best is None or best.rate < wanted:
        return None
    return replace(best, bound=min(peak_bound(error, *nominal), *(f.bound for f in forms)))


def ceiling(error: ErrorSystem) -> float:
    """Return the rate that no form can exceed, by eigenvalues alone; -inf: there is no form."""
    rising = error.rising.feeding
    if error.loose.feeding.radius.size or (rising.radius.size and error.sample_time is not None):
        return -np.inf
    if np.any(np.sum(rising.p.T * rising.g, axis=1) >= 0):
        return -np.inf  # S p = -t g' with t > 0 needs g p = -p' S p / t
    least = decay_rate(error.N, error.sample_time)
    if error.cornered:
        least = min(least, *(decay_rate(A, error.sample_time) for A in error.corners()))
    return least


def _climb(solve: Solve, ceiling: float, low: float, wanted: float,
           weigh: Callable[..., float], accuracy: float) -> None:
    """Bisect for the largest rate up to the ceiling; every form met on the way is weighed."""
    def proved(rate: float, for_noise: bool = False) -> float:
        answer = solve(rate, for_noise)
        return -np.inf if answer is None else weigh(*answer)

    if low < max(wanted, 1e-3 * ceiling):
        low = proved(max((1 + 0.6 * accuracy) * wanted, 1e-3 * ceiling))
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
    cvxpy = solver()

    def right(M: np.ndarray) -> np.ndarray:  # M L'^-1
        return solve_triangular(L, M.T, lower=True).T

    k, step = len(L), error.sample_time
    N = L.T @ right(error.N)
    rising, fed = error.rising.feeding, error.bounded.feeding
    basis = _forms(L.T @ rising.p, right(rising.g))
    if not len(basis):
        return lambda rate, for_noise=False: None
    p, g = L.T @ fed.p, right(fed.g) * fed.radius[:, None]
    corners = error.joint is not None or (
        error.cornered and 2**len(fed.radius) * k * k <= LARGEST_INEQUALITY)
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
        if not answered(quiet if for_noise else steady, x):
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
