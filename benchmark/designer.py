"""
How long the design of a whole bank takes, beside full-order designs for the same plants.

Ours is `design(plant)`: for every sensor that may fail alone a virtual sensor of least order, or
nearly so, with its proof and its checks. The peers are what one writes otherwise, an observer of
all n states on the healthy sensors, for every sensor that may fail: its gain by `control.lqe`
(Kalman-Bucy; the Riccati solver is slycot's where it is installed, else scipy's), or by
`scipy.signal.place_poles` at the plant's own poles, moved by 1 to the left, which stops after 30
rounds whether it has converged or not. All faults are alike to them, so they are timed on FAULTS
at most and counted for all; place_poles, which takes minutes a fault for more than PLACED states,
on one fault of one plant. Neither decouples unknown inputs, proves anything or looks for less.

The plants are random and stable, with n/10 sensors, at least two: dense ones, and networks in
which each state hears three others. Seconds of the wall clock; the matrix library gets one thread
unless OPENBLAS_NUM_THREADS says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from time import perf_counter
from typing import Any
import warnings

import numpy as np

from benchmark.row import Row
from vsensor_ros import design, Plant

SIZES = (20, 50, 100, 200)
PLANTS = 3  # of each kind and size, up to MANY states; one beyond
MANY = 50
FAULTS = 3
PLACED = 50
HEARD = 3  # states that each state of a network hears


def dense(n: int, seed: int) -> Plant:
    """Make a plant whose poles fill a disc of radius 1 about -1.5, of which sensors mix all."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) / np.sqrt(n) - 1.5 * np.eye(n)
    return _stable(A, rng.standard_normal((_sensors(n), n)) / np.sqrt(n), rng)


def network(n: int, seed: int) -> Plant:
    """Make a network, each state with its own decay; each sensor sees one state."""
    rng = np.random.default_rng(seed)
    A = -np.diag(rng.uniform(0.5, 2.0, n))
    for i in range(n):
        A[i, rng.choice(n, HEARD, replace=False)] += rng.uniform(-0.5, 0.5, HEARD)
    return _stable(A, np.eye(n)[rng.choice(n, _sensors(n), replace=False)], rng)


def _sensors(n: int) -> int:
    return max(2, n // 10)


def _stable(A: np.ndarray, C: np.ndarray, rng: np.random.Generator) -> Plant:
    slowest = np.linalg.eigvals(A).real.max()
    return Plant.from_matrices(A - max(0.0, slowest + 0.1) * np.eye(len(A)),
                               rng.standard_normal((len(A), 1)), C)


KINDS: dict[str, Callable[[int, int], Plant]] = {'dense': dense, 'network': network}


def riccati(A: np.ndarray, C: np.ndarray) -> None:
    """Design one full-order Kalman filter with unit noises."""
    from control import lqe
    lqe(A, np.eye(len(A)), C, np.eye(len(A)), np.eye(len(C)))


def placement(A: np.ndarray, C: np.ndarray) -> None:
    """Design one full-order observer by pole placement."""
    from scipy.signal import place_poles
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', UserWarning)  # not converged
        place_poles(A.T, C.T, np.linalg.eigvals(A) - 1.0)


def _timed(work: Callable[..., Any], *given: object) -> tuple[float, Any]:
    begin = perf_counter()
    result = work(*given)
    return perf_counter() - begin, result


def for_all_faults(plant: Plant, peer: Callable[[np.ndarray, np.ndarray], None],
                   faults: int) -> float:
    """Return what a peer would take for every single fault of a plant [s]."""
    count = len(plant.sensors)
    return count * median(_timed(peer, plant.A, np.delete(plant.C, i, axis=0))[0]
                          for i in range(min(faults, count)))


def exponent(seconds: dict[int, float]) -> float:
    """Return p of the c n^p that fits the seconds by n best, in logarithms."""
    return float(np.polyfit(np.log(list(seconds)), np.log(list(seconds.values())), 1)[0])


def measure(sizes: Sequence[int] = SIZES,
            progress: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Time both on the same plants, in turns; medians over the plants of one size."""
    rows = []
    small = dense(4, 0)  # so that nobody's imports are timed
    design(small)
    for peer in (riccati, placement):
        for_all_faults(small, peer, 1)
    for kind, make in KINDS.items():
        ours, lqe, placed, states = ({} for _ in range(4))  # by n
        for n in sizes:
            spent = []
            for seed in range(PLANTS if n <= MANY else 1):
                progress(f'design of a {kind} plant, n = {n}, number {seed + 1}')
                plant = make(n, seed)
                seconds, made = _timed(design, plant)
                for refused in made.refusals:  # stable and undisturbed: a copy serves at least
                    raise AssertionError(f'{kind}, n = {n}: {refused.reason}')
                order = sum(v.order for v in made.virtual_sensors)
                spent.append((seconds, for_all_faults(plant, riccati, FAULTS), order))
            ours[n], lqe[n], states[n] = map(median, zip(*spent))
            if n <= PLACED:
                placed[n] = for_all_faults(plant, placement, 1)
        what = f'for every single fault, {kind} plants; peer: '

        def compared(group: str, unit: str, mine: dict[int, float],
                     other: dict[int, float]) -> list[Row]:
            return [Row(group, f'n = {n}, {_sensors(n)} sensors', unit, mine[n], other[n])
                    for n in other]

        group = f'design {what}control.lqe, all states'
        rows += compared(group, 's', ours, lqe)
        if len(sizes) > 1:
            rows.append(Row(group, 'time grows as n to the power', '', exponent(ours),
                            exponent(lqe)))
        rows += compared(f'design {what}scipy place_poles, all states', 's', ours, placed)
        rows += compared(f'states to run {what}all states', '', states,
                         {n: float(n * _sensors(n)) for n in sizes})
    return rows
