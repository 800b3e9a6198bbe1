"""
Make a Takagi-Sugeno plant of equations by sector nonlinearity.

Each addend is written as z(premises) times one name, or times 1. Each z lies in a sector, and each
corner of all sectors is a submodel; blended, they are the equations, not an approximation of them.
Which factor counts as the name is a choice: the premises should be read by healthy sensors.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
import itertools

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import (
    Apply,
    fold,
    function_of,
    Name,
    names,
    Node,
    Number,
    parse,
    substitute,
    to_text,
)
from vsensor_ros.functions.interval import Interval
from vsensor_ros.plant.plant import Plant
from vsensor_ros.plant.takagi_sugeno import MOST_SUBMODELS, TakagiSugeno

MOST_ADDENDS = 400
_POINTS = 500  # random ones, where it is held beside the equations
_OFF = 1e-9  # relative, by which it may be off them
_ONE = Number(1.0)
Addend = tuple[float, tuple[Node, ...]]


@dataclass(frozen=True)
class _Choice:
    z: str  # the premise's function, as a text
    name: str  # what it multiplies; '' for 1


def from_equations(plant: Plant, healthy: Collection[str] | None = None,
                   ranges: Mapping[str, tuple[float, float]] | None = None) -> TakagiSugeno:
    """
    Return the Takagi-Sugeno plant that is the same as the equations over the declared ranges.

    healthy: states that healthy sensors read, all when None: premises are taken of these and of
    the inputs where that can be. ranges: narrower than declared, by name. Raises BadInput where
    there are no equations, an open range, or too many submodels.
    """
    if not plant.equations:
        raise BadInput(plant.name, 'dynamics', 'are not known as equations',
                       'write the plant file with dynamics')
    if plant.definitions:
        raise BadInput(plant.name, 'definitions', 'are too long to be written out in dynamics',
                       'write shorter equations')
    unmeasured = set(plant.states) - set(plant.states if healthy is None else healthy)
    if plant.unknown is not None:
        raise BadInput(plant.name, 'disturbances', 'or sensors are in nonlinear addends, which '
                       'submodels cannot hold', 'let unknown inputs be addends of their own')
    where = {**dict(zip(plant.states, plant.ranges)), **dict(zip(plant.inputs, plant.input_range)),
             **(ranges or {})}
    rows = [_expanded(fold(substitute(parse(text), plant.parameters)), plant.name,
                      f'dynamics.{state}') for text, state in zip(plant.equations, plant.states)]
    columns = (*plant.states, *plant.inputs, *plant.disturbances, '')
    parts: dict[str, np.ndarray] = {_text(()): np.zeros((len(rows), len(columns)))}
    for (i, (scale, _)), choice in _chosen(rows, set(columns), unmeasured, plant):
        parts.setdefault(choice.z, np.zeros_like(parts[_text(())]))[
            i, columns.index(choice.name)] += scale
    base = parts.pop(_text(())).copy()
    sectors: list[tuple[str, Interval, np.ndarray]] = []
    for z, matrix in parts.items():
        if not matrix.any():  # its addends cancel
            continue
        node = parse(z)
        for name in names(node):
            if not np.isfinite(where[name]).all():
                raise BadInput(plant.name, f'{name}.range', f'is open, and {name} is a premise',
                               f'declare where {name} lives: range: [low, high]')
        low, high = _bounds(node, where)
        if not np.isfinite([low, high]).all():
            raise BadInput(plant.name, 'dynamics', f'{z} has no bounds over the declared ranges',
                           'declare narrower ranges')
        if low == high:
            base += low * matrix
        else:
            sectors.append((z, (low, high), matrix))
    if 2**len(sectors) > MOST_SUBMODELS:
        raise BadInput(plant.name, 'dynamics', f'make {2**len(sectors)} submodels, of '
                       + ', '.join(z for z, _, _ in sectors),
                       f'keep it within {MOST_SUBMODELS}: declare fewer nonlinear addends')
    found: dict[bytes, tuple[np.ndarray, list[str]]] = {}
    unit = 1e-12 * max(1e-300, *(abs(part).max() * max(map(abs, ends))
                                 for _, ends, part in sectors), abs(base).max())
    for corner in itertools.product((0, 1), repeat=len(sectors)):
        matrix, h = base.copy(), []
        for (z, (low, high), part), side in zip(sectors, corner):
            matrix += (low, high)[side] * part
            above = f'(({z}) - ({low!r}))' if side else f'(({high!r}) - ({z}))'
            h.append(f'{above}/{high - low!r}')
        same = (np.rint(matrix / unit) + 0.0).tobytes()  # bounds are rounded outward
        found.setdefault(same, (matrix, []))[1].append('*'.join(h) or '1')
    all_ = np.array([matrix for matrix, _ in found.values()])
    n, m, d = len(plant.states), len(plant.inputs), len(plant.disturbances)
    used = [name for name in (*plant.states, *plant.inputs)
            if any(name in names(parse(z)) for z, _, _ in sectors)]
    merged = 2**len(sectors) - len(all_)
    said = (f'{len(all_)} submodels of ' + (', '.join(z for z, _, _ in sectors) or 'no premise')
            + (f'; {merged} coincided' if merged else ''),)
    made = TakagiSugeno.of_submodels(
        all_[:, :, :n], all_[:, :, n:n + m], plant.C, E=all_[:, :, n + m:n + m + d],
        a=all_[:, :, -1], premises={name: list(where[name]) for name in used},
        memberships=[' + '.join(texts) for _, texts in found.values()], states=plant.states,
        inputs=plant.inputs, disturbances=plant.disturbances, sensors=plant.sensors,
        sample_time=plant.sample_time, name=plant.name, remarks=said, where=plant.name)
    _check(plant, made, where)
    return made


def _chosen(rows: list[list[Addend]], known: set[str], unmeasured: set[str],
            plant: Plant) -> list[tuple[tuple[int, Addend], _Choice]]:
    """Choose the name in each addend; those with the fewest ways first, then what is there."""
    ways: list[tuple[tuple[int, Addend], list[_Choice]]] = []
    for i, addends in enumerate(rows):
        for addend in addends:
            factors = addend[1]
            unknown = set(plant.disturbances)
            open_ = [_Choice(_text(factors[:k] + factors[k + 1:]), factor.id)
                     for k, factor in enumerate(factors)
                     if isinstance(factor, Name) and factor.id in known]
            open_.append(_Choice(_text(factors), ''))
            open_ = [c for c in open_ if unknown.isdisjoint(names(parse(c.z)))]
            if not open_:
                raise BadInput(plant.name, f'dynamics.{plant.states[i]}', 'an unknown input is '
                               f'inside of {_text(factors)}', 'let it be a factor of its own')
            read = [c for c in open_ if unmeasured.isdisjoint(names(parse(c.z)))] or open_
            # where a name is left, it is a submodel's entry and no offset
            ways.append(((i, addend), [c for c in read if c.name] or read))
    there: set[str] = set()
    found = []
    for place, choices in sorted(ways, key=lambda way: len(way[1])):
        choice = min(choices, key=lambda c: (c.z != _text(()), c.z not in there))
        there.add(choice.z)
        found.append((place, choice))
    return found


def _text(factors: tuple[Node, ...]) -> str:
    return '*'.join(sorted(f'({to_text(factor)})' if isinstance(factor, Apply)
                           else to_text(factor) for factor in factors)) or '1'


def _expanded(node: Node, where: object, key: str) -> list[Addend]:
    """Return the addends of a node with all products multiplied out."""
    def inner(part: Node) -> list[Addend]:
        return _expanded(part, where, key)

    if isinstance(node, Number):
        return [(node.value, ())]
    if isinstance(node, Name):
        return [(1.0, (node,))]
    arguments = node.arguments
    if node.function == 'neg':
        return [(-scale, factors) for scale, factors in inner(arguments[0])]
    if node.function in ('+', '-'):
        sign = 1.0 if node.function == '+' else -1.0
        return inner(arguments[0]) + [(sign * s, factors) for s, factors in inner(arguments[1])]
    if node.function == '**' and arguments[1] in (Number(2.0), Number(3.0)):
        assert isinstance(arguments[1], Number)
        once = inner(arguments[0])
        product: list[Addend] = [(1.0, ())]
        for _ in range(int(arguments[1].value)):
            product = _times(product, once, where, key)
        return product
    if node.function == '*':
        return _times(inner(arguments[0]), inner(arguments[1]), where, key)
    if node.function == '/':
        if isinstance(arguments[1], Number) and arguments[1].value:
            by = arguments[1].value
            return [(scale / by, factors) for scale, factors in inner(arguments[0])]
        if arguments[0] != _ONE:
            return _times(inner(arguments[0]), [(1.0, (Apply('/', (_ONE, arguments[1])),))],
                          where, key)
    return [(1.0, (node,))]


def _times(one: list[Addend], other: list[Addend], where: object, key: str) -> list[Addend]:
    if len(one) * len(other) > MOST_ADDENDS:
        raise BadInput(where, key, 'has too many addends when it is multiplied out',
                       'write it with fewer')
    return [(a * b, (*left, *right)) for a, left in one for b, right in other]


def _bounds(node: Node, where: Mapping[str, tuple[float, float]]) -> Interval:
    """Bound a node over ranges by name."""
    if isinstance(node, Number):
        return node.value, node.value
    if isinstance(node, Name):
        low, high = where[node.id]
        return float(low), float(high)
    return function_of(node).bounds(*[_bounds(a, where) for a in node.arguments])[0]


def _check(plant: Plant, made: TakagiSugeno, where: Mapping[str, tuple[float, float]]) -> None:
    """Hold it beside the plant at random points; raise BadInput where it is off."""
    random = np.random.default_rng(0)

    def points(names_: tuple[str, ...]) -> np.ndarray:
        given = np.array([where.get(name, (-1.0, 1.0)) for name in names_]).reshape(-1, 2)
        ends = np.where(np.isfinite(given), given, [-1.0, 1.0])
        low, high = ends.min(axis=1), ends.max(axis=1)
        return low[:, None] + (high - low)[:, None] * random.random((len(names_), _POINTS))
    x, u, rho = points(plant.states), points(plant.inputs), points(plant.disturbances)
    truth = plant.rate_of_change(x, u, rho)
    off = abs(made.rate_of_change(x, u, rho) - truth).max(axis=1)
    size = abs(truth).max(axis=1) + abs(np.array([A @ x for A in made.A])).max(axis=(0, 2))
    for state, wrong, scale in zip(plant.states, off, size):
        if not wrong <= _OFF * max(scale, 1e-300):
            raise BadInput(plant.name, f'dynamics.{state}', f'is off its submodels by {wrong:.2g} '
                           'at a random point', 'report this: the two should be the same')
