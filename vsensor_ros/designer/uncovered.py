"""Where in the declared ranges of a plant nothing is proved of a virtual sensor, in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import product

import numpy as np

from vsensor_ros.designer.error_in_box import used_inputs, used_states
from vsensor_ros.functions.nonlinearity import NonlinearTerm, set_valued, slope_at
from vsensor_ros.observers import VirtualSensor
from vsensor_ros.plant.plant import Plant

MOST_ENDS = 10  # sides of the declared box whose 2**10 vertices are tried
ROUNDING = 1e-9  # of the decay: an error that grows no faster stays
BETWEEN, PARTS = 32, 4  # so many other points, each side in so many parts

Side = tuple[str, bool, int, tuple[float, float]]  # name, whether an input, index, range


def uncovered(plant: Plant, sensor: VirtualSensor,
              box: tuple[np.ndarray, np.ndarray] | None) -> str:
    """
    Say what of the declared ranges a box (n, 2), (m, 2) leaves out, and where it is unstable.

    None is the empty box. '' where nothing is left out or nothing declared.
    """
    sides = _declared(plant, sensor)
    parts = ['anywhere in the declared ranges'] if box is None and sides else []
    for name, is_input, j, (low, high) in sides if box is not None else ():
        assert box is not None
        least, most = box[is_input][j]
        ends = [f'{word} {end:.4g}' for word, end, beyond in (
            ('below', least, least > low), ('above', most, most < high)) if beyond]
        if ends:
            unit = plant.units.get(name, '')
            parts.append(f'with {name} {" or ".join(ends)} {unit}'.rstrip())
    if not parts:
        return ''
    worst = unstable_at(plant, sensor)
    return ', '.join(parts) + (f'; unstable at {worst}' if worst else '')


@lru_cache(maxsize=64)
def unstable_at(plant: Plant, sensor: VirtualSensor) -> str:
    """
    Name the point of the declared ranges at which an error grows most, ''; frozen slopes.

    Their vertices are tried, and if it grows at none of them, points between.
    """
    sides = _declared(plant, sensor)[:MOST_ENDS]
    ends = [[end for end in limits if np.isfinite(end)] for *_, limits in sides]
    rng = np.random.default_rng(0)
    between = ([side[0] + (side[-1] - side[0]) * rng.integers(PARTS + 1) / PARTS
                for side in ends] for _ in range(BETWEEN))
    return _worst(plant, sensor, sides, product(*ends)) or \
        _worst(plant, sensor, sides, between)


def _worst(plant: Plant, sensor: VirtualSensor, sides: Sequence[Side],
           points: Iterable[Sequence[float]]) -> str:
    points = list(points)
    x = np.tile(plant.operating_point, (len(points), 1))
    u = np.tile(plant.operating_input, (len(points), 1))
    for (_, is_input, j, _), values in zip(sides, zip(*points)):
        (u if is_input else x)[:, j] = values
    modes = np.linalg.eigvals(_frozen(plant, sensor, x, u))
    h = sensor.sample_time
    grows = (modes.real.max(axis=1) if h is None else
             np.log(np.maximum(np.abs(modes).max(axis=1), 1e-12)) / h)
    worst = int(np.argmax(grows))
    if not grows[worst] > ROUNDING * abs(sensor.decay):
        return ''
    at = [f'{name} = {value:.4g} {plant.units.get(name, "")}'.rstrip()
          for (name, *_), value in zip(sides, points[worst])]
    return f'{", ".join(at)}, where an error grows at {grows[worst]:.3g} 1/s'


def _frozen(plant: Plant, sensor: VirtualSensor, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return N (m, k, k) with the terms' slopes at points x (m, n) and u, as ``linearised``."""
    N = np.tile(sensor.N, (len(x), 1, 1))
    for i in sensor.active:
        term = sensor.terms[i]
        if set_valued(term) and sensor.sample_time is None:
            continue
        # a term holds few of the sides: many points are the same to it
        at, same = np.unique(np.hstack([x @ plant.G[i].T, u]), axis=0, return_inverse=True)
        slopes = np.array([_slope(term, plant.inputs, tuple(p)) for p in at.tolist()]) - term.slope
        N += sensor.P[:, i, None] * (slopes @ sensor.Gz[i])[same.ravel(), None, :]
    return N


@lru_cache(maxsize=1 << 14)  # many virtual sensors are looked at in the same points
def _slope(term: NonlinearTerm, inputs: tuple[str, ...], at: tuple[float, ...]) -> np.ndarray:
    r = len(term.slope)
    return slope_at(term, at[:r], inputs, at[r:])


def _declared(plant: Plant, sensor: VirtualSensor) -> list[Side]:
    """List what stands in the feeding terms and has a range."""
    every = [*((plant.states[j], False, j, plant.ranges[j]) for j in used_states(plant, sensor)),
             *((plant.inputs[j], True, j, plant.input_range[j]) for j in used_inputs(sensor))]
    return [(name, is_input, j, (float(low), float(high)))
            for name, is_input, j, (low, high) in every if np.isfinite((low, high)).any()]
