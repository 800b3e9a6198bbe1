"""What the engine is told at its start, and what of it may change while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from vsensor_ros.bank import End
from vsensor_ros.engine.policy import Policy
from vsensor_ros.isolator import Settings as IsolatorSettings
from vsensor_ros.observers import Design


@dataclass(frozen=True)
class Live:
    """What may change while the engine runs."""

    without_estimate: str  # 'stop', 'hold', 'nan' or 'pass'
    time_constant: float  # s of the decay of an offset at a switch; 0: a plain switch
    policies: Mapping[str, Policy]  # by sensor
    # by sensor, in its unit; 0: no limit; None: the limits that follow from the design
    max_deviation: Mapping[str, float | None]


@dataclass(frozen=True)
class StreamPlan:
    """One stream of messages and the channels that travel in them."""

    names: tuple[str, ...]  # of its channels, in the order of their fields
    source: str  # where the drivers' messages come in; a topic, for people
    output: str  # where they go out
    stamped: bool  # its messages have stamps


@dataclass(frozen=True)
class Setup:
    """All that the engine must know at its start. Every sensor is in just one stream."""

    design: Design
    rate: float  # Hz
    max_age: Mapping[str, float]  # s, by sensor
    jump_ahead: float  # s; a clock that jumps further ahead starts the virtual sensors anew
    streams: tuple[StreamPlan, ...]
    simulated: bool  # the clock is a simulation's: it stands still between two looks
    live: Live
    command_ends: Mapping[str, End] = field(default_factory=dict)  # of those that may end
    # s before the loss of a sensor in which it is not believed afterwards; default: the bank's
    guard: Mapping[str, float] = field(default_factory=dict)
    isolator: IsolatorSettings | None = None  # None: nobody but others isolates
