"""
Ask the algebra of functions for a channel, where no linear map of the states is enough.

The plant's equations are handed over with numbers for parameters, and each sensor as its linear
reading, or as it stands where it is no curve of one. What was found becomes an entry of a design.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.algebra import find, System
from vsensor_ros.designer.algebra.derivative import SMOOTH
from vsensor_ros.designer.nonlinear_entry import nonlinear_entry
from vsensor_ros.designer.sentences import say
from vsensor_ros.functions.expression import (
    Apply,
    fold,
    Name,
    names,
    Node,
    parse,
    substitute,
    to_text,
    walk,
)
from vsensor_ros.observers import NonlinearSensor
from vsensor_ros.plant import Plant
from vsensor_ros.plant.plant import reading_node
from vsensor_ros.reason import Reason

LARGEST = 16  # states of a plant that is asked about
SMALL = 2


def by_functions(plant: Plant, fault_set: tuple[str, ...],
                 channel: str) -> NonlinearSensor | Reason:
    """Return a nonlinear virtual sensor of a channel that has failed with others, or why not."""
    system = system_of(plant, fault_set, channel)
    if isinstance(system, Reason):
        return system
    try:
        answer = find(system)
    except BadInput as error:
        return Reason.of('functions not asked', why=error.problem)
    if answer.observer is None:
        return Reason.of('no function', why=say(answer.reason) if answer.reason else '')
    i = plant.sensors.index(channel)
    out, turn = answer.observer.out[channel], 0.0
    if not np.isnan(plant.wrap[i]):
        turn, factor = abs(float(plant.wrap[i])), float(plant.C[i].sum())
        out = out if factor == 1.0 else f'{factor!r}*({out})'
    return nonlinear_entry(plant, fault_set, channel, answer.observer, out, turn) or \
        Reason.of('function not tracked')


def is_worth_asking(plant: Plant, fault_set: tuple[str, ...], channel: str,
                    refused: bool) -> bool:
    """
    Tell whether to ask unasked, of a plant whose unknown inputs and sensors are linear.

    Where there is a linear virtual sensor, though nothing is proved of it, only of small plants of
    which something can be: it would take longer than the whole design. So it would where no
    healthy sensor is left, and what commands alone tell is little.
    """
    if channel not in fault_set or not plant.terms or not plant.equations or \
            len(fault_set) == len(plant.sensors):
        return False
    return refused or (plant.sample_time is None and len(plant.states) <= SMALL and all(
        part.function in SMOOTH for text in plant.equations for part in walk(parse(text))
        if isinstance(part, Apply)))


def system_of(plant: Plant, fault_set: tuple[str, ...], channel: str) -> System | Reason:
    """Return the question put to the algebra, or why it cannot be put."""
    if channel not in fault_set or len(plant.equations) != len(plant.states) or \
            len(plant.states) > LARGEST:
        return Reason.of('functions not asked', why='it is for a sensor that failed, of a plant '
                         f'of at most {LARGEST} states that is given by equations')
    f = {state: fold(substitute(parse(text), plant.parameters))
         for state, text in zip(plant.states, plant.equations)}
    own = plant.sensors.index(channel)
    readings = {sensor: node for i, sensor in enumerate(plant.sensors)
                if set(names(node := _reading(plant, i))) <= set(plant.states)}
    if channel not in readings:
        return Reason.of('functions not asked', why=f'{channel} reads commands or unknown inputs')
    angles = tuple(_angles(plant, [*f.values(), *readings.values()]))
    wanted: Node = readings[channel]
    if not np.isnan(plant.wrap[own]):
        turning = [name for name in names(wanted) if name in angles]
        if len(turning) != 1 or set(names(wanted)) != set(turning):
            return Reason.of('functions not asked', why=f'{channel} reads an angle and more')
        wanted = Name(turning[0])
    point = dict(zip((*plant.states, *plant.inputs),
                     (*plant.operating_point, *plant.operating_input)))

    def ranges(names_: tuple[str, ...], declared: np.ndarray) -> dict[str, tuple[float, float]]:
        return {name: (float(low), float(high)) if np.isfinite([low, high]).all() else
                (-np.pi, np.pi) if name in angles else _about(point.get(name, 0.0))
                for name, (low, high) in zip(names_, declared)}
    unknown = plant.disturbance_range if plant.unknown is None else \
        np.array(plant.unknown.ranges).reshape(-1, 2)
    return System(
        ranges(plant.states, plant.ranges), {state: to_text(node) for state, node in f.items()},
        {sensor: to_text(node) for sensor, node in readings.items() if sensor not in fault_set},
        {channel: to_text(wanted)}, ranges(plant.inputs, plant.input_range),
        ranges(plant.unknown_inputs, unknown), angles, plant.sample_time)


def _reading(plant: Plant, i: int) -> Node:
    """Return what a sensor reads of the states: commands that it reads linearly are taken off."""
    beside = {name: 0.0 for name, gain in zip(plant.inputs, plant.Cu[i]) if gain}
    linear = reading_node(plant, i)
    if plant.unknown is not None and plant.Cd[i].any() and beside:
        return linear  # commands inside of what is nonlinear, too: nobody looks which
    return fold(substitute(linear, beside))


def _about(point: float) -> tuple[float, float]:
    beside = max(1.0, abs(point))
    return point - beside, point + beside


def _angles(plant: Plant, nodes: list[Node]) -> Iterator[str]:
    """Yield the states of which only cosine and sine have part in anything but who wraps them."""
    wrapped = {fold(_reading(plant, i)) for i in np.flatnonzero(~np.isnan(plant.wrap))}
    for state in plant.states:
        inside = any(state in names(node) for node in nodes if node not in wrapped)
        if inside and all(_turns(node, state) for node in nodes if node not in wrapped):
            yield state


def _turns(node: Node, state: str) -> bool:
    """Tell whether a node holds a state inside of cosine and sine alone, and once a turn."""
    if isinstance(node, Name):
        return node.id != state
    if not isinstance(node, Apply):
        return True
    if node.function in ('sin', 'cos') and node.arguments[0] == Name(state):
        return True
    return all(_turns(part, state) for part in node.arguments)
