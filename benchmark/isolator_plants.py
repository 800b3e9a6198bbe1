"""
Many machines of one plant at once, parameters a little wrong, and the residuals of a design.

The truth is integrated with the parameters of each machine, the virtual sensors run on the nominal
ones. Shapes: m machines, n states, l sensors, r checks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from vsensor_ros import design, load_plant, Plant
from vsensor_ros.designer.dedicated import dedicated, innovations
from vsensor_ros.designer.residuals import residual
from vsensor_ros.observers import NONE, Residual, VirtualSensor
from vsensor_ros.observers.kinds.functional.tracking import tracker

PERIOD = 0.01  # s
CONFIG = Path(__file__).resolve().parents[1] / 'config'

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A plant of the study: how its truth moves, and by which commands and unknown inputs."""

    name: str
    plant: Plant
    step: Callable[[Floats, Floats, Floats, Floats], Floats]  # x, u, rho, parameters -> next x
    parameters: Floats  # (p,) nominal
    start: Floats  # (n,)
    noise: Floats  # (l,) standard deviation of a reading
    command: tuple[tuple[float, float], ...]  # mean and amplitude of each input
    unknown: tuple[float, ...]  # amplitude of each unknown input
    # what of its faults stays visible, by this plant and the virtual sensors of its design
    isolable: tuple[str, ...] = ()


def servo_step(x: Floats, u: Floats, rho: Floats, k: Floats) -> Floats:
    """Move the servo by a period: implicit in the friction, four small steps."""
    h = PERIOD / 4
    angle, velocity, current = x.T
    for _ in range(4):
        turned = angle + h * (k[:, 0] * velocity + rho[:, 0])
        free = velocity + h * (k[:, 1] * velocity + k[:, 2] * current)
        slowed = np.sign(free) * np.maximum(np.abs(free) + h * k[:, 6], 0.0)
        current = current + h * (k[:, 3] * velocity + k[:, 4] * current + k[:, 5] * u[:, 0])
        angle, velocity = turned, slowed
    return np.stack([angle, velocity, current], axis=1)


def _root(x: Floats) -> Floats:
    return np.sign(x) * np.sqrt(np.abs(x))


def tank_step(x: Floats, u: Floats, rho: Floats, p: Floats) -> Floats:
    """Move the three tanks by a period, by the midpoint rule in two steps."""
    def rate(x: Floats) -> Floats:
        first = p[:, 3] * _root(x[:, 0] - x[:, 1])
        second = p[:, 4] * _root(x[:, 1] - x[:, 2])
        third = p[:, 5] * _root(x[:, 2])
        return np.stack([u[:, 0] / p[:, 0] - first, u[:, 1] / p[:, 1] + first - second,
                         second - third], axis=1)
    h = PERIOD / 2
    for _ in range(2):
        x = x + h * rate(x + h / 2 * rate(x))
    return x


def drive_matrices(p: Floats) -> tuple[Floats, Floats, Floats]:
    """Return A (.., 5, 5), B (.., 5, 1), D (.., 5, 1) of a drive with an elastic shaft."""
    motor, load, stiff, damp, drag, torque, resist, coil, back = np.moveaxis(p, -1, 0)
    a = np.zeros((*p.shape[:-1], 5, 5))
    a[..., 0, 0], a[..., 0, 1] = -(drag + damp) / motor, -stiff / motor
    a[..., 0, 2], a[..., 0, 4] = damp / motor, torque / motor
    a[..., 1, 0], a[..., 1, 2] = 1.0, -1.0
    a[..., 2, 0], a[..., 2, 1], a[..., 2, 2] = damp / load, stiff / load, -(drag + damp) / load
    a[..., 3, 2] = 1.0
    a[..., 4, 0], a[..., 4, 4] = -back / coil, -resist / coil
    b, d = np.zeros((*p.shape[:-1], 5, 1)), np.zeros((*p.shape[:-1], 5, 1))
    b[..., 4, 0], d[..., 2, 0] = 1.0 / coil, 1.0 / load
    return a, b, d


def drive_step(x: Floats, u: Floats, rho: Floats, p: Floats) -> Floats:
    """Move the drive by a period, in one exact step with held inputs."""
    return np.einsum('mij,mj->mi', p[:, :25].reshape(-1, 5, 5), x) + p[:, 25:30] * u \
        + p[:, 30:35] * rho


DRIVE = np.array([0.01, 0.02, 0.5, 0.01, 0.01, 0.1, 1.0, 0.02, 0.1])


def drive_plant() -> Plant:
    """Return the drive: motor speed, twist, load speed, angle, current; unknown load."""
    a, b, d = drive_matrices(DRIVE)
    c = np.eye(5)[[0, 2, 3, 4]]
    return Plant.from_matrices(
        a, b, c, D=d, states=('w1', 'twist', 'w2', 'turned', 'amps'), inputs=('volts',),
        sensors=('speed1', 'speed2', 'angle', 'current'), disturbances=('load',),
        noise=(0.05, 0.05, 0.005, 0.02), name='drive')


def exact(p: Floats) -> Floats:
    """Return the drive's discrete matrices of each row of parameters (m, 35)."""
    rows = []
    for a, b, d in zip(*drive_matrices(p)):
        whole = np.zeros((7, 7))
        whole[:5] = np.hstack([a, b, d])
        step = expm(PERIOD * whole)[:5]
        rows.append(np.concatenate([step[:, :5].ravel(), step[:, 5], step[:, 6]]))
    return np.array(rows)


def cases() -> tuple[Case, ...]:
    """Return the three plants of the study."""
    return (
        Case('servo', load_plant(CONFIG / 'servo' / 'plant.yaml'), servo_step,
             np.array([1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0]), np.zeros(3),
             np.array([0.01, 0.01, 0.01]), ((0.0, 3.0),), (0.3,), ('y2', 'y3')),
        Case('tank', load_plant(CONFIG / 'three_tank' / 'plant.yaml'), tank_step,
             np.ones(6), np.array([0.75, 0.5, 0.25]), np.array([0.005, 0.005]),
             ((0.6, 0.2), (0.2, 0.1)), (), ('y1', 'y2')),
        Case('drive', drive_plant(), drive_step, DRIVE, np.zeros(5),
             np.array([0.05, 0.05, 0.005, 0.02]), ((0.0, 3.0),), (0.1,),
             ('speed1', 'speed2', 'current')))


class Machines:
    """Machines of one case, each with parameters that err by `error` (0.02: up to 2 %)."""

    def __init__(self, case: Case, count: int, error: float, seed: int, motion: float = 1.0,
                 ) -> None:
        self.case, self.random = case, np.random.default_rng(seed)
        wrong = 1.0 + error * self.random.uniform(-1.0, 1.0, (count, len(case.parameters)))
        self.parameters = case.parameters * wrong
        if case.name == 'drive':
            self.parameters = exact(self.parameters)
        self.x = np.tile(case.start, (count, 1))
        inputs = len(case.command) + len(case.unknown)
        self._rates = 2 * np.pi / np.exp(self.random.uniform(
            np.log(2.0), np.log(40.0), (3, count, inputs)))
        self._phases = self.random.uniform(0.0, 2 * np.pi, (3, count, inputs))
        self._mean = np.array([mean for mean, _ in case.command] + [0.0] * len(case.unknown))
        self._size = np.array([size for _, size in case.command] + list(case.unknown))
        self._outputs = case.plant.C
        self.motion = motion
        self.tick = 0

    def step(self) -> tuple[Floats, Floats]:
        """Move all by a period; return healthy readings (m, l) and the commands held so far."""
        time = self.tick * PERIOD
        waves = np.sin(self._rates * time + self._phases).sum(0) / 1.7
        given = self._mean + self.motion * self._size * waves
        commands = given[:, :len(self.case.command)]
        self.x = self.case.step(self.x, commands, given[:, len(self.case.command):],
                                self.parameters)
        self.tick += 1
        noise = self.case.noise * self.random.standard_normal((len(self.x), len(self._outputs)))
        return self.x @ self._outputs.T + noise, commands


def bank_of(case: Case) -> tuple[list[Residual], list[VirtualSensor]]:
    """
    Return the residuals of a case, and the observer of each as it runs for its residual.

    Those of the design that isolates, for all sets of up to three sensors. And for each sensor the
    dedicated filter that reads all others: designed or not, because it is quick.
    """
    sensors = case.plant.sensors
    made = design(case.plant, [s for size in (1, 2, 3) for s in combinations(sensors, size)
                               if size <= len(sensors)], isolate=True)
    assert made.isolability is not None
    entries, residuals = made.isolating().entries, list(made.isolability.residuals)
    observers = []
    for r in residuals:
        entry = entries[r.fault_set, r.channel]
        assert isinstance(entry, VirtualSensor)
        observers.append(tracker(entry) if entry.grade == 'temporary' else entry)
    for sensor in sensors:
        shown = {d.sensor: d.strength for d in made.isolability.plant
                 if d.others == (sensor,) and d.strength != NONE}
        of = innovations(case.plant, (sensor,)) if shown else None
        for entry in dedicated(of, shown) if of else ():
            if entry.channel not in made.isolability.filters:
                observers.append(entry)
                residuals.append(residual(case.plant, entry))
    return residuals, observers


class Observers:
    """All virtual sensors of a design beside m machines: held commands, readings in between."""

    def __init__(self, sensors: list[VirtualSensor], names: tuple[str, ...], count: int) -> None:
        self.sensors, self._states = sensors, [np.zeros((count, s.order)) for s in sensors]
        self._columns = [[names.index(name) for name in s.healthy] for s in sensors]
        self._steps = []
        for s in sensors:
            k = s.order
            whole = np.zeros((3 * k, 3 * k))
            whole[:k, :k], whole[:k, k:2 * k], whole[k:2 * k, 2 * k:] = (
                PERIOD * s.N, PERIOD * np.eye(k), np.eye(k))
            e = expm(whole)
            self._steps.append((e[:k, :k].T, e[:k, k:2 * k].T, e[:k, 2 * k:].T))
        self._before: Floats | None = None

    def start(self, state: Floats) -> None:
        """Begin with what the plant's state (m, n) is."""
        self._states = [state @ s.Phi.T for s in self.sensors]

    def step(self, readings: Floats, commands: Floats) -> Floats:
        """Go on to these readings (m, l), by the commands (m, i) held until now; (m, r)."""
        before = readings if self._before is None else self._before
        said = np.empty((len(readings), len(self.sensors)))
        for i, (s, columns, (e, held, rising)) in enumerate(
                zip(self.sensors, self._columns, self._steps)):
            z, y0, y1 = self._states[i], before[:, columns], readings[:, columns]
            z1 = z @ e + (y0 @ s.J.T + commands @ s.B.T) @ held + ((y1 - y0) @ s.J.T) @ rising
            smooth = [a for a in s.active if not s.terms[a].text.startswith('sign')]
            if smooth:
                now = sum(self._flow(s, a, z, y0) for a in smooth)
                guess = z1 + now @ held
                then = sum(self._flow(s, a, guess, y1) for a in smooth)
                z1 = z1 + (now + then) / 2 @ held
            for a in s.active:
                if a not in smooth:
                    z1 = self._rubbed(s, a, z1, y1)
            self._states[i] = z1
            said[:, i] = z1 @ s.Cv[0] + y1 @ s.Q[0]
        self._before = readings.copy()
        return said

    @staticmethod
    def _flow(s: VirtualSensor, a: int, z: Floats, y: Floats) -> Floats:
        """Return what a square root, less its addend, does to the states (m, k)."""
        argument = z @ s.Gz[a][0] + y @ s.Gy[a][0]
        return np.outer(_root(argument) - s.terms[a].slope[0] * argument, s.P[:, a])

    @staticmethod
    def _rubbed(s: VirtualSensor, a: int, z: Floats, y: Floats) -> Floats:
        """Take dry friction off, implicitly in its argument."""
        argument = z @ s.Gz[a][0] + y @ s.Gy[a][0]
        slope = -float(s.Gz[a][0] @ s.P[:, a]) * PERIOD
        if slope <= 0.0:  # a measured argument
            return z + PERIOD * np.outer(np.sign(argument), s.P[:, a])
        force = np.clip(argument / slope, -1.0, 1.0)
        return z + PERIOD * np.outer(force, s.P[:, a])
