"""
Kalman filters on the plant's equations, where nothing is proved on the declared ranges.

They are for plants that say how far off their parameters may be (`spread`), or of which that is
stated when one asks: without that a filter does not know what it does not know. How the deviation
grows after the loss, and how fast an error dies out, is told at the operating point; on the
machine the filter finds it out where it is. Source: method 3.15.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.immersion import immersed
from vsensor_ros.designer.noise import INTERVAL
from vsensor_ros.functions.expression import fold, Node, Number, parse, substitute, to_text
from vsensor_ros.observers import ExtendedSensor, Model
from vsensor_ros.observers.kinds.extended.filter import ANYWHERE, Filter
from vsensor_ros.observers.kinds.extended.section import check_equation
from vsensor_ros.plant import Plant

LONGEST = 3000  # steps of which it is worked out how the deviation grows
TOLD = 500  # steps after which readings of the channels have told all, at most
NEARLY = 1.5  # times the least deviation: then they have told enough


def extended(plant: Plant, fault_set: tuple[str, ...], channel: str,
             spread: float | None = None) -> ExtendedSensor | None:
    """
    Return a filter for a channel that has failed with others; None where it cannot be built.

    spread: of parameters without one, as a share of what they are; None: these are exact. It needs
    spreads, all noise, equations without jumps, and readings free of unknown inputs.
    """
    if not is_possible(plant, fault_set, channel, spread):
        return None
    return _entry(plant, fault_set, channel, model_of(plant, spreads_of(plant, spread)))


def is_possible(plant: Plant, fault_set: tuple[str, ...], channel: str,
                spread: float | None = None) -> bool:
    """Tell whether a plant says all that such a filter asks for."""
    return bool(spreads_of(plant, spread)) and _is_told(plant, fault_set, channel) and \
        bool(plant.C[plant.sensors.index(channel)].any())


def of_angle(plant: Plant, fault_set: tuple[str, ...], channel: str,
             spread: float | None = None) -> ExtendedSensor | None:
    """
    Return a filter for an angle that only cosine and sine have part in; None where it is not so.

    It needs no spreads: its states say where it is from whatever start.
    """
    if not _is_told(plant, fault_set, channel):
        return None
    turns = np.flatnonzero(plant.C[plant.sensors.index(channel)])
    if len(turns) != 1:
        return None
    model = immersed(model_of(plant, spreads_of(plant, spread)), plant.states[turns[0]],
                     [name not in fault_set for name in plant.sensors])
    return None if model is None else _entry(plant, fault_set, channel, model)


def _is_told(plant: Plant, fault_set: tuple[str, ...], channel: str) -> bool:
    """Tell whether a plant tells all that a filter on its equations needs."""
    names = (*plant.states, *plant.inputs, *plant.unknown_inputs, *plant.parameters)
    if channel not in fault_set or not plant.equations or plant.Cd.any() or \
            not all(np.isfinite(noise).all() for noise in (
                plant.noise, plant.process_noise, plant.unknown_noise)) or \
            not plant.noise.all():
        return False
    try:
        for defined, text in plant.definitions:
            check_equation(text, names, plant.name, f'definitions.{defined}')
            names = (*names, defined)
        for text in plant.equations:
            check_equation(text, names, plant.name, 'dynamics')
    except BadInput:  # a jump, or too long to be written
        return False
    return True


def _entry(plant: Plant, fault_set: tuple[str, ...], channel: str,
           model: Model) -> ExtendedSensor | None:
    """Return the filter of a model, and how it goes on after the loss at the operating point."""
    tracks = model.C.any(axis=1) | (model.factors != 0.0 if model.angle else False)
    reads = np.array([bool(row.any()) and name not in fault_set
                      for name, row in zip(plant.sensors, model.C)])
    period = plant.sample_time or INTERVAL
    filter_ = Filter(model, period, np.array([tracks, reads]), np.zeros((2, len(reads)), bool))
    point = plant.operating_point
    if model.angle:
        at = plant.states.index(model.angle)
        point = np.append(point, np.sin(point[at]))
        point[at] = np.cos(point[at])
    own = filter_.row(plant.sensors.index(channel), point)
    step = filter_.linear(point, plant.operating_input)
    P, X = np.diag(model.start**2)[None], np.zeros((1, len(model.states), len(model.parameters)))

    def after(one: Filter, P: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        P, X = one.spread_step(*step, P, X)
        return one.spread_correction(one.gain(P), P, X)
    follows, free, said = filter_.of(np.array([0])), filter_.of(np.array([1])), []
    for _ in range(TOLD):
        P, X = after(follows, P, X)
        said.append(float(own @ P[0] @ own))
    ages, drift = [0.0], [float(own @ P[0] @ own)]
    for k in range(1, LONGEST + 1):
        P, X = after(free, P, X)
        if k < 10 or k % (k // 10) == 0 or k == LONGEST:
            ages.append(k * period)
            drift.append(float(own @ P[0] @ own))
    deviations = np.sqrt(np.maximum(drift, 0.0))
    if model.angle:
        deviations = np.minimum(deviations, ANYWHERE * np.abs(own).max())
    if not np.isfinite(deviations).all():
        return None
    left = free.after(free.gain(P))[0]
    slowest = float(np.abs(np.linalg.eigvals(left @ step[0][0])).max())
    return ExtendedSensor(
        channel, fault_set, tuple(s for s, read in zip(plant.sensors, reads) if read), model,
        max(0.0, -np.log(max(slowest, 1e-12)) / period),
        period * (1 + int(np.argmax(np.array(said) <= NEARLY**2 * said[-1]))),
        np.array(ages), deviations)


def spreads_of(plant: Plant, share: float | None) -> dict[str, float]:
    """Return the standard deviations of parameters; share: of those without, of their values."""
    stated = {name: share * abs(value) for name, value in plant.parameters.items()
              if share and value and '[' not in name}
    return {**stated, **plant.spreads}


def model_of(plant: Plant, spreads: Mapping[str, float]) -> Model:
    """
    Return the equations of a plant, with what it says of their noise.

    A state with a range starts anywhere in it; one without is off its initial value by a standard
    deviation as large as that, or 1.
    """
    low, high = plant.ranges.T
    known = np.isfinite(low) & np.isfinite(high)
    size = np.maximum(np.abs(plant.initial), np.abs(plant.operating_point))
    start = np.where(known, np.where(known, high, 0.0) - np.where(known, low, 0.0), 0.0) / 12**0.5
    initial = np.where(known, (np.where(known, high, 0.0) + np.where(known, low, 0.0)) / 2,
                       plant.initial)
    exact = {name: v for name, v in plant.parameters.items() if name not in spreads}
    told: dict[str, Node | float] = {**exact}
    definitions = []
    for name, text in plant.definitions:
        node = fold(substitute(parse(text), told))
        if isinstance(node, Number):
            told[name] = node
        else:
            definitions.append((name, to_text(node)))
    equations = tuple(to_text(fold(substitute(parse(text), told))) for text in plant.equations)
    return Model(
        plant.states, plant.inputs, equations, plant.unknown_inputs, tuple(spreads),
        np.array([plant.parameters[name] for name in spreads]),
        np.array(list(spreads.values())), plant.process_noise.copy(),
        np.nan_to_num(plant.input_noise), plant.unknown_noise.copy(), plant.C.copy(),
        plant.Cu.copy(), plant.noise.copy(), np.nan_to_num(1.0 / plant.sensor_rate), initial,
        np.where(known, start, np.where(size > 0.0, size, 1.0)), plant.sample_time,
        definitions=tuple(definitions))
