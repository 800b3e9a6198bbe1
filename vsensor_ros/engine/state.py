"""What the engine tells of itself: snapshots that nobody can change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

from vsensor_ros.bank import Rehearsal
from vsensor_ros.engine.commands import CommandState
from vsensor_ros.observers import Entry
from vsensor_ros.reason import Reason

STILL = 1.0  # s of steady time without simulated time


@dataclass(frozen=True)
class ChannelState:
    """One channel, at the time of the snapshot; values in its unit, times in s."""

    name: str
    topic: str  # on which it goes out
    unit: str  # '' when the design gives none
    source: str  # 'real', 'silent' (healthy, but not heard), 'virtual' or 'none'
    reason: Reason | None  # why, and what goes out instead; None: nothing to be said
    fault_set: tuple[str, ...]  # of the virtual sensor that serves; all that is faulty with 'none'
    grade: str  # of that virtual sensor; '' when none serves
    value: float  # that went out last; NaN when none did
    deviation: float  # its standard deviation; 0 of a real one, inf when not known
    interval: tuple[float, float] | None  # in which the truth lies, where that is known
    offset: float  # that is still on it, for no step at the switch
    switches: int  # of source, as seen on the topic
    last_step: float  # at the last switch: first value after - last before; NaN when there is none
    since_s: float  # with this source; NaN before the first switch
    virtual_s: float  # in all, with a virtual source
    forced: bool
    isolated_s: float  # since isolation says that it is faulty; NaN when it does not
    recovering_s: float  # since it is reported healthy and not yet believed; NaN when it is not
    residual: float  # last reading - estimate, while it is faulty; NaN when not known
    serves: Entry | None
    outside_region: bool  # that virtual sensor runs where nothing is proved of it
    outside_domain: int  # steps of its virtual sensors with an argument that a function lacks
    restarts: int  # of its virtual sensors, because a state became infinite
    counts: Mapping[Reason, int]  # what was not used or not sent on
    readings: int  # that came in
    reserve: Reason | None  # why nobody could speak for it if it failed now; None: one could
    # of who serves, else of who would
    reserve_deviation: float = math.inf  # as it is now
    rehearsed: Rehearsal | None = None  # beside the healthy sensor, lately; None: not yet
    remaining_s: float = math.inf  # until it is no longer good enough; inf: that is not to come
    isolated_by: tuple[str, ...] = ()  # who says that it is faulty: 'isolation', 'isolator'


@dataclass(frozen=True)
class EngineState:
    """All channels, and how the engine as a whole is doing."""

    channels: tuple[ChannelState, ...]  # stream by stream
    faulty: tuple[str, ...]  # the effective set, in the design's order
    spoken_of: tuple[str, ...]  # by isolation, since the start: sensors whose names it knows
    ticks: int
    left_out: int  # ticks, because time had gone on too far
    estimates: int  # that went out
    jumps: Mapping[str, int]  # of the clock, by way: 'backwards', 'forwards', 'stood still'
    starts: int  # of all virtual sensors anew, after a jump or a reset
    still: float  # s of steady time since simulated time moved; 0 of another clock
    commands: tuple[CommandState, ...] = ()

    @property
    def stopped(self) -> Reason | None:
        """Say that simulated time stands still, when it does."""
        return stopped(self.still)


def stopped(still: float) -> Reason | None:
    """Return the reason that simulated time stands still, when it has for so many s."""
    return Reason.of('clock stands still', seconds=still) if still > STILL else None
