"""Membership functions of submodels: how they are read, and how submodels are blended by them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse
from vsensor_ros.observers.checked_json import CheckedObject
from vsensor_ros.reason import add_sentences, Reason

add_sentences({'premises out of range': 'nothing is proved where {names} are now'})

_OFF = 1e-9  # by which they may be off
_POINTS = 200  # at which they are looked at


def read_memberships(reader: CheckedObject, premises: tuple[str, ...],
                     ranges: np.ndarray) -> tuple[str, ...]:
    """
    Return the texts of `memberships` over premises in ranges (p, 2).

    Raises BadInput where low is not below high, and where they are negative, or do not sum to 1,
    at random points.
    """
    low, high = ranges.T
    if not (low < high).all():
        raise reader.fail('ranges', 'are not low and high')
    texts = reader.texts('memberships')
    parsed = [parse(text, reader.path, f'{reader.place}memberships[{i}]', known=premises)
              for i, text in enumerate(texts)]
    share = np.random.default_rng(0).random((len(premises), _POINTS))
    h = Equations(parsed, premises).values(low[:, None] + (high - low)[:, None] * share)
    if not ((h >= -_OFF).all() and (abs(h.sum(axis=0) - 1.0) <= _OFF).all()):
        raise reader.fail('memberships', 'are negative, or do not sum to 1, in the ranges')
    return texts


class Blended(Protocol):
    """What is asked of an entry that blends submodels."""

    @property
    def premises(self) -> tuple[str, ...]:
        """Names of p premises."""

    @property
    def ranges(self) -> np.ndarray:
        """Where they must lie (p, 2)."""

    @property
    def memberships(self) -> tuple[str, ...]:
        """Expressions of the premises, one a submodel."""


class Weights:
    """
    The weights of the submodels of V entries.

    premises: of each, (p, L + m), what makes them of L readings and m commands. turns: of each,
    (p,), by what a premise may be more and is the same, or 0; (0,): there is none.
    """

    def __init__(self, entries: Sequence[Blended], premises: Sequence[np.ndarray],
                 turns: Sequence[np.ndarray] = ()) -> None:
        self._of = [(np.asarray(e.ranges), rows, e.premises, Equations(
            [parse(text) for text in e.memberships], e.premises))
            for e, rows in zip(entries, premises)]
        self._turns = [turns[i] if i < len(turns) and turns[i].any() else None
                       for i in range(len(entries))]
        self._most = max(len(e.memberships) for e in entries)

    def inside(self, i: int, end: np.ndarray) -> bool:
        """Tell whether the premises of one are in their ranges at readings, commands (L + m,)."""
        ranges, at = self._of[i][0], self._premises(i, end)
        return bool(((ranges[:, 0] <= at) & (at <= ranges[:, 1])).all())

    def _premises(self, i: int, end: np.ndarray) -> np.ndarray:
        """Return the premises of one (p,), angles next to the middle of their ranges."""
        ranges, rows, _, _ = self._of[i]
        at, turns = rows @ end, self._turns[i]
        if turns is None:
            return np.asarray(at)
        whole = np.rint((at - ranges.mean(axis=1)) / np.where(turns, turns, np.inf))
        return np.asarray(at - turns * whole)

    def why_not(self, i: int, end: np.ndarray) -> Reason | None:
        """Return why nothing is proved of one there; None: it is."""
        return None if self.inside(i, end) else Reason.of(
            'premises out of range', names=', '.join(self._of[i][2]))

    def at(self, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the weights (V, submodels), padded, and whose premises are in range (V,)."""
        h = np.zeros((len(self._of), self._most))
        inside = np.array([self.inside(i, end) for i in range(len(h))], dtype=bool)
        for i in np.flatnonzero(inside):
            found = self._of[i][3].values(self._premises(i, end)[:, None])[:, 0]
            h[i, :len(found)] = found
        return h, inside
