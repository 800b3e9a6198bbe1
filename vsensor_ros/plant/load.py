"""
Read a plant file (YAML).

Keys: name, description, time (continuous, or {sample_time: seconds}), time_unit, parameters
(value, unit, spread, fit), tables (points, interpolation), definitions (value, unit, table,
interpolation, friction), states (unit, initial, process_noise, range, slow), inputs (unit,
operating, range, delay, process_noise), disturbances (unit, range, process_noise), sensors
(measures, unit, noise, tolerance, wrap, delay, stamp_offset, rate, table, interpolation),
operating_point, and the right-hand side: dynamics, one equation a state, or matrices A, B, C, Cu,
Cd, D, P with nonlinearities (function over w1.., of which combinations of states). Every number
may be an expression of the parameters. What is wrong gives one BadInput line that names the file,
the place and the mend.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.functions.curve import Curve
from vsensor_ros.functions.expression import (
    Apply,
    fold,
    MAX_CHARACTERS,
    Name,
    names,
    Node,
    Number,
    parse,
    substitute,
    to_text,
)
from vsensor_ros.functions.nonlinearity import argument_names, make_term
from vsensor_ros.plant.checked import check_distinct
from vsensor_ros.plant.dead_time import with_registers
from vsensor_ros.plant.entries import DEFINITION, Entries, TABLE
from vsensor_ros.plant.measurement import Measured, measurement
from vsensor_ros.plant.plain_name import plain_name
from vsensor_ros.plant.plant import Plant
from vsensor_ros.plant.plant_yaml import read_yaml
from vsensor_ros.plant.split import (
    addends,
    check_split,
    lifted,
    Split,
    split_equations,
    with_addends,
)
from vsensor_ros.plant.units import check_rates, converted
from vsensor_ros.plant.unknown_inputs import directions, unknown_inputs

TOP = ('name', 'description', 'time', 'time_unit', 'parameters', 'tables', 'definitions',
       'states', 'inputs', 'disturbances', 'dynamics', 'matrices', 'nonlinearities', 'sensors',
       'operating_point')


def load_plant(path: str | Path) -> Plant:
    """
    Read a plant file and return the plant, split into its matrices and nonlinear terms.

    The formal addends are taken at `operating_point` (default: the initial guess; for a
    file with `matrices` only when it is given), so that A is the linearisation there. The
    split is checked against the equations at random points. Raises BadInput, one line.
    """
    content = read_yaml(path)
    if isinstance(content, dict) and 'submodels' in content:
        raise BadInput(path, 'submodels', 'are for what estimates faults, or by hand',
                       'give dynamics or matrices; or ask with designer --faulty NAMES, or read '
                       'it with load_takagi_sugeno')
    file = Entries(path, TOP, content)
    return replace(read_plant(file), remake=_Again(path, file.content))


@dataclass(frozen=True)
class _Again:
    """Makes the plant of a file that was read anew, with its parameters times factors."""

    path: str | Path
    content: dict[str, Any]

    def __call__(self, factors: Mapping[str, float]) -> Plant:
        return replace(read_plant(Entries(self.path, TOP, self.content, factors)), remake=self)


def read_plant(file: Entries) -> Plant:
    """Return the plant of a file, and leave in `file` what its names stand for."""
    name = file.content.get('name')
    if name is None:
        raise file.fail('name', 'is missing', 'write name: my_plant')
    if not isinstance(file.content.get('description', ''), str):
        raise file.fail('description', 'is not a text', 'put it in quotes')
    sample_time = file.sample_time()
    unit = file.time_unit(sample_time)
    parameters = file.section('parameters', ('value', 'unit', 'spread', 'fit'), 'value')
    states = file.section('states', ('unit', 'initial', 'process_noise', 'range', 'slow'))
    inputs = file.section('inputs', ('unit', 'operating', 'range', 'delay', 'process_noise'))
    disturbances = file.section('disturbances', ('unit', 'range', 'process_noise'))
    sensors = file.section('sensors', ('measures', 'unit', 'noise', 'tolerance', 'wrap',
                                       'delay', 'stamp_offset', 'rate', *TABLE),
                           'measures')
    for key, entries in (('states', states), ('sensors', sensors)):
        if not entries:
            raise file.fail(key, 'is missing or empty', f'name the {key}')
    check_distinct(file.path, {'states': tuple(states), 'inputs': tuple(inputs),
                               'disturbances': tuple(disturbances),
                               'parameters': tuple(parameters),
                               **{key: tuple(file.mapping(file.content.get(key), key))
                                  for key in ('tables', 'definitions')}})
    file.read_parameters(parameters)
    file.read_tables()
    said = file.read_units(states, inputs, disturbances, parameters, file.section(
        'definitions', DEFINITION, 'value'))
    file.read_definitions((*states, *inputs, *disturbances))
    unwritten = _too_large(file, tuple(states), tuple(inputs), tuple(disturbances),
                           any('spread' in entry for entry in parameters.values()))
    disturbances |= {rate: {'process_noise': 0.0} for rate in unwritten.values()}
    if unwritten:
        said.append(f'the equations of {", ".join(unwritten)} are too large to be written out: '
                    'what is proved takes them for unknown inputs, '
                    f'{", ".join(unwritten.values())}; filters on the equations know them')
    initial = np.array([file.number(e.get('initial', 0.0), f'states.{s}.initial')
                        for s, e in states.items()])
    u = np.array([file.number(e.get('operating', 0.0), f'inputs.{i}.operating')
                  for i, e in inputs.items()])
    point = initial.copy()
    given = file.mapping(file.content.get('operating_point'), 'operating_point',
                         tuple(states), 'state')
    for i, state in enumerate(states):
        if state in given:
            point[i] = file.number(given[state], f'operating_point.{state}')

    slow = tuple(s for s, e in states.items() if file.truth(e, 'slow', f'states.{s}'))
    split, measured = _right_hand_side(file, tuple(states), tuple(inputs),
                                           tuple(disturbances), point, u, slow, unwritten)
    ranges = [file.ranges(key, entries) for key, entries in (
        ('states', states), ('inputs', inputs), ('disturbances', disturbances))]
    groups = tuple(states), tuple(inputs), tuple(disturbances)
    curves: dict[str, Curve] = {}
    bent: Sequence[Sequence[Node]] = [()] * len(sensors)
    split, noisy = split.slower(unit), math.sqrt(unit)
    if measured is None:
        shown_by = {sensor: _measurement(
            file, sensor, entry, groups, np.vstack(ranges),
            np.concatenate([point, u, np.zeros(len(disturbances))]))
            for sensor, entry in sensors.items()}
        measured = np.array([found.row for found in shown_by.values()])
        curves = {sensor: found.curve for sensor, found in shown_by.items() if found.curve}
        bent = [found.rest for found in shown_by.values()]
        said = [*said, *(f'{sensor} is nonlinear, and no linear map uses it: {found.why}'
                         for sensor, found in shown_by.items() if found.rest)]
    else:
        for sensor, entry in sensors.items():
            if 'measures' in entry:
                raise file.fail(f'sensors.{sensor}.measures', 'stands beside matrices.C',
                                'give one of the two')
    spreads = file.spreads(parameters)
    equations, definitions = _equations(file, tuple(states), spreads, unit)
    file.fits(parameters)
    late = {s: file.time(e, 'delay', f'sensors.{s}', sample_time)
            for s, e in sensors.items()}
    C, Cu, Cd = np.split(measured, [len(states), len(states) + len(inputs)], axis=1)
    D, pushing, unknown = split.D, disturbances, None
    units = _units(file, states, inputs, disturbances, sensors, measured)
    disturbance_noise = [file.deviation(e, 'process_noise', f'disturbances.{r}') * noisy
                         for r, e in disturbances.items()]
    if any((*split.rest, *bent)):
        found = directions(D, Cd, (*(split.rest or [()] * len(states)), *bent), groups[0],
                           tuple(sensors), groups[2], dict(zip(
                               (*states, *inputs, *disturbances), np.vstack(ranges).tolist())))
        unknown = unknown_inputs(found, groups[2], ranges[2], disturbance_noise, file.path)
        D, Cd, said = found.D, found.Cd, [*said, *found.said]
        pushing = {name: disturbances.get(name, {}) for name in found.names}
        units = {name: unit for name, unit in units.items()
                 if name not in disturbances or name in pushing}
        known = [groups[2].index(name) if name in groups[2] else -1 for name in pushing]
        ranges[2] = np.vstack([ranges[2], [-np.inf, np.inf]])[known]
        disturbance_noise = [*disturbance_noise, np.nan]
        disturbance_noise = [disturbance_noise[i] for i in known]
    plant = Plant.from_matrices(
        split.A, split.B, C, D=D, sample_time=sample_time, P=split.P, G=split.G,
        nonlinearities=split.terms, states=tuple(states), inputs=tuple(inputs),
        sensors=tuple(sensors), disturbances=tuple(pushing), unknown=unknown, units=units,
        initial=initial,
        noise=[file.deviation(e, 'noise', f'sensors.{s}') for s, e in sensors.items()],
        parameters=file.parameters, operating_point=point, operating_input=u, Cu=Cu, Cd=Cd,
        process_noise=[file.deviation(e, 'process_noise', f'states.{s}') / noisy
                       for s, e in states.items()],
        ranges=ranges[0], input_range=ranges[1], disturbance_range=ranges[2], slow=slow,
        tolerances={s: file.tolerance(e['tolerance'], f'sensors.{s}.tolerance')
                    for s, e in sensors.items() if 'tolerance' in e},
        wrap=[file.turn(e, f'sensors.{s}.wrap') for s, e in sensors.items()], curves=curves,
        input_delay=[file.time(e, 'delay', f'inputs.{i}', sample_time)
                     for i, e in inputs.items()],
        sensor_delay=[late[s] * (sample_time is None)
                      + file.time(e, 'stamp_offset', f'sensors.{s}')
                      for s, e in sensors.items()],
        sensor_rate=[file.rate(e, f'sensors.{s}.rate') for s, e in sensors.items()],
        input_noise=[file.deviation(e, 'process_noise', f'inputs.{i}') * noisy
                     for i, e in inputs.items()],
        disturbance_noise=disturbance_noise,
        spreads=spreads, equations=equations, definitions=definitions,
        unwritten=tuple(unwritten.values()), remarks=said,
        name=name, where=file.path)
    return plant if sample_time is None else with_registers(
        plant, {s: round(delay / sample_time) for s, delay in late.items() if delay},
        file.path)


def _measurement(file: Entries, sensor: str, entry: Mapping[str, Any],
                groups: Sequence[Sequence[str]], ranges: np.ndarray,
                point: np.ndarray) -> Measured:
    """Read what a sensor measures, see `measurement`."""
    place = f'sensors.{sensor}.measures'
    text = file.required(entry, 'measures', f'sensors.{sensor}',
                         'say which state it measures')
    node = in_its_unit(file, file.expression(
        text, place, [name for names in groups for name in names]), sensor, entry)
    found = measurement(node, text, groups, ranges, point, file.path, place)
    if 'wrap' in entry and (found.rest or (found.curve is not None and found.curve.text)):
        raise file.fail(place, 'is a curve, and wraps', 'leave out one of them')
    return found


def in_its_unit(file: Entries, node: Node, sensor: str, entry: Mapping[str, Any]) -> Node:
    """Return what a sensor shows: what it measures in its own unit, by its table."""
    if file.units_of is not None and 'table' not in entry:
        factor, offset = converted(file.units_of, file.raw(entry['measures']),
                                   entry.get('unit', ''), sensor)
        node = node if factor == 1.0 else Apply('*', (Number(factor), node))
        node = fold(Apply('+', (node, Number(offset)))) if offset else node
    return file.tabled(node, entry, f'sensors.{sensor}')


def _units(file: Entries, states: Mapping[str, Mapping[str, Any]],
          inputs: Mapping[str, Mapping[str, Any]],
          disturbances: Mapping[str, Mapping[str, Any]],
          sensors: Mapping[str, Mapping[str, Any]], measured: np.ndarray) -> dict[str, str]:
    units = {name: entry.get('unit', '')
             for group in (states, inputs, disturbances) for name, entry in group.items()}
    everything = tuple(units)
    for (name, entry), row in zip(sensors.items(), measured):
        # a sensor of one state alone has that state's unit unless it says otherwise
        alone = np.count_nonzero(row) == 1 and row.max(initial=0.0) == 1.0
        unit = entry.get('unit', units[everything[int(np.argmax(row))]] if alone else '')
        if name in states and unit != units[name]:
            raise file.fail(f'sensors.{name}.unit', f'{shown(unit)} differs from that of '
                            f'the state {name}, {shown(units[name])}',
                            'give both the same, or rename the sensor')
        units[name] = unit
    return units


def _right_hand_side(file: Entries, states: tuple[str, ...], inputs: tuple[str, ...],
                    disturbances: tuple[str, ...], point: np.ndarray, u: np.ndarray,
                    slow: tuple[str, ...], unwritten: Mapping[str, str],
                    ) -> tuple[Split, np.ndarray | None]:
    by_equations = 'dynamics' in file.content
    if by_equations == ('matrices' in file.content):
        raise file.fail('dynamics', 'and matrices are both there' if by_equations
                        else 'is missing', 'give one equation a state under dynamics, '
                        'or matrices')
    if not by_equations:
        split, measured = _matrices(file, states, inputs, disturbances)
        if 'operating_point' in file.content:
            split = with_addends(split, point, inputs, u)
        return split, measured
    if 'nonlinearities' in file.content:
        raise file.fail('nonlinearities', 'stands beside dynamics',
                        'write them in the equations')
    continuous = file.content['time'] == 'continuous'
    texts = {**{state: '0' if continuous else state for state in slow},
             **file.mapping(file.content['dynamics'], 'dynamics', states, 'state')}
    for state in states:
        if texts.get(state) is None:
            raise file.fail(f'dynamics.{state}', 'is missing',
                            'write one equation a state')
    variables = (*states, *inputs, *disturbances)
    equations = [Name(unwritten[s]) if s in unwritten else
                 file.by_name(texts[s], f'dynamics.{s}', variables) for s in states]
    if file.units_of is not None:
        unit = file.content.get('time_unit', 's') if continuous else None
        check_rates(file.units_of, {s: file.raw(texts[s]) for s in states}, unit,
                    'time_unit' in file.content)
    split = with_addends(split_equations(
        equations, states, inputs, disturbances, file.path, definitions=file.definitions),
        point, inputs, u)
    check_split(split, [fold(substitute(e, file.definitions)) for e in equations], states,
                inputs, disturbances, point, file.path)
    return split, None


def _too_large(file: Entries, states: Sequence[str], inputs: Sequence[str],
               disturbances: Sequence[str], filters: bool) -> dict[str, str]:
    """
    Return by state whose equation is too large to be written out what stands for its rate.

    Those that share definitions with one go with it. filters: these are wanted, and so texts.
    """
    variables, texts = (*states, *inputs, *disturbances), file.content.get('dynamics')
    given = {state: text for state, text in texts.items() if state in states
             and text is not None} if isinstance(texts, dict) else {}
    named = [name for name in file.parameters if '[' not in name]

    def is_too_large(text: Any, key: str) -> bool:
        if file.is_large(text, key, variables):
            return True
        node = file.by_name(text, key, variables)
        if len(to_text(substitute(node, file.definitions))) > MAX_CHARACTERS and not all(
                _can_be_read(to_text(lifted(core, states, inputs, [], file.definitions)))
                for _, core in addends(node, file.path, key, file.definitions)[1]):
            return True
        return filters and bool(file.needed(names(file.raw(text)))) and not _can_be_read(
            to_text(file.with_names(text, key, named, True)))
    large = [state for state, text in given.items() if is_too_large(text, f'dynamics.{state}')]
    shared = {name for state in large for name in file.needed(names(file.raw(given[state])))}
    return {state: f'{state}_rate' for state, text in given.items() if state in large
            or not shared.isdisjoint(file.needed(names(file.raw(text))))}


def _can_be_read(text: str) -> bool:
    try:
        parse(text)
    except BadInput:
        return False
    return True


def _equations(file: Entries, states: tuple[str, ...], spreads: Mapping[str, float],
               unit: float) -> tuple[list[str], list[tuple[str, str]]]:
    """
    Return the right-hand sides per second with parameters by name; [] if not by equations.

    And the definitions that they use, where they are too long with these written out.
    """
    if 'dynamics' not in file.content:
        if spreads:
            raise file.fail('parameters', f'{next(iter(spreads))} has a spread, which only '
                            'equations can use', 'give one equation a state under dynamics')
        return [], []
    texts = {**{s: '0' if file.content['time'] == 'continuous' else s for s in states},
             **file.content['dynamics']}
    named = [name for name in file.parameters if '[' not in name]

    def right_hand_side(state: str, written_out: bool) -> Node:
        node = file.with_names(texts[state], f'dynamics.{state}', named, written_out)
        return node if unit == 1.0 else fold(Apply('/', (node, Number(unit))))
    if not file.large:
        found = [to_text(right_hand_side(state, True)) for state in states]
        if all(map(_can_be_read, found)):
            return found, []
    nodes = [right_hand_side(state, False) for state in states]
    found = list(map(to_text, nodes))
    if not all(map(_can_be_read, found)):
        return [], []
    return found, file.kept_texts({name for node in nodes for name in names(node)}, named)


def _matrices(file: Entries, states: tuple[str, ...], inputs: tuple[str, ...],
             disturbances: tuple[str, ...]) -> tuple[Split, np.ndarray | None]:
    given = file.mapping(file.content['matrices'], 'matrices',
                         ('A', 'B', 'C', 'Cu', 'Cd', 'D', 'P'))
    n = len(states)
    items = file.content.get('nonlinearities') or []
    if not isinstance(items, list):
        raise file.fail('nonlinearities', 'is not a list',
                        "write - {function: 'sqrt(w1)', of: [level1 - level2]}")
    terms, rows = [], []
    for i, item in enumerate(items):
        key = f'nonlinearities[{i}]'
        entry = file.mapping(item, key, ('function', 'of'))
        of = entry.get('of', [])
        of = of if isinstance(of, list) else [of]
        G = np.array([file.linear(text, f'{key}.of', states) for text in of]
                     ).reshape(len(of), n)
        node = file.expression(
            file.required(entry, 'function', key, 'write it over w1, w2, ...'),
            f'{key}.function', (*argument_names(len(G)), *inputs))
        term = make_term(to_text(node), len(G), inputs, file.path, f'{key}.function')
        terms.append(replace(term, name=plain_name(node, G, states)))
        rows.append(G)
    sizes = {'A': n, 'B': len(inputs), 'D': len(disturbances), 'P': len(terms)}
    arrays = {letter: file.matrix(given.get(letter), f'matrices.{letter}', n, width)
              for letter, width in sizes.items()}
    measured = None
    if not given.keys().isdisjoint(('C', 'Cu', 'Cd')):
        sensors = len(file.content['sensors'])
        blocks = [file.matrix(given.get('C'), 'matrices.C', sensors, n)]
        for letter, width in (('Cu', len(inputs)), ('Cd', len(disturbances))):
            blocks.append(file.matrix(given[letter], f'matrices.{letter}', sensors, width)
                          if letter in given else np.zeros((sensors, width)))
        measured = np.hstack(blocks)
    return Split(arrays['A'], arrays['B'], arrays['D'], arrays['P'], tuple(rows),
                 tuple(terms)), measured
