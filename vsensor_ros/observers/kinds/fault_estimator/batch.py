"""The fault observers of a design for the bank, all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.batch import Batch, Told
from vsensor_ros.observers.kinds.fault_estimator.sensor import FaultObserver
from vsensor_ros.observers.memberships import Weights
from vsensor_ros.reason import Reason

SETTLED = 0.05  # of the half-width: what is left of the start when it is ready
SURE = 2.0  # standard deviations in a half-width
_FAR = 0.8  # sample times from readings: so far one tick is at least where a sample is missing
_LONGEST = 5000  # steps that a wrong reading is followed


@dataclass(frozen=True, eq=False, kw_only=True)
class FaultBatch(Batch):
    """
    V observers of O outputs.

    A state is xb, padded, the bound of e' P e, the time [s] since the start, and that since it
    lacked a sample, in which all is as proved.
    """

    weights: Weights
    period: float  # s, the sample time
    N: np.ndarray  # (V, submodels, k, k), padded with zeros as all below
    drive: np.ndarray  # (V, submodels, k, L + m)
    T2: np.ndarray  # (V, k, L)
    first: np.ndarray  # (V, k + 3)
    from_first: np.ndarray  # (V, k, L)
    rows: np.ndarray  # (O, k)
    half_widths: np.ndarray  # (O,)
    left: np.ndarray  # (V,) of what the bound is above 1, after a step
    direct: np.ndarray  # (O, L) what a wrong reading does to outputs at once
    later: np.ndarray  # (O, L) the most that it does to them later
    in_all: np.ndarray  # (O, L) and in all, had it always been wrong

    def start(self, told: Told) -> np.ndarray:
        """Start from what healthy sensors say, in the middle of what is declared of the rest."""
        z = self.first.copy()
        z[:, :-3] += self.from_first @ told.y
        return z

    def step(self, z: np.ndarray, before: Told, after: Told,
             commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take the step of the submodels as they are blended at its beginning."""
        end = np.concatenate([before.y, before.held])
        h, inside = self.weights.at(end)
        moved = np.einsum('vs,vskl,vl->vk', h, self.N, z[:, :-3]) \
            + np.einsum('vs,vskl,l->vk', h, self.drive, end) + self.T2 @ after.y
        bound = 1.0 + (z[:, -3] - 1.0) * self.left
        since = np.where(self._missed(before) | self._missed(after), 0.0,
                         z[:, -1] + self.period)
        ended = np.column_stack([moved, bound, z[:, -2] + self.period, since])
        return np.where(inside[:, None], ended, self.start(after)), ~inside

    def _missed(self, told: Told) -> np.ndarray:
        """Tell (V,) whose readings are not all there, but held, or between two far apart."""
        old = told.ages > _FAR * self.period
        return np.asarray((self.runs_on[:, :len(old)] & old).any(axis=1))

    def estimates(self, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return Cv xb of each."""
        return np.asarray((z[..., self.of, :-3] * self.rows).sum(axis=-1))

    def waiting(self, output: int, z: np.ndarray, age: float) -> float:
        """Count from when premises came back into their ranges: there it started again."""
        return max(0.0, float(self.warm_up[output] - z[self.of[output], -2]))

    def invalid(self, output: int, z: np.ndarray, told: Told, age: float) -> Reason | None:
        """Say nothing while premises are out of their ranges."""
        return self.weights.why_not(self.of[output], np.concatenate([told.y, told.held]))

    def outside_region(self, output: int, z: np.ndarray, told: Told) -> bool:
        """Tell whether premises are out of their ranges, or a sample was missed of late."""
        i = self.of[output]
        since, run = z[i, -1], z[i, -2]
        return not self.weights.inside(i, np.concatenate([told.y, told.held])) \
            or bool(self._missed(told)[i] or since < min(run, self.warm_up[output]))

    def deviation(self, output: int, z: np.ndarray, told: Told, age: float) -> float:
        """Return what is left of the start."""
        return float(self.half_widths[output]) / SURE * math.sqrt(
            max(0.0, float(z[self.of[output], -3]) - 1.0))

    def interval(self, output: int, z: np.ndarray, told: Told,
                 age: float) -> tuple[float, float] | None:
        """Return the half-width to both sides; None where nothing is proved."""
        if self.outside_region(output, z, told):
            return None
        middle = float(self.estimates(z, told.y, told.held)[output])
        width = float(self.half_widths[output]) * math.sqrt(
            max(1.0, float(z[self.of[output], -3])))
        return middle - width, middle + width

    def reach(self, slopes: np.ndarray, ages: np.ndarray, direct: bool = True,
              output: int | None = None) -> np.ndarray:
        """Return how far outputs may be off; a reading that moves unseen is wrong by a ramp."""
        some = slice(None) if output is None else slice(output, output + 1)
        steps = ages / self.period
        off = self.later[some] * ages * (steps + 1.0) / 2.0
        if direct:
            off = off + self.direct[some] * ages
        off = np.minimum(off, self.in_all[some] * ages)
        moved: np.ndarray = np.where(off > 0.0, off * slopes, 0.0)
        return np.asarray(np.sqrt((moved * moved).sum(axis=1)))


def make_batch(entries: Sequence[FaultObserver], design: Contents, period: float,
               Cu: np.ndarray | None) -> FaultBatch:
    """Stack them, padded to the largest."""
    L, m, V = len(design.sensors), len(design.inputs), len(entries)
    k, S = max(e.order for e in entries), max(len(e.N) for e in entries)
    N, drive, T2 = np.zeros((V, S, k, k)), np.zeros((V, S, k, L + m)), np.zeros((V, k, L))
    first, from_first = np.zeros((V, k + 3)), np.zeros((V, k, L))
    needs, premises, rows, follow = np.zeros((V, L + m), dtype=bool), [], [], []
    for i, e in enumerate(entries):
        s, n = e.N.shape[:2]
        columns = [design.sensors.index(name) for name in e.reads]
        N[i, :s, :n, :n], drive[i, :s, :n, L:], T2[i][:n, columns] = e.N, e.M, e.T2
        first[i, :n], first[i, -3], from_first[i][:n, columns] = e.initial, e.start, e.from_first
        premise = np.zeros((len(e.premises), L + m))
        premise[:, L:] = e.from_inputs
        for j, column in enumerate(columns):
            drive[i, :s, :n, column], premise[:, column] = e.K[:, :, j], e.from_readings[:, j]
        premises.append(premise)
        rows.append(np.pad(e.Cv, ((0, 0), (0, k - n))))
        wide = np.zeros((3, len(e.outputs), L))
        wide[:, :, columns] = _followed(e)
        follow.append(wide)
        needs[i, columns] = True
        needs[i, [L + design.inputs.index(name) for name in e.commands]] = True
    of = np.repeat(np.arange(V), [len(e.outputs) for e in entries])
    keys = tuple((e.fault_set, name) for e in entries for name in e.outputs)
    direct, later, in_all = np.concatenate(follow, axis=1)
    return FaultBatch(
        keys=keys, of=of, width=k + 3, runs_on=needs, starts_on=needs.copy(),
        own=np.array([design.sensors.index(name) if name in design.sensors else -1
                      for _, name in keys], dtype=int),
        error=np.concatenate([e.deviations for e in entries]),
        assumed=np.zeros(len(of), dtype=bool),
        slowest=np.array([1.0 / e.decay for e in entries])[of],
        warm_up=np.array([_until(e) for e in entries])[of],
        proved=np.ones(len(of), dtype=bool), wants_held=True, wants_ages=True,
        period=period, weights=Weights(entries, premises), N=N, drive=drive, T2=T2, first=first,
        from_first=from_first,
        rows=np.concatenate(rows), half_widths=np.concatenate([e.half_widths for e in entries]),
        left=np.array([1.0 - e.alpha for e in entries]), direct=direct, later=later,
        in_all=in_all)


def _until(entry: FaultObserver) -> float:
    """Return the time [s] until the bound of e' P e is 1, but for what does not matter."""
    settled = (1.0 + SETTLED)**2 - 1.0
    return max(0.0, math.log(max(entry.start - 1.0, settled) / settled) / (2.0 * entry.decay))


def _followed(entry: FaultObserver) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what a reading wrong by 1 does at once, at most later, and in all, each (o, r)."""
    N, K = entry.N.mean(axis=0), entry.K.mean(axis=0)
    direct = abs(entry.Cv @ entry.T2)
    later, in_all = np.zeros_like(direct), direct.copy()
    state = N @ entry.T2 + K
    for _ in range(_LONGEST):
        now = abs(entry.Cv @ state)
        later, in_all = np.maximum(later, now), in_all + now
        if not (now > 1e-9 * in_all).any():
            break
        state = N @ state
    return direct, later, in_all
