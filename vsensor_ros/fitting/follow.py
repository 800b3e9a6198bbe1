"""
An extended Kalman filter along windows: how likely what the sensors said is, given the noises.

Each state is driven by white noise, an unknown input is a random walk, and what a sensor says has
noise. In the first part of a window, the lead, the filter reads; then all sensors are lost, and it
goes on alone. All windows are filtered at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vsensor_ros.fitting.model import Model, Moved
from vsensor_ros.fitting.windows import Windows

Run = Callable[[int, np.ndarray, np.ndarray], Moved]


@dataclass(frozen=True, eq=False)
class Followed:
    """Predicted less read (J, l, W), before that reading is taken, and its variances (J, l, W)."""

    errors: np.ndarray
    variances: np.ndarray


class Along(NamedTuple):
    """A step and what is shown, of states (N, W) under commands, by how many there were before."""

    step: Run
    outputs: Run


def follow(model: Model, windows: Windows, theta: np.ndarray, states: np.ndarray,
           known: np.ndarray, driven: np.ndarray, noise: np.ndarray, lead: int,
           along: Along | None = None) -> Followed:
    """
    Filter windows from states (N, W) on that are known to deviations `known` (N,).

    theta (P,) or (P, W); driven (N,) or (N, W): noise on the states, per sqrt(s), or a step with
    a sample time; noise (l,) or (l, W), of the sensors; lead: how many readings are read; along:
    what is linearised about in place of the filter's own states. The
    variances are those of each reading alone; sensors are taken one after the other.
    """
    n, wide = model.size, states.shape[1]
    driven = np.broadcast_to(driven.reshape(n, -1), (n, wide))
    noise = np.broadcast_to(noise.reshape(len(model.sensors), -1), (len(model.sensors), wide))
    step, outputs = along if along is not None else _prepared(model, theta, wide, windows.step)
    x, P = states, np.zeros((wide, n, n))
    P[:, range(n), range(n)] = known**2
    Q = np.zeros((wide, n, n))
    Q[:, range(n), range(n)] = (driven**2).T * (1.0 if model.period else windows.step)
    errors, variances = np.full((2, *windows.readings.shape[:2], wide), np.nan)
    u = windows.inputs[0]
    with np.errstate(all='ignore'):
        for k in range(len(windows.inputs) + 1):
            if k:
                x, slopes = step(k - 1, x, u)
                Phi = slopes[:, :, :n]
                P = Phi @ P @ np.swapaxes(Phi, 1, 2) + Q
            u = windows.inputs[min(k, len(windows.inputs) - 1)]
            if k % windows.every:
                continue
            j = k // windows.every
            y, slopes = outputs(j, x, u)
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
              ) -> Along:
    """Return the model's step and outputs at parameters; where it is linear, as matrices."""
    if not model.linear:
        return Along(lambda _, x, u: model.step(model.start(x), u, theta, h),
                     lambda _, x, u: model.outputs(model.start(x), u, theta))

    def matrices(run: Callable[[Moved, np.ndarray], Moved]) -> Run:
        at = model.start(np.zeros((model.size, wide)))
        idle = np.zeros((len(model.inputs), wide))
        value, slopes = run(at, idle)
        by_input = []
        for i in range(len(idle)):
            idle[i] = 1.0
            by_input.append(run(at, idle).value - value)
            idle[i] = 0.0

        def line(_: int, x: np.ndarray, u: np.ndarray) -> Moved:
            found = value + (slopes[:, :, :model.size] @ x.T[:, :, None])[:, :, 0].T
            for column, command in zip(by_input, u):
                found = found + column * command
            return Moved(found, slopes)
        return line
    return Along(matrices(lambda x, u: model.step(x, u, theta, h)),
                 matrices(lambda x, u: model.outputs(x, u, theta)))


def linearised(model: Model, windows: Windows, theta: np.ndarray, states: np.ndarray,
               times: int = 1) -> Along:
    """
    Return steps and outputs on straight lines about a simulation from states (N, W).

    times: for so many copies of the windows.
    """
    n, x = model.size, states
    steps, outputs = [], []
    with np.errstate(all='ignore'):
        for k in range(len(windows.inputs) + 1):
            u = windows.inputs[min(k, len(windows.inputs) - 1)]
            if k % windows.every == 0:
                outputs.append(_line(x, model.outputs(model.start(x), u, theta), n, times))
            if k < len(windows.inputs):
                moved = model.step(model.start(x), u, theta, windows.step)
                steps.append(_line(x, moved, n, times))
                x = moved.value
    return Along(lambda k, x, _: steps[k](x), lambda j, x, _: outputs[j](x))


def _line(about: np.ndarray, moved: Moved, n: int, times: int,
          ) -> Callable[[np.ndarray], Moved]:
    slopes = np.tile(moved.slopes[:, :, :n], (times, 1, 1))
    first = np.tile(moved.value, times) - (slopes @ np.tile(about, times).T[:, :, None])[:, :, 0].T
    return lambda x: Moved(first + (slopes @ x.T[:, :, None])[:, :, 0].T, slopes)

