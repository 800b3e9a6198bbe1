"""The truth that a replacer is judged by: a simulated plant, computed before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import compile_expression, parse
from vsensor_ros.plant import Plant
from vsensor_ros.simulate.fault import Channel
from vsensor_ros.simulate.simulate import readings, simulate

Array = NDArray[np.float64]

COMMAND_RATE = 20.0     # Hz, where no scenario gives it
SENSOR_RATE = 100.0     # Hz, the same of a continuous plant
TRIED = 4.0             # s in which those must move every sensor, or they are made wider
WIDER = (1.0, 2.0, 4.0, 8.0)  # friction holds what is pushed too weakly
SLOW, FAST = 0.7, 1.9   # rad/s, of the commands where no scenario gives them


@dataclass(frozen=True, eq=False)
class World:
    """What every channel is and says; times in s from the start, values in the channels' units."""

    time: Array               # (T,), when the sensors read
    truth: Mapping[str, Array]    # (T,) by sensor
    said: Mapping[str, Channel]             # by sensor and command, without faults
    span: Mapping[str, float]               # max - min of the truth, by sensor
    noise: Mapping[str, float]              # standard deviation of what is read, by sensor

    @property
    def end(self) -> float:
        """Return the time of the last reading."""
        return float(self.time[-1])

    def at(self, sensor: str, time: Any) -> Any:
        """Return the truth at times [s], interpolated."""
        return np.interp(time, self.time, self.truth[sensor])


def make_world(plant: Plant, scenario: Path | None, duration: float) -> World:
    """
    Simulate a plant for `duration` [s], driven as the `simulation` of a demo.yaml says.

    Without a scenario the commands swing about the operating point. Raises BadInput.
    """
    given = {} if scenario is None else _simulation(scenario)
    where = str(scenario or plant.name)
    rate = 1.0 / plant.sample_time if plant.sample_time else float(
        given.get('sensor_rate', SENSOR_RATE))
    command_rate = float(given.get('command_rate', min(rate, COMMAND_RATE)))
    t = np.arange(round(duration * rate) + 1) / rate
    held = np.floor(t * command_rate + 1e-9) / command_rate

    def signals(key: str, names: tuple[str, ...], at: Array) -> Array:
        texts = given.get(key) or {}
        columns = [compile_expression(parse(texts.get(n, 0.0), where, f'{key}.{n}', ['t']), ['t'])(
            [at]) for n in names]
        return np.array([np.broadcast_to(c, at.shape) for c in columns], float).reshape(
            len(names), len(at)).T

    rho = signals('disturbances', plant.disturbances, t)
    start = given.get('initial') or {}
    x0 = [start.get(name, value) for name, value in zip(plant.states, plant.initial)]
    try:
        u = signals('inputs', plant.inputs, held) if 'inputs' in given else \
            _swinging(plant, t, held, rho, x0)
        x = simulate(plant, t, u, rho, x0)
    except ArithmeticError as error:
        raise BadInput(where, 'simulation', str(error), 'give inputs that it can follow') from None
    noise = {name: float(size) for name, size in zip(plant.sensors, np.nan_to_num(plant.noise))}
    noise |= given.get('noise') or {}
    random = np.random.default_rng(0)
    truth, said = {}, {}
    for name, y in zip(plant.sensors, readings(plant, t, x, u, rho).T):
        truth[name] = y
        said[name] = Channel.of(t, y + noise[name] * random.standard_normal(len(y)))
        if not np.ptp(y) > 0.0:
            raise BadInput(where, name, 'never moves, so that nothing can be told of it',
                           'give inputs that move it')
    first = np.unique(held, return_index=True)[1]
    said |= {name: Channel.of(t[first], values[first]) for name, values in zip(plant.inputs, u.T)}
    return World(t, truth, said, {s: float(np.ptp(y)) for s, y in truth.items()}, noise)


def _simulation(path: Path) -> Mapping[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
        simulation = content['simulation']
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BadInput(path, '', f'cannot be read: {error}'[:200], 'give a demo.yaml') from None
    except (KeyError, TypeError):
        raise BadInput(path, 'simulation', 'is missing',
                       'give a scenario that is simulated, or none') from None
    if not isinstance(simulation, dict):
        raise BadInput(path, 'simulation', 'is not a mapping', 'write name: value pairs')
    return simulation


def _swinging(plant: Plant, t: Array, held: Array, rho: Array, x0: list[float]) -> Array:
    """Return commands (T, m) that swing about the operating point, wide enough to move all."""
    size = np.where(plant.operating_input != 0.0, 0.4 * np.abs(plant.operating_input), 1.0)
    phase = 1.3 * np.arange(len(size))
    wave = np.sin(SLOW * held[:, None] + phase) + 0.5 * np.sin(FAST * held[:, None] + 2.0 * phase)
    part = slice(np.searchsorted(t, TRIED) + 1)
    for factor in WIDER:
        u = plant.operating_input + factor * size * wave
        x = simulate(plant, t[part], u[part], rho[part], x0)
        if np.ptp(readings(plant, t[part], x, u[part], rho[part]), axis=0).all():
            break
    return u
