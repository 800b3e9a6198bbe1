"""
Many machines of one plant at once, parameters a little wrong, and the residuals of a design.

The truth is integrated with the parameters of each machine, the virtual sensors run on the nominal
ones. Shapes: m machines, n states, l sensors, r checks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from vsensor_ros import design, load_plant, Plant
from vsensor_ros.observers import Residual, VirtualSensor
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

    They are those of the design that isolates, for all sets of up to three sensors.
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
    return residuals, observers


class Observers:
    """
    All virtual sensors of a design beside m machines: held commands, readings in between.

    They are stacked to one: K states, r outputs, S smooth terms and F of dry friction.
    """

    def __init__(self, sensors: list[VirtualSensor], names: tuple[str, ...], count: int) -> None:
        columns = [[names.index(name) for name in s.healthy] for s in sensors]
        steps = [_step(s) for s in sensors]
        self._e, self._held, self._rising = (
            block_diag(*(step[i] for step in steps)).T for i in range(3))
        self._J = np.vstack([_spread(s.J, at, len(names)) for s, at in zip(sensors, columns)]).T
        self._B, self._Phi = (np.vstack([getattr(s, key) for s in sensors]).T
                              for key in ('B', 'Phi'))
        self._Cv = block_diag(*(s.Cv[:1] for s in sensors)).T
        self._Q = np.vstack([_spread(s.Q[:1], at, len(names))
                             for s, at in zip(sensors, columns)]).T
        starts = np.cumsum([0, *(s.order for s in sensors)])
        terms: dict[bool, list[tuple[Floats, Floats, Floats, float]]] = {False: [], True: []}
        for s, at, start in zip(sensors, columns, starts):
            own = range(start, start + s.order)
            for a in s.active:
                terms[s.terms[a].text.startswith('sign')].append((
                    _spread(s.Gz[a][:1], own, starts[-1])[0],
                    _spread(s.Gy[a][:1], at, len(names))[0],
                    _spread(s.P[:, a][None], own, starts[-1])[0], float(s.terms[a].slope[0])))
        self._smooth, self._rubbing = (
            tuple(np.array(part).T for part in zip(*terms[which])) if terms[which] else None
            for which in (False, True))
        self._z = np.zeros((count, starts[-1]))
        self._before: Floats | None = None

    def start(self, state: Floats) -> None:
        """Begin with what the plant's state (m, n) is."""
        self._z = state @ self._Phi

    def step(self, readings: Floats, commands: Floats) -> Floats:
        """Go on to these readings (m, l), by the commands (m, i) held until now; (m, r)."""
        before = readings if self._before is None else self._before
        z = self._z @ self._e + (before @ self._J + commands @ self._B) @ self._held \
            + ((readings - before) @ self._J) @ self._rising
        if self._smooth is not None:
            now = self._flow(self._z, before)
            then = self._flow(z + now @ self._held, readings)
            z = z + (now + then) / 2 @ self._held
        if self._rubbing is not None:
            z = self._rubbed(z, readings)
        self._z, self._before = z, readings.copy()
        return z @ self._Cv + readings @ self._Q

    def _flow(self, z: Floats, y: Floats) -> Floats:
        """Return what square roots, less their addends, do to the states (m, K)."""
        Gz, Gy, P, slope = self._smooth
        argument = z @ Gz + y @ Gy
        return (_root(argument) - slope * argument) @ P.T

    def _rubbed(self, z: Floats, y: Floats) -> Floats:
        """Take dry friction off, implicitly in its argument where that is a state."""
        Gz, Gy, P, _ = self._rubbing
        argument = z @ Gz + y @ Gy
        slope = -PERIOD * (Gz * P).sum(axis=0)
        implicit = np.clip(argument / np.where(slope > 0.0, slope, 1.0), -1.0, 1.0)
        force = np.where(slope > 0.0, implicit, np.sign(argument))
        return z + PERIOD * force @ P.T


def _step(s: VirtualSensor) -> tuple[Floats, Floats, Floats]:
    """Return what a period does to the states, by themselves, held inputs and rising ones."""
    k = s.order
    whole = np.zeros((3 * k, 3 * k))
    whole[:k, :k], whole[:k, k:2 * k], whole[k:2 * k, 2 * k:] = (
        PERIOD * s.N, PERIOD * np.eye(k), np.eye(k))
    e = expm(whole)
    return e[:k, :k], e[:k, k:2 * k], e[:k, 2 * k:]


def _spread(part: Floats, columns: Sequence[int], width: int) -> Floats:
    """Return a matrix whose columns stand where they are told, among others that are 0."""
    whole = np.zeros((len(part), width))
    whole[:, list(columns)] = part
    return whole
