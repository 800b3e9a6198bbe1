"""What stands in the way of a certificate, or of a bound in it, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsensor_ros.designer.error_in_box import (
    Bounds,
    error_system,
    feeding_terms,
    INFINITE_SLOPE,
    joint_system,
)
from vsensor_ros.designer.error_system import decay_rate
from vsensor_ros.designer.form_search import LARGEST_ORDER
from vsensor_ros.designer.slopes import jumps
from vsensor_ros.observers import VirtualSensor
from vsensor_ros.plant.plant import Plant


def runaway(sensor: VirtualSensor, bounds: Bounds) -> str:
    """Name a term with a jump that pushes its own argument away from the jump, or ''."""
    for i in feeding_terms(sensor):
        for row, (low, high) in zip(sensor.Gz[i], bounds[i]):
            push = float(row @ sensor.P[:, i])
            if sensor.sample_time is None and jumps(sensor.terms[i]) and (
                    high > INFINITE_SLOPE and push > 0 or low < -INFINITE_SLOPE and push < 0):
                name = sensor.terms[i].short
                return (f'{name} drives its own argument away from zero: '
                        'two branches can stay apart')
    return ''


def obstacle(plant: Plant, sensor: VirtualSensor, bounds: Bounds,
             box: tuple[np.ndarray, np.ndarray], place: str) -> str:
    """Say in one clause why no form was found."""
    for i, slopes in bounds.items():
        for row, (low, high) in zip(sensor.Gz[i], slopes):
            name = sensor.terms[i].short
            steep = high > INFINITE_SLOPE, low < -INFINITE_SLOPE
            if row.any() and all(steep):
                return f'the slope of {name} has no bound {place}'
            if row.any() and any(steep):
                push = float(row @ sensor.P[:, i]) * (1.0 if steep[0] else -1.0)
                if sensor.sample_time is not None:
                    return (f'{name} is infinitely steep {place}, and in one step it can throw '
                            'its argument beyond any bound')
                if push >= 0:
                    return (f'{name} is infinitely steep {place} and does not pull its argument '
                            'back')
    terms = listed_once(term_names(sensor))
    error = joint_system(plant, sensor, bounds, *box) or error_system(sensor, bounds)
    if error.cornered and min(decay_rate(A, sensor.sample_time) for A in error.corners()) <= 0:
        return f'with slopes that {terms} can have {place} the error does not die out'
    if len(sensor.N) > LARGEST_ORDER:
        return f'more than {LARGEST_ORDER} states: only a coarser test was made, and it failed'
    return f'no quadratic form falls for all slopes that {terms} can have {place}'


def steep_readings(plant: Plant, sensor: VirtualSensor, bounds: Bounds) -> str:
    """Say which terms of readings alone are so steep that small errors have no small effect."""
    steep = [i for i in sensor.active if any(
        row.any() and not own.any() and max(-low, high) > INFINITE_SLOPE
        for own, row, (low, high) in zip(sensor.Gz[i], sensor.Gy[i], bounds[i]))]
    if not steep:
        return ''
    of = [name for name, used, ends in zip(plant.states, np.any(
        [plant.G[i].any(axis=0) for i in steep], axis=0), plant.ranges)
        if used and not np.isfinite(ends).all()]
    names = listed_once([sensor.terms[i].short for i in steep])
    return (f'; {names} is taken of readings, and has a slope without bound'
            + (f': give {listed_once(of)} a range' if of else ''))


def term_names(sensor: VirtualSensor) -> list[str]:
    """Name the terms that see the estimate itself, in sentences."""
    return [sensor.terms[i].short for i in feeding_terms(sensor)]


def listed_once(texts: Sequence[str]) -> str:
    """Return 'a, b and c', each once."""
    texts = list(dict.fromkeys(texts))
    return ' and '.join([', '.join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)
