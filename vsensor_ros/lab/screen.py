"""What the live view shows: one status message of the replacer, laid out for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
import re
import textwrap
from typing import Any

OLD = 3.0  # s after which a status, which comes each second, is old
NODE = 'replacer'  # name of the status that is about no channel
STYLES = {'none': 'bold red', 'silent': 'bright_black', 'virtual': 'yellow', 'real': 'green'}
MOST_WORDS = 3  # lines for the words on a channel, where there is room
LONGEST_NAME = 16  # characters, in a narrow terminal
# in a narrow terminal
DROPPED = ('OFFSET', 'STEP', 'RESERVE', 'SERVED BY', 'SW', 'SINCE', 'VALUE')

Piece = tuple[str, str]  # text and its style, in the words of rich
Line = tuple[Piece, ...]


@dataclass(frozen=True)
class Status:
    """What is said of one channel, or of the node."""

    name: str
    message: str
    facts: Mapping[str, str]

    def number(self, key: str) -> float:
        """Return a fact as a number; NaN when it is missing or no number."""
        try:
            return float(self.facts.get(key, 'nan'))
        except ValueError:
            return math.nan

    @property
    def source(self) -> str:
        """Return 'real', 'silent', 'virtual' or 'none'."""
        return self.facts.get('source', '')

    @property
    def words(self) -> str:
        """Return what there is to say beyond the source."""
        return '' if self.message == self.source else self.message


@dataclass(frozen=True)
class StatusMessage:
    """What one message on ~/status says."""

    loop: Status
    channels: tuple[Status, ...]


def read_status(array: Any) -> StatusMessage:
    """Take a DiagnosticArray apart; it comes from outside and may hold anything."""
    loop, channels = Status(NODE, '', {}), []
    for status in array.status:
        facts = {_clean(v.key): _clean(v.value) for v in status.values}
        found = Status(_clean(status.name), _clean(status.message), facts)
        if found.name == NODE and 'state' in facts:
            loop = found
        else:
            channels.append(found)
    return StatusMessage(loop, tuple(channels))


def _clean(text: str) -> str:
    """Return the text without what would steer a terminal."""
    return ''.join(c if c.isprintable() else '?' for c in text)


def screen(told: StatusMessage, age: float, node: str, width: int, height: int) -> list[Line]:
    """
    Lay a status out in at most `height` lines of at most `width` characters.

    `age` [s] is how long ago it came. Channels that do not fit are counted, the worst are kept.
    """
    silent = age > OLD
    lines = [_head(told.loop, node)]
    if silent:
        lines = [((node, 'bold'), (f' SILENT since {duration(age)}', 'bold red'),
                  (': is it running? ros2 node list', ''))]
    lines.append(_pace(told.loop))
    if jumps(told.loop):
        lines.append(((f'    {jumps(told.loop)}', 'yellow'),))
    if told.loop.words not in ('', told.loop.facts.get('state')):
        lines += _wrapped(told.loop.words, width, 2, 'yellow')
    lines += _channels(told.channels, width, height - len(lines))
    if silent:  # what it said last
        lines[1:] = [tuple((text, 'bright_black') for text, _ in line) for line in lines[1:]]
    return [_cut(line, width) for line in lines[:height]]


def _head(loop: Status, node: str) -> Line:
    state = loop.facts.get('state', 'says nothing of itself')
    faulty = ', '.join(loop.facts.get('faulty', '').split())
    return ((node, 'bold'), (f' {state}', 'green' if state == 'active' else 'yellow'),
            (f'   faulty: {faulty}', 'bold red') if faulty else ('   no sensor faulty', ''))


def jumps(loop: Status) -> str:
    """Say how often the clock jumped, if it did."""
    told = [f'{key.removeprefix("clock_").replace("_", " ")} {value}'
            for key, value in loop.facts.items() if key.startswith('clock_') and value != '0']
    return f'the clock jumped: {", ".join(told)}' if told else ''


def _pace(loop: Status) -> Line:
    def ms(key: str) -> str:
        return short(1e3 * loop.number(f'step_{key}'), 2)
    overruns = loop.facts.get('overruns', '?')
    achieved = short(loop.number('achieved'), 4).replace('-', '?')
    return ((f'{achieved} of {short(loop.number("rate"), 4)} Hz, ', ''),
            (f'step p50 {ms("p50")} p99 {ms("p99")} max {ms("max")} ms, ', ''),
            (f'{overruns} overruns', '' if overruns == '0' else 'yellow'),
            ('' if jumps(loop) else ', clock steady', ''))


def _channels(channels: Sequence[Status], width: int, height: int) -> list[Line]:
    """Lay the channels out with as many words as there is room for."""
    if not channels:
        return []
    for most in range(MOST_WORDS, 0, -1):
        blocks = _blocks(channels, width, most)
        if 1 + sum(map(len, blocks)) <= height:
            return [_titles(channels, width), *(line for block in blocks for line in block)]
    worst = sorted(channels, key=_rank)
    blocks = _blocks(worst, width, 1)
    room = height - 2  # the titles and the count
    kept = 0
    while kept < len(blocks) and len(blocks[kept]) <= room:
        room -= len(blocks[kept])
        kept += 1
    left: dict[str, int] = {}
    for channel in worst[kept:]:
        left[channel.source] = left.get(channel.source, 0) + 1
    count = ', '.join(f'{n} {source or "unknown"}' for source, n in left.items())
    return [_titles(channels, width), *(line for block in blocks[:kept] for line in block),
            ((f'and {len(worst) - kept} more: {count}', 'bold'),)]


def _rank(channel: Status) -> float:
    """Return how soon somebody should look at a channel: the lowest first."""
    order = list(STYLES)
    rank = order.index(channel.source) if channel.source in order else -1
    return rank + (0.0 if channel.words else 0.5)


def cells(channel: Status) -> dict[str, str]:
    """Return what is shown of a channel, by column."""
    since = channel.number('since_s')
    return {
        'SENSOR': channel.name,
        'SOURCE': channel.source or '?',
        'VALUE': value(channel),
        'SERVED BY': serves(channel),
        'RESERVE': reserve(channel),
        'SINCE': '-' if math.isnan(since) else duration(since),
        'SW': channel.facts.get('switches', '?'),
        'STEP': short(channel.number('last_step'), 2),
        'OFFSET': short(channel.number('offset'), 2),
    }


def value(channel: Status) -> str:
    """Write the value with its deviation and unit."""
    number, deviation = channel.number('value'), channel.number('deviation')
    if math.isnan(number):
        return '-'
    text = short(number, 4)
    if channel.source == 'virtual':
        text += f' +- {short(deviation, 2) if math.isfinite(deviation) else "?"}'
    return f'{text} {channel.facts.get("unit", "")}'.rstrip()


def serves(channel: Status) -> str:
    """Say which virtual sensor serves a channel: the set it is made for, and its grade."""
    if channel.source != 'virtual':
        return '-'
    names = ','.join(channel.facts.get('fault_set', '').split())
    return f'{{{names}}} {channel.facts.get("grade", "")}'.rstrip()


def reserve(channel: Status) -> str:
    """Say how good who would serve a healthy channel is now; or no, that nobody would."""
    told = channel.facts.get('reserve')
    if channel.source not in ('real', 'silent') or told is None:
        return '-'
    deviation = channel.number('reserve_deviation')
    return 'no' if told != 'ready' else \
        f'+- {short(deviation, 2) if math.isfinite(deviation) else "?"}'


def _widths(channels: Sequence[Status], width: int) -> tuple[dict[str, int], str]:
    """Return the widths of the columns that fit, and the gap between them."""
    rows = [cells(channel) for channel in channels]
    if all(row['RESERVE'] == '-' for row in rows):  # nothing to be told
        rows = [{title: text for title, text in row.items() if title != 'RESERVE'}
                for row in rows]
    widths = {title: max(len(title), *(len(row[title]) for row in rows)) for title in rows[0]}
    for gap in ('  ', ' '):
        if sum(widths.values()) + len(gap) * (len(widths) - 1) <= width:
            return widths, gap
    widths['SENSOR'] = min(widths['SENSOR'], LONGEST_NAME)
    for title in DROPPED:
        if sum(widths.values()) + len(widths) - 1 <= width:
            break
        widths.pop(title, None)
    return widths, ' '


def _titles(channels: Sequence[Status], width: int) -> Line:
    widths, gap = _widths(channels, width)
    return ((gap.join(title.ljust(n) for title, n in widths.items()).rstrip(), 'underline'),)


def _blocks(channels: Sequence[Status], width: int, most: int) -> list[list[Line]]:
    """Return the lines of each channel: its cells, and at most so many lines of words."""
    widths, gap = _widths(channels, width)
    blocks = []
    for channel in channels:
        style = STYLES.get(channel.source, 'bold red')
        row = cells(channel)
        line = tuple((_short_of_middle(row[title], n).ljust(n) + gap,
                      style if title in ('SENSOR', 'SOURCE') else '')
                     for title, n in widths.items())
        words = _wrapped(channel.words, width, most, '') if channel.words else []
        blocks.append([line, *words])
    return blocks


def _wrapped(text: str, width: int, most: int, style: str) -> list[Line]:
    room = max(width - 4, 10)
    lines = textwrap.wrap(text, room, max_lines=most, placeholder=' ...')
    if most == 1:  # the remedy comes last
        lines = [_short_of_middle(text, room)]
    return [((f'    {line}', style),) for line in lines]


def _short_of_middle(text: str, width: int) -> str:
    """Return the text, without its middle when it is longer than that."""
    if len(text) <= width:
        return text
    tail = max(width - 2, 0) // 2
    return f'{text[:width - 2 - tail]}..{text[len(text) - tail:]}'


def _cut(line: Line, width: int) -> Line:
    """Return the line, no longer than the terminal is wide and without blanks at its end."""
    pieces: list[Piece] = []
    for text, style in line:
        text = text[:width]
        width -= len(text)
        pieces.append((text, style))
    pieces[-1] = (pieces[-1][0].rstrip(), pieces[-1][1])
    return tuple(pieces)


def short(number: float, digits: int) -> str:
    """Write a number with so many significant digits; '-' when there is none."""
    return '-' if math.isnan(number) else f'{number:.{digits}g}'


def duration(seconds: float) -> str:
    """Write a time as one looks at it: 4.2 s, 35 s, 12 min, 3.1 h, 5 d."""
    if math.isnan(seconds):
        return '-'
    for least, size, unit, digits in ((172800, 86400, 'd', 0), (7200, 3600, 'h', 1),
                                      (120, 60, 'min', 0)):
        if seconds >= least:
            return f'{seconds / size:.{digits}f} {unit}'
    return f'{seconds:.{1 if seconds < 10.0 else 0}f} s'


def changes(before: StatusMessage | None, told: StatusMessage) -> list[str]:
    """Return a line for the node and each channel that are not as they were before."""
    known = {s.name: _essence(s) for s in before.channels} if before else {}
    lines = []
    if before is None or _essence(before.loop) != _essence(told.loop):
        faulty = ', '.join(told.loop.facts.get('faulty', '').split()) or 'none'
        lines.append(f'replacer: {told.loop.message or "?"}; faulty: {faulty}; '
                     + ''.join(text for text, _ in _pace(told.loop))
                     + (f'; {jumps(told.loop)}' if jumps(told.loop) else ''))
    for channel in told.channels:
        if known.get(channel.name) != _essence(channel):
            by = f' by {serves(channel)}' if channel.source == 'virtual' else ''
            words = f': {channel.words}' if channel.words else ''
            lines.append(f'{channel.name}: {channel.source or "?"} {value(channel)}{by}{words}')
    lines += [f'{name}: not served any more' for name in known
              if name not in {c.name for c in told.channels}]
    return lines


def _essence(status: Status) -> tuple[str, ...]:
    """Return what is worth a line when it changes: not the numbers in the words."""
    return (re.sub(r'\d+(\.\d+)?(e[+-]?\d+)?', '#', status.message), jumps(status),
            serves(status),
            *(status.facts.get(key, '') for key in ('state', 'source', 'switches', 'faulty')))
