"""How good what went out for a lost sensor was, against what it said in the recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.recordings.recording import Track
from vsensor_ros.recordings.through_engine import Said


@dataclass(frozen=True)
class Verdict:
    """Over all losses of one channel, in its unit; NaN where nothing went out."""

    losses: int
    served: float  # share of the time for which something went out
    rmse: float  # of what went out
    held: float  # rmse, at the same times, of the last value before the loss
    median: float  # of the errors' sizes at the ends of the losses
    ninetieth: float  # percentile of those
    deviation: float  # rms of what was stated
    covered: float  # share of what went out that was within two deviations


def verdict(heard: Sequence[Said], truth: Track) -> Verdict:
    """Judge what went out in several losses."""
    errors = [said.values - truth.at(said.times) for said in heard]
    held = [truth.at(said.times[0]) - truth.at(said.times) for said in heard]
    error, stated = np.concatenate(errors), np.concatenate([s.deviations for s in heard])
    out = np.isfinite(error)
    ends = np.abs([e[np.isfinite(e)][-1] for e in errors if np.isfinite(e).any()])
    if not out.any():
        return Verdict(len(heard), 0.0, *[np.nan] * 6)
    return Verdict(
        len(heard), float(out.mean()), _rms(error[out]), _rms(np.concatenate(held)[out]),
        float(np.median(ends)), float(np.percentile(ends, 90)), _rms(stated[out]),
        float(np.mean(np.abs(error[out]) <= 2.0 * stated[out])))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
