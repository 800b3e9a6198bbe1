"""
Takagi-Sugeno plants: linear submodels, blended by membership functions of premises.

Weights are checked where they come from outside: at random points of the declared ranges and at
the corners they are not negative and sum to 1. Those of equations are made elsewhere, by sector
nonlinearity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
import hashlib
import itertools
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, check_text, shown
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse, to_text
from vsensor_ros.plant.checked import (
    as_list,
    check_distinct,
    checked_matrix,
    checked_names,
    checked_ranges,
    checked_sample_time,
)

MOST_SUBMODELS = 64
MOST_PREMISES = 10
_SUM = 1e-9  # by which the weights may be off 1
_POINTS = 200  # at which they are looked at


@dataclass(frozen=True, eq=False)
class TakagiSugeno:
    """
    d x = sum_i h_i(p) (A_i x + B_i u + E_i rho + a_i),  y = C x.

    d is the derivative, or the shift by `sample_time` seconds; h_i >= 0 sum to 1 where the
    premises p are in their ranges. V submodels, n states, m inputs, d unknown inputs, l sensors.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    sensors: tuple[str, ...]
    A: np.ndarray  # (V, n, n)
    B: np.ndarray  # (V, n, m)
    E: np.ndarray  # (V, n, d)
    a: np.ndarray  # (V, n)
    C: np.ndarray  # (l, n)
    premises: tuple[str, ...]  # names of states or inputs
    ranges: np.ndarray  # (p, 2) of them, finite
    memberships: tuple[str, ...]  # V expressions of the premises
    sample_time: float | None  # s
    remarks: tuple[str, ...] = ()  # what is to be told of how it was made
    units: Mapping[str, str] = field(default_factory=dict)
    box: np.ndarray | None = None  # (n + m, 2) where states and inputs lie; None: nobody said
    # how large noise is at most, None: nobody said: of a step (n,), of readings (l,)
    state_noise: np.ndarray | None = None
    reading_noise: np.ndarray | None = None

    @classmethod
    def of_submodels(cls, A: Any, B: Any, C: Any, *, premises: Mapping[str, Any],
                     memberships: Sequence[str], E: Any = None, a: Any = None,
                     states: Sequence[str] | None = None, inputs: Sequence[str] | None = None,
                     disturbances: Sequence[str] | None = None,
                     sensors: Sequence[str] | None = None, sample_time: float | None = None,
                     name: str = 'plant', remarks: Sequence[str] = (),
                     where: object = 'TakagiSugeno.of_submodels') -> TakagiSugeno:
        """
        Make one of V submodels: A (n, n) each, B (n, m), E (n, d) and a (n,), zero when None.

        premises: low and high by name of a state or input; memberships: V expressions of them.
        Raises BadInput, also where the memberships are negative or do not sum to 1.
        """
        A = _stacked(A, where, 'A')
        V, n = A.shape[:2]
        if not 0 < V <= MOST_SUBMODELS or A.shape[2] != n or n == 0:
            raise BadInput(where, 'A', f'has shape {A.shape}',
                           f'give 1 to {MOST_SUBMODELS} square matrices')
        B = _stacked(np.zeros((V, n, 0)) if B is None else B, where, 'B')
        E = _stacked(np.zeros((V, n, 0)) if E is None else E, where, 'E')
        a = checked_matrix(np.zeros((V, n)) if a is None else a, where, 'a')
        for key, array in (('B', B), ('E', E), ('a', a)):
            if array.shape[:2] != (V, n):
                raise BadInput(where, key, f'has shape {array.shape}',
                               f'give one of {n} rows for each of the {V} submodels')
        C = checked_matrix(C, where, 'C', row=True)
        if len(C) == 0 or C.shape[1] != n:
            raise BadInput(where, 'C', f'has shape {C.shape}',
                           f'give one row of {n} numbers a sensor')
        names = {
            'states': checked_names(states, 'x', n, where, 'states'),
            'inputs': checked_names(inputs, 'u', B.shape[2], where, 'inputs'),
            'disturbances': checked_names(disturbances, 'rho', E.shape[2], where, 'disturbances')}
        check_distinct(where, names)
        if not isinstance(premises, Mapping) or len(premises) > MOST_PREMISES:
            raise BadInput(where, 'premises', f'{shown(premises)} is no mapping of at most '
                           f'{MOST_PREMISES}', 'give {name: [low, high]}')
        for premise in premises:
            if premise not in (*names['states'], *names['inputs']):
                raise BadInput(where, 'premises', f'{shown(premise)} is no state and no input',
                               'name one of ' + ', '.join((*names['states'], *names['inputs'])))
        ranges = checked_ranges(list(premises.values()) or np.zeros((0, 2)), len(premises), where,
                                'premises', 'a premise')
        if not np.isfinite(ranges).all():
            raise BadInput(where, 'premises', 'have a range that is open',
                           'give finite low and high')
        texts = tuple(as_list(memberships, where, 'memberships'))
        if len(texts) != V:
            raise BadInput(where, 'memberships', f'are {len(texts)}', f'give {V}, one a submodel')
        for i, text in enumerate(texts):
            parse(text, where, f'memberships[{i}]', known=tuple(premises))
        made = cls(check_text(name, where, 'name'), names['states'], names['inputs'],
                   names['disturbances'], checked_names(sensors, 'y', len(C), where, 'sensors'),
                   A, B, E, a, C, tuple(premises), ranges, texts,
                   checked_sample_time(sample_time, where), tuple(remarks))
        made._check_weights(where)
        return made

    @cached_property
    def _weights(self) -> Equations:
        return Equations([parse(text) for text in self.memberships], self.premises)

    def weights(self, at: np.ndarray) -> np.ndarray:
        """Return h (V, N) at premises (p, N)."""
        return self._weights.values(at)

    def inside(self, at: np.ndarray) -> np.ndarray:
        """Tell (N,) where all premises (p, N) are in their ranges."""
        low, high = self.ranges.T[:, :, None]
        return ((low <= at) & (at <= high)).all(axis=0)

    def premises_of(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the premises (p, N) of states (n, N) and inputs (m, N)."""
        rows = dict(zip((*self.states, *self.inputs), (*x, *u)))
        return np.array([rows[name] for name in self.premises]).reshape(-1, x.shape[1])

    def rate_of_change(self, x: np.ndarray, u: np.ndarray, rho: np.ndarray) -> np.ndarray:
        """Return the right-hand side (n, N) at x (n, N), u (m, N), rho (d, N)."""
        h = self.weights(self.premises_of(x, u))
        each = self.A @ x + self.B @ u + self.E @ rho + self.a[:, :, None]
        return np.einsum('vk,vnk->nk', h, each)

    def points(self, count: int, seed: int = 0) -> np.ndarray:
        """Return premises (p, N): the corners of their ranges, and so many random points."""
        corners = np.array(list(itertools.product(*self.ranges))).reshape(
            2**len(self.ranges), -1).T
        low, high = self.ranges.T[:, :, None]
        random = np.random.default_rng(seed).random((len(self.ranges), count))
        return np.concatenate([corners, low + (high - low) * random], axis=1)

    def _check_weights(self, where: object) -> None:
        at = self.points(_POINTS)
        h = self.weights(at)
        if not np.isfinite(h).all() or (h < -_SUM).any():
            v, k = np.argwhere(~(h >= -_SUM))[0]
            raise BadInput(where, f'memberships[{v}]', f'is {h[v, k]:g} at {self.told(at[:, k])}',
                           'let it be 0 or more where the premises are in their ranges')
        off = abs(h.sum(axis=0) - 1.0)
        if (worst := int(off.argmax()), off.max() > _SUM)[1]:
            raise BadInput(where, 'memberships', f'sum to {h[:, worst].sum():.6g} at '
                           f'{self.told(at[:, worst])}', 'let them sum to 1 there')

    def hash(self) -> str:
        """Return the SHA-256 of what a design depends on."""
        digest = hashlib.sha256()
        for key, value in vars(self).items():
            if isinstance(value, np.ndarray):
                value = value.shape, [float(v + 0.0).hex() for v in value.ravel()]
            if key not in ('_weights', 'remarks', 'units'):
                digest.update(f'{key}:{value};'.encode())
        return digest.hexdigest()

    def told(self, at: np.ndarray) -> str:
        """Return premises (p,) in words: 'id = -21.9, iq = 0'."""
        exact = np.where(abs(at) > _SUM * np.diff(self.ranges)[:, 0], at, 0.0)
        return ', '.join(f'{name} = {value:.4g}' for name, value in zip(self.premises, exact)) \
            or 'all times'


def grid_memberships(axes: Mapping[str, Sequence[float]],
                     where: object = 'grid') -> tuple[str, ...]:
    """
    Return the memberships of submodels on a grid: linear in each premise between its points.

    axes: the points of each premise, two or more, rising. The last premise runs fastest.
    """
    hats: list[list[str]] = []
    for name, axis in axes.items():
        points = checked_matrix(axis, where, name, row=True)[0]
        if len(points) < 2 or not (np.diff(points) > 0.0).all():
            raise BadInput(where, name, f'{shown(axis)} are not two points or more that rise',
                           'give the grid points of the premise')
        hats.append([to_text(parse(f'table({name}, ' + ', '.join(
            f'{point!r}, {float(j == i)}' for j, point in enumerate(points.tolist())) + ')'))
            for i in range(len(points))])
    return tuple('*'.join(part) or '1' for part in itertools.product(*hats))


def _stacked(value: Any, where: object, key: str) -> np.ndarray:
    """Return matrices of one shape (V, .., ..)."""
    found = [checked_matrix(one, where, f'{key}[{i}]')
             for i, one in enumerate(as_list(value, where, key))]
    if len({one.shape for one in found}) > 1 or not found:
        raise BadInput(where, key, 'are none, or not of one shape', 'give one a submodel')
    array = np.array(found)
    array.flags.writeable = False
    return array
