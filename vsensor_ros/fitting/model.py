"""
A plant that is run for a fit: one step of many windows at once, with exact derivatives.

The state of a run is that of the plant and, behind it, each unknown input, which stays what it is.
Continuous equations take the Runge-Kutta step of fourth order with commands held, and each stage
is differentiated by the chain rule with the slopes of the equations.

Dry friction, a `sign(w)` in an equation, is implicit: in each step it has the one value between
-1 and 1 with which w ends at 0, or its end where none does (Moreau's time stepping). So an axis
that stops stays stopped, nothing chatters, and a step is continuous in states and parameters. It
is differentiated as it is computed: at rest the friction is what holds, and moves with the rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Apply, Name, names, Node
from vsensor_ros.plant.free import FreePlant


class Moved(NamedTuple):
    """A value (E, W) for W windows, and its derivatives (W, E, N + P) by start and parameters."""

    value: np.ndarray
    slopes: np.ndarray


class Model:
    """
    N states (unknown inputs are the last), m inputs, P free parameters, l sensors.

    An unknown input whose `process_noise` is 0 is taken for 0 all the time.
    """

    def __init__(self, given: FreePlant) -> None:
        """Prepare the equations; what is known of the plant stays in `given`."""
        plant = given.plant
        self.given, self.period = given, plant.sample_time
        self.parameters = tuple(free.name for free in given.free)
        noisy = zip(plant.disturbances, plant.disturbance_noise)
        self.unknown = tuple(name for name, noise in noisy if noise != 0.0)
        quiet = tuple(name for name in plant.disturbances if name not in self.unknown)
        self.states = (*given.states, *self.unknown)
        self.sensors, self.inputs = plant.sensors, plant.inputs
        signs: dict[Node, Name] = {}
        dynamics = [_without_signs(node, signs) for node in given.dynamics] \
            if self.period is None else list(given.dynamics)
        self._signs = tuple(name.id for name in signs.values())
        known = (*self.states, *self.inputs, *self._signs, *self.parameters, *quiet)
        self._dynamics = Equations(dynamics, known)
        self._rubbing = Equations([_inside(node) for node in signs], known)
        self._outputs = Equations(given.measures, known)
        self._quiet = len(quiet)
        self.linear = not plant.terms and not any(c.text for c in plant.curves.values())

    @property
    def size(self) -> int:
        """N: how many states there are, with unknown inputs."""
        return len(self.states)

    def offsets(self) -> np.ndarray:
        """Tell which states (N,) only drift: nothing acts on them but what they are."""
        given = self.given
        alone = [set(names(node)) <= {state} and Name(state) not in given.measures
                 for state, node in zip(given.states, given.dynamics)]
        return np.array([*alone, *[False] * len(self.unknown)])

    def told(self) -> np.ndarray:
        """
        Tell of which states (N,) the file's process noise stays, where it has any.

        Windows are too short to tell how an offset drifts. And what only adds up another state, as
        a position does with a speed, is not driven by noise: what is off there is the sensor's.
        """
        given = self.given
        noise = given.plant.process_noise[:len(given.states)]
        sums = [self.period is None and isinstance(node, Name) and node.id in given.states
                and node.id != state for state, node in zip(given.states, given.dynamics)]
        unknown = [False] * len(self.unknown)
        given_one = np.array([*(noise > 0.0), *unknown])
        return (self.offsets() | np.array([*sums, *unknown])) & given_one

    # parameters are given as (P,), or (P, W) where windows have their own

    def outputs(self, x: Moved, u: np.ndarray, theta: np.ndarray) -> Moved:
        """Return what the sensors show (l, W) in states (N, W) under commands (m, W)."""
        return self._along(self._outputs, x, self._point(x.value, u, theta))

    def step(self, x: Moved, u: np.ndarray, theta: np.ndarray, h: float) -> Moved:
        """Return the states `h` [s] later."""
        if self.period is not None:
            return self._rates(x, u, theta, None)
        rubbing = self._friction(x, u, theta, h) if self._signs else None
        k1 = self._rates(x, u, theta, rubbing)
        k2 = self._rates(_ahead(x, k1, h / 2), u, theta, rubbing)
        k3 = self._rates(_ahead(x, k2, h / 2), u, theta, rubbing)
        k4 = self._rates(_ahead(x, k3, h), u, theta, rubbing)
        return Moved(*(a + h / 6 * (b + 2 * c + 2 * d + e)
                       for a, b, c, d, e in zip(x, k1, k2, k3, k4)))

    def start(self, x: np.ndarray) -> Moved:
        """Return states (N, W) whose derivatives by themselves are 1."""
        slopes = np.zeros((x.shape[1], self.size, self.size + len(self.parameters)))
        slopes[:, np.arange(self.size), np.arange(self.size)] = 1.0
        return Moved(x, slopes)

    def _point(self, x: np.ndarray, u: np.ndarray, theta: np.ndarray,
               rubbing: np.ndarray | None = None) -> np.ndarray:
        n, m, signs, count = x.shape[0], len(u), len(self._signs), len(self.parameters)
        at = np.zeros((n + m + signs + count + self._quiet, x.shape[1]))
        at[:n], at[n:n + m] = x, u
        if rubbing is not None:
            at[n + m:n + m + signs] = rubbing
        at[n + m + signs:n + m + signs + count] = theta.reshape(count, -1)
        return at

    def _along(self, equations: Equations, x: Moved, at: np.ndarray,
               rubbing: Moved | None = None) -> Moved:
        """Return equations at a point that moves as x does, and with the parameters."""
        n, signs, count = self.size, len(self._signs), len(self.parameters)
        value, slopes = equations.slopes(at)
        slopes = slopes.transpose(2, 0, 1)
        moved = slopes[:, :, :n] @ x.slopes
        first = n + len(self.inputs)
        if rubbing is not None:
            moved += slopes[:, :, first:first + signs] @ rubbing.slopes
        moved[:, :, n:] += slopes[:, :, first + signs:first + signs + count]
        return Moved(value, moved)

    def _rates(self, x: Moved, u: np.ndarray, theta: np.ndarray, rubbing: Moved | None) -> Moved:
        """Return the right-hand side (N, W): 0 for unknown inputs, or with a sample time them."""
        at = self._point(x.value, u, theta, None if rubbing is None else rubbing.value)
        found = self._along(self._dynamics, x, at, rubbing)
        known = len(self.given.states)
        if known == self.size:
            return found
        value, slopes = np.zeros_like(x.value), np.zeros_like(x.slopes)
        if self.period is not None:
            value, slopes = x.value.copy(), x.slopes.copy()
        value[:known], slopes[:, :known] = found
        return Moved(value, slopes)

    def _friction(self, x: Moved, u: np.ndarray, theta: np.ndarray, h: float) -> Moved:
        """Return the values of the signs (S, W) in this step."""
        wide = x.value.shape[1]
        now = self._rubbing.values(self._point(x.value, u, theta))
        taken = Moved(np.sign(now), np.zeros((wide, len(now), x.slopes.shape[2])))
        both = Moved(*(np.concatenate([part] * 2, axis=axis) for part, axis in zip(x, (1, 0))))
        u, theta = np.tile(u, 2), theta if theta.ndim == 1 else np.tile(theta, 2)
        for i in range(len(self._signs)):
            tried = Moved(*(np.concatenate([part] * 2, axis=axis)
                            for part, axis in zip(taken, (1, 0))))
            tried.value[i], tried.slopes[:, i] = np.repeat([0.0, 1.0], wide), 0.0
            later = _ahead(both, self._rates(both, u, theta, tried), h)
            w = self._along(self._rubbing, later, self._point(later.value, u, theta))
            ends = [Moved(w.value[i, part], w.slopes[part, i])
                    for part in (slice(wide), slice(wide, None))]
            free, push = ends[0], Moved(*(b - a for a, b in zip(*ends)))
            brakes = push.value < 0.0
            slower = np.where(brakes, push.value, -1.0)
            held = -free.value / slower
            slope = -(free.slopes + held[:, None] * push.slopes) / slower[:, None]
            rests = brakes & (np.abs(held) < 1.0)
            taken.value[i] = np.where(brakes, np.clip(held, -1.0, 1.0), np.sign(now[i]))
            taken.slopes[:, i] = np.where(rests[:, None], slope, 0.0)
        return taken


def _ahead(x: Moved, rate: Moved, h: float) -> Moved:
    return Moved(x.value + h * rate.value, x.slopes + h * rate.slopes)


def _without_signs(node: Node, signs: dict[Node, Name]) -> Node:
    """Return an equation with a name for each sign in it, which is added to `signs`."""
    if not isinstance(node, Apply):
        return node
    node = Apply(node.function, tuple(_without_signs(a, signs) for a in node.arguments),
                 node.called)
    if node.function != 'sign':
        return node
    return signs.setdefault(node, Name(f'sign {len(signs)}'))


def _inside(node: Node) -> Node:
    assert isinstance(node, Apply)
    return node.arguments[0]

