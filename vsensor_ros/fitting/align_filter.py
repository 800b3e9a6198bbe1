"""
A Kalman filter on the equations along windows, its smoother, and how its errors answer to causes.

What the next reading is off by, whitened, is white where model, noise and delays are right. A
cause, as a delay, a gain that is off, a parameter, moves readings, commands or rates a little; the
filter is linear about where it is, so what a cause does to the errors is what the same filter
makes of these movements alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsensor_ros.fitting.align_windows import Nodes
from vsensor_ros.fitting.model import Model

TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Filtered:
    """
    A filter's way through W windows of T steps.

    errors, sizes (T + 1, l, W): of each reading less its prediction, and its deviation; gains
    (T + 1, l, W, n); shown (T + 1, W, l, n + P): slopes of what is shown; moved (T, W, n, n + P):
    slopes of steps; pushed (T, W, n, m): by commands. before, after: states (T + 1, n, W) and
    covariances (T + 1, W, n, n).
    """

    errors: np.ndarray
    sizes: np.ndarray
    gains: np.ndarray
    shown: np.ndarray
    moved: np.ndarray
    pushed: np.ndarray
    before: tuple[np.ndarray, np.ndarray]
    after: tuple[np.ndarray, np.ndarray]


def filtered(model: Model, nodes: Nodes, readings: np.ndarray, states: np.ndarray,
             known: np.ndarray, driven: np.ndarray, noise: np.ndarray,
             pushes: bool = True) -> Filtered:
    """
    Filter windows from states (N, W) on, known to deviations (N,).

    readings (T + 1, l, W): those of the nodes, or corrected. driven (N,), noise (l,): deviations
    of noise, per sqrt(s) or per step; of readings. pushes: what commands do is asked for, too.
    """
    theta = np.array([f.value for f in model.given.free])
    steps, sensors, width = len(nodes.commands), len(model.sensors), states.shape[1]
    n, inputs, size = model.size, len(model.inputs), model.size + len(theta)
    errors, sizes = np.full((2, steps + 1, sensors, width), np.nan)
    gains = np.zeros((steps + 1, sensors, width, n))
    shown = np.zeros((steps + 1, width, sensors, size))
    moved, pushed = np.zeros((steps, width, n, size)), np.zeros((steps, width, n, inputs))
    means, covariances = np.zeros((2, steps + 1, n, width)), np.zeros((2, steps + 1, width, n, n))
    Q = np.diag(driven**2 * (1.0 if model.period else nodes.step))
    x, P = states, np.tile(np.diag(known**2), (width, 1, 1))
    small = 1e-6 * np.maximum(np.abs(nodes.commands).max(axis=(0, 2), initial=0.0), 1.0)
    with np.errstate(all='ignore'):
        for k in range(steps + 1):
            u = nodes.commands[min(k, steps - 1)]
            means[0, k], covariances[0, k] = x, P
            y, shown[k] = model.outputs(model.start(x), u, theta)
            H = shown[k][:, :, :n]
            value = x
            for i in range(sensors):
                row = H[:, i]
                gain = (P @ row[:, :, None])[:, :, 0]
                variance = (gain * row).sum(axis=1) + noise[i]**2
                off = readings[k, i] - y[i] - (row.T * (value - x)).sum(axis=0)
                read = np.isfinite(off)
                gain = np.where(read[:, None], gain / variance[:, None], 0.0)
                errors[k, i], sizes[k, i] = off, np.sqrt(variance)
                value = value + gain.T * np.where(read, off, 0.0)
                P = P - gain[:, :, None] * gain[:, None, :] * variance[:, None, None]
                gains[k, i] = gain
            x = value
            means[1, k], covariances[1, k] = x, P
            if k < steps:
                if pushes:  # each command a little larger, beside what is
                    more = np.repeat(u[:, None], inputs + 1, axis=1)
                    more[range(inputs), range(1, inputs + 1)] += small[:, None]
                    ahead, slopes = model.step(model.start(np.tile(x, inputs + 1)), more.reshape(
                        inputs, -1), theta, nodes.step)
                    x, moved[k] = ahead[:, :width], slopes[:width]
                    aside = ahead[:, width:].reshape(n, inputs, width) - x[:, None]
                    pushed[k] = (aside / small[:, None]).transpose(2, 0, 1)
                else:
                    x, moved[k] = model.step(model.start(x), u, theta, nodes.step)
                Phi = moved[k][:, :, :n]
                P = Phi @ P @ np.swapaxes(Phi, 1, 2) + Q
    return Filtered(errors, sizes, gains, shown, moved, pushed, (means[0], covariances[0]),
                    (means[1], covariances[1]))


@dataclass(frozen=True, eq=False)
class Smoothed:
    """States (T + 1, n, W) by all readings, their variances, and what drove them (n,) a step."""

    states: np.ndarray
    covariances: np.ndarray
    driven: np.ndarray


def smoothed(way: Filtered) -> Smoothed:
    """Go back (Rauch, Tung and Striebel), and tell the noise of states as one step of EM does."""
    (ahead, wide), (states, P) = way.before, way.after
    xs, Ps = states.copy(), P.copy()
    n = states.shape[1]
    total, count = np.zeros(n), 0
    for k in range(len(way.moved) - 1, -1, -1):
        Phi = way.moved[k][:, :, :n]
        scale = np.sqrt(np.maximum(np.einsum('wii->wi', wide[k + 1]), TINY))
        even = wide[k + 1] / scale[:, :, None] / scale[:, None, :] + 1e-12 * np.eye(n)
        J = np.swapaxes(np.linalg.solve(even, Phi @ P[k] / scale[:, :, None])
                        / scale[:, :, None], 1, 2)
        gone = (xs[k + 1] - ahead[k + 1]).T
        back = (J @ gone[:, :, None])[:, :, 0]
        xs[k] = states[k] + back.T
        Ps[k] = P[k] + J @ (Ps[k + 1] - wide[k + 1]) @ np.swapaxes(J, 1, 2)
        jump = gone - (Phi @ back[:, :, None])[:, :, 0]
        cross = np.einsum('wij,wjk,wki->wi', Phi, J, Ps[k + 1])
        total += (jump**2 + np.einsum('wii->wi', Ps[k + 1]) - 2.0 * cross + np.einsum(
            'wij,wjk,wik->wi', Phi, Ps[k], Phi)).sum(axis=0)
        count += len(jump)
    return Smoothed(xs, Ps, np.sqrt(np.maximum(total / count, TINY)))


def answers(way: Filtered, readings: np.ndarray, rates: np.ndarray,
            outputs: np.ndarray) -> np.ndarray:
    """
    Return what causes do to the errors, (T + 1, l, W, c), each by its size.

    readings (T + 1, W, l, c): what a cause adds to readings; rates (T, W, n, c): to the next
    states; outputs (T + 1, W, l, c): to what is shown.
    """
    steps, sensors = len(way.moved), way.errors.shape[1]
    n = way.gains.shape[3]
    found = np.zeros((*way.errors.shape, readings.shape[3]))
    dx = np.zeros((way.errors.shape[2], n, readings.shape[3]))
    for k in range(steps + 1):
        for i in range(sensors):
            off = readings[k][:, i] - outputs[k][:, i] - np.einsum(
                'wn,wnc->wc', way.shown[k][:, i, :n], dx)
            found[k, i] = off
            dx = dx + way.gains[k, i][:, :, None] * off[:, None, :]
        if k < steps:
            dx = way.moved[k][:, :, :n] @ dx + rates[k]
    return found
