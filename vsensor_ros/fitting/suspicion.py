"""What in a recording or in residuals speaks against a fit, as sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from vsensor_ros.fitting.windows import Windows

BACK = 3  # steps of the past by which a command is explained
GAIN = 0.2  # share of what a command's own past leaves that readings explain: closed loop
CARRIED = 1e-3  # share of a sensor's variance that commands do not explain: they carry it
LAGS = 20  # of residuals
SURE = 4.0  # deviations of a correlation
STRONG = 0.1  # correlation below which nothing is said


def loops(windows: Windows, sensors: Sequence[str], inputs: Sequence[str]) -> list[str]:
    """Say which commands are computed from sensors, and which sensors commands carry."""
    said = []
    y, every = windows.readings, windows.every
    # the mean command after each reading
    u = np.array([windows.inputs[j * every:(j + 1) * every].mean(axis=0)
                  for j in range(len(y) - 1)])
    if len(u) <= BACK + 1:
        return []
    for i, name in enumerate(inputs):
        now = np.concatenate([u[j, i] for j in range(BACK, len(u))])
        own = _columns([u[j - lag] for lag in range(1, BACK + 1)] for j in range(BACK, len(u)))
        seen = _columns([y[j - lag] for lag in range(BACK + 1)] for j in range(BACK, len(u)))
        alone, both = _left(own, now), _left(np.hstack([own, seen]), now)
        if alone > 1e-12 * float(np.var(now)) and both < (1.0 - GAIN) * alone:
            told = [(_left(np.hstack([own, seen[:, s::len(sensors)]]), now), sensor)
                    for s, sensor in enumerate(sensors)]
            said.append(f'{name} seems to be computed from {min(told)[1]} (closed loop): '
                        'parameters may be biased; excite it by what does not come from a sensor, '
                        'and do not give a virtual sensor what the controller was given')
    for i, name in enumerate(sensors):
        shown = np.concatenate(list(y[1:-1, i]))
        commands = _columns([u[j - 1], u[j]] for j in range(1, len(u)))
        there = np.isfinite(shown)
        if inputs and there.any() and _left(commands, shown) < CARRIED * np.nanvar(shown):
            said.append(f'{name} is told by the commands at the same time, but for '
                        f'{_left(commands, shown)**0.5:.2g}: one of {", ".join(inputs)} carries '
                        'it, such as the reference of a controller; leave that one out')
    return said


def _columns(rows: Iterable[Sequence[np.ndarray]]) -> np.ndarray:
    """Return regressors (.., columns) of lists of arrays (columns, W)."""
    return np.concatenate([np.concatenate(row).T for row in rows])


def _left(regressors: np.ndarray, of: np.ndarray) -> float:
    """Return the mean square that a regression with an offset leaves."""
    A = np.column_stack([regressors, np.ones(len(of))])
    whole = np.isfinite(A).all(axis=1) & np.isfinite(of)
    A, b = A[whole], of[whole]
    if len(b) <= 2 * A.shape[1]:
        return float('inf')
    size = np.abs(A).max(axis=0) + 1e-300
    rest = b - (A / size) @ np.linalg.lstsq(A / size, b, rcond=1e-12)[0]
    return float(np.mean(rest**2))


def residual_tests(residuals: np.ndarray, windows: Windows, sensors: Sequence[str],
                   inputs: Sequence[str]) -> list[str]:
    """
    Say where residuals of the next reading (J, l, W) are not white, or follow commands.

    Both are correlations over lags within a window, of SURE deviations and STRONG at least.
    """
    said = []
    every = windows.every
    last = len(windows.inputs) - 1
    u = np.array([windows.inputs[j * every:(j + 1) * every].mean(axis=0)
                  if j * every <= last else windows.inputs[last]
                  for j in range(len(residuals))])
    for i, sensor in enumerate(sensors):
        e = residuals[:, i]
        worst, lag = _largest(e, e, 1)
        if worst > 0.0:
            said.append(f'{sensor}: residuals are not white (correlation {worst:.2f} over '
                        f'{lag} readings): dynamics, or noise of a colour, are not in the model')
        for j, command in enumerate(inputs):
            worst, lag = _largest(e, u[:, j], 0)
            if worst > 0.0:
                said.append(f'{sensor}: residuals follow {command} (correlation {worst:.2f} '
                            f'after {lag} readings): what it does is not all in the model')
    return said


def _largest(e: np.ndarray, other: np.ndarray, first: int) -> tuple[float, int]:
    """Return the largest correlation of e (J, W) with an earlier `other`, and its lag."""
    best = 0.0, 0
    centred = other - np.nanmean(other)
    for lag in range(first, min(LAGS, len(e) // 2) + 1):
        a, b = e[lag:], centred[:len(e) - lag]
        there = np.isfinite(a) & np.isfinite(b)
        count = int(there.sum())
        if count < 30 or not a[there].any() or not b[there].any():
            continue
        like = abs(float(a[there] @ b[there]) / float(
            np.linalg.norm(a[there]) * np.linalg.norm(b[there])))
        if like > max(SURE / np.sqrt(count), STRONG, best[0]):
            best = like, lag
    return best
