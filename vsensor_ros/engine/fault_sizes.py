"""How large each fault is now, from the observers that isolation runs, whoever is believed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np

from vsensor_ros.observers import FaultSize
from vsensor_ros.observers.fault_size import SLIDING, VIRTUAL, WALK
from vsensor_ros.observers.injection import first_order, Step, super_twisting

SETTLES = 3.0  # responses after which an injection has come to the residual


class SizeNow(NamedTuple):
    """The fault of a sensor or of what a command does, if it is the only one."""

    name: str
    method: str
    value: float  # in its unit; NaN: not known now
    deviation: float  # standard deviation
    misled_by: tuple[str, ...]  # who is faulty of those that it reads besides


class Sizes:
    """Follows the faults of a design from one time of the grid to the next."""

    def __init__(self, sizes: Sequence[FaultSize], sensors: Sequence[str], period: float,
                 turns: Mapping[str, float]) -> None:
        """Prepare; period in s, turns by sensor that wraps."""
        self.time: int | None = None  # ns, of what is known now
        self._followers = [
            _Follower(size, sensors.index(size.name) if size.method == VIRTUAL else -1, period,
                      turns.get(size.name)) for size in sizes]

    def restart(self) -> None:
        """Forget all."""
        self.time = None
        for follower in self._followers:
            follower.restart()

    def step(self, time: int, readings: np.ndarray, said: np.ndarray) -> None:
        """
        Take the next time [ns] of the grid.

        readings (L,), and what the observers say (s,), NaN where nothing is known.
        """
        self.time = time
        for follower, estimate in zip(self._followers, said.tolist()):
            follower.step(readings, estimate)

    def now(self, faulty: Collection[str]) -> list[SizeNow]:
        """Return the sizes; faulty: the sensors that are not believed."""
        return [SizeNow(f.size.name, f.size.method, f.value, f.size.deviation,
                        tuple(s for s in f.size.reads if s in faulty and s != f.size.name))
                for f in self._followers]


class _Follower:
    """Follows one fault."""

    def __init__(self, size: FaultSize, own: int, period: float, turn: float | None) -> None:
        self.size, self._own, self._turn = size, own, turn
        self._pull = -math.expm1(-period / size.response)
        self._settles = SETTLES * size.response / period
        self._length, self._step = _injected(size, period)
        self.restart()

    def restart(self) -> None:
        """Forget all."""
        self.value = math.nan
        self._state: np.ndarray | None = None
        self._steps = 0

    def step(self, readings: np.ndarray, estimate: float) -> None:
        """Take what is known of the next time."""
        if self._own >= 0:
            estimate = float(readings[self._own]) - estimate
        if not math.isfinite(estimate):
            self.restart()
        elif self._step is not None:
            self._inject(estimate)
        elif self.size.method == WALK or math.isnan(self.value):
            self.value = self._shortest(estimate)
        else:
            self.value += self._pull * self._shortest(estimate - self.value)
            self.value = self._shortest(self.value)

    def _inject(self, residual: float) -> None:
        assert self._step is not None
        state = np.zeros(self._length) if self._state is None else self._state
        self._state = self._step(state, np.array(residual))
        self._steps += 1
        if self._steps > self._settles:
            self.value = self._shortest(float(self._state[-1]))

    def _shortest(self, value: float) -> float:
        return value if self._turn is None else math.remainder(value, self._turn)


def _injected(size: FaultSize, period: float) -> tuple[int, Step | None]:
    if size.injection is None:
        return 0, None
    return first_order(size.injection, size.response, period) if size.method == SLIDING \
        else super_twisting(size.injection, period)
