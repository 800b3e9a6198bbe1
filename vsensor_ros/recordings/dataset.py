"""
Recordings that were wired once, as a file that the commands take: paths, wiring, windows, delays.

    recordings: [run1.csv, run2.csv]    # or bags; paths begin beside this file
    columns: {T1: temperature_1}        # of tables: the column of each channel
    wiring: replacer.yaml               # of bags: the replacer's parameter file
    time: t                             # a table's column with the times, if it is not called so
    time_unit: ms                       # of its numbers; s, or as they look
    period: 0.01                        # s between two rows of a table that has no times
    windows: {every: 60, length: 10}    # s; start, end, too; else the first at 50
    delays: {gyro: 0.36}                # s by which stamps are later than what they are of
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from vsensor_ros.bad_input import BadInput, reason, shown
from vsensor_ros.plant.plant_yaml import read_yaml
from vsensor_ros.recordings.bag import is_bag, open_bag, Progress
from vsensor_ros.recordings.columns import Clock, open_table, Table, UNITS
from vsensor_ros.recordings.recording import BEGIN, Recording, Track
from vsensor_ros.whole_file import write_whole

KEYS = ('recordings', 'columns', 'wiring', 'time', 'time_unit', 'period', 'windows', 'delays')
WINDOW_KEYS = ('every', 'length', 'start', 'end')


@dataclass(frozen=True)
class Windows:
    """Parts of a recording, at even distances [s from its first stamp on]."""

    every: float
    length: float
    start: float = 0.0
    end: float = math.inf

    @classmethod
    def after_health(cls, every: float, length: float) -> Windows:
        """Return those before the first of which all is well as long as between the others."""
        return cls(every, length, max(0.0, every - length))

    @classmethod
    def of(cls, text: str) -> Windows:
        """Return those of a command line, ``60,10`` or ``60,10,300``; raises BadInput."""
        try:
            every, length, *start = map(float, text.split(','))
        except ValueError:
            every, length, start = 0.0, 0.0, []
        if not (0.0 < every < math.inf and 0.0 < length < math.inf) or len(start) > 1 or not all(
                0.0 <= first < math.inf for first in start):
            raise BadInput('--windows', '', f'{shown(text)} are no two numbers of seconds, or '
                           'three', 'write --windows 60,10, or with a start 60,10,300')
        made = cls.after_health(every, length)
        return cls(every, length, *start) if start else made

    def starts(self, seconds: float) -> np.ndarray:
        """Return where windows begin that lie in a recording of so many seconds, (N,)."""
        last = min(self.end, seconds) - self.length
        return np.arange(self.start, last + 1e-9, self.every)


@dataclass(frozen=True)
class Dataset:
    """What a dataset file says."""

    recordings: tuple[Path, ...]
    wiring: Path | None = None  # of bags
    columns: Mapping[str, str] = field(default_factory=dict)  # of tables, by channel; {}: as named
    clock: Clock = field(default_factory=Clock)
    windows: Windows | None = None
    delays: Mapping[str, float] = field(default_factory=dict)  # s, by channel

    def load(self, progress: Progress | None = None) -> tuple[Recording, ...]:
        """Read the recordings; raises BadInput."""
        return tuple(_read(path, self, progress) for path in self.recordings)


def load_dataset(path: str | Path, progress: Progress | None = None) -> tuple[Recording, ...]:
    """
    Read all recordings of a dataset file, wired, with its delays taken off.

    progress: is called with how much of how much is done, and of what. Raises BadInput.
    """
    return read_dataset(path).load(progress)


def read_dataset(path: str | Path) -> Dataset:
    """Read a dataset file, but not what it names; raises BadInput."""
    where = Path(path)
    found = read_yaml(where, 'dataset file')
    if not isinstance(found, dict) or not found.get('recordings'):
        raise BadInput(where, 'recordings', 'are missing', 'list their paths: recordings: [..]')
    for key in found:
        if key not in KEYS:
            raise BadInput(where, str(key), 'is not known', f'its keys are {", ".join(KEYS)}')
    paths = found['recordings']
    if not isinstance(paths, list) or not all(isinstance(p, str) for p in paths):
        raise BadInput(where, 'recordings', f'{shown(paths)} is no list of paths',
                       'write recordings: [run1.csv, run2.csv]')
    folder = where.absolute().parent
    wiring = _text(found, 'wiring', where)
    return Dataset(
        tuple(folder / p for p in paths), folder / wiring if wiring else None,
        columns_of(found.get('columns') or {}, where),
        Clock(_text(found, 'time', where), _unit(found, where),
              _number(found, 'period', where, 0.0)),
        _windows(found.get('windows'), where),
        {str(name): _number(_mapping(found, 'delays', where), name, where, 0.0, signed=True)
         for name in _mapping(found, 'delays', where)})


def write_dataset(path: Path, dataset: Dataset) -> None:
    """Write a dataset file, whole or not at all; paths are relative to it. Raises BadInput."""
    folder = path.absolute().parent
    clock, windows = dataset.clock, dataset.windows
    said: dict[str, Any] = {
        'recordings': [os.path.relpath(p, folder) for p in dataset.recordings],
        'wiring': os.path.relpath(dataset.wiring, folder) if dataset.wiring else None,
        'columns': dict(dataset.columns), 'time': clock.column, 'time_unit': clock.unit,
        'period': clock.period,
        'windows': None if windows is None else {
            key: float(f'{value:.9g}') for key in WINDOW_KEYS
            if math.isfinite(value := getattr(windows, key))},
        'delays': dict(dataset.delays)}
    try:
        write_whole(path, yaml.safe_dump({key: value for key, value in said.items() if value},
                                         sort_keys=False, allow_unicode=True))
    except (OSError, ValueError) as error:
        raise BadInput(path, 'dataset', f'cannot be written ({reason(error)})',
                       'name a file in a folder that exists and is writable') from error


def read_mapping(path: Path) -> dict[str, str]:
    """Read a file that says channel: column, for tables. Raises BadInput."""
    found = read_yaml(path)
    return columns_of(found.get('columns', found) if isinstance(found, dict) else found, path)


def columns_of(found: object, where: Path) -> dict[str, str]:
    """Return the columns by channel; raises BadInput."""
    if not isinstance(found, dict) or not all(
            isinstance(k, str) and isinstance(v, str) for k, v in found.items()):
        raise BadInput(where, 'columns', f'{shown(found)} does not say channel: column',
                       'write T1: temperature_1, a line for each')
    return dict(found)


def _read(path: Path, dataset: Dataset, progress: Progress | None) -> Recording:
    units: Mapping[str, str]
    if is_bag(path):
        raw, units = _from_bag(path, dataset.wiring, progress)
    else:
        table = open_table(path, dataset.clock)
        raw, units = _from_table(table, wanted_columns(table, dataset.columns), progress)
    silent = [name for name, (stamps, _) in raw.items() if not len(stamps)]
    if silent or not raw:
        raise BadInput(path, ', '.join(silent), 'says nothing', 'wire it to what is recorded')
    check_delays(path, dataset, raw)
    first = min(int(stamps.min()) for stamps, _ in raw.values())
    shift = max(0, BEGIN - first)  # a clock at 0 has not begun
    return Recording({name: Track.in_order(
        stamps + shift - round(dataset.delays.get(name, 0.0) * 1e9), values, first + shift)
        for name, (stamps, values) in raw.items()}, path.name, units)


def check_delays(path: Path, dataset: Dataset, channels: Collection[str]) -> None:
    """Raise BadInput where a delay is of no channel of a recording."""
    for name in dataset.delays:
        if name not in channels:
            raise BadInput(path, f'delays.{name}', 'is no channel',
                           f'its channels are {", ".join(channels)}')


def _from_bag(path: Path, wiring: Path | None, progress: Progress | None,
              ) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], Mapping[str, str]]:
    if wiring is None:
        raise BadInput(path, 'wiring', 'is missing', "name a replacer's parameter file, which "
                       'says where each channel is')
    from vsensor_ros.recordings.bag_wiring import read_wired, units, wires_of

    with open_bag(path) as bag:
        wires = wires_of(bag, wiring)
        heard = read_wired(bag, wires, progress)
        return {name: h.arrays()[::2] for name, h in heard.items()}, units(wires)


def wanted_columns(table: Table, columns: Mapping[str, str]) -> dict[str, str]:
    """Return the column of each channel, all of a table where none are named. Raises BadInput."""
    for channel, column in columns.items():
        if column not in table.columns:
            raise BadInput(table.path, channel, f'there is no column of numbers {shown(column)}',
                           f'its columns are {", ".join(table.columns)}')
    return dict(columns) or {column: column for column in table.columns}


def _from_table(table: Table, columns: Mapping[str, str], progress: Progress | None,
                ) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], Mapping[str, str]]:
    stamps: dict[str, list[np.ndarray]] = {name: [] for name in columns}
    values: dict[str, list[np.ndarray]] = {name: [] for name in columns}
    rows = 0
    for times, piece in table.chunks(list(dict.fromkeys(columns.values()))):
        rows += len(times)
        if progress is not None:
            progress(rows, max(table.rows, rows), table.path.name)
        for name, column in columns.items():
            there = ~np.isnan(piece[column])  # an empty cell: nothing was said
            stamps[name].append(times[there])
            values[name].append(piece[column][there])
    empty = np.zeros(0, np.int64)
    return ({name: (np.concatenate([empty, *stamps[name]]), np.concatenate([[], *values[name]]))
             for name in columns},
            {name: table.units[c] for name, c in columns.items() if c in table.units})


def _mapping(found: Mapping[str, Any], key: str, where: Path) -> Mapping[str, Any]:
    said = found.get(key) or {}
    if not isinstance(said, dict):
        raise BadInput(where, key, f'{shown(said)} is no mapping', 'write name: value')
    return said


def _text(found: Mapping[str, Any], key: str, where: Path) -> str:
    said = found.get(key) or ''
    if not isinstance(said, str):
        raise BadInput(where, key, f'{shown(said)} is no text', 'write a name')
    return said


def _unit(found: Mapping[str, Any], where: Path) -> str:
    unit = _text(found, 'time_unit', where)
    if unit and unit not in UNITS:
        raise BadInput(where, 'time_unit', f'{shown(unit)} is not a unit of time',
                       f'choose from {", ".join(UNITS)}')
    return unit


def _number(found: Mapping[str, Any], key: str, where: Path, default: float | None = None,
            signed: bool = False) -> float:
    said = found.get(key, default)
    if isinstance(said, bool) or not isinstance(said, (int, float)) or not math.isfinite(said) \
            or (said < 0 and not signed):
        raise BadInput(where, key, f'{shown(said)} is no number of seconds', 'write it like 2.5')
    return float(said)


def _windows(found: object, where: Path) -> Windows | None:
    if found is None:
        return None
    if not isinstance(found, dict) or not set(found) <= set(WINDOW_KEYS):
        raise BadInput(where, 'windows', f'{shown(found)} says no windows',
                       'write windows: {every: 60, length: 10}')
    made = Windows.after_health(_number(found, 'every', where), _number(found, 'length', where))
    made = replace(made, start=_number(found, 'start', where, made.start),
                   end=_number(found, 'end', where) if 'end' in found else math.inf)
    if made.every <= 0.0 or made.length <= 0.0:
        raise BadInput(where, 'windows', 'every and length must be above 0',
                       'write windows: {every: 60, length: 10}')
    return made
