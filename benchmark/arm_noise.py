"""
Choose the process noise of the two-link arm on the runs that its model was fitted to.

    VSENSOR_DATA=FOLDER python -m benchmark.arm_noise

The rule is in config/two_link/fit.py, which has the figures chosen. Nothing here reads the runs
that they are judged on. Takes a minute a pair.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
import os
from pathlib import Path
import sys

import numpy as np

from benchmark.recordings import ARM_PLANT, arm_run, ELBOW, ELBOW_LOST, two_link
from vsensor_ros import load_plant
from vsensor_ros.engine import Setup
from vsensor_ros.recordings import Recording, replay

FITTED = (0, 1, 2)  # runs
ELBOWS = (0.5, 1.0, 2.0, 4.0)  # rad/s^2 per sqrt(Hz) on the elbow's acceleration
SHOULDERS = (0.1, 0.3, 1.0)  # on the shoulder's
ENOUGH = 0.95  # of what goes out within two deviations


def arm(shoulder: float, elbow: float) -> Setup:
    """Return an engine for an arm with these process noises."""
    plant = load_plant(ARM_PLANT)
    noise = plant.process_noise.copy()
    noise[[plant.states.index(name) for name in ('vel1', 'vel2')]] = shoulder, elbow
    return two_link(replace(plant, process_noise=noise))


def within(setup: Setup, runs: list[Recording]) -> tuple[float, float]:
    """Return the shares: of what went out within two deviations, of the time for which it did."""
    sizes = np.concatenate([
        (said[name].values - run.tracks[name].at(said[name].times)) / said[name].deviations
        for run in runs for _, said in replay(setup, run, ELBOW_LOST) for name in ELBOW])
    out = np.isfinite(sizes)
    return float((np.abs(sizes[out]) <= 2.0).mean()) if out.any() else 0.0, float(out.mean())


def main() -> int:
    """Print the shares of each pair up to the one chosen."""
    folder = os.environ.get('VSENSOR_DATA')
    if not folder:
        print('benchmark.arm_noise: set VSENSOR_DATA to the folder with the recordings',
              file=sys.stderr)
        return 2
    runs = [arm_run(Path(folder), number) for number in FITTED]
    found: dict[tuple[float, float], float] = {}
    for elbow, shoulder in product(ELBOWS, SHOULDERS):
        found[elbow, shoulder], served = within(arm(shoulder, elbow), runs)
        print(f'elbow {elbow:g}, shoulder {shoulder:g}: {100 * found[elbow, shoulder]:.1f} % '
              f'within two deviations, out for {100 * served:.0f} % of the time', flush=True)
        if found[elbow, shoulder] >= ENOUGH:
            break
    elbow, shoulder = max(found, key=lambda pair: found[pair])
    print(f'chosen: elbow {elbow:g}, shoulder {shoulder:g}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
