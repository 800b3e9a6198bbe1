"""What a step of the isolator takes, for 500 residuals of 40 sensors, beside nothing else."""

from __future__ import annotations

import sys
import time

import numpy as np

from vsensor_ros.isolator import Isolator, Settings
from vsensor_ros.isolator.detector import ENOUGH
from vsensor_ros.observers import Residual

SENSORS, RESIDUALS = 40, 500
PERIOD = 0.01  # s
NOISE = 0.01
ROUNDS, TICKS = 30, 1024  # 1024: each window is looked at
BAR = 30.0  # us


def main() -> int:
    """Print the least of many rounds, with noisy sensors and with some that repeat; return 0."""
    print(f'{RESIDUALS} residuals, {SENSORS} sensors: us a tick, least of {ROUNDS} rounds '
          f'(bar: {BAR:g})')
    for label, step in (('every reading is new', 0.0), ('one sensor in four repeats', 0.01)):
        print(f'  {label}: {measure(step):.1f}')
    return 0


def measure(step: float) -> float:
    """Let a healthy machine learn; return the least mean of a round [us]. step: of readings."""
    random = np.random.default_rng(0)
    names = tuple(f'y{j}' for j in range(SENSORS))
    own = np.arange(RESIDUALS) % SENSORS
    isolator = Isolator(Settings(), names, [_residual(i, names) for i in range(RESIDUALS)], PERIOD)
    ticks = np.arange(8 * TICKS)
    truth = np.sin(PERIOD * ticks[:, None] * np.linspace(0.1, 1.0, SENSORS) + np.arange(SENSORS))
    readings = truth + NOISE * random.standard_normal(truth.shape)
    if step:
        readings[:, ::4] = step * np.round(readings[:, ::4] / step)
    estimates = truth[:, own] + NOISE * random.standard_normal((len(ticks), RESIDUALS))
    count, means = 0, []
    for ticks_of_round in [round((ENOUGH + 10.0) / PERIOD), *[TICKS] * ROUNDS]:
        began = time.process_time()
        for _ in range(ticks_of_round):
            verdict = isolator.step(round(1e9 * PERIOD) * count, readings[count % len(readings)],
                                    estimates[count % len(readings)])
            count += 1
        means.append(1e6 * (time.process_time() - began) / ticks_of_round)
    assert verdict.state == 'healthy'
    return min(means[1:])


def _residual(i: int, names: tuple[str, ...]) -> Residual:
    """Return one of a sensor, from the three beside it."""
    support = tuple(sorted({names[(i + k) % len(names)] for k in range(4)}))
    channel = names[i % len(names)]
    gains = tuple(1.0 if name == channel else 0.5 for name in support)
    return Residual(f'r{i}', (channel,), channel, support, gains, 1.5 * NOISE, 9.0 * NOISE)


if __name__ == '__main__':
    sys.exit(main())
