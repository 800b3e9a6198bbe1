"""The isolator beside many machines at once: learning, then a fault in each, and what is said."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from benchmark.isolator_peer import Peer
from benchmark.isolator_plants import bank_of, Case, Floats, Machines, Observers, PERIOD
from vsensor_ros.isolator.detector import Bools, TESTS
from vsensor_ros.isolator.diagnosis import Diagnosis
from vsensor_ros.isolator.recovery import Recovery
from vsensor_ros.isolator.watch import Watch

WANTED = 1 / 86400.0  # false alarms a second, of one machine
CLEARED = 60.0  # s after an alarm, when somebody says that the machine is healthy
GRAVE = ('suspected', 'model', 'blamed')  # states, the gravest last

Told = tuple[float, int, str]  # s, machine, state


@dataclass(frozen=True)
class Faults:
    """One fault in each machine: which sensor, what, since when [s from now], how large."""

    sensor: NDArray[np.int64]
    kind: str  # bias, drift, noise, freeze or ''
    start: Floats
    size: Floats  # of a bias in units of the sensor, of a drift a second, of noise as a factor
    end: float = np.inf

    def put(self, readings: Floats, before: Floats, time: float, noise: Floats, random: Floats,
            ) -> Floats:
        """Return what the drivers say (m, l) instead of the readings; before: what they said."""
        said = readings.copy()
        rows = np.arange(len(said))
        on = (time >= self.start) & (time < self.end)
        here = readings[rows, self.sensor]
        if self.kind == 'bias':
            here = here + self.size
        elif self.kind == 'drift':
            here = here + self.size * (time - self.start)
        elif self.kind == 'noise':
            here = here + noise[self.sensor] * random * np.sqrt(self.size**2 - 1.0)
        elif self.kind == 'freeze':
            here = before[rows, self.sensor]
        said[rows, self.sensor] = np.where(on, here, readings[rows, self.sensor])
        return said


@dataclass(frozen=True)
class Outcome:
    """What became of each machine: when and whom the isolator blamed first; NaN, -1: nobody."""

    time: Floats  # s since the fault
    sensor: NDArray[np.int64]
    wrong: int  # machines in which ever another sensor was blamed
    believed: int  # that would have been believed again, while the fault still was there
    peer_sensor: NDArray[np.int64]  # whom the peer blamed first
    peer_time: Floats  # s since the fault


class Alarms:
    """False alarms of many machines, each counted once."""

    def __init__(self) -> None:
        self.open: dict[int, tuple[float, str]] = {}  # machine: since when, the gravest state
        self.over: list[Told] = []

    def take(self, now: float, machine: int, state: str) -> bool:
        """Take what is said of a machine, '': nothing; tell whether it is cleared now."""
        if state:
            since, known = self.open.get(machine, (now, state))
            self.open[machine] = since, max(known, state, key=GRAVE.index)
        cleared = bool(state) and now - self.open[machine][0] >= CLEARED
        if cleared or not state and machine in self.open:
            since, known = self.open.pop(machine)
            self.over.append((since, machine, known))
        return cleared

    def all(self) -> list[Told]:
        """Return all, those that stand, too."""
        return sorted([*self.over, *((since, m, state) for m, (since, state)
                                     in self.open.items())])


def _state(diagnosis: Diagnosis) -> str:
    return ('model' if diagnosis.model else 'blamed' if diagnosis.found else
            'suspected' if diagnosis.candidates else '')


class Fleet:
    """Machines of a case, their virtual sensors, and an isolator for each."""

    def __init__(self, case: Case, count: int, error: float, seed: int) -> None:
        self.case, self.count = case, count
        self.sensors = case.plant.sensors
        self.checks, observers = bank_of(case)
        self.machines = Machines(case, count, error, seed)
        self.observers = Observers(observers, self.sensors, count)
        self.observers.start(self.machines.x)
        r, c = len(self.checks), len(self.sensors)
        own = np.array([self.sensors.index(i.channel) if i.channel in self.sensors else -1
                        for i in self.checks])
        support = np.array([[name in i.support for name in self.sensors] for i in self.checks])
        self.supports = [sum(1 << int(j) for j in np.flatnonzero(row)) for row in support]
        best = np.array([min(np.flatnonzero(own == j), default=-1,
                             key=lambda i: support[i].sum()) for j in range(c)])
        gains = np.array([[check.motion().get(name, 0.0) for name in self.sensors]
                          for check in self.checks])
        at, each = np.arange(count)[:, None], np.eye(count)
        self.watch = Watch(
            PERIOD, np.where(own < 0, -1, own + c * at).ravel(), np.kron(each, support) > 0.0,
            np.kron(each, gains), np.tile([i.noise for i in self.checks], count),
            np.where(best < 0, -1, best + r * at).ravel(), WANTED / (TESTS * r), 0.1)
        self.diagnoses = [Diagnosis(self.supports) for _ in range(count)]
        self.readings = np.zeros((self.watch.batch, count, c))
        self.estimates = np.zeros((self.watch.batch, count, r))
        self.ticks = 0
        self.busy: set[int] = set()
        self.random = np.random.default_rng(seed + 10**6)
        self.said = np.zeros((count, c))

    def copy(self) -> Fleet:
        """Return a fleet that has learnt the same."""
        return deepcopy(self)

    def tick(self, faults: Faults | None = None, time: float = 0.0) -> bool:
        """Go on by a period; tell whether a batch was full and judged."""
        readings, self.commands = self.machines.step()
        if faults is not None:
            readings = faults.put(readings, self.said, time, self.case.noise,
                                  self.random.standard_normal(self.count))
        self.said = readings
        place = self.ticks % self.watch.batch
        self.readings[place] = readings
        self.estimates[place] = self.observers.step(readings, self.commands)
        self.ticks += 1
        if self.ticks % self.watch.batch:
            return False
        self._judge()
        return True

    def _judge(self) -> None:
        r, c = len(self.checks), len(self.sensors)
        healthy = np.ones(self.count, dtype=bool)
        healthy[list(self.busy)] = False
        alarms = self.watch.step(self.readings.reshape(-1, self.count * c),
                                 self.estimates.reshape(-1, self.count * r),
                                 np.repeat(healthy, r), np.repeat(healthy, c))
        self.alarms = alarms.reshape(self.count, r)
        channels = self.watch.channels
        direct = channels.stuck(self.watch.said) | channels.dropped() | channels.noisy()
        self.direct = direct.reshape(self.count, c)
        running = self.watch.detector.filled.reshape(self.count, r) > 16
        now = self.ticks * PERIOD
        stepped = cache(channels.stepped)
        for m in self.busy | set(np.flatnonzero(self.alarms.any(1) | self.direct.any(1))):
            diagnosis = self.diagnoses[m]
            excusable = diagnosis.excusable()
            diagnosis.update(now, self.alarms[m], running[m],
                             [1 << int(j) for j in np.flatnonzero(self.direct[m])],
                             partial(self._stepped, m, stepped))
            if not diagnosis.stands and self.watch.detector.full(
                    m * len(self.checks) + excusable):
                self._admit(m, excusable)
            (self.busy.add if diagnosis.stands else self.busy.discard)(m)

    def _stepped(self, machine: int, stepped: Callable[[], Bools]) -> list[int]:
        return [1 << int(j) for j in np.flatnonzero(stepped().reshape(self.count, -1)[machine])]

    def _admit(self, machine: int, checks: NDArray[np.int64]) -> None:
        if checks.size:
            self.watch.detector.admit(machine * len(self.checks) + checks)
            self.watch.detector.restart(machine * len(self.checks) + checks)

    def healthy(self, seconds: float, compare: bool = True) -> tuple[list[Told], list[Told]]:
        """
        Run without faults; return the false alarms, and those of the peer if it is to run, too.

        Whatever is said from the first word to the last is one alarm, of the gravest state. Who
        looks after the machine says CLEARED after the first word that it is healthy; what is told
        then is another alarm. The peer starts anew then.
        """
        told = [Alarms(), Alarms()]
        peer = Peer(self.case, self.machines.x) if compare else None
        for _ in range(round(seconds / PERIOD)):
            judged, now = self.tick(), self.ticks * PERIOD
            if peer is not None:
                rejected = peer.step(self.said, self.commands).any(axis=1)
                for m in told[1].open.keys() | set(np.flatnonzero(rejected).tolist()):
                    if told[1].take(now, m, 'blamed' if rejected[m] else ''):
                        peer.start(m, self.machines.x[m])
            if judged:
                for m in self.busy | told[0].open.keys():
                    if told[0].take(now, m, _state(self.diagnoses[m])):
                        self._clear(m, now)
        return told[0].all(), told[1].all()

    def _clear(self, machine: int, now: float) -> None:
        """Do what the isolator does when everybody who was named is cleared."""
        diagnosis, r = self.diagnoses[machine], len(self.checks)
        excusable = diagnosis.excusable()
        if excusable.size:
            diagnosis.dismiss(now)
            self._admit(machine, excusable)
        else:
            for j in range(len(self.sensors)):
                diagnosis.forgive(1 << j, now, np.ones(r, dtype=bool))
        self.watch.detector.restart(np.arange(machine * r, (machine + 1) * r))
        self.busy.discard(machine)

    def campaign(self, faults: Faults, seconds: float, dwell: float = 10.0) -> Outcome:
        """Let each machine have its fault; return what was said of it, by the peer, too."""
        time, peer_time = np.full(self.count, np.nan), np.full(self.count, np.nan)
        first, peer_first = np.full(self.count, -1), np.full(self.count, -1)
        wrong: set[int] = set()
        recoveries: dict[int, Recovery] = {}
        believed: set[int] = set()
        peer = Peer(self.case, self.machines.x)
        for k in range(round(seconds / PERIOD)):
            now = k * PERIOD
            judged = self.tick(faults, now)
            for m, j in zip(*np.nonzero(peer.step(self.said, self.commands))):
                if peer_first[m] < 0:
                    peer_first[m], peer_time[m] = j, now - faults.start[m]
            if not judged:
                continue
            levels = self.watch.detector.level(16)
            noisy = self.watch.channels.noisy().reshape(self.count, -1)
            runs = self.watch.channels.run.reshape(self.count, -1)
            for m in self.busy:
                d, since = self.diagnoses[m], now - faults.start[m]
                for s in d.found:
                    sensor = s.bit_length() - 1
                    if first[m] < 0:
                        first[m], time[m] = sensor, since
                    if sensor != faults.sensor[m]:
                        wrong.add(m)
                j = faults.sensor[m]
                if 1 << int(j) in d.found:
                    best = int(self.watch.best.reshape(self.count, -1)[m, j])
                    deviation = None if best < 0 else levels[best] - self.watch.centre(best)
                    recovery = recoveries.setdefault(m, Recovery(dwell))
                    if recovery.step(now, deviation, not (noisy[m, j] or runs[m, j]),
                                     faults.kind in ('bias', 'drift')) and now < faults.end:
                        believed.add(m)
        return Outcome(time, first, len(wrong), len(believed), peer_first, peer_time)
