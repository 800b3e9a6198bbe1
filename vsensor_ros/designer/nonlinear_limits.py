"""Where a nonlinear virtual sensor says something, by noise and by the declared ranges."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vsensor_ros.designer.algebra.answer import Observer
from vsensor_ros.designer.algebra.validity import beyond
from vsensor_ros.designer.sentences import say
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Apply, names, parse
from vsensor_ros.observers import Condition
from vsensor_ros.observers.kinds.nonlinear.motion import steep_names
from vsensor_ros.plant import Plant
from vsensor_ros.plant.plant import reading_node

POINTS = 200  # at which slopes are looked at
CLEAR = 5.0  # standard deviations of a divisor: then it is not 0


@dataclass(frozen=True, eq=False)
class Sampled:
    """Points all over where a plant works."""

    x: np.ndarray  # (n, POINTS)
    u: np.ndarray  # (m, POINTS)
    y: np.ndarray  # (L, POINTS), linear readings


def sample(plant: Plant, seed: int = 0) -> Sampled:
    """Return points in the declared ranges; about the operating point where these are open."""
    random = np.random.default_rng(seed)

    def within(ranges: np.ndarray, point: np.ndarray) -> np.ndarray:
        beside = np.maximum(1.0, np.abs(point))
        low, high = (np.where(np.isfinite(ranges).all(axis=1), side, other)[:, None]
                     for side, other in zip(ranges.T, (point - beside, point + beside)))
        return random.uniform(low, high, (len(point), POINTS))
    x = within(plant.ranges, plant.operating_point)
    u = within(plant.input_range, plant.operating_input)
    with np.errstate(all='ignore'):
        y = Equations([reading_node(plant, i) for i in range(len(plant.sensors))], (
            *plant.states, *plant.inputs, *plant.unknown_inputs)).values(np.concatenate([
                x, u, np.zeros((len(plant.unknown_inputs), POINTS))])) - plant.Cu @ u
    return Sampled(x, u, y)


def conditions(plant: Plant, observer: Observer, sampled: Sampled,
                noise: np.ndarray) -> tuple[Condition, ...]:
    """
    Return where it says something.

    A divisor whose range holds 0 has a floor, some part of the range. Where z does not depend on
    it none is needed: the deviation tells. Where z does, it is what noise of readings makes of it.
    """
    kept, integrated = [], {n for text in observer.F for n in steep_names(parse(text))}
    for c in observer.validity:
        node = parse(c.positive)
        size = node.arguments[0] if isinstance(node, Apply) and node.function == '-' else node
        used = set(names(size))
        if not (isinstance(size, Apply) and size.function == 'abs'):
            kept.append(c)
        elif used & integrated:
            if used <= set(plant.sensors):
                slopes = Equations([size.arguments[0]], plant.sensors).slopes(sampled.y)[1][0]
                floor = float(f'{CLEAR * np.median(np.hypot.reduce(slopes * noise[:, None])):.2g}')
                kept.append(beyond(size, size.arguments[0], floor))
            else:
                kept.append(c)
    return tuple(Condition(c.positive, say(c.reason)) for c in kept)


def useful(plant: Plant, y: np.ndarray, turn: float) -> float:
    """Return how far readings (POINTS,) are from their mean over the declared ranges; 0: open."""
    if turn:
        return turn / math.sqrt(12.0)
    open_ = not np.isfinite(plant.ranges).all()
    return 0.0 if open_ or not np.isfinite(y).all() else float(y.std())
