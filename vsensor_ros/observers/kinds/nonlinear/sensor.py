"""The data of the kind nonlinear; letters as in its folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from vsensor_ros.functions.expression import names, parse
from vsensor_ros.observers.entry import read_only


class Condition(NamedTuple):
    """It says something only while an expression of z, readings and inputs is above 0."""

    positive: str
    words: str  # what is so where it is not above 0


@dataclass(frozen=True, eq=False)
class NonlinearSensor:
    """
    A virtual sensor z = phi(x), k states, all of it in expressions; k = 0: readings tell at once.

    They are over z (its names), sensors and inputs; those of `tracks` may hold sensors of the
    fault set. Noise by sensor, of those in the expressions.
    """

    kind: ClassVar[str] = 'nonlinear'
    noise = proof = certificate = None

    channel: str
    fault_set: tuple[str, ...]
    reads: tuple[str, ...]  # healthy sensors
    inputs: tuple[str, ...]  # m, of the plant
    grade: str  # 'exact', or 'temporary': it goes on from what its channels said
    proved: bool  # that it converges while all is within `region`
    z: tuple[str, ...]  # k names
    phi: tuple[str, ...]  # k, over the states of the plant; for people
    F: tuple[str, ...]  # k
    out: str
    residuals: tuple[str, ...]  # 0 in truth, of healthy sensors
    tracks: tuple[str, ...]  # 0 in truth, of the channels, too
    # k times as many as noises: what each does to each state, per sqrt(s); () where not known
    driven: tuple[str, ...]
    validity: tuple[Condition, ...]
    turn: float  # what the channel turns by where it goes round; 0: it does not
    region: Mapping[str, tuple[float, float]]  # by name of z, sensor, input
    initial: np.ndarray  # (k,)
    start: np.ndarray  # (k, k) covariance of the error with it
    process_noise: np.ndarray  # (k,) standard deviation per sqrt(s), or per step, besides
    noise_of: Mapping[str, float]  # standard deviation of one reading, by sensor
    lasts: Mapping[str, float]  # s between two readings, by sensor; 0: each step has one
    decay: float  # 1/s, of an error; 0: it stays
    warm_up: float  # s until the start is forgotten by itself; of a temporary one 0
    followed: float  # s until its channels have told where z is
    ages: np.ndarray  # (T,) s after the loss of its channels, and then
    drift: np.ndarray  # (T,) its standard deviation at the operating point
    direct: Mapping[str, float]  # slopes of what it says by readings,
    pushes: Mapping[str, float]  # and [1/s] through z, at most where it works
    useful: float  # deviation from which on the declared ranges tell as much; 0: not known
    sample_time: float | None
    words: str = ''  # what z is, for people
    why: str = ''  # it stands there and no linear one

    def __post_init__(self) -> None:
        read_only(self)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Name of what it says."""
        return (self.channel,)

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.z)

    @property
    def method(self) -> str:
        """What it is."""
        return f'a function of the states: {self.words or ", ".join(self.phi)}'

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the inputs in its expressions."""
        used = names_in((*self.F, self.out, *self.residuals, *self.tracks, *self.driven,
                         *(c.positive for c in self.validity)))
        return tuple(name for name in self.inputs if name in used)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the sensors of the fault set that correct it while they are believed."""
        used = names_in(self.tracks)
        return tuple(name for name in self.fault_set if name in used)


def names_in(texts: Iterable[str]) -> set[str]:
    """Return all names in some expressions."""
    return {name for text in texts for name in names(parse(text))}
