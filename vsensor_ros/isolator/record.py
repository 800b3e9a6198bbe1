"""
What was learnt of the healthy machine, in a file of its own.

JSON text. It is bound to the design by a hash that the caller gives, and checked when it is
loaded: nothing in it is trusted, and nothing is loaded when something is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.isolator.block_maxima import BlockMaxima, ROOM
from vsensor_ros.isolator.detector import TESTS
from vsensor_ros.isolator.isolator import Isolator, LARGEST
from vsensor_ros.observers.checked_json import CheckedObject, read_json
from vsensor_ros.whole_file import write_whole

FORMAT = 'vsensor_ros isolation record'
VERSION = 1
MEND = 'remove the file; the isolator then learns anew'
MOST = 2**53  # samples, of any count
COUNTS = ('repeats', 'again', 'pairs', 'longest', 'longest_gap', 'samples')  # of channels
BEYOND = 10.0  # times what a residual counts as at most: no threshold is there
SIZES = ('travel', 'roughness', 'usual_spike')  # of channels


def save(isolator: Isolator, path: str | Path, design: str) -> None:
    """Write what was learnt, whole or not at all; design: its hash. Raises BadInput."""
    detector, channels = isolator.watch.detector, isolator.watch.channels
    channels.settle()
    record = {
        'format': FORMAT, 'version': VERSION, 'design': design, 'period': isolator.period,
        'residuals': [r.name for r in isolator.residuals], 'sensors': list(isolator.sensors),
        'learnt': detector.learnt.tolist(), 'maxima': _written(detector.maxima),
        'motion': _written(channels.motion), 'steps': _written(channels.steps),
        'swings': _known(isolator.watch.motion.swings), 'taught': _known(detector.taught),
        **{key: getattr(channels, key).tolist() for key in (*COUNTS, *SIZES)}}
    try:
        write_whole(path, json.dumps(record, allow_nan=False) + '\n')
    except (OSError, ValueError) as error:
        raise BadInput(path, 'isolation record', f'cannot be written ({reason(error)})',
                       'name a file in a folder that exists and is writable') from error


def load(isolator: Isolator, path: str | Path, design: str) -> None:
    """
    Let an isolator go on from what was learnt; design: the hash of the design it runs.

    Raises BadInput, one line, when the file is missing, malformed, or of another design; the
    isolator is as it was then.
    """
    try:
        apply = _read(isolator, path, design)
    except BadInput as error:
        key = 'isolation record' if error.key == 'design file' else error.key
        raise BadInput(path, key, error.problem, MEND) from None
    apply()


def _read(isolator: Isolator, path: str | Path, design: str) -> Callable[[], None]:
    """Check all of a file; return what puts it into the isolator."""
    record = read_json(path)
    if not isinstance(record, dict):
        raise BadInput(path, '', 'is not an object', MEND)
    reader = CheckedObject(path, '', record)
    reader.word('format', (FORMAT,))
    if reader.whole('version') != VERSION:
        raise reader.fail('version', f'is not {VERSION}')
    if reader.text('design') != design:
        raise reader.fail('design', 'is another design than the one that runs')
    if reader.positive('period') != isolator.period:
        raise reader.fail('period', f'is not {isolator.period:g} s')
    for key, names in (('residuals', [r.name for r in isolator.residuals]),
                       ('sensors', list(isolator.sensors))):
        if list(reader.texts(key)) != names:
            raise reader.fail(key, 'are not those of the design')
    reader.only(('format', 'version', 'design', 'period', 'residuals', 'sensors', 'learnt',
                 'maxima', 'motion', 'steps', 'swings', 'taught', *COUNTS, *SIZES))
    r, c = len(isolator.residuals), len(isolator.sensors)
    detector, channels, motion = (isolator.watch.detector, isolator.watch.channels,
                                  isolator.watch.motion)
    learnt = _counts(reader, 'learnt', r)
    maxima = _maxima(reader.object('maxima'), TESTS, r)
    extremes = _maxima(reader.object('motion'), 3, c)
    steps = _maxima(reader.object('steps'), 1, c) if 'steps' in record else BlockMaxima(1, c)
    counts = {key: _counts(reader, key, c) for key in COUNTS}
    sizes = {key: _sizes(reader, key, c) for key in SIZES}
    swings = _cells(reader, 'swings', motion.swings.shape)
    taught = _cells(reader, 'taught', detector.taught.shape)
    if np.any(taught > BEYOND * detector.limit):
        raise reader.fail('taught', 'has a number that no residual reaches')
    if np.any(counts['again'] > counts['repeats']):
        raise reader.fail('again', 'are more than repeats')
    if np.any(counts['repeats'] > counts['pairs']):
        raise reader.fail('repeats', 'are more than pairs')

    def apply() -> None:
        channels.settle()  # of what came in before, nothing is counted later
        detector.learnt, detector.maxima, channels.motion = learnt, maxima, extremes
        detector.taught, motion.swings, channels.steps = taught, swings, steps
        motion.learnt = int(learnt.max(initial=0))
        for key, values in (*counts.items(), *sizes.items()):
            setattr(channels, key, values)
        detector.refresh()
        channels.refresh()
        motion.use()
    return apply


def _written(maxima: BlockMaxima) -> dict[str, Any]:
    """Return a store as lists by row and column; blocks that are not full yet are left out."""
    rows, columns = maxima.count.shape
    return {
        'blocks': [[[float(f'{value:.6g}') for value in
                     maxima.maxima[:maxima.count[i, j], i, j].tolist()]
                    for j in range(columns)] for i in range(rows)],
        'merged': maxima.merged.tolist()}


def _known(cells: np.ndarray) -> list[list[float]]:
    """Return what is known of a table, whose other cells are -inf: rows of place and value."""
    return [[*place, float(f'{cells[tuple(place)]:.6g}')]
            for place in np.argwhere(~np.isneginf(cells)).tolist()]


def _cells(reader: CheckedObject, key: str, shape: tuple[int, ...]) -> np.ndarray:
    """Read such a table; records of earlier versions have none."""
    cells = np.full(shape, -np.inf)
    rows = reader.get(key, list, 'a list of lists') if key in reader.record else []
    if not rows:
        return cells
    found = reader.array(key, len(rows), len(shape) + 1)
    places = found[:, :-1]
    if np.any((places < 0) | (places >= shape) | (places % 1 != 0)):
        raise reader.fail(key, 'has places that are none')
    if np.any(np.abs(found[:, -1]) > LARGEST):
        raise reader.fail(key, f'has a number above {LARGEST:g}')
    cells[tuple(places.astype(np.int64).T)] = found[:, -1]
    return cells


def _maxima(reader: CheckedObject, rows: int, columns: int) -> BlockMaxima:
    reader.only(('blocks', 'merged'))
    merged = reader.array('merged', rows, columns)
    if np.any((merged < 1) | (merged > MOST) | (np.log2(np.maximum(merged, 1)) % 1 != 0)):
        raise reader.fail('merged', 'are not powers of two')
    blocks = reader.get('blocks', list, 'a list of lists')
    if len(blocks) != rows or not all(isinstance(row, list) and len(row) == columns
                                      for row in blocks):
        raise reader.fail('blocks', f'is not {rows} x {columns} lists')
    store = BlockMaxima(rows, columns)
    store.merged[:] = merged
    for i, row in enumerate(blocks):
        for j, cell in enumerate(row):
            if not isinstance(cell, list) or len(cell) >= ROOM:
                raise reader.fail(f'blocks[{i}][{j}]', f'is not less than {ROOM} numbers')
            values = CheckedObject(reader.path, reader.place, {f'blocks[{i}][{j}]': cell})
            found = values.array(f'blocks[{i}][{j}]', len(cell))
            if np.any(np.abs(found) > LARGEST):
                raise values.fail(f'blocks[{i}][{j}]', f'has a number above {LARGEST:g}')
            store.maxima[:len(cell), i, j] = found
            store.count[i, j] = len(cell)
    return store


def _counts(reader: CheckedObject, key: str, length: int) -> np.ndarray:
    values = reader.array(key, length)
    if np.any((values < 0) | (values > MOST) | (values % 1 != 0)):
        raise reader.fail(key, 'are not counts')
    return values.astype(np.int64)


def _sizes(reader: CheckedObject, key: str, length: int) -> np.ndarray:
    values = reader.array(key, length)
    if np.any(values < 0.0):
        raise reader.fail(key, 'must not be negative')
    if np.any(values > LARGEST):
        raise reader.fail(key, f'has a number above {LARGEST:g}')
    return values
