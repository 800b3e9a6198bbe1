"""
Fit the plant file of a two-link arm to three of its recordings.

    python config/two_link/fit.py trajectory_00.csv trajectory_01.csv trajectory_02.csv \
        -o config/two_link/plant.yaml

Two links that hang, with a motor in each joint; angles from hanging, the second from the first:

    m11 vel1' + m12 vel2' = torque1 + ..,  m11 = a1 + 2 a3 cos pos2,  m12 = a2 + a3 cos pos2
    m12 vel1' + m22 vel2' = k2 torque2 + load + ..,  m22 = a2 + a4 (the second motor's rotor)

Both ways of simulation count: both joints for 0.6 s by their torques, and the elbow for 1.2 s
along the shoulder's measured motion (its momentum m12 vel1 + m22 vel2 does not feel the shoulder's
torque). Each joint's friction is d v + f tanh(v/vs); z1 and z2 are the encoders' zeros.

The load is what the elbow's friction and motor are off by: constant in a run, another in the next
(up to 0.06 N m). Each run gets its own in the fit; on the machine it is learnt. From one window of
1.2 s to the next it differs by 0.005 to 0.013 N m: LOAD. It forgets within 50 s, which is longer
than these runs, so that what never reads the elbow forgets its start.

Process noise is chosen, not fitted, by a rule that was written before any of its figures were seen
(benchmark/arm_noise.py): each of these runs is replayed with a model that was fitted to the others
alone, and the elbow's encoder is lost for 2 s from every second (positions and speeds together).
Of the noises SHOULDER and ELBOW on the accelerations the smallest, the elbow's first, with which
in every run at least 95 % of what the engine lets go out lies within two deviations. What is wrong
at the shoulder is the unknown input `shoulder`, a torque, kept out exactly where the arm hangs.

The filter that serves when the elbow's encoder is lost reads the shoulder instead of keeping it
out. So it is told how far off the parameters may be, and what torques act that nobody told. The
parameters: SHARE of each, as stated, or what leaving one run out of three moves it by, where that
is more (SPREADS). The torques: what the accelerations of one run leave of the equations as fitted
to the other two is 0.11 to 0.125 N m at the shoulder and 0.03 to 0.055 at the elbow in the mean
over 0.1 s, and less over longer times, as of white noise: TORQUES. benchmark/arm_noise.py says how
good the filter is on each of these runs with the parameters of the other two.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
import sys

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

NAMES = ('a1', 'a2', 'a3', 'b1', 'b2', 'd1', 'd2', 'f1', 'f2', 'k2', 'a4', 'z1', 'z2')
GUESS = np.array([0.12, 0.02, 0.03, 3.0, 1.0, 0.03, 0.004, 0.1, 0.1, 0.9, 0.004, 0.0, 0.0])
VS = 0.5  # rad/s over which friction turns round
STEP, APART = 0.002, 60  # s, and samples between the starts of windows
BOTH, ALONE = 300, 600  # samples for which both joints, and the elbow alone, are simulated
SIZES = np.array([0.02, 0.05, 0.2, 0.5])  # rad, rad/s that weigh alike
LOAD = 0.01  # N m per sqrt(s)
TORQUES = (0.04, 0.0115)  # N m per sqrt(Hz), of the torques as they are said
SHARE = 0.05  # of a parameter: its standard deviation
SPREADS = {'d1': 0.004, 'd2': 0.002, 'f1': 0.0175, 'a4': 0.0005, 'z1': 0.01, 'z2': 0.01}
SHOULDER, ELBOW = 0.1, 0.5  # rad/s^2 per sqrt(Hz): by benchmark.arm_noise


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return (T, 4) smoothed positions and speeds, and (T, 2) torques, every 2 ms."""
    with path.open(encoding='utf-8', newline='') as file:
        rows = list(csv.DictReader(file))

    def column(name: str) -> np.ndarray:
        return np.array([float(row[name]) for row in rows])
    time = column('time')
    grid = np.arange(0.0, time[-1], STEP)
    held = np.clip(np.searchsorted(time, grid + 1e-9, side='right') - 1, 0, None)
    angles = [np.interp(grid, time, column(f'pos_meas{i}')) for i in (1, 2)]
    x = [savgol_filter(a, 21, 3, deriv=n, delta=STEP) for n in (0, 1) for a in angles]
    return np.array(x).T, np.array([column(f'tau_meas{i}')[held] for i in (1, 2)]).T


def accelerations(p: np.ndarray, x: np.ndarray, torque: np.ndarray,
                  load: np.ndarray) -> np.ndarray:
    """Return the derivative (4, W) of pos1, pos2, vel1, vel2 (4, W); load (W,)."""
    a1, a2, a3, b1, b2, d1, d2, f1, f2, k2, a4, z1, z2 = p
    q1, q2, v1, v2 = x[0] + z1, x[1] + z2, x[2], x[3]
    m11, m12, m22 = a1 + 2 * a3 * np.cos(q2), a2 + a3 * np.cos(q2), a2 + a4
    lean = b2 * np.sin(q1 + q2)
    r1 = torque[0] + a3 * np.sin(q2) * (2 * v1 * v2 + v2**2) - b1 * np.sin(q1) - lean \
        - d1 * v1 - f1 * np.tanh(v1 / VS)
    r2 = k2 * torque[1] + load - a3 * np.sin(q2) * v1**2 - lean - d2 * v2 - f2 * np.tanh(v2 / VS)
    det = m11 * m22 - m12**2
    return np.array([v1, v2, (m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det])


def elbow_speed(p: np.ndarray, q2: np.ndarray, momentum: np.ndarray, v1: np.ndarray) -> np.ndarray:
    """Return vel2 of the momentum m12 vel1 + m22 vel2."""
    return np.asarray((momentum - (p[1] + p[2] * np.cos(q2 + p[12])) * v1) / (p[1] + p[10]))


def elbow(p: np.ndarray, x: np.ndarray, shoulder: np.ndarray, torque: np.ndarray,
          load: np.ndarray) -> np.ndarray:
    """Return the derivative (2, W) of pos2 and momentum along the shoulder's pos1, vel1."""
    _, _, a3, _, b2, _, d2, _, f2, k2, _, z1, z2 = p
    q2, v1 = x[0] + z2, shoulder[1]
    v2 = elbow_speed(p, x[0], x[1], v1)
    return np.array([v2, k2 * torque[1] + load - a3 * np.sin(q2) * (v1**2 + v1 * v2)
                     - b2 * np.sin(shoulder[0] + z1 + q2) - d2 * v2 - f2 * np.tanh(v2 / VS)])


def windows(runs: list[tuple[np.ndarray, np.ndarray]], length: int,
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states (T, 4, W) and torques (T, 2, W) of all windows, and of which run (W,)."""
    cut = [(x[s:s + length + 1], u[s:s + length + 1], run) for run, (x, u) in enumerate(runs)
           for s in range(30, len(x) - length - 12, APART)]
    return (np.array([x for x, _, _ in cut]).transpose(1, 2, 0),
            np.array([u for _, u, _ in cut]).transpose(1, 2, 0),
            np.array([run for _, _, run in cut]))


def both_off(p: np.ndarray, x: np.ndarray, u: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Return how far off both joints are every 40 ms (.., 4, W), by steps of 4 ms."""
    now, h, found = x[0], 2 * STEP, []
    for k in range(0, len(x) - 2, 2):
        torque = (u[k] + u[k + 1]) / 2
        k1 = accelerations(p, now, torque, load)
        k2 = accelerations(p, now + h / 2 * k1, torque, load)
        k3 = accelerations(p, now + h / 2 * k2, torque, load)
        k4 = accelerations(p, now + h * k3, torque, load)
        now = now + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        found.append(now - x[k + 2])
    return np.array(found)[9::10]


def elbow_off(p: np.ndarray, x: np.ndarray, u: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Return the same of pos2 and vel2 (.., 2, W) along the shoulder's motion."""
    now = np.array([x[0, 1], (p[1] + p[2] * np.cos(x[0, 1] + p[12])) * x[0, 2]
                    + (p[1] + p[10]) * x[0, 3]])
    h, found = 2 * STEP, []
    for k in range(0, len(x) - 2, 2):
        torque = (u[k] + u[k + 1]) / 2
        first, middle, last = x[k, ::2], x[k + 1, ::2], x[k + 2, ::2]
        k1 = elbow(p, now, first, torque, load)
        k2 = elbow(p, now + h / 2 * k1, middle, torque, load)
        k3 = elbow(p, now + h / 2 * k2, middle, torque, load)
        k4 = elbow(p, now + h * k3, last, torque, load)
        now = now + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        found.append(np.array([now[0], elbow_speed(p, now[0], now[1], last[1])]) - x[k + 2, 1::2])
    return np.array(found)[9::10]


def fit(runs: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return the parameters, see NAMES, whatever the loads of the runs."""
    (*short, one), (*long, other) = windows(runs, BOTH), windows(runs, ALONE)

    def errors(q: np.ndarray) -> np.ndarray:
        p, loads = np.split(q, [len(NAMES)])
        with np.errstate(all='ignore'):
            off = [both_off(p, *short, loads[one]) / SIZES[:, None],
                   elbow_off(p, *long, loads[other]) / SIZES[1::2, None]]
        return np.nan_to_num(np.concatenate([o.ravel() for o in off]), nan=1e3).clip(-1e3, 1e3)
    guess = np.concatenate([GUESS, np.zeros(len(runs))])
    return np.asarray(least_squares(errors, guess, x_scale=np.maximum(guess, 0.02),
                                    loss='soft_l1').x[:len(NAMES)])


def plant_file(p: np.ndarray, names: str) -> str:
    """Return the plant file."""
    a1, a2, a3, *_, a4, _, z2 = p
    numbers = '\n'.join(
        f'  {name}: {{value: {value:.6g}, spread: {SPREADS.get(name, SHARE * abs(value)):.3g}}}'
        for name, value in zip(NAMES, p))
    bend = a3 * np.cos(z2)
    m11, m12, m22 = a1 + 2 * bend, a2 + bend, a2 + a4
    det = m11 * m22 - m12**2
    inertia = ('(a1 + 2*a3*cos(pos2 + z2))', '(a2 + a3*cos(pos2 + z2))', '(a2 + a4)')
    one = ('(torque1 + a3*sin(pos2 + z2)*(2*vel1*vel2 + vel2*vel2) - b1*sin(pos1 + z1) '
           '- b2*sin(pos1 + pos2 + z1 + z2) - d1*vel1 - f1*tanh(vel1/vs))')
    two = ('(k2*torque2 + load - a3*sin(pos2 + z2)*vel1*vel1 - b2*sin(pos1 + pos2 + z1 + z2) '
           '- d2*vel2 - f2*tanh(vel2/vs))')
    whole = '({0}*{2} - {1}*{1})'.format(*inertia)
    return f"""# Written by config/two_link/fit.py; do not edit, run it again.
# Fitted to {names}.
name: two_link
description: Two links that hang, a motor with encoder in each joint. The load at the elbow is
  learnt; what is wrong at the shoulder is an unknown torque, kept out where that can be.
time: continuous
parameters:
{numbers}
  vs: {VS:g}
states:
  pos1: {{unit: rad, process_noise: 1.0e-4, range: [-3.2, 3.2]}}
  pos2: {{unit: rad, process_noise: 1.0e-4, range: [-3.2, 3.2]}}
  vel1: {{unit: rad/s, process_noise: {SHOULDER:g}, range: [-20, 20]}}
  vel2: {{unit: rad/s, process_noise: {ELBOW:g}, range: [-20, 20]}}
  load: {{unit: N m, process_noise: {LOAD:g}, range: [-0.2, 0.2]}}
inputs:
  torque1: {{unit: N m, process_noise: {TORQUES[0]:g}}}
  torque2: {{unit: N m, process_noise: {TORQUES[1]:g}}}
disturbances:
  shoulder: {{unit: N m, process_noise: 0}}  # it stands in that of torque1
dynamics:
  pos1: vel1
  pos2: vel2
  vel1: ({inertia[2]}*{one} - {inertia[1]}*{two})/{whole}
    + {m22 / det:.15g}*shoulder
  vel2: ({inertia[0]}*{two} - {inertia[1]}*{one})/{whole}
    - {m12 / det:.15g}*shoulder
  load: -load/50
sensors:
  pos1: {{measures: pos1, unit: rad, noise: 2.0e-4}}
  pos2: {{measures: pos2, unit: rad, noise: 2.0e-4}}
  vel1: {{measures: vel1, unit: rad/s, noise: 0.03}}
  vel2: {{measures: vel2, unit: rad/s, noise: 0.03}}
"""


def main() -> int:
    """Fit and write the plant file."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('recordings', type=Path, nargs='+', help='trajectory_00.csv ..')
    parser.add_argument('-o', '--output', type=Path, required=True, help='the plant file to write')
    options = parser.parse_args()
    try:
        runs = [read(path) for path in options.recordings]
    except (OSError, LookupError, TypeError, ValueError) as problem:
        print(f'not a recording: {problem}', file=sys.stderr)
        return 2
    p = fit(runs)
    try:
        options.output.write_text(
            plant_file(p, ', '.join(path.name for path in options.recordings)), encoding='utf-8')
    except OSError as problem:
        print(f'{options.output}: cannot be written: {problem.strerror}', file=sys.stderr)
        return 2
    return 0


if __name__ == '__main__':
    sys.exit(main())
