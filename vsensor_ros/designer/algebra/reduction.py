"""
Few functions inside gamma* that tell what is wanted and their own change: Algorithm 1.

Source: Symmetry 15, 993, Algorithm 1. Each missing component is looked for among all functions of
gamma* that are functions of what is to be told. That the result is the smallest is not proved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.designer.algebra.coefficients import Function, named, next_of
from vsensor_ros.designer.algebra.dictionary import Dictionary
from vsensor_ros.designer.algebra.invariant import constant_along
from vsensor_ros.designer.algebra.model import Model
from vsensor_ros.designer.algebra.null_space import echelon, kernels, ranks
from vsensor_ros.designer.algebra.preimage import Twins
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Node

_POINTS = 9    # at which ranks are taken
_COMMANDS = 3  # at each of them, for what depends on commands
MOST_STATES = 24
_FAILED = 3    # functions that were not confirmed, and none that was


@dataclass(frozen=True, eq=False)
class Inside:
    """gamma* as coefficients (K, q), and points at which ranks are taken."""

    model: Model
    dictionary: Dictionary
    gamma: np.ndarray

    def gradients(self, nodes: Sequence[Node], commands: bool = True) -> np.ndarray:
        """Return gradients (E c, n, N) of expressions by the states, at c commands a point."""
        count, n = _POINTS + len(self.dictionary), len(self.model.states)
        x = self.model.points(count, 41)[:n]
        equations = Equations(nodes, self.model.variables)
        result = []
        for c in range(_COMMANDS if commands else 1):
            at = self.model.points(count, 43 + c)
            at[:n] = x
            with np.errstate(all='ignore'):
                result.append(equations.slopes(at)[1][:, :n])
        return np.concatenate(result)

    def known(self, chosen: Sequence[Function], sensors: bool = True) -> np.ndarray:
        """Return the gradients of chosen functions and healthy sensors."""
        return self.gradients([*(f.node for f in chosen),
                               *(self.model.sensors.values() if sensors else ())], False)

    def missing(self, chosen: Sequence[Function], targets: Sequence[Node],
                sensors: bool = True) -> int:
        """Return how many components are missing to tell the targets."""
        known, more = self.known(chosen, sensors), self.gradients(targets)
        few = np.s_[:, :, :_POINTS]
        return int((ranks(np.concatenate([known, more])[few]) - ranks(known[few])).max())

    def told(self) -> bool:
        """Whether gamma* and the healthy sensors tell what is wanted."""
        x = self.model.points(_POINTS, 47)
        n = len(self.model.states)
        with np.errstate(all='ignore'):
            own = np.einsum('Kq,KiN->qiN', self.gamma, self.dictionary.gradients(x[:n]))
            known = np.concatenate([own, self.model.h0.slopes(x[:n])[1]])
            more = Equations(list(self.model.wanted.values()), self.model.states).slopes(x[:n])[1]
        return bool((ranks(np.concatenate([known, more])) == ranks(known)).all())

    def component(self, chosen: Sequence[Function], targets: Sequence[Node],
                  apart: Twins | None = None) -> Function | None:
        """
        Return the simplest function of gamma* that is missing, or None.

        It is a function of the targets and what is known already, where there is such a one. With
        `apart` it has another value at these two states, new or not.
        """
        known = self.known(chosen)
        x = self.model.points(known.shape[2], 41)[:len(self.model.states)]
        K, d = kernels(np.concatenate([known, self.gradients(targets)]))
        inner = self.gamma if not d else constant_along(self.dictionary, self.gamma, x, K)
        for among in (inner, self.gamma):
            for f in self.simplest_first(among):
                if apart is not None:
                    if self._differs(f, apart):
                        return f
                elif self.missing(chosen, [f.node]):
                    return f
        return None

    def simplest_first(self, span: np.ndarray) -> list[Function]:
        """Return a basis of the functions of coefficients (K, q), confirmed."""
        basis = echelon(span / (np.abs(span).max(axis=0, initial=0.0) + 1e-300))
        costs = [(float(self.dictionary.costs[np.flatnonzero(c)].sum()), i)
                 for i, c in enumerate(basis.T)]
        result: list[Function] = []
        failed = 0
        for _, i in sorted(costs):
            f = named(self.model, self.dictionary, basis[:, i])
            if f is not None:
                result.append(f)
            elif (failed := failed + 1) == _FAILED and not result:
                break  # they passed by rounding only
        return result

    def _differs(self, f: Function, apart: Twins) -> bool:
        at = np.stack([apart.one, apart.other], axis=1)
        one, other = Equations([f.node], self.model.states).values(at)[0]
        return abs(one - other) > 1e-6 * max(abs(one), abs(other))


def closed(inside: Inside, chosen: Sequence[Function],
           targets: Sequence[Node]) -> list[Function] | None:
    """Return `chosen` and what more is needed to tell the targets and all their own changes."""
    result = list(chosen)
    waiting = [list(targets), *([next_of(inside.model, f.node)] for f in chosen)]
    while waiting:
        now = waiting.pop(0)
        while inside.missing(result, now):
            f = inside.component(result, now)
            if f is None or len(result) == MOST_STATES:
                return None
            result.append(f)
            waiting.append([next_of(inside.model, f.node)])
    return result
