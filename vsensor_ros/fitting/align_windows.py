"""
Readings of windows at even times, the nodes, each where it was so by the delays assumed.

A reading is put at the nearest node as it is, and how much later the node is stands beside it. It
is not interpolated: between two readings noise would be less than at one, and delays by half an
interval would look the likeliest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.windows import held
from vsensor_ros.recordings import Recording

LONGEST, SHORTEST, PARTS = 256, 64, 48  # nodes of a window; windows that there are to be
MOST = 96  # windows, evenly over the recordings


@dataclass(frozen=True, eq=False)
class Nodes:
    """
    W windows of T steps [s], each from a start [s] in one of the recordings.

    commands (T, m, W): mean of each step; readings (T + 1, l, W): NaN where there is none; after
    (T + 1, l, W): by how much a node is later than its reading [s].
    """

    step: float
    run: np.ndarray
    starts: np.ndarray
    commands: np.ndarray
    readings: np.ndarray
    after: np.ndarray

    @classmethod
    def beside(cls, parts: Sequence[Nodes]) -> Nodes:
        """Return all windows of several, which are as long."""
        return cls(parts[0].step, *(np.concatenate([getattr(part, name) for part in parts], -1)
                                    for name in ('run', 'starts', 'commands', 'readings',
                                                 'after')))


@dataclass(frozen=True, eq=False)
class Channels:
    """What sensors and commands of a plant said: by recording times and values, NaN left out."""

    model: Model
    runs: Sequence[Recording]
    sensors: Sequence[Sequence[tuple[np.ndarray, np.ndarray]]]  # by recording, then by sensor
    step: float

    @classmethod
    def of(cls, model: Model, runs: Sequence[Recording]) -> Channels:
        """Take what there is; the step is that of the fastest sensor, or the sample time."""
        found, steps = [], []
        for run in runs:
            said = []
            for name, turn in zip(model.sensors, model.given.plant.wrap):
                track = run.tracks.get(name)
                there = np.isfinite(track.values) if track is not None else np.zeros(0, bool)
                if track is None or there.sum() < 3:
                    said.append((np.zeros(0), np.zeros(0)))
                    continue
                times, values = track.times[there], track.values[there]
                said.append((times, values if np.isnan(turn) else np.unwrap(values, period=turn)))
                steps.append(float(np.median(np.diff(times))))
            found.append(said)
        if not steps:
            raise BadInput(runs[0].name or 'recording', '', 'is too short: no sensor has three '
                           'readings', 'record for longer')
        return cls(model, runs, found, model.period or min(steps))

    def cut(self, most: float) -> tuple[np.ndarray, np.ndarray, int]:
        """
        Return of which recording and from where on [s] windows are (W,), and their steps.

        most: by how much readings may be moved [s]. Raises BadInput.
        """
        spans = []
        for run, said in zip(self.runs, self.sensors):
            ends = [(t[0], t[-1]) for t, _ in said if len(t)] + [
                (run.tracks[n].times[0], np.inf) for n in self.model.inputs]
            spans.append((max(e[0] for e in ends) + most, min(e[1] for e in ends) - most))
        total = sum(max(0.0, last - first) for first, last in spans) / self.step
        count = int(min(LONGEST, max(SHORTEST, total // PARTS)))
        length = count * self.step
        owner: list[int] = []
        starts: list[float] = []
        for i, (first, last) in enumerate(spans):
            begin = first + length * np.arange(max(0, int((last - first) / length)))
            owner += [i] * len(begin)
            starts += begin.tolist()
        if len(starts) < 4:
            raise BadInput(self.runs[0].name or 'recording', '', f'is too short: {total:.0f} '
                           f'readings besides {most:g} s at each end',
                           f'give {4 * SHORTEST} or more, or a smaller --most')
        which = np.unique(np.linspace(0, len(starts) - 1, MOST).astype(int))
        return np.array(owner)[which], np.array(starts)[which], count

    def nodes(self, run: np.ndarray, starts: np.ndarray, count: int,
              delays: np.ndarray) -> Nodes:
        """
        Return windows with so late stamps (l + m,) [s] of sensors and commands.

        That is beside what the plant says. A command whose stamps are late acts before them.
        """
        model, h, width = self.model, self.step, len(run)
        late = np.asarray(model.given.late) + delays[:len(model.sensors)]
        acting = model.given.plant.input_delay - delays[len(model.sensors):]
        readings, after = np.full((2, count + 1, len(model.sensors), width), np.nan)
        commands = np.empty((count, len(model.inputs), width))
        for w, (r, start) in enumerate(zip(run, starts)):
            grid = start + h * np.arange(count + 1)
            commands[:, :, w] = held(self.runs[r], model, grid, acting)
            for i, (times, values) in enumerate(self.sensors[r]):
                at = times - late[i] - start
                first, last = np.searchsorted(at, [-h / 2, (count + 0.5) * h])
                if first == last:
                    continue
                node = np.clip(np.rint(at[first:last] / h).astype(int), 0, count)
                readings[node, i, w] = values[first:last]
                after[node, i, w] = node * h - at[first:last]
        return Nodes(h, run, starts, commands, readings, after)

    def later(self, nodes: Nodes, delays: np.ndarray) -> np.ndarray:
        """Return by how much commands (T, m, W) of windows grow with how late their stamps are."""
        acting = self.model.given.plant.input_delay - delays[len(self.model.sensors):]
        grids = nodes.starts[:, None] + nodes.step * np.arange(len(nodes.commands) + 1)
        half = nodes.step / 2.0
        return np.stack([held(self.runs[r], self.model, grid, acting - half)
                         - held(self.runs[r], self.model, grid, acting + half)
                         for r, grid in zip(nodes.run, grids)], axis=2) / nodes.step
