"""The scheduled virtual sensors of a design for the bank, all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from scipy.linalg import expm

from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.batch import Batch, Told
from vsensor_ros.observers.kinds.takagi_sugeno.sensor import ScheduledSensor
from vsensor_ros.observers.memberships import Weights
from vsensor_ros.reason import Reason

SETTLED = 0.05  # of the half-width: what is left of the start when it is ready
SURE = 2.0  # standard deviations in a half-width
_LONG = 3.0  # times the age on a line, in periods: at least its steps, on average over it


@dataclass(frozen=True, eq=False, kw_only=True)
class ScheduledBatch(Batch):
    """V of one output; a state is z, padded, the bound of e' S e and the time [s] it has run."""

    entries: tuple[ScheduledSensor, ...]
    weights: Weights
    period: float
    N: np.ndarray  # (V, submodels, k, k), padded with zeros as all below
    drive: np.ndarray  # (V, submodels, k, L + m)
    a: np.ndarray  # (V, submodels, k)
    first: np.ndarray  # (V, k + 2)
    row: np.ndarray  # (V, k)
    S: np.ndarray  # (V, k, k)
    Q: np.ndarray  # (V, L)
    fading: np.ndarray  # (V,) of what the bound is above 1, in a step
    pushes: np.ndarray  # (V, L) [1/s] how fast a wrong reading moves it, at most
    gains: np.ndarray  # (V, L) and how far in all

    def start(self, told: Told) -> np.ndarray:
        """Start in the middle of what is declared."""
        return self.first.copy()

    def step(self, z: np.ndarray, before: Told, after: Told,
             commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step exactly: matrices in the mean, what drives them as a straight line."""
        k = self.width - 2
        ends = [np.concatenate([told.y, u]) for told, u in zip((before, after), commands)]
        (h0, in0), (h1, in1) = (self.weights.at(end) for end in ends)
        g0, g1 = (np.einsum('vs,vsk->vk', h, self.drive @ end + self.a)
                  for h, end in zip((h0, h1), ends))
        M = np.zeros((len(z), k + 2, k + 2))
        N0, N1 = (np.einsum('vs,vskl->vkl', h, self.N) for h in (h0, h1))
        M[:, :k, :k] = (N0 + N1) / 2
        M[:, :k, k], M[:, :k, k + 1] = g1 - g0, g0
        M *= self.period
        M[:, k, k + 1] = 1.0
        inside = in0 & in1
        M[~(inside & np.isfinite(M).all(axis=(1, 2)))] = 0.0
        moved = expm(M)
        ended = (moved[:, :k, :k] @ z[:, :k, None])[:, :, 0] + moved[:, :k, k + 1]
        # what rises or falls in between, and maybe at one end of the step, is off by so much
        off = self.period / 2 * (g1 - g0 + ((N1 - N0) @ z[:, :k, None])[:, :, 0] + np.einsum(
            'vs,vskl,l->vk', h1, self.drive, self._further(before, after)))
        unseen = np.sqrt(np.einsum('vk,vkl,vl->v', off, self.S, off))
        bound = (np.sqrt(1.0 + (z[:, k] - 1.0) * self.fading) + unseen)**2
        ended = np.column_stack([ended, bound, z[:, k + 1] + self.period])
        return np.where(inside[:, None], ended, self.first), ~inside

    def _further(self, before: Told, after: Told) -> np.ndarray:
        """Return how much further (L + m,) readings may have gone than in steps between two."""
        longer = np.maximum(
            1.0, _LONG * np.maximum(before.ages, after.ages) / self.period) - 1.0
        return np.concatenate([longer * (after.y - before.y), np.zeros(len(after.held))])

    def _is_held(self, output: int, told: Told) -> bool:
        """Tell whether a reading it needs is held, or between two that are far apart."""
        L = len(told.ages)
        return bool((self.runs_on[output, :L] & (told.ages > self.period)).any())

    def estimates(self, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return Cv z + Q y0 of each."""
        return np.asarray((z[..., :-2] * self.row).sum(axis=-1) + y @ self.Q.T)

    def waiting(self, output: int, z: np.ndarray, age: float) -> float:
        """Count from when premises came back into their ranges: there it started again."""
        return max(0.0, float(self.warm_up[output] - z[output, -1]))

    def invalid(self, output: int, z: np.ndarray, told: Told, age: float) -> Reason | None:
        """Say nothing while premises are out of their ranges."""
        return self.weights.why_not(output, np.concatenate([told.y, told.held]))

    def outside_region(self, output: int, z: np.ndarray, told: Told) -> bool:
        """Tell whether premises are out of their ranges, or a reading is awaited."""
        return not self.weights.inside(output, np.concatenate([told.y, told.held])) \
            or self._is_held(output, told)

    def deviation(self, output: int, z: np.ndarray, told: Told, age: float) -> float:
        """Return what is left of the start, and what happened between readings."""
        width, settled = self._half_width(output, z), self.entries[output].half_width
        return math.sqrt(max(width * width - settled * settled, 0.0)) / SURE

    def interval(self, output: int, z: np.ndarray, told: Told,
                 age: float) -> tuple[float, float] | None:
        """Return the half-width to both sides; None where nothing is proved."""
        if self.outside_region(output, z, told):
            return None
        middle, width = float(self.estimates(z, told.y, told.held)[output]), self._half_width(
            output, z)
        return middle - width, middle + width

    def reach(self, slopes: np.ndarray, ages: np.ndarray, direct: bool = True,
              output: int | None = None) -> np.ndarray:
        """Return how far outputs may be off by what the form tells of readings that are wrong."""
        some = slice(None) if output is None else slice(output, output + 1)
        through = self.pushes[some] * ages * ages / 2
        if direct:
            through = np.abs(self.Q[some]) * ages + through
        reach = np.minimum(self.gains[some] * ages, through)
        moved: np.ndarray = np.where(reach > 0.0, reach * slopes, 0.0)
        return np.asarray(np.sqrt((moved * moved).sum(axis=1)))

    def _half_width(self, output: int, z: np.ndarray) -> float:
        entry = self.entries[output]
        grown = math.sqrt(max(1.0, float(z[output, -2])))
        return (entry.half_width - entry.direct) * grown + entry.direct


def make_batch(entries: Sequence[ScheduledSensor], design: Contents, period: float,
               Cu: np.ndarray | None) -> ScheduledBatch:
    """Stack them, padded to the largest."""
    L, m, V = len(design.sensors), len(design.inputs), len(entries)
    k, S = max(e.order for e in entries), max(len(e.N) for e in entries)
    N, drive = np.zeros((V, S, k, k)), np.zeros((V, S, k, L + m))
    form = np.zeros((V, k, k))
    a, first, row = np.zeros((V, S, k)), np.zeros((V, k + 2)), np.zeros((V, k))
    Q, needs, premises = np.zeros((V, L)), np.zeros((V, L + m), dtype=bool), []
    pushes = np.zeros((V, L))
    for i, e in enumerate(entries):
        s, n = e.N.shape[:2]
        columns = [design.sensors.index(name) for name in e.reads]
        N[i, :s, :n, :n], a[i, :s, :n], row[i, :n], Q[i, columns] = e.N, e.a, e.Cv[0], e.Q[0]
        drive[i, :s, :n, L:], form[i, :n, :n] = e.B, e.S
        premise = np.zeros((len(e.premises), L + m))
        premise[:, L:] = e.from_inputs
        for j, column in enumerate(columns):
            drive[i, :s, :n, column], premise[:, column] = e.J[:, :, j], e.from_readings[:, j]
        premises.append(premise)
        first[i, :n], first[i, -2] = e.initial, e.start
        pushes[i, columns] = _pushes(e)
        needs[i, columns] = True
        needs[i, [L + design.inputs.index(name) for name in e.commands]] = True
    decay = np.array([e.decay for e in entries])
    return ScheduledBatch(
        keys=tuple((e.fault_set, e.channel) for e in entries), of=np.arange(V), width=k + 2,
        runs_on=needs, starts_on=needs.copy(),
        own=np.array([design.sensors.index(e.channel) for e in entries], dtype=int),
        error=np.array([e.half_width / SURE for e in entries]), assumed=np.zeros(V, dtype=bool),
        slowest=1.0 / decay, warm_up=np.array([_until(e.start, e.decay) for e in entries]),
        proved=np.ones(V, dtype=bool), wants_held=True, wants_ages=True,
        entries=tuple(entries), period=period,
        weights=Weights(entries, premises, [e.turns for e in entries]), N=N, drive=drive, a=a,
        first=first, row=row, S=form, Q=Q, fading=np.exp(-2.0 * decay * period), pushes=pushes,
        gains=np.abs(Q) + pushes / decay[:, None])


def _pushes(entry: ScheduledSensor) -> np.ndarray:
    """Return how fast (r,) [1/s] readings wrong by 1 move what it says, by the form, at most."""
    root = np.linalg.cholesky(entry.S)
    return np.asarray(np.linalg.norm(np.linalg.solve(root, entry.Cv[0])) * np.linalg.norm(
        root.T @ entry.J, axis=1).max(axis=0))


def _until(bound: float, decay: float) -> float:
    """Return the time [s] until a bound of e' S e is 1, but for what does not matter."""
    left = (1.0 + SETTLED)**2 - 1.0
    return max(0.0, math.log(max(bound - 1.0, left) / left) / (2.0 * decay))
