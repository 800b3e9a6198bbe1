"""
What is simple, beside what a virtual sensor says: two models by least squares, without a plant.

Both are fitted on what lies outside the judged windows. A static regression computes the channel
from what the other channels say at the same time. An ARX model computes it from these and its own
past, which in a window is what it has said itself there.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.recordings.dataset import Windows
from vsensor_ros.recordings.recording import Recording

ORDERS = (1, 2, 3)
MOST = 200_000  # rows of a recording that a model is fitted to, evenly over it
ENOUGH = 10  # rows a parameter that it takes for a fit
RIDGE = 1e-10  # of the largest singular value: channels that say the same share what they explain
FAR = 1e3  # times the spread of the channel, from which on a model has run away


@dataclass(frozen=True)
class Peers:
    """What the peers say in each window, at its times (T,); NaN where there is none."""

    regression: list[np.ndarray]
    arx: list[np.ndarray]
    order: int  # of the ARX model; 0: there is none


@dataclass(frozen=True)
class _Grid:
    """One recording on even times: row k is of the time k/rate."""

    y: np.ndarray  # (K,)
    x: np.ndarray  # (K, m), the other channels, and 1
    usable: np.ndarray  # (K,), outside the windows and known
    starts: np.ndarray  # rows where windows begin
    first: int  # row from which on all is known


def peers(recordings: Sequence[Recording], channel: str, others: Collection[str], rate: float,
          windows: Windows, times: Sequence[np.ndarray], turn: float | None = None) -> Peers:
    """
    Return what the peers of a channel say at the times [s] of each window, recording by recording.

    others: channels that they may use. rate: of the grid that they are fitted on [Hz].
    turn: of a channel that is an angle.
    """
    grids = [_grid(r, channel, others, rate, windows, turn) for r in recordings]
    count = round(windows.length * rate)
    regression = _fit(np.vstack([g.x[g.usable] for g in grids]),
                      np.concatenate([g.y[g.usable] for g in grids]))
    static, dynamic = [], []
    best, order = None, 0
    for n in ORDERS:
        theta = _fit_arx(grids, n)
        if theta is None:
            continue
        error = _trial(grids, theta, n, count)
        if best is None or error < best[0]:
            best, order = (error, theta), n
    for grid in grids:
        for start in grid.starts:
            rows = slice(start, start + count)
            static.append(np.full(count, np.nan) if regression is None
                          else _filled(grid.x[rows] @ regression, count))
        dynamic.append(np.full((len(grid.starts), count), np.nan) if best is None else
                       _run(grid, best[1], order, grid.starts, count))
    shape = (0, count)
    on_grid = (np.array(static).reshape(-1, count),
               np.vstack([np.zeros(shape), *dynamic]))
    begins = np.concatenate([np.zeros(0), *(g.starts for g in grids)]) / rate
    at = [[np.interp(t, begin + np.arange(count) / rate, row)
           for t, begin, row in zip(times, begins, rows)] for rows in on_grid]
    return Peers(at[0], at[1], order)


def _grid(recording: Recording, channel: str, others: Collection[str], rate: float,
          windows: Windows, turn: float | None) -> _Grid:
    times = np.arange(int(recording.seconds * rate) + 1) / rate
    stamps = recording.origin + np.rint(times * 1e9).astype(np.int64)
    y = recording.tracks[channel].held(stamps)
    x = np.column_stack([np.ones(len(times)), *(recording.tracks[o].held(stamps) for o in others)])
    if turn is not None:
        there = np.isfinite(y)
        y[there] = np.unwrap(y[there], period=turn)
    known = np.isfinite(y) & np.isfinite(x).all(axis=1)
    starts = np.ceil(windows.starts(recording.seconds) * rate - 1e-9).astype(int)
    usable = known.copy()
    for start in starts:
        usable[start:start + round(windows.length * rate)] = False
    return _Grid(y, x, usable, starts, int(np.argmax(known)))


def _fit(rows: np.ndarray, targets: np.ndarray) -> np.ndarray | None:
    """Return parameters by least squares; None: there is too little to fit."""
    if len(rows) < ENOUGH * rows.shape[1]:
        return None
    scale = np.abs(rows).max(axis=0)
    scale[scale == 0.0] = 1.0
    found = np.linalg.lstsq(rows / scale, targets, rcond=RIDGE)[0]
    return np.asarray(found / scale)


def _lagged(grid: _Grid, n: int, rows: np.ndarray) -> np.ndarray:
    """Return what an ARX model of order n reads at these rows: its past, and the others."""
    past = [grid.y[rows - i] for i in range(1, n + 1)]
    said = [grid.x[rows - i][:, 1:] for i in range(n)]
    return np.column_stack([np.ones(len(rows)), *past, *said])


def _fit_arx(grids: Sequence[_Grid], n: int) -> np.ndarray | None:
    found = []
    for grid in grids:
        rows = np.flatnonzero(grid.usable)
        rows = rows[rows >= grid.first + n]
        for i in range(1, n + 1):
            rows = rows[grid.usable[rows - i]]
        rows = rows[::1 + len(rows) // MOST]
        found.append((_lagged(grid, n, rows), grid.y[rows]))
    return _fit(np.vstack([x for x, _ in found]), np.concatenate([y for _, y in found]))


def _trial(grids: Sequence[_Grid], theta: np.ndarray, n: int, count: int) -> float:
    """Return how well a model runs on by itself where it was fitted, at most a window long."""
    errors = []
    for grid in grids:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], grid.usable.astype(int), [0]])))
        begins, ends = edges.reshape(-1, 2).T
        length = min(count, int((ends - begins).max(initial=0)) - n)
        if length > n:
            starts = ends[ends - begins >= length + n] - length
            there = grid.y[starts[:, None] + np.arange(length)]
            errors.append((_run(grid, theta, n, starts, length) - there).ravel())
    return float(np.sqrt(np.mean(np.concatenate(errors)**2))) if errors else np.inf


def _run(grid: _Grid, theta: np.ndarray, n: int, starts: np.ndarray, count: int) -> np.ndarray:
    """Return what a model says by itself from some rows on, (N, count); NaN where it ran away."""
    past = np.column_stack([grid.y[np.maximum(starts - i, 0)] for i in range(1, n + 1)])
    made, m = np.full((len(starts), count), np.nan), grid.x.shape[1] - 1
    there = grid.y[np.isfinite(grid.y)]
    spread = float(np.std(there)) if len(there) else 0.0
    far = FAR * max(spread, 1e-300) + float(np.abs(there).max(initial=0.0))
    with np.errstate(over='ignore', invalid='ignore'):
        for k in range(count):
            value = theta[0] + past @ theta[1:n + 1]
            for i in range(n):
                rows = np.clip(starts + k - i, 0, len(grid.x) - 1)
                value = value + grid.x[rows][:, 1:] @ theta[1 + n + i * m:1 + n + (i + 1) * m]
            made[:, k] = np.where(np.abs(value) < far, value, np.nan)
            past = np.column_stack([made[:, k], past[:, :-1]])
    return made


def _filled(values: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([values, np.full(count - len(values), np.nan)])
