"""Fit the free parameters of a plant file to recordings, and say how far the result is good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsensor_ros.fitting.held_out import crossed, lead_of, Predicted
from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.noise import found_noise, Noise
from vsensor_ros.fitting.search import (
    begun,
    bounds_of,
    first_states,
    Found,
    offset_spreads,
    Progress,
    search,
)
from vsensor_ros.fitting.suspicion import loops, residual_tests
from vsensor_ros.fitting.uncertainty import Known, known
from vsensor_ros.fitting.windows import averaging, check_channels, cut, usual_horizon, Windows
from vsensor_ros.plant.free import FreePlant
from vsensor_ros.recordings import Recording

FILTERED = 24  # windows at most by which noise is found
WHOLE = 4000  # steps of a recording that is filtered whole, at most
EQUAL = 1e-8  # of the largest step of a sensor: below, two readings differ by rounding alone
EVERYTHING = 10**9  # readings: more than any window has


@dataclass(frozen=True, eq=False)
class Fit:
    """
    What was found.

    values, spreads (P,): of the parameters; spreads are standard errors, or what leaving a part
    out moved a parameter by, where that is more. rates (l,): usual readings a second. next_error
    (l,): rms of the next reading less its
    prediction. held_out: predictions of parts by what was fitted to the others. said: sentences on
    what to mind.
    """

    model: Model
    horizon: float
    count: int
    folds: int
    values: np.ndarray
    spreads: np.ndarray
    known: Known
    noise: Noise
    rates: np.ndarray
    next_error: np.ndarray
    held_out: Predicted
    offsets: tuple[dict[str, float], ...]
    costs: tuple[float, ...]
    said: tuple[str, ...]


def fit(given: FreePlant, runs: Sequence[Recording], horizon: float | None = None,
        tries: int = 5, progress: Progress = None) -> Fit:
    """
    Fit a plant to recordings; horizon [s]: how long it is simulated, tries: starts of a search.

    Raises BadInput, one line, when a recording does not fit the plant.
    """
    model = Model(given)
    check_channels(runs, model, given.plant.name)
    length = usual_horizon(runs, model) if horizon is None else horizon
    windows = cut(runs, model, length)
    first = np.array([free.value for free in given.free])
    found = search(model, windows, first, tries, progress)
    theta, noise, long, states = _with_noise(model, runs, found, length, progress)
    lead = EVERYTHING if model.unknown else lead_of(long)
    followed = noise.follow(model, long, theta, states, lead)
    residuals = followed.errors[:lead]
    if progress is not None:
        progress(1, 2, 'without a part')
    moved, held = crossed(found)
    certain = known(found)
    spreads = np.maximum(certain.errors, np.abs(moved - found.start.theta).max(axis=0))
    drifting = np.flatnonzero(model.offsets())
    offsets = [{model.states[i]: float(found.start.states[i, np.argmax(windows.run == run)])
                for i in drifting} for run in np.unique(windows.run)]
    said = (*certain.said, *loops(windows, model.sensors, model.inputs),
            *residual_tests(residuals, long, model.sensors, model.inputs))
    with np.errstate(all='ignore'):
        next_error = np.sqrt(np.nanmean(residuals[1:]**2, axis=(0, 2)))
    of_readings = replace(noise, sensors=noise.sensors / averaging(runs, model, long))
    return Fit(model, windows.horizon, len(windows.run), len(moved), theta, spreads, certain,
               of_readings, _rates(runs, model), next_error, held, tuple(offsets), found.costs,
               said)


def _rates(runs: Sequence[Recording], model: Model) -> np.ndarray:
    """Return how many readings of each sensor (l,) usually come in a second."""
    between = [np.concatenate([np.diff(run.tracks[s].stamps) for run in runs])
               for s in model.sensors]
    return np.array([1e9 / np.median(there) for there in between])


def _with_noise(model: Model, runs: Sequence[Recording], found: Found, horizon: float,
                progress: Progress) -> tuple[np.ndarray, Noise, Windows, np.ndarray]:
    """Return parameters, noise, and the windows that told it with where these begin."""
    if progress is not None:
        progress(0, 1, 'noise')
    if model.unknown:
        long = _whole(model, runs)
    else:
        longest = min((max(t.stamps[-1] for t in run.tracks.values())
                       - min(t.stamps[0] for t in run.tracks.values())) * 1e-9 for run in runs)
        long = cut(runs, model, min(1.5 * horizon, 0.9 * longest))
        long = long.only(np.unique(np.linspace(0, len(long.run) - 1, FILTERED).astype(int)))
    states = first_states(model, long) if model.unknown else begun(
        model, long.shorter(lead_of(long)), found.start.theta, found.shooting.deviations).states
    guess = _guess(found)
    theta, noise = found_noise(
        model, long, found.start.theta, states, guess,
        EVERYTHING if model.unknown else lead_of(long), resolution(model, runs), model.told(),
        bounds_of(model) if model.unknown else None)
    return theta, noise, long, states


def _whole(model: Model, runs: Sequence[Recording]) -> Windows:
    """Return whole recordings as windows, of the length of the shortest."""
    ends = [min(int(t.stamps[-1]) for t in run.tracks.values())
            - max(int(t.stamps[0]) for t in run.tracks.values()) for run in runs]
    return cut(runs, model, min(ends) * 1e-9 * (1.0 - 1e-9), steps=WHOLE, nodes=WHOLE)


def _guess(found: Found) -> Noise:
    """Return noise to begin with: misfits come from the sensors, and by a tenth from states."""
    model, windows = found.shooting.model, found.shooting.windows
    moved = np.array([np.std(row) for row in found.start.states])
    drifting, spreads = model.offsets(), offset_spreads(model)
    shot = found.shot.misfits
    apart = np.nanstd(np.diff(shot, axis=0), axis=(0, 2)) / np.sqrt(2.0)
    sensors = np.where(np.isfinite(apart) & (apart > 0.0), apart, found.shooting.deviations)
    unknown = np.arange(model.size) >= len(model.given.states)
    known = np.where(drifting & np.isfinite(spreads), spreads, np.maximum(moved, 1e-9))
    share = np.where(drifting, 0.01, np.where(unknown, 0.1, 0.01))
    period = windows.step if model.period else 1.0
    driven = share * np.maximum(known, 1e-9) / np.sqrt(windows.horizon / period)
    told = model.told()
    given = np.zeros(model.size)
    given[:len(model.given.states)] = model.given.plant.process_noise[:len(model.given.states)]
    return Noise(np.where(told, given, np.maximum(driven, 1e-12)),
                 sensors, known)


def resolution(model: Model, runs: Sequence[Recording]) -> np.ndarray:
    """Return the noise of rounding (l,): the smallest step of what sensors said, over root 12."""
    found = []
    for name in model.sensors:
        steps = np.concatenate([np.abs(np.diff(run.tracks[name].values)) for run in runs
                                if name in run.tracks])
        steps = steps[steps > EQUAL * np.nanmax(steps, initial=0.0)]
        found.append(max(float(np.nanmin(steps)) if len(steps) else 0.0, 1e-15) / np.sqrt(12.0))
    return np.array(found)
