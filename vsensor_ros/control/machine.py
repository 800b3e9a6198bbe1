"""
What a controller has before it: a plant, and virtual sensors in the place of those that it lost.

All is linear about the operating point. The virtual sensors are those of the nominal plant,
whatever the plant before them is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.observers import VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.plant.linear import linearised, slopes_of


@dataclass(frozen=True, eq=False)
class Machine:
    """
    ``d xi = F xi + G v + J n, yhat = H xi + L v + M n`` with xi = (x, z_1, z_2, ..) of N states.

    v are the commands twice (2m): as the plant gets them, and as the virtual sensors hear them; n
    are the errors of the l readings. yhat is what the controller is told, of all sensors.
    """

    F: np.ndarray  # (N, N)
    G: np.ndarray  # (N, 2m)
    J: np.ndarray  # (N, l)
    H: np.ndarray  # (l, N)
    L: np.ndarray  # (l, 2m)
    M: np.ndarray  # (l, l)


def linear_sensor(plant: Plant, sensor: VirtualSensor) -> tuple[np.ndarray, ...]:
    """Return N, J and B of a virtual sensor with its terms' slopes at the operating point."""
    N, J, B = sensor.N.copy(), sensor.J.copy(), sensor.B.copy()
    for i in sensor.active:
        w, u = slopes_of(sensor.terms[i], plant.G[i] @ plant.operating_point, plant.inputs,
                            plant.operating_input)
        column = sensor.P[:, i]
        N += np.outer(column, w @ sensor.Gz[i])
        J += np.outer(column, w @ sensor.Gy[i])
        B += np.outer(column, w @ sensor.Gu[i] + u)
    return N, J, B


def machine(plant: Plant, nominal: Plant, sensors: Sequence[VirtualSensor],
            unheard: Sequence[str] = ()) -> Machine:
    """
    Put virtual sensors, designed for the nominal plant, beside a plant as it may be.

    sensors: of one fault set, those that the controller reads; unheard: inputs of which they do
    not hear, so that they take them to be at their operating values.
    """
    A, B = linearised(plant)
    n, m, count = len(A), len(plant.inputs), len(plant.sensors)
    total = n + sum(sensor.order for sensor in sensors)
    heard = np.array([name not in unheard for name in plant.inputs], dtype=float)
    F, G, J = np.zeros((total, total)), np.zeros((total, 2 * m)), np.zeros((total, count))
    H, L, M = np.zeros((count, total)), np.zeros((count, 2 * m)), np.eye(count)
    F[:n, :n], G[:n, :m], H[:, :n], L[:, :m] = A, B, plant.C, plant.Cu
    first = n
    for sensor in sensors:
        rows = [plant.sensors.index(name) for name in sensor.healthy]
        own, block = plant.sensors.index(sensor.channel), slice(first, first + sensor.order)
        N, gain, command = linear_sensor(nominal, sensor)
        F[block, block], F[block, :n] = N, gain @ plant.C[rows]
        G[block, :m], G[block, m:] = gain @ plant.Cu[rows], command * heard
        J[block, rows] = gain
        H[own], M[own] = 0.0, 0.0
        H[own, block], H[own, :n] = sensor.Cv[0], (sensor.Q @ plant.C[rows])[0]
        L[own, :m], L[own, m:] = (sensor.Q @ plant.Cu[rows])[0], sensor.Qu[0] * heard
        M[own, rows] = sensor.Q[0]
        first += sensor.order
    return Machine(F, G, J, H, L, M)


def separate(plant: Plant, here: Machine, sensors: Sequence[VirtualSensor]) -> bool:
    """
    Tell whether the errors ``e = Phi x - z`` live by themselves, whatever the controller does.

    Then the poles of the loop are those with healthy sensors, and the eigenvalues of N. It takes a
    virtual sensor that hears the command which the plant gets, and a model that is right. Source:
    the method, 3.14.
    """
    n, m = len(plant.states), len(plant.inputs)
    first = n
    for sensor in sensors:
        rows = np.zeros((sensor.order, len(here.F)))
        block = slice(first, first + sensor.order)
        rows[:, :n], rows[:, block] = sensor.Phi, -np.eye(sensor.order)
        own = plant.sensors.index(sensor.channel)
        told = here.H[own] + (sensor.Cv @ rows)[0]
        told[:n] -= plant.C[own]
        pairs = ((rows @ here.F - here.F[block, block] @ rows, abs(rows) @ abs(here.F)),
                 (rows @ (here.G[:, :m] + here.G[:, m:]), abs(rows) @ abs(here.G[:, :m])),
                 (told, abs(here.H[own]) + abs(sensor.Cv @ rows)[0]),
                 (here.L[own, :m] + here.L[own, m:] - plant.Cu[own], abs(here.L[own]).sum()))
        if any(np.abs(left).max(initial=0.0) > 1e-6 * np.max(size, initial=1e-300)
               for left, size in pairs):
            return False
        first += sensor.order
    return True
