"""The data of the kind extended; letters as in its folder."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from vsensor_ros.functions.expression import names, parse
from vsensor_ros.observers.entry import read_only


@dataclass(frozen=True, eq=False)
class Model:
    """
    The equations of a plant, and what is not known exactly in them.

    Each gives the derivative of a state or, with a sample time, its next value, over states,
    inputs, unknown inputs (0 in the mean) and parameters. Noise is white: standard deviations per
    sqrt(Hz), or per step.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    equations: tuple[str, ...]  # n
    unknown: tuple[str, ...]  # d
    parameters: tuple[str, ...]  # p
    values: np.ndarray  # (p,)
    spreads: np.ndarray  # (p,) standard deviations
    process_noise: np.ndarray  # (n,) [unit of the state per sqrt(s), or per step]
    input_noise: np.ndarray  # (m,) by which what acts is off what is said
    unknown_noise: np.ndarray  # (d,)
    C: np.ndarray  # (L, n) what sensors read of the states,
    Cu: np.ndarray  # (L, m) and directly of the inputs
    noise: np.ndarray  # (L,) standard deviation of one reading
    lasts: np.ndarray  # (L,) s between two readings of a sensor; 0: each step has one
    initial: np.ndarray  # (n,) the start before anything was read,
    start: np.ndarray  # (n,) and its standard deviation
    sample_time: float | None  # s; None: continuous
    # a state of the plant that is an angle, of which these states are cosine and sine; '': none
    angle: str = ''
    # (L,) of the angle in what sensors read, and of nothing else there; (0,): there is none
    factors: np.ndarray = field(default_factory=lambda: np.zeros(0))
    # names and texts that equations use, of which a later one may use earlier ones
    definitions: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        read_only(self)

    @property
    def circle(self) -> tuple[int, int]:
        """Indices of the cosine and the sine of the angle."""
        cos, sin = on_circle(self.angle)
        return self.states.index(cos), self.states.index(sin)

    def same(self, other: Model) -> bool:
        """Tell whether another is equal."""
        return all(np.array_equal(mine, theirs) for mine, theirs in zip(
            vars(self).values(), vars(other).values()))


@dataclass(frozen=True)
class Tried:
    """What a filter did in runs over the declared ranges, with parameters off by their spreads."""

    runs: int
    seconds: float  # after the loss
    rmse: float  # of what was served there [unit of the channel]
    within: float  # share of it that was within two deviations
    lost: float  # share of the runs in which it was withdrawn
    served: float  # share of the time in the ranges


def on_circle(angle: str) -> tuple[str, str]:
    """Return the names of the states that are cosine and sine of an angle."""
    return f'cos_{angle}', f'sin_{angle}'


def immersed_states(states: tuple[str, ...], angle: str) -> tuple[str, ...]:
    """Return states with the cosine in place of an angle, and the sine as the last."""
    cos, sin = on_circle(angle)
    return (*(cos if name == angle else name for name in states), sin)


@dataclass(frozen=True, eq=False)
class ExtendedSensor:
    """A Kalman filter that says what a failed sensor would have said."""

    kind: ClassVar[str] = 'extended'
    grade: ClassVar[str] = 'filtered'
    noise = proof = certificate = None

    channel: str
    fault_set: tuple[str, ...]
    reads: tuple[str, ...]  # the healthy sensors that correct it
    model: Model
    decay: float  # 1/s, of an error at the operating point without the channels; 0: it stays
    warm_up: float  # s until readings of the channels have told where it is
    ages: np.ndarray  # (T,) s after the loss of its channels, and then
    drift: np.ndarray  # (T,) its standard deviation at the operating point
    why: str = ''  # it stands there and no virtual sensor of which something is proved
    tried: Tried | None = None  # by the designer

    @property
    def outputs(self) -> tuple[str, ...]:
        """Name of what it says."""
        return (self.channel,)

    @property
    def method(self) -> str:
        """What it is."""
        return 'extended Kalman filter, ' + (
            'the angle as cosine and sine' if self.model.angle else
            'uncertain parameters considered')

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.model.states)

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the commands that its equations or sensors hold."""
        m = self.model
        texts = (*m.equations, *(text for _, text in m.definitions))
        used = {name for text in texts for name in names(parse(text))}
        return tuple(name for i, name in enumerate(m.inputs) if name in used or m.Cu[:, i].any())
