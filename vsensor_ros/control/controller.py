"""A linear controller: from what sensors say, to what inputs are told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.plant.checked import suggestion

LARGEST = 1e75  # of an entry
MOST_STATES = 200


@dataclass(frozen=True, eq=False)
class Controller:
    """
    ``d s = A s + B y, u = C s + D y``; d is the derivative, or the next value.

    r states, l sensors that it reads, m inputs that it writes. y and u are deviations from the
    operating point, in their units.
    """

    reads: tuple[str, ...]  # l sensors
    writes: tuple[str, ...]  # m inputs
    A: np.ndarray  # (r, r)
    B: np.ndarray  # (r, l)
    C: np.ndarray  # (m, r)
    D: np.ndarray  # (m, l)
    sample_time: float | None = None  # s; None: continuous, or that of the plant when A is empty
    unheard: tuple[str, ...] = ()  # inputs that virtual sensors do not hear of
    name: str = 'controller'  # the file that it comes from

    def __post_init__(self) -> None:
        A = _numbers(self.A, self.name, 'A')
        r, m, count = len(np.atleast_2d(A)) * bool(A.size), len(self.writes), len(self.reads)
        if r > MOST_STATES:
            raise BadInput(self.name, 'A', f'has {r} states', f'keep it within {MOST_STATES}')
        for letter, shape in (('A', (r, r)), ('B', (r, count)), ('C', (m, r)), ('D', (m, count))):
            object.__setattr__(self, letter, _array(getattr(self, letter), shape, self.name,
                                                    letter))
        for key in ('reads', 'writes', 'unheard'):
            names = getattr(self, key)
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise BadInput(self.name, key, f'{twice} is named twice', 'name each once')
        if not (self.reads and self.writes):
            raise BadInput(self.name, 'writes' if self.reads else 'reads', 'is empty',
                           'name what it reads and what it writes')
        for name in self.unheard:
            if name not in self.writes:
                raise BadInput(self.name, 'unheard', f'{shown(name)} is no input that it writes',
                               suggestion(name, self.writes))
        h = self.sample_time
        if h is not None and (isinstance(h, bool) or not isinstance(h, (int, float))
                              or not 0.0 < h <= LARGEST):
            raise BadInput(self.name, 'sample_time', f'{shown(h)} is not a positive number',
                           'give seconds, or leave it out')

    @classmethod
    def gain(cls, K: Any, reads: Sequence[str], writes: Sequence[str], *,
             sample_time: float | None = None, unheard: Sequence[str] = (),
             name: str = 'controller') -> Controller:
        """Return ``u = -K y`` with K (m, l); raise BadInput."""
        K = _array(K, (len(writes), len(reads)), name, 'gain')
        return cls(tuple(reads), tuple(writes), np.zeros((0, 0)), np.zeros((0, len(reads))),
                   np.zeros((len(writes), 0)), -K, sample_time, tuple(unheard), name)

    @classmethod
    def transfer(cls, entries: Mapping[str, Mapping[str, Any]], sample_time: float, *,
                 reads: Sequence[str] | None = None, unheard: Sequence[str] = (),
                 name: str = 'controller') -> Controller:
        """
        Return ``u_i = sum_j b_ij(z) / a_ij(z) y_j`` of a discrete transfer matrix.

        entries: by input and by sensor (b, a), the coefficients of falling powers of z. In one
        row, entries of the same denominator share its states. Raises BadInput.
        """
        writes = tuple(entries)
        heard = tuple(reads) if reads is not None else tuple(
            dict.fromkeys(sensor for row in entries.values() for sensor in row))
        blocks, D = [], np.zeros((len(writes), len(heard)))
        for i, (of, row) in enumerate(entries.items()):
            shared: dict[tuple[float, ...], np.ndarray] = {}
            for sensor, (b, a) in row.items():
                key = f'transfer.{of}.{sensor}'
                if sensor not in heard:
                    raise BadInput(name, key, 'is no sensor that it reads',
                                   suggestion(sensor, heard))
                j = heard.index(sensor)
                b, a = _proper(b, a, name, key)
                D[i, j] = b[0]
                into = shared.setdefault(tuple(a[1:].tolist()),
                                         np.zeros((len(a) - 1, len(heard))))
                into[:, j] += b[1:] - a[1:] * b[0]
            blocks += [(i, np.array(a), into) for a, into in shared.items() if len(a)]
        r = sum(len(a) for _, a, _ in blocks)
        A, B, C = np.zeros((r, r)), np.zeros((r, len(heard))), np.zeros((len(writes), r))
        first = 0
        for i, a, into in blocks:  # in the observer form, which has no states to spare
            own = slice(first, first + len(a))
            A[own, own] = np.eye(len(a), k=1)
            A[own, first] = -a
            B[own], C[i, first] = into, 1.0
            first += len(a)
        return cls(heard, writes, A, B, C, D, sample_time, tuple(unheard), name)


def _proper(b: Any, a: Any, where: str, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Return both of one length, the denominator with 1 in front."""
    b, a = (np.trim_zeros(_array(np.atleast_1d(v), None, where, f'{key}.{part}'), 'f')
            for v, part in ((b, 'numerator'), (a, 'denominator')))
    if not len(a):
        raise BadInput(where, f'{key}.denominator', 'is zero',
                       'give the coefficients of falling powers of z')
    if len(b) > len(a):
        raise BadInput(where, f'{key}.numerator', f'is of degree {len(b) - 1}, above that of the '
                       f'denominator, {len(a) - 1}',
                       'it would need readings of the future: give as many coefficients or fewer')
    return np.concatenate([np.zeros(len(a) - len(b)), b]) / a[0], a / a[0]


def _numbers(value: Any, where: str, key: str) -> np.ndarray:
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise BadInput(where, key, f'{shown(value)} is not numbers', 'give numbers') from None


def _array(value: Any, shape: tuple[int, ...] | None, where: str, key: str) -> np.ndarray:
    array = _numbers(value, where, key)
    if shape is not None:
        if array.size == 0 and 0 in shape:
            array = array.reshape(shape)
        if array.ndim == 1 and 1 in shape and array.size == max(shape):
            array = array.reshape(shape)
        if array.shape != shape:
            raise BadInput(where, key, f'has shape {array.shape}',
                           f'give {shape[0]} rows of {shape[1]} numbers')
    elif array.ndim != 1:
        raise BadInput(where, key, f'{shown(value)} is no list of numbers', 'give a list')
    if not (np.abs(array) <= LARGEST).all():
        raise BadInput(where, key, f'holds a number that is not finite or beyond {LARGEST:g}',
                       'give finite numbers')
    array.flags.writeable = False
    return array
