"""
Estimate states, actuator faults and sensor faults of a Takagi-Sugeno plant at once.

After Pazera, Witczak, Kukurowski and Buciakowski, Sensors 2020, 20(12), 3486. The plant is
x+ = sum h_i (A_i x + B_i u) + Bf fa + W1 w1, y = C x + Cf fs + W2 w2. Its descriptor state
xb = (x, fa of a step before, fs) needs no model of how faults change. With T1 E + T2 Cb = I the
error is e+ = (T G_i - K_i R) (e, w) where T = [T1, T2], w = (w1, w2, next w2) and w'w <= 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, null_space

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.quadratic_bound import Found, Inequalities, inflated
from vsensor_ros.plant import TakagiSugeno

ALPHAS = tuple(np.geomspace(0.002, 0.1, 12).tolist())  # that are tried
_RANK = 1e-9
_STEPS = 20000  # of the Riccati recursion
_STILL = 1e-10
_TOO_LARGE = 1e12
_HIDDEN = 1e-8


@dataclass(frozen=True, eq=False)
class FaultEstimator:
    """
    z+ = sum h_i (N_i z + M_i u + L_i y),  (x, fa a step before, fs) = z + T2 y.

    An error within e' P e <= 1 stays there; `half_widths` are the intervals of each variable.
    """

    variables: tuple[str, ...]  # N of them
    N: np.ndarray  # (V, N, N)
    M: np.ndarray  # (V, N, m)
    L: np.ndarray  # (V, N, l)
    T1: np.ndarray  # (N, n)
    T2: np.ndarray  # (N, l)
    K: np.ndarray  # (V, N, l)
    P: np.ndarray  # (N, N)
    alpha: float  # by which the excess of e' P e over 1 falls each step
    norm: float  # of the error's map, found afterwards; 1 or less is the proof
    contraction: float  # largest spectral radius of the N_i

    @property
    def half_widths(self) -> np.ndarray:
        """Half-widths (N,) once the start is forgotten."""
        return np.sqrt(np.diag(np.linalg.inv(self.P)))

    def widening(self, k: np.ndarray, start: float) -> np.ndarray:
        """Return by how much intervals are wider k steps after e' P e was at most `start`."""
        return np.sqrt(1.0 + (1.0 - self.alpha)**k * max(start - 1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Descriptor:
    """The plant with faults as states: E xb+ = Ab_i xb + B_i u + W1 w1, y = Cb xb + W2 w2."""

    plant: TakagiSugeno
    E: np.ndarray  # (n, N)
    Cb: np.ndarray  # (l, N)
    G: np.ndarray  # (V, n + l, N + w): what T maps into the next error
    R: np.ndarray  # (l, N + w): what the reading sees of error and w
    actuators: int  # number of actuator faults
    variables: tuple[str, ...]

    @property
    def size(self) -> int:
        """Return N, the number of variables."""
        return self.E.shape[1]

    @property
    def goal(self) -> np.ndarray:
        """Return the indices of what is to be narrow: sensor faults; without any, all."""
        known = len(self.plant.states) + self.actuators
        return np.arange(known if known < self.size else 0, self.size)


def descriptor(plant: TakagiSugeno, actuators: np.ndarray, sensors: list[str], *,
               W1: np.ndarray, W2: np.ndarray) -> Descriptor:
    """
    Make the descriptor form of a plant in discrete time.

    actuators: Bf (n, a), through which actuator faults act; sensors: names of those that may be
    faulty; W1 (n, w1), W2 (l, w2): (w1, w2, next w2) has length 1 at most. Raises BadInput.
    """
    where = 'descriptor'
    if plant.sample_time is None or plant.E.size or plant.a.any():
        raise BadInput(where, 'plant', 'has continuous time, unknown inputs or offsets',
                       'give submodels A and B in discrete time')
    for name in sensors:
        if name not in plant.sensors:
            raise BadInput(where, 'sensors', f'{name!r} is no sensor',
                           'name one of ' + ', '.join(plant.sensors))
    n, r = plant.A.shape[1], len(plant.C)
    a, s = actuators.shape[1], len(sensors)
    Cf = np.eye(r)[:, [plant.sensors.index(name) for name in sensors]]
    E = np.hstack([np.eye(n), -actuators, np.zeros((n, s))])
    Cb = np.hstack([plant.C, np.zeros((r, a)), Cf])
    values = np.linalg.svd(np.vstack([E, Cb]), compute_uv=False)
    if len(values) < n + a + s or values[-1] < _RANK * values[0]:
        raise BadInput(where, 'sensors', f'{a} actuator faults and {s} sensor faults cannot be '
                       f'told apart with {r} sensors', 'give more sensors, or fewer faults')
    w1, w2 = W1.shape[1], W2.shape[1]
    G = np.array([block_diag(np.hstack([A, np.zeros((n, a + s)), W1, np.zeros((n, w2))]), -W2)
                  for A in plant.A])
    R = np.hstack([Cb, np.zeros((r, w1)), W2, np.zeros((r, w2))])
    names = (*plant.states, *(f'fa {i + 1}' for i in range(a)), *(f'fs {x}' for x in sensors))
    return Descriptor(plant, E, Cb, G, R, a, names)


def least_T(form: Descriptor) -> np.ndarray:
    """Return the smallest [T1, T2] (N, n + l) with T1 E + T2 Cb = I. It depends on the units."""
    return np.linalg.pinv(np.vstack([form.E, form.Cb]))


def quietest(form: Descriptor, alpha: float = 0.0, T: np.ndarray | None = None) \
        -> tuple[np.ndarray, np.ndarray] | None:
    """
    Return [T1, T2] and the error's covariance by a Kalman filter on the mean submodel.

    T stays as it is where it is given. Otherwise what is free in it is a gain on readings, too:
    the next reading corrects through T, this one through K. With alpha > 0 the covariance is the
    least inverse of a form P that one submodel has: no P of all submodels does better. None where
    the filter diverges.
    """
    start = least_T(form) if T is None else T
    free = _free(form) if T is None else np.zeros((0, start.shape[1]))
    G, N = form.G.mean(axis=0), form.size
    seen = np.vstack([form.R, free @ G])
    ahead = start @ G
    S = np.eye(N)
    for _ in range(_STEPS):
        D = inflated(S, G.shape[1] - N, alpha)
        gain = np.linalg.lstsq(seen @ D @ seen.T, seen @ D @ ahead.T, rcond=1e-14)[0].T
        rest = ahead - gain @ seen
        new = rest @ D @ rest.T
        size = np.sqrt(np.diag(new))
        moved = abs((new - S) / np.outer(size, size)).max()
        S = (new + new.T) / 2.0
        if moved < _STILL:
            return start - gain[:, len(form.R):] @ free, S
        if not S.max() < _TOO_LARGE:
            break
    return None


def estimator(form: Descriptor, alphas: Sequence[float] = ALPHAS, *,
              fixed_gains: bool = False) -> FaultEstimator:
    """
    Return the estimator with the least intervals of the sensor faults, over these alphas.

    T is optimised with the gains and P at each alpha. fixed_gains: the easier way, T and gains of
    the Kalman filter on the mean submodel, for which P is sought afterwards: less noise, wider
    intervals. Raises BadInput, with what to relax, and ImportError, with what to install.
    """
    if (calm := quietest(form)) is None:
        raise _hidden(form, 0.0)
    unit = np.sqrt(np.diag(calm[1]))[form.goal]
    kept = {alpha: one for alpha in alphas if (one := quietest(form, alpha)) is not None}
    if not kept:
        raise _hidden(form, min(alphas))

    def cost(S: np.ndarray) -> float:
        return float(sum(np.diag(S)[form.goal] / unit**2))

    lmi = Inequalities(form.G, form.R, form.goal)
    gains = lmi.gains(calm[0], np.linalg.inv(calm[1]), 0.0) if fixed_gains else None
    best: tuple[float, Found] | None = None
    for alpha in sorted(kept, key=lambda a: cost(kept[a][1])):
        T, S = kept[alpha]
        if best is not None and cost(S) >= cost(np.linalg.inv(best[1].P)):
            break  # no form of all submodels is better than that of one
        found = lmi.solve(alpha, T, S, _free(form)) if gains is None \
            else lmi.solve(alpha, calm[0], S, K=gains)
        if found is not None and (best is None or cost(np.linalg.inv(found.P)) < cost(
                np.linalg.inv(best[1].P))):
            best = alpha, found
    if best is None:
        raise BadInput('fault estimator', 'submodels', 'have no common form P at alpha '
                       + ', '.join(f'{alpha:.3g}' for alpha in sorted(kept)),
                       'give narrower ranges of the premises, smaller alphas, more sensors, or '
                       'fewer faults')
    return _made(form, *best)


def _made(form: Descriptor, alpha: float, found: Found) -> FaultEstimator:
    n = form.plant.A.shape[1]
    T1, T2 = found.T[:, :n], found.T[:, n:]
    N = (found.T @ form.G - found.K @ form.R)[:, :, :form.size]
    return FaultEstimator(form.variables, N, T1 @ form.plant.B, found.K + N @ T2, T1, T2, found.K,
                          found.P, alpha, found.norm,
                          float(abs(np.linalg.eigvals(N)).max()))


def _free(form: Descriptor) -> np.ndarray:
    """Return the directions (q, n + l) in which T may move."""
    return null_space(np.vstack([form.E, form.Cb]).T).T


def _hidden(form: Descriptor, alpha: float) -> BadInput:
    """Return the refusal, with the mode that no gain can move, where there is one."""
    G = form.G.mean(axis=0)[:, :form.size]
    A = least_T(form) @ G
    seen = np.vstack([form.R[:, :form.size], _free(form) @ G])
    size = np.linalg.norm(np.vstack([A, seen]), axis=0)  # units of the variables
    size[size == 0.0] = 1.0
    for mode in sorted(np.linalg.eigvals(A), key=abs, reverse=True):
        _, values, rows = np.linalg.svd(np.vstack([A - mode * np.eye(len(A)), seen]) / size)
        if abs(mode)**2 >= 1.0 - alpha - _RANK and values[-1] < _HIDDEN:
            name = form.variables[int(abs(rows[-1] / size).argmax())]
            slower = '' if abs(mode) > 1.0 - _RANK \
                else f', an alpha below {1.0 - abs(mode)**2:.3g}'
            return BadInput('fault estimator', 'sensors', f'a mode {abs(mode):.4g} per step of '
                            f'{name!r} is hidden from them by the faults',
                            f'give a sensor of {name!r}{slower}, or fewer faults')
    return BadInput('fault estimator', 'sensors', 'leave an error that does not stay bounded at '
                    f'alpha {alpha:.3g}', 'give more sensors, smaller alphas, or fewer faults')
