"""
Rows that can be decoupled, with the others of the same functional built upon them.

Source: method 2 (Composition), D section 3.2.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.designer.disturbance import graded, told
from vsensor_ros.designer.existence import avoidable_signs, examine
from vsensor_ros.designer.gain import peak
from vsensor_ros.designer.least_disturbed import least_disturbed
from vsensor_ros.designer.noise import noise_model
from vsensor_ros.designer.observer import Candidate
from vsensor_ros.designer.order_noise import search_orders
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.designer.relaxation import decouple, relax
from vsensor_ros.designer.sentences import say
from vsensor_ros.observers import Noise, Refusal, VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.reason import Reason


def composed(problem: Problem, prefer: str, decay: float | None) -> VirtualSensor | None:
    """
    Decouple the rows that can be, and use what they give as readings for the others.

    None where all rows or none can be decoupled. Source: method 2 (Composition), D section 3.2.
    """
    rows, plant = problem.wanted[0], problem.plant
    if len(rows) < 2:
        return None

    def part(chosen: list[int], of: Plant) -> Problem:
        return pose(of, problem.fault_set, problem.channel, rows[chosen])

    clear = [i for i in range(len(rows))
             if examine(part([i], plant)).obstruction is None]
    rest = [i for i in range(len(rows)) if i not in clear]
    if not clear or not rest:
        return None
    exact_problem = part(clear, plant)
    existence = examine(exact_problem)
    if existence.obstruction is not None:
        return None
    signs = avoidable_signs(exact_problem)
    exact = search_orders(exact_problem, existence, signs, prefer, decay, None)
    if isinstance(exact, Refusal):
        return None
    relaxed = relax(part(rest, _with_readings(plant, exact, exact_problem)))
    below = None if relaxed is None else least_disturbed(relaxed, prefer, decay)
    if relaxed is None or below is None:
        return None
    sensor = _cascade(plant, exact, below, clear, rest)
    bare = decouple(problem, (), None)
    if bare is None:
        return None
    noise = noise_model(bare.problem)
    error = noise.error(bare.problem, _scaled(bare.problem, sensor))
    sensor = graded(problem, sensor)
    rows_told = say(Reason.of('rows decoupled', rows=tuple(i + 1 for i in clear)))
    return replace(
        sensor, noise=Noise(error, min(error, bare.floor), noise.assumed),
        method=f'{below.method} below {exact.method}; '
               f'{rows_told} {told(problem, relaxed.kept, sensor)}')


def _with_readings(plant: Plant, exact: VirtualSensor, problem: Problem) -> Plant:
    """Return the plant with the states z of a decoupled sensor as sensors that cannot fail."""
    k = exact.order
    noise, scaled = noise_model(problem), _scaled(problem, exact)
    B = np.hstack([scaled.Phi * noise.process,
                   -scaled.J * noise.intensity])
    shown = [np.sqrt(noise.variance(scaled.N, B, row[None, :], np.zeros((1, len(exact.healthy)))))
             for row in np.eye(k)]
    names: list[str] = []
    number = 0
    while len(names) < k:
        number += 1
        if f'z{number}' not in plant.sensors:
            names.append(f'z{number}')
    return replace(
        plant, sensors=(*plant.sensors, *names), C=np.vstack([plant.C, exact.Phi]),
        Cu=np.vstack([plant.Cu, np.zeros((k, plant.Cu.shape[1]))]),
        Cd=np.vstack([plant.Cd, np.zeros((k, plant.Cd.shape[1]))]),
        noise=np.concatenate([plant.noise, shown]),
        sensor_rate=np.concatenate([plant.sensor_rate, np.full(k, np.nan)]))


def _cascade(plant: Plant, exact: VirtualSensor, below: VirtualSensor, clear: list[int],
             rest: list[int]) -> VirtualSensor:
    """Join a decoupled sensor with one that reads its z, after y0, as further readings."""
    k, l0, s = exact.order, len(exact.healthy), below.order

    def apart(M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return M[:, :l0], M[:, l0:]

    J, Jz = apart(below.J)
    Q, Qz = apart(below.Q)
    gain, gain_z = apart(below.z0_gain)
    N = np.block([[exact.N, np.zeros((k, s))], [Jz, below.N]])
    Cv, whole_Q, Qu = (np.zeros((len(clear) + len(rest), width))
                       for width in (k + s, l0, len(plant.inputs)))
    Cv[clear, :k], whole_Q[clear], Qu[clear] = exact.Cv, exact.Q, exact.Qu
    Cv[rest] = np.hstack([Qz, below.Cv])
    whole_Q[rest], Qu[rest] = Q, below.Qu
    J = np.vstack([exact.J, J])
    Gz, Gy, Gu = [], [], []
    for i in range(len(plant.terms)):
        if i in exact.active:  # what is decoupled must not look at what is not
            Gz.append(np.hstack([exact.Gz[i], np.zeros((len(exact.Gz[i]), s))]))
            Gy.append(exact.Gy[i])
            Gu.append(exact.Gu[i])
        else:
            gy, gz = apart(below.Gy[i])
            Gz.append(np.hstack([gz, below.Gz[i]]))
            Gy.append(gy)
            Gu.append(below.Gu[i])
    eigenvalues = np.concatenate([exact.eigenvalues, below.eigenvalues])
    return replace(
        below, healthy=exact.healthy, Phi=np.vstack([exact.Phi, below.Phi]), N=N, J=J,
        B=np.vstack([exact.B, below.B]), P=np.vstack([exact.P, below.P]), Cv=Cv, Q=whole_Q,
        Gz=tuple(Gz), Gy=tuple(Gy), Gu=tuple(Gu), Qu=Qu,
        z0=np.concatenate([exact.z0, below.z0 + gain_z @ exact.z0]),
        z0_gain=np.vstack([exact.z0_gain, gain + gain_z @ exact.z0_gain]),
        eigenvalues=eigenvalues[np.lexsort([eigenvalues.imag, eigenvalues.real])],
        noise_gain=peak(N, J, Cv, whole_Q, plant.sample_time)[0], ladder=())


def _scaled(problem: Problem, sensor: VirtualSensor) -> Candidate:
    """Return a virtual sensor in the scaled coordinates of its problem."""
    size = problem.v_size[:, None]
    return Candidate(sensor.Phi * problem.scale, sensor.N, sensor.J * problem.y0_size,
                     sensor.Cv / size, sensor.Q * problem.y0_size / size)
