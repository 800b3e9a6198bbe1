"""
The twin rotor of Sensors 2020, 20(12), 3486: design its estimator, run it, draw figures 3 to 8.

The truth is the continuous nonlinear machine of which the submodels are samples; fault scenarios
(50) to (53) over 100 s. What the paper does not print (inputs, memberships, the bound of the
noise) is chosen, see docs/twin_rotor.md.

    python -m benchmark.twin_rotor [FOLDER]     # figures go to FOLDER
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import sys

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.fault_estimator import (
    ALPHAS,
    Descriptor,
    descriptor,
    estimator,
    FaultEstimator,
)
from vsensor_ros.plant import load_takagi_sugeno, TakagiSugeno

PLANT = Path(__file__).resolve().parent.parent / 'config/twin_rotor/submodels.yaml'
FAULTY = ['yaw_rate', 'pitch_rate']
STEPS = 10000
SAMPLE = 0.01  # s
_SUBSTEPS = 10  # of Runge-Kutta a sample
SCAN = (0.002, 0.003, 0.005, 0.008, 0.012, 0.016, 0.02, 0.025, 0.03)


@dataclass(frozen=True, eq=False)
class Run:
    """What was true, what was read and what was estimated, at STEPS samples."""

    truth: np.ndarray  # (STEPS, N): states, actuator faults of a step before, sensor faults
    readings: np.ndarray  # (STEPS, l)
    estimates: np.ndarray  # (STEPS, N)


def form_of(plant: TakagiSugeno) -> Descriptor:
    """Return the descriptor form; faults act through the mean of the B_i, W1 and W2 as printed."""
    return descriptor(plant, plant.B.mean(axis=0), FAULTY, W1=0.01 * np.eye(6),
                      W2=0.05 * np.eye(6))


def motion(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return dx/dt of the machine; its coefficients are those of the logarithms of the A_i."""
    yaw_rate, tail, pitch, pitch_rate, main = x[1:]
    u_tail, u_main = u
    side, ahead = np.sin(pitch), np.cos(pitch)
    m1, m2 = (1 - ahead) / 0.3, (1 + side / 0.70710678) / 2
    m3, m4 = side**2 / 0.5, (pitch**2 / 6 - pitch**4 / 120 + pitch**6 / 5040) / 0.1
    inertia = 1 + 0.004503 * m3  # of the yaw, reciprocal
    return np.array([
        yaw_rate,
        inertia * (-0.5837002 * yaw_rate + 0.01040633 * (1 - 0.3 * m1) * tail
                   + 0.01040672 * (1 - 0.1 * m4) * pitch
                   + (-1.094987 + 0.8830514 * m1 - 1.342211 * m2) * u_main),
        37000 * (u_tail - tail / 900),
        pitch_rate,
        (-2.481154 + 1.557007 * m1 - 1.26568 * m2) * pitch - 0.4225208 * pitch_rate
        + 0.003685524 * main + 0.1388988 * u_tail,
        6100 * (u_main - main / 600)])


def moved(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the state a sample later, the inputs held."""
    h = SAMPLE / _SUBSTEPS
    for _ in range(_SUBSTEPS):
        a = motion(x, u)
        b = motion(x + h / 2 * a, u)
        c = motion(x + h / 2 * b, u)
        x = x + h / 6 * (a + 2 * b + 2 * c + motion(x + h * c, u))
    return x


def command(k: int) -> np.ndarray:
    """Return the inputs (u_h, u_v) at a step."""
    t = k * SAMPLE
    slow, step, main = (np.sin(2 * np.pi * t / period) for period in (17, 31, 23))
    return np.array([0.25 * slow + 0.15 * np.sign(step), 0.3 + 0.2 * main])


def faults(k: int, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return actuator and sensor faults (50) to (53)."""
    return (np.array([-0.1 * u[0] * (3000 <= k <= 6500), 0.1 * u[1] * (4500 <= k <= 8000)]),
            np.array([-2.5 * (5000 <= k <= 7000), 1.6 * (6000 <= k <= 9500)]))


def simulate(plant: TakagiSugeno, found: FaultEstimator, steps: int = STEPS,
             seed: int = 1) -> Run:
    """Run machine and estimator; noise is uniform in the ball, the premise is the pitch read."""
    random = np.random.default_rng(seed)
    low, high = plant.ranges[0]
    x, before = np.zeros(6), np.zeros(2)
    truth, readings, estimates = [], [], []
    z = None
    for k in range(steps):
        w = random.normal(size=12)
        w *= random.random()**(1 / 12) / np.linalg.norm(w) / np.sqrt(2)
        u = command(k)
        fa, fs = faults(k, u)
        y = x + 0.05 * w[6:]
        y[[1, 4]] += fs
        if z is None:  # as if nothing had failed
            z = np.concatenate([y, np.zeros(4)]) - found.T2 @ y
        truth.append(np.concatenate([x, before, fs]))
        readings.append(y)
        estimates.append(z + found.T2 @ y)
        h = plant.weights(np.clip(y[3:4, None], low, high))[:, 0]
        z = sum(np.tensordot(h, matrices, 1) @ vector for matrices, vector in (
            (found.N, z), (found.M, u), (found.L, y)))
        x, before = moved(x, u + fa) + 0.01 * w[:6], fa
    return Run(np.array(truth), np.array(readings), np.array(estimates))


def table(found: FaultEstimator, run: Run) -> list[str]:
    """Return a line for each variable: half-width, rms, worst, and the share inside."""
    off = abs(run.estimates - run.truth)
    lines = ['variable           half-width        rms      worst   inside   half-width/worst']
    for name, width, error in zip(found.variables, found.half_widths, off.T):
        lines.append(f'{name:14s} {width:14.4g} {np.sqrt(np.mean(error**2)):10.3g} '
                     f'{error.max():10.3g} {np.mean(error <= width):8.4f} '
                     f'{width / error.max():12.0f}')
    return lines


def draw(found: FaultEstimator, run: Run, folder: Path) -> None:
    """Draw figures 3 to 8 of the paper."""
    import matplotlib  # of the desk
    matplotlib.use('Agg')
    from matplotlib import pyplot
    t = np.arange(len(run.truth)) * SAMPLE
    index = {name: i for i, name in enumerate(found.variables)}
    pairs = {3: ('fa 1', 'fa 2'), 4: ('fs yaw_rate', 'fs pitch_rate'), 5: ('omega_v', 'omega_h'),
             6: ('Omega_v', 'Omega_h'), 7: ('omega_v', 'omega_h'), 8: ('theta_v',)}
    for number, names in pairs.items():
        figure, axes = pyplot.subplots(len(names), 1, sharex=True, squeeze=False,
                                       figsize=(7, 2.6 * len(names)))
        for name, axis in zip(names, axes[:, 0]):
            i = index[name]
            true, got, width = run.truth[:, i], run.estimates[:, i], found.half_widths[i]
            if number < 7:
                if i < 6:
                    axis.plot(t, run.readings[:, i], color='lightgreen', label='reading')
                axis.plot(t, true, 'b-.', label='true')
                axis.plot(t, got, 'r--', label='estimate')
                axis.plot(t, got - width, 'k--', t, got + width, 'k--', linewidth=0.7)
                axis.legend(loc='upper right')
            else:
                axis.plot(t, true - got, 'r')
            axis.set_ylabel(name if number < 7 else f'error of {name}')
        axes[-1, 0].set_xlabel('t [s]')
        figure.tight_layout()
        figure.savefig(folder / f'figure_{number}.png', dpi=120)
        pyplot.close(figure)


def scan(form: Descriptor) -> list[tuple[float, float, float]]:
    """Return (alpha, half-width, half-width) of both sensor faults, T optimised at each alpha."""
    found = []
    for alpha in SCAN:
        try:
            one = estimator(form, [alpha])
            found.append((alpha, *one.half_widths[form.goal].tolist()))
            print('  alpha {:.3f}: {:.3f} {:.3f}'.format(*found[-1]), flush=True)
        except BadInput as why:
            print(f'  alpha {alpha:.3f}: {why}', flush=True)
    return found


def draw_scan(found: list[tuple[float, float, float]], folder: Path) -> None:
    """Draw half-width against alpha."""
    import matplotlib  # of the desk
    matplotlib.use('Agg')
    from matplotlib import pyplot
    alpha, *widths = np.array(found).T
    figure, axis = pyplot.subplots(figsize=(7, 3.5))
    for name, width in zip(FAULTY, widths):
        axis.plot(alpha, width, 'o-', label=name)
    axis.set(xlabel='alpha', ylabel='half-width [rad/s]')
    axis.legend()
    figure.tight_layout()
    figure.savefig(folder / 'half_width_of_alpha.png', dpi=120)
    pyplot.close(figure)


def main(folder: str | None = None) -> None:
    """Design both ways, simulate, print the tables; draw where a folder is given."""
    plant = load_takagi_sugeno(PLANT)
    form = form_of(plant)
    for way, alphas, fixed in (('the easier way', ALPHAS, True),
                               ('least intervals', ALPHAS, False), ('quieter', [0.012], False)):
        found = estimator(form, alphas, fixed_gains=fixed)
        run = simulate(plant, found)
        print(f'{way}: alpha {found.alpha:.4f}, norm {found.norm:.7f}, '
              f'spectral radius {found.contraction:.5f}')
        print('\n'.join(table(found, run)), flush=True)
    if folder is not None:
        Path(folder).mkdir(parents=True, exist_ok=True)
        draw(found, run, Path(folder))
        draw_scan(scan(form), Path(folder))


if __name__ == '__main__':
    main(*sys.argv[1:2])
