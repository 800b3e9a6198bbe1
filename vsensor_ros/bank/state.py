"""All runs of a batch at one time of the grid."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from vsensor_ros.observers import Told


class State(NamedTuple):
    """All R runs at the grid time t_0 + tick * period."""

    tick: int
    z: np.ndarray  # (R, k), of no meaning where not running
    running: np.ndarray  # (R,) bool
    since: np.ndarray  # (R,) tick at which it started
    restarts: np.ndarray  # (R,) how often it became infinite
    outside: np.ndarray  # (R,) steps with an argument outside its domain
    told: Told
    # (T, k, k) covariances of the free runs along their way; None: that bends no error
    spread: np.ndarray | None = None


def stacked(states: Iterable[State]) -> tuple[
        np.ndarray, np.ndarray, np.ndarray, np.ndarray, Told]:
    """Return ticks, z, running, since, told of states, along a first axis."""
    ticks, z, running, since, _, _, told, _ = zip(*states)
    return (np.array(ticks), np.array(z), np.array(running), np.array(since),
            Told(*map(np.array, zip(*told))))
