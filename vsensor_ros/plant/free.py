"""A plant file with its free parameters by name: what a fit moves, and what moves with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.functions.expression import Apply, fold, names, Node, Number, substitute
from vsensor_ros.plant.entries import DEFINITION, Entries
from vsensor_ros.plant.load import in_its_unit, read_plant, TOP
from vsensor_ros.plant.plant import Plant


@dataclass(frozen=True)
class Free:
    """A parameter that is looked for between low and high, from `value` on."""

    name: str
    value: float
    low: float
    high: float
    unit: str = ''


@dataclass(frozen=True)
class FreePlant:
    """
    A plant whose equations name its free parameters.

    dynamics: of each state of the file, per second, or the next value with a sample time;
    measures: of each sensor, what it shows. Both are over states, inputs, disturbances and the
    free parameters. late: by how much what a sensor says is older than its stamp [s]. plant: the
    same with the values of the file.
    """

    plant: Plant
    states: tuple[str, ...]
    dynamics: tuple[Node, ...]
    measures: tuple[Node, ...]
    free: tuple[Free, ...]
    late: tuple[float, ...]
    seconds: float = 1.0  # of the file's unit of time


def load_free(path: str | Path, content: dict[str, Any] | None = None,
              every: bool = False) -> FreePlant:
    """
    Read a plant file for a fit, or its content in place of what stands in it.

    every: free are all parameters that stand there as numbers, and none need be. Raises BadInput,
    one line, where nothing in it is free.
    """
    file = Entries(path, TOP, content)
    plant = read_plant(file)
    section = file.section('parameters', ('value', 'unit', 'spread', 'fit'), 'value')
    fits = {name: (value - (abs(value) or 1.0), value + (abs(value) or 1.0))
            for name, value in file.parameters.items() if name in section and isinstance(
                section[name]['value'], int | float)} if every else file.fits(section)
    if not fits and not every:
        raise file.fail('parameters', 'none has a key fit',
                        'give those that are to be found a range: {value: 0.3, fit: [0.1, 1.0]}')
    if 'dynamics' not in file.content:
        raise file.fail('matrices', 'cannot be fitted', 'give one equation a state under dynamics')
    if plant.definitions:
        raise file.fail('definitions', 'make equations too large to be fitted',
                        'fit a part of the machine, such as two of its joints')
    moving = _moving(file, section, fits)
    unit = file.time_unit(plant.sample_time)

    def by_name(text: object, key: str) -> Node:
        return fold(substitute(file.with_names(text, key, moving, True), moving), path, key)
    states = tuple(file.section('states', ('unit', 'initial', 'process_noise', 'range', 'slow')))
    texts = {**{s: '0' if plant.sample_time is None else s for s in states},
             **file.content['dynamics']}
    dynamics = [by_name(texts[s], f'dynamics.{s}') for s in states]
    if unit != 1.0:
        dynamics = [fold(Apply('/', (node, Number(unit)))) for node in dynamics]
    measures, late = [], []
    for sensor in plant.sensors:
        entry = file.content['sensors'][sensor]
        entry = entry if isinstance(entry, dict) else {'measures': entry}
        late.append(sum(file.time(entry, what, f'sensors.{sensor}')
                        for what in ('delay', 'stamp_offset')))
        measures.append(in_its_unit(file, by_name(
            entry['measures'], f'sensors.{sensor}.measures'), sensor, entry))
    used = {name for node in (*dynamics, *measures) for name in names(node)}
    if every:
        fits = {name: ends for name, ends in fits.items() if name in used}
    for name in fits:
        if name not in used:
            raise file.fail(f'parameters.{name}.fit', 'no equation and no sensor depends on it',
                            'leave it out')
    return FreePlant(plant, states, tuple(dynamics), tuple(measures), tuple(
        Free(name, plant.parameters[name], *ends, section[name].get('unit', ''))
        for name, ends in fits.items()), tuple(late), unit)


def _moving(file: Entries, section: dict[str, dict[str, object]],
            fits: dict[str, tuple[float, float]]) -> dict[str, Node | float]:
    """Return what moves in a fit: the free parameters, and those that are computed from them."""
    moving: dict[str, Node | float] = {}
    for name, entry in section.items():
        if name in fits:
            moving[name] = file.raw(name)
        elif name not in file.arrays:
            node = file.raw(entry['value'])
            if moving.keys() & set(names(node)):
                fixed = {n: v for n, v in file.parameters.items() if n not in moving}
                moving[name] = fold(substitute(substitute(node, moving), fixed))
    return moving


def frictions(path: str | Path) -> dict[str, tuple[str, float, float]]:
    """
    Return which definitions of a plant file are friction: of which state, how large, how fast.

    Raises BadInput, one line.
    """
    file = Entries(path, TOP)
    plant = read_plant(file)
    fastest = dict(zip(plant.states, np.abs(plant.ranges).max(axis=1).tolist()))
    return {name: file.friction(entry['friction'], f'definitions.{name}.friction', fastest)
            for name, entry in file.section('definitions', DEFINITION, 'value').items()
            if 'friction' in entry}
