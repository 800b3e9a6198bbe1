"""
What an engineer would say of a plant and its design: figures that are good for nothing, and why.

Each is one line with its mend. Nothing here changes a design.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from vsensor_ros.designer.existence import avoidable_signs
from vsensor_ros.designer.problem import pose
from vsensor_ros.functions.expression import Apply, gradient, names, Node, parse, walk
from vsensor_ros.functions.nonlinearity import argument_names, evaluate, slope_at
from vsensor_ros.observers import Design, ExtendedSensor, VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.plant.units import per_second

UNBALANCED = 0.02  # of the addends of an equation: what is left of them at an equilibrium
DEAR = 2.0  # times the noise without friction
STEEP = 5.0  # times the fastest mode of the rest of the plant
NEAR = 1.5  # the argument of a tanh that is steep there
MOST_INPUTS = 30  # for which it is looked for an equilibrium

Again = Callable[[Plant, tuple[str, ...]], Design]
LITTLE = 1e-6  # of a parameter, by which its slope is found


def advice(plant: Plant, design: Design, again: Again) -> tuple[str, ...]:
    """
    Return what is to be minded, a line each.

    again: designs one fault set of another plant, to see what something costs.
    """
    lines = [*_beyond_ranges(plant), *_steep(plant), *_unbalanced(plant),
             *_spread_readings(plant, design), *_turns(design)]
    for (fault_set, channel), entry in design.entries.items():
        if not isinstance(entry, VirtualSensor) or entry.noise is None or \
                entry.grade == 'temporary':
            continue
        without = f'{channel}, when {" and ".join(fault_set)} failed' \
            if len(fault_set) > 1 else channel
        low, high = design.ranges.get(channel, (-np.inf, np.inf))
        unit, guess = design.units.get(channel, ''), (high - low) / np.sqrt(12.0)
        if entry.noise.error > guess:
            lines.append(
                f'{without}: noise error {_figure(entry.noise.error, unit)}, more than that of '
                f'guessing the middle of its range, {_figure(guess, unit)}: it is of no use; '
                'give process_noise as it is, or add a sensor')
        lines += _dear_friction(plant, entry, unit, without, again)
    return tuple(dict.fromkeys(lines))


def _beyond_ranges(plant: Plant) -> Iterator[str]:
    """Find states and inputs that do not work where they are said to live."""
    for key, names_, point, ranges in (
            ('operating_point', plant.states, plant.operating_point, plant.ranges),
            ('operating', plant.inputs, plant.operating_input, plant.input_range)):
        for name, value, (low, high) in zip(names_, point, ranges):
            if not low <= value <= high:
                yield (f'{name} works at {_figure(value, plant.units[name])}, outside its range, '
                       f'{low:.4g} to {high:.4g}: all slopes are taken there; give '
                       + (f'{key}: {{{name}: ..}}' if key == 'operating_point' else
                          f'its {key}: ..') + ' within it')


def _spread_readings(plant: Plant, design: Design) -> Iterator[str]:
    """Find parameters not known exactly that move what sensors read: filters take it as exact."""
    model = next((entry.model for entry in design.virtual_sensors
                  if isinstance(entry, ExtendedSensor)), None)
    if model is None or plant.remake is None:
        return
    spreads = {**dict(zip(model.parameters, model.spreads)), **plant.spreads}
    for name, spread in spreads.items():
        value = plant.parameters[name]
        if not value or not spread:
            continue
        other = plant.remake({name: 1.0 + LITTLE})
        C, Cu = ((new - old) * spread / (LITTLE * abs(value)) for new, old in (
            (other.C, plant.C), (other.Cu, plant.Cu)))
        off = np.abs(C @ plant.operating_point + Cu @ plant.operating_input)
        for sensor, size in zip(plant.sensors, off):
            i = plant.sensors.index(sensor)
            if C[i].any() or Cu[i].any():
                size_there = _figure(float(size), plant.units.get(sensor, ''))
                yield (f'the spread of {name} is not counted with in what {sensor} reads '
                       f'({size_there} at the operating point): filters are off by more than '
                       'they say; make it part of the noise, or a slow state')


def _turns(design: Design) -> Iterator[str]:
    """Find angles as cosine and sine, which know no turns, whose sensors are not said to wrap."""
    wraps = {name for turns in design.wrap for name in turns}
    for entry in design.virtual_sensors:
        if isinstance(entry, ExtendedSensor) and entry.model.angle and \
                entry.channel not in wraps:
            turn = abs(float(entry.model.factors[design.sensors.index(entry.channel)]))
            yield (f'{entry.channel}: cosine and sine of {entry.model.angle} do not tell whole '
                   f'turns, and it is not said that it wraps: give it wrap: {2 * np.pi * turn:.6g}'
                   f'{" (2*pi)" if turn == 1.0 else ""}')


def _steep(plant: Plant) -> Iterator[str]:
    """Find friction written as tanh(x/eps) that is linearised where it is steep."""
    for term, g, column in zip(plant.terms, plant.G, plant.P.T):
        if plant.sample_time is not None or not len(g):
            continue
        w, arguments = g @ plant.operating_point, argument_names(len(g))
        at = {**dict(zip(arguments, map(float, w))),
              **dict(zip(plant.inputs, map(float, plant.operating_input)))}
        inner = [part.arguments[0] for part in walk(parse(term.text))
                 if isinstance(part, Apply) and part.function == 'tanh']
        inner = [node for node in inner if abs(gradient(node, at, arguments)[0]) < NEAR]
        if not inner:
            continue
        slope = slope_at(term, w, plant.inputs, plant.operating_input)
        more = np.outer(column, slope @ g)
        damping = np.abs(np.diag(more))
        rest = float(np.abs(np.linalg.eigvals(plant.A - more)).max(initial=0.0))
        state = int(np.argmax(damping))
        if damping[state] <= STEEP * rest or not damping[state]:
            continue
        yield (f'{term.short}: the operating point is where it is steep: its slope adds '
               f'{damping[state]:.3g} 1/s to {plant.states[state]}, all else has {rest:.3g} 1/s, '
               'and governs the gains; give an operating_point in motion'
               + _beyond(inner[0], g, plant))


def _beyond(inner: Node, g: np.ndarray, plant: Plant) -> str:
    """Say from where on a tanh is flat, where that is a matter of one state."""
    at = dict.fromkeys(names(inner), 0.0)
    arguments = argument_names(len(g))
    row = gradient(inner, at, arguments)[1] @ g
    of = np.flatnonzero(row)
    return '' if len(of) != 1 else f', such as {plant.states[of[0]]}: {3.0 / abs(row[of[0]]):.3g}'


def _unbalanced(plant: Plant) -> Iterator[str]:
    """Find an operating point of terms at which the plant does not stay."""
    x, u = plant.operating_point, plant.operating_input
    bent = [i for i, g in enumerate(plant.G) if len(g)]
    if not bent:
        return
    own = np.eye(len(x)) * (plant.sample_time is not None)
    # what no term depends on, such as a position, may move on
    acts = plant.A - own != 0.0
    for g, column in zip(plant.G, plant.P.T):
        acts |= np.outer(column != 0.0, g.any(axis=0))
    matters = np.any([plant.G[i].any(axis=0) for i in bent], axis=0)
    for _ in x:
        matters = matters | acts[matters].any(axis=0)

    def left(u: np.ndarray) -> np.ndarray:
        rate = plant.rate_of_change(x, u)
        return rate - x if plant.sample_time is not None else rate

    psi = np.array([float(evaluate(term, g @ x, plant.inputs, u))
                    for term, g in zip(plant.terms, plant.G)])
    size = np.abs(plant.A - own) @ np.abs(x) + np.abs(plant.B) @ np.abs(u) + np.abs(
        plant.P) @ np.abs(psi)
    residual = left(u)
    off = matters & (np.abs(residual) > UNBALANCED * size)
    if not off.any() or not np.isfinite(residual).all():
        return
    shown = ', '.join(f'{plant.states[i]} {residual[i]:+.3g} {_per(plant, i)}'
                      for i in np.flatnonzero(off)[:6])
    yield f'the operating point is no equilibrium: {shown}; {_mend(plant, left, u, size, matters)}'


def _per(plant: Plant, i: int) -> str:
    unit = plant.units[plant.states[i]]
    if plant.sample_time is not None:
        return f'{unit} a step'.strip()
    return per_second(unit)


def _mend(plant: Plant, left: Callable[[np.ndarray], np.ndarray], u: np.ndarray,
          size: np.ndarray, matters: np.ndarray) -> str:
    """Say which input would make it one, if any does."""
    if 0 < len(u) <= MOST_INPUTS:
        weight = np.where(size > 0.0, size, 1.0)[matters]
        scale = np.where(u != 0.0, np.abs(u), 1.0)
        found = least_squares(lambda v: (left(u + v * scale) / np.where(
            size > 0.0, size, 1.0))[matters], np.zeros(len(u)))
        new = u + found.x * scale
        if (np.abs(left(new)[matters]) <= 0.1 * UNBALANCED * weight).all():
            moved = [f'{name} = {value:.4g}' for name, value, old in zip(plant.inputs, new, u)
                     if abs(value - old) > 1e-6 * max(1.0, abs(old))]
            return 'it would be one at ' + ', '.join(moved)
    return 'no input makes it one: choose another operating_point'


def _dear_friction(plant: Plant, entry: VirtualSensor, unit: str, without: str,
                   again: Again) -> list[str]:
    """Tell when it is dry friction on a measured speed that makes a design worse."""
    assert entry.noise is not None
    if entry.noise.ratio < DEAR or entry.channel not in plant.sensors:
        return []
    signs = sorted(avoidable_signs(pose(plant, entry.fault_set, entry.channel))
                   - set(entry.active))
    if not signs:
        return []
    kept = [i for i in range(len(plant.terms)) if i not in signs]
    bare = again(replace(plant, P=plant.P[:, kept], G=tuple(plant.G[i] for i in kept),
                         terms=tuple(plant.terms[i] for i in kept)), entry.fault_set)
    found = bare[entry.fault_set, entry.channel]
    if not isinstance(found, VirtualSensor) or found.noise is None or \
            entry.noise.error < DEAR * found.noise.error:
        return []
    dropped = sorted({*found.reads, *found.commands} - {*entry.reads, *entry.commands})
    lost = f', and what {" and ".join(dropped)} tells is not used' if dropped else ''
    terms = ' and '.join(plant.terms[i].short for i in signs)
    return [f'{without}: {terms} costs most of its quality: noise error '
            f'{_figure(entry.noise.error, unit)}, without it {_figure(found.noise.error, unit)}'
            f'{lost}: at rest no reading of a speed tells what it is, so it is kept out; write '
            'tanh(speed/eps) for sign(speed) if it seldom rests']


def _figure(value: float, unit: str) -> str:
    return f'{value:.3g} {unit}'.rstrip()
