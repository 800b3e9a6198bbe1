"""The virtual sensors of a design, stacked along a first axis V, over all L sensors of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from vsensor_ros.bank.convergence import (
    converge,
    Convergence,
    reading_gains,
    reading_pushes,
    Region,
    region_of,
)
from vsensor_ros.bank.step import make_step, pad, Step, widen
from vsensor_ros.observers import Design, VirtualSensor


@dataclass(frozen=True, eq=False)
class Stack:
    """What a bank needs of its V virtual sensors of one row each; commands are m."""

    keys: tuple[tuple[tuple[str, ...], str], ...]  # fault set and channel of each
    step: Step | None  # None: there is none
    Cu: np.ndarray | None  # (L, m) what is taken out of each reading; None: nothing
    z0: np.ndarray  # (V, k)
    z0_gain: np.ndarray  # (V, k, L)
    Cv: np.ndarray  # (V, k)
    Q: np.ndarray  # (V, L)
    Qu: np.ndarray | None  # (V, m); None: nothing reads a command directly
    runs_on: np.ndarray  # (V, L + m) bool: what each needs to run
    starts_on: np.ndarray  # (V, L + m) bool: and what it needs to start
    own: np.ndarray  # (V,) the sensor that it stands in for; -1: none
    gains: np.ndarray  # (V, L) peak over frequency of each reading's gain to vhat
    pushes: np.ndarray  # (V, L) 1/s, peak over time of vhat after an impulse of a reading in z
    convergence: tuple[Convergence, ...]
    regions: tuple[Region | None, ...]  # of the certificates, over all L readings
    error: np.ndarray  # (V,) steady-state standard deviation of the design; NaN: not known
    assumed: np.ndarray  # (V,) bool: made of default figures

    def estimates(self, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return vhat (.., V) for states (.., V, k), readings (.., L), commands (.., m)."""
        found = (self.Cv * z).sum(axis=-1) + y @ self.Q.T
        return found if self.Qu is None else found + held @ self.Qu.T

    def outside(self, row: int, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> bool:
        """Tell whether an argument of a virtual sensor is where nothing is proved of it."""
        region = self.regions[row]
        if region is None:
            return False
        w = region.Gz @ z[row, :region.Gz.shape[1]] + region.Gy @ y
        if held.size:
            w = w + region.Gu @ held
        return bool((w < region.low).any() or (w > region.high).any())

    def reach(self, slopes: np.ndarray, ages: np.ndarray, sample_time: float,
              direct: bool = True) -> np.ndarray:
        """
        Return how far vhat (V,) may be off when readings have moved unseen for these ages [s].

        Those of a reading that moves at its slope (L,) lead to an error of no more than the peak
        gain allows, and of no more than a ramp does through Q, if direct, and through z.
        """
        through = self.pushes * ages * (ages + sample_time) / 2
        if direct:
            through = np.abs(self.Q) * ages + through
        reach = np.minimum(self.gains * ages, through)
        moved: np.ndarray = np.where(reach > 0.0, reach * slopes, 0.0)
        return np.linalg.norm(moved, axis=1)


def make_stack(design: Design, period: float) -> Stack:
    """Stack all virtual sensors of one row, for steps of so many seconds."""
    sensors = design.sensors
    kept = [v for v in design.virtual_sensors if len(v.Cv) == 1]
    # a discrete plant's readings are of the instants at which its commands begin
    Cu = design.Cu if design.sample_time is None else None
    Cu = Cu if Cu is not None and Cu.any() else None
    clean = [v if Cu is None else _cleaned(v, Cu[[sensors.index(s) for s in v.healthy]])
             for v in kept]
    V, L, m = len(kept), len(sensors), len(design.inputs)
    k = max((v.order for v in kept), default=0)
    # pad one more and drop it, so that a design without virtual sensors has shapes, too
    z0_gain = pad([widen(v, sensors, v.z0_gain) for v in kept] + [np.zeros((k, L))])[:-1]
    runs_on = np.array([_needs(v, sensors) for v in kept], dtype=bool).reshape(V, L + m)
    starts_on = runs_on.copy()
    starts_on[:, :L] |= z0_gain.any(axis=1)
    direct = any(v.Qu.any() or any(v.Gu[i].any() for i in v.active) for v in clean)
    return Stack(
        tuple((v.fault_set, v.channel) for v in kept),
        make_step(clean, sensors, period) if kept else None, Cu,
        pad([v.z0 for v in kept] + [np.zeros(k)])[:-1], z0_gain,
        pad([v.Cv[0] for v in kept] + [np.zeros(k)])[:-1],
        pad([widen(v, sensors, v.Q[0]) for v in kept] + [np.zeros(L)])[:-1],
        np.array([v.Qu[0] for v in clean]) if direct else None, runs_on, starts_on,
        np.array([sensors.index(v.channel) if v.channel in sensors else -1 for v in kept],
                 dtype=int),
        pad([widen(v, sensors, reading_gains(v)) for v in kept] + [np.zeros(L)])[:-1],
        pad([widen(v, sensors, reading_pushes(v)) for v in kept] + [np.zeros(L)])[:-1],
        tuple(converge(v) for v in kept), tuple(_widened(v, sensors) for v in clean),
        np.array([np.nan if v.noise is None else v.noise.error for v in kept]),
        np.array([v.noise is None or v.noise.assumed for v in kept], dtype=bool))


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
