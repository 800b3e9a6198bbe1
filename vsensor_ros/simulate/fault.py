"""Sensor faults, applied to a recorded channel: pure functions from channel to channel."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Recorded:
    """
    What one channel said: `value[k]` at `time[k]` [s], unless `sent[k]` is False.

    A reading that was never sent and a reading of NaN are different faults; `sent` keeps them
    apart. All three have shape (T,); `time` increases.
    """

    time: NDArray[np.float64]
    value: NDArray[np.float64]
    sent: NDArray[np.bool_]

    @classmethod
    def of(cls, time: ArrayLike, value: ArrayLike) -> 'Recorded':
        """Return a healthy channel: every value sent."""
        time, value = np.asarray(time, float), np.asarray(value, float)
        return cls(time, value, np.ones(time.shape, bool))


def _within(channel: Recorded, start: float, end: float) -> NDArray[np.bool_]:
    return (channel.time >= start) & (channel.time < end)


def freeze(channel: Recorded, start: float, end: float = np.inf) -> Recorded:
    """Repeat the last value before `start` [s] until `end` [s]; the stamps go on."""
    before = np.flatnonzero((channel.time < start) & channel.sent)
    last = channel.value[before[-1]] if before.size else np.nan
    return replace(channel, value=np.where(_within(channel, start, end), last, channel.value))


def drop_out(channel: Recorded, start: float, end: float = np.inf) -> Recorded:
    """Send nothing from `start` to `end` [s]."""
    return replace(channel, sent=channel.sent & ~_within(channel, start, end))


def not_a_number(channel: Recorded, start: float, end: float = np.inf) -> Recorded:
    """Send NaN from `start` to `end` [s]."""
    return replace(channel, value=np.where(_within(channel, start, end), np.nan, channel.value))


def infinity(channel: Recorded, start: float, end: float = np.inf) -> Recorded:
    """Send infinity from `start` to `end` [s]."""
    return replace(channel, value=np.where(_within(channel, start, end), np.inf, channel.value))


def bias(channel: Recorded, start: float, end: float = np.inf, *, size: float) -> Recorded:
    """Add `size` [unit of the channel] from `start` to `end` [s]."""
    return replace(channel, value=channel.value + size * _within(channel, start, end))


def drift(channel: Recorded, start: float, end: float = np.inf, *, rate: float) -> Recorded:
    """Add `rate` [unit/s] times the time since `start`, from `start` to `end` [s]."""
    ramp = np.where(_within(channel, start, end), channel.time - start, 0.0)
    return replace(channel, value=channel.value + rate * ramp)


def spikes(channel: Recorded, start: float, end: float = np.inf, *,
           size: float, probability: float, seed: int = 0) -> Recorded:
    """Add +-`size` [unit] to a random share `probability` of the readings, fixed by `seed`."""
    random = np.random.default_rng(seed)
    hit = random.random(channel.time.shape) < probability
    spike = random.choice([-size, size], channel.time.shape)
    return replace(channel, value=channel.value + spike * (hit & _within(channel, start, end)))


def noise(channel: Recorded, start: float, end: float = np.inf, *,
          size: float, seed: int = 0) -> Recorded:
    """Add white noise of the standard deviation `size` [unit] from `start` to `end` [s]."""
    random = np.random.default_rng(seed)
    added = size * random.standard_normal(channel.time.shape)
    return replace(channel, value=channel.value + added * _within(channel, start, end))


FAULTS: dict[str, Callable[..., Recorded]] = {
    'freeze': freeze, 'drop_out': drop_out, 'not_a_number': not_a_number, 'infinity': infinity,
    'bias': bias, 'drift': drift, 'spikes': spikes, 'noise': noise}
