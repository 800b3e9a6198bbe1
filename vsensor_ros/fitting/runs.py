"""The recordings of a fit: read from dataset files or tables, and parts of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.recordings import Dataset, load_dataset, read_dataset, Recording, Track

DATASET = ('.yaml', '.yml')
LARGEST = 1e100  # of a reading: the square of what is larger may be none


def read_runs(paths: Sequence[Path], first: float = 0.0, last: float = float('inf'),
              ) -> tuple[Recording, ...]:
    """
    Read dataset files, and tables whose columns are called as the channels are.

    first, last: the part of each that is taken [s from its start on]. Raises BadInput.
    """
    runs: list[Recording] = []
    for path in paths:
        runs.extend(load_dataset(path) if path.suffix in DATASET
                    else Dataset((path.absolute(),)).load())
    return tuple(part(run, first, last) for run in runs)


def also_judged(paths: Sequence[Path], first: float, last: float) -> list[str]:
    """Return the dataset files whose windows lie in what is fitted to. Raises BadInput."""
    found = [(path.name, read_dataset(path).windows) for path in paths if path.suffix in DATASET]
    return [name for name, w in found if w is not None and w.start < last and w.end > first]


def part(run: Recording, first: float, last: float) -> Recording:
    """Return what was said from `first` to `last` [s]; raise BadInput where that is nothing."""
    tracks = {}
    for name, track in run.tracks.items():
        inside = (track.times >= first) & (track.times < last)
        if inside.sum() > 1:
            large = np.abs(track.values[inside])
            if (large[np.isfinite(large)] > LARGEST).any():
                raise BadInput(run.name or 'recording', name, 'has values beyond 1e100, which are '
                               'no readings', 'leave them out, or write nan')
            tracks[name] = Track(track.stamps[inside], track.values[inside], track.origin)
    if not tracks:
        raise BadInput(run.name or 'recording', '', f'says nothing from {first:g} to {last:g} s',
                       f'it is {run.seconds:.4g} s long')
    return replace(run, tracks=tracks)
