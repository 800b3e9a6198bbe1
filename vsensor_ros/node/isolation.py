"""
What the fault isolation says: from its messages to the set of faulty sensors. Pure, no node.

A DiagnosticArray speaks of the sensors it names, and only of them: absence is not recovery.
A String holds the complete set, if it is understood; else it adds to the set.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
import difflib
import re

OK, WARN, ERROR, STALE = range(4)  # levels of diagnostic_msgs/msg/DiagnosticStatus
LARGEST_TEXT = 65536  # characters of a String that are looked at


@dataclass(frozen=True)
class Isolation:
    """The faulty sensors after a message, and what in it could not be honoured."""

    faulty: frozenset[str]
    problems: tuple[str, ...] = ()


def from_statuses(statuses: Iterable[tuple[str, bytes | int]], sensors: Collection[str],
                  faulty: frozenset[str], shared: bool = True) -> Isolation:
    """
    Apply the (name, level) pairs of a DiagnosticArray to the set known so far.

    ERROR and STALE make a sensor faulty, OK makes it healthy, WARN (suspect, not isolated) leaves
    it as it is. Other names are other components' business on a shared topic (/diagnostics); on
    one of the isolation's own an ERROR or STALE of them is a problem.
    """
    after = set(faulty)
    problems = []
    unknown = set()
    for name, level in statuses:
        number = level[0] if isinstance(level, bytes) and level else level
        if name not in sensors:
            if not shared and number in (ERROR, STALE):
                unknown.add(name)
            continue
        if number in (ERROR, STALE):
            after.add(name)
        elif number == OK:
            after.discard(name)
        elif number != WARN:
            problems.append(f'{name}: level {number!r} is none of OK, WARN, ERROR, STALE; ignored')
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


def _strangers(unknown: Collection[str], sensors: Collection[str]) -> list[str]:
    problems = []
    for name in sorted(unknown)[:5]:
        near = difflib.get_close_matches(name, sensors, 1)
        problems.append(f'{name!r:.80} is not a sensor' + (
            f'; did you mean {near[0]}?' if near else f'; there are {", ".join(sensors)}'))
    if len(unknown) > 5:
        problems.append(f'and {len(unknown) - 5} more that are not sensors')
    return problems
