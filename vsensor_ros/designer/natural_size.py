"""
Natural sizes of a plant's states: the units in which ranks are decided and noise is assumed.

How large a state is beside another comes from how they act on each other, in the plant's
continuous original if it is sampled: those that act both ways are balanced, one that is only acted
on is as large as that makes it in steady state. How large all of them are comes from the noise of
the sensors, else from the ranges, else from what the inputs do. So sizes follow the units, and
depend neither on the sample time nor on the order of the states.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import matrix_balance, sqrtm
from scipy.sparse.csgraph import connected_components

from vsensor_ros.plant import Plant

RELATIVE = 0.01  # of its natural size: what a reading errs by where its noise is not given
INTEGRATES = 1.1  # times as fast as is between its neighbours and the mean: an integrator
STEPS = 60  # of Newton's method
NEAR = 0.25  # of one: a matrix that differs by no more has a logarithm by its series
ROOTS = 40  # square roots, at most, until it does
STILL = 1e-9  # of the fastest: a rate below it is none
DEAD = 1e-6  # a mode of a sampled plant that leaves no more is dead beat, and has no rate


@dataclass(frozen=True, eq=False)
class Couplings:
    """How the states of a plant act on each other."""

    modes: np.ndarray  # (n,) complex, of A, of one strongly connected part after the other
    parts: tuple[np.ndarray, ...]  # the states of each such part
    mean_rate: float  # 1/s
    slowest: float  # 1/s, of what is no integrator
    sizes: np.ndarray  # (n,) natural sizes but for one factor a group
    group: np.ndarray  # (n,) which of the groups that do not act on each other a state is in


@lru_cache(maxsize=8)
def couplings(plant: Plant) -> Couplings:
    """Look at how the states of a plant act on each other."""
    A, h = plant.A, plant.sample_time
    count, part = connected_components(A != 0, directed=True, connection='strong')
    parts = tuple(np.flatnonzero(part == i) for i in range(count))
    moving = A if h is None else (A - np.eye(len(A))) / h
    inner = np.ones(len(A))
    for states in parts:
        inner[states] = _balanced(moving[np.ix_(states, states)])
    # equal parts in a row have equal modes, which taken together would scatter widely
    modes = np.concatenate([np.linalg.eigvals(
        A[np.ix_(states, states)] / inner[states, None] * inner[states]).astype(complex)
        for states in parts])
    rates = rates_of(modes, h)
    rate = mean_of(rates)
    sizes = inner * _outer(moving / inner[:, None] * inner, part, rate)
    if h is not None:
        moving = _logarithm(A / sizes[:, None] * sizes, modes) / h
        again = np.ones(len(A))
        for states in parts:
            again[states] = _balanced(moving[np.ix_(states, states)])
        sizes = sizes * again * _outer(moving / again[:, None] * again, part, rate)
    group = connected_components(A != 0, directed=True, connection='weak')[1]
    return Couplings(modes, parts, rate, rates.min(initial=rate), sizes, group)


def rates_of(modes: np.ndarray, sample_time: float | None) -> np.ndarray:
    """Return the moduli [1/s] of modes, integrators and dead beats left out."""
    rates = (np.abs(modes) if sample_time is None
             else np.abs(np.log(modes[np.abs(modes) > DEAD])) / sample_time)
    return np.asarray(rates[rates > STILL * max(rates.max(initial=0.0), np.finfo(float).tiny)])


def mean_of(rates: np.ndarray) -> float:
    """Return the geometric mean of rates [1/s]; 1 where there is none."""
    return float(np.exp(np.mean(np.log(rates)))) if rates.size else 1.0


def natural_sizes(plant: Plant, healthy: list[int], failed: list[int],
                  wanted: np.ndarray) -> np.ndarray:
    """
    Return the natural size (n,) of each state in its unit.

    ``healthy``, ``failed``: indices of sensors; ``wanted`` (p, n): rows that are to be estimated.
    What a reading or a wanted row is made of is taken to be of one size, where nothing else tells.
    The noise that is given is RELATIVE of the size of what is read, in the median of the healthy
    sensors; where none of these has any, of the failed ones. Next come the states' ranges, half
    of which is their size, or the operating value if that is less; next what the inputs move
    within the largest time constant, with half their ranges or their operating values. Where
    nothing is known readings are of size 1.
    """
    made = couplings(plant)
    rows = np.vstack([plant.C[healthy], wanted])
    sizes, group = _joined(made.sizes, made.group, rows)
    found = np.ones(group.max() + 1)
    given = _own(plant.input_range, plant.operating_input, np.zeros(len(plant.inputs)))
    driven = np.linalg.norm(_moved(plant) / sizes[:, None] * given, axis=1)
    half, point = 0.5 * (plant.ranges[:, 1] - plant.ranges[:, 0]), np.abs(plant.operating_point)
    half = np.where((point > 0.0) & (half < np.inf), np.minimum(half, point), half)
    for g in range(len(found)):
        here = group == g
        rate = [_said(plant, sensors, sizes, here) for sensors in (healthy, failed)]
        bounded = (half / sizes)[here & np.isfinite(half)]
        lengths = np.linalg.norm(rows[:, here] * sizes[here], axis=1)
        for known in (*rate, bounded, [np.sqrt(np.mean(driven[here] ** 2))],
                      1.0 / lengths[lengths > 0]):
            logs = np.log([size for size in known if 0.0 < size < np.inf])
            if len(logs):
                found[g] = np.exp(np.median(logs))
                break
    return np.asarray(sizes * found[group])


@lru_cache(maxsize=8)
def reaches(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """
    Return how far from the operating point states (n,) and inputs (m,) are taken to go.

    Each by its own: half its range; else its operating value; else what the noise of its own
    sensor is RELATIVE of; else its natural size, of an input what moves a state by that.
    """
    every = list(range(len(plant.sensors)))
    size = natural_sizes(plant, every, [], np.zeros((0, len(plant.states))))
    moved = _moved(plant) / size[:, None]
    most = moved.max(axis=0, initial=0.0)
    for row, noise, *direct in zip(plant.C, plant.noise, plant.Cu, plant.Cd):
        alone = np.flatnonzero(row)
        if len(alone) == 1 and noise > 0.0 and not any(more.any() for more in direct):
            size[alone] = noise / RELATIVE / np.abs(row[alone])
    return (_own(plant.ranges, plant.operating_point, size),
            _own(plant.input_range, plant.operating_input,
                 1.0 / np.where(most > 0.0, most, 1.0)))


def _own(ranges: np.ndarray, point: np.ndarray, natural: np.ndarray) -> np.ndarray:
    half = 0.5 * (ranges[:, 1] - ranges[:, 0])
    return np.where(np.isfinite(half), half, np.where(point != 0.0, np.abs(point), natural))


def _said(plant: Plant, sensors: list[int], sizes: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return how large the given noise of sensors says that states are, in ``sizes``."""
    rows = plant.C[sensors] * sizes
    within = rows.any(axis=1) & ~rows[:, ~here].any(axis=1)
    return plant.noise[sensors][within] / RELATIVE / np.linalg.norm(rows[within], axis=1)


def _moved(plant: Plant) -> np.ndarray:
    """Return how far an input of 1 moves each state (n, m) within the largest time constant."""
    known, h = couplings(plant), plant.sample_time
    s = known.slowest if h is None else np.exp(known.slowest * h)
    A, B = plant.A / known.sizes[:, None] * known.sizes, plant.B / known.sizes[:, None]
    response = np.linalg.lstsq(s * np.eye(len(A)) - A, B, rcond=None)[0]
    return np.abs(response) * known.sizes[:, None]


def _balanced(A: np.ndarray) -> np.ndarray:
    """
    Return units (n,) in which each row of A, off the diagonal, is as long as its column.

    A is strongly connected, so that there are such units, but for one factor; by Newton's method
    on the logarithms: sum |a_ij|^2 exp(2 (x_j - x_i)) is convex and least there.
    """
    n = len(A)
    if n == 1:
        return np.ones(1)
    square = (A * (1 - np.eye(n))) ** 2
    x = np.log(matrix_balance(A, permute=False, separate=True)[1][0])
    for _ in range(STEPS):
        x = x - x.mean()
        E = square * np.exp(2 * (x - x[:, None]))
        row, column = E.sum(axis=1), E.sum(axis=0)
        both = row + column
        if (np.abs(column - row) <= 1e-13 * both).all():
            break
        unit = 1.0 / np.sqrt(both)
        H = (np.diag(both) - E - E.T) * unit * unit[:, None] * 2
        step = unit * np.linalg.lstsq(H, unit * (row - column), rcond=1e-14)[0]
        x = x + step / max(1.0, np.abs(step).max())
    return np.exp(x - x.mean())


def _outer(A: np.ndarray, part: np.ndarray, rate: float) -> np.ndarray:
    """
    Return factors (n,) for parts that act on each other in one direction only.

    With them each part is, in the sense of least squares, as large as what acts on it makes it in
    steady state: it is pushed as fast as it goes back by itself. What acts along several ways
    counts by its strongest.
    """
    count = int(part.max()) + 1
    member = np.eye(count)[:, part]
    blocks = np.sqrt(member @ A**2 @ member.T)
    own = np.diag(blocks)
    still = own <= STILL * own.max()
    between = blocks * (1 - np.eye(count))
    straight = _straightness(between, np.where(still, rate, own))
    between = np.where(straight > STILL, between, 0.0)  # what is less came of rounding
    own = _own_rates(own, still, between, rate)
    i, j = np.nonzero(between)
    if not len(i):
        return np.ones(len(A))
    wanted = np.log(own[i]) - np.log(between[i, j])  # x_j - x_i
    return np.exp(_potential(count, i, j, wanted, _straightness(between, own)[i, j] ** 2))[part]


def _straightness(between: np.ndarray, own: np.ndarray) -> np.ndarray:
    """
    Return which share of what a part does to another it does straight, not through others (c, c).

    ``between`` (c, c): couplings of the parts, without a way back; ``own`` (c,): their rates.
    """
    i, j = np.nonzero(between)
    if not len(i):
        return np.zeros_like(between)
    wanted = np.log(own[i]) - np.log(between[i, j])
    x = _potential(len(own), i, j, wanted, np.ones(len(i)))  # numbers near one
    now = between * np.exp(x - x[:, None]) / own[:, None]
    with np.errstate(over='ignore', invalid='ignore'):
        ways = np.linalg.inv(np.eye(len(own)) - now)  # 1 + now + now^2 + .., which ends
        share = now / np.where(now > 0, ways, 1.0)
    return np.where(np.isfinite(share), share, (between > 0).astype(float))


def _own_rates(own: np.ndarray, still: np.ndarray, between: np.ndarray,
               rate: float) -> np.ndarray:
    """
    Return how fast each part is by itself (c,) [1/s]; ``still``: those that are not by themselves.

    An integrator is taken to be as fast as is between its neighbours and the plant's mean.
    """
    if not still.any():
        return own
    linked = (between > 0) | (between.T > 0)
    alone = still & ~_reached(linked, ~still)
    near = np.where(still, 0.0, np.log(np.where(still, 1.0, own)))
    among = np.flatnonzero(still & ~alone)
    own = np.where(still, rate, own)
    if len(among):  # each the mean of its neighbours
        weight = linked[among] / linked[among].sum(axis=1, keepdims=True)
        near[among] = np.linalg.solve(np.eye(len(among)) - weight[:, among], weight @ near)
        own[among] = INTEGRATES * np.exp((3 * near[among] + np.log(rate)) / 4)
    return own


def _reached(linked: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Tell which parts are linked to one of the start, directly or not."""
    reached = start
    while True:
        more = reached | (linked @ reached.astype(float) > 0)
        if (more == reached).all():
            return reached
        reached = more


def _potential(count: int, i: np.ndarray, j: np.ndarray, wanted: np.ndarray,
               weight: np.ndarray) -> np.ndarray:
    """Return x (count,), of mean 0 in each group, with x_j - x_i as wanted by least squares."""
    L, b = np.zeros((count, count)), np.zeros(count)
    np.add.at(L, (i, i), weight)
    np.add.at(L, (j, j), weight)
    np.add.at(L, (i, j), -weight)
    np.add.at(L, (j, i), -weight)
    np.add.at(b, j, weight * wanted)
    np.add.at(b, i, -weight * wanted)
    group = connected_components(L != 0, directed=False)[1]
    alike = group[:, None] == group
    size = np.where(np.diag(L) > 0, np.diag(L), 1.0)
    unit = 1.0 / np.sqrt(size)
    x = np.linalg.lstsq(L * unit * unit[:, None], unit * b, rcond=1e-13)[0] * unit
    return np.asarray(np.clip(x - alike @ x / alike.sum(axis=1), -300, 300))


def _joined(sizes: np.ndarray, group: np.ndarray,
            rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Join groups of states that rows (s, n) add up, each as large in a row as the others."""
    count = int(group.max()) + 1
    if count == 1:
        return sizes, group
    member = np.eye(count)[:, group]
    length = np.sqrt((rows * sizes) ** 2 @ member.T)
    i, j, wanted = [], [], []
    for row in length:
        told = np.flatnonzero(row)
        for a, b in zip(told, told[1:]):
            i.append(a)
            j.append(b)
            wanted.append(np.log(row[a] / row[b]))
    if not i:
        return sizes, group
    x = _potential(count, np.array(i), np.array(j), np.array(wanted), np.ones(len(i)))
    linked = np.zeros((count, count))
    linked[i, j] = 1.0
    return sizes * np.exp(x)[group], connected_components(linked, directed=False)[1][group]


def _logarithm(A: np.ndarray, modes: np.ndarray) -> np.ndarray:
    """
    Return the logarithm of A, which moves the plant's continuous original in a step.

    Where there is none (a dead beat, a mode that changes its sign at every step) A - 1.
    """
    one, root, times = np.eye(len(A)), A, 1.0
    if (np.abs(modes) < DEAD).any() or (np.abs(modes + np.abs(modes)) < DEAD).any():
        return A - one
    for _ in range(ROOTS):
        if np.linalg.norm(root - one, 1) <= NEAR:
            break
        root, times = sqrtm(root), 2 * times
        if np.iscomplexobj(root):
            if np.abs(root.imag).max() > 1e-9 * np.abs(root.real).max():
                return A - one
            root = root.real
        if not np.isfinite(root).all():
            return A - one
    else:
        return A - one
    Y = np.linalg.solve(root + one, root - one)
    square, power, total = Y @ Y, Y, np.zeros_like(Y)
    for k in range(1, 16, 2):  # log A = 2 artanh (A - 1)/(A + 1)
        total = total + power / k
        power = power @ square
    return np.asarray(2 * times * total)
