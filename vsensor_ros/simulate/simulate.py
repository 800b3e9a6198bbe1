"""Truth: a plant that runs. Nothing here is shared with the observers it judges."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from vsensor_ros.functions.nonlinearity import compile_term, set_valued
from vsensor_ros.plant import Plant

Array = NDArray[np.float64]
Held = Callable[[int, float], Array]
Signal = ArrayLike | Callable[[float], ArrayLike] | None

# A switching surface counts as reached when passed by this much [unit of G x], so that a motion
# that starts on the surface does not end there at once.
TOUCH = 1e-11


def simulate(plant: Plant, t: ArrayLike, inputs: Signal = None, disturbances: Signal = None,
             x0: ArrayLike | None = None) -> Array:
    """
    Return the true states at the times `t` [s] (T,), shape (T, n).

    `inputs` (T, m) and `disturbances` (T, d) of `plant.unknown_inputs` are held from t[k] to
    t[k + 1], as an actuator holds a command; a function of time is followed as it is; None is
    zero. `x0` defaults to `plant.initial`. Continuous plants are integrated to 1e-10 with each
    sliding or crossing of a `sign(w1)` term located as an event (Filippov's solution: a stopped
    axis stays stopped); discrete ones are iterated, and `t` must then step by the sample time. An
    input with a dead time acts so much later; before the first it is as the first.
    """
    t = np.asarray(t, float)
    x = np.array(plant.initial if x0 is None else x0, float)
    u, u_jumps = _signal(_later(inputs, t, plant.input_delay), t, plant.B.shape[1], 'inputs')
    rho, rho_jumps = _signal(disturbances, t, len(plant.unknown_inputs), 'disturbances')
    if plant.sample_time is None:
        return _flow(plant, t, u, rho, x, np.union1d(u_jumps, rho_jumps))
    if not np.allclose(np.diff(t), plant.sample_time, rtol=1e-6):
        raise ValueError(f't must step by the sample time of {plant.name}, {plant.sample_time} s')
    states = [x]
    for k in range(len(t) - 1):
        states.append(plant.rate_of_change(states[-1], u(k, t[k]), rho(k, t[k])))
    return np.array(states)


def readings(plant: Plant, t: ArrayLike, x: ArrayLike, inputs: Signal = None,
             disturbances: Signal = None) -> Array:
    """
    Return what the sensors say without noise, shape (T, l): C x + Cu u + Cd rho by their curves.

    t (T,), `inputs` and `disturbances` as given to `simulate`, x (T, n) as it returned. A sensor
    that reads a command directly sees at t[k] the one that begins there. One with a dead time
    says what was so long ago; before the first it is as the first.
    """
    t, x = np.asarray(t, float), np.asarray(x, float)
    u, _ = _signal(_later(inputs, t, plant.input_delay), t, plant.B.shape[1], 'inputs')
    rho, _ = _signal(disturbances, t, len(plant.unknown_inputs), 'disturbances')
    y = np.array([plant.C @ x[k] + plant.Cu @ u(k, t[k])
                  + plant.Cd @ plant.acting(x[k], u(k, t[k]), rho(k, t[k]))
                  for k in range(len(t))])
    for i, name in enumerate(plant.sensors):
        if name in plant.curves:
            curve = plant.curves[name]
            beside = np.array([curve.beside.get(command, 0.0) for command in plant.inputs])
            y[:, i] = [curve.shown(float(y[k, i]), float(beside @ u(k, t[k])))
                       for k in range(len(t))]
        if plant.sensor_delay[i]:
            y[:, i] = np.interp(t - plant.sensor_delay[i], t, y[:, i])
    return y


def _later(signal: Signal, t: Array, delay: Array) -> Signal:
    """Return a signal of which each column comes later by its dead time [s]."""
    if signal is None or not delay.any():
        return signal

    def delayed(time: float) -> Array:
        if callable(signal):
            return np.array([np.atleast_1d(np.asarray(signal(max(time - d, t[0])), float))[i]
                             for i, d in enumerate(delay)])
        given = np.asarray(signal, float)
        # a jump that falls on an instant of the grid, but for rounding, is there
        rows = np.searchsorted(t, time - delay + 1e-9 * (t[-1] - t[0]), side='right') - 1
        return given[np.maximum(rows, 0), np.arange(given.shape[1])]
    return delayed if callable(signal) or not _on_grid(t, delay) else \
        np.array([delayed(time) for time in t])


def _on_grid(t: Array, delay: Array) -> bool:
    """Tell whether each dead time is a whole number of the grid's steps."""
    step = t[1] - t[0] if len(t) > 1 else 1.0
    return bool(np.allclose(np.diff(t), step, 1e-6)
                and np.allclose(delay / step, np.rint(delay / step), 0.0, 1e-6))


def _signal(signal: Signal, t: Array, width: int, what: str,
            ) -> tuple[Held, NDArray[np.intp]]:
    """Return the signal as a function of the row being held and of time, and where it jumps."""
    if callable(signal):
        return lambda _, time: np.atleast_1d(np.asarray(signal(time), float)), np.empty(0, np.intp)
    held = np.zeros((len(t), width)) if signal is None else np.asarray(signal, float)
    if held.shape != (len(t), width):
        raise ValueError(f'{what} must have shape {(len(t), width)}, not {held.shape}')
    return lambda row, _: held[row], 1 + np.flatnonzero(np.any(np.diff(held, axis=0), axis=1))


def _flow(plant: Plant, t: Array, u: Held, rho: Held, x: Array,
          jumps: NDArray[np.intp]) -> Array:
    motion = _Motion(plant)
    states = [x[None, :]]
    ends = np.unique([0, *jumps, len(t) - 1])
    for start, end in pairwise(ends):
        states.append(motion.run(t[start:end + 1], states[-1][-1],
                                 partial(u, start), partial(rho, start)))
    return np.concatenate(states)


class _Motion:
    """
    The continuous plant, with a mode for each sign(w) term: +1, -1, or 0 while w rests at zero.

    At rest the term takes whatever value in [-1, 1] keeps w' = 0; rest ends when it would have to
    leave that interval.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.signs = [i for i, term in enumerate(plant.terms) if set_valued(term)]
        self.smooth = [(i, compile_term(term, plant.inputs)) for i, term in enumerate(plant.terms)
                       if i not in self.signs]
        n = plant.A.shape[0]
        self.rows = np.array([plant.G[i][0] for i in self.signs]).reshape(-1, n)    # w = rows @ x
        self.push = plant.P[:, self.signs]
        if plant.unwritten and self.signs:
            raise ValueError(f'{plant.name}: a sign stands beside equations that are too large '
                             'to be terms; write friction with tanh')
        for i in self.signs:
            if np.any(plant.terms[i].slope):
                raise ValueError(f'{plant.terms[i].name}: a sign term has no slope')

    def free(self, x: Array, u: Array, rho: Array) -> Array:
        """Return x' without the sign terms."""
        plant = self.plant
        if plant.unwritten:
            return plant.rate_of_change(x, u, rho)
        rate = plant.A @ x + plant.B @ u + plant.D @ plant.acting(x, u, rho)
        for i, value in self.smooth:
            w = plant.G[i] @ x
            rate = rate + plant.P[:, i] * (value(w, u) - plant.terms[i].slope @ w)
        return rate

    def hold(self, free: Array, mode: Array, rest: Array) -> Array:
        """Return the values of the sign terms: their mode, or at rest what keeps w' = 0."""
        s = mode.copy()
        if rest.any():
            rows = self.rows[rest]
            s[rest] = np.linalg.solve(rows @ self.push[:, rest],
                                      -rows @ (free + self.push @ np.where(rest, 0.0, mode)))
        return s

    def settle(self, x: Array, mode: Array, free: Array) -> tuple[Array, Array]:
        """Return x put exactly on the surfaces that it touches, and the mode of every term."""
        w = self.rows @ x
        touching = np.abs(w) <= 10 * TOUCH
        mode = np.where(touching, mode, np.sign(w))
        for i in np.flatnonzero(touching):
            row = self.rows[i]
            x = x - row * (row @ x) / (row @ row)
            rest = mode == 0
            rest[i] = False
            mode[i] = 0.0
            drift = row @ (free + self.push @ self.hold(free, mode, rest))
            mode[i] = 1.0
            pull = row @ (free + self.push @ self.hold(free, mode, rest)) - drift
            mode[i] = 0.0 if pull < 0 and abs(drift) <= -pull else np.sign(drift) or 1.0
        return x, mode

    def run(self, t: Array, x: Array, u: Callable[[float], Array],
            rho: Callable[[float], Array]) -> Array:
        """Return the states at t[1:] from x at t[0]."""
        def rate(time: float, x: Array, mode: Array) -> Array:
            free = self.free(x, u(time), rho(time))
            return free + self.push @ self.hold(free, mode, mode == 0) if self.signs else free

        def event(i: int, mode: Array) -> Any:
            def margin(time: float, x: Array, *_: Any) -> float:
                if mode[i]:
                    return float(mode[i] * (self.rows[i] @ x)) + TOUCH
                free = self.free(x, u(time), rho(time))
                return 1.0 + TOUCH - abs(self.hold(free, mode, mode == 0)[i])
            margin.terminal, margin.direction = True, -1.0   # type: ignore[attr-defined]
            return margin

        states: list[Array] = []
        now = t[0]
        mode: Array = np.zeros(len(self.signs))
        while now < t[-1]:
            if self.signs:
                x, mode = self.settle(x, mode, self.free(x, u(now), rho(now)))
            flow = solve_ivp(rate, (now, t[-1]), x, 'DOP853', t[t > now], args=(mode,),
                             rtol=1e-10, atol=1e-12,
                             events=[event(i, mode) for i in range(len(mode))])
            if flow.status < 0:
                raise ArithmeticError(f'{self.plant.name} at t = {now:.6g} s: {flow.message}')
            states.extend(np.reshape(flow.y, (len(x), -1)).T)   # [] when an event came first
            now, x = float(t[-1]), np.array(states[-1] if states else x)
            if flow.status == 1:
                i = next(i for i, times in enumerate(flow.t_events) if len(times))
                now, x = flow.t_events[i][0], flow.y_events[i][0]
        return np.array(states)
