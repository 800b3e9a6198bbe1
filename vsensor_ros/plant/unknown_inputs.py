"""
Unknown inputs that enter nonlinearly, such as rho*(15 - T)/V: directions in which they push.

A linear map is free of such an input when it is free of all directions that its columns take
over the domain: Phi p(x) = 0 for all x means that Phi annihilates span {p(x)}. So each direction
of the span is an unknown input of its own, with a constant column, and an expression that says
what it is. What a sensor shows beside its linear part is one, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Apply, Name, names, Node, Number, parse, to_text

POINTS = 64  # random ones, at which directions are told apart
RANK = 1e-9  # of the largest singular value: what is less is rounding
BEND = 'bend_of_'  # before the name of a sensor that is not linear


@dataclass(frozen=True)
class UnknownInputs:
    """
    The unknown inputs as they are given, and what they come to in each column of D and Cd.

    texts: one a column, over states, inputs and names.
    """

    names: tuple[str, ...]
    ranges: tuple[tuple[float, float], ...]
    noise: tuple[float, ...]  # as Plant.disturbance_noise
    texts: tuple[str, ...]

    def acting(self, at: np.ndarray, known: Sequence[str]) -> np.ndarray:
        """Return what each column is multiplied by (d, ..) at known quantities, then names."""
        with np.errstate(all='ignore'):
            return _compiled(self.texts, (*known, *self.names)).values(
                at.reshape(len(at), -1)).reshape(-1, *at.shape[1:])


@lru_cache(maxsize=16)
def _compiled(texts: tuple[str, ...], variables: tuple[str, ...]) -> Equations:
    return Equations([parse(text) for text in texts], variables)


@dataclass(frozen=True, eq=False)
class Directions:
    """Columns of D (n, d) and Cd (l, d), their names, what each is, and what is to be told."""

    D: np.ndarray
    Cd: np.ndarray
    names: tuple[str, ...]
    nodes: tuple[Node, ...]
    said: tuple[str, ...]


def directions(D: np.ndarray, Cd: np.ndarray, rest: Sequence[Sequence[Node]],
               states: Sequence[str], sensors: Sequence[str], disturbances: Sequence[str],
               ranges: Mapping[str, tuple[float, float]]) -> Directions:
    """
    Find the directions of unknown inputs that are in nonlinear addends.

    D (n, d), Cd (l, d): of the addends that are linear. rest (n + l): the others of each state
    and of each sensor, of the states those with an unknown input, of the sensors all. ranges: of
    all names, where they live.
    """
    linear = np.vstack([D, Cd])
    rows = (*states, *(BEND + sensor for sensor in sensors))
    groups = _groups(rest, rows, len(states), disturbances)
    taken = {name for group in groups for name in group}
    plain = [i for i, name in enumerate(disturbances) if name not in taken]
    columns = [linear[:, plain]]
    names_ = [disturbances[i] for i in plain]
    nodes: list[Node] = [Name(name) for name in names_]
    said: list[str] = []
    for group, addends in groups.items():
        parts = [_sum([*addends.get(i, ()), *(
            Apply('*', (Number(float(row[j])), Name(name)))
            for j, name in enumerate(disturbances) if name in group and row[j])])
            for i, row in enumerate(linear)]
        found, pivots = _span(parts, ranges)
        of = [name for name in group if not name.startswith(BEND)]
        made = [group[0] if len(pivots) == len(of) == 1 else
                BEND + sensors[i - len(states)] if i >= len(states) else
                '_'.join(of) + '_in_' + states[i] for i in pivots]
        columns.append(found)
        names_.extend(made)
        nodes.extend(parts[i] for i in pivots)
        if of and len(pivots) > 1:
            said.append(f'{" and ".join(of)} pushes in {len(pivots)} directions, by where the '
                        f'plant is: a linear map must be free of {", ".join(made)}, each as of '
                        'an unknown input of its own')
    whole = np.hstack(columns)
    return Directions(whole[:len(states)], whole[len(states):], tuple(names_), tuple(nodes),
                      tuple(said))


def _groups(rest: Sequence[Sequence[Node]], rows: Sequence[str], n: int,
            disturbances: Sequence[str]) -> dict[tuple[str, ...], dict[int, list[Node]]]:
    """Return addends by row, of unknown inputs that share one; of a sensor without, its own."""
    groups: dict[tuple[str, ...], dict[int, list[Node]]] = {}
    for i, addends in enumerate(rest):
        # a sensor is one reading: whatever bends it belongs together
        for of in ([addends] if i >= n and addends else [[node] for node in addends]):
            held = {name for node in of for name in names(node)}
            own = tuple(name for name in disturbances if name in held) or (rows[i],)
            merged = {i: list(of)}
            for other in [group for group in groups if set(group) & set(own)]:
                own = (*own, *(name for name in other if name not in own))
                for row, nodes in groups.pop(other).items():
                    merged.setdefault(row, []).extend(nodes)
            groups[own] = merged
    return groups


def _sum(nodes: Sequence[Node]) -> Node:
    return reduce(lambda a, b: Apply('+', (a, b)), nodes) if nodes else Number(0.0)


def _span(parts: Sequence[Node], ranges: Mapping[str, tuple[float, float]],
          ) -> tuple[np.ndarray, list[int]]:
    """
    Return columns (.., r) that span what the parts say anywhere, and rows that tell them apart.

    These rows are those of the identity.
    """
    random, variables = np.random.default_rng(0), tuple(ranges)
    ends = np.array([ranges[name] for name in variables])
    low, high = (np.where(np.isfinite(ends).all(axis=1), side, other)[:, None]
                 for side, other in zip(ends.T, (-1.0, 2.0)))
    with np.errstate(all='ignore'):
        said = Equations(parts, variables).values(random.uniform(
            low, high, (len(variables), POINTS)))
    said = said[:, np.isfinite(said).all(axis=0)]
    size = np.abs(said).max(axis=1, initial=0.0)
    level = said / np.where(size > 0.0, size, 1.0)[:, None]
    pivots: list[int] = []
    for i in range(len(parts)):
        values = np.linalg.svd(level[[*pivots, i]], compute_uv=False)
        if size[i] and values[-1] > RANK * values[0]:
            pivots.append(i)
    if not pivots:
        return np.zeros((len(parts), 0)), pivots
    found = np.linalg.lstsq(said[pivots].T / size[pivots], said.T, rcond=None)[0].T / size[pivots]
    found = np.array([[float(f'{v:.10g}') for v in row] for row in found]).reshape(
        len(parts), len(pivots))
    biggest = np.abs(found * size[pivots]).max(axis=1, initial=0.0, keepdims=True)
    return np.where(np.abs(found * size[pivots]) > RANK * biggest, found, 0.0), pivots


def unknown_inputs(found: Directions, given: Sequence[str], ranges: np.ndarray,
                   noise: Sequence[float], where: object) -> UnknownInputs:
    """Return how the columns follow from the unknown inputs as given; raises BadInput."""
    texts = tuple(to_text(node) for node in found.nodes)
    if len(set(found.names)) < len(found.names):
        twice = next(name for name in given if found.names.count(name) > 1)
        raise BadInput(where, f'disturbances.{twice}', 'is the name of a direction of another one',
                       'rename it')
    for name, text in zip(found.names, texts):
        try:
            parse(text)
        except BadInput as error:
            raise BadInput(where, 'dynamics', f'{name}, what the unknown input comes to, is too '
                           'long to be written', 'write its addends shorter') from error
    return UnknownInputs(tuple(given), tuple((float(a), float(b)) for a, b in ranges),
                         tuple(map(float, noise)), texts)
