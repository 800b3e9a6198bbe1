"""Entries of a plant file: sections, numbers, expressions, and what definitions make of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml

from vsensor_ros.bad_input import BadInput, check_text, shown
from vsensor_ros.functions.affine import affine
from vsensor_ros.functions.expression import (
    Apply,
    check_name,
    fold,
    function_of,
    Name,
    names,
    Node,
    Number,
    parse,
    substitute,
    table_node,
    to_text,
)
from vsensor_ros.plant.checked import suggestion
from vsensor_ros.plant.plant_yaml import read_yaml
from vsensor_ros.plant.split import addends
from vsensor_ros.plant.units import NOT_INSTALLED, registry, Units

LARGEST_SECTION = 1000   # states, inputs, ...; keeps a forged file from eating the memory
_SECONDS = {'us': 1e-6, 'ms': 1e-3, 's': 1.0, 'min': 60.0, 'h': 3600.0, 'd': 86400.0}
TABLE = ('table', 'interpolation')
DEFINITION = ('value', 'unit', 'friction', *TABLE)
_MOST_PARTS, _DEEPEST = 2000, 60  # of an expression with its definitions written out
_MOST_IN_ALL = 20_000  # parts of all definitions
_SHAPES = {'linear': 'table', 'cubic': 'smooth_table'}


class Entries:
    """One plant file being read: where errors are, and what is known of it so far."""

    what = 'plant file'

    def __init__(self, path: str | Path, keys: Iterable[str],
                 content: dict[str, Any] | None = None,
                 factors: Mapping[str, float] = MappingProxyType({})) -> None:
        """Read a file, or take its content; parameters are multiplied by factors, by name."""
        self.path, self.factors = path, factors
        content = read_yaml(path, self.what) if content is None else content
        if content is None:
            raise BadInput(path, '', 'is empty', f'write a {self.what}')
        self.content = self.mapping(content, '', keys)
        self.parameters: dict[str, float] = {}
        self.arrays: dict[str, list[Any]] = {}
        self.tables: dict[str, tuple[str, tuple[Node, ...]]] = {}  # by name: kind, points
        self.definitions: dict[str, Node] = {}  # without names of others
        self.written: dict[str, Node] = {}  # those whose names give way to what they are
        self.loose: dict[str, Node] = {}  # all, with names for parameters
        self.kept: dict[str, Node] = {}  # all, as they were read
        self.large: set[str] = set()  # those that are too large to be written out
        self.extents: dict[str, tuple[int, int]] = {}  # of definitions: parts, and how deep
        self.units_of: Units | None = None  # None: not checked

    def fail(self, key: str, problem: str, mend: str) -> BadInput:
        """Return what is to be raised because of a key."""
        return BadInput(self.path, key, problem, mend)

    def mapping(self, value: Any, key: str, allowed: Iterable[str] | None = None,
                what: str = 'key') -> dict[Any, Any]:
        """Return a mapping, empty for nothing; only these keys are allowed in it."""
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
        """Read an expression of numbers and parameters."""
        node = fold(self.expression(value, key, ()), self.path, key)
        assert isinstance(node, Number)
        return node.value

    def expression(self, value: Any, key: str, variables: Iterable[str]) -> Node:
        """Read an expression of variables, with numbers for parameters."""
        return fold(substitute(self.by_name(value, key, variables), self.definitions), self.path,
                    key)

    def by_name(self, value: Any, key: str, variables: Iterable[str]) -> Node:
        """Read an expression in which definitions that are nonlinear addends keep their names."""
        node = parse(value, self.path, key, (*variables, *self.parameters, *self.kept),
                     self.tables)
        self.extent(node, key)
        return fold(substitute(substitute(node, self.parameters), self.written), self.path, key)

    def extent(self, node: Node, key: str) -> tuple[int, int]:
        """Return parts and depth of a node with its definitions written out, if not too many."""
        if isinstance(node, Name) and node.id in self.large:
            raise self.fail(key, f'{node.id} is too large with its definitions written out',
                            'only dynamics may use it, and not with matrices')
        if isinstance(node, Name):
            return self.extents.get(node.id, (1, 1))
        parts = [self.extent(part, key) for part in node.arguments] \
            if isinstance(node, Apply) else []
        size = 1 + sum(size for size, _ in parts)
        depth = 1 + max((depth for _, depth in parts), default=0)
        if size > _MOST_PARTS or depth > _DEEPEST:
            raise self.fail(key, 'is too large with its definitions written out',
                            'write it with fewer of them')
        return size, depth

    def is_large(self, value: Any, key: str, variables: Iterable[str]) -> bool:
        """Tell whether an expression over these is too large with its definitions written out."""
        node = parse(value, self.path, key, (*variables, *self.parameters, *self.kept),
                     self.tables)
        if not self.large.isdisjoint(names(node)):
            return True
        try:
            self.extent(node, key)
        except BadInput:
            return True
        return False

    def needed(self, used: Iterable[str]) -> list[str]:
        """Return the definitions that these names need, in order."""
        wanted, found = set(used), []
        for name, node in reversed(self.kept.items()):
            if name in wanted:
                wanted.update(names(node))
                found.append(name)
        return found[::-1]

    def kept_texts(self, used: Iterable[str], named: Iterable[str]) -> list[tuple[str, str]]:
        """Return the definitions that these names need, as texts with these parameters by name."""
        numbers = {name: v for name, v in self.parameters.items() if name not in set(named)}
        return [(name, to_text(fold(substitute(self.kept[name], numbers), self.path,
                                    f'definitions.{name}'))) for name in self.needed(used)]

    def raw(self, value: Any) -> Node:
        """Return an expression that was read already with all its names."""
        return parse(value, self.path, tables=self.tables)

    def with_names(self, value: Any, key: str, parameters: Iterable[str],
                   written_out: bool) -> Node:
        """Return an expression that was read before; some parameters, or all names, are kept."""
        numbers = {name: v for name, v in self.parameters.items() if name not in parameters}
        node = substitute(self.raw(value), self.loose if written_out else {})
        return fold(substitute(node, numbers), self.path, key)

    def spreads(self, parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
        """Read the standard deviations of parameters that are not known exactly."""
        found = {}
        for name, entry in parameters.items():
            if 'spread' not in entry:
                continue
            key = f'parameters.{name}.spread'
            if name in self.arrays:
                raise self.fail(key, 'stands beside an array',
                                'give its numbers names of their own')
            found[name] = self.number(entry['spread'], key)
            if not found[name] > 0.0:
                raise self.fail(key, f'{found[name]:g} is not positive',
                                'give a standard deviation, or leave it out')
        return found

    def fits(self, parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, tuple[float, float]]:
        """Read between what a parameter is looked for by the command fit: (low, high)."""
        found = {}
        for name, entry in parameters.items():
            if 'fit' not in entry:
                continue
            key, ends = f'parameters.{name}.fit', entry['fit']
            if name in self.arrays:
                raise self.fail(key, 'stands beside an array',
                                'give its numbers names of their own')
            if not isinstance(ends, list) or len(ends) != 2:
                raise self.fail(key, f'{shown(ends)} is not two numbers', 'write [low, high]')
            low, high = (self.number(end, key) for end in ends)
            value = self.parameters[name]
            if not low < high:
                raise self.fail(key, f'{low:g} is not below {high:g}', 'write [low, high]')
            if not self.factors and not low <= value <= high:
                raise self.fail(key, f'the value {value:g} is not between {low:g} and {high:g}',
                                'widen it, or begin with another value')
            found[name] = low, high
        return found

    def read_units(self, *sections: Mapping[str, Mapping[str, Any]]) -> list[str]:
        """Begin to check units; return where it is said what is amiss, or why nothing is."""
        of = {name: entry['unit'] for section in sections for name, entry in section.items()
              if entry.get('unit')}
        if not of or registry() is None:
            return [NOT_INSTALLED] if of else []
        of.update({element: of[name] for element in self.parameters
                   if (name := element.split('[')[0]) in of})
        self.units_of = Units(of)
        return self.units_of.said

    def read_parameters(self, parameters: Mapping[str, Mapping[str, Any]]) -> None:
        """Read the parameters; a later one may use earlier ones."""
        for key, entry in parameters.items():
            place = f'parameters.{key}'
            value = self.required(entry, 'value', place, 'give its value')
            if isinstance(value, list):
                self.arrays[key] = value
                self.array(value, key)
            else:
                self.parameters[key] = self.scaled(key, value)

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
                self.parameters[element] = self.scaled(element, value)

    def scaled(self, name: str, value: Any) -> float:
        """Read the value of a parameter, times its factor."""
        return self.number(value, f'parameters.{name}') * self.factors.get(name, 1.0)

    def read_definitions(self, variables: Sequence[str]) -> None:
        """Read intermediate expressions; a later one may use earlier ones."""
        section = self.section('definitions', DEFINITION, 'value')
        for name, entry in section.items():
            place = f'definitions.{name}'
            text = self.required(entry, 'value', place, 'write what it is')
            for used in names(parse(text, self.path, place, tables=self.tables)):
                if used in section and used not in self.kept:
                    raise self.fail(place, f'{used} is not known yet', 'a definition may use '
                                    'earlier ones only: bring them into order, without a circle')
            self.kept[name] = self.tabled(self.raw(text), entry, place)
            if self.is_large(text, place, variables) or \
                    sum(size for size, _ in self.extents.values()) > _MOST_IN_ALL:
                self.large.add(name)
                continue
            node = self.tabled(self.by_name(text, place, variables), entry, place)
            self.loose[name] = self.tabled(substitute(self.raw(text), self.loose), entry, place)
            whole = fold(substitute(node, self.definitions), self.path, place)
            if self.units_of is not None and 'table' not in entry:
                self.units_of.inferred[name] = self.units_of.infer(self.raw(text), place)
            linear, cores = addends(whole, self.path, place)
            friction = [core for _, core in cores
                        if isinstance(core, Apply) and function_of(core).set_valued]
            if linear or len(cores) != 1 or friction:
                self.written[name] = node
            self.definitions[name] = whole
            self.extents[name] = self.extent(whole, place)

    def friction(self, given: Any, key: str,
                 ranges: Mapping[str, float]) -> tuple[str, float, float]:
        """Read what a friction opposes, how large it gets, and how fast that (by default) gets."""
        said = self.mapping(given, key, ('speed', 'most', 'fastest'))
        speed, mend = str(said.get('speed')), 'write {speed: NAME, most: SIZE, fastest: SPEED}'
        if speed not in ranges:
            raise self.fail(f'{key}.speed', f'{shown(speed)} is no state', mend)
        sizes = {what: self.number(said[what], f'{key}.{what}')
                 for what in ('most', 'fastest') if what in said}
        most, fastest = sizes.get('most', 0.0), sizes.get('fastest', ranges[speed])
        if not most > 0.0 or not 0.0 < fastest < math.inf:
            raise self.fail(key, 'does not say how large it gets, and how fast it turns', mend)
        return speed, most, fastest

    def tabled(self, node: Node, entry: Mapping[str, Any], place: str) -> Node:
        """Return the lookup table of a node, where there is one; else itself."""
        if 'table' not in entry:
            if 'interpolation' in entry:
                raise self.fail(f'{place}.interpolation', 'stands there without a table',
                                'give table: [[x, y], ..]')
            return node
        kind, points = self.points(entry, place, 'table')
        return table_node(kind, node, *points, where=self.path, key=f'{place}.table')

    def read_tables(self) -> None:
        """Read the tables that expressions may call by name."""
        for name, entry in self.section('tables', ('points', 'interpolation'), 'points').items():
            place = f'tables.{name}'
            self.required(entry, 'points', place, 'write [[x, y], [x, y]]')
            kind, points = self.points(entry, place, 'points')
            table_node(kind, Name('x'), *points, where=self.path, key=place)
            self.tables[name] = kind, tuple(points)

    def points(self, entry: Mapping[str, Any], place: str, of: str) -> tuple[str, list[Number]]:
        """Read the kind of a lookup table, and x1, y1, x2, y2, ..: a list, or an array's name."""
        rows, key = entry[of], f'{place}.{of}'
        rows = self.arrays.get(rows, rows) if isinstance(rows, str) else rows
        if not isinstance(rows, list) or not all(isinstance(r, list) and len(r) == 2
                                                 for r in rows):
            raise self.fail(key, f'{shown(rows)} is no list of points', 'write [[x, y], [x, y]]')
        shape = entry.get('interpolation', 'linear')
        if not isinstance(shape, str) or shape not in _SHAPES:
            raise self.fail(f'{place}.interpolation', f'{shown(shape)} is not known',
                            f'write {" or ".join(_SHAPES)}')
        return _SHAPES[shape], [Number(self.number(v, f'{key}[{i}]'))
                                for i, row in enumerate(rows) for v in row]

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
        """Read the sample time [s], None in continuous time."""
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
        if not isinstance(unit, str) or unit not in _SECONDS:
            raise self.fail('time_unit', f'{shown(unit)} is not known',
                            f'write one of {", ".join(_SECONDS)}')
        if 'time_unit' in self.content and sample_time is not None:
            raise self.fail('time_unit', 'stands beside a sample time',
                            'leave it out: the equations give the next values, not rates')
        return _SECONDS[unit]

    def required(self, entry: Mapping[str, Any], what: str, key: str, mend: str) -> Any:
        """Return what must be there."""
        if entry.get(what) is None:
            raise self.fail(f'{key}.{what}', 'is missing', mend)
        return entry[what]

    def deviation(self, entry: Mapping[str, Any], what: str, place: str) -> float:
        """Read a standard deviation, NaN where it is left out."""
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
        """Read how far off an estimate may be."""
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

    def matrix(self, value: Any, key: str, height: int, width: int) -> np.ndarray:
        """Read rows of numbers, or the name of an array of them; one column or row may be flat."""
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
