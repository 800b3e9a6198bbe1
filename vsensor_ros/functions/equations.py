"""
Several expressions over the same names at once, with their exact partial derivatives.

What they have in common is worked out once: the equations of a mechanism share most of what is in
them, and most of what is in their derivatives. All is elementwise over N points.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from vsensor_ros.functions.expression import Node
from vsensor_ros.functions.tape import Program, Tape


class Equations:
    """
    E expressions over V names and definitions, of which a later one may use earlier ones.

    Numbers in them stay what they are.
    """

    def __init__(self, nodes: Sequence[Node], variables: Sequence[str],
                 definitions: Sequence[tuple[str, Node]] = ()) -> None:
        """Prepare; a name that is no variable raises KeyError."""
        self._tape, names = Tape(len(variables)), {name: i for i, name in enumerate(variables)}
        self._tape.define(definitions, names)
        self._ends = [self._tape.place(node, names) for node in nodes]
        self._values = Program(self._tape, self._ends)

    def values(self, at: np.ndarray) -> np.ndarray:
        """Return the values (E, N) at points (V, N)."""
        return self._values.run(at.T).T

    def slopes(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values (E, N) and derivatives (E, V, N), 0 where there is none, as at a kink."""
        slopes, program = self._slopes
        found = program.run(at.T)
        return found[:, :len(self._ends)].T, slopes.of(found).transpose(1, 2, 0)

    @cached_property
    def _slopes(self) -> tuple[Slopes, Program]:
        slopes = Slopes(self._tape, self._ends, range(self._tape.variables))
        return slopes, Program(self._tape, [*self._ends, *slopes.places])


class Slopes:
    """The derivatives of what stands at E ends of a tape, by what stands at V places of it."""

    def __init__(self, tape: Tape, ends: Sequence[int], by: Sequence[int]) -> None:
        """Find where they stand: `places`, those that change."""
        self._always, self.places, which = np.zeros((len(ends), len(by))), list[int](), []
        for e, of_end in enumerate(tape.derivatives(ends, by)):
            for v, place in of_end.items():
                if place in tape.numbers:
                    self._always[e, v] = tape.numbers[place]
                else:
                    which.append(e * len(by) + v)
                    self.places.append(place)
        self._which = np.array(which, dtype=int)

    def of(self, found: np.ndarray) -> np.ndarray:
        """Return them (N, E, V) of rows (N, ..) that end with what stands at `places`."""
        slopes = np.empty((len(found), *self._always.shape))
        slopes[:] = self._always
        by = found[:, found.shape[1] - len(self.places):]
        slopes.reshape(len(found), -1)[:, self._which] = np.where(np.isfinite(by), by, 0.0)
        return slopes
