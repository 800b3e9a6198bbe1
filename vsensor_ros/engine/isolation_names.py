"""
By which names the fault isolation speaks of the sensors, and which others sound like one.

A sensor's own name counts, as the name of a status or as its hardware_id; so do the names that
the parameter isolation.names gives it. An ending alone does not: statuses of drivers, and those of
the replacer itself, end in the name of a sensor, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
import difflib
from fnmatch import translate
from glob import escape
import re

HARDWARE = 'hardware_id='  # what an entry for a hardware_id begins with
MOST_ENTRIES = 1000
MOST_PATTERNS = 50  # each is compared with every name that is not known
LONGEST = 200  # characters of a name that is looked at
_SPECIAL = re.compile(r'\[[^]]*\]|[*?[]')

Matches = Callable[[str], object]


class Wrong(ValueError):
    """An entry that cannot be used: what is wrong with it, and the mend."""

    def __init__(self, problem: str, mend: str) -> None:
        super().__init__(problem)
        self.problem, self.mend = problem, mend


@dataclass(frozen=True)
class Rules:
    """What stands for a sensor, as names and as patterns; '' stands for none."""

    exact: dict[str, str] = field(default_factory=dict)
    patterns: list[tuple[Matches, str]] = field(default_factory=list)

    def find(self, name: str) -> str | None:
        """Return the sensor that a name stands for; None: it is not known."""
        found = self.exact.get(name)
        if found is None and self.patterns:
            return next((sensor for matches, sensor in self.patterns if matches(name)), None)
        return found


@dataclass(frozen=True)
class Names:
    """All names of all sensors. Made by `of`; what is in it does not change any more."""

    sensors: tuple[str, ...]
    names: Rules  # of statuses
    hardware: Rules  # of their hardware_id
    folded: Mapping[str, str]  # the sensors without regard to case
    # what to look for in serialized messages
    whole: tuple[bytes, ...]  # names that are no patterns
    endings: tuple[bytes, ...]  # the least with which all of these end
    parts: tuple[bytes, ...]  # what is literal in the patterns, the longest of each

    @classmethod
    def of(cls, sensors: Iterable[str], entries: Iterable[str] = ()) -> Names:
        """
        Take the names of the sensors, and entries 'NAME=SENSOR', beside them; raises Wrong.

        NAME may be a pattern with *, ? and [..]; 'hardware_id=ID=SENSOR' is about a hardware_id.
        No sensor, 'NAME=': such a name is nobody's. 'isolator: *=*': each sensor by its name.
        """
        sensors, entries = tuple(sensors), [entry for entry in entries if entry]
        own = {sensor: sensor for sensor in sensors}
        names, hardware = Rules(dict(own)), Rules(dict(own))
        whole, parts = list(sensors), []
        if len(entries) > MOST_ENTRIES:
            raise Wrong(f'has {len(entries)} entries', f'at most {MOST_ENTRIES} are taken')
        for entry in entries:
            for name, sensor in _expanded(entry, sensors):
                rules = hardware if name.startswith(HARDWARE) else names
                name = name.removeprefix(HARDWARE)
                if _SPECIAL.search(name):
                    rules.patterns.append((re.compile(translate(name)).match, sensor))
                    parts.append(max(_SPECIAL.split(name), key=len))
                elif rules.exact.setdefault(name, sensor) != sensor:
                    raise Wrong(f'{entry!r:.80} gives {name!r:.80} to {sensor or "nobody"}, but '
                                f'it is that of {rules.exact[name] or "nobody"} already',
                                'give a name to one sensor')
                else:
                    whole.append(name)
        if len(parts) > MOST_PATTERNS:
            raise Wrong(f'has {len(parts)} patterns', f'at most {MOST_PATTERNS} are compared')
        more = [name for name in whole if not name.endswith(sensors)]
        return cls(sensors, names, hardware, {sensor.casefold(): sensor for sensor in sensors},
                   _encoded(whole, b'\0'), _encoded((*sensors, *more), b'\0'), _encoded(parts))

    def find(self, name: str, hardware_id: str = '') -> str | None:
        """Return the sensor that a status is about; '': none; None: it is not known."""
        found = self.names.find(name[:LONGEST])
        return self.hardware.find(hardware_id[:LONGEST]) if found is None and hardware_id \
            else found

    def alike(self, name: str) -> str | None:
        """Return the sensor whose name ends a name, as in 'node: y2' and '/robot/Y2'; cheap."""
        words = re.split(r'\W+', name[-LONGEST:])
        return self.folded.get(words[-1].casefold())

    def nearest(self, name: str) -> str | None:
        """Return the sensor that was most likely meant; takes its time."""
        text = name[-LONGEST:].casefold()
        inside = [sensor for folded, sensor in self.folded.items() if folded in text]
        if found := self.alike(name) or max(inside, key=len, default=None):
            return found
        near = difflib.get_close_matches(re.split(r'\W+', text)[-1], self.folded, 1)
        return self.folded[near[0]] if near else None

    def tell(self, name: str) -> str:
        """Say that a name is no sensor's, and the mend; takes its time."""
        near, entry = self.nearest(name), escape(name)
        if near is None or len(entry) > 100:
            return f'{name!r:.80} is not a sensor; there are {", ".join(self.sensors):.400}; ' \
                'isolation.names may give it to one of them'
        return f'{name!r:.80} is not a sensor; did you mean {near}? If so, add ' \
            f"{f'{entry}={near}'!r} to isolation.names; if not, {f'{entry}='!r}"


def _encoded(texts: Iterable[str], end: bytes = b'') -> tuple[bytes, ...]:
    return tuple(text.encode() + end for text in dict.fromkeys(texts))


def _expanded(entry: str, sensors: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield the names and sensors of one entry; raises Wrong."""
    name, equals, sensor = entry.rpartition('=')
    name, sensor = name.strip(), sensor.strip()
    bare = name.removeprefix(HARDWARE)
    if not equals or not bare:
        raise Wrong(f'{entry!r:.80} is not NAME=SENSOR', "write it like 'isolator: y2=y2'")
    if len(name) > LONGEST:
        raise Wrong(f'{entry!r:.80}.. has a name of {len(name)} characters',
                    f'at most {LONGEST} are compared')
    special = _SPECIAL.findall(bare)
    if special and not any(_SPECIAL.split(bare)):
        raise Wrong(f'{entry!r:.80} is for every name there is', 'give a part of the name, too')
    if sensor == '*':
        if special != ['*']:
            raise Wrong(f'{entry!r:.80} does not say which part of the name is that of the sensor',
                        "put one * in its place, as in 'isolator: *=*'")
        yield from ((name.replace('*', s), s) for s in sensors)
    elif sensor and sensor not in sensors:
        near = difflib.get_close_matches(sensor[:LONGEST], sensors, 1)
        raise Wrong(f'{entry!r:.80} is for {sensor!r:.80}, which is not a sensor',
                    f'did you mean {near[0]}?' if near else
                    f'name one of {", ".join(sensors):.400}')
    else:
        yield name, sensor
