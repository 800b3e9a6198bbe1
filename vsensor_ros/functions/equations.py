"""
Several expressions over the same names at once, with their exact partial derivatives.

What they have in common is worked out once: the equations of a mechanism share most of what is in
them. All is elementwise over N points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from vsensor_ros.functions.expression import Apply, function_of, Name, Node, Number


class _Part(NamedTuple):
    """One function applied to earlier values, by their places."""

    value: Callable[..., Any]
    arguments: tuple[int, ...]
    slopes: tuple[tuple[int, Callable[..., Any]], ...]  # by argument that is not constant


class Equations:
    """E expressions over V names; numbers in them stay what they are."""

    def __init__(self, nodes: Sequence[Node], variables: Sequence[str]) -> None:
        """Prepare; a name that is no variable raises KeyError."""
        self._count = len(variables)
        self._places: dict[object, int] = {name: i for i, name in enumerate(variables)}
        # by place: whether it changes with a variable
        self._moves = [True] * self._count
        self._numbers: dict[int, float] = {}
        self._order: list[tuple[int, _Part]] = []
        self._ends = [self._place(node) for node in nodes]

    def _place(self, node: Node) -> int:
        """Return where the value of a node stands; equal ones share a place."""
        if isinstance(node, Name):
            return self._places[node.id]
        key: object = node
        arguments: tuple[int, ...] = ()
        if isinstance(node, Apply):
            arguments = tuple(self._place(a) for a in node.arguments)
            key = node.function, arguments
        if key in self._places:
            return self._places[key]
        place = self._places[key] = len(self._moves)
        self._moves.append(any(self._moves[a] for a in arguments))
        if isinstance(node, Number):
            self._numbers[place] = node.value
        else:
            assert isinstance(node, Apply)
            function = function_of(node)
            self._order.append((place, _Part(function.value, arguments, tuple(
                (i, _elementwise(slope, len(arguments))) for i, slope in enumerate(function.slopes)
                if self._moves[arguments[i]]))))
        return place

    def values(self, at: np.ndarray) -> np.ndarray:
        """Return the values (E, N) at points (V, N)."""
        return self._found(at, self._run(at))

    def slopes(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values (E, N) and derivatives (E, V, N), 0 where there is none, as at a kink."""
        known = self._run(at)
        unit = np.zeros((self._count, self._count, 1))
        unit[np.arange(self._count), np.arange(self._count)] = 1.0
        moved: list[np.ndarray | None] = [*unit, *[None] * (len(known) - self._count)]
        for place, part in self._order:
            total = None
            for i, slope in part.slopes:
                inner = moved[part.arguments[i]]
                if inner is not None:
                    more = slope(*[known[a] for a in part.arguments]) * inner
                    total = more if total is None else total + more
            moved[place] = total
        found = np.zeros((len(self._ends), *at.shape))
        for row, end in zip(found, self._ends):
            if (slopes := moved[end]) is not None:
                row[:] = slopes
        return self._found(at, known), np.where(np.isfinite(found), found, 0.0)

    def _run(self, at: np.ndarray) -> list[Any]:
        known: list[Any] = [*at, *[None] * (len(self._moves) - self._count)]
        for place, number in self._numbers.items():
            known[place] = number
        for place, part in self._order:
            known[place] = part.value(*[known[a] for a in part.arguments])
        return known

    def _found(self, at: np.ndarray, known: list[Any]) -> np.ndarray:
        found = np.empty((len(self._ends), *at.shape[1:]))
        for row, end in zip(found, self._ends):
            row[...] = known[end]
        return found


def _elementwise(slope: Callable[..., Any], count: int) -> Callable[..., Any]:
    """Return a slope of so many arguments that takes arrays; some are written for numbers."""
    try:
        slope(*[np.array([0.25, 0.5])] * count)
    except (TypeError, ValueError):  # what asks whether an array is true
        one = np.frompyfunc(slope, count, 1)
        return lambda *values: np.asarray(one(*values), dtype=float)
    return slope
