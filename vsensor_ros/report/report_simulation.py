"""
Runs of a virtual sensor beside the true plant, for the report.

A plant that is unstable by itself is held at its operating point by its commands. Where they
cannot hold it the run is short, and only the error is worth a look.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import warnings

import numpy as np

from vsensor_ros.bank import Bank
from vsensor_ros.observers import Design, settling_time, VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.report.hold import growth, held
from vsensor_ros.simulate import simulate
from vsensor_ros.simulate.simulate import readings

STEPS = 800  # of a run of a continuous plant
LONGEST = 2000  # steps of a run of a discrete one
SHOWN = 10.0  # time constants of the virtual sensor
UNSTABLE = 1.0  # time constants of its growth in a run, from which on a plant must be held
GROWTH = 5.0  # time constants of a plant that runs away
TOO_STIFF = 3e4  # of the plant's fastest mode in a run
MOST_LOOKS = 200_000  # at the plant in a run
OFFSET = 0.5  # wrong start, of the size of each state
PUSH = 0.3  # of the size of each state, what a disturbance does within a time constant
SWING = 1.0  # the same of a command
STEP_AT, WAVE_AT = 0.25, 0.6  # of a run, in which the disturbance is a step, then a wave


class NotRun(Exception):
    """A run that cannot be shown; str() is one sentence."""


class NotHeld(Exception):
    """The commands of an unstable plant do not hold it."""


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """One run, without sensor noise; all arrays (T,), values in the channel's unit."""

    time: np.ndarray  # s
    truth: np.ndarray
    estimate: np.ndarray
    rho: np.ndarray  # (T, d)
    still: np.ndarray  # the truth without rho
    held: bool = False  # by its commands: the plant is unstable by itself
    runs_away: bool = False  # and its commands cannot hold it

    @property
    def error(self) -> np.ndarray:
        """Return truth - estimate."""
        return self.truth - self.estimate


def from_wrong_start(plant: Plant, design: Design, entry: VirtualSensor) -> SimulatedRun:
    """Run from a start that is not the one the virtual sensor believes in; raise NotRun."""
    start = np.array(plant.operating_point)
    if np.allclose(start, plant.initial):
        generic = 1.0 + 0.15 * (np.arange(len(start)) % 5)  # hidden from no functional
        start = plant.initial + OFFSET * _sizes(plant) * generic
        low, high = plant.ranges.T
        start = np.clip(start, low, high)
    return _run(plant, design, entry, start, np.zeros(len(plant.disturbances)))


def disturbed(plant: Plant, design: Design, entry: VirtualSensor) -> SimulatedRun:
    """Run with every unknown input at once, a step that becomes a wave; raise NotRun."""
    tau, sizes = 1.0 / _mean_rate(plant), _sizes(plant)
    if plant.sample_time is not None:
        tau = max(1.0, tau / plant.sample_time)
    push = np.abs(plant.D) * tau / sizes[:, None]
    most = push.max(axis=0, initial=0.0)
    return _run(plant, design, entry, plant.initial,
                np.where(most > 0, PUSH / np.where(most > 0, most, 1.0), 1.0))


def _run(plant: Plant, design: Design, entry: VirtualSensor, start: np.ndarray,
         push: np.ndarray) -> SimulatedRun:
    if len(entry.Cv) > 1:
        raise NotRun('it has several rows')
    unstable = growth(plant) * _duration(plant, entry) > UNSTABLE
    if unstable:
        try:
            return _run_on(plant, design, entry, start, push, _grid(plant, entry), hold=True)
        except NotHeld:
            pass
    grid = _grid(plant, entry, GROWTH / growth(plant) if unstable else np.inf)
    return replace(_run_on(plant, design, entry, start, push, grid), runs_away=unstable)


def _run_on(plant: Plant, design: Design, entry: VirtualSensor, start: np.ndarray,
            push: np.ndarray, grid: tuple[int, int], hold: bool = False) -> SimulatedRun:
    period, count = grid
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
    planned = plant.operating_input + _swing(plant) * np.where(on, 1.0, 0.0)[:, None]
    x, inputs = _motion(plant, time, planned, rho, start, hold)
    looks = 0
    unknown = np.array([rho(t) for t in time]).reshape(count, len(push))
    y = readings(plant, time, x, inputs, unknown)
    truth = _value(plant, entry, x, y)
    still = truth
    if push.any():
        looks = 0
        x, undisturbed = _motion(plant, time, planned, lambda t: 0.0 * rho(t), start, hold)
        still = _value(plant, entry, x, readings(plant, time, x, undisturbed))
    estimate = _estimates(plant, design, entry, period, y, inputs)
    return SimulatedRun(time, truth, estimate, unknown, still, hold)


def _motion(plant: Plant, time: np.ndarray, planned: np.ndarray,
            rho: Callable[[float], np.ndarray], start: np.ndarray,
            hold: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (T, n) and the commands (T, m); raise NotHeld."""
    if not hold:
        return _states(plant, time, planned, rho, start), planned
    swing = _swing(plant)
    effort = np.where(swing != 0, np.abs(swing), 1.0)
    try:
        with np.errstate(all='ignore'), warnings.catch_warnings():
            warnings.simplefilter('ignore')  # what becomes infinite has fallen
            motion = held(plant, time, planned, rho, start, _sizes(plant), effort)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        raise NotHeld from error
    if motion is None:
        raise NotHeld
    return motion


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


def _duration(plant: Plant, entry: VirtualSensor) -> float:
    """Return how long [s] a run is to be, by what there is to see."""
    return max(SHOWN / 3.0 * max(settling_time(entry), 3.0 / entry.decay), 4.0 / _mean_rate(plant))


def _grid(plant: Plant, entry: VirtualSensor, longest: float = np.inf) -> tuple[int, int]:
    """Return the period [ns] and the number of instants of a run of at most so many seconds."""
    h, duration = plant.sample_time, min(_duration(plant, entry), longest)
    if h is not None:
        return round(1e9 * h), int(np.clip(np.ceil(duration / h), 20, LONGEST)) + 1
    fastest = np.abs(np.linalg.eigvals(plant.A)).max()
    if fastest * duration > TOO_STIFF:
        raise NotRun(f'the plant has modes {fastest * duration:.0e} times faster than '
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
