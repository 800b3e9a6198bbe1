"""The nonlinear virtual sensors of a design for the bank, all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np

from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.batch import Batch, StepOfSome, Told, Tracked
from vsensor_ros.observers.kinds.nonlinear.motion import BLIND, Motion
from vsensor_ros.observers.kinds.nonlinear.sensor import NonlinearSensor
from vsensor_ros.reason import add_sentences, Reason

LEFT = 0.3  # of the steady deviation: what is left of the start when it is forgotten

add_sentences({
    'where it says nothing': '{words}',
    'where nothing follows': 'what it divides by, or takes a root of, is 0 within its noise',
    'says too little': 'its deviation is {deviation:.3g}, and {useful:.3g} is what the declared '
                       'ranges tell without it'})


@dataclass(frozen=True, eq=False, kw_only=True)
class NonlinearBatch(Batch):
    """V of one output; then those that channels track, then what goes on from these."""

    entries: tuple[NonlinearSensor, ...]
    motions: tuple[Motion, ...]  # V
    which: np.ndarray  # (R,) int: whose run it is
    follows: np.ndarray  # (R,) bool: whether its channels correct it
    alone: np.ndarray  # (R,) bool: whether it starts by itself
    Cu: np.ndarray  # (L, m) what is in readings of commands, which expressions do not know
    limits: tuple[np.ndarray, ...]  # V of (k + L + m, 2), where it is proved
    pushes: np.ndarray  # (V, L) 1/s
    direct: np.ndarray  # (V, L)

    def start(self, told: Told) -> np.ndarray:
        """Start from the middle, or by what the channels say."""
        z = np.full((len(self.which), self.width), np.nan)
        y = told.y - self.Cu @ told.held
        for i, motion in enumerate(self.motions):
            for follows in (False, True):
                rows = np.flatnonzero((self.which == i) & (self.follows == follows) & self.alone)
                if len(rows):
                    z[rows] = 0.0
                    z[rows, :motion.width] = motion.start(y, told.held, len(rows), follows)
        return z

    def step(self, z: np.ndarray, before: Told, after: Told,
             commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step all, one virtual sensor after the other."""
        return self._stepped(self._groups(np.arange(len(self.which))), z, before, after, commands)

    def step_of(self, rows: np.ndarray) -> StepOfSome:
        """Step some."""
        groups = self._groups(rows)
        return lambda z, before, after, commands: self._stepped(
            groups, z, before, after, commands)

    def _groups(self, rows: np.ndarray) -> list[tuple[Motion, np.ndarray, np.ndarray]]:
        """Return motions, their places among rows, and which of these are followed."""
        return [(self.motions[i], at, self.follows[rows[at]]) for i in range(len(self.motions))
                if len(at := np.flatnonzero(self.which[rows] == i))]

    def _stepped(self, groups: list[tuple[Motion, np.ndarray, np.ndarray]], z: np.ndarray,
                 before: Told, after: Told,
                 commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        ended, outside = np.zeros_like(z), np.zeros(len(z), dtype=bool)
        first, last, mean = commands
        y0, y1 = before.y - self.Cu @ first, after.y - self.Cu @ last
        y, u = after.y - self.Cu @ after.held, after.held
        ages = np.stack([before.ages, after.ages])
        for motion, at, follows in groups:
            begin = np.concatenate([y0, first if motion.continuous else mean])
            own = motion.step(z[at, :motion.width], begin, np.concatenate([y1, last]), ages)
            for tracked in (False, True):
                some = follows == tracked
                if some.any() and motion.fresh(after.ages, tracked):
                    own[some] = motion.corrected(own[some], y, u, tracked)
            own = motion.said(own, y, u)
            ended[at, :motion.width] = own
            outside[at] = motion.failing(own, y, u).any(axis=0)
        return ended, outside

    def estimates(self, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return what each says."""
        return np.stack([self.estimate(i, z[..., i, :], y, held)
                         for i in range(len(self.entries))], axis=-1)

    def estimate(self, output: int, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return what one says."""
        shape, motion = z.shape[:-1], self.motions[output]
        held = held if held.shape[-1] else np.zeros((*held.shape[:-1], self.Cu.shape[1]))
        N = math.prod(shape)
        flat = [np.broadcast_to(v, (*shape, v.shape[-1])).reshape(N, v.shape[-1])
                for v in (z[..., :motion.width], y - held @ self.Cu.T, held)]
        with np.errstate(all='ignore'):
            return motion.says(*flat).reshape(shape)

    def invalid(self, output: int, z: np.ndarray, told: Told, age: float) -> Reason | None:
        """Return which condition fails."""
        entry, deviation = self.entries[output], self._deviation(output, z[output])
        failing = self.motions[output].failing(
            z[[output]], told.y - self.Cu @ told.held, told.held)[:, 0]
        if failing.any():
            return Reason.of('where it says nothing',
                             words=entry.validity[int(np.argmax(failing))].words)
        if deviation >= BLIND:
            return Reason('where nothing follows')
        return Reason.of('says too little', deviation=deviation, useful=entry.useful) \
            if entry.useful and deviation > entry.useful else None

    def outside_region(self, output: int, z: np.ndarray, told: Told) -> bool:
        """Tell whether z, a reading or a command is out of the ranges of the proof."""
        k, limits = self.motions[output].k, self.limits[output]
        at = np.concatenate([z[output, :k], told.y - self.Cu @ told.held, told.held])
        return bool((at < limits[:, 0]).any() or (at > limits[:, 1]).any())

    def deviation(self, output: int, z: np.ndarray, told: Told, age: float) -> float:
        """Return what its covariance says, and what may be left of the start at worst."""
        entry = self.entries[output]
        forgotten = entry.grade == 'temporary' or not entry.z
        left = 0.0 if forgotten else float(entry.drift[-1]) * math.exp(
            min(entry.decay * (entry.warm_up - age), 700.0))
        return math.hypot(self._deviation(output, z[output]), LEFT * left)

    def along(self, i: int, z: np.ndarray) -> float:
        """Return what the covariance of a free run says."""
        return self._deviation(self.tracked[i].own, z)

    def _deviation(self, i: int, z: np.ndarray) -> float:
        return float(z[self.motions[i].deviating])

    def drift(self, i: int, ages: np.ndarray) -> np.ndarray:
        """Return what was worked out; beyond it nobody knows unless it had settled."""
        entry = self.entries[self.tracked[i].own]
        settled = entry.drift[-1] <= 1.05 * np.interp(
            entry.ages[-1] / 2, entry.ages, entry.drift)
        return np.asarray(np.interp(ages, entry.ages, entry.drift,
                                    right=entry.drift[-1] if settled else np.inf))

    def reach(self, slopes: np.ndarray, ages: np.ndarray, direct: bool = True,
              output: int | None = None) -> np.ndarray:
        """Return how far outputs may be off by readings that moved unseen, by their slopes."""
        some = slice(None) if output is None else slice(output, output + 1)
        through = self.pushes[some] * ages * ages / 2
        if direct:
            through = self.direct[some] * ages + through
        moved: np.ndarray = np.where(through > 0.0, through * slopes, 0.0)
        return np.asarray(np.sqrt((moved * moved).sum(axis=1)))


def make_batch(entries: Sequence[NonlinearSensor], design: Contents, period: float,
               Cu: np.ndarray | None) -> NonlinearBatch:
    """Put them below each other: V that serve, then trackers, then what goes on from these."""
    sensors, inputs, V = design.sensors, design.inputs, len(entries)
    motions = tuple(Motion(e, sensors, inputs, period) for e in entries)
    following = [i for i, e in enumerate(entries) if e.tracks]
    going_on = [i for i in following if entries[i].grade != 'temporary']
    which = np.array([*range(V), *following, *going_on], dtype=int)
    follows = np.zeros(len(which), dtype=bool)
    follows[V:V + len(following)] = True
    alone = np.array([e.grade != 'temporary' for e in entries], dtype=bool)
    needs = np.array([[name in entries[i].reads or (tracked and name in entries[i].channels)
                       for name in sensors] + [name in entries[i].commands for name in inputs]
                      for i, tracked in zip(which, follows)], dtype=bool)

    def by_sensor(values: Sequence[Mapping[str, float]]) -> np.ndarray:
        return np.array([[by.get(name, 0.0) for name in sensors] for by in values])
    return NonlinearBatch(
        keys=tuple((e.fault_set, e.channel) for e in entries), of=np.arange(V),
        width=max(motion.width for motion in motions), runs_on=needs, starts_on=needs.copy(),
        own=np.array([sensors.index(e.channel) for e in entries], dtype=int),
        error=np.zeros(V), assumed=np.zeros(V, dtype=bool),
        slowest=np.array([min(1.0 / max(e.decay, 1e-9), float(e.ages[-1])) for e in entries]),
        warm_up=np.array([e.followed if e.grade == 'temporary' else e.warm_up
                          for e in entries]),
        proved=np.array([e.proved for e in entries], dtype=bool),
        wants_held=True, wants_ages=True,
        tracked=tuple(Tracked(
            i, V + n, i if i not in going_on else V + len(following) + going_on.index(i),
            tuple(sensors.index(name) for name in sensors if name in entries[i].channels),
            entries[i].followed)
            for n, i in enumerate(following)),
        entries=tuple(entries), motions=motions, which=which, follows=follows,
        alone=np.concatenate([alone, np.ones(len(following), dtype=bool),
                              np.zeros(len(going_on), dtype=bool)]),
        # the bank takes it out of the readings of continuous plants
        Cu=np.zeros((len(sensors), len(inputs))) if Cu is not None or design.Cu is None
        else design.Cu,
        limits=tuple(np.array([e.region.get(name, (-np.inf, np.inf))
                               for name in (*e.z, *sensors, *inputs)]) for e in entries),
        pushes=by_sensor([e.pushes for e in entries]),
        direct=by_sensor([e.direct for e in entries]))
