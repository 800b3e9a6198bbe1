"""
A proof that nothing exists: the directions that any decoupled function must be blind to.

D_0 is what the unknown inputs push, D_(i+1) the involutive closure of D_i + [f_u, K_i], where K_i
is what of D_i no healthy sensor feels. A function z = phi(x) with z' = F(z, y, u) is constant
along all of D, so where some of K moves what is wanted there is none. Needs no dictionary; continuous
time and smooth plants only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np

from vsensor_ros.designer.algebra.derivative import derivative, NotSmooth
from vsensor_ros.designer.algebra.digits import flint, precise
from vsensor_ros.designer.algebra.invariant import evaluated
from vsensor_ros.designer.algebra.jets import Jet, Jets
from vsensor_ros.designer.algebra.model import Model
from vsensor_ros.designer.algebra.null_space import ranks
from vsensor_ros.functions.expression import Node

MOST = 1000      # coefficients of a series
_ZERO = 1e-30    # of the largest: below it a ball is 0
_COMMANDS = 3    # values of the inputs for which f is taken


class Unclear(ValueError):
    """The point was not generic, or a series too short."""


@dataclass(frozen=True, eq=False)
class Field:
    """A vector field as n series, and up to which order these are right."""

    parts: list[Jet]
    order: int


@dataclass(frozen=True, eq=False)
class Span:
    """Vector fields that are independent at the point, and their values there, eliminated."""

    fields: list[Field] = field(default_factory=list)
    rows: list[list[Any]] = field(default_factory=list)

    def add(self, own: Field) -> bool:
        """Take a field in, if it is independent of the others there; tell whether it was."""
        row = [part[0] for part in own.parts]
        size = max(abs(float(x)) for x in row)
        for known in self.rows:
            lead = next(i for i, x in enumerate(known) if _clear(x, 1.0))
            factor = row[lead] / known[lead]
            row = [a - factor * b for a, b in zip(row, known)]
            row[lead] = flint().arb(0)
        if size == 0.0 or not any(_clear(x, size) for x in row):
            return False
        largest = max(row, key=lambda x: abs(float(x)))
        lead = row.index(largest)
        # the lead comes first among what is clear, so that elimination finds it
        self.rows.append([x / largest if i == lead or _clear(x, size) else flint().arb(0)
                          for i, x in enumerate(row)])
        self.fields.append(own)
        return True


@dataclass(frozen=True)
class Forced:
    """How many directions are forced, and whether what is wanted moves along one unfelt."""

    dimension: int
    blocks: bool


def forced(model: Model, targets: Sequence[Node]) -> Forced | None:
    """Return what is forced near a random point, or None where that could not be told."""
    n = len(model.states)
    if model.discrete or not model.unknown or not model.smooth:
        return None
    with precise():
        for order in range(2, n - _pushed(model) + 2):
            if math.comb(n + order, n) > MOST:
                return None
            try:
                return _forced(model, targets, n, order)
            except Unclear:
                continue
            except NotSmooth:
                return None
    return None


def _forced(model: Model, targets: Sequence[Node], n: int, order: int) -> Forced:
    at = model.points(_COMMANDS + 1, 201)
    pushes = [[derivative(f, name) for f in model.f] for name in model.unknown]
    jets = Jets(n, order)
    x = [jets.variable(i, flint().arb(float(at[i, 0]))) for i in range(n)]

    def at_commands(nodes: Sequence[Node], c: int) -> Field:
        more = {name: jets.constant(flint().arb(float(at[n + j, c])))
                for j, name in enumerate(model.variables[n:])}
        return Field([jets.value(node, {**dict(zip(model.states, x)), **more})
                      for node in nodes], order)

    span = Span()
    for c in range(_COMMANDS):
        for push in pushes:
            span.add(at_commands(push, c))
    drifts = [at_commands(model.f, c) for c in range(_COMMANDS)]
    readings = [[at_commands([derivative(node, state)], 0).parts[0] for state in model.states]
                for node in model.sensors.values()]
    _involutive(jets, span)
    while len(span.fields) < n:
        before = len(span.fields)
        for unfelt in _kernel(jets, span, readings):
            for drift in drifts:
                span.add(_bracket(jets, drift, unfelt))
        _involutive(jets, span)
        if len(span.fields) == before:
            break
    blocks = False
    for node in targets:
        slopes = [at_commands([derivative(node, state)], 0).parts[0] for state in model.states]
        for unfelt in _kernel(jets, span, readings):
            moved = sum(p[0] * s[0] for p, s in zip(unfelt.parts, slopes))
            size = max(abs(float(p[0] * s[0])) for p, s in zip(unfelt.parts, slopes))
            blocks = blocks or (size > 0.0 and _clear(moved, size))
    return Forced(len(span.fields), blocks)


def _pushed(model: Model) -> int:
    """Return in how many directions the unknown inputs push at once."""
    n, s = len(model.states), len(model.unknown)
    at = model.points(_COMMANDS, 201)
    at[:n] = at[:n, :1]
    slopes = evaluated(model, at)[1][:, -s:]
    return int(ranks(slopes.transpose(1, 2, 0).reshape(-1, n, 1))[0])


def _involutive(jets: Jets, span: Span) -> None:
    i = 1
    while i < len(span.fields) < jets.n:
        for j in range(i):
            span.add(_bracket(jets, span.fields[j], span.fields[i]))
        i += 1


def _bracket(jets: Jets, f: Field, g: Field) -> Field:
    order = min(f.order, g.order) - 1
    if order < 0:
        raise Unclear
    parts = []
    for a, b in zip(f.parts, g.parts):
        own = jets.constant(flint().arb(0))
        for j in range(jets.n):
            own = own + jets.times(f.parts[j], jets.slope(b, j)) \
                - jets.times(g.parts[j], jets.slope(a, j))
        parts.append(own)
    return Field(parts, order)


def _kernel(jets: Jets, span: Span, readings: Sequence[Sequence[Jet]]) -> list[Field]:
    """Return fields of the span that no healthy sensor feels."""
    left = list(span.fields)
    for slopes in readings:
        felt: list[Jet] = [np.sum([jets.times(p, s) for p, s in zip(own.parts, slopes)], axis=0)
                           for own in left]
        if not left:
            break
        sizes = [max(abs(float(p[0])) for p in own.parts) * max(abs(float(s[0])) for s in slopes)
                 for own in left]
        best = max(range(len(left)), key=lambda i: abs(float(felt[i][0])) / (sizes[i] or 1.0))
        if not _clear(felt[best][0], sizes[best]):
            for own, w, size in zip(left, felt, sizes):
                known = [w[k] for k, e in enumerate(jets.exponents) if sum(e) <= own.order]
                if own.order < 1 or any(_clear(c, size or 1.0) for c in known):
                    raise Unclear  # it may be felt near the point, and not at it
            continue
        over = jets.inverse(felt[best])
        pivot = left[best]
        rest = []
        for i, own in enumerate(left):
            if i != best:
                factor = jets.times(felt[i], over)
                rest.append(Field([p - jets.times(factor, q)
                                   for p, q in zip(own.parts, pivot.parts)],
                                  min(own.order, pivot.order)))
        left = rest
    return left


def _clear(x: Any, size: float) -> bool:
    return abs(float(abs(x).lower())) > _ZERO * size


def closure_of_kernels(names: Sequence[str], a: Sequence[Node], b: Sequence[Node],
                       at: np.ndarray) -> int | None:
    """
    Return how many functions are constant along ker da and ker db, near a point (n,).

    None where that could not be told there.
    """
    n = len(names)
    order = n
    if math.comb(n + order, n) > MOST:
        return None
    try:
        with precise():
            jets = Jets(n, order)
            x = {name: jets.variable(i, flint().arb(float(own)))
                 for i, (name, own) in enumerate(zip(names, at))}
            whole = Span()
            for i in range(n):
                parts = [jets.constant(flint().arb(int(i == j))) for j in range(n)]
                whole.add(Field(parts, order))
            span = Span()
            for nodes in (a, b):
                slopes = [[jets.value(derivative(node, name), x) for name in names]
                          for node in nodes]
                for own in _kernel(jets, whole, slopes):
                    span.add(own)
            _involutive(jets, span)
            return n - len(span.fields)
    except (NotSmooth, Unclear):
        return None
