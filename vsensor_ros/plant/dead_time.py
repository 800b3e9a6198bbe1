"""Dead times of the sensors of a sampled plant: shift registers, which are states like others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.plant.plant import Plant

MOST = 100  # samples


def with_registers(plant: Plant, steps: Mapping[str, int], where: object) -> Plant:
    """
    Return the plant with a register for each of these sensors, which reads its end.

    steps: by sensor, samples by which it is late. The states of a register are called
    ``<sensor>_late1`` and so on. Exact: what is computed of such a plant knows what the late
    readings tell of now. Raises BadInput, one line, when there are too many, or names are taken.
    """
    for sensor, count in steps.items():
        key = f'sensors.{sensor}.delay'
        if count > MOST:
            raise BadInput(where, key, f'is {count} samples', f'keep it within {MOST}')
        names = tuple(f'{sensor}_late{i + 1}' for i in range(count))
        taken = set(names) & {*plant.states, *plant.inputs, *plant.disturbances, *plant.sensors,
                              *plant.parameters}
        if taken:
            raise BadInput(where, key, f'{min(taken)} is the name of a state that it needs',
                           'choose another name')
        if sensor in plant.curves and plant.curves[sensor].beside:
            raise BadInput(where, key, 'stands beside a curve to which commands are added',
                           'give the delay to the commands, or leave it out')
        plant = _with_register(plant, plant.sensors.index(sensor), names)
    return plant


def _with_register(plant: Plant, i: int, names: tuple[str, ...]) -> Plant:
    n, count = len(plant.states), len(names)
    C, Cu, Cd = plant.C[i], plant.Cu[i], plant.Cd[i]
    A = np.zeros((n + count, n + count))
    A[:n, :n], A[n, :n] = plant.A, C
    A[n + 1:, n:-1] = np.eye(count - 1)
    first = np.eye(count)[:, :1]
    rows = np.hstack([plant.C, np.zeros((len(plant.C), count))])
    rows[i] = np.eye(n + count)[-1]
    low, high = np.sort(np.where(C != 0.0, C, np.nan)[:, None] * plant.ranges, axis=1).T
    ends = np.array([np.nansum(low), np.nansum(high)])
    plain = not (Cu.any() or Cd.any())

    def filled(values: np.ndarray, more: object) -> np.ndarray:
        return np.concatenate([values, np.broadcast_to(np.asarray(
            more, values.dtype), (count, *values.shape[1:]))])
    cleared = [matrix * (np.arange(len(matrix)) != i)[:, None] for matrix in (plant.Cu, plant.Cd)]
    return replace(
        plant, states=(*plant.states, *names), A=A,
        B=np.vstack([plant.B, first @ Cu[None, :]]), C=rows,
        D=np.vstack([plant.D, first @ Cd[None, :]]), P=filled(plant.P, 0.0),
        G=tuple(np.hstack([g, np.zeros((len(g), count))]) for g in plant.G),
        Cu=cleared[0], Cd=cleared[1],
        units={**plant.units, **dict.fromkeys(names, plant.units[plant.sensors[i]])},
        initial=filled(plant.initial, C @ plant.initial + Cu @ plant.operating_input),
        operating_point=filled(plant.operating_point,
                               C @ plant.operating_point + Cu @ plant.operating_input),
        process_noise=filled(plant.process_noise, 0.0),
        ranges=filled(plant.ranges, ends if plain else [-np.inf, np.inf]),
        slow=filled(plant.slow, False), equations=())
