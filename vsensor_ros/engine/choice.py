"""
Which virtual sensor serves a failed channel: of those that may, the one that is surest now.

Pure, as the switch that asks: times [ns] are arguments, a new Choice comes out. All designs for a
superset of the faulty sensors may serve, for they read none of these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
import math
from typing import Protocol

from vsensor_ros.observers import Design, Refusal
from vsensor_ros.reason import Reason

FaultSet = tuple[str, ...]  # in the design's order

# why a virtual sensor (fault set, channel) cannot serve, however long one waits; None: it may
Never = Callable[[FaultSet, str], Reason | None]

BETTER = 0.8  # of the deviation of who serves: another's is at most that, and it takes over
WHILE = 500_000_000  # ns for which it must be so, if it has been ready without being better
_COMING = {'converging', 'converging, not proved', 'about to start'}  # codes: passes by itself


class Candidates(Protocol):
    """What can be asked of virtual sensors, each given by its fault set and channel."""

    def ready(self, fault_set: FaultSet, channel: str) -> bool:
        """Tell whether it has forgotten its start and is good enough to serve."""

    def converges(self, fault_set: FaultSet, channel: str) -> bool:
        """Tell whether it has not, but knows how far off it still is, and is good enough."""

    def deviation(self, fault_set: FaultSet, channel: str) -> float:
        """Return its standard deviation now; infinite when not known."""

    def why_not(self, fault_set: FaultSet, channel: str) -> Reason | None:
        """Return why it is not ready; None: it is."""

    def why_not_again(self, fault_set: FaultSet, channel: str) -> Reason | None:
        """Return why it is not so clearly good enough that it may come back; None: it is."""


@dataclass(frozen=True)
class Choice:
    """
    What is remembered of the virtual sensors of each faulty channel.

    Who serves goes on while it may. Another takes over when its deviation is at most BETTER of
    that, or no more and its fault set is smaller. It does so at once when it has just become good
    enough; one that was ready without being better must be better for a WHILE first, so that
    noise in the deviations does not whip the output. One that still converges may take over from
    one that is ready, too: what is ready first may only be so noisy that it has nothing to forget.

    Whoever was given up during a fault, because it was no longer good enough, must first be
    clearly so again, for a dwell and at least a WHILE without interruption; a temporary one has
    served its time until the channel is believed again.
    """

    # by channel: the fault sets that it has a virtual sensor for, the smallest first
    designed: Mapping[str, tuple[tuple[frozenset[str], FaultSet], ...]]
    temporary: frozenset[tuple[FaultSet, str]]
    # by faulty channel: who was given up, and since when it is ready again
    lost: Mapping[str, Mapping[FaultSet, int | None]] = field(default_factory=dict)
    # by faulty channel: who else is ready, and since when it is better than who serves
    rivals: Mapping[str, Mapping[FaultSet, int | None]] = field(default_factory=dict)

    @classmethod
    def of(cls, design: Design) -> Choice:
        """Begin with all that is designed for the sensors."""
        designed: dict[str, list[FaultSet]] = {s: [] for s in design.sensors}
        temporary = set()
        for (fault_set, channel), entry in design.entries.items():
            if channel in designed and not isinstance(entry, Refusal):  # no wanted functional
                designed[channel].append(fault_set)
                if entry.grade == 'temporary':
                    temporary.add((fault_set, channel))
        return cls({s: tuple((frozenset(key), key) for key in sorted(keys, key=len))
                    for s, keys in designed.items()}, frozenset(temporary))

    def candidates(self, faulty: frozenset[str], channel: str) -> tuple[FaultSet, ...]:
        """Return the fault sets designed for a channel that hold all that is faulty."""
        return tuple(key for names, key in self.designed[channel] if faulty <= names)

    def able(self, key: FaultSet, channel: str, present: FaultSet, asked: Candidates) -> bool:
        """Tell whether a virtual sensor may serve, or go on, if it is the present one."""
        return key not in self.lost.get(channel, ()) and (
            asked.ready(key, channel) or (key == present and asked.converges(key, channel)))

    def choose(self, channel: str, faulty: frozenset[str], present: FaultSet, time: int,
               asked: Candidates) -> FaultSet | None:
        """Return whose virtual sensor serves a channel; None: nobody's. present: whose has."""
        keys = self.candidates(faulty, channel)
        able = [key for key in keys if self.able(key, channel, present, asked)]
        if not able:
            return None
        best = present if present in able else able[0]
        for key in able:
            if key != best and _takes_over(key, best, channel, asked) and (
                    present not in able or self._long_enough(key, channel, time)):
                best = key
        if asked.deviation(best, channel) < math.inf:  # else it may be the better one
            for key in keys:
                if key not in able and key not in self.lost.get(channel, ()) and \
                        asked.converges(key, channel) and _takes_over(key, best, channel, asked):
                    best = key
        return best

    def better_to_come(self, faulty: frozenset[str], channel: str, asked: Candidates) -> bool:
        """Tell whether the virtual sensor of a smaller set than any that is ready converges."""
        for key in self.candidates(faulty, channel):
            if asked.ready(key, channel):
                return False
            why = asked.why_not(key, channel)
            if why is not None and why.code in _COMING:
                return True
        return False

    def _long_enough(self, key: FaultSet, channel: str, time: int) -> bool:
        rivals = self.rivals.get(channel, {})
        since = rivals.get(key)
        return key not in rivals or (since is not None and time - since >= WHILE)

    # ------------------------------------------------------------------- what is remembered

    def given_up(self, faulty: frozenset[str], serving: Mapping[str, FaultSet],
                 dwells: Mapping[str, int], time: int, asked: Candidates) -> Choice:
        """Note who may serve no longer, until it was clearly good again for the dwell [ns]."""
        found: dict[str, dict[FaultSet, int | None]] = {}
        for channel in (*self.lost, *(s for s in serving if s not in self.lost)):
            keys = {key: self._again(key, channel, since, time, asked)
                    for key, since in self.lost.get(channel, {}).items()}
            present = serving.get(channel)
            if present is not None and faulty.issubset(present) and \
                    not (asked.ready(present, channel) or asked.converges(present, channel)):
                keys[present] = None
            keys = {key: since for key, since in keys.items()
                    if since is None or time - since < max(dwells[channel], WHILE)}
            if keys:
                found[channel] = keys
        return self if found == self.lost else replace(self, lost=found)

    def _again(self, key: FaultSet, channel: str, since: int | None, time: int,
               asked: Candidates) -> int | None:
        if (key, channel) in self.temporary or asked.why_not_again(key, channel) is not None:
            return None
        return time if since is None else since

    def compared(self, faulty: frozenset[str], serving: Mapping[str, FaultSet], time: int,
                 asked: Candidates) -> Choice:
        """Note how the others compare with who serves now."""
        found = {}
        for channel, present in serving.items():
            before = self.rivals.get(channel, {})
            rivals: dict[FaultSet, int | None] = {}
            for key in self.candidates(faulty, channel):
                if key == present or not self.able(key, channel, present, asked):
                    continue
                since = before.get(key)
                rivals[key] = None if not _takes_over(key, present, channel, asked) else \
                    time if since is None else since
            if rivals:
                found[channel] = rivals
        return self if found == self.rivals else replace(self, rivals=found)

    def only(self, faulty: frozenset[str]) -> Choice:
        """Forget all that is remembered of channels that are not faulty."""
        if faulty.issuperset(self.lost) and faulty.issuperset(self.rivals):
            return self
        return replace(self, lost={s: keys for s, keys in self.lost.items() if s in faulty},
                       rivals={s: keys for s, keys in self.rivals.items() if s in faulty})

    def set_back(self, time: int) -> Choice:
        """Let nothing have begun after a time, for the clock was set back."""
        lost, rivals = ({s: {key: None if t is None else min(t, time) for key, t in keys.items()}
                         for s, keys in what.items()} for what in (self.lost, self.rivals))
        return replace(self, lost=lost, rivals=rivals)


def perhaps(fault_set: FaultSet, channel: str) -> None:
    """Know of no virtual sensor that it can never serve."""


def _takes_over(key: FaultSet, present: FaultSet, channel: str, asked: Candidates) -> bool:
    own, other = asked.deviation(key, channel), asked.deviation(present, channel)
    return own < BETTER * other or (own <= other and len(key) < len(present))
