"""What a replacer would read in a bag: its topics and fields, by its own accessors."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.commissioning.likeness import nearest_topic
from vsensor_ros.commissioning.units import units_of
from vsensor_ros.lab.parameter_file import Parameters, read_parameters
from vsensor_ros.lab.wiring import topic_of
from vsensor_ros.node.accessor import Accessor
from vsensor_ros.node.cdr import Reader
from vsensor_ros.node.cdr_walk import compile_structure
from vsensor_ros.node.endpoints import find_field
from vsensor_ros.node.stamp import Stamp
from vsensor_ros.recordings.bag import Bag, Progress

KEYS = ('type', 'field', 'topic', 'input', 'stamp', 'stamp_unit', 'disowned')
CDR = b'\x00\x01'  # what begins a message that is read here: XCDR1, little endian


@dataclass(frozen=True)
class Wire:
    """Where a channel stands in a bag."""

    name: str
    topic: str
    accessor: Accessor
    stamps: tuple[Stamp, ...]  # where a message has its time; the first counts
    kind: Any


@dataclass
class Heard:
    """What was heard of one channel, in the order of the bag. Stamps are in ns."""

    stamps: array[int] = field(default_factory=lambda: array('q'))
    recorded: array[int] = field(default_factory=lambda: array('q'))
    values: array[float] = field(default_factory=lambda: array('d'))

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return stamps, times of the recording, and values."""
        return (np.array(self.stamps, np.int64), np.array(self.recorded, np.int64),
                np.array(self.values, float))


def wires_of(bag: Bag, parameters: Path) -> list[Wire]:
    """Return where each sensor and command of a parameter file is; raises BadInput."""
    told = read_parameters(parameters)
    names = dict.fromkeys(key.rpartition('.')[0] for key in told.given
                          if key.startswith(('sensors.', 'commands.')))
    return [_wire(bag, told, place) for place in names if place.count('.') == 1]


def _wire(bag: Bag, told: Parameters, place: str) -> Wire:
    given, where = told.given, str(told.path)
    for key in KEYS:
        if not isinstance(given.get(f'{place}.{key}', ''), str):
            raise BadInput(where, f'{place}.{key}',
                           f'{shown(given[f"{place}.{key}"])} is no text', 'write a text')
    for key in ('topic', 'type', 'field'):
        if not given.get(f'{place}.{key}'):
            raise BadInput(where, f'{place}.{key}', 'is missing',
                           'give topic, type and field of each sensor and command')
    output = topic_of(told, given[f'{place}.topic'], f'{place}.topic')
    wanted = [output]
    if place.startswith('sensors.'):  # before there was a replacer, its driver spoke on the output
        wanted.insert(0, topic_of(told, given.get(f'{place}.input') or f'{output}_raw',
                                  f'{place}.input'))
    topic = next((topic for topic in wanted if topic in bag.topics), None)
    if topic is None:
        kinds = {name: kind for name, (kind, _) in bag.topics.items()}
        near = next(filter(None, (nearest_topic(t, kinds, given[f'{place}.type'])
                                  for t in wanted)), None)
        raise BadInput(bag.path, place, f'has no topic {" or ".join(wanted)}',
                       f'did you mean {near}?' if near else f'it has {", ".join(bag.topics)}')
    kind, wanted_kind = bag.topics[topic][0], given[f'{place}.type']
    if kind != wanted_kind:
        raise BadInput(where, f'{place}.type', f'is {wanted_kind}, but {topic} carries {kind} in '
                       f'{bag.path}', 'name the type of the bag')
    problems: list[BadInput] = []
    found = find_field(given, place, where, problems)
    if problems or found is None:
        raise problems[0]
    return Wire(place.partition('.')[2], topic, found[2], found[3], found[1])


def heard_in(bag: Bag, wires: list[Wire], progress: Progress | None = None,
             ) -> Iterator[tuple[list[str], int, int, list[float | None]]]:
    """
    Yield names, stamp, time of the recording [ns] and values of each message; None: no number.

    Raises BadInput.
    """
    together: dict[tuple[str, tuple[str, ...]], list[Wire]] = {}
    for wire in wires:
        together.setdefault((wire.topic, tuple(s.path for s in wire.stamps)), []).append(wire)
    readers: dict[str, list[tuple[Reader, list[str]]]] = {}
    for (topic, _), group in together.items():
        if not is_readable(group[0].kind):
            raise BadInput(bag.path, topic, f'has in {bag.topics[topic][0]} what is not read here',
                           'name another topic')
        readers.setdefault(topic, []).append((
            Reader(group[0].kind, [w.accessor for w in group], group[0].stamps),
            [w.name for w in group]))
    for topic, recorded, raw in bag.messages(readers, progress):
        for reader, names in readers[topic]:
            reading = reader.read(raw) if raw[:2] == CDR else None
            if reading is not None:
                yield names, reading.stamp or recorded, recorded, [
                    value if isinstance(value, float) else None
                    for value in reading.values]


def read_wired(bag: Bag, wires: list[Wire], progress: Progress | None = None) -> dict[str, Heard]:
    """Return what was heard of each channel. Raises BadInput."""
    heard = {wire.name: Heard() for wire in wires}
    for names, stamp, recorded, values in heard_in(bag, wires, progress):
        for name, value in zip(names, values):
            if value is not None:
                track = heard[name]
                track.stamps.append(stamp)
                track.recorded.append(recorded)
                track.values.append(value)
    return heard


def units(wires: list[Wire]) -> Mapping[str, str]:
    """Return the units of channels, where the messages say them."""
    found = {}
    for wire in wires:
        if wire.accessor.angle is not None:
            found[wire.name] = 'rad'
            continue
        for step in reversed(wire.accessor.steps):  # what lies within has the unit of the nearest
            package = step.kind.__module__.split('.')[0]
            if known := units_of(f'{package}/{step.kind.__name__}', step.field):
                if len(known) == 1 and known[0]:
                    found[wire.name] = known[0]
                break
    return found


def is_readable(kind: Any) -> bool:
    """Tell whether all that is in a message class is known to the reader."""
    try:
        compile_structure(kind)
    except (KeyError, BadInput):  # a wide string, say; or a type that the bag does not define
        return False
    return True
