"""A system read: its expressions as trees, and points at which identities are tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.algebra.answer import Range, System
from vsensor_ros.designer.algebra.derivative import SMOOTH
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Apply, check_name, Name, names, Node, parse, walk

WHERE = 'functions'
# what is continued outside of a domain by something else than itself, or has kinks
_NARROW = frozenset(('sqrt', 'log', 'asin', 'exp', 'tan'))
_WAVES = frozenset(('sin', 'cos'))


@dataclass(frozen=True, eq=False)
class Model:
    """Of n states, m inputs and s unknown inputs; variables stand in this order."""

    system: System
    f: tuple[Node, ...]          # (n,) over states, inputs and unknown inputs
    sensors: dict[str, Node]     # over the states
    wanted: dict[str, Node]

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(self.system.states)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the known inputs."""
        return tuple(self.system.inputs)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the unknown inputs."""
        return tuple(self.system.unknown)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of all that f may depend on."""
        return (*self.states, *self.inputs, *self.unknown)

    @property
    def discrete(self) -> bool:
        """Whether f gives next values."""
        return self.system.discrete

    @cached_property
    def dynamics(self) -> Equations:
        """The f, to be evaluated at points (n + m + s, N)."""
        return Equations(self.f, self.variables)

    @cached_property
    def h0(self) -> Equations:
        """What the healthy sensors show, over states (n, N)."""
        return Equations(list(self.sensors.values()), self.states)

    @cached_property
    def smooth(self) -> bool:
        """Whether all is made of smooth functions."""
        return all(part.function in SMOOTH for part in self._parts)

    @cached_property
    def _parts(self) -> list[Apply]:
        return [part for node in (*self.f, *self.sensors.values(), *self.wanted.values())
                for part in walk(node) if isinstance(part, Apply)]

    @cached_property
    def declared(self) -> list[Range]:
        """The ranges of all variables."""
        return [*self.system.states.values(), *self.system.inputs.values(),
                *self.system.unknown.values()]

    @cached_property
    def wide(self) -> list[Range]:
        """
        Ranges in which identities are tried: wider, where that can do no harm.

        An identity between smooth functions that holds in one place holds everywhere, and over
        a wide range monomials differ more clearly.
        """
        if not self.smooth:
            return self.declared
        narrow = {name for part in self._parts for argument in part.arguments
                  if part.function in _NARROW or (part.function == '**'
                                                  and not _whole(part.arguments[1]))
                  for name in names(argument)}
        waves = {name for part in self._parts if part.function in _WAVES for name in names(part)}
        return [known if name in narrow else _widened(known, name in waves)
                for name, known in zip(self.variables, self.declared)]

    def points(self, count: int, seed: int, declared: bool = False,
               beyond: float = 0.0) -> np.ndarray:
        """
        Return points (n + m + s, count), uniform over the wide or the declared ranges.

        beyond: how much of a declared range is added to both its ends.
        """
        low, high = np.array(self.declared if declared else self.wide, dtype=float).T
        draw = np.random.default_rng(seed).random((count, len(low)))
        return (low + (high - low) * ((1.0 + 2.0 * beyond) * draw - beyond)).T


def read(system: System) -> Model:
    """Read and check a system; raises BadInput, one line, that names what is wrong."""
    states, inputs, unknown = (list(part) for part in (system.states, system.inputs,
                                                       system.unknown))
    known = [*states, *inputs, *unknown]
    for name in known:
        check_name(name, WHERE, name)
    if len(set(known)) < len(known):
        raise BadInput(WHERE, 'states', 'two of the states and inputs have the same name',
                       'give each a name of its own')
    for name, (low, high) in [*system.states.items(), *system.inputs.items(),
                              *system.unknown.items()]:
        if not -math.inf < low <= high < math.inf:
            raise BadInput(WHERE, name, f'has the range {low:g} to {high:g}',
                           'give a finite range, the lower end first')
    if list(system.f) != states:
        raise BadInput(WHERE, 'f', 'does not have one equation for each state',
                       'give one for each, in their order')
    if not system.wanted:
        raise BadInput(WHERE, 'wanted', 'nothing is wanted', 'name what is to be estimated')
    if missing := [name for name in system.angles if name not in states]:
        raise BadInput(WHERE, 'angles', f'{missing[0]} is no state', 'name states only')
    if system.sample_time is not None and not 0.0 < system.sample_time < math.inf:
        raise BadInput(WHERE, 'sample_time', 'is not positive', 'give seconds')
    return Model(
        system, tuple(parse(text, WHERE, f'f.{state}', known) for state, text in system.f.items()),
        {name: parse(text, WHERE, f'sensors.{name}', states)
         for name, text in system.sensors.items()},
        {name: parse(text, WHERE, f'wanted.{name}', states)
         for name, text in system.wanted.items()})


def gradients(nodes: Sequence[Node], variables: Sequence[str], at: np.ndarray) -> np.ndarray:
    """Return the gradients (E, V, N) at points (V, N)."""
    with np.errstate(all='ignore'):
        return Equations(nodes, variables).slopes(at)[1]


def state_of(node: Node) -> str | None:
    """Return the name that an expression is alone, or None."""
    return node.id if isinstance(node, Name) else None


def _whole(p: Node) -> bool:
    value = getattr(p, 'value', None)
    return value is not None and float(value).is_integer()


def _widened(known: Range, wave: bool) -> Range:
    low, high = known
    if wave:
        return min(low, -3.0), max(high, 3.0)
    if low > 0.0:
        return 0.5 * low, 2.0 * high
    if high < 0.0:
        return 2.0 * low, 0.5 * high
    reach = max(-low, high) or 1.0
    return -reach, reach
