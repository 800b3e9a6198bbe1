"""A recording as a CSV file: a row a time, an empty cell where nothing was sent."""

import csv
from io import StringIO
from pathlib import Path

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.simulate.fault import Recorded
from vsensor_ros.text_file import read_text

LARGEST_FILE = 2**30  # bytes


def write_table(path: Path, channels: dict[str, Recorded]) -> None:
    """Write channels, their times merged, at full precision."""
    times = np.unique(np.concatenate([c.time[c.sent] for c in channels.values()]))
    cells = np.full((len(times), len(channels)), '', dtype=object)
    for column, channel in enumerate(channels.values()):
        rows = np.searchsorted(times, channel.time[channel.sent])
        cells[rows, column] = [repr(float(v)) for v in channel.value[channel.sent]]
    with open(path, 'w', newline='', encoding='utf-8') as file:
        lines = csv.writer(file, lineterminator='\n')
        lines.writerow(['time', *channels])
        lines.writerows([repr(float(t)), *row] for t, row in zip(times, cells))


def read_table(path: Path) -> dict[str, Recorded]:
    """Return the channels of a table, all on its times; raise BadInput."""
    text = read_text(path, 'table', 'give a CSV file with a column time', LARGEST_FILE)
    try:
        header, *rows = [row for row in csv.reader(StringIO(text, newline='')) if row]
    except (ValueError, csv.Error):
        raise BadInput(str(path), 'table', 'no table in it',
                       'begin with the line time,<channel>,...') from None
    if header[0] != 'time' or len(set(header)) != len(header) or len(header) < 2 or not rows:
        raise BadInput(str(path), ','.join(header)[:60], 'not the head of a table, or no row',
                       'begin with time, then each channel once')
    for number, row in enumerate(rows, 2):
        if len(row) != len(header):
            raise BadInput(str(path), f'line {number}', f'{len(row)} cells',
                           f'give {len(header)}, as in the head')
    try:
        cells = np.array([[float(cell or 0.0) for cell in row] for row in rows])
    except ValueError as error:
        raise BadInput(str(path), 'table', str(error), 'write numbers, nan or nothing') from None
    time, sent = cells[:, 0], np.array([[cell != '' for cell in row] for row in rows])
    if not (np.all(np.isfinite(time)) and sent[:, 0].all() and np.all(np.diff(time) > 0)):
        raise BadInput(str(path), 'time', 'does not increase', 'sort the rows by time')
    return {name: Recorded(time, cells[:, i], sent[:, i])
            for i, name in enumerate(header[1:], 1)}
