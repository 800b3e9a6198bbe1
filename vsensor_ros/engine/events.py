"""What goes into the engine, and what comes out of it: plain data. Times are in ns."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from vsensor_ros.reason import Reason

Token = Any  # stands for a message; the engine hands it back and does not look into it
ANYBODYS = -1  # in place of the number of a sender: the message may be that of any


class Message(Protocol):
    """What the engine wants to know of one message of a stream."""

    @property
    def stamp(self) -> int | None:
        """Its stamp; None when it has none, or one that was not filled in."""

    @property
    def values(self) -> tuple[float | Reason, ...]:
        """By channel of the stream: the number, or why there is none."""

    @property
    def foreign(self) -> bool:
        """Whether it has none of the stream's channels, and may be sound all the same."""


class Forward(NamedTuple):
    """The message goes on; these fields of it, by index of the channel, get other values."""

    changed: Mapping[int, float]


AS_IT_CAME = Forward(MappingProxyType({}))


class Substitute(NamedTuple):
    """What goes out in place of a failed reading, in the unit of the channel."""

    value: float  # NaN: there is none
    fault_set: tuple[str, ...] | None  # of the virtual sensor that says so; None: nobody does
    deviation: float  # standard deviation; inf when not known
    interval: tuple[float, float] | None  # in which the truth lies, where that is known
    grade: str  # of the virtual sensor; '' when there is none
    offset: float  # in the value, so that there is no step; it dies out
    doubtful: float = 0.0  # of the offset, what may be the fault


class Reserve(NamedTuple):
    """What would go out in place of a healthy reading, beside it, in the unit of the channel."""

    name: str  # of the channel
    reading: float  # NaN: there is none
    estimate: float
    deviation: float  # standard deviation; inf when not known
    ready: bool  # it would serve; else it is only looked at


class Functional(NamedTuple):
    """What is wanted besides sensors: a functional of the states, or a fault."""

    name: str
    value: float
    deviation: float  # standard deviation; inf when not known
    interval: tuple[float, float] | None  # in which the truth lies
    ready: bool  # it has forgotten its start, and may be used


class Composition(NamedTuple):
    """A message to be made of a template and sent; `Engine.done` wants to know how it went."""

    stream: int
    sender: int  # number of who sends such messages
    template: Token | None  # its last message of use; None: none, begin with an empty one
    first: Token | None  # its first message: numbers that have changed since are measurements
    blank: bool  # it is silent: none of what was measured is to be repeated
    stamp: int
    time: int  # of the state that the estimates are of
    # by channel of the sender, as its index in the stream: what takes the place of its reading,
    # its live value, or None: NaN, if the template has a number there
    fields: tuple[tuple[int, Substitute | float | None], ...]


class Remark(NamedTuple):
    """Something to be said to people, who have no use for hearing it all the time."""

    level: str  # 'error', 'warning' or 'info'
    what: Reason
    subject: object  # what it is about: one remark on it now and then will do


class IsolationReport(NamedTuple):
    """What one source of isolation says now."""

    faulty: Mapping[str, int]  # the faulty sensors, each with the time since which it is
    knows: frozenset[str]  # the sensors that it has said anything of


def together(*reports: IsolationReport) -> IsolationReport:
    """
    Return what several sources say in all: faulty is whom any of them takes for it.

    Since the earliest time that one knows; 0: nobody knows.
    """
    faulty: dict[str, int] = {}
    for report in reports:
        for name, since in report.faulty.items():
            known = [time for time in (since, faulty.get(name, 0)) if time]
            faulty[name] = min(known, default=0)
    return IsolationReport(faulty, frozenset().union(*(report.knows for report in reports)))
