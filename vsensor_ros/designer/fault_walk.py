"""
The size of a fault as one more state: a Kalman filter in which it walks at random.

A plant whose sensor or command errs by d is a plant with the further state d, ``d' = 0``, which
is read, or acts, as the fault does. Its size is a wanted functional of that plant, so that what is
known of these decides: it can be told in the end iff a constant fault shows beside the unknown
inputs. How fast the walk is decides how fast the estimate follows, and how noisy it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from vsensor_ros.designer.exact import verdict
from vsensor_ros.designer.existence import examine
from vsensor_ros.designer.invariant_spaces import filter_candidate
from vsensor_ros.designer.isolability import Checks, checks
from vsensor_ros.designer.noise import Filter, kalman, noise_model, NoiseModel
from vsensor_ros.designer.observer import build
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.designer.start import started
from vsensor_ros.designer.subspaces import RANK_TOLERANCE
from vsensor_ros.observers import Noise, VirtualSensor
from vsensor_ros.observers.fault_size import observer_name, WALK
from vsensor_ros.plant import Plant
from vsensor_ros.reason import Reason

LEFT = float(np.exp(-1.0))  # of a step, after the time of response
SLOWER = 12  # times that the response is doubled, at most, where no walk is fast enough
FINE = 12  # bisections


@dataclass(frozen=True, eq=False)
class Walk:
    """The filter, and how it does."""

    observer: VirtualSensor
    response: float  # s until 63 % of a step is told
    noise: float  # standard deviation of the size while there is no fault, by readings alone


def fault_columns(plant: Plant, channel: str) -> tuple[np.ndarray, np.ndarray]:
    """Return by what a fault of 1 moves the states (n,) and the readings (l,)."""
    if channel in plant.sensors:
        return np.zeros(len(plant.states)), np.eye(len(plant.sensors))[
            plant.sensors.index(channel)]
    j = plant.inputs.index(channel)
    return plant.B[:, j], plant.Cu[:, j]


def with_fault(plant: Plant, channel: str) -> Plant:
    """Return the plant with the fault of a sensor or an input as its last state."""
    moves, shows = fault_columns(plant, channel)
    n, m, d, q = len(plant.states), *(M.shape[1] for M in (plant.B, plant.D, plant.P))
    name = observer_name(channel)

    def one_more(row: np.ndarray, last: float) -> np.ndarray:
        return np.append(row, last)

    return replace(
        plant, states=(*plant.states, name), units={**plant.units, name: plant.units[channel]},
        A=np.block([[plant.A, moves[:, None]],
                    [np.zeros((1, n)), float(plant.sample_time is not None) * np.ones((1, 1))]]),
        B=np.vstack([plant.B, np.zeros((1, m))]), C=np.hstack([plant.C, shows[:, None]]),
        D=np.vstack([plant.D, np.zeros((1, d))]), P=np.vstack([plant.P, np.zeros((1, q))]),
        G=tuple(np.hstack([g, np.zeros((len(g), 1))]) for g in plant.G),
        initial=one_more(plant.initial, 0.0),
        operating_point=one_more(plant.operating_point, 0.0),
        process_noise=one_more(plant.process_noise, np.nan),
        ranges=np.vstack([plant.ranges, [-np.inf, np.inf]]), slow=one_more(plant.slow, 0.0) > 0.0,
        equations=(), remake=None)


def walk(plant: Plant, channel: str, response: float) -> Walk | Reason:
    """Return the filter that follows a step within a response [s], or the next slower one."""
    problem = pose(with_fault(plant, channel), (), observer_name(channel),
                   np.eye(len(plant.states) + 1)[-1:])
    obstruction = _obstruction(problem)
    if obstruction is not None:
        return obstruction
    found, noise = checks(problem), noise_model(problem)
    for _ in range(SLOWER):
        steady = _fast_enough(found, noise, response)
        if steady is not None:
            made = _built(plant, found, noise, steady)
            if made is not None:
                return Walk(made, response, _error(found, steady, of_readings(plant, noise)))
        response *= 2.0
    return Reason.of('size, no filter')


def _obstruction(problem: Problem) -> Reason | None:
    """Return why a constant fault is not told; exact arithmetic has the last word."""
    found, plant = examine(problem), problem.plant
    exact = verdict(plant.A, plant.C, problem.wanted[0], plant.D, Cd0=plant.Cd, P=plant.P,
                    G=plant.G)
    if found.obstruction is None and (exact is None or all(exact.solvable)):
        return None
    fault = checks(problem).known.Phi[:, -1]
    if np.abs(fault).max(initial=0.0) < RANK_TOLERANCE:
        return Reason.of('size, not seen', names=plant.disturbances)
    return Reason.of('size, only its onset')


def _fast_enough(found: Checks, noise: NoiseModel, response: float) -> Filter | None:
    """Return the filter of the slowest walk that is as fast; None: none is."""
    def of(speed: float) -> tuple[Filter | None, float]:
        process = np.append(noise.process[:-1], noise.usual * speed)
        steady = kalman(found.slopes, replace(noise, process=process))
        return steady, np.inf if steady is None else _left(found, steady, response)

    slow, fast = 1e-8, 1e8
    best, left = of(fast)
    if left > LEFT:
        return None
    for _ in range(FINE + 12):
        middle = float(np.sqrt(slow * fast))
        steady, left = of(middle)
        if left > LEFT:
            slow = middle
        else:
            best, fast = steady, middle
        if fast / slow < 1.05:
            break
    return best


def _left(found: Checks, steady: Filter, response: float) -> float:
    """Return what is not told of a step after a time, as a share of it."""
    known, problem, h = found.slopes, found.problem, found.problem.plant.sample_time
    N = known.A - steady.L @ known.E
    off = known.Phi[:, -1] / problem.scale[-1]
    moved = expm(N * response) if h is None else np.linalg.matrix_power(
        N, max(1, round(response / h)))
    # steps that overshoot are followed, too
    return float((problem.v_size * (steady.Cv @ moved @ off))[0])


def _built(plant: Plant, found: Checks, noise: NoiseModel,
           steady: Filter) -> VirtualSensor | None:
    """Build it; nothing is proved of its terms, which would take seconds."""
    problem = found.problem
    made = build(problem, filter_candidate(found.known, steady, found.arguments), WALK)
    if made is None:
        return None
    # the walk itself is no noise: it stands for faults
    still = replace(noise, process=np.append(noise.process[:-1], 0.0))
    error = _error(found, steady, still)
    # while there is no fault its rows of Phi are of the plant's states alone
    return replace(started(problem, made), Phi=made.Phi[:, :len(plant.states)].copy(),
                   noise=Noise(error, error, noise.assumed))


def of_readings(plant: Plant, noise: NoiseModel) -> NoiseModel:
    """Return the noise of the readings, with the process noise that is given but no defaults."""
    process = np.zeros(len(noise.process))
    known = ~np.isnan(plant.process_noise)
    process[:len(known)][known] = noise.process[:len(known)][known]
    return replace(noise, process=process)


def _error(found: Checks, steady: Filter, noise: NoiseModel) -> float:
    """Return the standard deviation of the size, terms with their slopes."""
    return noise.error(found.problem,
                       filter_candidate(found.slopes, steady, found.arguments))
