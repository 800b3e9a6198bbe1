"""
Which methods tell how large a fault is, how noisy each is, and which is taken.

Where the sensor alone has an exact virtual sensor, the reading less that; else the quietest of a
random walk (`fault_walk.py`) and a sliding mode (`fault_sliding.py`), for the same response.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.designer.fault_sliding import Sliding, sliding
from vsensor_ros.designer.fault_walk import of_readings, walk
from vsensor_ros.designer.natural_size import couplings
from vsensor_ros.designer.noise import noise_model, NoiseModel
from vsensor_ros.designer.observer import linearised
from vsensor_ros.designer.problem import pose
from vsensor_ros.designer.sentences import say
from vsensor_ros.observers import Design, Refusal, VirtualSensor
from vsensor_ros.observers.fault_size import (
    FaultSize,
    FaultSizes,
    METHODS,
    SLIDING,
    TWISTING,
    VIRTUAL,
    WALK,
)
from vsensor_ros.plant import Plant
from vsensor_ros.reason import Reason

RESPONSE = 0.3  # of the plant's mean time constant: until 63 % of a step is told
PLAIN = 20.0  # standard deviations by a random walk: a fault that is plain to see
OUTWEIGHS = 1e3  # of them: what an injection outweighs where no range is known
FEWEST = 3  # steps of a sampled plant, or readings, in a response


def sized(plant: Plant, designed: Design,
          progress: Callable[[int, int, str], None] | None = None) -> Design:
    """Return the design with how the faults of each sensor and input are estimated."""
    response = response_of(plant)
    found: list[FaultSize] = []
    refused: dict[str, str] = {}
    names = (*plant.sensors, *plant.inputs)
    for done, name in enumerate(names):
        if progress is not None:
            progress(done, len(names), f'the size of a fault of {name}')
        size = fault_size(plant, designed, name, response)
        if isinstance(size, FaultSize):
            found.append(size)
        else:
            refused[name] = size
    if progress is not None:
        progress(len(names), len(names), 'done')
    return Design(**{**vars(designed), 'fault_sizes': FaultSizes(tuple(found), refused)})


def response_of(plant: Plant) -> float:
    """Return the time [s] in which 63 % of a step is to be told."""
    lasts = plant.sample_time or 0.0
    rates = plant.sensor_rate[~np.isnan(plant.sensor_rate)]
    slowest = FEWEST / rates.min() if len(rates) else 0.0
    return float(max(RESPONSE / couplings(plant).mean_rate, FEWEST * lasts, slowest))


def fault_size(plant: Plant, designed: Design, name: str, response: float | None = None,
               method: str | None = None) -> FaultSize | str:
    """
    Return how the fault of a sensor or an input is estimated; else one sentence why not.

    ``response`` [s]: until 63 % of a step is told, by default that of `response_of`. ``method``:
    one of METHODS to be taken, whatever is quieter. Raises BadInput.
    """
    _check(plant, name, response, method)
    response = response_of(plant) if response is None else response
    virtual = _virtual(plant, designed, name, response)
    by_walk = walk(plant, name, response)
    found: list[FaultSize] = [] if isinstance(virtual, str) else [virtual]
    why_not: dict[str, str] = {VIRTUAL: virtual} if isinstance(virtual, str) else {}
    if isinstance(by_walk, Reason):  # what fades from all readings is not kept by a mode
        why_not |= dict.fromkeys((WALK, SLIDING, TWISTING), say(by_walk))
    else:
        noise = by_walk.observer.noise
        assert noise is not None
        found.append(FaultSize(name, WALK, by_walk.observer, by_walk.response, by_walk.noise,
                               noise.error, noise.assumed))
        by_sliding = sliding(plant, name, _largest(plant, name, by_walk.noise))
        if isinstance(by_sliding, Reason):
            why_not |= dict.fromkeys((SLIDING, TWISTING), say(by_sliding))
        else:
            found += _slid(name, by_sliding, by_walk.response, PLAIN * by_walk.noise)
            if len(found) < 3 + isinstance(virtual, FaultSize):
                why_not[TWISTING] = say(Reason.of('size, too slow'))
    allowed = found if method is None else [size for size in found if size.method == method]
    if not allowed:
        return why_not[WALK if method is None else method]
    best = allowed[0] if allowed[0].method == VIRTUAL and not allowed[0].disturbed else min(
        allowed, key=lambda size: (size.disturbed > 0.0, _bent(size), size.noise))
    return replace(best, why_not=why_not, others={
        size.method: size.noise for size in found if size is not best})


def _check(plant: Plant, name: str, response: float | None, method: str | None) -> None:
    if name not in (*plant.sensors, *plant.inputs):
        raise BadInput('fault_size', 'name', f'{shown(name)} is neither a sensor nor an input',
                       f'name one of {", ".join((*plant.sensors, *plant.inputs))}')
    if method is not None and method not in METHODS:
        raise BadInput('fault_size', 'method', f'{shown(method)} is not a method',
                       f'use one of {", ".join(METHODS)}')
    if response is not None and (isinstance(response, bool) or not (
            isinstance(response, (int, float)) and 0.0 < response < np.inf)):
        raise BadInput('fault_size', 'response', f'{shown(response)} is not a time',
                       'give a positive number of s')


def _virtual(plant: Plant, designed: Design, name: str, response: float) -> FaultSize | str:
    """Return the reading less the virtual sensor of the sensor alone, filtered."""
    entry = designed.entries.get(((name,), name))
    if name not in plant.sensors:
        return say(Reason.of('size, a command'))
    if entry is None:
        return say(Reason.of('size, not designed'))
    if isinstance(entry, Refusal):
        return entry.reason
    if not isinstance(entry, VirtualSensor) or entry.grade == 'temporary':
        return say(Reason.of('size, not exact', grade=entry.grade))
    whole = noise_model(pose(plant, (), name))
    return FaultSize(name, VIRTUAL, entry, response,
                     _difference(plant, entry, of_readings(plant, whole), response),
                     _difference(plant, entry, whole, response), whole.assumed,
                     disturbed=entry.disturbance_gain if entry.grade == 'bounded' else 0.0)


def _difference(plant: Plant, entry: VirtualSensor, noise: NoiseModel, response: float) -> float:
    """Return the standard deviation of a healthy reading less vhat, after a filter."""
    problem = pose(plant, (), entry.channel)
    own = plant.sensors.index(entry.channel)
    sigma = noise.intensity * problem.y0_size
    read = np.array([plant.sensors.index(s) for s in entry.healthy], dtype=int)
    N, J = linearised(plant, entry)
    k, n, h = entry.order, len(plant.states), plant.sample_time
    pull = 1.0 / response if h is None else -float(np.expm1(-h / response))
    # white noise of the states, then of the readings, to e and to the reading less vhat
    drive = np.zeros((k, n + len(sigma)))
    drive[:, :n] = entry.Phi * (noise.process * problem.scale)
    drive[:, n + read] = -J * sigma[read]
    direct = np.zeros((1, n + len(sigma)))
    direct[0, n + read] = -entry.Q[0] * sigma[read]
    direct[0, n + own] += sigma[own]
    A = np.block([[N, np.zeros((k, 1))],
                  [pull * entry.Cv[:1], np.full((1, 1), -pull if h is None else 1.0 - pull)]])
    B = np.vstack([drive, pull * direct])
    P = solve_continuous_lyapunov(A, -B @ B.T) if h is None else solve_discrete_lyapunov(
        A, B @ B.T)
    return float(np.sqrt(max(0.0, P[-1, -1])))


def _slid(name: str, by: Sliding, response: float, plain: float) -> list[FaultSize]:
    """Return both modes, that of the second only where it is fast enough."""
    assumed = by.observer.noise is None or by.observer.noise.assumed
    sizes = [FaultSize(name, SLIDING, by.observer, response, by.first_order(response, by.drive),
                       by.first_order(response, by.rough), assumed, injection=by.injection)]
    change = by.change(response, plain)
    if change is not None:
        sizes.append(FaultSize(
            name, TWISTING, by.observer, response, by.twisting(response, change, by.drive),
            by.twisting(response, change, by.rough), assumed,
            injection=replace(by.injection, change=change)))
    return sizes


def _bent(size: FaultSize) -> bool:
    """
    Tell whether a fault enters a sliding mode through a term.

    There f is by its slope at the operating point: elsewhere the size is off by as much as that.
    """
    v = size.observer
    if size.injection is None or not isinstance(v, VirtualSensor) or size.name not in v.healthy:
        return False
    return any(v.Gy[i][:, v.healthy.index(size.name)].any() for i in v.active)


def _largest(plant: Plant, name: str, noise: float) -> float:
    """Return the fault that an injection has to outweigh."""
    low, high = plant.reading_ranges().get(name, (-np.inf, np.inf))
    if name in plant.inputs:
        low, high = plant.input_range[plant.inputs.index(name)]
    return float(high - low if np.isfinite(high - low) else OUTWEIGHS * noise)
