"""Runs of a virtual sensor beside the true plant, and pictures of them, for the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import io
import re
from typing import Any
import warnings

import numpy as np

from vsensor_ros.bank import Bank
from vsensor_ros.observers import Design, VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.simulate import simulate
from vsensor_ros.simulate.simulate import readings

STEPS = 800  # of a run of a continuous plant
LONGEST = 2000  # steps of a run of a discrete one
SHOWN = 10.0  # time constants of the virtual sensor
GROWTH = 10.0  # time constants of a plant that runs away
TOO_STIFF = 3e4  # of the plant's fastest mode in a run
MOST_LOOKS = 200_000  # at the plant in a run
OFFSET = 0.5  # wrong start, of the size of each state
PUSH = 0.3  # of the size of each state, what a disturbance does within a time constant
SWING = 1.0  # the same of a command
STEP_AT, WAVE_AT = 0.25, 0.6  # of a run, in which the disturbance is a step, then a wave
TRUTH, ESTIMATE, PROVED = '#a8a8a8', '#1f5fbf', '#2a7f3a'


class NotRun(Exception):
    """A run that cannot be shown; str() is one sentence."""


@dataclass(frozen=True, eq=False)
class Run:
    """One run, without sensor noise; all arrays (T,), values in the channel's unit."""

    time: np.ndarray  # s
    truth: np.ndarray
    estimate: np.ndarray
    rho: np.ndarray  # (T, d)
    still: np.ndarray  # the truth without rho

    @property
    def error(self) -> np.ndarray:
        """Return truth - estimate."""
        return self.truth - self.estimate


def from_wrong_start(plant: Plant, design: Design, entry: VirtualSensor) -> Run:
    """Run from a start that is not the one the virtual sensor believes in; raise NotRun."""
    start = np.array(plant.operating_point)
    if np.allclose(start, plant.initial):
        generic = 1.0 + 0.15 * (np.arange(len(start)) % 5)  # hidden from no functional
        start = plant.initial + OFFSET * _sizes(plant) * generic
        low, high = plant.ranges.T
        start = np.clip(start, low, high)
    return _run(plant, design, entry, start, np.zeros(len(plant.disturbances)))


def disturbed(plant: Plant, design: Design, entry: VirtualSensor) -> Run:
    """Run with every unknown input at once, a step that becomes a wave; raise NotRun."""
    tau, sizes = 1.0 / _mean_rate(plant), _sizes(plant)
    if plant.sample_time is not None:
        tau = max(1.0, tau / plant.sample_time)
    push = np.abs(plant.D) * tau / sizes[:, None]
    most = push.max(axis=0, initial=0.0)
    return _run(plant, design, entry, plant.initial,
                np.where(most > 0, PUSH / np.where(most > 0, most, 1.0), 1.0))


def _run(plant: Plant, design: Design, entry: VirtualSensor, start: np.ndarray,
         push: np.ndarray) -> Run:
    if len(entry.Cv) > 1:
        raise NotRun('it has several rows')
    period, count = _grid(plant, entry)
    time = np.arange(count) * period * 1e-9
    begin, wave = (time[round(part * (count - 1))] for part in (STEP_AT, WAVE_AT))
    angular = 2.0 * np.pi * 3.0 / max(time[-1] - wave, time[-1] * 1e-6)
    looks = 0

    def rho(t: float) -> np.ndarray:
        nonlocal looks
        looks += 1
        if looks > MOST_LOOKS:
            raise NotRun('the plant takes too long to simulate')
        # a millionth of a step early, so that a discrete plant is pushed in the step itself
        return push * (0.0 if t < begin - 1e-6 * time[1] else 1.0 if t < wave else
                       np.cos(angular * (t - wave)))

    on = np.cos(4.0 * np.pi * time / time[-1] + 1.0) > 0
    inputs = plant.operating_input + _swing(plant) * np.where(on, 1.0, 0.0)[:, None]
    x = _states(plant, time, inputs, rho, start)
    looks = 0
    unknown = np.array([rho(t) for t in time]).reshape(count, len(push))
    y = readings(plant, time, x, inputs, unknown)
    truth = _value(plant, entry, x, y)
    still = truth
    if push.any():
        looks = 0
        x = _states(plant, time, inputs, lambda t: 0.0 * rho(t), start)
        still = _value(plant, entry, x, readings(plant, time, x, inputs))
    return Run(time, truth, _estimates(plant, design, entry, period, y, inputs), unknown, still)


def _states(plant: Plant, time: np.ndarray, inputs: np.ndarray,
            rho: Callable[[float], np.ndarray], start: np.ndarray) -> np.ndarray:
    """Simulate the plant, with a step of rho at STEP_AT; (T, n)."""
    first = round(STEP_AT * (len(time) - 1))
    try:
        with np.errstate(all='ignore'), warnings.catch_warnings():
            warnings.simplefilter('ignore')  # what becomes infinite is said below
            x = simulate(plant, time[:first + 1], inputs[:first + 1], rho, start)
            x = np.vstack([x[:-1], simulate(plant, time[first:], inputs[first:], rho, x[-1])])
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        raise NotRun(f'the plant cannot be simulated ({str(error)[:100]})') from error
    if not np.isfinite(x).all():
        raise NotRun('the plant itself runs away')
    return x


def _value(plant: Plant, entry: VirtualSensor, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return what the channel is in fact, (T,)."""
    if entry.channel in plant.sensors:
        return y[:, plant.sensors.index(entry.channel)]
    rows = [plant.sensors.index(name) for name in entry.healthy]  # v = V x, by (E3)
    return np.asarray(x @ (entry.Cv @ entry.Phi + entry.Q @ plant.C[rows])[0])


def _estimates(plant: Plant, design: Design, entry: VirtualSensor, period: int, y: np.ndarray,
               inputs: np.ndarray) -> np.ndarray:
    """Return what the replacer's bank makes of the readings, (T,); NaN where it says nothing."""
    alone = replace(design, entries={(entry.fault_set, entry.channel): entry})
    try:
        bank = Bank(alone, 1e9 / period)
    except ValueError as problem:
        raise NotRun(str(problem)) from problem
    columns = [(name, y[:, plant.sensors.index(name)]) for name in entry.healthy]
    columns += list(zip(plant.inputs, inputs.T))
    said = []
    for k in range(len(y)):
        for name, column in columns:
            bank.take(name, k * period, float(column[k]))
        bank.advance(k * period)
        value = bank.estimate(entry.fault_set, entry.channel)
        said.append(np.nan if value is None else value)
    if not np.isfinite(said[-1]):
        raise NotRun(str(bank.why_not(entry.fault_set, entry.channel) or 'it says nothing'))
    return np.array(said)


def _grid(plant: Plant, entry: VirtualSensor) -> tuple[int, int]:
    """Return the period [ns] and the number of instants of a run."""
    own = np.linalg.eigvals(plant.A).astype(complex)
    h = plant.sample_time
    rates = own.real if h is None else np.log(np.maximum(np.abs(own), 1e-12)) / h
    duration = max(SHOWN / entry.decay, 4.0 / _mean_rate(plant))
    if rates.max() > 0:  # else nothing but the plant's own growth would be seen
        duration = min(duration, GROWTH / rates.max())
    if h is not None:
        return round(1e9 * h), int(np.clip(np.ceil(duration / h), 20, LONGEST)) + 1
    if np.abs(own).max() * duration > TOO_STIFF:
        raise NotRun(f'the plant has modes {np.abs(own).max() * duration:.0e} times faster than '
                     'what is to be seen')
    return max(round(1e9 * duration / STEPS), 1000), STEPS + 1


def _mean_rate(plant: Plant) -> float:
    own, h = np.linalg.eigvals(plant.A).astype(complex), plant.sample_time
    rates = np.abs(own) if h is None else np.abs(np.log(own[np.abs(own) > 1e-6])) / h
    rates = rates[rates > 1e-9 * rates.max(initial=1e-300)]
    return float(np.exp(np.mean(np.log(rates)))) if rates.size else 1.0 if h is None else 1.0 / h


def _sizes(plant: Plant) -> np.ndarray:
    """Return what is much for each state (n,): of its range, its start, else of the largest."""
    span = plant.ranges[:, 1] - plant.ranges[:, 0]
    size = np.maximum(np.abs(plant.initial), np.abs(plant.operating_point))
    size = np.where(np.isfinite(span), 0.25 * span, size)
    return np.where(size > 0, size, size.max() if size.any() else 1.0)


def _swing(plant: Plant) -> np.ndarray:
    """Return how far the commands go up (m,) from the operating point; a valve knows no less."""
    tau = 1.0 / _mean_rate(plant)
    if plant.sample_time is not None:
        tau = max(1.0, tau / plant.sample_time)
    push = (np.abs(plant.B) * tau / _sizes(plant)[:, None]).max(axis=0, initial=0.0)
    free = np.where(push > 0, SWING / np.where(push > 0, push, 1.0), 0.0)
    return np.where(plant.operating_input != 0, 0.5 * plant.operating_input, free)


def need_matplotlib() -> Any:
    """Return matplotlib; raise ModuleNotFoundError."""
    import matplotlib
    import matplotlib.figure
    return matplotlib


def picture(entry: VirtualSensor, unit: str, start: Run | None, pushed: Run | None,
            salt: str) -> str:
    """
    Return an SVG element: above truth and estimate, below the error, one column for each run.

    ``salt`` keeps the names inside it apart from those of other pictures on one page.
    """
    matplotlib = need_matplotlib()
    runs = [(run, what) for run, what in (
        (start, 'from a wrong start'), (pushed, 'under unknown inputs'))
        if run is not None]
    # texts stay texts, and a $ in a unit stays a $
    with matplotlib.rc_context({
            'svg.fonttype': 'none', 'svg.hashsalt': salt, 'text.parse_math': False,
            'text.usetex': False, 'font.size': 9, 'axes.spines.top': False,
            'axes.spines.right': False, 'axes.grid': True, 'grid.alpha': 0.25}):
        figure = matplotlib.figure.Figure(figsize=(4.6 * len(runs), 3.9), layout='constrained')
        axes = figure.subplots(2, len(runs), squeeze=False, sharex='col', height_ratios=(3, 2))
        for (run, what), (above, below) in zip(runs, axes.T):
            above.plot(run.time, run.truth, color=TRUTH, lw=5, label='truth',
                       solid_capstyle='round')
            above.plot(run.time, run.estimate, color=ESTIMATE, lw=1.5, label='virtual sensor')
            above.set_title(what, fontsize=10, loc='left')
            if run is pushed:
                above.plot(run.time, run.still, color='black', lw=0.8, ls='--',
                           label='truth without them')
            _framed(above, run)
            if run is start:
                _falling(below, entry, run)
            else:
                _level(below, run)
                for part, word in ((STEP_AT, ' step'), (WAVE_AT, ' wave')):
                    for axis in (above, below):
                        axis.axvline(run.time[-1] * part, color='black', lw=0.8, ls=':')
                    above.text(run.time[-1] * part, 0.98, word, va='top', fontsize=8,
                               transform=above.get_xaxis_transform())
            below.set_xlabel('time [s]')
        shown = f' [{unit}]' if unit else ''
        axes[0, 0].set_ylabel(f'{entry.channel}{shown}')
        axes[1, 0].set_ylabel(f'{"|error|" if start else "error"}{shown}')
        if start and pushed:
            axes[1, 1].set_ylabel(f'error{shown}')
        for axis in axes[0]:
            axis.legend(frameon=False, fontsize=8)
        text = io.StringIO()
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # a unit in letters that the font has not
            figure.savefig(text, format='svg', metadata={'Date': None, 'Creator': None})
    svg = text.getvalue()
    svg = re.sub(r'<metadata>.*?</metadata>', '', svg[svg.index('<svg'):], flags=re.DOTALL)
    return re.sub(r'<g id="[^"]*"', '<g', svg)


def _framed(axis: Any, run: Run) -> None:
    """Leave room around the curves, and do not magnify rounding errors."""
    both = np.concatenate([run.truth, run.still, run.estimate[np.isfinite(run.estimate)]])
    middle, half = 0.5 * (both.max() + both.min()), 0.5 * np.ptp(both)
    half = max(1.15 * half, 1e-6 * np.abs(both).max(), 1e-9)
    axis.set_ylim(middle - half, middle + half)


def _falling(axis: Any, entry: VirtualSensor, run: Run) -> None:
    """Draw the error of a run that starts wrong, and the rate that is proved."""
    size = np.abs(run.error)
    if not np.nanmax(size) > 0:
        axis.plot(run.time, size, color=ESTIMATE, lw=1.5)
        return
    least = 1e-6 * np.nanmax(size)
    axis.semilogy(run.time, np.maximum(size, least), color=ESTIMATE, lw=1.5)
    axis.set_ylim(least, 3.0 * np.nanmax(size))
    c = entry.certificate
    if c is not None and c.status != 'none' and 0 < c.rate < np.inf:
        axis.semilogy(run.time, np.maximum(np.nanmax(size) * np.exp(-c.rate * run.time), least),
                      color=PROVED, lw=1, ls='--',
                      label='rate proved' if c.status == 'global' else 'rate in its region')
        axis.legend(frameon=False, fontsize=8)
    axis.yaxis.set_major_formatter(lambda value, _: f'{value:g}')  # 10^n would need a mathtext
    axis.yaxis.set_minor_formatter(lambda value, _: '')


def _level(axis: Any, run: Run) -> None:
    """Draw an error on the scale of the truth: what cannot be seen there does not matter."""
    axis.plot(run.time, run.error, color=ESTIMATE, lw=1.5)
    reach = max(0.05 * np.ptp(run.truth), 1.1 * np.nanmax(np.abs(run.error)), 1e-12)
    axis.set_ylim(-reach, reach)
