"""Goes through a recording, and puts what comes by into the tallies of the survey."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.recordings.bag import Bag, is_bag, open_bag, Progress
from vsensor_ros.recordings.columns import open_table
from vsensor_ros.recordings.dataset import check_delays, Dataset, wanted_columns
from vsensor_ros.recordings.survey import (
    Channel,
    ClockTally,
    nothing_of,
    Survey,
    ValueTally,
    with_copies,
)

LOOKS = 10  # messages of a topic that are looked into for numbers
LARGEST = 2**16  # bytes of a message that is: images and clouds are no sensors
MOST_FIELDS = 500  # of a topic
FLUSH = 4096  # messages that are put together

Said = tuple[Sequence[str], int, int, Sequence[float | None]]  # names, stamp, recorded, values


class _Group:
    """Channels that come together: one clock, some values."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names, self.clock = names, ClockTally()
        self.values = [ValueTally() for _ in names]
        self._stamps: list[int] = []
        self._recorded: list[int] = []
        self._rows: list[Sequence[float | None]] = []

    def take(self, stamp: int, recorded: int, values: Sequence[float | None]) -> None:
        self._stamps.append(stamp)
        self._recorded.append(recorded)
        self._rows.append(values)
        if len(self._rows) >= FLUSH:
            self.flush()

    def flush(self) -> None:
        self.clock.take(np.array(self._stamps, np.int64), np.array(self._recorded, np.int64))
        for i, tally in enumerate(self.values):
            tally.take(np.array([row[i] for row in self._rows if row[i] is not None], float))
        self._stamps, self._recorded, self._rows = [], [], []

    def channels(self, units: Mapping[str, str]) -> list[Channel]:
        found = []
        for name, tally in zip(self.names, self.values):
            channel = self.clock.fill(nothing_of(name, units.get(name, '')))
            found.append(tally.fill(channel, channel.rate))
        return found


def survey(path: Path, dataset: Dataset, progress: Progress | None = None) -> Survey:
    """Return what is in one recording, wired as a dataset says. Raises BadInput."""
    if is_bag(path):
        return _survey_bag(path, dataset, progress)
    table = open_table(path, dataset.clock)
    columns = wanted_columns(table, dataset.columns)
    check_delays(path, dataset, columns)
    clock, tallies, rows = ClockTally(), {name: ValueTally() for name in columns}, 0
    for stamps, values in table.chunks(list(dict.fromkeys(columns.values()))):
        rows += len(stamps)
        if progress is not None:
            progress(rows, max(rows, table.rows), path.name)
        clock.take(stamps)
        for name, column in columns.items():
            tallies[name].take(values[column])
    channels = []
    for name, tally in tallies.items():
        channel = clock.fill(nothing_of(name, table.units.get(columns[name], '')))
        channels.append(tally.fill(channel, channel.rate))
    notes = [f'times: {table.time}' if table.time else 'times: of the rows, by the period']
    if table.left and not dataset.columns:
        notes.append(f'not numbers in all rows, left out: {", ".join(table.left)}')
    return Survey(path.name, table.form, clock.first, (clock.last - clock.first) * 1e-9,
                  with_copies(channels), tuple(notes))


def _survey_bag(path: Path, dataset: Dataset, progress: Progress | None) -> Survey:
    from vsensor_ros.recordings.bag_wiring import heard_in, units, wires_of

    groups: dict[tuple[str, ...], _Group] = {}
    known: dict[str, str] = {}
    left: dict[str, str] = {}
    with open_bag(path) as bag:
        if dataset.wiring is not None:
            wires = wires_of(bag, dataset.wiring)
            check_delays(path, dataset, [wire.name for wire in wires])
            known.update(units(wires))
            said: Iterator[Said] = heard_in(bag, wires, progress)
            asked = [wire.name for wire in wires]
        else:
            said, asked = _all_in(bag, known, left, progress), []
        for names, stamp, recorded, values in said:
            key = tuple(names)
            group = groups.get(key)
            if group is None:
                group = groups[key] = _Group(names)
            group.take(stamp, recorded, values)
        for group in groups.values():
            group.flush()
        found = [c for group in groups.values() for c in group.channels(known)]
        if asked:
            by_name = {c.name: c for c in found}
            found = [by_name.get(name) or ValueTally().fill(nothing_of(name), 0.0)
                     for name in asked]
        heard = [group.clock for group in groups.values() if group.clock.count]
        first = min((clock.first for clock in heard), default=0)
        last = max((clock.last for clock in heard), default=0)
        silent = [topic for topic, (_, count) in bag.topics.items() if not count]
        notes = [f'{topic} ({kind}): {why}' for topic, why in left.items()
                 for kind, _ in [bag.topics[topic]]]
        notes += [f'{topic}: no message' for topic in silent if not asked]
        return Survey(path.name, bag.form, first, (last - first) * 1e-9, with_copies(found),
                      tuple(notes))


def _all_in(bag: Bag, known: dict[str, str], left: dict[str, str],
            progress: Progress | None) -> Iterator[Said]:
    """
    Yield all numbers of a bag that may be signals, found in the first messages of each topic.

    Puts their units into `known`, and into `left` why a topic has none.
    """
    from vsensor_ros.commissioning.candidates import leaves
    from vsensor_ros.node.cdr import Reader
    from vsensor_ros.node.stamp import compile_stamps
    from vsensor_ros.recordings.bag_kinds import decode
    from vsensor_ros.recordings.bag_wiring import CDR, is_readable

    readers: dict[str, list[tuple[Reader, list[str]]]] = {}
    looked = dict.fromkeys(bag.topics, 0)
    fields: dict[str, set[str]] = {topic: set() for topic in bag.topics}
    for topic, recorded, raw in bag.messages(bag.topics, progress):
        if looked[topic] < LOOKS and topic not in left:
            looked[topic] += 1
            kind = bag.kinds.get(bag.topics[topic][0])
            if kind is None or not is_readable(kind):
                left[topic] = 'its type is not read here'
            elif len(raw) > LARGEST:
                left[topic] = "its messages are too large to be a sensor's"
            elif (message := decode(kind, raw)) is not None:
                new = [leaf for leaf in leaves(message) if leaf.path not in fields[topic]]
                new = new[:MOST_FIELDS - len(fields[topic])]
                paths = [leaf.path for leaf in new if _is_field(kind, leaf.path)]
                fields[topic].update(leaf.path for leaf in new)
                if paths:
                    readers.setdefault(topic, []).append((
                        Reader(kind, paths, compile_stamps(kind)),
                        [f'{topic} {p}' for p in paths]))
                known.update({f'{topic} {leaf.path}': leaf.units[0] for leaf in new
                              if len(leaf.units) == 1})
        for reader, names in readers.get(topic, ()):
            reading = reader.read(raw) if raw[:2] == CDR else None
            if reading is not None:
                yield names, reading.stamp or recorded, recorded, [
                    value if isinstance(value, float) else None for value in reading.values]
    left.update({topic: 'no numbers in it' for topic, (_, count) in bag.topics.items()
                 if count and topic not in readers and topic not in left})


def _is_field(kind: object, path: str) -> bool:
    from vsensor_ros.node.field_path import trace
    try:
        trace(kind, path)
    except BadInput:
        return False
    return True
