"""
Fit the plant file of a positioning drive to the first half of its recording.

    python config/drive/fit.py DATA_EMPS.mat -o config/drive/plant.yaml

A carriage on a ball screw (EMPS, Janot, Gautier and Brunot 2019) with viscous and dry friction,

    mass q'' = gain u - (viscous - direction*sign(q')) q' - coulomb sign(q') - pull

`gain` is what the makers published; the published friction has no `direction`: viscous friction
that differs by direction. Without it a second of simulation from the true state errs by 2 mm, with
it by a third of that.

Friction is fitted so that a second and a half of simulation ends where the carriage did. Process
noise is chosen where friction was not fitted: friction of the first quarter, the likelihood of
what a tracked start errs by in the second. Then friction is fitted to the whole first half. The
range of the offset is twice its largest size there, once it is found: without a range it would be
taken to be anything at a start, and be learnt for 16 s. The second half is only scored. The
recording's reference is never used: it tells the position.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import product
from pathlib import Path
import sys

import numpy as np
from scipy.io import loadmat
from scipy.linalg import expm, solve_continuous_are
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

GAIN = 35.15065188248547  # N/V, published
STEP = 1e-3  # s, of the recording
NAMES = ('mass', 'viscous', 'direction', 'coulomb', 'pull')
GUESS = np.array([95.0, 200.0, 0.0, 20.0, -3.0])  # near the published ones
SCALE = np.array([10.0, 20.0, 20.0, 2.0, 2.0])
READING = 1e-5  # m, of the encoder: with what vibrates between it and the carriage
INTERVAL = 0.01  # s between the readings that the designer takes for granted
FOUND = 1500  # samples after which a tracker has found the offset, more or less
AGES = (300, 1000, 1500)  # samples after the loss at which errors count
SHAKEN = (5e-4, 1e-3, 2e-3, 4e-3, 8e-3)  # m/s^2 per sqrt(Hz) on the velocity
DRIFTING = (2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3)  # m/s^2 per sqrt(s) of the offset


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return position [m] and voltage [V] of each millisecond."""
    with path.open('rb') as file:
        data = loadmat(file, squeeze_me=True)
    t, q, u = (np.asarray(data[name], float) for name in ('t', 'qm', 'vir'))
    if not (t.shape == q.shape == u.shape and np.isfinite([t, q, u]).all()
            and np.allclose(np.diff(t), STEP, atol=1e-6)):
        raise ValueError('t, qm and vir must be finite numbers, a sample a millisecond')
    return q, u


def step(theta: np.ndarray, q: np.ndarray, v: np.ndarray, offset: np.ndarray | float,
         u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return position and velocity a sample later; dry friction may stop it."""
    mass, viscous, direction, coulomb, pull = theta
    free = v + STEP * ((GAIN * u - viscous * v + direction * np.abs(v) - pull) / mass + offset)
    new = np.sign(free) * np.maximum(np.abs(free) - STEP * coulomb / mass, 0.0)
    return q + STEP * (v + new) / 2, new


def run(theta: np.ndarray, start: Sequence[np.ndarray], u: np.ndarray) -> np.ndarray:
    """Return positions (T + 1, W) of W windows from (q, v, offset), with voltages (T, W)."""
    q, v, offset = start
    found = [q]
    for now in u:
        q, v = step(theta, q, v, offset, now)
        found.append(q)
    return np.array(found)


def fit(q: np.ndarray, u: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Return theta: see NAMES."""
    v = savgol_filter(q, 51, 3, deriv=1, delta=STEP)
    starts = np.arange(30, len(q) - max(AGES) - 30, 100)
    windows = starts + np.arange(max(AGES) + 1)[:, None]

    def errors(theta: np.ndarray) -> np.ndarray:
        x = run(theta, (q[starts], v[starts], 0.0), u[windows[:-1]])
        return np.asarray(1e3 * (x - q[windows])[100::100].ravel())
    return np.asarray(least_squares(errors, guess, x_scale=SCALE).x)


def tracked(theta: np.ndarray, q: np.ndarray, u: np.ndarray, shaken: float, drifting: float,
            ) -> tuple[np.ndarray, np.ndarray]:
    """Return what a tracker knows (T, 3): q, v, offset; and its errors' growth (ages,) [m^2]."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, -theta[1] / theta[0], 1.0], [0.0, 0.0, 0.0]])
    W, R = np.diag([1e-12, shaken**2, drifting**2]), np.array([[READING**2 * INTERVAL]])
    C = np.eye(1, 3)
    P = solve_continuous_are(A.T, C.T, W, R)
    L = P[:, 0] / R[0, 0] * STEP
    x, states = np.array([q[0], 0.0, 0.0]), np.empty((len(q), 3))
    for k, reading in enumerate(q):
        if k:
            x[0], x[1] = step(theta, x[0], x[1], x[2], u[k - 1])
        x = x + L * (reading - x[0])
        states[k] = x
    grown = []
    for age in AGES:
        both = expm(np.block([[-A, W], [np.zeros((3, 3)), A.T]]) * age * STEP)
        E = both[3:, 3:].T
        grown.append((E @ P @ E.T + E @ both[:3, 3:])[0, 0])
    return states, np.array(grown)


def after(theta: np.ndarray, q: np.ndarray, u: np.ndarray, states: np.ndarray,
          starts: np.ndarray) -> np.ndarray:
    """Return by how much a tracked start is off at each of AGES (ages, W) [m]."""
    windows = starts + np.arange(max(AGES) + 1)[:, None]
    x = run(theta, states[starts].T, u[windows[:-1]])
    return np.asarray((x - q[windows])[list(AGES)])


def noises(q: np.ndarray, u: np.ndarray) -> tuple[float, float]:
    """Return the process noise of velocity and offset, of the second half of what is given."""
    half = len(q) // 2
    theta = fit(q[:half], u[:half], GUESS)
    starts = np.arange(half, len(q) - max(AGES) - 1, 50)

    def unlikely(candidate: tuple[float, float]) -> float:
        states, grown = tracked(theta, q, u, *candidate)
        errors = after(theta, q, u, states, starts)
        return float(np.mean(errors**2 / grown[:, None] + np.log(grown)[:, None]))
    return min(product(SHAKEN, DRIFTING), key=unlikely)


def plant_file(theta: np.ndarray, shaken: float, drifting: float, widest: float,
               comment: str) -> str:
    """Return the plant file."""
    units = ('kg', 'N s/m', 'N s/m', 'N', 'N')
    numbers = '\n'.join(f'  {name}: {{value: {value:.6g}, unit: {unit}}}'
                        for name, value, unit in zip(NAMES, theta, units))
    lines = ''.join(f'# {line}'.rstrip() + '\n' for line in comment.splitlines())
    return f"""{lines}name: drive
description: Positioning drive; friction differs by direction, and drifts. The encoder is all
  that measures, so that it is replaced for a time only.
time: continuous
parameters:
  gain: {{value: {GAIN:.6g}, unit: N/V}}
{numbers}
states:
  position: {{unit: m, process_noise: 1.0e-6, range: [0.0, 0.25]}}
  velocity: {{unit: m/s, process_noise: {shaken:g}}}
  offset: {{unit: m/s^2, process_noise: {drifting:g}, slow: true,
    range: [{-widest:.2g}, {widest:.2g}]}}
inputs:
  voltage: {{unit: V}}
dynamics:
  position: velocity
  velocity: (gain*voltage - viscous*velocity + direction*abs(velocity) - coulomb*sign(velocity)
    - pull)/mass + offset
sensors:
  encoder: {{measures: position, unit: m, noise: {READING:g}, tolerance: 0.01}}
operating_point: {{velocity: 0.08}}
"""


def figures(errors: np.ndarray) -> str:
    """Return median and 90th percentile, in mm."""
    median, ninetieth = 1e3 * np.percentile(np.abs(errors), (50, 90))
    return f'{median:6.2f} {ninetieth:6.2f}'


def main() -> int:
    """Fit, write the plant file, print the figures of both halves."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('recording', type=Path, help='DATA_EMPS.mat')
    parser.add_argument('-o', '--output', type=Path, required=True, help='the plant file to write')
    options = parser.parse_args()
    try:
        q, u = read(options.recording)
    except (OSError, LookupError, TypeError, ValueError) as problem:
        print(f'{options.recording}: not the recording: {problem}', file=sys.stderr)
        return 2
    half = len(q) // 2
    shaken, drifting = noises(q[:half], u[:half])
    theta = fit(q[:half], u[:half], GUESS)
    states, _ = tracked(theta, q, u, shaken, drifting)
    widest = 2.0 * float(np.abs(states[FOUND:half, 2]).max())
    frozen = states * [1.0, 1.0, 0.0]
    rows = []
    for label, known in (('tracked start', states), ('the same, offset taken for 0', frozen)):
        first, second = (after(theta, q, u, known, np.arange(a, b - max(AGES) - 1, 50))[1]
                         for a, b in ((FOUND, half), (half, len(q))))
        rows.append(f'  {label:<30} {figures(first)}   {figures(second)}')
    table = '\n'.join(rows)
    comment = f"""\
Written by config/drive/fit.py; do not edit, run it again.
Fitted to samples 0 to {half - 1} of {len(q)} of {options.recording.name} (1 kHz).
Error of the position 1 s after its loss [mm], median and 90 %: first half, unseen second half
{table}"""
    print(comment)
    try:
        options.output.write_text(
            plant_file(theta, shaken, drifting, widest, comment), encoding='utf-8')
    except OSError as problem:
        print(f'{options.output}: cannot be written: {problem.strerror}', file=sys.stderr)
        return 2
    return 0


if __name__ == '__main__':
    sys.exit(main())
