"""
The work file: what a sweep has answered so far, so that a run that was stopped can go on.

One line of JSON for each answer, appended as it comes, below a line that tells whose they are. An
answer stands there as in the design file, and is checked as such when it is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.designer.semidefinite import is_there
from vsensor_ros.observers import Entry, Key, Refusal
from vsensor_ros.observers.checked_json import CheckedObject, LARGEST_FILE, parse_json
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.file import entry_record, read_entry, VERSION
from vsensor_ros.plant import Plant
from vsensor_ros.text_file import looked_in

FORMAT = 'vsensor_ros work'
MEND = 'delete it, and what it holds is designed anew'


class WorkFile:
    """
    Answers by fault set and channel, in a file that is made with the first of them.

    An answer holds while the same refusal with fewer faults came before it: ``lost``, None where
    none did; one that was made without cvxpy, until that is there. Raises BadInput, one line, for
    a file that is of another plant or of other choices, or malformed; a last line that was cut
    off is dropped.
    """

    def __init__(self, path: str | Path, plant: Plant, choices: Mapping[str, Any],
                 empty: Contents) -> None:
        self._path = path
        self._head = {'format': FORMAT, 'version': VERSION,
                      'plant': fingerprint(replace(plant, remake=None)),
                      'choices': fingerprint(dict(choices))}
        self._kept: dict[Key, tuple[tuple[str, ...] | None, Entry | Refusal]] = {}
        self._end: int | None = 0  # bytes of what is whole; None once it is cut to them
        self._read(empty)

    def find(self, key: Key, lost: Refusal | None) -> Entry | Refusal | None:
        """Return what is kept for a fault set and channel."""
        then, entry = self._kept.get(key, (None, None))
        return entry if then == (lost.fault_set if lost is not None else None) else None

    def add(self, entry: Entry | Refusal, lost: Refusal | None) -> None:
        """Keep an answer; raises BadInput when it cannot be written."""
        record = {'lost': list(lost.fault_set) if lost is not None else None,
                  'entry': entry_record(entry), **({} if is_there() else {'without_cvxpy': True})}
        try:
            with open(self._path, 'ab') as file:
                if self._end is not None:
                    file.truncate(self._end)
                    file.write(b'' if self._end else _line(self._head))
                    self._end = None
                file.write(_line(record))
        except (OSError, ValueError) as error:
            raise BadInput(self._path, 'work file',
                           f'cannot be written ({reason(error)}){looked_in(self._path)}',
                           'name a design file in a folder that exists and is writable'
                           ) from error

    def _read(self, empty: Contents) -> None:
        if not os.path.exists(self._path):
            return
        if not os.path.isfile(self._path):
            raise BadInput(self._path, 'work file', 'is no regular file', 'name another')
        try:
            with open(self._path, 'rb') as file:
                lines = iter(lambda: file.readline(LARGEST_FILE), b'')
                for number, line in enumerate(lines, 1):
                    if len(line) == LARGEST_FILE:
                        raise self._fail(number, 'is longer than any answer')
                    if line[-1:] != b'\n':
                        return  # of a run that was killed while it wrote
                    self._take(number, line, empty)
                    self._end = file.tell()
        except OSError as error:
            raise BadInput(self._path, 'work file', f'cannot be read ({reason(error)})',
                           MEND) from error

    def _take(self, number: int, line: bytes, empty: Contents) -> None:
        try:
            record = parse_json(line.decode('utf-8'), self._path, number)
        except UnicodeDecodeError:
            raise self._fail(number, 'is not UTF-8') from None
        if not isinstance(record, dict):
            raise self._fail(number, 'is not an object')
        if number == 1:
            self._check_head(record)
            return
        reader = CheckedObject(self._path, f'line {number}: ', record)
        reader.only(('lost', 'entry', 'without_cvxpy'))
        if reader.record.get('without_cvxpy') and is_there():
            return  # more may be proved now
        lost = None
        if reader.record.get('lost', 0) is not None:
            lost = reader.names('lost')
        entry = read_entry(reader.object('entry'), empty, VERSION)
        self._kept[entry.fault_set, entry.channel] = lost, entry

    def _check_head(self, record: dict[str, Any]) -> None:
        for key, problem in (('format', 'is no work file of the designer'),
                             ('version', 'is of another version of vsensor_ros'),
                             ('plant', 'is of another plant, or of an earlier state of this one'),
                             ('choices', 'was begun with other options')):
            if record.get(key) != self._head[key]:
                raise BadInput(self._path, 'work file', problem,
                               f'go on with what it was begun with, or {MEND}')

    def _fail(self, number: int, problem: str) -> BadInput:
        return BadInput(self._path, f'line {number}', problem, MEND)


def _line(record: dict[str, Any]) -> bytes:
    return json.dumps(record, default=np.generic.item).encode() + b'\n'


def fingerprint(value: object) -> str:
    """Return the SHA-256 of all that plain data, arrays and data classes of them hold."""
    digest = hashlib.sha256()

    def add(part: object) -> None:
        if is_dataclass(part):
            part = {field.name: getattr(part, field.name) for field in fields(part)}
        if isinstance(part, np.ndarray):
            digest.update(f'{part.dtype} {part.shape}:'.encode() + part.tobytes() + b';')
        elif isinstance(part, Mapping):
            digest.update(b'{')
            for key in sorted(part):
                digest.update(f'{key!r}:'.encode())
                add(part[key])
            digest.update(b'}')
        elif isinstance(part, (tuple, list)):
            digest.update(b'[')
            for item in part:
                add(item)
            digest.update(b']')
        else:
            plain = part.item() if isinstance(part, np.generic) else part
            digest.update(f'{plain!r};'.encode())
    add(value)
    return digest.hexdigest()
