"""
Read a plant file (YAML).

Keys: name, description, time (continuous, or {sample_time: seconds}), parameters, states (unit,
initial, process_noise, range, slow), inputs (unit, operating, range), disturbances (unit,
range), sensors (measures, unit, noise, tolerance, wrap), operating_point, and the right-hand
side: dynamics, one equation a state, or matrices A, B, C, Cu, Cd, D, P with nonlinearities
(function over w1.., of which combinations of states). Every number may be an expression of the
parameters. What is wrong gives one BadInput line that names the file, the place and the mend.
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
from vsensor_ros.functions.expression import (
    check_name,
    fold,
    Node,
    Number,
    parse,
    substitute,
    to_text,
)
from vsensor_ros.functions.nonlinearity import argument_names, make_term
from vsensor_ros.plant.plant import check_distinct, plain_name, Plant, suggestion
from vsensor_ros.plant.split import check_split, Split, split_equations, with_addends
from vsensor_ros.text_file import read_text

LARGEST_FILE = 2**20    # bytes
LARGEST_SECTION = 1000   # states, inputs, ...; keeps a forged file from eating the memory
_TOP = ('name', 'description', 'time', 'parameters', 'states', 'inputs', 'disturbances',
        'dynamics', 'matrices', 'nonlinearities', 'sensors', 'operating_point')


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
        node = parse(value, self.path, key, known=(*variables, *self.parameters))
        return fold(substitute(node, self.parameters), self.path, key)

    def linear(self, value: Any, key: str, variables: Sequence[str],
               kinds: tuple[str, ...] = ('state',)) -> np.ndarray:
        """Read a linear expression as one row over the variables, which are of these kinds."""
        form = affine(self.expression(value, key, variables))
        if form is None or not form or '' in form:
            every = ', '.join(f'{kind}s' for kind in kinds)
            raise self.fail(key, f'{shown(value)} is not linear in the {every}' if form is None
                            else f'{shown(value)} has an offset' if form
                            else f'{shown(value)} holds no {", ".join(kinds)}',
                            f'write a sum of {every} with factors, such as level1 - level2')
        return np.array([form.get(name, 0.0) for name in variables])

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

    def plant(self) -> Plant:
        name = self.content.get('name')
        if name is None:
            raise self.fail('name', 'is missing', 'write name: my_plant')
        if not isinstance(self.content.get('description', ''), str):
            raise self.fail('description', 'is not a text', 'put it in quotes')
        sample_time = self.sample_time()
        parameters = self.section('parameters', ('value', 'unit'), 'value')
        states = self.section('states', ('unit', 'initial', 'process_noise', 'range', 'slow'))
        inputs = self.section('inputs', ('unit', 'operating', 'range'))
        disturbances = self.section('disturbances', ('unit', 'range'))
        sensors = self.section('sensors', ('measures', 'unit', 'noise', 'tolerance', 'wrap'),
                               'measures')
        for key, entries in (('states', states), ('sensors', sensors)):
            if not entries:
                raise self.fail(key, 'is missing or empty', f'name the {key}')
        check_distinct(self.path, {'states': tuple(states), 'inputs': tuple(inputs),
                                   'disturbances': tuple(disturbances),
                                   'parameters': tuple(parameters)})
        for key, entry in parameters.items():
            place = f'parameters.{key}'
            self.parameters[key] = self.number(
                self.required(entry, 'value', place, 'give its value'), place)

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
        everything = (*states, *inputs, *disturbances)
        if measured is None:
            measured = np.array([self.linear(
                self.required(e, 'measures', f'sensors.{s}', 'say which state it measures'),
                f'sensors.{s}.measures', everything, ('state', 'input', 'disturbance'))
                for s, e in sensors.items()])
        else:
            for sensor, entry in sensors.items():
                if 'measures' in entry:
                    raise self.fail(f'sensors.{sensor}.measures', 'stands beside matrices.C',
                                    'give one of the two')
        C, Cu, Cd = np.split(measured, [len(states), len(states) + len(inputs)], axis=1)
        return Plant.from_matrices(
            split.A, split.B, C, split.D, sample_time, P=split.P, G=split.G,
            nonlinearities=split.terms, states=tuple(states), inputs=tuple(inputs),
            sensors=tuple(sensors), disturbances=tuple(disturbances),
            units=self.units(states, inputs, disturbances, sensors, measured), initial=initial,
            noise=[self.deviation(e, 'noise', f'sensors.{s}') for s, e in sensors.items()],
            parameters=self.parameters, operating_point=point, operating_input=u, Cu=Cu, Cd=Cd,
            process_noise=[self.deviation(e, 'process_noise', f'states.{s}')
                           for s, e in states.items()],
            ranges=self.ranges('states', states), input_range=self.ranges('inputs', inputs),
            disturbance_range=self.ranges('disturbances', disturbances), slow=slow,
            tolerances={s: self.tolerance(e['tolerance'], f'sensors.{s}.tolerance')
                        for s, e in sensors.items() if 'tolerance' in e},
            wrap=[self.turn(e, f'sensors.{s}.wrap') for s, e in sensors.items()],
            name=name, where=self.path)

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
        equations = [self.expression(texts[s], f'dynamics.{s}', variables) for s in states]
        split = with_addends(split_equations(equations, states, inputs, disturbances,
                                             self.path), point, inputs, u)
        check_split(split, equations, states, inputs, disturbances, point, self.path)
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
        rows = [[] for _ in range(height)] if value is None else value
        if isinstance(rows, list) and not any(isinstance(row, list) for row in rows):
            rows = [[v] for v in rows] if width == 1 else [rows]    # one column or row, flat
        if not isinstance(rows, list) or len(rows) != height or not all(
                isinstance(row, list) and len(row) == width for row in rows):
            raise self.fail(key, f'is not {height} rows of {width} numbers',
                            'write it as [[.., ..], [.., ..]], one row a line')
        return np.array([[self.number(v, f'{key}[{i}][{j}]') for j, v in enumerate(row)]
                         for i, row in enumerate(rows)], dtype=float).reshape(height, width)
