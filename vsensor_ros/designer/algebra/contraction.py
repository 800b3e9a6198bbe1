"""
Whether the error of an observer z' = F(z, y, u) dies out: no part of the algebra.

Two solutions come nearer to each other in a constant metric P where He(P dF/dz) < 0 all over the
region. Eigenvalues of frozen Jacobians are no evidence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np

from vsensor_ros.designer.algebra.answer import CERTIFIED, Range, SAMPLED, TEMPORARY
from vsensor_ros.designer.algebra.derivative import derivative, NotSmooth
from vsensor_ros.designer.algebra.enclosure import Box, enclosed, upper_bound, used_in
from vsensor_ros.designer.algebra.invariant import evaluated
from vsensor_ros.designer.algebra.model import Model
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Node

_SOLVED_ON, _VERIFIED_ON = 60, 3000  # sampled points
_NEUTRAL = 1e-9  # of the size of dF/dz: an error that stays
_SPREADS = (1.0, 0.3, 0.1, 0.03, 0.01)
_RATES = (0.8, 0.5, 0.3, 0.1, 0.03, 0.01)


@dataclass(frozen=True, eq=False)
class Stability:
    """grade '': not stable, or not shown to be; `rate` < 0 is then its growth."""

    grade: str
    rate: float
    metric: np.ndarray  # (k, k)


@dataclass(frozen=True, eq=False)
class ErrorSystem:
    """F (k) of z over z, sensors and inputs, and what values these take."""

    model: Model
    names: tuple[str, ...]
    phi: tuple[Node, ...]   # over the states
    F: tuple[Node, ...]
    signs: tuple[tuple[Node, int], ...] = ()  # of expressions over the states: one branch only

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """Names of z, sensors and inputs."""
        return (*self.names, *self.model.sensors, *self.model.inputs)

    @cached_property
    def ranges(self) -> dict[str, Range]:
        """Ranges over the states' ranges: of z and sensors between all values at points."""
        known = self.points(4000, 61, 0.0)[0]
        low, high = known.min(axis=1), known.max(axis=1)
        result = {name: (float(a), float(b)) for name, a, b in zip(self.variables, low, high)}
        corners = dict(zip(self.model.states, self.model.declared))
        for name, node in (*zip(self.names, self.phi), *self.model.sensors.items()):
            a, b = enclosed(node, corners)
            inner = result[name]
            if math.isfinite(a + b) and b - a < 1.2 * (inner[1] - inner[0]):
                result[name] = (a, b)
        return {**result, **self.model.system.inputs}

    @cached_property
    def own_rate(self) -> float:
        """How fast the plant moves by itself: the median of its largest eigenvalue."""
        at = self.model.points(60, 107, declared=True)
        slopes = np.moveaxis(evaluated(self.model, at)[1][:, :len(self.model.states)], 2, 0)
        return float(np.median(np.abs(np.linalg.eigvals(slopes)).max(axis=1)))

    def points(self, count: int, seed: int, spread: float = 1.0,
               beyond: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """
        Return known quantities (v, N), z off by some of its range, and the states (n, N).

        beyond: how much of their ranges is added to both ends.
        """
        at = self.model.points(count, seed, True, beyond)
        n, m = len(self.model.states), len(self.model.inputs)
        with np.errstate(all='ignore'):
            for node, sign in self.signs:
                at = at[:, np.sign(Equations([node], self.model.states).values(at[:n])[0]) == sign]
            z = Equations(self.phi, self.model.states).values(at[:n])
            y = self.model.h0.values(at[:n])
        random = np.random.default_rng(seed + 1)
        other = z[:, random.permutation(z.shape[1])]
        z = z + spread * random.random(z.shape[1]) * (other - z)
        known = np.concatenate([z, y, at[n:n + m]])
        good = np.isfinite(known).all(axis=0)
        return known[:, good], at[:n, good]

    def jacobians(self, count: int, seed: int) -> np.ndarray:
        """Return dF/dz (N, k, k) at points."""
        known, _ = self.points(count, seed)
        with np.errstate(all='ignore'):
            slopes = Equations(self.F, self.variables).slopes(known)[1][:, :len(self.names)]
        return np.moveaxis(slopes, 2, 0)


def stability(error: ErrorSystem) -> Stability:
    """Return the grade, the rate at which an error shrinks at least, and the metric."""
    discrete = error.model.discrete
    A = error.jacobians(_VERIFIED_ON, 71)
    k = len(error.names)
    size = np.array([high - low or 1.0 for low, high in (error.ranges[n] for n in error.names)])
    best = Stability('', -math.inf, np.eye(k))
    for order in _orders(A):
        for spread in _SPREADS[:1 if k == 1 else None]:
            scale = spread ** np.array(order, dtype=float) / size
            P = np.diag((scale / scale.max()) ** 2)
            rate = slowest(A, P, discrete)
            if rate > best.rate * (1.05 if best.rate > 0.0 else 1.0):
                best = Stability('', rate, P)
    neutral = _NEUTRAL * max(1.0 if discrete else error.own_rate,
                             float(np.abs(A).max(initial=0.0)))
    if k > 1 and best.rate <= neutral and not _hopeless(A, discrete, neutral):
        best = max(best, _by_lmi(error, A, size), key=lambda own: own.rate)
    if best.rate > neutral:
        grade = SAMPLED
        if np.array_equal(best.metric, np.diag(np.diag(best.metric))):
            certain = _certified(error, np.sqrt(np.diag(best.metric)), 0.9 * best.rate)
            if certain > 0.0:
                return Stability(CERTIFIED, min(certain, best.rate), best.metric)
        return Stability(grade, best.rate, best.metric)
    return Stability(TEMPORARY if best.rate >= -neutral else '', best.rate, best.metric)


def slowest(A: np.ndarray, P: np.ndarray, discrete: bool) -> float:
    """Return the least rate at which an error shrinks in the metric P, dF/dz being A (N, k, k)."""
    if not len(A):
        return -math.inf
    T = np.linalg.cholesky(P).T
    own = T @ A @ np.linalg.inv(T)
    if not np.isfinite(own).all():
        return -math.inf
    if discrete:
        largest = float(np.linalg.norm(own, 2, axis=(1, 2)).max())
        return -math.log(largest) if largest > 0.0 else math.inf
    return -0.5 * float(np.linalg.eigvalsh(own + np.swapaxes(own, 1, 2))[:, -1].max())


def _hopeless(A: np.ndarray, discrete: bool, neutral: float) -> bool:
    """Tell whether dF/dz at one of the points has a mode that does not die out there."""
    modes = np.linalg.eigvals(A)
    return bool(((np.abs(modes) >= 1.0 - neutral) if discrete
                 else (modes.real >= -neutral)).any())


def _orders(A: np.ndarray) -> list[list[int]]:
    """Return how deep each component stands in a cascade, both ways; one way where it is none."""
    k = A.shape[1]
    feeds = (np.abs(A).max(axis=0) > 0.0) & ~np.eye(k, dtype=bool)  # [i, j]: j feeds i
    depth = [0] * k
    for _ in range(k):
        depth = [max((depth[j] + 1 for j in range(k) if feeds[i, j]), default=0)
                 for i in range(k)]
    return [depth] if max(depth) < k else [[0] * k]


def _by_lmi(error: ErrorSystem, A: np.ndarray, size: np.ndarray) -> Stability:
    """Look for a metric at some points, and see what it is worth at new ones."""
    import cvxpy as cp
    discrete, k = error.model.discrete, len(error.names)
    S = np.diag(size)
    scaled = np.linalg.inv(S) @ A @ S
    typical = float(np.median(np.abs(np.linalg.eigvals(scaled)).max(axis=1)))
    tried = scaled[:_SOLVED_ON]
    best = Stability('', -math.inf, np.eye(k))
    for share in (0.0, *reversed(_RATES)):
        P = cp.Variable((k, k), symmetric=True)
        constraints = [P >> np.eye(k), P << 1e4 * np.eye(k)]
        slack = cp.Variable()
        for a in tried:
            if discrete:
                constraints.append(cp.bmat([[(1.0 - share) * P, a.T @ P],
                                            [P @ a, (1.0 - share) * P]]) + slack * np.eye(
                                                2 * k) >> 0)
            else:
                constraints.append(a.T @ P + P @ a + 2.0 * share * typical * P
                                   << slack * np.eye(k))
        problem = cp.Problem(cp.Minimize(slack), [*constraints, slack >= -1.0])
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            break
        if P.value is None:
            break
        metric = np.linalg.inv(S) @ P.value @ np.linalg.inv(S)
        metric = metric / np.abs(metric).max()
        rate = slowest(A, 0.5 * (metric + metric.T), discrete)
        if rate <= best.rate:
            break
        best = Stability('', rate, 0.5 * (metric + metric.T))
    return best


def _certified(error: ErrorSystem, scale: np.ndarray, hoped: float) -> float:
    """Return a rate proved by intervals, 0 or less without a proof; metric diag(scale**2)."""
    k = len(error.names)
    try:
        J = [[derivative(F, name) for name in error.names] for F in error.F]
    except NotSmooth:
        return 0.0
    box: Mapping[str, Range] = error.ranges
    discrete = error.model.discrete

    def row(i: int, own: Box) -> float:
        """Bound the growth in a row, after Gershgorin; discrete: the norm of the scaled row."""
        worst = 0.0
        for j in range(k):
            low, high = enclosed(J[i][j], own)
            up, down = scale[i] / scale[j], 1.0
            if discrete:
                worst += max(-low, high) * up
            elif i == j:
                worst += high
            else:
                other = enclosed(J[j][i], own)
                worst += 0.5 * (max(-low, high) * up + max(-other[0], other[1]) / up * down)
        return worst
    if discrete and k > 1:
        return 0.0  # the sum of a row bounds another norm than that of the metric
    bounds = []
    for i in range(k):
        used = used_in(*J[i], *(J[j][i] for j in range(k)))
        bounds.append(upper_bound(lambda own, i=i: row(i, own), box, used,  # type: ignore[misc]
                                  math.exp(-hoped) if discrete else -hoped))
    if discrete:
        return -math.log(bounds[0]) if bounds[0] > 0.0 else hoped
    return -max(bounds)
