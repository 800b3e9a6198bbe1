"""What the designer knows of a virtual sensor, whatever its kind; letters are the method's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class OrderStep:
    """What is known of the virtual sensors of one order."""

    order: int
    verdict: str  # 'impossible', 'possible' or 'open'
    why: str  # one sentence
    freedom: int  # free coefficients of the characteristic polynomial; 0 when impossible
    # largest singular value taken for zero, smallest taken for nonzero (inf: none); relative
    gap: tuple[float, float]


@dataclass(frozen=True)
class Proof:
    """Between which bounds the least order lies, and why. Source: method, 3.4 and 3.7."""

    lower: int
    upper: int
    steps: tuple[OrderStep, ...]
    doubts: tuple[str, ...]  # decisions on a rank that are ambiguous
    # the bounds are those of exact arithmetic modulo two primes, right but by a freak of both
    modulo: bool = False

    @property
    def least(self) -> bool:
        """Whether the least order is known."""
        return self.lower == self.upper


@dataclass(frozen=True)
class Rung:
    """One order of the ladder that a person may choose from, and what it costs."""

    order: int
    noise: float  # standard deviation of the error of vhat in steady state, unit of the channel
    noise_gain: float  # as that of the virtual sensor
    decay: float  # 1/s; inf when there is nothing that must die out
    method: str


@dataclass(frozen=True)
class Noise:
    """What the noise of sensors and process does to vhat in steady state."""

    error: float  # standard deviation of v - vhat, unit of the channel
    floor: float  # the same for the Kalman filter on the same healthy sensors; inf: it has none
    assumed: bool  # whether some noise figures are defaults, not given

    @property
    def ratio(self) -> float:
        """Return error / floor: 1 when both are 0, inf when only the floor is."""
        if self.floor == 0.0:
            return 1.0 if self.error == 0.0 else np.inf
        return self.error / self.floor


class Limit(NamedTuple):
    """Where one argument of a nonlinear term has to stay, in its unit; or one command."""

    term: int | None  # index of the term; None: a command
    argument: int  # index of its argument; of the command
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proved of the error ``e = Phi x - z`` with its nonlinear terms (method, 3.5)."""

    status: str  # 'global', 'region' or 'none'
    rate: float  # 1/s at which the error is proved to decay; 0 when none
    bound: float  # sup |v - vhat| per unit of sup |error of the readings|; inf when none
    S: np.ndarray  # (k, k), of V = e' S e; zeros when none
    region: tuple[Limit, ...]  # where it holds; empty when global
    lipschitz: tuple[float, float] | None  # the papers' condition holds when left < right
    reason: str  # one sentence
    # where in the plant's declared ranges nothing is proved, in words; '': proved in all of them
    uncovered: str = ''
    # the region in states, sums of states and commands, with their limits; (): not told
    where: tuple[tuple[str, float, float], ...] = ()

    def __post_init__(self) -> None:
        self.S.flags.writeable = False
