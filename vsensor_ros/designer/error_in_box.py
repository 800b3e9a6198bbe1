"""The error system of a virtual sensor while states and inputs keep to a box."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.designer.error_system import ErrorSystem, Slopes
from vsensor_ros.designer.joint_slopes import (
    JointSlopes,
    MOST_ENTRIES,
    MOST_SIDES,
    SharedTerm,
    sides_of,
)
from vsensor_ros.designer.quadratic_form import ROUNDING
from vsensor_ros.designer.slopes import slope_bounds_on
from vsensor_ros.functions.expression import names, parse
from vsensor_ros.functions.interval import Interval
from vsensor_ros.functions.nonlinearity import argument_names
from vsensor_ros.observers import VirtualSensor
from vsensor_ros.plant.plant import Plant

INFINITE_SLOPE = 1e100
Bounds = dict[int, tuple[Interval, ...]]  # by term, a pair for each argument


def feeding_terms(sensor: VirtualSensor) -> list[int]:
    """Return the active terms that see the estimate itself."""
    return [i for i in sensor.active if np.any(sensor.Gz[i])]


def used_states(plant: Plant, sensor: VirtualSensor) -> list[int]:
    """Return the states that stand in these terms."""
    used = [np.abs(plant.G[i]).sum(axis=0) > 0 for i in feeding_terms(sensor)]
    return [int(j) for j in np.flatnonzero(np.any(used, axis=0))] if used else []


def used_inputs(sensor: VirtualSensor) -> list[int]:
    """Return the inputs that these terms hold."""
    used = {name for i in feeding_terms(sensor) for name in names(parse(sensor.terms[i].text))}
    return [j for j, name in enumerate(sensor.inputs) if name in used]


def image(rows: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return the box (r, 2) in which rows @ x lies for x in a box (n, 2)."""
    low, high = box[:, 0], box[:, 1]
    with np.errstate(invalid='ignore'):
        down = np.where(rows > 0, rows * low, np.where(rows < 0, rows * high, 0.0))
        up = np.where(rows > 0, rows * high, np.where(rows < 0, rows * low, 0.0))
    return np.stack([down.sum(axis=1), up.sum(axis=1)], axis=1)


def slope_bounds(plant: Plant, sensor: VirtualSensor, states: np.ndarray,
                 inputs: np.ndarray) -> Bounds:
    """Bound the slopes of every active term over a box of states and inputs."""
    return {i: slope_bounds_on(sensor.terms[i], image(plant.G[i], states), sensor.inputs, inputs)
            for i in sensor.active}


def error_system(sensor: VirtualSensor, bounds: Bounds) -> ErrorSystem:
    """Return the error system in which every slope takes any value in its bounds."""
    N, J = np.array(sensor.N, dtype=float), np.array(sensor.J, dtype=float)
    groups: dict[str, list[tuple[np.ndarray, np.ndarray, np.ndarray, float]]] = {
        'bounded': [], 'rising': [], 'loose': []}
    for i, slopes in bounds.items():
        for j, (low, high) in enumerate(slopes):
            p, g, h = sensor.P[:, i], sensor.Gz[i][j], sensor.Gy[i][j]
            if not (g.any() or h.any()):
                continue
            sinks, climbs = low < -INFINITE_SLOPE, high > INFINITE_SLOPE
            if sinks and climbs:
                groups['loose'].append((p, g, h, np.inf))
                continue
            if sinks:
                p, centre, radius = -p, -high, np.inf
            elif climbs:
                centre, radius = low, np.inf
            else:
                centre, radius = 0.5 * (low + high), 0.5 * (high - low)
                if radius <= ROUNDING * abs(centre):
                    radius = 0.0
            N += centre * np.outer(p, g)
            J += centre * np.outer(p, h)
            if radius:
                groups['bounded' if np.isfinite(radius) else 'rising'].append((p, g, h, radius))
    k, l0 = N.shape[0], J.shape[1]
    made = {name: Slopes(np.array([p for p, *_ in some]).reshape(len(some), k).T,
                         np.array([g for _, g, _, _ in some]).reshape(len(some), k),
                         np.array([h for _, _, h, _ in some]).reshape(len(some), l0),
                         np.array([r for *_, r in some]))
            for name, some in groups.items()}
    return ErrorSystem(N, J, sensor.Cv, sensor.Q, made['bounded'], made['rising'], made['loose'],
                       sensor.sample_time)


def joint_system(plant: Plant, sensor: VirtualSensor, bounds: Bounds, states: np.ndarray,
                 inputs: np.ndarray) -> ErrorSystem | None:
    """
    Return the error system in which slopes of shared arguments come together; None: none do.

    ``bounds``: of the slopes in this box. Only slopes within bounds are taken together, and only
    where all sides of their box are finite.
    """
    feeding = feeding_terms(sensor)
    rows = [row for i in feeding for row in plant.G[i]]
    commands = used_inputs(sensor)
    if not all(row.any() for row in rows):
        return None
    found, places = sides_of(rows)
    box = np.vstack([image(np.array(found), states), inputs[commands]])
    slopes = [(i, j) for i in feeding for j, (low, high) in enumerate(bounds[i])
              if sensor.Gz[i][j].any() and max(-low, high) < INFINITE_SLOPE]
    if len(slopes) < 2 or not np.isfinite(box).all() \
            or len(box) > MOST_SIDES or 2**len(box) * sensor.N.size > MOST_ENTRIES:
        return None
    terms, place = [], iter(places)
    for i in feeding:
        own = [next(place) for _ in plant.G[i]]
        text = names(parse(sensor.terms[i].text))
        held = [n for n, j in enumerate(commands) if sensor.inputs[j] in text]
        terms.append(SharedTerm(
            sensor.terms[i],
            (*argument_names(len(own)), *(sensor.inputs[commands[n]] for n in held)),
            (*(side for side, _ in own), *(len(found) + n for n in held)),
            (*(ratio for _, ratio in own), *[1.0] * len(held)),
            tuple((j, slopes.index((i, j))) for j in range(len(own)) if (i, j) in slopes)))
    apart = error_system(sensor, bounds)
    centre = np.array([0.5 * sum(bounds[i][j]) for i, j in slopes])
    p = np.array([sensor.P[:, i] for i, _ in slopes]).T
    g = np.array([sensor.Gz[i][j] for i, j in slopes])
    return replace(apart, joint=JointSlopes(apart.N - p * centre @ g, p, g, box, tuple(terms)))
