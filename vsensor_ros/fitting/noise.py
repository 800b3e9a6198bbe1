"""
How noisy sensors and states are: what makes a recording most likely, see `follow`.

Noise is judged by the next reading, and by what the filter is off by when all sensors were lost:
a third, two thirds and a whole horizon after. A plant with an unknown input is judged by the next
reading alone, over whole recordings, and its parameters are found with the noise: what the unknown
input did is not to be told from what they did by a simulation, since it does not stay what it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from vsensor_ros.fitting.follow import follow, Followed, linearised
from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.windows import Windows

BURN = 10  # readings at a start that are not judged
SMALL = 1e-4  # of a logarithm, for slopes
LONG = {'maxiter': 200, 'ftol': 1e-10}  # of the search with parameters, which are correlated
SHORT = {'maxiter': 30, 'ftol': 1e-6}  # of noise alone
WIDE = np.log(1e3)  # how far a noise may be from its guess


@dataclass(frozen=True, eq=False)
class Noise:
    """
    What a filter takes for granted.

    driven (N,): noise on the states, per sqrt(s) or per step; sensors (l,): their noise; known
    (N,): how well a start is known. All are standard deviations.
    """

    driven: np.ndarray
    sensors: np.ndarray
    known: np.ndarray

    def follow(self, model: Model, windows: Windows, theta: np.ndarray, states: np.ndarray,
               lead: int) -> Followed:
        """Filter windows with it."""
        return follow(model, windows, theta, states, self.known, self.driven, self.sensors, lead)


def found_noise(model: Model, windows: Windows, theta: np.ndarray, states: np.ndarray,
                guess: Noise, lead: int, least: np.ndarray, kept: np.ndarray,
                bounds: tuple[np.ndarray, np.ndarray] | None = None) -> tuple[np.ndarray, Noise]:
    """
    Return parameters and the likeliest noise; without bounds parameters stay what they are.

    states (N, W): where windows begin; lead: readings that the filter takes; the rest is lost;
    least (l,): noise of sensors that they have for certain; kept (N,): states whose noise is told.
    """
    moving = len(theta) if bounds is not None else 0
    n, wide = model.size, states.shape[1]
    first = np.concatenate([np.zeros(moving), np.log(guess.driven), np.log(guess.sensors)])
    limits = [(value - WIDE * free, value + WIDE * free)
              for value, free in zip(first[moving:], [*~kept, *np.ones(len(guess.sensors), bool)])]
    limits[n:] = [(max(low, np.log(floor)), max(high, np.log(floor)))
                  for (low, high), floor in zip(limits[n:], least)]
    low, high = bounds if bounds is not None else (theta, theta)
    scale = np.where(theta != 0.0, np.abs(theta), 0.1 * (high - low))
    if bounds is not None:
        limits = [*zip((low - theta) / scale, (high - theta) / scale), *limits]

    def to_theta(z: np.ndarray) -> np.ndarray:
        moved = theta[:, None] + np.zeros((1, z.shape[1]))
        return moved + scale[:, None] * z[:moving] if moving else moved

    # what parameters do stays what it is while these do
    along = None if moving or model.linear else linearised(
        model, windows, theta, states, len(first) + 1)

    def unlikely(z: np.ndarray) -> tuple[float, np.ndarray]:
        points = z[:, None] + SMALL * np.eye(len(z), len(z) + 1, 1)
        count = points.shape[1]
        every = np.repeat(points, wide, axis=1)
        many = _repeated(windows, count)
        done = follow(model, many, to_theta(every), np.tile(states, count), guess.known,
                      np.exp(every[moving:moving + n]), np.exp(every[moving + n:]), lead, along)
        values = _unlikelihood(done, lead).reshape(count, wide).mean(axis=1)
        return float(values[0]), (values[1:] - values[0]) / SMALL
    z = minimize(unlikely, first, jac=True, bounds=limits, method='L-BFGS-B',
                 options=LONG if moving else SHORT).x
    return to_theta(z[:, None])[:, 0], Noise(np.exp(z[moving:moving + n]), np.exp(z[moving + n:]),
                                             guess.known)


def _repeated(windows: Windows, count: int) -> Windows:
    return replace(windows, inputs=np.tile(windows.inputs, (1, 1, count)),
                   readings=np.tile(windows.readings, (1, 1, count)),
                   run=np.tile(windows.run, count), starts=np.tile(windows.starts, count))


def _unlikelihood(done: Followed, lead: int) -> np.ndarray:
    """Return the negative log-likelihood a reading of each window (W,)."""
    with np.errstate(all='ignore'):
        each = 0.5 * (np.log(done.variances) + done.errors**2 / done.variances)
    each = np.where(np.isfinite(done.errors), np.nan_to_num(each, nan=1e6, posinf=1e6), np.nan)
    last = len(each) - 1
    total = _mean(each[min(BURN, lead // 2):lead])
    if last > lead:
        ages = np.rint(lead + (last - lead) * np.array([1.0, 2.0, 3.0]) / 3.0).astype(int)
        total = total + _mean(each[ages])
    return total


def _mean(each: np.ndarray) -> np.ndarray:
    there = np.isfinite(each)
    return np.where(there, each, 0.0).sum(axis=(0, 1)) / np.maximum(there.sum(axis=(0, 1)), 1)
