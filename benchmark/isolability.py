"""
How much of what a plant allows its residuals tell apart: by singles, by pairs, with filters.

Random plants, half of them discrete, with unknown inputs; those count of which any sensor's fault
can be told from another's. Each ordered pair of sensors that the plant allows is asked of three
banks, parts of what `isolate=True` designs: a virtual sensor for every single sensor; those of the
pairs, too; all with the dedicated filters.

    python -m benchmark.isolability [COUNT]
"""

from __future__ import annotations

from collections.abc import Sequence
import sys

import numpy as np

from vsensor_ros import design, Plant
from vsensor_ros.designer.residuals import residuals
from vsensor_ros.observers import Distinction, Isolability, NONE, STRENGTHS

COUNT = 114
BANKS = ('singles', 'with pairs', 'with filters, too')


def plant_of(seed: int) -> Plant:
    """Make a plant of 2 to 5 states, in which half of the states hear each other."""
    rng = np.random.default_rng(seed)
    n, outputs, unknown = rng.integers(2, 6), rng.integers(2, 5), rng.integers(1, 3)
    A = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.5)
    values, sample_time = np.linalg.eigvals(A), [None, 0.1][seed % 2]
    if sample_time is None:
        A = A - (values.real.max() + 0.2) * np.eye(n)
    else:
        A = 0.9 * A / max(np.abs(values).max(), 0.1)
    C = (np.eye(n)[rng.permutation(n)[:outputs]] if rng.random() < 0.5
         else rng.normal(size=(outputs, n)))
    D = rng.normal(size=(n, unknown)) * (rng.random((n, unknown)) < 0.5)
    return Plant.from_matrices(A, rng.normal(size=(n, 1)), C, D=D, sample_time=sample_time)


def told(found: Isolability, pairs: Sequence[Distinction]) -> tuple[int, int]:
    """Count the pairs that are told at all, and as well as the plant allows."""
    has = [(found.by_residuals(d.sensor, d.others), d.strength) for d in pairs]
    return (sum(h != NONE for h, _ in has),
            sum(STRENGTHS.index(h) >= STRENGTHS.index(best) for h, best in has))


def main(count: int = COUNT) -> None:
    """Print the shares over so many plants."""
    total, plants, seed, filters = 0, 0, 0, 0
    sums = np.zeros((3, 2), int)
    while plants < count:
        plant = plant_of(seed)
        seed += 1
        result = design(plant, isolate=True)
        found = result.isolability
        assert found is not None
        pairs = [d for d in found.plant if len(d.others) == 1 and d.strength != NONE]
        if not pairs:
            continue
        plants, total, filters = plants + 1, total + len(pairs), filters + len(found.filters)
        entries = result.each_once()
        banks = (residuals(plant, [e for e in entries if len(e.fault_set) == 1]),
                 residuals(plant, entries), found.residuals)
        for i, bank in enumerate(banks):
            sums[i] += told(Isolability(bank), pairs)
    print(f'{plants} plants, {total} ordered pairs that they allow, {filters} dedicated filters')
    for name, (some, whole) in zip(BANKS, sums):
        print(f'{name:18} {100 * some / total:6.1f} %, as well as can be '
              f'{100 * whole / total:6.1f} %')


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
