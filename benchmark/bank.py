"""
What one tick of the bank costs, beside plain observers stepped one by one.

A tick of ours takes all readings and commands with their stamps, steps what is new and what late
readings changed, and asks for one estimate. The peer is what one writes with numpy: for each
virtual sensor a Luenberger observer of the same order and terms, matrices discretised before, one
step with the newest readings; no stamps, no checks, nothing redone.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np
from scipy.linalg import expm

from benchmark.row import Row
from vsensor_ros.bank import Bank
from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.observers import Design, Refusal, VirtualSensor

GROUP = ('one tick of the bank, orders 1 to 4, nonlinear with a square root each; '
         'peer: numpy Luenberger observers, one by one')
SIZES = (1, 10, 50)
RATE = 100.0  # Hz
LATE = 3_000_000  # ns, age of the newest readings at a tick
WARM_UP = 20  # ticks
INPUTS = ('u1', 'u2')
TERM = NonlinearTerm('sqrt(w1)', 'sqrt(w1)', np.zeros(1))


def make_design(size: int, nonlinear: bool) -> Design:
    """Make virtual sensors of orders 1 to 4 in turns, each reading two sensors and two inputs."""
    rng = np.random.default_rng(size)
    sensors = tuple(f'y{i + 1}' for i in range(max(size, 3)))
    entries: dict[tuple[tuple[str, ...], str], VirtualSensor | Refusal] = {}
    for i in range(size):
        healthy = sensors[:i] + sensors[i + 1:]
        k, l0 = 1 + i % 4, len(healthy)
        read = [i % l0, (i + 1) % l0]
        J, Gy = np.zeros((k, l0)), np.zeros((1, l0))
        J[:, read] = rng.uniform(-1, 1, (k, 2))
        Gy[0, read] = 1.0
        eigenvalues = -np.arange(1.0, k + 1)
        entries[(sensors[i],), sensors[i]] = VirtualSensor(
            sensors[i], (sensors[i],), healthy, INPUTS, np.eye(k),
            np.diag(eigenvalues) + np.diag(np.ones(k - 1), 1), J, rng.uniform(-1, 1, (k, 2)),
            np.ones((k, 1)) if nonlinear else np.zeros((k, 0)), np.ones((1, k)),
            np.zeros((1, l0)), (np.zeros((1, k)),) * nonlinear, (Gy,) * nonlinear,
            (TERM,) * nonlinear, None, np.zeros(k), np.zeros((k, l0)),
            eigenvalues.astype(complex), 1.0, 'by hand')
    return Design('benchmark', '0' * 64, ('x1',), INPUTS, sensors, {}, None, entries)


class Observers:
    """The peer."""

    def __init__(self, design: Design) -> None:
        self.observers = []
        for v in design.virtual_sensors:
            k = v.order
            gains = np.hstack((v.J, v.B, v.P))
            system = np.zeros((k + gains.shape[1],) * 2)
            system[:k] = np.hstack((v.N, gains))
            held = expm(system / RATE)[:k]
            E, F, H, W = np.split(
                held, np.cumsum([k, len(v.healthy), len(INPUTS)]), axis=1)
            index = np.array([design.sensors.index(name) for name in v.healthy])
            self.observers.append((E, F, H, W, v, index))
        self.z = [np.zeros(v.order) for v in design.virtual_sensors]

    def step(self, y: np.ndarray, u: np.ndarray) -> None:
        """Step each observer with the readings and commands of now."""
        for i, (E, F, H, W, v, index) in enumerate(self.observers):
            z, y0 = self.z[i], y[index]
            new = E @ z + F @ y0 + H @ u
            if v.terms:
                new += W @ np.sqrt(v.Gz[0] @ z + v.Gy[0] @ y0)
            self.z[i] = new

    def estimate(self, i: int, y: np.ndarray) -> float:
        """Return the output of one of them."""
        v, index = self.observers[i][4:]
        return float((v.Cv @ self.z[i] + v.Q @ y[index])[0])


def measure(ticks: int, sizes: tuple[int, ...] = SIZES,
            progress: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Measure both in turns, tick by tick; compare medians."""
    result = []
    for nonlinear in (False, True):
        for size in sizes:
            label = f'{size} virtual sensor{"s" * (size > 1)}, {"non" * nonlinear}linear'
            progress(f'tick of the bank: {label}')
            ours, peer = _ticks(make_design(size, nonlinear), ticks)
            result.append(Row(GROUP, label, 'us', 1e6 * ours, 1e6 * peer))
    return result


def _ticks(design: Design, ticks: int) -> tuple[float, float]:
    """Return the median time of a tick of the bank and of the peer [s]."""
    bank, observers = Bank(design, RATE), Observers(design)
    names, L = design.sensors + INPUTS, len(design.sensors)
    served = design.virtual_sensors[-1]
    spent = np.empty((ticks, 2))
    for tick in range(-WARM_UP, ticks):
        now = (tick + WARM_UP + 1) * bank.period
        values = 2.0 + np.sin(1e-9 * now + np.arange(len(names)))
        texts = list(zip(names, values.tolist()))
        y, u = values[:L], values[L:]
        begin = perf_counter()
        for name, value in texts:
            bank.take(name, now - LATE, value)
        bank.advance(now)
        estimate = bank.estimate(served.fault_set, served.channel)
        middle = perf_counter()
        observers.step(y, u)
        plain = observers.estimate(-1, y)
        end = perf_counter()
        if tick >= 0:
            spent[tick] = middle - begin, end - middle
    if estimate is None or not np.isfinite(plain):
        raise AssertionError(f'nothing was estimated: {estimate}, {plain}')
    ours, peer = np.median(spent, axis=0)
    return float(ours), float(peer)
