"""A recording as one table: a row a time, nothing where a channel said nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.recordings.recording import Recording
from vsensor_ros.whole_file import written_whole

SUFFIXES = ('.csv', '.parquet')


def check_target(path: Path) -> None:
    """Raise BadInput unless a table can be written there, as far as its name says."""
    if path.suffix not in SUFFIXES:
        raise BadInput(path, '--to', 'is no kind of table that is written',
                       f'end it in {" or ".join(SUFFIXES)}')


def write_aligned(path: Path, recording: Recording, rate: float | None = None) -> None:
    """
    Write times [s] from the first stamp on and all channels, whole or not at all.

    rate: of the rows [Hz], each with what was said last; None: a row for each stamp, with what
    was said just then. Raises BadInput.
    """
    import pyarrow as pa
    from pyarrow import csv, parquet

    check_target(path)
    times, columns = aligned(recording, rate)
    fields = [pa.field('time', pa.float64(), metadata={'unit': 's'})]
    fields += [pa.field(name, pa.float64(), metadata={
        'unit': recording.units[name]} if name in recording.units else None) for name in columns]
    table = pa.Table.from_arrays(
        [pa.array(times), *(pa.array(v, mask=np.isnan(v)) for v in columns.values())],
        schema=pa.schema(fields))
    try:
        with written_whole(path) as beside:
            if path.suffix == '.csv':
                csv.write_csv(table, beside, csv.WriteOptions(quoting_style='none'))
            else:
                parquet.write_table(table, beside)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise BadInput(path, '--to', f'cannot be written ({reason(error)})',
                       'name a file in a folder that exists and is writable') from error


def aligned(recording: Recording,
            rate: float | None = None) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return times (T,) [s] and by channel values (T,), NaN where there is none: the table."""
    tracks = recording.tracks
    if rate is None:
        stamps = np.unique(np.concatenate([t.stamps for t in tracks.values()]))
        columns = {}
        for name, track in tracks.items():
            columns[name] = np.full(len(stamps), np.nan)
            columns[name][np.searchsorted(stamps, track.stamps)] = track.values
        return (stamps - recording.origin) * 1e-9, columns
    times = np.arange(int(recording.seconds * rate) + 1) / rate
    stamps = recording.origin + np.rint(times * 1e9).astype(np.int64)
    return times, {name: track.held(stamps) for name, track in tracks.items()}
