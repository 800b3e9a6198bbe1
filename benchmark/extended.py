"""
What filters on the equations cost a tick, beside filterpy's one by one, in one run.

Three coupled pendulums, six states and ten sensors. Ours: a bank with the filters of so many fault
sets, of which each loses its first sensor, with what tracks them and parameters that are
considered: a bank of one runs two filters, one that the lost sensor corrects and one that goes on
without it. The peer: filterpy's extended Kalman filter with Runge and Kutta, all sensors but one,
no parameter considered. Its model is the same generated one (values and derivatives by
`Equations`), or written by hand in numpy.

    python -m benchmark.extended
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from vsensor_ros import Design, load_plant
from vsensor_ros.bank import Bank
from vsensor_ros.designer.extended import extended
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse
from vsensor_ros.observers import Model
from vsensor_ros.plant import Plant

Map = Callable[[np.ndarray, np.ndarray], np.ndarray]  # of states (6,) and commands (1,)
PERIOD, TICKS, FORGOTTEN = 0.01, 2000, 100
PENDULUMS = """
name: pendulums
time: continuous
parameters: {k: {value: 3.0, spread: 0.15}, g: 9.81, c: {value: 0.4, spread: 0.04}}
states:
  a1: {process_noise: 0.001}
  a2: {process_noise: 0.001}
  a3: {process_noise: 0.001}
  w1: {process_noise: 0.1}
  w2: {process_noise: 0.1}
  w3: {process_noise: 0.1}
inputs: {u: }
dynamics:
  a1: w1
  a2: w2
  a3: w3
  w1: -g*sin(a1) - c*w1 + k*(a2 - a1) + u
  w2: -g*sin(a2) - c*w2 + k*(a1 + a3 - 2*a2)
  w3: -g*sin(a3) - c*w3 + k*(a2 - a3)
sensors:
  angle_1: {measures: a1, noise: 0.01}
  angle_2: {measures: a2, noise: 0.01}
  angle_3: {measures: a3, noise: 0.01}
  rate_1: {measures: w1, noise: 0.02}
  rate_2: {measures: w2, noise: 0.02}
  rate_3: {measures: w3, noise: 0.02}
  bend_12: {measures: a2 - a1, noise: 0.01}
  bend_23: {measures: a3 - a2, noise: 0.01}
  twist_12: {measures: w2 - w1, noise: 0.02}
  twist_23: {measures: w3 - w2, noise: 0.02}
"""


def plant_of() -> Plant:
    """Return the pendulums."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / 'pendulums.yaml'
        path.write_text(PENDULUMS)
        return load_plant(path)


def bank_of(plant: Plant, count: int) -> Bank:
    """Return a bank of the filters of so many fault sets, of one sensor and of two."""
    sets = [s for size in (1, 2) for s in combinations(plant.sensors, size)][:count]
    entries = {(lost, lost[0]): entry for lost in sets
               if (entry := extended(plant, lost, lost[0])) is not None}
    return Bank(Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                       dict(plant.units), None, dict(entries)), 1.0 / PERIOD)


def ours(plant: Plant, count: int) -> float:
    """Return the least time [s] of a tick."""
    bank, random, times = bank_of(plant, count), np.random.default_rng(0), []
    for k in range(TICKS):
        now = round(k * PERIOD * 1e9)
        for sensor, value in zip(plant.sensors, plant.noise * random.standard_normal(10)):
            bank.take(sensor, now, float(value))
        bank.take('u', now, 0.0)
        begun = perf_counter()
        bank.advance(now)
        times.append(perf_counter() - begun)
    return min(times[FORGOTTEN:])


def generated(model: Model) -> tuple[Map, Map]:
    """Return the derivatives and their slopes as `Equations` have them."""
    f = Equations([parse(text) for text in model.equations], (
        *model.states, *model.inputs, *model.unknown, *model.parameters))

    def at(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.concatenate([x, u, model.values])[:, None]
    return (lambda x, u: f.values(at(x, u))[:, 0],
            lambda x, u: f.slopes(at(x, u))[1][:, :len(x), 0])


def by_hand(model: Model) -> tuple[Map, Map]:
    """Return them as one writes them down."""
    (k, c), g, sin, cos = model.values, 9.81, np.sin, np.cos

    def values(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        a1, a2, a3, w1, w2, w3 = x
        return np.array([w1, w2, w3,
                         -g * sin(a1) - c * w1 + k * (a2 - a1) + u[0],
                         -g * sin(a2) - c * w2 + k * (a1 + a3 - 2 * a2),
                         -g * sin(a3) - c * w3 + k * (a2 - a3)])

    def slopes(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        a1, a2, a3, *_ = x
        return np.array([[0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1],
                         [-g * cos(a1) - k, k, 0, -c, 0, 0],
                         [k, -g * cos(a2) - 2 * k, k, 0, -c, 0],
                         [0, k, -g * cos(a3) - k, 0, 0, -c]])
    return values, slopes


def peer(model: Model, values: Map, slopes: Map) -> float:
    """Return the least time [s] of a step of filterpy's filter."""
    from filterpy.kalman import ExtendedKalmanFilter
    n, h = 6, PERIOD

    class Filter(ExtendedKalmanFilter):
        def predict_x(self, u: np.ndarray) -> None:
            x = self.x
            k1 = values(x, u)
            k2 = values(x + h / 2 * k1, u)
            k3, A = values(x + h / 2 * k2, u), slopes(x + h / 2 * k2, u)
            k4 = values(x + h * k3, u)
            self.F = np.eye(n) + h * A + h * h / 2 * A @ A
            self.x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    C, random, times = model.C[1:], np.random.default_rng(0), []
    one = Filter(n, len(C))
    one.x, one.R, one.Q = np.zeros(n), np.diag(model.noise[1:]**2), 1e-4 * np.eye(n)
    for _ in range(TICKS):
        y = model.noise[1:] * random.standard_normal(len(C))
        begun = perf_counter()
        one.predict(np.zeros(1))
        one.update(y, lambda x: C, lambda x: C @ x)
        times.append(perf_counter() - begun)
    return min(times[FORGOTTEN:])


def main() -> None:
    """Print a line for each number of fault sets."""
    plant = plant_of()
    entry = extended(plant, plant.sensors[:1], plant.sensors[0])
    assert entry is not None
    model = entry.model
    peers = [peer(model, *made(model)) for made in (generated, by_hand)]
    print('filterpy, one filter: {:.0f} us, by hand {:.0f} us'.format(*(1e6 * t for t in peers)))
    for count in (1, 10, 50):
        tick = ours(plant, count)
        shares = [tick / (count * one) for one in peers]
        print(f'{count:2d} fault sets: {1e6 * tick:5.0f} us a tick, {shares[0]:.3f} of filterpy '
              f'one by one, {shares[1]:.3f} of it by hand')


if __name__ == '__main__':
    main()
