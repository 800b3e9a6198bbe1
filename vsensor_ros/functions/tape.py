"""
Expressions as steps, each one function of what was found before, and their derivatives.

What is found stands at places: first the variables, then numbers and what the steps find.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
import operator
from typing import Any, NamedTuple

import numpy as np

from vsensor_ros.functions.expression import Apply, function_of, Name, Node
from vsensor_ros.functions.function import Function
from vsensor_ros.functions.operators import OPERATORS

FEW = 6  # points at most that are taken one by one, in Python's own numbers: that is quicker then
_OF_NUMBERS: dict[object, Callable[..., float]] = {
    np.add: operator.add, np.subtract: operator.sub, np.multiply: operator.mul,
    np.negative: operator.neg, np.abs: abs, np.sin: math.sin, np.cos: math.cos, np.tan: math.tan,
    np.tanh: math.tanh, np.arctan: math.atan, np.arctan2: math.atan2}


class Step(NamedTuple):
    """One function of what stands at earlier places."""

    place: int
    of_arrays: Callable[..., Any]  # elementwise
    of_numbers: Callable[..., float]
    arguments: tuple[int, ...]


# place, function, its first argument, its second, and all of them if they are more
_Known = tuple[int, Callable[..., Any], int, 'int | None', Sequence[int]]


class Tape:
    """Steps over so many variables; equal ones are taken once."""

    def __init__(self, variables: int) -> None:
        """Prepare; the variables stand at 0, 1, .."""
        self.numbers: dict[int, float] = {}  # by place
        self.steps: list[Step] = []
        self.variables = self.size = variables
        self._places: dict[object, int] = {}
        self._made: dict[int, tuple[Function, tuple[int, ...]]] = {}

    def place(self, node: Node, names: Mapping[str, int]) -> int:
        """Return where the value of a node stands; a name that stands nowhere raises KeyError."""
        if isinstance(node, Name):
            return names[node.id]
        if not isinstance(node, Apply):
            return self.number(node.value)
        function = function_of(node)
        arguments = tuple(self.place(a, names) for a in node.arguments)
        place = self._apply((node.function, arguments), function.value, arguments)
        if place not in self.numbers:
            self._made[place] = function, arguments
        return place

    def define(self, definitions: Sequence[tuple[str, Node]], names: dict[str, int]) -> None:
        """Add to names where definitions stand; a later one may use earlier ones."""
        for name, node in definitions:
            names[name] = self.place(node, names)

    def derivatives(self, ends: Sequence[int], by: Sequence[int]) -> list[dict[int, int]]:
        """Return for each end where its derivatives stand, by the index of `by`; 0: the others."""
        moved = {place: {i: self.number(1.0)} for i, place in enumerate(by)}
        for place, (function, arguments) in list(self._made.items()):
            if place in moved:
                continue
            total: dict[int, int] = {}
            for i in range(len(function.slopes)):
                if not (inner := moved.get(arguments[i])):
                    continue
                slope = self._slope(function, i, arguments, place)
                for variable, change in inner.items():
                    more = self.operator('*', slope, change)
                    total[variable] = self.operator('+', total[variable], more) \
                        if variable in total else more
            if total:
                moved[place] = total
        return [moved.get(end, {}) for end in ends]

    def _slope(self, function: Function, i: int, arguments: tuple[int, ...], value: int) -> int:
        """Return where the derivative of a function by its argument i stands."""
        if function.name in ('+', '-', 'neg'):
            return self.number(function.slopes[i](*[0.0] * len(arguments)))
        if function.name == '*':
            return arguments[1 - i]
        if function.name == '/':
            over = self.operator('/', value if i else self.number(1.0), arguments[1])
            return self.operator('neg', over) if i else over
        if function.name == '**' and (p := self.numbers.get(arguments[1])) is not None:
            x = arguments[0]
            if p == 2.0:
                return self.operator('*', arguments[1], x)
            if not p.is_integer():  # it is odd
                x = self._apply(('abs', (x,)), np.abs, (x,))
            return self.operator('*', arguments[1], self.operator('**', x, self.number(p - 1.0)))
        return self._apply((function.name, i, arguments), function.slopes[i], arguments,
                           _elementwise(function.slopes[i], len(arguments)))

    def operator(self, name: str, *arguments: int) -> int:
        """Return where an operator of what stands at places stands."""
        if name in ('+', '*'):
            neutral = float(name == '*')
            for one, other in (arguments, arguments[::-1]):
                if self.numbers.get(one) == neutral:
                    return other
                if name == '*' and self.numbers.get(one) == 0.0:
                    return one
        return self._apply((name, arguments), OPERATORS[name].value, arguments)

    def number(self, value: float) -> int:
        """Return where a number stands."""
        if value not in self._places:
            self.numbers[self._new(value)] = value
        return self._places[value]

    def _apply(self, key: object, function: Callable[..., Any], arguments: tuple[int, ...],
               of_arrays: Callable[..., Any] | None = None) -> int:
        """Return where it stands what a function finds; key: what is equal has the same."""
        if key in self._places:
            return self._places[key]
        if all(a in self.numbers for a in arguments):
            with np.errstate(all='ignore'):
                return self.number(float(function(*[self.numbers[a] for a in arguments])))
        of_numbers = _OF_NUMBERS.get(function) or (lambda *values: float(function(*values)))
        self.steps.append(Step(self._new(key), of_arrays or function, of_numbers, arguments))
        return self._places[key]

    def _new(self, key: object) -> int:
        self._places[key] = self.size
        self.size += 1
        return self._places[key]


def _known(step: Step, function: Callable[..., Any]) -> _Known:
    first, *rest = step.arguments
    return step.place, function, first, rest[0] if rest else None, rest[1:] and step.arguments


class Program:
    """The steps of a tape that lead to what is wanted."""

    def __init__(self, tape: Tape, wanted: Sequence[int]) -> None:
        """Prepare for what stands at these places."""
        needed, steps = set(wanted), []
        for step in reversed(tape.steps):
            if step.place in needed:
                needed.update(step.arguments)
                steps.append(step)
        self._wanted = list(wanted)
        self._blank: list[Any] = [tape.numbers.get(place)
                                  for place in range(tape.variables, tape.size)]
        self._of_arrays = [_known(step, step.of_arrays) for step in reversed(steps)]
        self._of_numbers = [_known(step, step.of_numbers) for step in reversed(steps)]

    def run(self, points: np.ndarray, others: Sequence[float] = ()) -> np.ndarray:
        """Return what is wanted (N, ..) at N points of the first variables; others: of all."""
        if 0 < len(points) <= FEW:
            try:
                return np.array([self._run(self._of_numbers, [*point, *others, *self._blank])
                                 for point in points.tolist()])
            except (ArithmeticError, ValueError):  # numpy knows what is beyond Python's numbers
                pass
        found = np.empty((len(self._wanted), len(points)))
        known = [*np.ascontiguousarray(points.T), *map(np.array, others), *self._blank]
        for row, one in zip(found, self._run(self._of_arrays, known)):
            row[:] = one
        return found.T

    def _run(self, steps: list[_Known], known: list[Any]) -> list[Any]:
        for place, function, first, second, more in steps:
            if second is None:
                known[place] = function(known[first])
            elif more:
                known[place] = function(*[known[i] for i in more])
            else:
                known[place] = function(known[first], known[second])
        return [known[i] for i in self._wanted]


def _elementwise(slope: Callable[..., Any], count: int) -> Callable[..., Any]:
    """Return a slope of so many arguments that takes arrays; some are written for numbers."""
    try:
        slope(*[np.array([0.25, 0.5])] * count)
        return slope
    except (TypeError, ValueError):  # what asks whether an array is true
        pass

    def alone(*values: float) -> float:
        try:
            return float(slope(*values))
        except ArithmeticError:  # beyond Python's own numbers
            return math.nan
    each = np.frompyfunc(alone, count, 1)
    return lambda *values: np.asarray(each(*values), dtype=float)
