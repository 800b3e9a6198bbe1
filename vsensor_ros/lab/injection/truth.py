"""The truth that a replacer is judged by: a simulated plant, computed before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.bad_input import BadInput
from vsensor_ros.plant import Plant
from vsensor_ros.simulate.drive import DRIVE, Drive, HOLD, read_drive, Trajectory
from vsensor_ros.simulate.fault import Recorded
from vsensor_ros.simulate.section import Section

Array = NDArray[np.float64]

COMMAND_RATE = 20.0     # Hz, where no scenario gives it
SENSOR_RATE = 100.0     # Hz, the same of a continuous plant
TRIED = 4.0             # s in which those must move every sensor, or they are made wider
WIDER = (1.0, 2.0, 4.0, 8.0)  # friction holds what is pushed too weakly
SLOW, FAST = 0.7, 1.9   # rad/s, of the commands where no scenario gives them
NOISE = 0.002           # of the range, where some is asked for and nothing gives any
FALLEN = 10.0           # a plant that moves so much more in the last quarter than before runs away


@dataclass(frozen=True, eq=False)
class Truth:
    """What every channel is and says; times in s from the start, values in the channels' units."""

    time: Array               # (T,), when the sensors read
    value: Mapping[str, Array]    # (T,) by sensor
    said: Mapping[str, Recorded]             # by sensor and command, without faults
    span: Mapping[str, float]               # max - min of the truth, by sensor
    noise: Mapping[str, float]              # standard deviation of what is read, by sensor

    @property
    def end(self) -> float:
        """Return the time of the last reading."""
        return float(self.time[-1])

    def at(self, sensor: str, time: Any) -> Any:
        """Return the truth at times [s], interpolated."""
        return np.interp(time, self.time, self.value[sensor])


def compute_truth(plant: Plant, scenario: Path | None, duration: float,
                  noisy: bool = False) -> Truth:
    """
    Simulate a plant for `duration` [s], driven as the `simulation` of a demo.yaml says.

    Without a scenario, or where it gives no inputs, the commands swing about the operating point.
    noisy: a sensor of which nothing gives the noise has some. Raises BadInput.
    """
    given = Section(plant.name, 'simulation', {}) if scenario is None else _simulation(scenario)
    given.expect(set(), DRIVE)
    rate = 1.0 / plant.sample_time if plant.sample_time else SENSOR_RATE
    rate = given.number('sensor_rate') if 'sensor_rate' in given.content else rate
    command_rate = given.number('command_rate') if 'command_rate' in given.content else min(
        rate, COMMAND_RATE)
    drive = read_drive(given, plant, rate, command_rate)
    drive = replace(drive, noise={name: float(size) for name, size in zip(
        plant.sensors, np.nan_to_num(plant.noise))} | dict(drive.noise))
    if 'inputs' not in given.content:
        drive = _swinging(plant, drive)
    run = drive.run(plant, np.arange(round(duration * rate) + 1) / rate)
    for name, y in run.readings.items():
        if not np.ptp(y) > 0.0:
            raise BadInput(given.where, name, 'never moves, so that nothing can be told of it',
                           'give inputs that move it')
    if name := _fallen(run):
        raise BadInput(given.where, f'simulation.inputs: {name}',
                       f'runs away: {plant.name} {_unheld(plant, drive)}', HOLD)
    span = {s: float(np.ptp(y)) for s, y in run.readings.items()}
    if noisy:
        drive = replace(drive, noise={s: drive.noise[s] or NOISE * span[s] for s in span})
    return Truth(run.time, run.readings, drive.said(run) | run.commands, span, drive.noise)


def _simulation(path: Path) -> Section:
    given = Section.of(path)
    if 'simulation' not in given.content:
        raise given.bad('simulation', 'is missing',
                        'give a scenario that is simulated, or none')
    return given.inner('simulation')


def _swinging(plant: Plant, drive: Drive) -> Drive:
    """Give commands that swing about the operating point, wide enough to move all."""
    size = np.where(plant.operating_input != 0.0, 0.4 * np.abs(plant.operating_input), 1.0)
    phase = 1.3 * np.arange(len(size))

    def swung(factor: float) -> Drive:
        def law(t: Array, _: Array) -> Array:
            wave = np.sin(SLOW * t[:, None] + phase) + 0.5 * np.sin(
                FAST * t[:, None] + 2.0 * phase)
            return plant.operating_input + factor * size * wave
        return replace(drive, law=law, closed=False)

    tried = np.arange(round(TRIED * drive.sensor_rate) + 2) / drive.sensor_rate
    for factor in WIDER:
        swinging = swung(factor)
        if all(np.ptp(y) for y in swinging.run(plant, tried).readings.values()):
            break
    return swinging


def _fallen(run: Trajectory) -> str:
    """
    Return a sensor that runs away, '' if none does.

    Errors are judged by the range of the truth: where most of it is passed in the end, anything
    would pass before.
    """
    last = 3 * len(run.time) // 4
    return next((name for name, y in run.readings.items()
                 if np.ptp(y) > FALLEN * np.ptp(y[:last])), '')


def _unheld(plant: Plant, drive: Drive) -> str:
    """Say why a plant runs away."""
    if drive.closed:
        return 'is not held by inputs that read its states'
    poles = np.linalg.eigvals(plant.A)
    unstable = poles.real > 1e-6 if plant.sample_time is None else np.abs(poles) > 1 + 1e-6
    return 'is unstable' if unstable.any() else 'follows inputs that grow'
