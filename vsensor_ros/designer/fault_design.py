"""A design of a Takagi-Sugeno plant whose sensors and actuators may be faulty, to be run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.fault_estimator import (
    ALPHAS,
    Descriptor,
    descriptor,
    estimator,
    FaultEstimator,
)
from vsensor_ros.designer.scheduled import premises_from
from vsensor_ros.observers import Design, Entry, FAULT, FaultObserver, Key, Refusal
from vsensor_ros.plant import TakagiSugeno

_TOLD = 1e-9  # by which a state may be off that readings tell


def fault_design(plant: TakagiSugeno, faulty: Sequence[str], alphas: Sequence[float] = ALPHAS, *,
                 fixed_gains: bool = False) -> Design:
    """
    Return a design that estimates faults, and corrects the readings of sensors that have them.

    faulty: names of sensors, one at least, and of inputs, that may be faulty, all at once.
    alphas, fixed_gains: see `estimator`. Raises BadInput, and ImportError where the desk's solver
    is missing.
    """
    where = plant.name
    for name in faulty:
        if name not in (*plant.sensors, *plant.inputs):
            raise BadInput(where, 'faulty', f'{name!r:.80} is no sensor and no input',
                           'name some of ' + ', '.join((*plant.sensors, *plant.inputs)))
    sensors = tuple(name for name in plant.sensors if name in faulty)
    inputs = tuple(name for name in plant.inputs if name in faulty)
    if not sensors:
        raise BadInput(where, 'faulty', 'names no sensor', 'name one of '
                       + ', '.join(plant.sensors))
    if plant.state_noise is None or plant.reading_noise is None or plant.box is None:
        raise BadInput(where, 'noise_bound', 'is not given for states and sensors',
                       'give how large noise is at most, of a step and of a reading')
    moved = plant.B.mean(axis=0)[:, [plant.inputs.index(name) for name in inputs]]
    form = descriptor(plant, moved, list(sensors), W1=np.diag(plant.state_noise),
                      W2=np.diag(plant.reading_noise))
    read = _healthy(plant, sensors)
    found = fault_observer(form, estimator(form, alphas, fixed_gains=fixed_gains), sensors,
                           inputs, *read)
    entries: dict[Key, Entry | Refusal] = {(sensors, name): found for name in found.outputs}
    units = {FAULT + name: plant.units[name] for name in (*sensors, *inputs)
             if name in plant.units}
    return Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                  {**plant.units, **units}, plant.sample_time, entries,
                  tuple(FAULT + name for name in (*sensors, *inputs)),
                  np.zeros((len(plant.sensors), len(plant.inputs))))


def _healthy(plant: TakagiSugeno,
             sensors: tuple[str, ...]) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Return the rows of the healthy sensors, and what makes premises of them and of inputs."""
    rows = [i for i, name in enumerate(plant.sensors) if name not in sensors]
    C0 = plant.C[rows]
    off = abs(np.linalg.pinv(C0) @ C0 - np.eye(len(plant.states))).max(axis=1)
    for name in plant.premises:
        if name in plant.states and off[plant.states.index(name)] > _TOLD:
            raise BadInput(plant.name, 'premises', f'{name!r} is read by no healthy sensor',
                           'let the sensor of it be none that may be faulty')
    return rows, *premises_from(plant, C0)


def fault_observer(form: Descriptor, found: FaultEstimator, sensors: tuple[str, ...],
                   inputs: tuple[str, ...], rows: Sequence[int], from_readings: np.ndarray,
                   from_inputs: np.ndarray) -> FaultObserver:
    """
    Return the entry of a design that runs an estimator without readings that may be faulty.

    These change nothing but the estimate of their own fault, by themselves: so it is run as if
    they read 0. rows: of the healthy sensors. Raises BadInput where states that these do not
    show, or inputs that may be faulty, have no range.
    """
    plant, n = form.plant, form.plant.A.shape[1]
    assert plant.sample_time is not None and plant.box is not None
    assert plant.reading_noise is not None
    Cv = np.zeros((len(sensors) + len(inputs), form.size))
    Cv[:len(sensors), :n] = plant.C[[plant.sensors.index(name) for name in sensors]]
    Cv[len(sensors):, n:n + len(inputs)] = np.eye(len(inputs))
    initial, from_first, start = _start(form, found.P, Cv[:len(sensors), :n], inputs, rows)
    return FaultObserver(
        sensors[0], sensors, (*sensors, *(FAULT + name for name in inputs)),
        tuple(plant.sensors[i] for i in rows), plant.inputs, plant.sample_time, plant.premises,
        plant.ranges, plant.memberships, from_readings, from_inputs, found.N,
        found.K[:, :, rows], found.M, found.T2[:, rows], Cv, (found.P + found.P.T) / 2.0, initial,
        from_first, start, found.alpha, _deviations(form, found, Cv))


def _start(form: Descriptor, P: np.ndarray, faulty: np.ndarray, inputs: tuple[str, ...],
           rows: Sequence[int]) -> tuple[np.ndarray, np.ndarray, float]:
    """Return what it starts from, without and of readings, and what e' P e is then at most."""
    plant, n, a = form.plant, form.plant.A.shape[1], form.actuators
    assert plant.box is not None and plant.reading_noise is not None
    C0 = plant.C[rows]
    of_readings = np.linalg.pinv(C0)
    hidden = np.eye(n) - of_readings @ C0
    hidden[abs(hidden) < _TOLD] = 0.0
    moves = hidden.any(axis=0)
    of_inputs = [n + plant.inputs.index(name) for name in inputs]
    for i in (*np.flatnonzero(moves), *of_inputs):
        if not np.isfinite(plant.box[i]).all():
            name = (*plant.states, *plant.inputs)[i]
            raise BadInput(plant.name, f'{name}.range', 'is open', 'give [low, high]: where it '
                           'may be at the start, when no healthy sensor tells')
    low, high = np.where(moves[:, None], plant.box[:n], 0.0).T
    # a reading of 0 is off by what should have been read
    whole = np.vstack([np.eye(n), np.zeros((a, n)), -faulty])
    of_faults = np.zeros((form.size, a))
    of_faults[n:n + a] = np.diff(plant.box[of_inputs], axis=1)[:, 0] * np.eye(a)
    root = np.linalg.cholesky((P + P.T) / 2.0).T
    sides = root @ np.hstack([whole @ hidden * (high - low) / 2.0, of_faults])
    noise = root @ whole @ of_readings * plant.reading_noise[rows]
    size = np.linalg.norm(sides, axis=0).sum() + np.linalg.norm(noise, 2)
    return (whole @ hidden @ (low + high) / 2.0, whole @ of_readings, max(1.0, float(size)**2))


def _deviations(form: Descriptor, found: FaultEstimator, Cv: np.ndarray) -> np.ndarray:
    """Return the standard deviations of outputs, as if noise were as long as it may be, evenly."""
    T, worst = np.hstack([found.T1, found.T2]), np.zeros(len(Cv))
    for G, K in zip(form.G, found.K):
        moved = T @ G - K @ form.R
        N, W = moved[:, :form.size], moved[:, form.size:]
        S = solve_discrete_lyapunov(N, W @ W.T / W.shape[1])
        worst = np.maximum(worst, np.sqrt(np.einsum('ok,kl,ol->o', Cv, S, Cv)))
    return worst
