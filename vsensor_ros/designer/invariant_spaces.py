"""
Spaces that an observer can be built on, for several functionals and for arguments of terms.

A row space U that holds the readings E and what is wanted works when the rows that stay inside U
under A, together with E, span it. Where U does not work, as few rows as possible are added.
Source: method 3.6 and 3.7.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_are, solve_discrete_are
from scipy.optimize import minimize

from vsensor_ros.designer.noise import Filter, NoiseModel, riccati, riccati_in_steps
from vsensor_ros.designer.observer import Candidate
from vsensor_ros.designer.quotient import Quotient
from vsensor_ros.designer.subspaces import (
    complement,
    image,
    left_kernel,
    RANK_TOLERANCE,
    solve_left,
    unobservable,
)

WEIGHTS = (1e4, 1e2, 1.0, 1e-2)  # of the readings' noise, against what drives z
FASTER = (4.0, 2.0, 1.0)  # times the wanted decay rate
SMALL = 40  # states, up to which all weights and rates are tried
POLISHED = 30  # so many free gains are polished by descent


@dataclass(frozen=True, eq=False)
class InvariantSpace:
    """``W A = N W + j E`` and ``T E A = Nc W + jc E``; ``W + M T E`` serves, too."""

    W: np.ndarray  # (k, r)
    N: np.ndarray  # (k, k)
    j: np.ndarray  # (k, c)
    T: np.ndarray  # (t, c)
    Nc: np.ndarray  # (t, k)
    jc: np.ndarray  # (t, c)


def spaces(known: Quotient, outputs: np.ndarray) -> Iterator[InvariantSpace]:
    """
    Yield observers that know the rows ``outputs`` (s, r), of growing order.

    The first has the order of method 3.7's lower bound whenever that is attained.
    """
    E = image(known.E.T, size=1.0).T
    U = image(np.vstack([E, outputs]).T).T
    size = max(known.speed, np.finfo(float).tiny)
    while True:
        while True:
            A = known.A / size
            rest = left_kernel(E @ U.T, size=1.0) if len(E) else None
            B = U if rest is None else image((U - (U @ E.T) @ E).T, size=1.0).T
            away = B @ A - (B @ A) @ U.T @ U  # what of B A leaves U
            spare = E @ A - (E @ A) @ U.T @ U
            M = -solve_left(spare, away, size=1.0)
            left = image((away + M @ spare).T, size=1.0).T
            if not len(left):
                break
            U = image(np.vstack([U, left]).T).T
        W = B + M @ E
        T = left_kernel(spare, size=1.0)
        both = np.vstack([W, E])
        Nj = solve_left(both, W @ known.A)
        Nc = solve_left(both, T @ E @ known.A)
        k = len(W)
        # E above is orthonormal; back to the rows of the quotient
        back = solve_left(known.E, E)
        yield InvariantSpace(W, Nj[:, :k], Nj[:, k:] @ back, T @ back, Nc[:, :k], Nc[:, k:] @ back)
        if len(U) == known.order:
            return
        grown = image(np.vstack([U, U @ known.A / size]).T).T
        if len(grown) == len(U):
            return
        U = grown


def whole(known: Quotient) -> InvariantSpace:
    """Return the observer of all that is known but not read: order r less the rank of E."""
    E = image(known.E.T, size=1.0).T
    W = complement(E.T)
    back = solve_left(known.E, E)
    A = np.vstack([W, E]) @ known.A @ np.vstack([W, E]).T  # an orthonormal basis
    k = len(W)
    return InvariantSpace(W, A[:k, :k], A[:k, k:] @ back, back, A[k:, :k], A[k:, k:] @ back)


def candidates(known: Quotient, noise: NoiseModel, space: InvariantSpace,
               decay: float, polish: bool = True) -> Iterator[Candidate]:
    """
    Yield virtual sensors on an invariant space: without the free gain M, and with good ones.

    ``polish``: descend to the quietest gain at last, if there are few.
    """
    k, t = len(space.W), len(space.T)
    size = (k, t)
    outputs = solve_left(np.vstack([space.W, known.E]), known.v)

    def member(M: np.ndarray) -> Candidate:
        W, N, j, Cv, g = _with_gain(space, outputs, M)
        return Candidate(W @ known.Phi + M @ space.T @ known.E @ known.Phi, N,
                         j @ known.R + (W + M @ space.T @ known.E) @ known.J, Cv,
                         g @ known.R + known.q)

    yield member(np.zeros(size))
    if not (k and t):
        return
    B, D = noise.drives(known)
    W0B = space.W @ B - space.j @ D
    found = []
    for M in _riccati(space, W0B @ W0B.T, noise.sample_time, decay):
        if not np.isfinite(M).all():  # the solver does not say so itself
            continue
        found.append(M)
        yield member(M)
    if not found or not polish or k * t > POLISHED:
        return

    def cost(flat: np.ndarray) -> float:
        M = flat.reshape(size)
        W, N, j, Cv, g = _with_gain(space, outputs, M)
        values = np.linalg.eigvals(N)
        speed = (-values.real.max() if noise.sample_time is None
                 else -np.log(max(np.abs(values).max(), 1e-12)) / noise.sample_time)
        if speed <= 0.99 * decay or speed <= 0:
            return 1e300
        W = W + M @ space.T @ known.E
        return noise.variance(N, W @ B - j @ D, Cv, g @ known.R + known.q)

    starts = sorted(found, key=lambda M: cost(M.ravel()))
    if cost(starts[0].ravel()) < 1e300:
        best = minimize(cost, starts[0].ravel(), method='Nelder-Mead',
                        options={'maxiter': 80 * k * t, 'xatol': 1e-4, 'fatol': 1e-12})
        yield member(best.x.reshape(size))


def plain_candidate(known: Quotient, space: InvariantSpace) -> Candidate:
    """Return the observer on an invariant space without the free gain, stable or not."""
    outputs = solve_left(np.vstack([space.W, known.E]), known.v)
    k = len(space.W)
    return Candidate(space.W @ known.Phi, space.N, space.j @ known.R + space.W @ known.J,
                     outputs[:, :k], outputs[:, k:] @ known.R + known.q)


def _with_gain(space: InvariantSpace, outputs: np.ndarray, M: np.ndarray,
               ) -> tuple[np.ndarray, ...]:
    """Return W (without M T E), N, j, Cv and g of the observer of ``(W + M T E) xi``."""
    k = len(space.W)
    N = space.N + M @ space.Nc
    return (space.W, N, space.j + M @ space.jc - N @ M @ space.T, outputs[:, :k],
            outputs[:, k:] - outputs[:, :k] @ M @ space.T)


def _riccati(space: InvariantSpace, drive: np.ndarray, sample_time: float | None,
             decay: float) -> Iterator[np.ndarray]:
    """Yield gains M for N + M Nc that decay as wanted if they can, the quietest first."""
    k, t = len(space.W), len(space.T)
    scale = max(float(np.trace(drive)) / k, float(np.finfo(float).tiny))
    drive = drive + 1e-6 * scale * np.eye(k)
    moved = space.N if sample_time is None else space.N - np.eye(k)
    gain = float(np.linalg.norm(space.Nc)) / max(float(np.linalg.norm(moved, 2)), 1e-150)
    typical = scale * max(gain**2 / t, 1e-300)
    for weight in WEIGHTS if k <= SMALL else WEIGHTS[1:2]:
        meter = weight * typical * np.eye(t)
        for shift in (*(decay * faster for faster in FASTER), 0.0) if k <= SMALL else (decay, 0.0):
            try:
                if sample_time is None:
                    N = space.N + shift * np.eye(k)
                    X = (solve_continuous_are(N.T, space.Nc.T, drive, meter) if k <= SMALL else
                         riccati(N, space.Nc, drive, meter, np.zeros((k, t))))
                    yield -np.linalg.solve(meter, space.Nc @ X).T
                else:
                    grow = np.exp(shift * sample_time)
                    N, Nc = grow * space.N, grow * space.Nc
                    X = (solve_discrete_are(N.T, Nc.T, drive, meter) if k <= SMALL else
                         riccati_in_steps(N, Nc, drive, meter, np.zeros((k, t))))
                    yield -np.linalg.solve(Nc @ X @ Nc.T + meter, Nc @ X @ N.T).T
            except (np.linalg.LinAlgError, ValueError):  # a mode on the boundary: try slower
                continue


def filter_candidate(known: Quotient, found: Filter, outputs: np.ndarray) -> Candidate:
    """
    Return a Kalman filter as a virtual sensor, less what it does not need.

    ``outputs`` (s, r): rows that it must know besides v.
    """
    N = known.A - found.L @ known.E
    hidden = unobservable(N, np.vstack([found.Cv, outputs]))
    W = left_kernel(hidden) if hidden.shape[1] else np.eye(len(N))
    return Candidate(W @ known.Phi, W @ N @ W.T, W @ (found.L @ known.R + known.J),
                     found.Cv @ W.T, found.g @ known.R + known.q)


def lower_bound(known: Quotient, outputs: np.ndarray) -> int:
    """Return ``rank [E; outputs] - rank E``: no observer of them is smaller (method 3.7)."""
    E = image(known.E.T, size=1.0).T
    rest = outputs - (outputs @ E.T) @ E
    size = np.maximum(np.linalg.norm(outputs, axis=1), np.finfo(float).tiny)
    sigma = np.linalg.svd(rest / size[:, None], compute_uv=False) if outputs.size else np.zeros(0)
    return int(np.sum(sigma > RANK_TOLERANCE))
