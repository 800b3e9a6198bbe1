"""
What the fault isolation says: from its messages to the set of faulty sensors. Pure, no node.

A DiagnosticArray speaks of the sensors it names, and only of them: absence is not recovery. Each
name speaks for itself: a sensor is faulty while any name that stands for it is. A String holds the
complete set, if it is understood; else it adds to the set. Anybody may publish there, so that
size, number and rate of what is looked at are bounded, and what is said of it too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
import re
from typing import Literal

from vsensor_ros.engine.isolation_names import LONGEST, Names

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

Key = tuple[str, str]  # a sensor, and the name that stood for it


@dataclass(frozen=True)
class Said:
    """What a message says, and what in it could not be honoured."""

    faulty: Mapping[Key, bool]  # of whom it speaks: faulty or healthy
    problems: tuple[str, ...] = ()
    # names that are no sensor's, though they are said to be faulty (True) or sound like one
    strangers: Mapping[str, bool] = field(default_factory=dict)


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


def may_name_one(raw: bytes, names: Names) -> bool:
    """Tell whether a string in a serialized message names a sensor or ends like one; cheap."""
    return any(ending in raw for ending in names.endings) or any(
        part in raw for part in names.parts)


def names_one(raw: bytes, names: Names) -> bool:
    """Tell whether a sensor's name is among the strings of a serialized message; cheap."""
    order: Literal['little', 'big'] = 'little' if raw[1:2] == b'\1' else 'big'
    return any(part in raw for part in names.parts) or any(
        len(name).to_bytes(4, order) + name in raw for name in names.whole)


def names_one_in_text(raw: bytes, names: Names) -> bool:
    """Tell whether a serialized String may name a sensor, or says that none is faulty; cheap."""
    return not raw[8:].strip(b'\0 \t\r\n,') or any(
        part in raw for part in (*names.parts, *(ending[:-1] for ending in names.endings)))


def from_statuses(statuses: Iterable[tuple[str, bytes | int, str]], names: Names,
                  shared: bool = True) -> Said:
    """
    Read the (name, level, hardware_id) of the statuses of a DiagnosticArray.

    ERROR and STALE make a sensor faulty, OK makes it healthy, WARN (suspect, not isolated) leaves
    it as it is; of several statuses of one name the worst counts. Other names are other
    components' business on a shared topic (/diagnostics), unless they end like a sensor's; on one
    of the isolation's own an ERROR or STALE of them is a problem, too.
    """
    worst: dict[Key, int] = {}
    wrong: dict[str, object] = {}
    strangers: dict[str, bool] = {}
    rest = iter(statuses)
    for name, level, hardware_id in islice(rest, MOST_STATUSES):
        name, number = name[:LONGEST], level[0] if isinstance(level, bytes) and level else level
        sensor = names.find(name, hardware_id)
        if sensor is None:
            bad = number in (ERROR, STALE)
            if (bad and not shared) or names.alike(name):
                strangers[name] = bad or strangers.get(name, False)
        elif number not in (OK, WARN, ERROR, STALE):
            wrong[name] = number
        elif sensor:
            assert isinstance(number, int)
            worst[sensor, name] = max(number, worst.get((sensor, name), OK))
    problems = [f'{name:.80}: level {number!r} is none of OK, WARN, ERROR, STALE; ignored'
                for name, number in islice(wrong.items(), FEW)]
    if next(rest, None) is not None:
        problems.append(f'more than {MOST_STATUSES} statuses; those beyond are ignored')
    return Said({key: number != OK for key, number in worst.items() if number != WARN},
                tuple(problems), strangers)


def from_text(text: str, names: Names) -> Said:
    """
    Read the complete set of faulty sensors from a String, separated by commas or blanks.

    An empty text means that all are healthy. With a name that is no sensor it is not known which
    are meant: then the sensors named are faulty and those known so far remain so. A text of
    unreasonable length says nothing.
    """
    if len(text) > LARGEST_TEXT:
        return Said({}, (f'a text of {len(text)} characters; ignored',))
    meant = {name: names.find(name) for name in re.split(r'[\s,]+', text) if name}
    strangers = {name: True for name, sensor in meant.items() if sensor is None}
    faulty = set(meant.values())
    if strangers:
        return Said({(s, s): True for s in names.sensors if s in faulty},
                    ('so no sensor is taken as healthy',), strangers)
    return Said({(s, s): s in faulty for s in names.sensors})
