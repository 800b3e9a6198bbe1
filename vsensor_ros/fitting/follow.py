"""
An extended Kalman filter along windows: how likely what the sensors said is, given the noises.

Each state is driven by white noise, an unknown input is a random walk, and what a sensor says has
noise. In the first part of a window, the lead, the filter reads; then all sensors are lost, and it
goes on alone. All windows are filtered at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vsensor_ros.fitting.model import Model, Moved
from vsensor_ros.fitting.windows import Windows


@dataclass(frozen=True, eq=False)
class Followed:
    """Predicted less read (J, l, W), before that reading is taken, and its variances (J, l, W)."""

    errors: np.ndarray
    variances: np.ndarray


def follow(model: Model, windows: Windows, theta: np.ndarray, states: np.ndarray,
           known: np.ndarray, driven: np.ndarray, noise: np.ndarray, lead: int) -> Followed:
    """
    Filter windows from states (N, W) on that are known to deviations `known` (N,).

    theta (P,) or (P, W); driven (N,) or (N, W): noise on the states, per sqrt(s), or a step with
    a sample time; noise (l,) or (l, W), of the sensors; lead: how many readings are read. The
    variances are those of each reading alone; sensors are taken one after the other.
    """
    n, wide = model.size, states.shape[1]
    driven = np.broadcast_to(driven.reshape(n, -1), (n, wide))
    noise = np.broadcast_to(noise.reshape(len(model.sensors), -1), (len(model.sensors), wide))
    step, outputs = _prepared(model, theta, wide, windows.step)
    x, P = states, np.zeros((wide, n, n))
    P[:, range(n), range(n)] = known**2
    Q = np.zeros((wide, n, n))
    Q[:, range(n), range(n)] = (driven**2).T * (1.0 if model.period else windows.step)
    errors, variances = np.full((2, *windows.readings.shape[:2], wide), np.nan)
    u = windows.inputs[0]
    with np.errstate(all='ignore'):
        for k in range(len(windows.inputs) + 1):
            if k:
                x, slopes = step(x, u)
                Phi = slopes[:, :, :n]
                P = Phi @ P @ np.swapaxes(Phi, 1, 2) + Q
            u = windows.inputs[min(k, len(windows.inputs) - 1)]
            if k % windows.every:
                continue
            j = k // windows.every
            y, slopes = outputs(x, u)
            H = slopes[:, :, :n]
            misfit = y - windows.readings[j]
            errors[j] = misfit
            variances[j] = np.einsum('wln,wnm,wlm->lw', H, P, H) + noise**2
            if j >= lead:
                continue
            value = x
            for i in range(len(model.sensors)):
                row = H[:, i]
                gain = (P @ row[:, :, None])[:, :, 0]
                size = (gain * row).sum(axis=1) + noise[i]**2
                off = misfit[i] + (row.T * (value - x)).sum(axis=0)
                read = np.isfinite(off)
                gain = np.where(read[:, None], gain / size[:, None], 0.0)
                value = value - gain.T * np.where(read, off, 0.0)
                P = P - gain[:, :, None] * gain[:, None, :] * size[:, None, None]
            x = value
    return Followed(errors, variances)


def _prepared(model: Model, theta: np.ndarray, wide: int, h: float,
              ) -> tuple[Callable[[np.ndarray, np.ndarray], Moved], ...]:
    """Return the model's step and outputs at parameters; where it is linear, as matrices."""
    if not model.linear:
        return (lambda x, u: model.step(model.start(x), u, theta, h),
                lambda x, u: model.outputs(model.start(x), u, theta))

    def matrices(run: Callable[[Moved, np.ndarray], Moved],
                 ) -> Callable[[np.ndarray, np.ndarray], Moved]:
        at = model.start(np.zeros((model.size, wide)))
        idle = np.zeros((len(model.inputs), wide))
        value, slopes = run(at, idle)
        by_input = []
        for i in range(len(idle)):
            idle[i] = 1.0
            by_input.append(run(at, idle).value - value)
            idle[i] = 0.0

        def line(x: np.ndarray, u: np.ndarray) -> Moved:
            found = value + (slopes[:, :, :model.size] @ x.T[:, :, None])[:, :, 0].T
            for column, command in zip(by_input, u):
                found = found + column * command
            return Moved(found, slopes)
        return line
    return (matrices(lambda x, u: model.step(x, u, theta, h)),
            matrices(lambda x, u: model.outputs(x, u, theta)))

