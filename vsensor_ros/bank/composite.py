"""The virtual sensors of a design as one batch, of whatever kinds they are."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.observers import (
    Batch,
    Bent,
    Design,
    Entry,
    kind_named,
    kind_names,
    Refusal,
    StepOfSome,
    Told,
)
from vsensor_ros.reason import Reason


def batch_of(design: Design, period: float, Cu: np.ndarray | None) -> Batch:
    """
    Make one batch for steps of a period [s]; of one kind only, it is that of the kind itself.

    Cu (L, m): what is taken out of each reading; None: nothing.
    """
    groups: dict[tuple[str, Hashable], list[Entry]] = {}
    for entry in design.each_once():
        if not isinstance(entry, Refusal):
            if entry.kind not in kind_names():
                raise BadInput('', 'kind', f'{entry.kind:.80} is not one of '
                               f'{", ".join(kind_names())}', 'register the kind')
            groups.setdefault((entry.kind, kind_named(entry.kind).alike(entry)), []).append(entry)
    parts = [kind_named(name).batch(entries, design, period, Cu)
             for (name, _), entries in groups.items()]
    return parts[0] if len(parts) == 1 else _composed(
        parts, len(design.sensors), len(design.inputs))


def _composed(parts: Sequence[Batch], L: int, m: int) -> Composite:
    sizes, runs = [part.size for part in parts], [len(part.runs_on) for part in parts]
    starts = np.cumsum([0, *sizes]).tolist()
    helpers = (starts[-1] + np.cumsum([0, *(r - s for r, s in zip(runs, sizes))])).tolist()
    # where the runs of each part stand: those that serve first, of all parts
    at = [np.concatenate([np.arange(start, start + size),
                          np.arange(more, more + r - size)]).astype(int)
          for start, size, more, r in zip(starts, sizes, helpers, runs)]
    order = np.argsort(np.concatenate([np.zeros(0, dtype=int), *at]))

    def joined(name: str, dtype: type, *shape: int) -> np.ndarray:
        return np.concatenate([np.zeros((0, *shape), dtype=dtype),
                               *(getattr(part, name) for part in parts)])
    return Composite(
        keys=tuple(key for part in parts for key in part.keys),
        of=np.concatenate([np.zeros(0, dtype=int),
                           *(part.of + start for part, start in zip(parts, starts))]),
        width=max((part.width for part in parts), default=0),
        runs_on=joined('runs_on', bool, L + m)[order],
        starts_on=joined('starts_on', bool, L + m)[order],
        own=joined('own', int),
        error=joined('error', float),
        assumed=joined('assumed', bool),
        slowest=joined('slowest', float),
        warm_up=joined('warm_up', float),
        proved=joined('proved', bool),
        wants_held=any(part.wants_held for part in parts),
        wants_ages=any(part.wants_ages for part in parts),
        tracked=tuple(t._replace(own=int(rows[t.own]), tracker=int(rows[t.tracker]),
                                 free=int(rows[t.free]))
                      for part, rows in zip(parts, at) for t in part.tracked),
        left_out={key: why for part in parts for key, why in part.left_out.items()},
        parts=tuple((part, slice(start, start + size), rows, part.width)
                    for part, start, size, rows in zip(parts, starts, sizes, at)),
        outputs=tuple((i, j) for i, part in enumerate(parts) for j in range(len(part.keys))),
        tracks=tuple((i, j) for i, part in enumerate(parts) for j in range(len(part.tracked))))


@dataclass(frozen=True, eq=False, kw_only=True)
class Composite(Batch):
    """Batches of several kinds, one below the other; narrow states are filled up with zeros."""

    # batch, its virtual sensors, all its runs, its width
    parts: tuple[tuple[Batch, slice, np.ndarray, int], ...]
    outputs: tuple[tuple[int, int], ...]  # O: which part says it, and which output of it
    tracks: tuple[tuple[int, int], ...]  # likewise of those that are tracked

    def start(self, told: Told) -> np.ndarray:
        """Start each kind."""
        return self._filled([part.start(told) for part, _, _, _ in self.parts])

    def step(self, z: np.ndarray, before: Told, after: Told,
             commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step each kind."""
        outside = np.zeros(len(self.runs_on), dtype=bool)
        stepped = []
        for part, _, rows, k in self.parts:
            own = z[rows, :k]
            if len(rows):
                own, outside[rows] = part.step(own, before, after, commands)
            stepped.append(own)
        return self._filled(stepped), outside

    def step_of(self, rows: np.ndarray) -> StepOfSome:
        """Step those of each kind."""
        steps = []
        for part, _, at, k in self.parts:
            mine, own = np.nonzero(rows[:, None] == at)
            if mine.size:
                steps.append((part.step_of(own), mine, k))

        def step(z: np.ndarray, before: Told, after: Told,
                 commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            ended, outside = np.zeros_like(z), np.zeros(len(z), dtype=bool)
            for of_kind, mine, k in steps:
                ended[mine, :k], outside[mine] = of_kind(z[mine, :k], before, after, commands)
            return ended, outside
        return step

    def _filled(self, states: Sequence[np.ndarray]) -> np.ndarray:
        z = np.zeros((len(self.runs_on), self.width))
        for (_, _, rows, k), own in zip(self.parts, states):
            z[rows, :k] = own
        return z

    def estimates(self, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return the outputs of all kinds, side by side."""
        return np.concatenate([np.zeros((*z.shape[:-2], 0)), *(
            part.estimates(z[..., rows, :k], y, held)
            for part, rows, _, k in self.parts)], axis=-1)

    def estimate(self, output: int, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Ask the kind."""
        i, own = self.outputs[output]
        part, _, _, k = self.parts[i]
        return part.estimate(own, z[..., :k], y, held)

    def waiting(self, output: int, z: np.ndarray, age: float) -> float:
        """Ask the kind."""
        part, own, z = self._own(output, z)
        return part.waiting(own, z, age)

    def invalid(self, output: int, z: np.ndarray, told: Told, age: float) -> Reason | None:
        """Ask the kind."""
        part, own, z = self._own(output, z)
        return part.invalid(own, z, told, age)

    def outside_region(self, output: int, z: np.ndarray, told: Told) -> bool:
        """Ask the kind."""
        part, own, z = self._own(output, z)
        return part.outside_region(own, z, told)

    def deviation(self, output: int, z: np.ndarray, told: Told, age: float) -> float:
        """Ask the kind."""
        part, own, z = self._own(output, z)
        return part.deviation(own, z, told, age)

    def interval(self, output: int, z: np.ndarray, told: Told,
                 age: float) -> tuple[float, float] | None:
        """Ask the kind."""
        part, own, z = self._own(output, z)
        return part.interval(own, z, told, age)

    def drift(self, i: int, ages: np.ndarray) -> np.ndarray:
        """Ask the kind."""
        part, own = self.tracks[i]
        return self.parts[part][0].drift(own, ages)

    def along(self, i: int, z: np.ndarray) -> float:
        """Ask the kind."""
        part, own = self.tracks[i]
        of_kind, _, _, k = self.parts[part]
        return of_kind.along(own, z[:k])

    def bent(self, i: int) -> Bent | None:
        """Ask the kind."""
        part, own = self.tracks[i]
        return self.parts[part][0].bent(own)

    def _own(self, output: int, z: np.ndarray) -> tuple[Batch, int, np.ndarray]:
        i, own = self.outputs[output]
        part, rows, _, k = self.parts[i]
        return part, own, z[rows, :k]

    def reach(self, slopes: np.ndarray, ages: np.ndarray, direct: bool = True,
              output: int | None = None) -> np.ndarray:
        """Ask each kind."""
        if output is not None:
            i, own = self.outputs[output]
            return self.parts[i][0].reach(slopes, ages, direct, own)
        return np.concatenate([np.zeros(0), *(
            part.reach(slopes, ages, direct) for part, _, _, _ in self.parts)])
