"""
Read a controller file (YAML).

Keys: name, description, sample_time [s], parameters, reads (sensors), writes (inputs), unheard
(inputs of which virtual sensors do not hear), and one of ``gain``, ``transfer`` and ``matrices``.
Every number may be an expression of the parameters. What is wrong gives one BadInput line that
names the file, the key and the mend.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.bad_input import check_text, shown
from vsensor_ros.control.controller import Controller
from vsensor_ros.plant import Plant
from vsensor_ros.plant.checked import suggestion
from vsensor_ros.plant.entries import Entries

FORMS = ('gain', 'transfer', 'matrices')
MOST = 200  # states, coefficients


class _File(Entries):
    what = 'controller file'


def load_controller(path: str | Path, plant: Plant) -> Controller:
    """Read a controller of a plant; by default it reads all sensors and writes all inputs."""
    file = _File(path, ('name', 'description', 'parameters', 'sample_time', 'reads', 'writes',
                        'unheard', *FORMS))
    for key in ('name', 'description'):
        check_text(file.content.get(key, ''), path, key)
    file.read_parameters(file.section('parameters', ('value', 'unit'), 'value'))
    forms = [form for form in FORMS if form in file.content]
    if len(forms) != 1:
        raise file.fail(' and '.join(forms), 'are both there' if forms else
                        'there is no controller in it', f'give one of {", ".join(FORMS)}')
    reads = _names(file, 'reads', plant.sensors, 'sensor')
    writes = _names(file, 'writes', plant.inputs, 'input')
    unheard = _names(file, 'unheard', plant.inputs, 'input', ())
    given = file.content.get('sample_time')
    h = None if given is None else file.number(given, 'sample_time')
    if h is not None and h <= 0.0:
        raise file.fail('sample_time', f'{h:g} is not positive', 'give seconds')
    if forms == ['gain']:
        K = file.matrix(file.content['gain'], 'gain', len(writes), len(reads))
        return Controller.gain(K, reads, writes, sample_time=h, unheard=unheard, name=str(path))
    if forms == ['transfer']:
        return _transfer(file, plant, h, unheard)
    rows = file.mapping(file.content['matrices'], 'matrices', ('A', 'B', 'C', 'D'))
    r = _count(file, rows.get('A'))
    sizes = {'A': (r, r), 'B': (r, len(reads)), 'C': (len(writes), r)}
    arrays = {letter: file.matrix(rows.get(letter), f'matrices.{letter}', *size)
              if r else np.zeros(size) for letter, size in sizes.items()}
    shape = len(writes), len(reads)
    D = file.matrix(rows['D'], 'matrices.D', *shape) if 'D' in rows else np.zeros(shape)
    return Controller(reads, writes, arrays['A'], arrays['B'], arrays['C'], D, h, unheard,
                      str(path))


def _names(file: Entries, key: str, known: Sequence[str], what: str,
           default: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """Read names of the plant, one or a list; when they are left out, the default or all."""
    given = file.content.get(key)
    if given is None:
        return tuple(known) if default is None else default
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list) or not names:
        raise file.fail(key, f'{shown(given)} is no list of names', f'write {key}: [name, name]')
    for name in names:
        if name not in known:
            raise file.fail(key, f'unknown {what} {shown(name)}', suggestion(name, known))
        if names.count(name) > 1:
            raise file.fail(key, f'{name} is named twice', 'name each once')
    return tuple(names)


def _count(file: Entries, rows: Any) -> int:
    """Return how many states the rows of A are of; a bare number is one."""
    if isinstance(rows, str):
        rows = file.arrays.get(rows, rows)
    if rows is None:
        return 0
    if not isinstance(rows, list) or not rows:
        raise file.fail('matrices.A', f'{shown(rows)} is not rows of numbers',
                        'write it as [[.., ..], [.., ..]], one row a line')
    if len(rows) > MOST:
        raise file.fail('matrices.A', f'has {len(rows)} rows', f'keep it within {MOST}')
    return len(rows)


def _transfer(file: Entries, plant: Plant, h: float | None,
              unheard: tuple[str, ...]) -> Controller:
    for key in ('reads', 'writes'):
        if key in file.content:
            raise file.fail(key, 'stands beside transfer, which has the names in it',
                            'leave it out')
    if h is None:
        raise file.fail('sample_time', 'is missing', 'a transfer matrix is of z: give seconds')
    mend = 'write transfer: {input: {sensor: {numerator: [..], denominator: [..]}}}'
    rows = file.mapping(file.content['transfer'], 'transfer', plant.inputs, 'input')
    entries: dict[str, dict[str, Any]] = {}
    for of, row in rows.items():
        cells = file.mapping(row, f'transfer.{of}', plant.sensors, 'sensor')
        if not cells:
            raise file.fail(f'transfer.{of}', 'is empty', mend)
        entries[of] = {}
        for sensor, cell in cells.items():
            key = f'transfer.{of}.{sensor}'
            parts = cell if isinstance(cell, dict) else {'numerator': cell}
            file.mapping(parts, key, ('numerator', 'denominator'))
            if 'numerator' not in parts:
                raise file.fail(f'{key}.numerator', 'is missing', mend)
            entries[of][sensor] = tuple(
                _coefficients(file, parts.get(part, 1.0), f'{key}.{part}')
                for part in ('numerator', 'denominator'))
    if not entries:
        raise file.fail('transfer', 'is empty', mend)
    return Controller.transfer(entries, h, unheard=unheard, name=str(file.path))


def _coefficients(file: Entries, value: Any, key: str) -> list[float]:
    """Read the coefficients of falling powers of z; a bare number is a constant."""
    values = value if isinstance(value, list) else [value]
    if len(values) > MOST:
        raise file.fail(key, f'has {len(values)} coefficients', f'keep it within {MOST}')
    return [file.number(v, f'{key}[{i}]' if isinstance(value, list) else key)
            for i, v in enumerate(values)]
