"""What unknown inputs that are not decoupled do to a virtual sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.designer.gain import peak
from vsensor_ros.designer.observer import linearised
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.sentences import say
from vsensor_ros.observers import VirtualSensor
from vsensor_ros.reason import Reason


def graded(problem: Problem, sensor: VirtualSensor) -> VirtualSensor:
    """Return a sensor with grade 'bounded' and its disturbance gain."""
    gain, _ = peak(*disturbed_error(problem, sensor), problem.plant.sample_time)
    return replace(sensor, grade='bounded', disturbance_gain=gain)


def disturbed_error(problem: Problem, sensor: VirtualSensor,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return ``d e = N e + B rho``, ``v - vhat = C e + D rho``, e = Phi x - z, as (N, B, C, D).

    In the user's units, with the nonlinear terms' slopes at the operating point.
    """
    plant = problem.plant
    Cd = plant.Cd[[plant.sensors.index(s) for s in problem.healthy]]
    N, J = linearised(plant, sensor)
    return (N, sensor.Phi @ plant.D - J @ Cd, sensor.Cv, problem.wanted[2] - sensor.Q @ Cd)


def told(problem: Problem, kept: tuple[int, ...], sensor: VirtualSensor) -> str:
    """Say from what a sensor is decoupled, and what the other unknown inputs (kept) do to it."""
    plant = problem.plant
    N, B, C, D = disturbed_error(problem, sensor)
    steady = np.eye(len(N)) - N if plant.sample_time is not None else -N
    effects = []
    for i in kept:
        gain, at = peak(N, B[:, [i]], C, D[:, [i]], plant.sample_time)
        constant = float(np.linalg.norm(C @ np.linalg.solve(steady, B[:, [i]]) + D[:, [i]]))
        effects.append((plant.disturbances[i], gain, at, constant))
    return say(Reason.of(
        'decoupled', kept=tuple(effects), unit=plant.units.get(problem.channel, ''),
        free=tuple(name for i, name in enumerate(plant.disturbances) if i not in kept)))
