"""
What the fault isolation says: from its messages to the set of faulty sensors. Pure, no node.

A DiagnosticArray speaks of the sensors it names, and only of them: absence is not recovery.
A String holds the complete set, if it is understood; else it adds to the set. Anybody may publish
there, so that size, number and rate of what is looked at are bounded, and what is said of it too.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from heapq import nsmallest
from itertools import islice
import re

OK, WARN, ERROR, STALE = range(4)  # levels of diagnostic_msgs/msg/DiagnosticStatus
LARGEST = 2**18  # bytes of a message that is decoded (15 ms)
PER_SECOND = 2**20  # bytes a second that are decoded; one second's worth may come at once
STRANGERS = PER_SECOND // 4  # of messages that name no sensor, which must not crowd out others
LEAST = 1024  # bytes that a message counts as, at least: so it is 1024 messages a second, too
MOST_STATUSES = 4096  # of a message that are looked at
LARGEST_TEXT = 65536  # characters of a String that are looked at
FEW = 5  # problems of a message that are spelled out

TOO_LARGE = f'messages of more than {LARGEST} bytes'
TOO_MUCH = 'more messages a second than are read'


@dataclass(frozen=True)
class Isolation:
    """The faulty sensors after a message, and what in it could not be honoured."""

    faulty: frozenset[str]
    problems: tuple[str, ...] = ()


@dataclass(frozen=True)
class Allowance:
    """How many bytes may be decoded now; refilled as time passes, up to one second's worth."""

    left: float = PER_SECOND  # bytes
    time: int = 0  # ns, of a clock that is never set back
    rate: float = PER_SECOND  # bytes a second

    def admit(self, size: int, now: int) -> tuple[Allowance, str | None]:
        """Return what is left after a message of `size` bytes, and why it is not read, or None."""
        left = min(self.rate, self.left + self.rate * (now - self.time) * 1e-9)
        if size > LARGEST:
            return replace(self, left=left, time=now), TOO_LARGE
        size = max(size, LEAST)
        if size > left:
            return replace(self, left=left, time=now), TOO_MUCH
        return replace(self, left=left - size, time=now), None


def names_one(raw: bytes, sensors: Iterable[str]) -> bool:
    """Tell whether a sensor's name is among the strings of a serialized message; cheap."""
    return any(len(name).to_bytes(4, order) + name in raw
               for name in (sensor.encode() + b'\0' for sensor in sensors)
               for order in ('little', 'big'))


def names_one_in_text(raw: bytes, sensors: Iterable[str]) -> bool:
    """Tell whether a serialized String may name a sensor, or says that none is faulty; cheap."""
    return not raw[8:].strip(b'\0 \t\r\n,') or any(sensor.encode() in raw for sensor in sensors)


def from_statuses(statuses: Iterable[tuple[str, bytes | int]], sensors: Collection[str],
                  faulty: frozenset[str], shared: bool = True) -> Isolation:
    """
    Apply the (name, level) pairs of a DiagnosticArray to the set known so far.

    ERROR and STALE make a sensor faulty, OK makes it healthy, WARN (suspect, not isolated) leaves
    it as it is. Other names are other components' business on a shared topic (/diagnostics); on
    one of the isolation's own an ERROR or STALE of them is a problem.
    """
    after = set(faulty)
    wrong: dict[str, object] = {}
    unknown = set()
    rest = iter(statuses)
    for name, level in islice(rest, MOST_STATUSES):
        number = level[0] if isinstance(level, bytes) and level else level
        if name not in sensors:
            if not shared and number in (ERROR, STALE):
                unknown.add(name)
        elif number in (ERROR, STALE):
            after.add(name)
        elif number == OK:
            after.discard(name)
        elif number != WARN:
            wrong[name] = number
    problems = [f'{name}: level {number!r} is none of OK, WARN, ERROR, STALE; ignored'
                for name, number in islice(wrong.items(), FEW)]
    if next(rest, None) is not None:
        problems.append(f'more than {MOST_STATUSES} statuses; those beyond are ignored')
    return Isolation(frozenset(after), (*problems, *_strangers(unknown, sensors)))


def from_text(text: str, sensors: Collection[str], faulty: frozenset[str]) -> Isolation:
    """
    Read the complete set of faulty sensors from a String, separated by commas or blanks.

    An empty text means that all are healthy. With a name that is no sensor it is not known which
    are meant: then the sensors named are faulty and those known so far remain so. A text of
    unreasonable length leaves the set known so far.
    """
    if len(text) > LARGEST_TEXT:
        return Isolation(faulty, (f'a text of {len(text)} characters; ignored',))
    names = frozenset(name for name in re.split(r'[\s,]+', text) if name)
    unknown = names - set(sensors)
    if unknown:
        return Isolation(faulty | names & frozenset(sensors),
                         (*_strangers(unknown, sensors), 'so no sensor is taken as healthy'))
    return Isolation(names)


def _strangers(unknown: Collection[str], sensors: Collection[str]) -> Iterator[str]:
    for name in nsmallest(FEW, unknown):
        near = _near(name, sensors)
        yield f'{name!r:.80} is not a sensor' + (
            f'; did you mean {near}?' if near else f'; there are {", ".join(sensors):.400}')
    if len(unknown) > FEW:
        yield f'and {len(unknown) - FEW} more that are not sensors'


def _near(name: str, sensors: Iterable[str]) -> str | None:
    """Return the longest sensor's name in it; cheap, for garbage may come a thousand times."""
    text = name[:80].casefold()
    return max((s for s in sensors if s.casefold() in text), key=len, default=None)
