"""
The quietest virtual sensor with a given characteristic polynomial.

With N given, all rows W that satisfy ``W A = N W + j E`` are affine in free gains. To give v,
these gains must satisfy linear equations; the noise is quadratic in them. The quietest virtual
sensor is therefore a least-squares solution. N is modal (S (19) and R (14) in the quotient, all
solutions kept) or, where roots repeat, a Hessenberg matrix.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr, solve_continuous_lyapunov, solve_discrete_lyapunov

from vsensor_ros.designer.noise import NoiseModel
from vsensor_ros.designer.observer import Candidate
from vsensor_ros.designer.order import start_row
from vsensor_ros.designer.quotient import Quotient
from vsensor_ros.designer.subspaces import left_kernel, RANK_TOLERANCE, solve_left

APART = 1e-6  # of A's size: an eigenvalue of A nearer than this is met exactly
REPEATED = 1e-3  # relative: roots nearer than this are taken for repeated
MOST_MODES = 120  # beyond, the filter and closed subspaces have to do
LARGEST = 20_000_000  # numbers in the largest array made here
SPARING = 1.1  # reading fewer sensors may cost so much noise


@dataclass(frozen=True, eq=False)
class GainEquations:
    """
    All solutions of ``W A = N W + j E``, ``v = Cv W + g E`` for one N.

    ``W = W0 + gains W_``, ``j = gains j_``, ``g = gains g_`` under ``gains M = target``.
    """

    N: np.ndarray  # (k, k)
    Cv: np.ndarray  # (1, k)
    W0: np.ndarray  # (k, r)
    W_: np.ndarray  # (u, k, r)
    j_: np.ndarray  # (u, k, c)
    g_: np.ndarray  # (u, c)
    M: np.ndarray  # (u, r)
    target: np.ndarray  # (r,)


@dataclass(frozen=True, eq=False)
class Solutions:
    """All virtual sensors with one N: gains ``best + t Z``, variance ``variance + |t|^2``."""

    known: Quotient
    noise: NoiseModel
    form: GainEquations
    best: np.ndarray  # (u,)
    Z: np.ndarray  # (f, u)
    variance: float

    def candidate(self, gains: np.ndarray) -> Candidate:
        """Return the virtual sensor with these gains (u,), in the coordinates of its problem."""
        form, known = self.form, self.known
        W = form.W0 + np.tensordot(gains, form.W_, 1)
        return Candidate(W @ known.Phi, form.N,
                         np.tensordot(gains, form.j_, 1) @ known.R + W @ known.J, form.Cv,
                         (gains @ form.g_)[None, :] @ known.R + known.q)

    def sparing(self) -> np.ndarray:
        """
        Return gains that read as few sensors as they can at little more noise.

        What is not read can fail, too.
        """
        known, form = self.known, self.form
        reads = np.concatenate([form.W_ @ known.J + form.j_ @ known.R,
                                (form.g_ @ known.R)[:, None, :]], axis=1) * self.noise.reading
        offset = np.vstack([form.W0 @ known.J, known.q]) * self.noise.reading
        now, moves = offset + np.tensordot(self.best, reads, 1), np.tensordot(self.Z, reads, 1)
        limit = (SPARING**2 - 1) * self.variance
        size = np.abs(now).max(axis=0) if now.size else np.zeros(0)
        left_out: list[int] = []
        t = np.zeros(len(self.Z))
        for a in np.argsort(size) if len(self.Z) else ():
            chosen = [*left_out, int(a)]
            system = moves[:, :, chosen].reshape(len(self.Z), -1)
            goal = -now[:, chosen].ravel()
            tried = np.linalg.lstsq(system.T, goal, rcond=RANK_TOLERANCE)[0]
            miss = np.abs(tried @ system - goal).max(initial=0.0)
            if miss <= 1e-10 * np.abs(now).max() and tried @ tried <= limit:
                left_out, t = chosen, tried
        return np.asarray(self.best + t @ self.Z)


def with_spectrum(known: Quotient, noise: NoiseModel, spectrum: np.ndarray) -> Solutions | None:
    """
    Return all virtual sensors of one functional with this spectrum, around the quietest.

    ``spectrum`` (k,) closed under conjugation; where eigenvalues repeat, ``with_polynomial`` is
    to be taken. None when there is no virtual sensor.
    """
    k, c = len(spectrum), len(known.E)
    if k > MOST_MODES:
        return None
    modes = list(_modes(known, spectrum))
    u = sum(len(X) * (1 if value.imag == 0 else 2) for value, X, _ in modes) + c
    if u * max(k, 1) * known.order > LARGEST:
        return None
    N, Cv = np.zeros((k, k)), np.zeros((1, k))
    W_, j_, g_ = np.zeros((u, k, known.order)), np.zeros((u, k, c)), np.zeros((u, c))
    row = gain = 0
    for value, X, G in modes:
        s = len(X)
        Cv[0, row] = 1.0
        for array, part in ((W_, X), (j_, G)):
            array[gain:gain + s, row] = part.real
            if value.imag:  # rows and gains are real part and imaginary part
                array[gain:gain + s, row + 1] = part.imag
                array[gain + s:gain + 2 * s, row] = -part.imag
                array[gain + s:gain + 2 * s, row + 1] = part.real
        if value.imag:
            N[row:row + 2, row:row + 2] = [[value.real, -value.imag], [value.imag, value.real]]
        else:
            N[row, row] = value.real
        row, gain = (row + 1, gain + s) if value.imag == 0 else (row + 2, gain + 2 * s)
    g_[gain:] = np.eye(c)
    M = np.einsum('k,ukr->ur', Cv[0], W_) + g_ @ known.E
    return _least(known, noise, GainEquations(
        N, Cv, np.zeros((k, known.order)), W_, j_, g_, M, known.v[0]))


def repeated(spectrum: np.ndarray, still: float = 0.0) -> bool:
    """
    Tell whether two eigenvalues are so near that the modal form is ill-conditioned.

    ``still``: the eigenvalue of what rests.
    """
    gaps = np.abs(np.subtract.outer(spectrum, spectrum)) + np.diag(np.full(len(spectrum), np.inf))
    return bool(len(spectrum) > 1 and gaps.min() <= REPEATED * np.abs(spectrum - still).max())


def with_polynomial(known: Quotient, noise: NoiseModel, N: np.ndarray) -> Solutions | None:
    """
    Return all virtual sensors whose N (k, k) is a member of a ``Family``, around the quietest.

    The first row of W is v less readings, each further row follows from the one before, and the
    last equation of ``W A = N W + j E`` is the condition on the gains.
    """
    k, c, r = len(N), len(known.E), known.order
    u = (k + 1) * c
    if k > MOST_MODES or u * k * r > LARGEST:
        return None
    start, size = start_row(known)
    W0, W_ = np.zeros((k + 1, r)), np.zeros((u, k + 1, r))
    j_, g_ = np.zeros((u, k, c)), np.zeros((u, c))
    g_[k * c:] = np.eye(c)
    W0[0], W_[:, 0] = start, -g_ @ known.E / size
    for i in range(k):
        j_[i * c:(i + 1) * c, i] = np.eye(c)
        step = N[i, i + 1] if i < k - 1 else 1.0
        W0[i + 1] = (W0[i] @ known.A - N[i, :i + 1] @ W0[:i + 1]) / step
        W_[:, i + 1] = (W_[:, i] @ known.A - np.einsum('i,uir->ur', N[i, :i + 1], W_[:, :i + 1])
                        - j_[:, i] @ known.E) / step
    Cv = np.zeros((1, k))
    Cv[0, 0] = size
    return _least(_less(known, known.v[0] - size * start), noise,
                  GainEquations(N, Cv, W0[:k], W_[:, :k], j_, g_, W_[:, k], -W0[k]))


def _less(known: Quotient, measured: np.ndarray) -> Quotient:
    """Return the quotient with a row (r,) of v, made of rows of E, moved to the readings q."""
    g = solve_left(known.E, measured[None, :])
    return replace(known, v=known.v - g @ known.E, q=known.q + g @ known.R)


def _modes(known: Quotient, spectrum: np.ndarray,
           ) -> Iterator[tuple[complex, np.ndarray, np.ndarray]]:
    """Yield for each real eigenvalue and each pair all rows ``X (A - value) = G E``."""
    A, E = known.A, known.E
    for value in (complex(v) for v in spectrum if v.imag >= 0):
        shifted = A - (value if value.imag else value.real) * np.eye(len(A))
        size = max(known.motion, abs(value - known.still), float(np.finfo(float).tiny))
        try:
            X = np.linalg.solve(shifted.T, E.T).T
            near = (np.abs(known.spectrum - value).min() <= APART * size
                    or np.abs(X).max(initial=0.0) * size * APART > 1.0)
        except np.linalg.LinAlgError:
            near = True
        if not near:
            yield value, X, np.eye(len(E))
        else:  # orthonormal rows [x, -g] with x (A - value) - g E = 0
            rows = left_kernel(np.vstack([shifted / size, E]))
            yield value, rows[:, :len(A)], -rows[:, len(A):] * size


def _least(known: Quotient, noise: NoiseModel, form: GainEquations) -> Solutions | None:
    """Find the gains of least noise under ``gains M = target``, and the directions left free."""
    M, v = form.M, form.target
    if not (np.isfinite(M).all() and np.isfinite(form.W_).all()):
        return None
    gram, linear, constant = _noise_form(known, noise, form)
    if not np.isfinite(gram).all():  # an eigenvalue on the boundary of stability
        return None
    size = 1.0 / np.sqrt(np.diag(gram) + 1e-30 + 1e-12 * np.diag(gram).max(initial=0.0))
    scaled = size[:, None] * M
    # (u, u), (u, r); LAPACK does without an empty matrix
    Q, R = qr(scaled, pivoting=True)[:2] if scaled.size else (np.eye(len(M)), scaled)
    diagonal = np.abs(np.diag(R))
    r = int(np.sum(diagonal > 1e-13 * diagonal.max(initial=0.0)))
    start = np.linalg.lstsq(scaled.T, v, rcond=1e-14)[0]
    start = start + np.linalg.lstsq(scaled.T, v - start @ scaled, rcond=1e-14)[0]
    wanted = max(np.linalg.norm(v), np.linalg.norm(known.v) if form.W0.any() else 0.0)
    if np.linalg.norm(v - start @ scaled) > RANK_TOLERANCE * wanted:
        return None
    best, free = start * size, Q[:, r:].T * size
    if len(free):
        H = free @ gram @ free.T
        values, vectors = np.linalg.eigh(0.5 * (H + H.T))
        values = np.maximum(values, 1e-14 * max(values.max(initial=0.0), 1e-300))
        free = (vectors / np.sqrt(values)).T @ free
        best = best - (free @ (gram @ best + linear)) @ free
        # the projection must not have cost what was solved
        best = best + np.linalg.lstsq(scaled.T, v - best @ M, rcond=1e-14)[0] * size
    with np.errstate(over='ignore', invalid='ignore'):  # of gains beyond use
        variance = float(best @ gram @ best + 2 * linear @ best + constant)
    if not np.isfinite(variance):
        return None
    return Solutions(known, noise, form, best, free, max(variance, 0.0))


def _noise_form(known: Quotient, noise: NoiseModel,
                form: GainEquations) -> tuple[np.ndarray, np.ndarray, float]:
    """Return gram (u, u), linear (u,), constant: variance = g gram g' + 2 linear g + constant."""
    B, D = noise.drives(known)
    k, u = len(form.N), len(form.g_)
    read = (form.g_ @ known.R) * noise.reading
    direct = known.q[0] * noise.reading
    gram, linear, constant = read @ read.T, read @ direct, float(direct @ direct)
    if not k:
        return gram, linear, constant
    observed = form.Cv.T @ form.Cv  # e is weighed by the Gramian of what v shows of it
    try:
        weight = (solve_continuous_lyapunov(form.N.T, -observed)
                  if noise.sample_time is None
                  else solve_discrete_lyapunov(form.N.T, observed))
    except (np.linalg.LinAlgError, ValueError):
        weight = np.full((k, k), np.nan)
    if not np.isfinite(weight).all():
        return np.full((u, u), np.nan), np.zeros(u), np.inf
    weight = 0.5 * (weight + weight.T)
    gain, row = np.nonzero(form.W_.any(axis=2) | form.j_.any(axis=2))
    if len(gain) <= 2 * u and not form.W0.any():  # modal: each gain moves one mode
        driven = form.W_[gain, row] @ B - form.j_[gain, row] @ D
        moved = (driven @ driven.T) * weight[np.ix_(row, row)]
        moving, first = np.unique(gain, return_index=True)
        gram[np.ix_(moving, moving)] += np.add.reduceat(np.add.reduceat(moved, first, 0), first, 1)
        return gram, linear, constant
    values, vectors = np.linalg.eigh(weight)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T  # (k, k)
    driven = np.zeros((u, k, B.shape[1]))
    driven[gain, row] = form.W_[gain, row] @ B - form.j_[gain, row] @ D
    square = (root @ driven).reshape(u, k * B.shape[1])
    offset = (root @ form.W0 @ B).ravel()
    return (gram + square @ square.T, linear + square @ offset,
            constant + float(offset @ offset))

