"""A plant file from recordings alone: a linear model whose states mean nothing in physics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import json

import numpy as np
from scipy.linalg import logm, solve_discrete_lyapunov

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.first_plant.subspace import arx, arx_errors, Linear, Run, subspace
from vsensor_ros.functions.expression import check_name
from vsensor_ros.recordings import Recording

Progress = Callable[[int, int, str], None] | None

MEMORY = 20  # steps in the time in which half of what sensors said is forgotten
PAST = 20  # steps from which the next reading is told, at most
ENOUGH = 10  # rows for each number that is found
ORDERS = range(1, 9)  # that `auto` compares
AS_GOOD = 1.05  # times the least error: fewer states are taken then
HELD_OUT = 1 / 3  # of each recording, its end
PHASES = 10  # grids beside each other, at most
DIGITS = 9


@dataclass(frozen=True, eq=False)
class BlackBox:
    """
    A model of channels in deviations from their means, in units of their own spreads.

    ahead: steps after which it was judged on the end of the recordings, by a model of their
    beginning; plant, arx, held (len(ahead), l): rms errors in the units of the sensors.
    """

    model: Linear
    step: float
    commands: tuple[str, ...]
    sensors: tuple[str, ...]
    means: np.ndarray  # (m + l,)
    spreads: np.ndarray  # (m + l,)
    units: dict[str, str]
    ahead: tuple[int, ...]
    plant: np.ndarray
    arx: np.ndarray
    held: np.ndarray


def black_box(runs: Sequence[Recording], commands: Sequence[str], order: int | None = None,
              step: float | None = None, direct: bool = False,
              progress: Progress = None) -> BlackBox:
    """
    Find a model of so many states; all channels that are no commands are sensors.

    order: without it the least that is as good as any on what was held out. step: of the model
    [s]; without it a twentieth of what the sensors remember. direct: sensors may show commands at
    once. Raises BadInput, one line.
    """
    sensors = _sensors(runs, commands)
    names = (*commands, *sensors)
    usual = min(float(np.median(np.diff(run.tracks[n].times))) for run in runs for n in sensors)
    stride = max(1, round((step or _memory(runs, sensors) / MEMORY) / usual))
    short = BadInput(runs[0].name or 'recording', '', 'is too short for steps of '
                     f'{stride * usual:g} s', 'record for longer, or give a smaller --step')
    if stride * usual * 3 * MEMORY > max(run.seconds for run in runs):
        raise short
    grids = [_grid(run, commands, sensors, usual, stride) for run in runs]
    whole = np.concatenate([np.hstack(phase) for grid in grids for phase in grid])
    means, spreads = whole.mean(axis=0), whole.std(axis=0)
    if not (spreads > 0.0).all():
        raise BadInput(names[int(np.argmin(spreads))], '', 'never changes in the recordings',
                       'leave it out of the columns of the dataset')
    m = len(commands)

    def scaled(u: np.ndarray, y: np.ndarray) -> Run:
        return (u - means[:m]) / spreads[:m], (y - means[m:]) / spreads[m:]
    phases = [[scaled(*phase) for phase in grid] for grid in grids]
    first = [(u[:_split(u)], y[:_split(u)]) for grid in phases for u, y in grid]
    last = [(u[_split(u):], y[_split(u):]) for grid in phases for u, y in grid]
    past = _past(first, len(names), stride)
    ahead = (1, MEMORY // 2, MEMORY)
    if min(len(y) for _, y in last) <= 2 * MEMORY:
        raise short
    found = {}
    for n in ORDERS if order is None else (order,):
        if n <= past * len(sensors) and n <= past:
            if progress is not None:
                progress(n, max(ORDERS), f'{n} states')
            found[n] = _rms([subspace(first, n, past, direct).errors(run, ahead) for run in last])
    if not found:
        raise BadInput('--black-box', '', f'{order} states are too many for this recording',
                       f'give at most {past}')
    sizes = {n: float(np.sqrt(np.mean(errors**2))) for n, errors in found.items()}
    best = min(n for n, size in sizes.items() if size <= AS_GOOD * min(sizes.values()))
    weights = arx(first, best, direct)
    every = [run for grid in phases for run in grid]
    kept = [_held_errors(y, ahead) for _, y in last]
    of_sensors = spreads[m:]
    return BlackBox(subspace(every, best, past, direct), stride * usual, tuple(commands), sensors,
                    means, spreads, {n: u for run in runs for n, u in run.units.items()}, ahead,
                    found[best] * of_sensors, _rms([arx_errors(
                        weights, best, run, ahead) for run in last]) * of_sensors,
                    _rms(kept) * of_sensors)


def _sensors(runs: Sequence[Recording], commands: Sequence[str]) -> tuple[str, ...]:
    for run in runs:
        for name in commands:
            if name not in run.tracks:
                raise BadInput('--commands', '', f'{shown(name)} is not in {run.name}',
                               f'its channels are {", ".join(run.tracks)}')
    found = tuple(n for n in runs[0].tracks if n not in commands and all(
        n in run.tracks for run in runs))
    if not found:
        raise BadInput('--commands', '', 'no channel is left for a sensor',
                       'name those only that are commands')
    for name in (*commands, *found):
        check_name(name, runs[0].name or 'recording', name)
    return found


def _memory(runs: Sequence[Recording], sensors: Sequence[str]) -> float:
    """Return in what time the mean square of sensors' changes is their variance, median [s]."""
    found = []
    for run in runs:
        for name in sensors:
            track = run.tracks[name]
            grid = np.linspace(track.times[0], track.times[-1], 4000)
            values = track.at(grid)
            lags = np.unique(np.geomspace(1, 500, 60).astype(int))
            changed = [np.mean((values[lag:] - values[:-lag])**2) >= values.var() for lag in lags]
            lag = int(lags[int(np.argmax(changed))]) if any(changed) else 500
            found.append(lag * (grid[1] - grid[0]))
    return float(np.median(found))


def _grid(run: Recording, commands: Sequence[str], sensors: Sequence[str], usual: float,
          stride: int) -> list[Run]:
    """Return commands, in the mean of each step, and readings at its beginning, on some grids."""
    tracks = [run.tracks[n] for n in (*commands, *sensors)]
    first, last = max(t.times[0] for t in tracks), min(t.times[-1] for t in tracks[len(commands):])
    times = first + usual * np.arange(int((last - first) / usual + 1e-6) + 1)
    stamps = run.origin + np.rint(times * 1e9).astype(np.int64)
    u = np.array([run.tracks[n].held(stamps) for n in commands]).reshape(-1, len(times)).T
    y = np.array([run.tracks[n].at(times) for n in sensors]).T
    summed = np.vstack([np.zeros(u.shape[1]), np.cumsum(u, axis=0)])
    found = []
    for phase in np.unique(np.linspace(0, stride, PHASES, endpoint=False).astype(int)):
        rows = np.arange(phase, len(times) - stride + 1, stride)
        found.append(((summed[rows + stride] - summed[rows]) / stride, y[rows]))
    return found


def _split(values: np.ndarray) -> int:
    return int(len(values) * (1.0 - HELD_OUT))


def _past(runs: Sequence[Run], width: int, stride: int) -> int:
    rows = sum(len(u) for u, _ in runs) / min(stride, PHASES)
    return int(max(2, min(PAST, rows / (ENOUGH * width))))


def _held_errors(y: np.ndarray, ahead: Sequence[int]) -> np.ndarray:
    found = np.full((len(ahead), *y.shape), np.nan)
    for i, k in enumerate(ahead):
        found[i, k:] = y[:-k] - y[k:]
    return found


def _rms(errors: Sequence[np.ndarray]) -> np.ndarray:
    """Return the rms (len(ahead), l), without the first steps, in which a state is found."""
    return np.asarray(np.sqrt(np.nanmean(np.concatenate(
        [e[:, MEMORY:] for e in errors], axis=1)**2, axis=1)))


def box_text(box: BlackBox, name: str, of: str) -> str:
    """Return the plant file; of: what the model is of."""
    model, m = box.model, len(box.commands)
    A, B, C, D, driven, noise = _with_noise(model)
    A, B, time = _continuous(A, B, box.step)
    driven = driven / np.sqrt(box.step) if time == 'continuous' else driven
    U, Y = box.spreads[:m], box.spreads[m:]
    B, C, D = B / U, C * Y[:, None], D * Y[:, None] / U
    shift = np.linalg.solve(A if time == 'continuous' else A - np.eye(len(A)), B @ box.means[:m])
    # the states that belong to the means: - shift in deviations from them
    offset = box.means[m:] + C @ shift - D @ box.means[:m]
    states = _state_names(len(A), box)
    lines = [*(f'# {line}'.rstrip() for line in box_lines(box, of)), f'name: {name}',
             f'description: Black box of {len(A)} states, which mean nothing in physics.',
             f'time: {time}', 'states:']
    lines += [f'  {s}: {{initial: {-z:.6g}, process_noise: {q:.3g}}}'
              for s, z, q in zip(states, shift, driven)]
    if m:
        lines += ['inputs:', *(f'  {u}: {{operating: {mean:.6g}{_unit(box, u)}}}'
                               for u, mean in zip(box.commands, box.means))]
    lines += ['dynamics:', *(f'  {s}: {_sum(row, (*states, *box.commands))}'
                             for s, row in zip(states, np.hstack([A, B])))]
    lines += ['sensors:', *(
        f'  {y}: {{measures: {_sum(row, (*states, *box.commands), mean)}, noise: {size:.3g}'
        f'{_unit(box, y)}}}' for y, row, mean, size in zip(
            box.sensors, np.hstack([C, D]), offset, noise * Y))]
    return '\n'.join(lines) + '\n'


def box_lines(box: BlackBox, of: str) -> list[str]:
    """Return what is to be known of a model."""
    seconds = [f'{k * box.step:.3g} s' for k in box.ahead]
    lines = [f'Black box of {of}, by the command start: {len(box.model.A)} states, found in steps '
             f'of {box.step:g} s.', 'Its states mean nothing, and it holds only for what was '
             'recorded: the same commands, the same load.', '',
             'rms error on the last third, predicted by what was fitted to the rest',
             f'{"sensor":<14} ' + ' '.join(f'{s:>10}' for s in seconds)
             + f' {"held":>10} {"ARX":>10}   ({seconds[-1]})']
    for i, name in enumerate(box.sensors):
        lines.append(f'{name:<14} ' + ' '.join(f'{v:>10.3g}' for v in (
            *box.plant[:, i], box.held[-1, i], box.arx[-1, i])))
    return lines


def _with_noise(model: Linear) -> tuple[np.ndarray, ...]:
    """
    Return A, B, C, D, and deviations of noise on states (n,) and sensors (l,), independent.

    A filter on these has about the gain K: of the errors' covariance, C P C' is what states are
    uncertain by. States are turned so that what drives them is independent, and of spread 1.
    """
    A, B, C, D, K, R = model.A, model.B, model.C, model.D, model.K, model.R
    gain = np.linalg.lstsq(A, K, rcond=1e-9)[0]
    G = gain @ R  # P C'
    own = (C @ G + (C @ G).T) / 2.0
    noise = np.clip(np.diag(R - own), 0.02 * np.diag(R), None)
    P = G @ np.linalg.pinv(own, rcond=1e-6, hermitian=True) @ G.T
    P = (P + P.T) / 2.0
    Q = P - A @ P @ A.T + K @ R @ K.T
    sizes, turn = np.linalg.eigh((Q + Q.T) / 2.0)
    driven = np.sqrt(np.clip(sizes, 1e-4 * max(sizes.max(), 1e-300), None))
    spread = solve_discrete_lyapunov(A, B @ B.T + K @ R @ K.T)  # where commands are white
    scale = np.diag(turn.T @ spread @ turn)
    scale = np.sqrt(np.where(scale > 0.0, scale, 1.0))
    T, back = turn * scale, (turn / scale).T
    return back @ A @ T, back @ B, C @ T, D, driven / scale, np.sqrt(noise)


def _continuous(A: np.ndarray, B: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray, str]:
    """Return A and B per second, where there is such a system, else as they are; and the time."""
    n, m = B.shape
    values = np.linalg.eigvals(A)
    if ((values.real <= 0.0) & (np.abs(values.imag) < 1e-9)).any():
        return A, B, f'{{sample_time: {step!r}}}'
    whole = np.real(logm(np.block([[A, B], [np.zeros((m, n)), np.eye(m)]]))) / step
    return whole[:n, :n], whole[:n, n:], 'continuous'


def _state_names(count: int, box: BlackBox) -> list[str]:
    taken = {*box.commands, *box.sensors}
    letter = next(c for c in ('x', 'z', 'state', 'box_state') if not any(
        f'{c}{i + 1}' in taken for i in range(count)))
    return [f'{letter}{i + 1}' for i in range(count)]


def _sum(row: np.ndarray, names: Sequence[str], offset: float = 0.0) -> str:
    parts = [f'{offset:.{DIGITS}g}'] if offset else []
    parts += [f'{value:.{DIGITS}g}*{name}' for value, name in zip(row, names) if value]
    return ' + '.join(parts).replace('+ -', '- ') or '0'


def _unit(box: BlackBox, name: str) -> str:
    unit = box.units.get(name, '')
    return f', unit: {json.dumps(unit, ensure_ascii=False)}' if unit else ''
