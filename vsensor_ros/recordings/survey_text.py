"""What a survey says to people."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
import math

from vsensor_ros.recordings.survey import Channel, Survey

TITLES = ('CHANNEL', 'UNIT', 'COUNT', 'RATE', 'GAP', 'JITTER', 'LATE', 'VALUES')
LISTED = 5  # channels of which the same is said
EPOCH = 10**17  # ns; a stamp beyond is of today, one before of some clock


def survey_text(found: Survey) -> str:
    """Return a table with a row for each channel, and below it what is suspicious."""
    lines = [f'{found.name}: {found.form}, {_count(len(found.channels))}, '
             f'{found.seconds:.6g} s{_begun(found.begin)}']
    lines += _table([TITLES, *(_row(c) for c in found.channels)])
    suspicious: dict[str, list[str]] = {}
    for channel in found.channels:
        for why in channel.suspicions:
            suspicious.setdefault(str(why), []).append(channel.name)
    lines += [f'  {why}: {_listed(names)}' for why, names in suspicious.items()]
    lines += [f'  {note}' for note in found.notes]
    return '\n'.join(''.join(c if c.isprintable() else '?' for c in line) for line in lines)


def _listed(names: Sequence[str]) -> str:
    more = f' and {len(names) - LISTED} more' if len(names) > LISTED else ''
    return ', '.join(names[:LISTED]) + more


def _count(channels: int) -> str:
    return f'{channels} channel' + 's' * (channels != 1)


def _begun(stamp: int) -> str:
    if stamp < EPOCH:
        return ''
    when = datetime.fromtimestamp(stamp * 1e-9, timezone.utc)
    return f', from {when:%Y-%m-%d %H:%M:%S} UTC'


def _row(c: Channel) -> tuple[str, ...]:
    late = '-' if math.isnan(c.late) else f'{_time(c.late)} +- {_time(c.late_spread / 2.0)}'
    values = '-' if not c.low <= c.high else f'{c.low:.4g}' if c.low == c.high else \
        f'{c.low:.4g} .. {c.high:.4g}'
    return (c.name, c.unit or '-', str(c.count), '-' if math.isnan(c.rate) else
            f'{c.rate:.4g} Hz', _time(c.gap), _time(c.jitter), late, values)


def _time(seconds: float) -> str:
    if math.isnan(seconds):
        return '-'
    return f'{seconds * 1e3:.3g} ms' if abs(seconds) < 1.0 else f'{seconds:.4g} s'


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ['  '.join(cell.ljust(n) for cell, n in zip(row, widths)).rstrip() for row in rows]
