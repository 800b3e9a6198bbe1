"""
Recordings cut into windows on a common grid of times, as the simulation of a fit needs them.

A command is held from one stamp to the next, and its mean over a step acts in it. A reading stands
at the times of comparison on a straight line between its neighbours, and is missing in a gap. Dead
times of the plant are taken off: what is said at a stamp is put where it was so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.fitting.model import Model
from vsensor_ros.recordings import Recording, Track

GAP = 5.0  # times the usual time between readings: nothing is told in between
STEPS = 200  # of the simulation in a window, at most
NODES = 100  # times of comparison in a window, at most
SETTLED = 4000  # points that tell over which time a sensor changes


@dataclass(frozen=True, eq=False)
class Windows:
    """
    W windows of `steps` steps of `step` [s], with readings every `every` steps.

    inputs (steps, m, W): mean command of each step; readings (J, l, W): NaN where missing, the
    first at the start; run (W,): which recording; starts (W,): when it begins in that [s].
    """

    step: float
    every: int
    inputs: np.ndarray
    readings: np.ndarray
    run: np.ndarray
    starts: np.ndarray

    @property
    def horizon(self) -> float:
        """How long each is [s]."""
        return self.step * len(self.inputs)

    @property
    def times(self) -> np.ndarray:
        """When each reading of a window is, from its start on [s] (J,)."""
        return self.step * self.every * np.arange(len(self.readings))

    def only(self, which: np.ndarray) -> Windows:
        """Return some of them."""
        return replace(self, inputs=self.inputs[:, :, which], readings=self.readings[:, :, which],
                       run=self.run[which], starts=self.starts[which])

    def shorter(self, count: int) -> Windows:
        """Return their beginnings, with so many readings."""
        return replace(self, inputs=self.inputs[:(count - 1) * self.every],
                       readings=self.readings[:count])


def check_channels(runs: Sequence[Recording], model: Model, where: object) -> None:
    """Raise BadInput unless each recording has all commands and a sensor."""
    for run in runs:
        for name in model.inputs:
            if name not in run.tracks:
                raise BadInput(where, name, 'this command of the plant is not in the recording',
                               f'say which column it is: {name}=COLUMN')
        if not set(model.sensors) & set(run.tracks):
            raise BadInput(where, '', 'no sensor of the plant is in the recording',
                           f'say which column one is: {model.sensors[0]}=COLUMN')


def usual_horizon(runs: Sequence[Recording], model: Model) -> float:
    """
    Return three times that in which sensors forget what they said, in the median [s].

    That is when the mean square of their change reaches their variance. An eighth of the shortest
    recording at most.
    """
    found, longest = [], np.inf
    for run in runs:
        for name in model.sensors:
            if name not in run.tracks:
                continue
            track = run.tracks[name]
            first, last = _ends(track)
            longest = min(longest, (last - first) / 8.0)
            grid = np.linspace(first, last, SETTLED)
            values = track.at(grid)
            variance = values.var()
            if not variance > 0.0:
                continue
            lags = np.unique(np.geomspace(1, SETTLED // 8, 60).astype(int))
            changed = [np.mean((values[lag:] - values[:-lag])**2) >= variance for lag in lags]
            lag = lags[int(np.argmax(changed))] if any(changed) else SETTLED // 8
            found.append(lag * (last - first) / SETTLED)
    if not found:
        raise BadInput(runs[0].name or 'recording', '', 'no sensor of the plant moves in it',
                       'record the machine in motion')
    return min(3.0 * float(np.median(found)), longest)


def cut(runs: Sequence[Recording], model: Model, horizon: float, stride: float | None = None,
        steps: int = STEPS, nodes: int = NODES) -> Windows:
    """
    Cut recordings into windows of `horizon` [s], one every `stride` (default: none overlaps).

    steps, nodes: of the simulation and times of comparison in a window, at most.
    """
    between = min(float(np.median(np.diff(run.tracks[name].stamps))) * 1e-9 for run in runs
                  for name in (*model.sensors, *model.inputs) if name in run.tracks)
    if model.period is not None:
        step = model.period
        count = max(int(round(horizon / step)), 2)
    else:
        step = max(between, horizon / steps)
        count = max(int(round(horizon / step)), 4)
        step = horizon / count
    every = max(int(np.ceil(count / nodes)), int(round(between / step)), 1)
    count -= count % every
    if count < 2 * every:
        raise BadInput('--horizon', '', f'{horizon:.3g} s is shorter than three readings, '
                       f'{between:.3g} s apart', 'give a longer one, or a longer recording')
    inputs, readings, owner, starts = [], [], [], []
    for i, run in enumerate(runs):
        first = max(_ends(run.tracks[n])[0] for n in (*model.inputs, *model.sensors)
                    if n in run.tracks)
        last = min(_ends(run.tracks[n])[1] for n in (*model.inputs, *model.sensors)
                   if n in run.tracks)
        for start in np.arange(first, last - step * count + 1e-9, stride or step * count):
            grid = start + step * np.arange(count + 1)
            inputs.append(held(run, model, grid, model.given.plant.input_delay))
            readings.append(_read(run, model, grid[::every]))
            owner.append(i)
            starts.append(start)
    if not inputs:
        raise BadInput('--horizon', '', f'no recording is {horizon:g} s long',
                       'give a shorter one')
    return Windows(step, every, np.moveaxis(np.array(inputs), 0, 2),
                   np.moveaxis(np.array(readings), 0, 2), np.array(owner), np.array(starts))


def averaging(runs: Sequence[Recording], model: Model, windows: Windows) -> np.ndarray:
    """
    Return by how much the noise of a reading counts on the grid (l,), between 0.7 and 1.

    A time of comparison between two stamps has a part of both readings, whose noise is averaged.
    """
    found = np.ones(len(model.sensors))
    for i, (name, delay) in enumerate(zip(model.sensors, model.given.late)):
        parts = []
        for w, run in enumerate(windows.run):
            if name not in runs[run].tracks:
                continue
            track = runs[run].tracks[name]
            times = track.times[np.isfinite(track.values)]
            at = windows.starts[w] + windows.times + delay
            after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
            part = np.clip((at - times[after - 1]) / (times[after] - times[after - 1]), 0.0, 1.0)
            parts.append(part**2 + (1.0 - part)**2)
        if parts:
            found[i] = np.sqrt(np.mean(parts))
    return found


def _ends(track: Track) -> tuple[float, float]:
    return float(track.times[0]), float(track.times[-1])


def held(run: Recording, model: Model, grid: np.ndarray, delays: np.ndarray) -> np.ndarray:
    """Return the mean commands (T, m), each so late (m,) [s], of the steps between T + 1 times."""
    found = []
    for name, delay in zip(model.inputs, delays):
        track = run.tracks[name]
        times = track.times + delay
        if model.period is not None:
            at = np.searchsorted(times, grid[:-1] + 1e-6, side='right') - 1
            found.append(track.values[np.maximum(at, 0)])
            continue
        inside = np.concatenate([[grid[0]], times[(times > grid[0]) & (times < grid[-1])],
                                 [grid[-1]]])
        at = np.searchsorted(times, inside[:-1] + 1e-9, side='right') - 1
        held = track.values[np.maximum(at, 0)]
        summed = np.concatenate([[0.0], np.cumsum(held * np.diff(inside))])
        found.append(np.diff(np.interp(grid, inside, summed)) / np.diff(grid))
    return np.array(found).reshape(len(model.inputs), len(grid) - 1).T


def _read(run: Recording, model: Model, grid: np.ndarray) -> np.ndarray:
    """Return the readings (J, l) at times [s]."""
    plant = model.given.plant
    found: list[np.ndarray] = []
    for name, turn, delay in zip(model.sensors, plant.wrap, model.given.late):
        if name not in run.tracks:
            found.append(np.full(len(grid), np.nan))
            continue
        track = run.tracks[name]
        at, there = grid + delay, np.isfinite(track.values)
        times, values = track.times[there], track.values[there]
        values = values if np.isnan(turn) else np.unwrap(values, period=turn)
        read = np.interp(at, times, values, np.nan, np.nan)
        after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
        gaps = np.diff(times)
        read[gaps[after - 1] > GAP * np.median(gaps)] = np.nan
        found.append(read)
    return np.array(found).T
