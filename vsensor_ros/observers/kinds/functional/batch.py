"""The functional observers of a design for the bank, stacked over all L sensors of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.batch import Batch, Bent, StepOfSome, Told, Tracked
from vsensor_ros.observers.kinds.functional.convergence import (
    converge,
    Convergence,
    reading_gains,
    reading_pushes,
    Region,
    region_of,
)
from vsensor_ros.observers.kinds.functional.step import make_step, pad, Step, step_of, widen
from vsensor_ros.observers.kinds.functional.tracking import deviation_after, tracker
from vsensor_ros.observers.kinds.functional.virtual_sensor import VirtualSensor
from vsensor_ros.reason import Reason

# s after which the drift of a free run is worked out; between them it is a straight line
_AFTER = np.concatenate([[0.0], np.geomspace(1e-3, 1e7, 161)])


@dataclass(frozen=True, eq=False, kw_only=True)
class FunctionalBatch(Batch):
    """V functional observers of one row each, so that O is V; commands are m."""

    fused: Step | None  # None: there is none
    z0: np.ndarray  # (R, k); NaN of those that do not start by themselves
    z0_gain: np.ndarray  # (R, k, L)
    Cv: np.ndarray  # (V, k)
    Q: np.ndarray  # (V, L)
    Qu: np.ndarray | None  # (V, m); None: nothing reads a command directly
    gains: np.ndarray  # (V, L) peak over frequency of each reading's gain to vhat
    pushes: np.ndarray  # (V, L) 1/s, peak over time of vhat after an impulse of a reading in z
    sample_time: float  # s; 0: continuous
    convergence: tuple[Convergence, ...]  # of temporary ones that of the tracker
    drifts: np.ndarray  # (tracked, after)
    bends: tuple[Bent | None, ...]  # of the tracked
    drifting: tuple[int, ...]  # which of the tracked a temporary one is; -1: it is none
    regions: tuple[Region | None, ...]  # of the certificates, over all L readings

    def start(self, told: Told) -> np.ndarray:
        """Return z0 + z0_gain y."""
        return np.asarray(self.z0 + self.z0_gain @ told.y)

    def step(self, z: np.ndarray, before: Told, after: Told,
             commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step all at once, see step.py."""
        assert self.fused is not None
        return _stepped(self.fused, z, before, after, commands)

    def step_of(self, rows: np.ndarray) -> StepOfSome:
        """Take their slices of all matrices."""
        assert self.fused is not None
        fused = step_of(self.fused, rows)
        return lambda z, before, after, commands: _stepped(fused, z, before, after, commands)

    def estimates(self, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return vhat (.., V) for states (.., V, k), readings (.., L), commands (.., m)."""
        found = (self.Cv * z).sum(axis=-1) + y @ self.Q.T
        return found if self.Qu is None else found + held @ self.Qu.T

    def estimate(self, output: int, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return vhat (..) of one."""
        found = (self.Cv[output] * z).sum(axis=-1) + y @ self.Q[output]
        return np.asarray(found if self.Qu is None else found + held @ self.Qu[output])

    def outside_region(self, output: int, z: np.ndarray, told: Told) -> bool:
        """Tell whether an argument of a virtual sensor is where nothing is proved of it."""
        region = self.regions[output]
        if region is None:
            return False
        w = region.Gz @ z[output, :region.Gz.shape[1]] + region.Gy @ told.y
        if told.held.size:
            w = w + region.Gu @ told.held
        return bool((w < region.low).any() or (w > region.high).any())

    def deviation(self, output: int, z: np.ndarray, told: Told, age: float) -> float:
        """Return what is left of the unknown start, or has come since that of a free run."""
        if self.drifting[output] >= 0:
            return float(self.drift(self.drifting[output], np.array(age)))
        return self.convergence[output].deviation(age)

    def drift(self, i: int, ages: np.ndarray) -> np.ndarray:
        """Return how far a free run has drifted off; beyond what is worked out, nobody knows."""
        return np.asarray(np.interp(ages, _AFTER, self.drifts[i], right=np.inf))

    def bent(self, i: int) -> Bent | None:
        """Return how the error of a free run grows where it has nonlinear terms."""
        return self.bends[i]

    def reach(self, slopes: np.ndarray, ages: np.ndarray, direct: bool = True,
              output: int | None = None) -> np.ndarray:
        """
        Return how far vhat (V,), or that of one (1,), may be off when readings have moved unseen.

        A reading that has moved at its slope for its age is wrong by slope x age. What vhat is off
        then has two bounds, and the smaller one counts: the peak gain times that; and what a ramp
        of this slope does at once, through Q (if direct), and through z.
        """
        some = slice(None) if output is None else slice(output, output + 1)
        through = self.pushes[some] * ages * (ages + self.sample_time) / 2
        if direct:
            through = np.abs(self.Q[some]) * ages + through
        reach = np.minimum(self.gains[some] * ages, through)
        moved: np.ndarray = np.where(reach > 0.0, reach * slopes, 0.0)
        return np.linalg.norm(moved, axis=1)


def make_batch(entries: Sequence[VirtualSensor], design: Contents, period: float,
               Cu: np.ndarray | None) -> FunctionalBatch:
    """Stack all virtual sensors of one row, for steps of so many seconds and clean readings."""
    sensors = design.sensors
    kept = [v for v in entries if len(v.Cv) == 1]
    trackers, free, tracked = _helpers(kept, sensors)
    runs = [*kept, *trackers, *free]
    clean = [v if Cu is None else _cleaned(v, Cu[[sensors.index(s) for s in v.healthy]])
             for v in runs]
    L, m = len(sensors), len(design.inputs)
    k = max((v.order for v in kept), default=0)
    # pad one more and drop it, so that a design without virtual sensors has shapes, too
    z0 = pad([v.z0 for v in runs] + [np.zeros(k)])[:-1]
    z0[[t.free for t in tracked]] = np.nan
    z0_gain = pad([widen(v, sensors, v.z0_gain) for v in runs] + [np.zeros((k, L))])[:-1]
    runs_on = np.array([_needs(v, sensors) for v in runs], dtype=bool).reshape(len(runs), L + m)
    starts_on = runs_on.copy()
    starts_on[:, :L] |= z0_gain.any(axis=1)
    serving = clean[:len(kept)]
    direct = any(v.Qu.any() or any(v.Gu[i].any() for i in v.active) for v in clean)
    temporary = {t.own: i for i, t in enumerate(tracked) if t.temporary}
    convergence = tuple(converge(trackers[temporary[i]] if i in temporary else v)
                        for i, v in enumerate(kept))
    regions = tuple(_widened(v, sensors) for v in serving)
    return FunctionalBatch(
        keys=tuple((v.fault_set, v.channel) for v in kept),
        of=np.arange(len(kept)),
        width=k,
        runs_on=runs_on,
        starts_on=starts_on,
        own=np.array([sensors.index(v.channel) if v.channel in sensors else -1 for v in kept],
                     dtype=int),
        error=np.array([0.0 if i in temporary else np.nan if v.noise is None else v.noise.error
                        for i, v in enumerate(kept)]),
        assumed=np.array([i not in temporary and (v.noise is None or v.noise.assumed)
                          for i, v in enumerate(kept)], dtype=bool),
        slowest=np.array([c.slowest for c in convergence]),
        warm_up=np.array([c.warm_up for c in convergence]),
        proved=np.array([c.proved for c in convergence], dtype=bool),
        wants_held=direct or any(r is not None and r.Gu.any() for r in regions),
        tracked=tracked,
        left_out={(v.fault_set, v.channel): Reason.of(
            'several rows', channel=v.channel, rows=len(v.Cv)) for v in entries if len(v.Cv) > 1},
        fused=make_step(clean, sensors, period) if kept else None,
        z0=z0,
        z0_gain=z0_gain,
        Cv=pad([v.Cv[0] for v in kept] + [np.zeros(k)])[:-1],
        Q=pad([widen(v, sensors, v.Q[0]) for v in kept] + [np.zeros(L)])[:-1],
        Qu=np.array([v.Qu[0] for v in serving]) if direct else None,
        # what a temporary one felt it may keep
        gains=pad([np.full(L, np.inf) if i in temporary else widen(v, sensors, reading_gains(v))
                   for i, v in enumerate(kept)] + [np.zeros(L)])[:-1],
        pushes=pad([widen(v, sensors, reading_pushes(v)) for v in kept] + [np.zeros(L)])[:-1],
        sample_time=design.sample_time or 0.0,
        convergence=convergence,
        drifts=np.array([deviation_after(kept[t.own], _AFTER) for t in tracked]),
        bends=tuple(_bent(kept[t.own], period) for t in tracked),
        drifting=tuple(temporary.get(i, -1) for i in range(len(kept))),
        regions=regions)


def _stepped(step: Step, z: np.ndarray, before: Told, after: Told,
             commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    start, end, mean = commands
    return step(z, before.y, after.y, start, end, mean, before.held, after.held)


def _bent(v: VirtualSensor, period: float) -> Bent | None:
    if not v.active:
        return None
    assert v.tracking is not None
    step = period if v.sample_time is None else 1.0
    return Bent(v.tracking.P, step * v.tracking.W, v.Cv[0], v.tracking.direct)


def _helpers(kept: Sequence[VirtualSensor], sensors: tuple[str, ...],
             ) -> tuple[list[VirtualSensor], list[VirtualSensor], tuple[Tracked, ...]]:
    """Return the trackers, the free runs of those that run alone, too, and where they stand."""
    rows = [i for i, v in enumerate(kept) if v.tracking is not None]
    trackers = [tracker(kept[i]) for i in rows]
    free: list[VirtualSensor] = []
    tracked: list[Tracked] = []
    for row, v in zip(rows, trackers):
        own = kept[row]
        assert own.tracking is not None
        at = row
        if own.grade != 'temporary':
            at = len(kept) + len(rows) + len(free)
            free.append(own)
        tracked.append(Tracked(row, len(kept) + len(tracked), at, tuple(
            sensors.index(name) for name in own.tracking.channels), converge(v).warm_up))
    return trackers, free, tuple(tracked)


def _widened(v: VirtualSensor, sensors: tuple[str, ...]) -> Region | None:
    region = region_of(v)
    return None if region is None else region._replace(Gy=widen(v, sensors, region.Gy))


def _cleaned(v: VirtualSensor, Cu0: np.ndarray) -> VirtualSensor:
    """Rewrite v for readings C0 x, out of which the bank has taken Cu0 u (l0, m) itself."""
    def added(now: np.ndarray, gain: np.ndarray) -> np.ndarray:
        more = gain @ Cu0
        return np.where(np.abs(now + more) < 1e-12 * (np.abs(now) + np.abs(more)), 0.0, now + more)
    return replace(v, B=added(v.B, v.J), Qu=added(v.Qu, v.Q),
                   Gu=tuple(added(gu, gy) for gu, gy in zip(v.Gu, v.Gy)))


def _needs(v: VirtualSensor, sensors: Iterable[str]) -> list[bool]:
    """Tell which sensors, then which commands, v cannot run without."""
    return [name in v.reads for name in sensors] + [name in v.commands for name in v.inputs]
