"""
Functions of what is measured, taken off z so that its error dies out.

With z - K w(y0) for z, the same is known, and dF/dz becomes dF/dz - K dW/dz, where W(z, y, u) is
the change of w. The method, 3.6, does so with linear w.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linprog

from vsensor_ros.designer.algebra.answer import CERTIFIED, SAMPLED
from vsensor_ros.designer.algebra.candidate import (
    Candidate,
    completed,
    exact_of,
    known_inputs,
    known_of,
)
from vsensor_ros.designer.algebra.coefficients import Function, next_of
from vsensor_ros.designer.algebra.contraction import ErrorSystem, stability
from vsensor_ros.designer.algebra.derivative import minus, total
from vsensor_ros.designer.algebra.dictionary import scaled
from vsensor_ros.designer.algebra.fit import fitted, plant_atoms
from vsensor_ros.designer.algebra.invariant import constant_along
from vsensor_ros.designer.algebra.null_space import kernels
from vsensor_ros.designer.algebra.reduction import Inside
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import names, Node

_MOST = 4
_LEVELS = ((1, False), (2, False), (2, True), (3, False))  # of what they change by
_FASTER = 1.2  # than the plant itself moves
_SAMPLES = 400
_FEWEST, _FEW = 8, 40  # of them, in matrix inequalities: to see that there is nothing, and all
_WORTH = 0.01   # of how fast the plant moves: slower is not worth it
_BEYOND = 0.5  # of a range
_LARGEST = 10.0  # gain: how often the size of z over that of w


def with_measured(inside: Inside, candidate: Candidate, error: ErrorSystem) -> Candidate | None:
    """Return the candidate with functions of measured quantities taken off, if it converges so."""
    model = inside.model
    known = known_of(model, candidate.names, candidate.functions)
    exact = exact_of(candidate.functions)
    own = [*known, *known_inputs(model)]
    measured, sides = [], []
    for w in _measured_functions(inside):
        side = fitted(model, next_of(model, w.node), [*own, *plant_atoms(model, own)], exact,
                      _LEVELS)
        if side is not None and set(names(side.node)) & set(candidate.names):
            measured.append(w)
            sides.append(side.node)
        if len(measured) == _MOST:
            break
    if not measured:
        return None
    K = _gain(error, measured, sides)
    if K is None or not _helps(error, sides, K):
        return None
    functions = [_taken_off(f, row, measured) for f, row in zip(candidate.functions, K)]
    found = completed(model, functions, None)
    return found if isinstance(found, Candidate) else None


def _helps(error: ErrorSystem, sides: Sequence[Node], K: np.ndarray) -> bool:
    """Tell whether the error dies out where K was not looked for, too: dF/dz - K dW/dz tells."""
    off = [total([scaled(float(own), side) for own, side in zip(row, sides) if own]) for row in K]
    F = tuple(map(minus, error.F, off))
    return stability(replace(error, F=F)).grade in (CERTIFIED, SAMPLED)


def _measured_functions(inside: Inside) -> list[Function]:
    """Return functions of gamma* that the healthy sensors tell alone, the simplest first."""
    model = inside.model
    if not model.sensors:
        return []
    x = model.points(len(inside.dictionary) + 20, 101)[:len(model.states)]
    with np.errstate(all='ignore'):
        K, d = kernels(model.h0.slopes(x)[1])
    span = constant_along(inside.dictionary, inside.gamma, x, K) if d else inside.gamma
    return [f for f in inside.simplest_first(span) if names(f.node)]


def _gain(error: ErrorSystem, measured: Sequence[Function],
         sides: Sequence[Node]) -> np.ndarray | None:
    """
    Return K (k, w) with which the error contracts at sampled points, as small as may be; or None.

    sides: the changes W (w,) of the measured functions, over z, sensors and inputs.
    """
    # well beyond the ranges too: what helps within them must not turn against one at their ends
    known, states = error.points(_SAMPLES, 103, beyond=_BEYOND)
    with np.errstate(all='ignore'):
        A, C = (np.moveaxis(Equations(nodes, error.variables).slopes(known)[1]
                            [:, :len(error.names)], 2, 0) for nodes in (error.F, sides))
        w = Equations(error.phi, error.model.states).values(states)
    typical = _FASTER * error.own_rate
    own = Equations([f.node for f in measured], error.model.states).values(states)
    size, sizes = np.ptp(w, axis=1), np.ptp(own, axis=1)
    if len(error.names) == 1:
        for i, spread in enumerate(sizes):
            K = _smallest(A[:, 0, 0], C[:, [i], 0], error.model.discrete, typical,
                          _LARGEST * size[0] / spread)
            if K is not None:
                result = np.zeros((1, len(sides)))
                result[0, i] = K[0]
                return _rounded(result)
        return None
    found = _by_lmi(A, C, size, error.model.discrete, typical)
    small = found is not None and (np.abs(found) * sizes <= _LARGEST * size[:, None]).all()
    return found if small else None


def _taken_off(f: Function, K: np.ndarray, measured: Sequence[Function]) -> Function:
    """Return f - K w."""
    off = total([scaled(float(own), w.node) for own, w in zip(K, measured) if own])
    more = {x: ball for w in (f, *measured) for x, ball in w.exact.items()}
    return Function(minus(f.node, off), more, f.cost)


def _smallest(A: np.ndarray, C: np.ndarray, discrete: bool, typical: float,
              largest: float) -> np.ndarray | None:
    """Return the smallest K (w,) with A - C K <= -rate at all points, or of size < 1 a step."""
    w = C.shape[1]
    sides = [(1.0, A)] if not discrete else [(1.0, A), (-1.0, -A)]
    rows = np.concatenate([np.hstack([-s * C, s * C]) for s, _ in sides])
    right = np.concatenate([own for _, own in sides])
    # the best there is, within a limit of the gain
    best = linprog([*np.zeros(2 * w), 1.0], A_ub=np.hstack([rows, -np.ones((len(rows), 1))]),
                   b_ub=-right, bounds=[*[(0.0, largest)] * (2 * w), (None, None)])
    goal = 1.0 if discrete else 0.0
    if best.status != 0 or best.x[-1] >= goal - _WORTH * (1.0 if discrete else typical):
        return None
    limit = 0.5 * (1.0 + max(best.x[-1], 0.0)) if discrete else max(-typical, 0.8 * best.x[-1])
    found = linprog(np.ones(2 * w), A_ub=rows, b_ub=limit - right, bounds=[(0.0, largest)] * 2 * w)
    return found.x[:w] - found.x[w:] if found.status == 0 else None


def _by_lmi(A: np.ndarray, C: np.ndarray, size: np.ndarray, discrete: bool,
            typical: float) -> np.ndarray | None:
    """Return K (k, w) from linear matrix inequalities at sampled points."""
    import cvxpy as cp
    if discrete:
        return None
    k, w = A.shape[1], C.shape[1]
    S = np.diag(size)
    scaled_A, scaled_C = np.linalg.inv(S) @ A @ S, C @ S
    unit = np.abs(scaled_C).max(axis=(0, 2))
    scaled_C = scaled_C / unit[:, None]
    P, Y = cp.Variable((k, k), symmetric=True), cp.Variable((k, w))
    rate = cp.Parameter(nonneg=True)
    best = None
    for few, shares in ((_FEWEST, (0.03,)), (_FEW, (0.03, 0.3, 1.0))):
        constraints = [P >> np.eye(k), P << 100.0 * np.eye(k)]
        for a, c in zip(scaled_A[:few], scaled_C[:few]):
            own = P @ a - Y @ c
            constraints.append(own + own.T + 2.0 * rate * P << 0)
        problem = cp.Problem(cp.Minimize(cp.norm(Y, 'fro')), constraints)
        for share in shares:
            rate.value = share * typical
            try:
                problem.solve(solver=cp.CLARABEL)
            except cp.SolverError:
                return best
            if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
                return best
            best = _rounded(S @ np.linalg.solve(P.value, Y.value) / unit)
    return best


def _rounded(K: np.ndarray) -> np.ndarray:
    largest = np.abs(K).max()
    return np.array([[float(f'{x:.2g}') if abs(x) > 1e-3 * largest else 0.0 for x in row]
                     for row in K])


