"""
Read a plant file (YAML).

Keys: name, description, time (continuous, or {sample_time: seconds}), parameters, states (unit,
initial, process_noise, range, slow), inputs (unit, operating, range, delay), disturbances (unit,
range), sensors (measures, unit, noise, tolerance, wrap, delay, stamp_offset, rate),
operating_point, and the right-hand side: dynamics, one equation a state, or matrices A, B, C, Cu,
Cd, D, P with nonlinearities (function over w1.., of which combinations of states). Every number
may be an expression of the parameters. What is wrong gives one BadInput line that names the file,
the place and the mend.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
import math
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import yaml

from vsensor_ros.bad_input import BadInput, check_text, shown
from vsensor_ros.functions.affine import affine
from vsensor_ros.functions.curve import Curve
from vsensor_ros.functions.expression import (
    Apply,
    check_name,
    fold,
    function_of,
    Node,
    Number,
    parse,
    substitute,
    table_node,
    to_text,
)
from vsensor_ros.functions.nonlinearity import argument_names, make_term
from vsensor_ros.plant.dead_time import with_registers
from vsensor_ros.plant.measurement import measurement
from vsensor_ros.plant.plant import check_distinct, plain_name, Plant, suggestion
from vsensor_ros.plant.split import (
    addends,
    check_split,
    Split,
    split_equations,
    with_addends,
)
from vsensor_ros.text_file import read_text

LARGEST_FILE = 2**20    # bytes
LARGEST_SECTION = 1000   # states, inputs, ...; keeps a forged file from eating the memory
_TOP = ('name', 'description', 'time', 'time_unit', 'parameters', 'definitions', 'states',
        'inputs', 'disturbances', 'dynamics', 'matrices', 'nonlinearities', 'sensors',
        'operating_point')
_SECONDS = {'us': 1e-6, 'ms': 1e-3, 's': 1.0, 'min': 60.0, 'h': 3600.0, 'd': 86400.0}
_TABLE = ('table', 'interpolation')
_SHAPES = {'linear': 'table', 'cubic': 'smooth_table'}


class _Loader(yaml.SafeLoader):
    """SafeLoader that refuses aliases (they can grow without bound), repeated keys, booleans."""

    where: object = ''

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            line = self.peek_event().start_mark.line + 1
            raise BadInput(self.where, f'line {line}', 'an alias (*) is not read here',
                           'write the value out')
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen: dict[Any, int] = {}
        for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
            if key.value == 'slow' and isinstance(value, yaml.ScalarNode):
                value.tag = 'tag:yaml.org,2002:str'  # the one truth value there is
            line = key.start_mark.line + 1
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise BadInput(self.where, f'line {line}', f'{shown(key.value)} stands '
                                   f'there twice (first in line {seen[key.value]})',
                                   'give each name once')
                seen[key.value] = line
        return super().construct_mapping(node, deep)

    def refuse_bool(self, node: yaml.ScalarNode) -> NoReturn:
        raise BadInput(self.where, f'line {node.start_mark.line + 1}', f'YAML reads {node.value} '
                       'as a truth value (so with on, off, yes, no)', f"write '{node.value}'")


_Loader.add_constructor('tag:yaml.org,2002:bool', _Loader.refuse_bool)


def _read(path: str | Path) -> Any:
    text = read_text(path, '', 'name a plant file (YAML)', LARGEST_FILE)
    try:
        loader = _Loader(text)
        loader.where = path
        return loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise BadInput(path, f'line {mark.line + 1}' if mark else '',
                       f'is not YAML ({error.problem or error.context})',
                       'correct the line or the one before it') from None
    except BadInput:
        raise
    except (RecursionError, ValueError, OverflowError, TypeError, KeyError) as error:
        # dates that do not exist, integers of thousands of digits, thousands of brackets
        problem = 'is nested too deeply' if isinstance(error, RecursionError) \
            else f'holds a value that cannot be read ({shown(str(error))})'
        raise BadInput(path, '', problem, 'write numbers and names only') from None


def load_plant(path: str | Path) -> Plant:
    """
    Read a plant file and return the plant, split into its matrices and nonlinear terms.

    The formal addends are taken at `operating_point` (default: the initial guess; for a
    file with `matrices` only when it is given), so that A is the linearisation there. The
    split is checked against the equations at random points. Raises BadInput, one line.
    """
    return _File(path).plant()


class _File:
    """One plant file being read: where errors are, and the parameters known so far."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        content = _read(path)
        if content is None:
            raise BadInput(path, '', 'is empty', 'write a plant file')
        self.content = self.mapping(content, '', _TOP)
        self.parameters: dict[str, float] = {}
        self.arrays: dict[str, list[Any]] = {}
        self.definitions: dict[str, Node] = {}  # without names of others
        self.written: dict[str, Node] = {}  # those whose names give way to what they are

    def fail(self, key: str, problem: str, mend: str) -> BadInput:
        return BadInput(self.path, key, problem, mend)

    def mapping(self, value: Any, key: str, allowed: Iterable[str] | None = None,
                what: str = 'key') -> dict[Any, Any]:
        if value is None:
            return {}
        if not isinstance(value, dict):
            raise self.fail(key, f'{shown(value)} is not a mapping (name: value)',
                            'write "name: value" lines')
        if allowed is not None:
            for name in value:
                if name not in allowed:
                    raise self.fail(key, f'unknown {what} {shown(name)}',
                                    suggestion(name, allowed))
        return value

    def section(self, key: str, allowed: Sequence[str],
                short: str | None = None) -> dict[str, dict[str, Any]]:
        """Read `key: {name: {..}, ..}`; short: the entry that a bare value stands for."""
        entries: dict[str, dict[str, Any]] = {}
        values = self.mapping(self.content.get(key), key)
        if len(values) > LARGEST_SECTION:
            raise self.fail(key, f'has {len(values)} entries', f'keep it within {LARGEST_SECTION}')
        for name, value in values.items():
            check_name(name, self.path, key)
            if short is not None and not isinstance(value, dict) and value is not None:
                value = {short: value}
            entries[name] = self.mapping(value, f'{key}.{name}', (*allowed, 'description'))
            for kind in ('unit', 'description'):
                check_text(entries[name].get(kind, ''), self.path, f'{key}.{name}.{kind}')
        return entries

    def number(self, value: Any, key: str) -> float:
        node = fold(self.expression(value, key, ()), self.path, key)
        assert isinstance(node, Number)
        return node.value

    def expression(self, value: Any, key: str, variables: Iterable[str]) -> Node:
        return fold(substitute(self.by_name(value, key, variables), self.definitions), self.path,
                    key)

    def by_name(self, value: Any, key: str, variables: Iterable[str]) -> Node:
        """Read an expression in which definitions that are nonlinear addends keep their names."""
        node = parse(value, self.path, key,
                     known=(*variables, *self.parameters, *self.definitions))
        return fold(substitute(substitute(node, self.parameters), self.written), self.path, key)

    def read_parameters(self, parameters: Mapping[str, Mapping[str, Any]]) -> None:
        for key, entry in parameters.items():
            place = f'parameters.{key}'
            value = self.required(entry, 'value', place, 'give its value')
            if isinstance(value, list):
                self.arrays[key] = value
                self.array(value, key)
            else:
                self.parameters[key] = self.number(value, place)

    def array(self, values: list[Any], name: str) -> None:
        """Read the elements of an array as parameters of their own: k[0], k[1][2]."""
        if len(self.parameters) + len(values) > LARGEST_SECTION:
            raise self.fail('parameters', f'has more than {LARGEST_SECTION} numbers',
                            'leave some out')
        for i, value in enumerate(values):
            element = f'{name}[{i}]'
            if isinstance(value, list):
                if name.count('['):
                    raise self.fail(f'parameters.{element}', 'is a list in a list in a list',
                                    'give rows of numbers')
                self.array(value, element)
            else:
                self.parameters[element] = self.number(value, f'parameters.{element}')

    def read_definitions(self, variables: Sequence[str]) -> None:
        """Read intermediate expressions; a later one may use earlier ones."""
        for name, entry in self.section('definitions', ('value', 'unit', *_TABLE),
                                        'value').items():
            place = f'definitions.{name}'
            text = self.required(entry, 'value', place, 'write what it is')
            node = self.tabled(self.by_name(text, place, variables), entry, place)
            whole = fold(substitute(node, self.definitions), self.path, place)
            linear, cores = addends(whole, self.path, place)
            friction = [core for _, core in cores
                        if isinstance(core, Apply) and function_of(core).set_valued]
            if linear or len(cores) != 1 or friction:
                self.written[name] = node
            self.definitions[name] = whole

    def tabled(self, node: Node, entry: Mapping[str, Any], place: str) -> Node:
        """Return the lookup table of a node, where there is one; else itself."""
        if 'table' not in entry:
            if 'interpolation' in entry:
                raise self.fail(f'{place}.interpolation', 'stands there without a table',
                                'give table: [[x, y], ..]')
            return node
        rows, key = entry['table'], f'{place}.table'
        rows = self.arrays.get(rows, rows) if isinstance(rows, str) else rows
        if not isinstance(rows, list) or not all(isinstance(r, list) and len(r) == 2
                                                 for r in rows):
            raise self.fail(key, f'{shown(rows)} is no list of points', 'write [[x, y], [x, y]]')
        shape = entry.get('interpolation', 'linear')
        if shape not in _SHAPES:
            raise self.fail(f'{place}.interpolation', f'{shown(shape)} is not known',
                            f'write {" or ".join(_SHAPES)}')
        points = [Number(self.number(v, f'{key}[{i}]')) for i, row in enumerate(rows) for v in row]
        return table_node(_SHAPES[shape], node, *points, where=self.path, key=key)

    def linear(self, value: Any, key: str, states: Sequence[str]) -> np.ndarray:
        """Read a linear expression as one row over the states."""
        form = affine(self.expression(value, key, states))
        if form is None or not form or '' in form:
            raise self.fail(key, f'{shown(value)} is not linear in the states' if form is None
                            else f'{shown(value)} has an offset' if form
                            else f'{shown(value)} holds no state',
                            'write a sum of states with factors, such as level1 - level2')
        return np.array([form.get(name, 0.0) for name in states])

    def sample_time(self) -> float | None:
        value = self.content.get('time')
        if value == 'continuous':
            return None
        if not isinstance(value, dict):
            raise self.fail('time', 'is missing' if value is None else
                            f'{shown(value)} is not understood',
                            'write continuous or {sample_time: seconds}')
        given = self.mapping(value, 'time', ('sample_time',))
        seconds = self.number(self.required(given, 'sample_time', 'time', 'give seconds'),
                              'time.sample_time')
        if seconds <= 0.0:
            raise self.fail('time.sample_time', f'{seconds:g} is not positive', 'give seconds')
        return seconds

    def time_unit(self, sample_time: float | None) -> float:
        """Read how many seconds the equations' unit of time has."""
        unit = self.content.get('time_unit', 's')
        if unit not in _SECONDS:
            raise self.fail('time_unit', f'{shown(unit)} is not known',
                            f'write one of {", ".join(_SECONDS)}')
        if 'time_unit' in self.content and sample_time is not None:
            raise self.fail('time_unit', 'stands beside a sample time',
                            'leave it out: the equations give the next values, not rates')
        return _SECONDS[unit]

    def plant(self) -> Plant:
        name = self.content.get('name')
        if name is None:
            raise self.fail('name', 'is missing', 'write name: my_plant')
        if not isinstance(self.content.get('description', ''), str):
            raise self.fail('description', 'is not a text', 'put it in quotes')
        sample_time = self.sample_time()
        unit = self.time_unit(sample_time)
        parameters = self.section('parameters', ('value', 'unit'), 'value')
        states = self.section('states', ('unit', 'initial', 'process_noise', 'range', 'slow'))
        inputs = self.section('inputs', ('unit', 'operating', 'range', 'delay'))
        disturbances = self.section('disturbances', ('unit', 'range'))
        sensors = self.section('sensors', ('measures', 'unit', 'noise', 'tolerance', 'wrap',
                                           'delay', 'stamp_offset', 'rate', *_TABLE),
                               'measures')
        for key, entries in (('states', states), ('sensors', sensors)):
            if not entries:
                raise self.fail(key, 'is missing or empty', f'name the {key}')
        check_distinct(self.path, {'states': tuple(states), 'inputs': tuple(inputs),
                                   'disturbances': tuple(disturbances),
                                   'parameters': tuple(parameters),
                                   'definitions': tuple(self.mapping(
                                       self.content.get('definitions'), 'definitions'))})
        self.read_parameters(parameters)
        self.read_definitions((*states, *inputs, *disturbances))
        initial = np.array([self.number(e.get('initial', 0.0), f'states.{s}.initial')
                            for s, e in states.items()])
        u = np.array([self.number(e.get('operating', 0.0), f'inputs.{i}.operating')
                      for i, e in inputs.items()])
        point = initial.copy()
        given = self.mapping(self.content.get('operating_point'), 'operating_point',
                             tuple(states), 'state')
        for i, state in enumerate(states):
            if state in given:
                point[i] = self.number(given[state], f'operating_point.{state}')

        slow = tuple(s for s, e in states.items() if self.truth(e, 'slow', f'states.{s}'))
        split, measured = self.right_hand_side(tuple(states), tuple(inputs),
                                               tuple(disturbances), point, u, slow)
        ranges = [self.ranges(key, entries) for key, entries in (
            ('states', states), ('inputs', inputs), ('disturbances', disturbances))]
        groups = tuple(states), tuple(inputs), tuple(disturbances)
        curves: dict[str, Curve] = {}
        split, noisy = split.slower(unit), math.sqrt(unit)
        if measured is None:
            rows = []
            for sensor, entry in sensors.items():
                row, curve = self.measurement(
                    sensor, entry, groups, np.vstack(ranges),
                    np.concatenate([point, u, np.zeros(len(disturbances))]))
                rows.append(row)
                if curve is not None:
                    curves[sensor] = curve
            measured = np.array(rows)
        else:
            for sensor, entry in sensors.items():
                if 'measures' in entry:
                    raise self.fail(f'sensors.{sensor}.measures', 'stands beside matrices.C',
                                    'give one of the two')
        late = {s: self.time(e, 'delay', f'sensors.{s}', sample_time)
                for s, e in sensors.items()}
        C, Cu, Cd = np.split(measured, [len(states), len(states) + len(inputs)], axis=1)
        plant = Plant.from_matrices(
            split.A, split.B, C, D=split.D, sample_time=sample_time, P=split.P, G=split.G,
            nonlinearities=split.terms, states=tuple(states), inputs=tuple(inputs),
            sensors=tuple(sensors), disturbances=tuple(disturbances),
            units=self.units(states, inputs, disturbances, sensors, measured), initial=initial,
            noise=[self.deviation(e, 'noise', f'sensors.{s}') for s, e in sensors.items()],
            parameters=self.parameters, operating_point=point, operating_input=u, Cu=Cu, Cd=Cd,
            process_noise=[self.deviation(e, 'process_noise', f'states.{s}') / noisy
                           for s, e in states.items()],
            ranges=ranges[0], input_range=ranges[1], disturbance_range=ranges[2], slow=slow,
            tolerances={s: self.tolerance(e['tolerance'], f'sensors.{s}.tolerance')
                        for s, e in sensors.items() if 'tolerance' in e},
            wrap=[self.turn(e, f'sensors.{s}.wrap') for s, e in sensors.items()], curves=curves,
            input_delay=[self.time(e, 'delay', f'inputs.{i}', sample_time)
                         for i, e in inputs.items()],
            sensor_delay=[late[s] * (sample_time is None)
                          + self.time(e, 'stamp_offset', f'sensors.{s}')
                          for s, e in sensors.items()],
            sensor_rate=[self.rate(e, f'sensors.{s}.rate') for s, e in sensors.items()],
            name=name, where=self.path)
        return plant if sample_time is None else with_registers(
            plant, {s: round(delay / sample_time) for s, delay in late.items() if delay},
            self.path)

    def measurement(self, sensor: str, entry: Mapping[str, Any],
                    groups: Sequence[Sequence[str]], ranges: np.ndarray,
                    point: np.ndarray) -> tuple[np.ndarray, Curve | None]:
        """Read what a sensor measures, see `measurement`."""
        place = f'sensors.{sensor}.measures'
        text = self.required(entry, 'measures', f'sensors.{sensor}',
                             'say which state it measures')
        node = self.tabled(self.expression(
            text, place, [name for names in groups for name in names]), entry, f'sensors.{sensor}')
        row, curve = measurement(node, text, groups, ranges, point, self.path, place)
        if curve is not None and curve.text and 'wrap' in entry:
            raise self.fail(place, 'is a curve, and wraps', 'leave out one of them')
        return row, curve

    def required(self, entry: Mapping[str, Any], what: str, key: str, mend: str) -> Any:
        if entry.get(what) is None:
            raise self.fail(f'{key}.{what}', 'is missing', mend)
        return entry[what]

    def deviation(self, entry: Mapping[str, Any], what: str, place: str) -> float:
        if what not in entry:
            return math.nan
        value = self.number(entry[what], f'{place}.{what}')
        if value < 0.0:
            raise self.fail(f'{place}.{what}', f'{value:g} is negative',
                            'give a standard deviation')
        return value

    def turn(self, entry: Mapping[str, Any], key: str) -> float:
        """Read what a turn is in the readings of a sensor, NaN if it does not wrap."""
        if 'wrap' not in entry:
            return math.nan
        value = self.number(entry['wrap'], key)
        if value <= 0.0:
            raise self.fail(key, f'{value:g} is not above 0',
                            'give what a turn is in its unit, such as 2*pi or 360')
        return value

    def time(self, entry: Mapping[str, Any], what: str, place: str,
             sample_time: float | None = None) -> float:
        """Read a dead time [s], of whole samples where there is a sample time; else 0."""
        value = self.number(entry.get(what, 0.0), f'{place}.{what}')
        if value < 0.0:
            raise self.fail(f'{place}.{what}', f'{value:g} is negative',
                            'give by how many seconds it is late')
        if sample_time and abs(value / sample_time - round(value / sample_time)) > 1e-6:
            raise self.fail(f'{place}.{what}', f'{value:g} s is no whole number of samples',
                            f'give a multiple of {sample_time:g}')
        return value

    def rate(self, entry: Mapping[str, Any], key: str) -> float:
        """Read how many readings come in a second, NaN if that is not said."""
        value = self.number(entry['rate'], key) if 'rate' in entry else math.nan
        if value <= 0.0:
            raise self.fail(key, f'{value:g} is not above 0', 'give readings a second')
        return value

    def truth(self, entry: Mapping[str, Any], what: str, place: str) -> bool:
        """Read true or false; false when it is left out."""
        text = str(entry.get(what, 'false'))
        if text.lower() not in yaml.SafeLoader.bool_values:
            raise self.fail(f'{place}.{what}', f'{shown(entry[what])} is neither true nor false',
                            'write one of them')
        return bool(yaml.SafeLoader.bool_values[text.lower()])

    def tolerance(self, value: Any, place: str) -> float:
        size = self.number(value, place)
        if size <= 0.0:
            raise self.fail(place, f'{size:g} is not positive',
                            'give how far off an estimate may be')
        return size

    def ranges(self, section: str, entries: Mapping[str, Mapping[str, Any]]) -> np.ndarray:
        """Read where each quantity of a section lives (.., 2)."""
        return np.array([self.range(entry, f'{section}.{name}.range')
                         for name, entry in entries.items()]).reshape(-1, 2)

    def range(self, entry: Mapping[str, Any], key: str) -> tuple[float, float]:
        """Read [low, high], where null leaves a side open."""
        sides = entry.get('range', [None, None])
        mend = 'write [low, high] with low < high; null leaves a side open'
        if not isinstance(sides, list) or len(sides) != 2:
            raise self.fail(key, f'{shown(sides)} is not two numbers', mend)
        low, high = (open_side if side is None else self.number(side, key)
                     for side, open_side in zip(sides, (-math.inf, math.inf)))
        if not low < high:
            raise self.fail(key, f'{low:g} is not below {high:g}', mend)
        return low, high

    def units(self, states: Mapping[str, Mapping[str, Any]],
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
                raise self.fail(f'sensors.{name}.unit', f'{shown(unit)} differs from that of '
                                f'the state {name}, {shown(units[name])}',
                                'give both the same, or rename the sensor')
            units[name] = unit
        return units

    def right_hand_side(self, states: tuple[str, ...], inputs: tuple[str, ...],
                        disturbances: tuple[str, ...], point: np.ndarray, u: np.ndarray,
                        slow: tuple[str, ...]) -> tuple[Split, np.ndarray | None]:
        by_equations = 'dynamics' in self.content
        if by_equations == ('matrices' in self.content):
            raise self.fail('dynamics', 'and matrices are both there' if by_equations
                            else 'is missing', 'give one equation a state under dynamics, '
                            'or matrices')
        if not by_equations:
            split, measured = self.matrices(states, inputs, disturbances)
            if 'operating_point' in self.content:
                split = with_addends(split, point, inputs, u)
            return split, measured
        if 'nonlinearities' in self.content:
            raise self.fail('nonlinearities', 'stands beside dynamics',
                            'write them in the equations')
        continuous = self.content['time'] == 'continuous'
        texts = {**{state: '0' if continuous else state for state in slow},
                 **self.mapping(self.content['dynamics'], 'dynamics', states, 'state')}
        for state in states:
            if texts.get(state) is None:
                raise self.fail(f'dynamics.{state}', 'is missing',
                                'write one equation a state')
        variables = (*states, *inputs, *disturbances)
        equations = [self.by_name(texts[s], f'dynamics.{s}', variables) for s in states]
        split = with_addends(split_equations(
            equations, states, inputs, disturbances, self.path, definitions=self.definitions),
            point, inputs, u)
        check_split(split, [fold(substitute(e, self.definitions)) for e in equations], states,
                    inputs, disturbances, point, self.path)
        return split, None

    def matrices(self, states: tuple[str, ...], inputs: tuple[str, ...],
                 disturbances: tuple[str, ...]) -> tuple[Split, np.ndarray | None]:
        given = self.mapping(self.content['matrices'], 'matrices',
                             ('A', 'B', 'C', 'Cu', 'Cd', 'D', 'P'))
        n = len(states)
        items = self.content.get('nonlinearities') or []
        if not isinstance(items, list):
            raise self.fail('nonlinearities', 'is not a list',
                            "write - {function: 'sqrt(w1)', of: [level1 - level2]}")
        terms, rows = [], []
        for i, item in enumerate(items):
            key = f'nonlinearities[{i}]'
            entry = self.mapping(item, key, ('function', 'of'))
            of = entry.get('of', [])
            of = of if isinstance(of, list) else [of]
            G = np.array([self.linear(text, f'{key}.of', states) for text in of]
                         ).reshape(len(of), n)
            node = self.expression(
                self.required(entry, 'function', key, 'write it over w1, w2, ...'),
                f'{key}.function', (*argument_names(len(G)), *inputs))
            term = make_term(to_text(node), len(G), inputs, self.path, f'{key}.function')
            terms.append(replace(term, name=plain_name(term.text, G, states)))
            rows.append(G)
        sizes = {'A': n, 'B': len(inputs), 'D': len(disturbances), 'P': len(terms)}
        arrays = {letter: self.matrix(given.get(letter), f'matrices.{letter}', n, width)
                  for letter, width in sizes.items()}
        measured = None
        if not given.keys().isdisjoint(('C', 'Cu', 'Cd')):
            sensors = len(self.content['sensors'])
            blocks = [self.matrix(given.get('C'), 'matrices.C', sensors, n)]
            for letter, width in (('Cu', len(inputs)), ('Cd', len(disturbances))):
                blocks.append(self.matrix(given[letter], f'matrices.{letter}', sensors, width)
                              if letter in given else np.zeros((sensors, width)))
            measured = np.hstack(blocks)
        return Split(arrays['A'], arrays['B'], arrays['D'], arrays['P'], tuple(rows),
                     tuple(terms)), measured

    def matrix(self, value: Any, key: str, height: int, width: int) -> np.ndarray:
        if value is None and width:
            raise self.fail(key, 'is missing', f'give {height} rows of {width} numbers')
        if isinstance(value, str):
            value = self.arrays.get(value, value)
        rows = [[] for _ in range(height)] if value is None else value
        if isinstance(rows, list) and not any(isinstance(row, list) for row in rows):
            rows = [[v] for v in rows] if width == 1 else [rows]    # one column or row, flat
        if not isinstance(rows, list) or len(rows) != height or not all(
                isinstance(row, list) and len(row) == width for row in rows):
            raise self.fail(key, f'is not {height} rows of {width} numbers',
                            'write it as [[.., ..], [.., ..]], one row a line')
        return np.array([[self.number(v, f'{key}[{i}][{j}]') for j, v in enumerate(row)]
                         for i, row in enumerate(rows)], dtype=float).reshape(height, width)
