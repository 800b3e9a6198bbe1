"""
An extended Kalman filter along windows: how likely what the sensors said is, given the noises.

Each state is driven by white noise, an unknown input is a random walk, and what a sensor says has
noise. In the first part of a window, the lead, the filter reads; then all sensors are lost, and it
goes on alone. All windows are filtered at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.windows import Windows

LEAST = 1e-12  # of a variance, relative: nothing is known better


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
    x, P = model.start(states), np.zeros((wide, n, n))
    P[:, range(n), range(n)] = known**2
    Q = np.zeros((wide, n, n))
    Q[:, range(n), range(n)] = (driven**2).T * (1.0 if model.period else windows.step)
    errors, variances = np.full((2, *windows.readings.shape[:2], wide), np.nan)
    u = windows.inputs[0]
    with np.errstate(all='ignore'):
        for k in range(len(windows.inputs) + 1):
            if k:
                x = model.step(model.start(x.value), u, theta, windows.step)
                Phi = x.slopes[:, :, :n]
                P = Phi @ P @ np.swapaxes(Phi, 1, 2) + Q
            u = windows.inputs[min(k, len(windows.inputs) - 1)]
            if k % windows.every:
                continue
            j = k // windows.every
            y = model.outputs(model.start(x.value), u, theta)
            H = y.slopes[:, :, :n]
            misfit = y.value - windows.readings[j]
            errors[j] = misfit
            variances[j] = np.einsum('wln,wnm,wlm->lw', H, P, H) + noise**2
            if j >= lead:
                continue
            value = x.value
            for i in range(len(model.sensors)):
                row = H[:, i]
                gain = np.einsum('wnm,wm->wn', P, row)
                size = np.einsum('wn,wn->w', gain, row) + noise[i]**2
                off = misfit[i] + np.einsum('wn,nw->w', row, value - x.value)
                read = np.isfinite(off)
                gain = np.where(read[:, None], gain / size[:, None], 0.0)
                value = value - gain.T * np.where(read, off, 0.0)
                P = P - gain[:, :, None] * gain[:, None, :] * size[:, None, None]
            x = x._replace(value=value)
    return Followed(errors, variances)


def unlikelihood(followed: Followed, first: int) -> np.ndarray:
    """Return the mean negative log-likelihood a reading of each window (W,), from `first` on."""
    errors, variances = followed.errors[first:], followed.variances[first:]
    each = np.log(variances) + errors**2 / variances
    there = np.isfinite(errors)
    count = np.maximum(there.sum(axis=(0, 1)), 1)
    total = np.where(there, each, 0.0).sum(axis=(0, 1)) / (2 * count)
    return np.where(np.isfinite(total), total, 1e9)
