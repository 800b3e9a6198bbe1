"""Commands on their way to the bank: from when each of them counts, and what is odd about it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
import math

from vsensor_ros.bank import Bank
from vsensor_ros.engine.clock import Clock
from vsensor_ros.engine.intake import Intake
from vsensor_ros.engine.stream import is_absent
from vsensor_ros.reason import Reason

NEAR = 100_000_000  # ns from its arrival that a stamp can be true
BEHIND = 250_000_000  # ns that a command may be on its way; from then on its clock is another one
SIMULATED = 1_000_000_000  # both: simulated time may run fast


@dataclass(frozen=True)
class CommandState:
    """One command, at the time of the snapshot."""

    name: str
    trouble: Reason | None  # what is wrong with the last one that came
    lack: Reason | None  # why what reads it is not valid; None: it counts
    lead: float  # s by which the stamp of the last one was ahead of its arrival; NaN: no stamp
    from_arrival: int  # how many counted from their arrival, because their stamps cannot be true
    counts: Mapping[Reason, int]  # what was not used


@dataclass
class _Heard:
    """What has come of one command; times in ns."""

    stamp: int = 0  # of the last one that had one of this clock
    time: int = 0  # from which the last one counts
    lead: int | None = None  # of the last one
    foreign: bool = False  # that lead is not possible on this clock
    unused: Reason | None = None  # why the last one is not used
    from_arrival: int = 0


class Commands:
    """
    Takes commands. One counts from its stamp, if that can be true, else from its arrival.

    A command acts when it arrives; a stamp only tells that better where it is near. It cannot be
    true ahead of the arrival, far behind it, or not after the one before: then it is of another
    clock, or means something else. What came later never counts earlier.
    """

    def __init__(self, names: Collection[str], bank: Bank, clock: Clock, intake: Intake) -> None:
        self._bank, self._clock, self._intake = bank, clock, intake
        self._heard = {name: _Heard() for name in names}
        # of simulated time the next step may not have come yet
        self._lead, self._lag, self._behind = (NEAR, SIMULATED, SIMULATED) if clock.simulated \
            else (0, NEAR, BEHIND)

    def take(self, name: str, value: float | Reason, stamp: int | None, received: int) -> None:
        """Take a command. received: when, by the system's clock."""
        heard = self._heard[name]
        time = arrival = self._intake.arrival(received)
        if isinstance(value, Reason):
            self._intake.count(name, value)
            if not is_absent(value):  # one of another joint, say, changes nothing
                self._bank.spoil(name, arrival)
                if self._intake.own is not None:
                    self._intake.own.spoil(name, arrival)
                heard.unused = value
            return
        if stamp and arrival:
            lead = stamp - arrival
            if -self._behind <= lead <= NEAR:
                if -self._lag <= lead <= self._lead and stamp > heard.stamp:
                    time = stamp
                heard.stamp, heard.foreign = stamp, False
            else:
                self._note_foreign(name, heard, lead)
            heard.lead = lead
        elif not (time := stamp or arrival):
            return  # simulated time has not begun
        else:
            heard.lead = None
        if time < heard.time:
            time = heard.time
        # the clock was looked at a while ago when all is busy
        now = max(self._clock.now, 0 if self._clock.simulated else received)
        heard.unused = self._bank.take(name, time, value, now)
        if self._intake.own is not None:
            self._intake.own.take(name, time, value, now)
        if heard.unused is None:
            heard.time = time if arrival else 0
        else:
            self._intake.note(name, heard.unused)

    def _note_foreign(self, name: str, heard: _Heard, lead: int) -> None:
        """Count that a stamp is of another clock; say so when it begins."""
        heard.from_arrival += 1
        if not heard.foreign:
            heard.foreign = True
            self._intake.say('warning', _foreign(name, lead), ('command', name))

    def forget(self) -> None:
        """Begin anew after the clock jumped."""
        for heard in self._heard.values():
            heard.stamp = heard.time = 0

    def states(self, counts: Mapping[str, Mapping[Reason, int]]) -> tuple[CommandState, ...]:
        """Return how each command is; counts: by name, what was not used."""
        return tuple(CommandState(
            name, _trouble(name, heard), self._bank.lack(name),
            math.nan if heard.lead is None else heard.lead * 1e-9, heard.from_arrival,
            counts.get(name, {})) for name, heard in self._heard.items())


def _trouble(name: str, heard: _Heard) -> Reason | None:
    if heard.unused is not None:
        return Reason.of('command not used', name=name, why=heard.unused)
    if heard.foreign:
        assert heard.lead is not None
        return _foreign(name, heard.lead)
    return None


def _foreign(name: str, lead: int) -> Reason:
    return Reason.of('command of another clock', name=name, seconds=lead * 1e-9)
