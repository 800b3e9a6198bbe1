"""
Choose the process noise of the two-link arm by runs that its model was not fitted to.

    VSENSOR_DATA=FOLDER python -m benchmark.arm_noise

The rule is in config/two_link/fit.py, which has the figures chosen: a model is fitted to two of
the three runs, and judged by the third. It is that of the virtual sensors without a filter. How
good the filter is, whose figures are stated, is said at the end, by the same runs. Nothing here
reads the runs that the figures are judged on at last. Takes a minute a pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
import os
from pathlib import Path
import subprocess
import sys
import tempfile

import numpy as np

from benchmark.recordings import ARM, arm_run, CONFIG, ELBOW, ELBOW_LOST, two_link
from vsensor_ros import load_plant
from vsensor_ros.plant import Plant
from vsensor_ros.recordings import replay

FIT = CONFIG / 'two_link' / 'fit.py'
FITTED = (0, 1, 2)  # runs
ELBOWS = (0.5, 1.0, 2.0, 4.0)  # rad/s^2 per sqrt(Hz) on the elbow's acceleration
SHOULDERS = (0.1, 0.3, 1.0)  # on the shoulder's
ENOUGH = 0.95  # of what goes out within two deviations


def without(data: Path, run: int, folder: Path) -> Plant:
    """Return a plant that was fitted to all of these runs but one."""
    others = [str(data / ARM.format(number)) for number in FITTED if number != run]
    written = folder / f'without_{run}.yaml'
    subprocess.run([sys.executable, str(FIT), *others, '-o', str(written)], check=True)
    return load_plant(written)


def with_noise(plant: Plant, shoulder: float, elbow: float) -> Plant:
    """Return the plant with these process noises."""
    noise = plant.process_noise.copy()
    noise[[plant.states.index(name) for name in ('vel1', 'vel2')]] = shoulder, elbow
    return replace(plant, process_noise=noise)


def within(data: Path, run: int, plant: Plant, extended: bool = False) -> tuple[float, float]:
    """Return the shares: of what went out within two deviations, of the time for which it did."""
    recording = arm_run(data, run)
    sizes = np.concatenate([
        (said[name].values - recording.tracks[name].at(said[name].times)) / said[name].deviations
        for _, said in replay(two_link(plant, extended), recording, ELBOW_LOST) for name in ELBOW])
    out = np.isfinite(sizes)
    return float((np.abs(sizes[out]) <= 2.0).mean()) if out.any() else 0.0, float(out.mean())


def told(shares: Sequence[tuple[float, float]]) -> str:
    """Say the shares of each run."""
    return ', '.join(f'{100 * share:.1f} % within two deviations, out for {100 * out:.0f} %'
                     for share, out in shares)


def main() -> int:
    """Print the shares of each pair up to the one chosen."""
    folder = os.environ.get('VSENSOR_DATA')
    if not folder:
        print('benchmark.arm_noise: set VSENSOR_DATA to the folder with the recordings',
              file=sys.stderr)
        return 2
    data = Path(folder)
    with tempfile.TemporaryDirectory() as made:
        plants = {run: without(data, run, Path(made)) for run in FITTED}
    found: dict[tuple[float, float], float] = {}
    for elbow, shoulder in product(ELBOWS, SHOULDERS):
        shares = [within(data, run, with_noise(plant, shoulder, elbow))
                  for run, plant in plants.items()]
        found[elbow, shoulder] = min(share for share, _ in shares)
        print(f'elbow {elbow:g}, shoulder {shoulder:g}, by run: {told(shares)}', flush=True)
        if found[elbow, shoulder] >= ENOUGH:
            break
    elbow, shoulder = max(found, key=lambda pair: found[pair])
    print(f'chosen: elbow {elbow:g}, shoulder {shoulder:g}')
    shares = [within(data, run, plant, True) for run, plant in plants.items()]
    print(f'the filter, by run: {told(shares)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
