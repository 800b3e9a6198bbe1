"""
How long the proof of a scheduled virtual sensor takes, against the number of submodels.

Random plants of four states of which two are read, with one unknown input and 2 to 64 submodels:
the whole search over rates, with all that is checked afterwards.

    python -m benchmark.scheduled [MOST]
"""

from __future__ import annotations

import sys
import time

import numpy as np

from vsensor_ros.designer.scheduled_proof import Blend, prove
from vsensor_ros.plant.takagi_sugeno import MOST_SUBMODELS


def blend_of(submodels: int) -> Blend:
    """Make an error of four states; each submodel is stable."""
    random = np.random.default_rng(7)
    N = random.normal(size=(4, 4)) - 3.0 * np.eye(4) + 0.3 * random.normal(size=(submodels, 4, 4))
    load = random.normal(size=(submodels, 4, 1))
    G = np.concatenate([load, np.zeros((submodels, 4, 2))], axis=2)
    return Blend(N, np.eye(2, 4), G, np.hstack([np.zeros((2, 1)), 0.1 * np.eye(2)]),
                 np.eye(4)[[3]], None)


def main(most: int = MOST_SUBMODELS) -> None:
    """Print a line for each number of submodels."""
    print('submodels     time  half-width  margin left')
    submodels = 2
    while submodels <= most:
        start = time.perf_counter()
        proof = prove(blend_of(submodels), 0.1)
        took = time.perf_counter() - start
        said = f'{proof.half_width:10.3g}  {proof.left:11.2g}' if proof else '      none'
        print(f'{submodels:9d}  {took:5.1f} s  {said}', flush=True)
        submodels *= 2


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
