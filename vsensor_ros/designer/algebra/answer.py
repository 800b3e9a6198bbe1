"""What the algebra of functions is asked, and what it answers: plain data, expressions as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from vsensor_ros.reason import Reason

Range = tuple[float, float]

# grades of stability, the best first
CERTIFIED = 'certified in a region'
SAMPLED = 'sampled'
TEMPORARY = 'temporary'


class Verdict(Enum):
    """A three-valued answer."""

    YES = 'yes'
    NO = 'no'
    NOT_DECIDED = 'not decided'


@dataclass(frozen=True)
class System:
    """
    A plant without one or several of its sensors.

    states: the range of each, in its unit (an angle over the circle: (-pi, pi)); f: by state, its
    derivative, or its next value where there is a sample_time [s], over states, inputs and unknown
    inputs; sensors: the healthy ones, expressions over states; wanted: by name, what is to be
    estimated, expressions over states; inputs, unknown: ranges; angles: states that wrap.
    """

    states: Mapping[str, Range]
    f: Mapping[str, str]
    sensors: Mapping[str, str]
    wanted: Mapping[str, str]
    inputs: Mapping[str, Range] = field(default_factory=dict)
    unknown: Mapping[str, Range] = field(default_factory=dict)
    angles: Sequence[str] = ()
    sample_time: float | None = None

    @property
    def discrete(self) -> bool:
        """Whether f gives next values."""
        return self.sample_time is not None


@dataclass(frozen=True)
class Condition:
    """Holds where `positive`, over z, sensors and inputs, is > 0; `reason` says why it must."""

    positive: str
    reason: Reason


@dataclass(frozen=True)
class Observer:
    """
    A virtual sensor z = phi(x) and all that its run needs, in the language of expressions.

    k states, p wanted, r residuals. `names`: of z, `z1` .. unless a sensor or an input has that
    name. `F` and `out` are over names, healthy sensors and inputs.
    """

    names: tuple[str, ...]             # (k,)
    phi: tuple[str, ...]               # (k,) over the states of the plant
    F: tuple[str, ...]                 # (k,) derivative of z, or its next value
    out: Mapping[str, str]             # by wanted name
    residuals: tuple[str, ...]         # (r,) 0 while z = phi(x)
    validity: tuple[Condition, ...]
    ranges: tuple[Range, ...]          # (k,) of z over the ranges of the states
    grade: str                         # CERTIFIED, SAMPLED or TEMPORARY
    # continuous: the error decays at least like exp(-rate t) [1/s]; discrete: like
    # exp(-rate) a step; 0 or less where TEMPORARY
    rate: float
    metric: tuple[tuple[float, ...], ...]  # (k, k) in which the error shrinks; () without one
    words: tuple[str, ...]             # of what is observed, a sentence part each
    only_coordinates: bool             # a change of coordinates a user could have made
    digits: int                        # to so many F and the decoupling are confirmed
    sample_time: float | None = None
    # (k, n) dphi/dx over names, sensors and inputs; () where not known, or of no use
    slopes: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class Answer:
    """
    Whether wanted can be had from the healthy sensors, free of the unknown inputs.

    YES with an observer; YES without one: a function is there, and `reason` says why its observer
    is refused ('functions not stable' with the rate of growth, 'functions many-valued' ..). NO is
    proved. `gamma`: what was found free of the unknown inputs, over the states.
    """

    verdict: Verdict
    reason: Reason | None = None
    observer: Observer | None = None
    gamma: tuple[str, ...] = ()
