"""What the replacer tells of itself: snapshots that others turn into messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vsensor_ros.observers import VirtualSensor

STILL = 1.0  # s of steady time without simulated time


@dataclass(frozen=True)
class ChannelState:
    """One channel, at the time of the snapshot; values in its unit, times in s."""

    name: str
    topic: str  # on which it goes out
    unit: str  # '' when the design gives none
    source: str  # 'real', 'silent' (healthy, but not heard), 'virtual' or 'none'
    reason: str  # why it is silent or has no source, and what goes out instead; else ''
    fault_set: tuple[str, ...]  # of the virtual sensor that serves; else the effective faulty set
    grade: str  # of that virtual sensor; '' when none serves
    value: float  # that went out last; NaN when none did
    deviation: float  # its standard deviation; 0 of a real one, inf when not known
    offset: float  # that is still on it, for no step at the switch
    switches: int  # of source, as seen on the topic
    last_step: float  # at the last switch: first value after - last before; NaN when there is none
    since_s: float  # with this source; NaN before the first switch
    virtual_s: float  # in all, with a virtual source
    forced: bool
    recovering_s: float  # since it is reported healthy and not yet believed; NaN when it is not
    serves: VirtualSensor | None
    counts: Mapping[str, int]  # what was not used or not sent on, by reason
    rate_hz: float  # of the readings that come in


@dataclass(frozen=True)
class Health:
    """How the loop keeps up; times in s."""

    rate: float  # Hz, of the virtual sensors, as configured
    achieved: float  # Hz, over the last ticks; NaN before there are two
    step_p50: float  # computing time of the last ticks
    step_p99: float
    step_max: float
    jitter_p99: float  # |interval - period| of the last ticks
    overruns: int  # ticks left out
    jumps: Mapping[str, int]  # of the clock, by way: 'backwards', 'forwards', 'stood still'
    faulty: tuple[str, ...]  # the effective set, in the design's order
    ticks: int
    estimates: int  # that went out
    not_used: int  # messages of isolation that were not used, or not wholly
    thrown_away: int = 0  # of these, not even read: too large, or too many
    clock_age: float = 0.0  # since simulated time moved, by a steady clock


def stands_still(clock_age: float) -> str:
    """Return in words that simulated time stands still, '' when it does not."""
    return f'the clock stands still: no /clock since {clock_age:.1f} s' \
        if clock_age > STILL else ''
