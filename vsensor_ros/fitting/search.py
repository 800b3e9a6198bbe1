"""From recordings to parameters: starts, more and more of each window, weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.shooting import Shooting, Shot, Start
from vsensor_ros.fitting.windows import Windows

FEW = 24  # windows, and a third of each, by which several starts are compared
SHARES = (0.1, 0.3, 1.0)  # of a window that are simulated, one after the other
WEIGHED = 3  # times that misfits tell the deviations by which they are weighed
SEED = 1
Progress = Callable[[int, int, str], None] | None


@dataclass(frozen=True, eq=False)
class Found:
    """The problem as it was weighed at last, where it ended, and what it misses there."""

    shooting: Shooting
    start: Start
    shot: Shot
    costs: tuple[float, ...] = ()  # of each start that was compared, the file's first


def bounds_of(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return least and most of each parameter."""
    free = model.given.free
    return np.array([f.low for f in free]), np.array([f.high for f in free])


def first_states(model: Model, windows: Windows) -> np.ndarray:
    """Return where windows seem to begin (N, W): what the first readings tell, else the file."""
    plant = model.given.plant
    n, known = model.size, len(model.given.states)
    C = np.zeros((len(model.sensors), n))
    C[:, :known] = plant.C[:, :known]
    C[:, known:] = plant.Cd[:, [plant.disturbances.index(name) for name in model.unknown]]
    home = np.concatenate([plant.initial[:known], np.zeros(n - known)])
    drifting = model.offsets()
    C[:, drifting] = 0.0
    states = np.repeat(home[:, None], len(windows.run), axis=1)
    shown = model.outputs(model.start(states), windows.inputs[0], np.array(
        [f.value for f in model.given.free])).value
    for w in range(len(windows.run)):
        there = np.isfinite(windows.readings[0, :, w])
        states[:, w] += np.linalg.pinv(C[there]) @ (windows.readings[0, :, w] - shown[:, w])[there]
    return states


def first_deviations(model: Model, windows: Windows) -> np.ndarray:
    """Return by what each sensor's misfits are weighed at first (l,): a part of its motion."""
    moved = np.nanstd(windows.readings, axis=(0, 2))
    return np.where(np.isfinite(moved) & (moved > 0.0), 0.1 * moved, 1.0)


def offset_spreads(model: Model) -> np.ndarray:
    """Return by how much an offset (N,) may be off what the file has: half of half its range."""
    plant = model.given.plant
    widths = plant.ranges[:len(model.given.states), 1] - plant.ranges[:len(model.given.states), 0]
    return np.concatenate([widths / 4.0, np.full(len(model.unknown), np.inf)])


def search(model: Model, windows: Windows, theta: np.ndarray, tries: int = 5,
           progress: Progress = None) -> Found:
    """
    Find the parameters from `theta` and, in all, `tries` starts drawn between their bounds.

    The starts are compared on some windows' beginnings, and the best goes on to the whole; one
    alone needs no comparison.
    """
    few = windows.only(np.unique(np.linspace(0, len(windows.run) - 1, FEW).astype(int)))
    random = np.random.default_rng(SEED)
    bounds = bounds_of(model)
    begun, costs = [], []
    for i in range(tries if tries > 1 else 0):
        if progress is not None:
            progress(i, tries + 2, f'start {i + 1} of {tries}')
        point = theta if i == 0 else _drawn(random, *bounds)
        found = _grown(model, few, Start(point, first_states(model, few)), SHARES[:2], bounds)
        begun.append(found.start.theta)
        costs.append(found.shot.cost)
    best = begun[int(np.argmin(costs))] if begun else theta
    if progress is not None:
        progress(tries, tries + 2, 'whole windows')
    found = refined(_grown(model, windows, Start(best, first_states(model, windows)), SHARES,
                           bounds))
    return Found(found.shooting, found.start, found.shot, tuple(costs))


def refined(found: Found, most: int = 20) -> Found:
    """Go on with misfits weighed by their own sizes, sensor by sensor."""
    shooting, start, shot = found.shooting, found.start, found.shot
    for _ in range(WEIGHED):
        deviations = spread_of(shot.misfits, shooting.deviations)
        # what an unknown input does within a window is not in the simulation: starts that are held
        # by the noise put it into the parameters, from where the likelihood is not found
        noise = deviations if shooting.model.unknown else noise_in(shot.misfits, deviations)
        shooting = shooting.weighed(deviations, noise)
        start, shot = shooting.solve(start, bounds_of(shooting.model), most)
    return Found(shooting, start, shot, found.costs)


def spread_of(misfits: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the deviation of each sensor's misfits (l,), by their median size."""
    with np.errstate(all='ignore'):
        sizes = 1.4826 * np.array([np.median(np.abs(m[np.isfinite(m)])) if np.isfinite(m).any()
                                   else np.nan for m in np.moveaxis(misfits, 1, 0)])
    return np.where(np.isfinite(sizes), np.clip(sizes, 1e-6 * before, 1e6 * before), before)


def noise_in(misfits: np.ndarray, deviations: np.ndarray) -> np.ndarray:
    """Return the noise of sensors (l,): by what misfits differ from one reading to the next."""
    noise = spread_of(np.diff(misfits, axis=0), deviations) / np.sqrt(2.0)
    return np.minimum(noise, deviations)


def without(found: Found, out: np.ndarray, most: int = 8) -> Found:
    """Go on without some windows (W,), from where the whole fit ended."""
    shooting, start = found.shooting, found.start
    kept = replace(shooting, windows=shooting.windows.only(~out))
    return Found(kept, *kept.solve(Start(start.theta, start.states[:, ~out]),
                                   bounds_of(shooting.model), most))


def begun(model: Model, windows: Windows, theta: np.ndarray, deviations: np.ndarray) -> Start:
    """Find where windows begin, with the parameters known."""
    return _grown(model, windows, Start(theta, first_states(model, windows)), (0.3, 1.0),
                  bounds_of(model), deviations, hold=True).start


def _grown(model: Model, windows: Windows, start: Start, shares: Sequence[float],
           bounds: tuple[np.ndarray, np.ndarray], deviations: np.ndarray | None = None,
           hold: bool = False) -> Found:
    """Solve the beginnings of windows first, with the parameters held, and then more of them."""
    if deviations is None:
        deviations = first_deviations(model, windows)
    count = len(windows.readings)
    for i, share in enumerate(shares):
        seen = max(int(share * (count - 1)) + 1, min(count, 4))
        shooting = Shooting(model, windows.shorter(seen), deviations, offset_spreads(model))
        start, shot = shooting.solve(start, bounds, 8 if i == 0 else 20, hold or i == 0)
    return Found(shooting, start, shot)


def _drawn(random: np.random.Generator, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return a point between bounds; evenly by magnitude where these are positive and wide."""
    share = random.random(len(low))
    wide = (low > 0.0) & (high > 10.0 * low)
    with np.errstate(all='ignore'):
        scaled = np.exp(np.log(low) + share * (np.log(high) - np.log(low)))
    return np.where(wide, scaled, low + share * (high - low))
