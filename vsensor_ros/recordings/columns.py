"""
Tables of columns, piece by piece: CSV with a header, Parquet, MATLAB. Nothing in them is executed.

A column is named as its file does: a CSV's `T1 [degC]` also as `T1`, the first column of the array
`ydat` of a MATLAB structure `data` as `data.ydat[0]`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
import csv
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
import re
from typing import Any

import numpy as np
from scipy.io import loadmat

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.recordings.recording import BEGIN

TIMES = ('time', 't', 'stamp', 'timestamp', 'sec', 'seconds', 'time_s', 'tdat')
UNITS = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1}  # ns of one
PEEKED = 2**16  # bytes of a CSV file that are looked at to know what its columns are
FARTHEST = 2**62  # ns, 146 years: stamps are below
LARGEST = 2**31  # bytes of a MATLAB file, which is read as a whole
_DATE = re.compile(r'\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d{1,9})?)?(Z|[+-]\d\d:?\d\d)?')
_LEAST = ((10**16, 'ns'), (10**13, 'us'), (10**10, 'ms'))  # a number of today, since 1970

Chunk = tuple[np.ndarray, dict[str, np.ndarray]]  # stamps (T,) [ns], values (T,) by column


@dataclass(frozen=True)
class Clock:
    """Where a table has its times."""

    column: str = ''  # '': one that is called so, see TIMES
    unit: str = ''  # of UNITS; '': as the numbers look
    period: float = 0.0  # s between two rows of a table that has no times; 0: it has


@dataclass(frozen=True)
class Table:
    """An open table."""

    path: Path
    form: str
    columns: tuple[str, ...]  # of numbers
    time: str  # the column with the times; '': there is none
    pieces: Callable[[Collection[str]], Iterator[dict[str, Any]]]  # arrays of these columns
    clock: Clock
    rows: int = 0  # 0: not known
    units: Mapping[str, str] = field(default_factory=dict)  # by column, where the head says them
    left: tuple[str, ...] = ()  # columns that are not of numbers

    def chunks(self, columns: Collection[str]) -> Iterator[Chunk]:
        """Yield stamps and values of some columns, NaN where there is none. Raises BadInput."""
        clock, row, unit = self.clock, 0, self.clock.unit
        for piece in self.pieces([*columns, *([self.time] if self.time else [])]):
            values = {name: np.asarray(piece[name], float) for name in columns}
            if self.time:
                times = np.asarray(piece[self.time])
                unit = unit or unit_of(times)
                stamps = _stamps(times, unit, self.path, self.time)
                count = len(times)
            else:
                count = len(next(iter(values.values())))
                stamps = BEGIN + np.rint(
                    (row + np.arange(count)) * clock.period * 1e9).astype(np.int64)
            row += count
            yield stamps, values


def open_table(path: Path, clock: Clock = Clock()) -> Table:
    """Open a table; raises BadInput."""
    openers = {'.csv': _csv, '.tsv': _csv, '.txt': _csv, '.parquet': _parquet, '.pq': _parquet,
               '.mat': _matlab}
    if path.suffix.lower() not in openers and path.is_file():
        raise BadInput(path, '', f'{path.suffix or "no suffix"} is no recording that is read here',
                       'give a bag, a .csv, .mat or .parquet file')
    if not path.is_file():
        raise BadInput(path, 'recording', 'is not there' if not path.exists() else 'is no file',
                       'name a file that exists')
    if clock.unit and clock.unit not in UNITS:
        raise BadInput(path, 'unit', f'{shown(clock.unit)} is not a unit of time',
                       f'choose from {", ".join(UNITS)}')
    return openers[path.suffix.lower()](path, clock)


def unit_of(times: np.ndarray) -> str:
    """Return of what unit times are, by the size of the first: of today, or else s."""
    if times.dtype.kind == 'M':
        return 'ns'
    first = abs(float(times[0])) if len(times) else 0.0
    return next((unit for least, unit in _LEAST if first >= least), 's')


def _stamps(times: np.ndarray, unit: str, path: Path, key: str) -> np.ndarray:
    if times.dtype.kind == 'M':
        if np.isnat(times).any():
            raise BadInput(path, key, 'has rows without a time', 'leave them out')
        return times.astype('datetime64[ns]').astype(np.int64)
    if times.dtype.kind not in 'iu' and not np.isfinite(times).all():
        raise BadInput(path, key, 'has rows without a time', 'leave them out')
    low, high = float(times.min(initial=0)), float(times.max(initial=0))
    if max(-low, high) * UNITS[unit] >= FARTHEST:
        raise BadInput(path, key, f'goes from {low:g} to {high:g} {unit}, which no clock says',
                       'name another column with --time, or its unit with --time-unit')
    if times.dtype.kind in 'iu':
        return times.astype(np.int64) * UNITS[unit]
    return np.rint(times * UNITS[unit]).astype(np.int64)


def _time_column(path: Path, columns: Collection[str], clock: Clock) -> str:
    """Return the column with the times, '' where the rows are at even distances."""
    if not columns:
        raise BadInput(path, '', 'has no column of numbers', 'write numbers, nan or nothing')
    if clock.period:
        return ''
    if clock.column:
        if clock.column not in columns:
            raise BadInput(path, 'time', f'there is no column {shown(clock.column)}',
                           f'the columns are {", ".join(columns)}')
        return clock.column
    found = next((c for name in TIMES for c in columns
                  if c.rpartition('.')[2].lower() == name), None)
    if found is None:
        raise BadInput(path, 'time', 'has no column that is called time',
                       f'say which it is, or the period of its rows; its columns are '
                       f'{", ".join(columns)}')
    return found


# ------------------------------------------------------------------------------------------ CSV

def _csv(path: Path, clock: Clock) -> Table:
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    try:
        with open(path, 'rb') as file:
            peeked = file.read(PEEKED)
    except OSError as error:
        raise BadInput(path, 'recording', f'cannot be read ({error.strerror})',
                       'give a CSV file') from None
    whole = peeked if len(peeked) < PEEKED else peeked[:peeked.rfind(b'\n') + 1]
    try:
        every = whole.decode('utf-8-sig').splitlines()
    except UnicodeDecodeError:
        raise BadInput(path, 'recording', 'is not UTF-8 text',
                       'give a CSV file in UTF-8') from None
    head, lines = _without_comments(every)
    if len(lines) < 2:
        raise BadInput(path, 'recording', 'has no row, or a line that is too long',
                       'begin with a line of names, then a row of numbers for each time')
    delimiter = max(',;\t', key=lines[0].count)
    header, *rows = csv.reader(StringIO('\n'.join(lines)), delimiter=delimiter)
    names = [name.strip() for name in header]
    names[0] = names[0].lstrip('#').strip()
    if len(set(names)) != len(names) or all(_is_number(n, '.') for n in names):
        raise BadInput(path, f'line {head + 1}', 'is no line of names, each once',
                       'begin with time and the name of each column')
    point = ',' if delimiter == ';' and any(re.fullmatch(r'[-+]?\d+,\d+', cell)
                                            for row in rows for cell in row) else '.'
    units = dict(_split_unit(name) for name in names)
    plain = [_split_unit(name)[0] for name in names]
    if len(set(plain)) == len(names):
        names = plain
    types: dict[str, Any] = {}
    for i, name in enumerate(names):
        cells = [row[i].strip() for row in rows if len(row) > i and row[i].strip()]
        if all(_is_number(cell, point) for cell in cells):
            whole_ones = cells and all(re.fullmatch(r'-?\d+', cell) for cell in cells)
            # of whole times no digit is to be lost
            types[name] = pa.int64() if whole_ones and int(cells[0]) > 10**12 else pa.float64()
        elif all(_is_date(cell) for cell in cells):
            zoned = bool(cells) and re.search(r'(Z|[+-]\d\d:?\d\d)$', cells[0]) is not None
            types[name] = pa.timestamp('ns', 'UTC' if zoned else None)
    numbers = tuple(name for name, of in types.items() if of == pa.float64() or of == pa.int64())
    time = _time_column(path, tuple(types), clock)

    def pieces(columns: Collection[str]) -> Iterator[dict[str, Any]]:
        try:
            with arrow_csv.open_csv(
                    path, read_options=arrow_csv.ReadOptions(skip_rows=head + 1,
                                                             column_names=names),
                    parse_options=arrow_csv.ParseOptions(
                        delimiter=delimiter, invalid_row_handler=lambda row:
                        'skip' if (row.text or '').lstrip().startswith('#') else 'error'),
                    convert_options=arrow_csv.ConvertOptions(
                        column_types=types, include_columns=list(columns), decimal_point=point,
                        strings_can_be_null=True)) as reader:
                for batch in reader:
                    yield {name: batch.column(name).to_numpy(zero_copy_only=False)
                           for name in columns}
        except pa.ArrowException as error:
            raise BadInput(path, 'recording', ' '.join(str(error).split())[:160],
                           'write numbers, nan or nothing, as many in each row') from None
    return Table(path, 'CSV', tuple(n for n in numbers if n != time), time, pieces, clock,
                 units={n: u for n, u in units.items() if u},
                 left=tuple(n for n in names if n not in numbers and n != time))


def _without_comments(lines: Sequence[str]) -> tuple[int, list[str]]:
    """
    Return which line has the names, and all lines from there on without comments (# ..).

    The names may stand in a comment themselves: the last one before the numbers, if it has as many
    cells as these.
    """
    spoken = [i for i, line in enumerate(lines) if line.strip() and line.lstrip()[0] != '#']
    if not spoken:
        return 0, []
    head = spoken[0]
    first = lines[head]
    delimiter = max(',;\t', key=first.count)
    if head and lines[head - 1].count(delimiter) == first.count(delimiter) and all(
            _is_number(cell.strip(), '.') for cell in first.split(delimiter) if cell.strip()):
        return head - 1, [lines[head - 1], *(lines[i] for i in spoken)]
    return head, [lines[i] for i in spoken]


def _split_unit(name: str) -> tuple[str, str]:
    """Return name and unit of ``T1 [degC]`` or ``T1 (degC)``."""
    match = re.fullmatch(r'(.*\S)\s*[\[(]([^\[\]()]*)[\])]', name)
    return (match[1], match[2].strip()) if match and not match[2].strip().isdigit() else (name, '')


def _is_number(cell: str, point: str) -> bool:
    try:
        float(cell.replace(point, '.'))
    except ValueError:
        return False
    return True


def _is_date(cell: str) -> bool:
    return _DATE.fullmatch(cell) is not None


# -------------------------------------------------------------------------------------- Parquet

def _parquet(path: Path, clock: Clock) -> Table:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        file = parquet.ParquetFile(path)
    except (pa.ArrowException, OSError) as error:
        raise BadInput(path, 'recording', f'cannot be read ({" ".join(str(error).split())[:120]})',
                       'give a Parquet file') from None
    numbers = [f.name for f in file.schema_arrow if pa.types.is_integer(f.type)
               or pa.types.is_floating(f.type) or pa.types.is_boolean(f.type)]
    dates = [f.name for f in file.schema_arrow if pa.types.is_timestamp(f.type)]
    time = _time_column(path, [*numbers, *dates], clock)
    found = {f.name: (f.metadata or {}).get(b'unit', b'').decode('utf-8', 'replace')
             for f in file.schema_arrow}

    def pieces(columns: Collection[str]) -> Iterator[dict[str, Any]]:
        try:
            for batch in file.iter_batches(columns=list(columns)):
                yield {name: batch.column(name).to_numpy(zero_copy_only=False)
                       for name in columns}
        except (pa.ArrowException, OSError) as error:
            raise BadInput(path, 'recording', ' '.join(str(error).split())[:160],
                           'the file is broken') from None
    return Table(path, 'Parquet', tuple(n for n in numbers if n != time), time, pieces, clock,
                 file.metadata.num_rows, {n: u for n, u in found.items() if u})


# --------------------------------------------------------------------------------------- MATLAB

def _matlab(path: Path, clock: Clock) -> Table:
    if path.stat().st_size > LARGEST:
        raise BadInput(path, 'recording', f'is larger than {LARGEST // 2**20} MiB',
                       'split it, or write it as Parquet')
    try:  # numbers, texts and structures; what is an object of a class of MATLAB stays unread
        content = loadmat(path, squeeze_me=True, struct_as_record=False, appendmat=False)
    except NotImplementedError:
        raise BadInput(path, 'recording', 'is of version 7.3 (HDF5)',
                       'save it with -v7') from None
    except Exception as error:  # scipy says what is wrong with a broken file in many ways
        raise BadInput(path, 'recording', f'cannot be read ({str(error)[:80]})',
                       'give a MATLAB file of version 7.2 or older') from error
    arrays = dict(_flat(content))
    if not arrays:
        raise BadInput(path, 'recording', 'has no columns of numbers', 'give one with a column '
                       'for each channel')
    time = _time_column(path, list(arrays), clock)
    lengths = [len(a) for a in arrays.values()]
    rows = len(arrays[time]) if time else max(lengths)

    def pieces(columns: Collection[str]) -> Iterator[dict[str, Any]]:
        yield {name: arrays[name] for name in columns}
    columns = tuple(n for n, a in arrays.items() if len(a) == rows and n != time)
    return Table(path, 'MATLAB', columns, time, pieces, clock, rows)


def _flat(content: Any, place: str = '') -> Iterator[tuple[str, np.ndarray]]:
    """Yield the columns of numbers in what `loadmat` returns, by their places."""
    fields = content if isinstance(content, dict) else {
        name: getattr(content, name) for name in getattr(content, '_fieldnames', ())}
    for name, value in fields.items():
        if name.startswith('__'):
            continue
        here = f'{place}{name}'
        if hasattr(value, '_fieldnames'):
            yield from _flat(value, f'{here}.')
        elif isinstance(value, np.ndarray) and value.dtype.kind in 'fiub':
            if value.ndim == 1 and len(value) > 1:
                yield here, value
            elif value.ndim == 2 and value.shape[0] > value.shape[1]:  # else a matrix, no columns
                yield from ((f'{here}[{i}]', value[:, i]) for i in range(value.shape[1]))
