"""
How far off predictions are on what was not fitted, beside simple peers.

Of each window the first third is read, for where it begins; from there on it is simulated, with
the commands alone. The peers know the same: the last reading, held; and ARX, a regression of the
next readings on those before and on the commands, fitted by least squares to the same windows as
the plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.search import begun, Found, offset_spreads, without
from vsensor_ros.fitting.shooting import Shooting
from vsensor_ros.fitting.windows import Windows

LEAD = 3  # a window's part that is read is one of so many
BLOCKS = 4  # of a single recording, in time, for cross-validation


@dataclass(frozen=True, eq=False)
class Predicted:
    """Errors (J, l, W) at times after the last reading (J,) [s], by who predicted."""

    ages: np.ndarray
    plant: np.ndarray
    held: np.ndarray
    arx: np.ndarray

    def rms(self, of: np.ndarray) -> np.ndarray:
        """Return the root of the mean square of errors, by sensor (l,)."""
        return np.sqrt(np.nanmean(of**2, axis=(0, 2)))


def folds_of(windows: Windows) -> list[np.ndarray]:
    """Return which windows (W,) each fold leaves out: a recording, or a block of the only one."""
    runs = np.unique(windows.run)
    if len(runs) > 1:
        return [windows.run == run for run in runs]
    count = len(windows.run)
    blocks = np.arange(count) * min(BLOCKS, count) // count
    return [blocks == block for block in np.unique(blocks)]


def lead_of(windows: Windows) -> int:
    """Return how many readings of each window are read."""
    return max(len(windows.readings) // LEAD, 2)


def predicted(model: Model, windows: Windows, theta: np.ndarray, deviations: np.ndarray,
              arx: np.ndarray, order: int) -> Predicted:
    """Predict the rest of windows from their beginnings."""
    lead = lead_of(windows)
    start = begun(model, windows.shorter(lead), theta, deviations)
    misfits = Shooting(model, windows, deviations, offset_spreads(model)).shoot(start).misfits
    last = windows.readings[lead - 1]
    return Predicted(windows.times[lead:] - windows.times[lead - 1], misfits[lead:],
                     np.where(np.isfinite(windows.readings[lead:]),
                              last - windows.readings[lead:], np.nan),
                     _arx_errors(windows, arx, order, lead))


def crossed(found: Found) -> tuple[np.ndarray, Predicted]:
    """Return the parameters without each fold (folds, P), and predictions of what was left out."""
    model, windows = found.shooting.model, found.shooting.windows
    deviations = found.shooting.deviations
    order = min(len(model.given.states), 5, lead_of(windows) - 1)
    moved, parts = [], []
    for out in folds_of(windows):
        kept = without(found, out)
        moved.append(kept.start.theta)
        parts.append(predicted(model, windows.only(out), kept.start.theta, deviations,
                               fitted_arx(kept.shooting.windows, order), order))
    return np.array(moved), _together(parts)


def _together(parts: Sequence[Predicted]) -> Predicted:
    """Return the predictions of all folds as one."""
    return Predicted(parts[0].ages, *(np.concatenate([getattr(p, name) for p in parts], axis=2)
                                      for name in ('plant', 'held', 'arx')))


def fitted_arx(windows: Windows, order: int) -> np.ndarray:
    """Return the coefficients (.., l) of the next readings over past ones and commands."""
    past, following = [], []
    for j in range(order, len(windows.readings)):
        past.append(_past(windows, windows.readings, j, order))
        following.append(windows.readings[j].T)
    left, right = np.concatenate(past), np.concatenate(following)
    whole = np.isfinite(left).all(axis=1) & np.isfinite(right).all(axis=1)
    found: np.ndarray = np.linalg.lstsq(left[whole], right[whole], rcond=1e-10)[0]
    return found


def _past(windows: Windows, readings: np.ndarray, j: int, order: int) -> np.ndarray:
    """Return what an ARX knows before reading j (W, ..): readings, commands between them, 1."""
    every = windows.every
    commands = [windows.inputs[(j - i) * every:(j - i + 1) * every].mean(axis=0)
                for i in range(1, order + 1)]
    rows = [*readings[j - order:j], *commands, np.ones((1, readings.shape[2]))]
    return np.concatenate(rows).T


def _arx_errors(windows: Windows, arx: np.ndarray, order: int, lead: int) -> np.ndarray:
    told = windows.readings.copy()
    with np.errstate(all='ignore'):
        for j in range(max(lead, order), len(told)):
            told[j] = (_past(windows, told, j, order) @ arx).T
    return told[lead:] - windows.readings[lead:]
