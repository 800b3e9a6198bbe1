"""
Units of equations and sensors, checked with pint where it is installed.

A number, and a parameter without a unit, may stand for a quantity of any unit: what they are
multiplied by is not judged. What is no unit (`counts`) is not, either. Temperatures count as
differences, but where a sensor shows one in another scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
import re
from typing import Any

from vsensor_ros.functions.expression import Apply, Name, Node, Number, to_text

NOT_INSTALLED = 'units are not checked: pint is not installed (pip install pint)'
_WRITTEN = re.compile(r'[A-Za-z%0-9 ./*^()-]{1,60}')
_LARGE_POWER = re.compile(r'(\^|\*\*)\s*\(?-?\s*(\d{2,}|\d\s*\)?\s*(\^|\*\*))')
_SPELLINGS = {'²': '^2', '³': '^3', '·': '*', '°C': 'degC', '°F': 'degF', '°': 'deg', 'µ': 'u',
              'Ω': 'ohm', 'Nm': 'N*m'}
_DIFFERENCES = {'degree_Celsius': 'kelvin', 'degree_Fahrenheit': 'delta_degree_Fahrenheit'}
_PURE = ('sin', 'cos', 'tan', 'tanh', 'exp', 'log', 'asin', 'atan')  # of what has no dimension
_ALIKE = ('+', '-', 'min', 'max', 'sat', 'deadzone', 'atan2')  # their arguments are added
_HOURLY = {'minute': 'min', 'hour': 'h', 'day': 'd'}


@lru_cache(maxsize=1)
def registry() -> Any:
    """Return pint's units; None where it is not installed."""
    try:
        import pint
    except ImportError:
        return None
    return pint.UnitRegistry()


@lru_cache(maxsize=1024)
def unit_of(text: str) -> Any:
    """Return a unit; None for what is none, or unknown."""
    units = registry()
    for written, plain in _SPELLINGS.items():
        text = text.replace(written, plain)
    if units is None or not _WRITTEN.fullmatch(text) or _LARGE_POWER.search(text):
        return None
    try:
        found = units.Quantity(units.parse_expression(text.replace('-', '') if text.strip() in (
            '', '-') else text))
    except Exception:  # pint raises what its tokenizer and its arithmetic raise
        return None
    if found.magnitude != 1 or 'count' in str(found.units):
        return None
    return found.units


def difference(unit: Any) -> Any:
    """Return the unit of differences: kelvin of degC."""
    units = registry()
    for name, other in _DIFFERENCES.items():
        if name in str(unit) and f'delta_{name}' not in str(unit):
            return units.parse_units(re.sub(rf'\b{name}\b', other, str(unit)))
    return unit


def conversion(given: Any, wanted: Any) -> tuple[float, float]:
    """Return (factor, offset) with wanted = factor given + offset; both of one dimension."""
    units = registry()
    zero = float(units.Quantity(0.0, given).to(wanted).magnitude)
    return ratio(given, wanted) or 1.0, zero


def ratio(given: Any, wanted: Any) -> float | None:
    """Return how many of the wanted a given unit is, both of differences; None: not alike."""
    given, wanted = difference(given), difference(wanted)
    if given.dimensionality != wanted.dimensionality:
        return None
    return float(registry().Quantity(1.0, given).to(wanted).magnitude)


@dataclass
class Units:
    """Units of the names of a plant, and what was found amiss so far."""

    of: dict[str, str]  # by name, as written
    inferred: dict[str, Any] = field(default_factory=dict)  # of definitions that give none
    said: list[str] = field(default_factory=list)

    def infer(self, node: Node, place: str) -> Any:
        """Return the unit of an expression, None when unknown; note what does not go together."""
        if isinstance(node, Number):
            return None
        if isinstance(node, Name):
            unit = unit_of(self.of.get(node.id, ''))
            return self.inferred.get(node.id) if unit is None else difference(unit)
        parts = [self.infer(argument, place) for argument in node.arguments]
        if node.function == 'neg' or node.function == 'abs':
            return parts[0]
        if node.function in _ALIKE:
            known = [(p, a) for p, a in zip(parts, node.arguments) if p is not None]
            for unit, argument in known[1:]:
                self.same(unit, argument, known[0], place)
            if node.function == 'atan2':
                return registry().dimensionless
            return known[0][0] if known else None
        if node.function in ('*', '/'):
            if None in parts:
                return None
            return parts[0] * parts[1] if node.function == '*' else parts[0] / parts[1]
        if node.function in ('**', 'sqrt'):
            power = node.arguments[1] if node.function == '**' else Number(0.5)
            return parts[0] ** power.value if isinstance(power, Number) and parts[0] is not None \
                else None
        if node.function in _PURE:
            if parts[0] is not None and ratio(parts[0], registry().dimensionless) != 1.0:
                self.note(place, f'{node.function} of {to_text(node.arguments[0])}, which is in '
                          f'{shown(parts[0])}')
            return registry().dimensionless
        return registry().dimensionless if node.function == 'sign' else None

    def same(self, unit: Any, argument: Node, other: tuple[Any, Node], place: str) -> None:
        """Note it when two addends are not of one unit."""
        if ratio(unit, other[0]) != 1.0:
            self.note(place, f'{to_text(argument)} is in {shown(unit)}, '
                      f'{to_text(other[1])} in {shown(other[0])}: they cannot be added')

    def note(self, place: str, text: str) -> None:
        """Note what is amiss, each once."""
        line = f'{place}: {text}'
        if line not in self.said:
            self.said.append(line)

    def rates(self, state: str, node: Node, time_unit: str | None, slower: list[str]) -> None:
        """Check an equation: its addends are in the state's unit, per unit of time if it flows."""
        place, unit = f'dynamics.{state}', unit_of(self.of.get(state, ''))
        wanted = None if unit is None else difference(unit)
        if wanted is not None and time_unit is not None:
            wanted = wanted / unit_of(time_unit)
        for addend in _addends(node):
            found = self.infer(addend, place)
            if found is None or wanted is None:
                continue
            times = ratio(found, wanted)
            if times is None:
                self.note(place, f'{to_text(addend)} is in {shown(found)}, but '
                          f'{state} in {self.of[state]}' + (
                              '' if time_unit is None else f', which changes in {shown(wanted)}'))
            elif abs(times - 1.0) > 1e-9:
                hours = [unit for unit, plain in _HOURLY.items() if abs(times * _seconds(
                    plain) - 1.0) < 1e-9]
                if time_unit == 's' and hours:
                    slower.append(state)
                else:
                    self.note(place, f'{to_text(addend)} is in {shown(found)}, {times:.6g} times '
                              f'{shown(wanted)}')


def converted(units: Units, node: Node, unit: str, sensor: str) -> tuple[float, float]:
    """Return (factor, offset) from what a sensor measures to the unit that it shows; said so."""
    place = f'sensors.{sensor}'
    found, wanted = units.infer(node, place), unit_of(unit)
    if found is None or wanted is None:
        return 1.0, 0.0
    if isinstance(node, Name):
        found = unit_of(units.of.get(node.id, '')) or found
    if ratio(found, wanted) is None:
        units.note(place, f'{to_text(node)} is in {shown(found)}, which cannot be shown in {unit}')
        return 1.0, 0.0
    factor, offset = conversion(found, wanted)
    if abs(factor - 1.0) < 1e-9 and abs(offset) < 1e-9:
        return 1.0, 0.0
    more = '' if abs(offset) < 1e-9 else f' {"+" if offset > 0.0 else "-"} {abs(offset):.6g}'
    text = to_text(node if abs(factor - 1.0) < 1e-9 else
                   Apply('*', (Number(float(f'{factor:.6g}')), node)))
    units.note(place, f'is in {unit}, and {to_text(node)} in {shown(found)}: it is taken to show '
               f'{text}{more}')
    return factor, offset if abs(offset) > 1e-9 else 0.0


def check_rates(units: Units, equations: Mapping[str, Node], time_unit: str | None,
                asked: bool) -> None:
    """
    Check all equations, by state; time_unit: of continuous ones.

    asked: the file says which it is. Hours in a model that runs in seconds are one line.
    """
    slower: list[str] = []
    for state, node in equations.items():
        units.rates(state, node, time_unit, slower)
    if time_unit is None or asked:
        return
    hourly = [f'{name} in {units.of[name]}' for name in units.of if _per_hour(units.of[name])]
    if slower or hourly:
        unit = next((plain for name, plain in _HOURLY.items() for text in units.of.values()
                     if name in str(unit_of(text))), 'h')
        what = ', '.join([*hourly, *(f'the rate of {state}' for state in slower)])
        units.said.append(f'{what}: but the equations run in seconds; if their rates are per '
                          f'{unit}, write time_unit: {unit}')


def per_second(text: str) -> str:
    """Return the unit, as written, of what changes by a unit in a second."""
    return f'{text}^2' if text.endswith('/s') else f'{text}/s' if text else 'per s'


def _per_hour(text: str) -> bool:
    unit = unit_of(text)
    return unit is not None and any(
        name in _HOURLY and power < 0 for name, power in unit._units.items())


def _seconds(unit: str) -> float:
    return float(registry().Quantity(1.0, unit).to('s').magnitude)


def _addends(node: Node) -> list[Node]:
    if isinstance(node, Apply) and node.function in ('+', '-'):
        return [part for argument in node.arguments for part in _addends(argument)]
    return [node]


def shown(unit: Any) -> str:
    """Return a unit as people write it."""
    return f'{unit:~C}'.replace('**', '^').replace('Δ', '').replace('°', 'deg') or '1'
