"""How large a fault is: by which method it is estimated, from what, and how well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from vsensor_ros.observers.entry import Entry

# a reading less a virtual sensor; a state of a Kalman filter that walks at random; the injection
# of an observer in a sliding mode, of the first order and super-twisting
VIRTUAL, WALK, SLIDING, TWISTING = (
    'virtual sensor', 'random walk', 'sliding mode', 'super-twisting')
METHODS = (VIRTUAL, WALK, SLIDING, TWISTING)


@dataclass(frozen=True, eq=False)
class Injection:
    """
    How a fault moves a residual, ``d e = N e + f d``, ``residual = c e`` with ``c f = 1``.

    An observer of e whose injection keeps it on the residual says d (continuous time).
    """

    N: np.ndarray  # (k, k)
    f: np.ndarray  # (k,) per unit of the fault
    c: np.ndarray  # (k,)
    largest: float  # the fault that the injection outweighs, in its unit
    change: float  # the largest rate of one that is followed, per s; only super-twisting

    def __post_init__(self) -> None:
        for array in (self.N, self.f, self.c):
            array.flags.writeable = False


@dataclass(frozen=True, eq=False)
class FaultSize:
    """How the fault of a sensor, or of what a command does, is estimated: in its unit."""

    name: str  # sensor or input that may be faulty
    method: str  # one of METHODS
    # of a virtual sensor, that is the entry of the sensor alone; else vhat is the fault, or the
    # residual that the injection is of
    observer: Entry
    response: float  # s until 63 % of a step is told; of super-twisting, of 20 deviations
    # standard deviation while there is no fault, in its unit: by the noise of the readings (and
    # the process noise that is given), and with what is assumed of the process where none is
    noise: float
    deviation: float
    assumed: bool  # some of the noise was not given and is a default
    disturbed: float = 0.0  # what unknown inputs of 1 make of it at most; 0: they do not reach it
    injection: Injection | None = None  # of the methods with a sliding mode
    # what else there is, with the noise that it would have for the same response
    others: Mapping[str, float] = field(default_factory=dict)
    why_not: Mapping[str, str] = field(default_factory=dict)  # by method that there is not

    @property
    def fault_set(self) -> tuple[str, ...]:
        """The sensors that its observer does not read."""
        return self.observer.fault_set

    @property
    def channel(self) -> str:
        """What its observer calls what it says."""
        return self.observer.channel

    @property
    def reads(self) -> tuple[str, ...]:
        """The sensors that it is made of."""
        own = (self.name,) if self.method == VIRTUAL else ()
        return (*own, *(s for s in self.observer.reads if s not in own))


@dataclass(frozen=True, eq=False)
class FaultSizes:
    """The sizes of faults of a plant's sensors and inputs that can be told."""

    found: tuple[FaultSize, ...]  # sensors in the plant's order, then inputs
    refused: Mapping[str, str] = field(default_factory=dict)  # by the others: why there is none


def observer_name(name: str) -> str:
    """Return what an observer is called that is there for the fault of a sensor or input."""
    return f'fault of {name}'
