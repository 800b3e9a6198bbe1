"""
Who serves each channel: the sensor itself, a virtual sensor, or nobody.

A pure state machine: events and a time [ns] go in, a new Switch comes out; nothing else changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum

from vsensor_ros.virtual_sensor import Design, Refusal


class Source(Enum):
    """Where a channel's values come from."""

    REAL = 'real'
    VIRTUAL = 'virtual'
    NONE = 'none'


@dataclass(frozen=True)
class Decision:
    """Who serves one channel."""

    source: Source
    fault_set: tuple[str, ...] = ()  # of the virtual sensor that serves, in the design's order
    reason: str = ''  # why nobody does


@dataclass(frozen=True)
class Switch:
    """
    The set of faulty sensors, and for each channel the decision that follows from it.

    The exact set is looked up: a set that was not designed for serves none of its channels.
    `since` is the time [ns] of each channel's last change of decision, None before the first;
    `switches` counts the changes.
    """

    sensors: tuple[str, ...]
    faulty: frozenset[str]
    decisions: Mapping[str, Decision]
    since: Mapping[str, int | None]
    switches: Mapping[str, int]
    design: Design

    @classmethod
    def of(cls, design: Design) -> Switch:
        """Begin with all sensors healthy."""
        return cls(design.sensors, frozenset(), {s: Decision(Source.REAL) for s in design.sensors},
                   dict.fromkeys(design.sensors), dict.fromkeys(design.sensors, 0), design)

    def report(self, name: str, faulty: bool, time: int) -> Switch:
        """Take one sensor as faulty or healthy, the others as before; KeyError if unknown."""
        return self.isolate(self.faulty | {name} if faulty else self.faulty - {name}, time)

    def isolate(self, names: Iterable[str], time: int) -> Switch:
        """Take these sensors as faulty and all others as healthy; KeyError if one is unknown."""
        faulty = frozenset(names)
        unknown = sorted(faulty - set(self.sensors))
        if unknown:
            raise KeyError(f'{", ".join(unknown)}: no such sensor')
        decisions = {s: decide(self.design, faulty, s) for s in self.sensors}
        changed = [s for s in self.sensors if decisions[s] != self.decisions[s]]
        if not changed and faulty == self.faulty:
            return self
        return replace(
            self, faulty=faulty, decisions=decisions,
            since={**self.since, **dict.fromkeys(changed, time)},
            switches={s: n + (s in changed) for s, n in self.switches.items()})


def decide(design: Design, faulty: frozenset[str], channel: str) -> Decision:
    """Decide who serves a channel when exactly these sensors are faulty."""
    if channel not in faulty:
        return Decision(Source.REAL)
    fault_set = tuple(s for s in design.sensors if s in faulty)
    entry = design.entries.get((fault_set, channel))
    if entry is None:
        return Decision(Source.NONE, reason=f'no design for the faulty sensors '
                                            f'{", ".join(fault_set)}')
    if isinstance(entry, Refusal):
        return Decision(Source.NONE, reason=entry.reason)
    return Decision(Source.VIRTUAL, fault_set)
