"""A plant as the `simulation` of a scenario drives it: open loop, or closed by its commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import compile_expression, names
from vsensor_ros.plant import Plant
from vsensor_ros.simulate.fault import Recorded
from vsensor_ros.simulate.section import Section
from vsensor_ros.simulate.simulate import readings, simulate

Array = NDArray[np.float64]
Law = Callable[[Any, Array], Array]     # times (T,), states (n, T) or (n, 1) -> commands (T, m)

HOLD = ('give inputs that hold the plant, such as `force: -30*angle - 8*rate`: they may read t '
        'and the states')
DRIVE = frozenset({'duration', 'sensor_rate', 'command_rate', 'inputs', 'initial', 'disturbances',
                   'noise'})  # what may stand in `simulation`
LARGEST = 1e12  # no machine is commanded more, in any unit


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A plant that has run; times in s, values in the channels' units."""

    time: Array                     # (T,)
    readings: Mapping[str, Array]   # (T,) by sensor, without noise
    commands: dict[str, Recorded]    # by input, a row each time it may change


@dataclass(frozen=True, eq=False)
class Drive:
    """What moves a plant, and how its sensors read it."""

    where: str
    sensor_rate: float      # Hz
    command_rate: float     # Hz, held in between
    law: Law
    closed: bool            # the commands read the states
    disturbances: Callable[[Any], Array]    # times (T,) -> (T, d), a time -> (d,)
    initial: list[float]
    noise: Mapping[str, float]      # standard deviation by sensor

    def run(self, plant: Plant, t: Array) -> Trajectory:
        """Run the plant at times `t` [s] (T,), evenly spaced; raise BadInput if it cannot."""
        steps = np.floor(t * self.command_rate + 1e-9)
        first = np.unique(steps, return_index=True)[1]     # rows at which commands change
        # a continuous plant follows the unknown inputs, a discrete one sees them at its samples
        rho = self.disturbances if plant.sample_time is None else self.disturbances(t)
        try:
            with np.errstate(all='ignore'):     # what is not finite is refused below
                if self.closed:
                    x, u = self._closed_loop(plant, t, first, rho)
                else:
                    u = self._commands(plant, steps / self.command_rate, np.empty((0, 1)))
                    x = simulate(plant, t, u, rho, self.initial)
                y = readings(plant, t, x, u, rho)
        except ArithmeticError as error:
            raise BadInput(self.where, 'simulation', f'does not go on: {error}',
                           'give inputs that it can follow') from None
        if not np.isfinite(y).all():
            raise BadInput(self.where, 'simulation', f'{plant.name} runs away', HOLD)
        return Trajectory(t, dict(zip(plant.sensors, y.T)),
                   {n: Recorded.of(t[first], v[first]) for n, v in zip(plant.inputs, u.T)})

    def _commands(self, plant: Plant, t: Array, x: Array) -> Array:
        """Return the commands (T, m) that the law gives; raise BadInput if one has no bound."""
        u = self.law(t, x)
        beyond = np.argwhere(~(np.abs(u) <= LARGEST))
        if len(beyond):
            row, i = beyond[0]
            raise BadInput(self.where, f'simulation.inputs.{plant.inputs[i]}',
                           f'is {u[row, i]:.3g} at t = {t[row]:g} s',
                           HOLD if self.closed else 'give one that stays within bounds')
        return u

    def _closed_loop(self, plant: Plant, t: Array, first: NDArray[np.intp], rho: Any,
                     ) -> tuple[Array, Array]:
        """Return states (T, n) and commands (T, m), each command as the states are then."""
        u = np.empty((len(t), len(plant.inputs)))
        x = np.empty((len(t), len(plant.states)))
        x[0] = self.initial
        for begin, end in zip(first, [*first[1:], len(t) - 1]):
            u[begin:end + 1] = self._commands(plant, t[begin:begin + 1], x[begin][:, None])
            held = rho if callable(rho) else rho[begin:end + 1]
            if begin < end:
                x[begin:end + 1] = simulate(plant, t[begin:end + 1], u[begin:end + 1], held,
                                            x[begin])
        return x, u

    def said(self, run: Trajectory, every: int = 1) -> dict[str, Recorded]:
        """Return what each sensor says at every so many rows, noise included."""
        random, channels = np.random.default_rng(0), {}
        for name, y in run.readings.items():
            y = y[::every]
            channels[name] = Recorded.of(run.time[::every], y + self.noise.get(
                name, 0.0) * random.standard_normal(len(y)))
        return channels


def read_drive(given: Section, plant: Plant, sensor_rate: float, command_rate: float) -> Drive:
    """Read what drives a plant; rates in Hz. Raise BadInput."""
    if plant.sample_time is not None and abs(sensor_rate * plant.sample_time - 1.0) > 1e-6:
        raise given.bad('sensor_rate', f'{plant.name} is sampled every {plant.sample_time} s',
                        f'write {1.0 / plant.sample_time:g}')
    start, noise = given.numbers('initial', plant.states), given.numbers('noise', plant.sensors)
    known = ('t', *(s for s in plant.states if s != 't'))
    inputs = given.expressions('inputs', plant.inputs, known)
    law = [compile_expression(node, known) for node in inputs]
    closed = any(set(names(node)) - {'t'} for node in inputs)
    unknown = [compile_expression(node, ['t'])
               for node in given.expressions('disturbances', plant.unknown_inputs, ('t',))]
    states = [plant.states.index(s) for s in known[1:]]

    def commands(t: Array, x: Array) -> Array:
        values = [t, *(x[i] for i in states)] if closed else [t, *([np.nan] * len(states))]
        return np.array([np.broadcast_to(f(values), t.shape) for f in law]).reshape(
            len(law), len(t)).T

    def disturbances(t: Any) -> Array:
        return np.array([np.broadcast_to(f([t]), np.shape(t)) for f in unknown]).reshape(
            len(unknown), *np.shape(t)).T

    return Drive(given.where, sensor_rate, command_rate, commands, closed, disturbances,
                 [start.get(name, value) for name, value in zip(plant.states, plant.initial)],
                 noise)
