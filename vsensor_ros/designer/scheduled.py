"""
Scheduled virtual sensors of Takagi-Sugeno plants, with one proof over the declared range.

z' = sum_i h_i(p) (N_i z + J_i y0 + B_i u + a_i), vhat = Cv z + Q y0. The functional z = Phi x is
constant: a scheduled one would bring in how fast the premises change, and with it the unknown
input. What is injected is scheduled. The premises are read by healthy sensors; what their noise
adds, e' = .. + Phi (f(x, u, p) - f(x, u, read p)), is one more bounded input.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import itertools

import numpy as np
from scipy.linalg import null_space, orth

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.designer.scheduled_proof import Blend, nearest_undetectable, prove, UNSEEN
from vsensor_ros.plant import TakagiSugeno
from vsensor_ros.reason import Reason

ROUNDING = 1e-9  # relative, of ranks, and to which the equalities must hold
SPREAD = 3.0  # standard deviations of a reading that are within bounds
_POINTS = 200  # premises at which pairs are looked at
_STRAYED = 4000  # points at which premises that are read wrong are looked at, beside corners
_MOST_CORNERS = 4096
ASIDE = 0.1  # of a range: how far a narrower one keeps off where there is no answer


@dataclass(frozen=True, eq=False)
class ScheduledObserver:
    """
    A virtual sensor with scheduled injection, of which a form says how far off it may be.

    k states, V submodels, r healthy sensors. Once |e| is within the form, and from then on:
    |v - vhat| <= half_width, for unknown inputs and noise within the bounds that were stated.
    """

    channel: str
    fault_set: tuple[str, ...]
    reads: tuple[str, ...]  # healthy sensors, r
    plant: TakagiSugeno
    Phi: np.ndarray  # (k, n)
    N: np.ndarray  # (V, k, k)
    J: np.ndarray  # (V, k, r)
    B: np.ndarray  # (V, k, m)
    a: np.ndarray  # (V, k)
    Cv: np.ndarray  # (1, k)
    Q: np.ndarray  # (1, r)
    S: np.ndarray  # (k, k): e' S e <= 1 is never left
    rate: float  # 1/s
    half_width: float  # [unit of the channel]
    margin: float  # left in the inequalities, of the rate
    decoupled: bool  # no unknown input reaches the error
    ranges: np.ndarray  # (p, 2) of the premises over which it is proved

    def rate_of_change(self, z: np.ndarray, y0: np.ndarray, u: np.ndarray,
                       premises: np.ndarray) -> np.ndarray:
        """Return dz (k, N), or the next z, at z (k, N), y0 (r, N), u (m, N), premises (p, N)."""
        h = self.plant.weights(premises)
        each = self.N @ z + self.J @ y0 + self.B @ u + self.a[:, :, None]
        return np.einsum('vk,vnk->nk', h, each)

    def estimate(self, z: np.ndarray, y0: np.ndarray) -> np.ndarray:
        """Return vhat (N,)."""
        return (self.Cv @ z + self.Q @ y0)[0]


def scheduled(plant: TakagiSugeno, fault_set: Sequence[str], channel: str, *, rate: float,
              noise: np.ndarray, unknown: np.ndarray,
              box: np.ndarray | None = None) -> ScheduledObserver | Reason:
    """
    Return a scheduled virtual sensor for a channel lost with others, or why there is none.

    rate [1/s]: at which an error must die out; noise (l,): standard deviations of the readings,
    bounded by three of them; unknown (d,): bounds of the unknown inputs, infinite where none is
    known. They are decoupled where that can be, else bounded. box (n + m, 2): in which states and
    inputs are, so that the noise of what reads the premises counts; None: it does not. Raises
    BadInput, or ImportError where the desk's solver is missing.
    """
    for name in (*fault_set, channel):
        if name not in plant.sensors:
            raise BadInput(plant.name, 'sensors', f'unknown sensor {shown(name)}',
                           'name one of ' + ', '.join(plant.sensors))
    if channel not in fault_set or not rate > 0.0:
        raise BadInput(plant.name, 'rate' if channel in fault_set else 'fault_set',
                       'must be positive' if channel in fault_set else f'is without {channel}',
                       'give a rate above 0 and a channel of the fault set')
    healthy = [i for i, name in enumerate(plant.sensors) if name not in fault_set]
    C0, V = plant.C[healthy], plant.C[[plant.sensors.index(channel)]]
    if (unread := _unread(plant, C0)):
        return Reason.of('premise not read', names=unread)
    Phi = _functional(plant, C0, V, True)
    decoupled = Phi is not None
    if Phi is None:
        Phi = _functional(plant, C0, V, False)
        if Phi is None:
            return Reason.of('not of the states', channel=channel)
        if not np.isfinite(unknown).all():
            return Reason.of('unknown inputs without bounds', names=tuple(
                name for name, size in zip(plant.disturbances, unknown) if not np.isfinite(size)))
    k, r = len(Phi), len(healthy)
    basis = np.vstack([Phi, C0])
    N, J = _shared(Phi @ plant.A, basis, k)
    Cv, Q = _shared(V[None], basis, k)
    left = null_space(basis.T, rcond=ROUNDING).T  # left @ [Phi; C0] = 0
    R, Ry = -left[:, :k], left[:, k:]  # Ry C0 = R Phi
    read = SPREAD * np.asarray(noise, dtype=float)[healthy]
    size = np.zeros(0) if decoupled else np.asarray(unknown, dtype=float)
    stray = np.zeros(k) if box is None else _strayed(
        plant, Phi, abs(premises_from(plant, C0)[0]) @ read, box)
    if not np.isfinite(stray).all():
        return Reason.of('states without ranges', channel=channel)
    strays = np.diag(stray)[:, stray > 0.0]
    # the box of all bounds lies within this times its ellipsoid
    whole = np.sqrt(len(size) + r + strays.shape[1])
    load = (Phi @ plant.E) * size if len(size) else np.zeros((len(N), k, 0))
    G = whole * np.concatenate(
        [load, -J * read, np.broadcast_to(strays, (len(N), *strays.shape))], axis=2)
    H = whole * np.hstack([np.zeros((len(R), len(size))), -Ry * read,
                           np.zeros((len(R), strays.shape[1]))])
    blend = Blend(N, R, G, H, Cv[0], plant.sample_time)
    at, near = nearest_undetectable(blend, plant.weights, plant.points(_POINTS), plant.ranges,
                                    rate)
    if near < UNSEEN:
        return Reason.of('not seen in the range', at=plant.told(at), rate=rate,
                         point=tuple(at.tolist()))
    proof = prove(blend, rate)
    if proof is None:
        return Reason.of('no form over the range', at=plant.told(at), rate=rate,
                         point=tuple(at.tolist()))
    return ScheduledObserver(
        channel, tuple(fault_set), tuple(plant.sensors[i] for i in healthy), plant, Phi,
        N - proof.K @ R, J + proof.K @ Ry, Phi @ plant.B, plant.a @ Phi.T, Cv[0], Q[0], proof.S,
        proof.rate, proof.half_width + float(abs(Q[0, 0]) @ read), proof.left, decoupled,
        plant.ranges)


def where_it_holds(make: Callable[[dict[str, tuple[float, float]]], TakagiSugeno],
                   refused: Reason, fault_set: Sequence[str], channel: str, *, rate: float,
                   noise: np.ndarray, unknown: np.ndarray) -> list[ScheduledObserver]:
    """
    Return virtual sensors on narrower ranges than one that was refused, the widest first.

    Each keeps off the point that was named, on one side in one premise. make: returns the plant
    over ranges by name of a premise.
    """
    if refused.code not in ('not seen in the range', 'no form over the range'):
        return []
    whole, point = make({}), refused.fact('point')
    found = []
    for i, name in enumerate(whole.premises):
        (low, high), at = whole.ranges[i], point[i]
        aside = ASIDE * (high - low)
        for ends in ((at + aside, high), (low, at - aside)):
            if ends[1] - ends[0] > aside:
                answer = scheduled(make({name: (float(ends[0]), float(ends[1]))}), fault_set,
                                   channel, rate=rate, noise=noise, unknown=unknown)
                if isinstance(answer, ScheduledObserver):
                    found.append(((ends[1] - ends[0]) / (high - low), answer))
    return [answer for _, answer in sorted(found, key=lambda one: -one[0])]


def premises_from(plant: TakagiSugeno, C0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what makes premises of healthy readings (p, r), and of inputs (p, m)."""
    of_states = np.linalg.pinv(C0, rcond=ROUNDING)  # x, where the readings tell it
    readings = np.zeros((len(plant.premises), len(C0)))
    inputs = np.zeros((len(plant.premises), len(plant.inputs)))
    for i, name in enumerate(plant.premises):
        if name in plant.states:
            readings[i] = of_states[plant.states.index(name)]
        else:
            inputs[i, plant.inputs.index(name)] = 1.0
    return readings, inputs


def _strayed(plant: TakagiSugeno, Phi: np.ndarray, off: np.ndarray,
             box: np.ndarray) -> np.ndarray:
    """
    Return how far (k,) premises that are read wrong by off (p,) lead Phi x astray, at most.

    At the corners of the box, where they are not too many, and at random points: between corners
    nothing is larger where submodels are blended linearly in each premise. Infinite where it
    depends on what has no range.
    """
    n, m = len(plant.states), len(plant.inputs)
    feels = abs(Phi @ (plant.A - plant.A[0])).max(axis=(0, 1)), \
        abs(Phi @ (plant.B - plant.B[0])).max(axis=(0, 1))
    moves = (np.concatenate(feels) > ROUNDING) | np.isin(
        (*plant.states, *plant.inputs), plant.premises)
    if not off.any() or not moves.any():
        return np.zeros(len(Phi))
    for i, name in enumerate((*plant.states, *plant.inputs)):
        if name in plant.premises:
            box = np.where(np.arange(n + m)[:, None] == i,
                           plant.ranges[plant.premises.index(name)], box)
    if not np.isfinite(box[moves]).all():
        return np.full(len(Phi), np.inf)
    low, high = np.where(moves[:, None], box, 0.0).T
    random = np.random.default_rng(0)
    share = random.random((n + m, _STRAYED))
    sides = np.sign(random.random((len(off), _STRAYED)) - 0.5)
    which = np.flatnonzero(np.r_[moves, off > 0.0])
    if 2**len(which) <= _MOST_CORNERS:
        corners = np.zeros((n + m + len(off), 2**len(which)))
        corners[which] = np.array(list(itertools.product((0.0, 1.0), repeat=len(which)))).T
        share = np.hstack([share, corners[:n + m]])
        sides = np.hstack([sides, 2.0 * corners[n + m:] - 1.0])
    x, u = np.split(low[:, None] + (high - low)[:, None] * share, [n])
    at = plant.premises_of(x, u)
    read = np.clip(at + off[:, None] * sides, *plant.ranges.T[:, :, None])
    each = Phi @ (plant.A @ x + plant.B @ u + plant.a[:, :, None])
    return np.asarray(abs(np.einsum(
        'vk,vnk->nk', plant.weights(read) - plant.weights(at), each)).max(axis=1))


def _unread(plant: TakagiSugeno, C0: np.ndarray) -> tuple[str, ...]:
    """Name the premises that no healthy sensor tells at once."""
    space = _row_space(C0)
    rows = np.eye(len(plant.states))
    return tuple(name for name in plant.premises if name in plant.states and np.linalg.norm(
        (row := rows[plant.states.index(name)]) - row @ space.T @ space) > ROUNDING)


def _functional(plant: TakagiSugeno, C0: np.ndarray, V: np.ndarray,
                decouple: bool) -> np.ndarray | None:
    """
    Return Phi (k, n), rows orthonormal, with Phi A_i = N_i Phi + J_i C0, from which v follows.

    decouple: and Phi E_i = 0. Its kernel is the smallest space that all submodels keep together
    (method 3.1, over all i).
    """
    n = len(plant.states)
    scale = np.abs(plant.A).max() or 1.0
    hidden = null_space(C0, rcond=ROUNDING) if len(C0) else np.eye(n)
    space = _span(np.hstack(list(plant.E))) if decouple else np.zeros((n, 0))
    while True:
        both = _meet(space, hidden)
        grown = _span(np.hstack([space, *(A @ both / scale for A in plant.A)]))
        if grown.shape[1] == space.shape[1]:
            break
        space = grown
    if np.linalg.norm(V @ _meet(space, hidden)) > ROUNDING * np.linalg.norm(V):
        return None
    return null_space(space.T, rcond=ROUNDING).T if space.shape[1] else np.eye(n)


def _meet(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return a basis of what two spaces share; their columns are orthonormal."""
    if not one.shape[1] or not other.shape[1]:
        return np.zeros((len(one), 0))
    _, cosines, turned = np.linalg.svd(other.T @ one)
    return one @ turned[:len(cosines)][cosines > 1.0 - ROUNDING].T


def _span(columns: np.ndarray) -> np.ndarray:
    return orth(columns, rcond=ROUNDING) if columns.size and columns.any() \
        else np.zeros((len(columns), 0))


def _row_space(rows: np.ndarray) -> np.ndarray:
    return _span(rows.T).T


def _shared(wanted: np.ndarray, basis: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Split (V, .., n) into what Phi (k rows of the basis) and C0, the rest, give of it."""
    found = wanted @ np.linalg.pinv(basis, rcond=ROUNDING)
    return found[:, :, :k], found[:, :, k:]
