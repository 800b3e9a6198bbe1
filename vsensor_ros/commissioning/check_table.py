"""How the findings are laid out: tables, then what to mend, the verdict last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import io
import math
import os
import sys
import textwrap

from vsensor_ros.commissioning.findings import (
    COMMAND,
    FAIL,
    Finding,
    INPUT,
    NOTE,
    OUTPUT,
    Use,
    WARN,
)
from vsensor_ros.commissioning.likeness import clean
from vsensor_ros.commissioning.rehearsal import Outlook

WIDTH = 100  # characters that lines are wrapped to; a long name may take more
MARKS = {NOTE: 'ok', WARN: 'WARN', FAIL: 'FAIL'}
STYLES = {NOTE: 'green', WARN: 'yellow', FAIL: 'bold red'}
MARK = 5  # characters that a mark takes

Line = tuple[tuple[str, str], ...]  # pieces: a text and its style, in the words of rich


@dataclass(frozen=True)
class CheckReport:
    """All that was found."""

    node: str  # full name of the replacer
    path: str  # of its parameter file
    seconds: float
    uses: tuple[Use, ...]
    findings: tuple[Finding, ...]  # the worst first
    outlooks: tuple[Outlook, ...]
    units: Mapping[str, str]
    start: str = ''  # remappings that make the replacer this node

    @property
    def fails(self) -> int:
        """How many things would not work; a sensor whose cause is listed is not counted again."""
        return sum(f.level == FAIL for f in self.findings) or \
            sum(o.level == FAIL for o in self.outlooks)


def lay_out(report: CheckReport) -> list[Line]:
    """Return the lines that are printed."""
    started = f', if started with --ros-args {report.start}' if report.start else ''
    lines: list[Line] = [((f'{report.node} of {report.path}, listened for {report.seconds:g} s'
                           f'{started}', 'bold'),), ()]
    lines += _table(('TOPIC', 'USE', 'TYPE', 'QOS', 'RATE', 'STAMPS', 'WHO'),
                    [_topic(use, report) for use in report.uses])
    lines.append(())
    lines += _table(('CHANNEL', 'FIELD', 'UNIT', 'FOUND', 'VALUES'),
                    [_channel(use, name, path, report) for use in report.uses
                     if use.role in (INPUT, COMMAND) for name, path in use.channels.items()])
    lines += [(), (('IF IT FAILED NOW', 'bold'),)]
    same: dict[tuple[int, str], list[str]] = {}
    for of in report.outlooks:
        same.setdefault((of.level, of.text), []).append(of.name)
    for (level, text), names in same.items():
        lines += _wrapped(level, f'{", ".join(names)}: {text}')
    if report.findings:
        lines += [(), (('WHAT TO MEND', 'bold'),)]
        for finding in report.findings:
            lines += _wrapped(finding.level, str(finding))
    return [*lines, (), *_verdict(report)]


def _topic(use: Use, report: CheckReport) -> tuple[int, tuple[str, ...]]:
    level = max((f.level for f in report.findings if use.topic in f.topics), default=NOTE)
    ends = use.listeners if use.role == OUTPUT else use.publishers
    types = [t for t in dict.fromkeys(e.type for e in (*use.publishers, *use.listeners))
             if t != use.type]
    kind = _short(use.type) + (f', not {", ".join(map(_short, types))}' if types else '')
    right = [e for e in ends if e.type == use.type]
    qos = '-' if not right else 'no' if any(e.mismatch for e in right) else 'ok'
    rate = stamps = '-'
    if use.heard is not None and use.heard.count:
        rate = '?' if math.isnan(use.heard.rate) else f'{use.heard.rate:.4g} Hz'
        stamps = _stamps(*use.heard.age)
    return level, (use.topic, use.role, kind, qos, rate, stamps, _who(use, report))


def _who(use: Use, report: CheckReport) -> str:
    names = [p.node for p in use.publishers]
    by = ', '.join(f'{n} x{names.count(n)}' if names.count(n) > 1 else n
                   for n in dict.fromkeys(names))
    if use.role != OUTPUT:
        return by or 'nobody'
    to = ', '.join(dict.fromkeys(e.node for e in use.listeners)) or 'nobody'
    return f'to {to}' + (f', by {by}' if by else '')


def _stamps(age: float, spread: float) -> str:
    if math.isnan(age):
        return 'none'
    if max(abs(age), spread) < 1.0:
        return f'{age * 1e3:.1f} +- {spread * 1e3:.1f} ms'
    return f'{age:.1f} +- {spread:.1f} s'


def _short(kind: str) -> str:
    return kind.rpartition('/')[2]


def _channel(use: Use, name: str, path: str,
             report: CheckReport) -> tuple[int, tuple[str, ...]]:
    count = use.heard.count if use.heard is not None else 0
    said = use.fields[path]
    found = f'{said.found} of {count}' + (f', {said.nan} NaN' if said.nan else '')
    low, high = getattr(said, 'low', math.inf), getattr(said, 'high', -math.inf)
    values = '-' if low > high else f'{low:.4g}' if low == high else f'{low:.4g} .. {high:.4g}'
    level = max((f.level for f in report.findings
                 if f.channel == name or (f.channel == '' and use.topic in f.topics)
                 and not said.found), default=NOTE)
    return level, (name, path, report.units.get(name, ''), found if count else 'never', values)


def _table(titles: Sequence[str], rows: Sequence[tuple[int, tuple[str, ...]]]) -> list[Line]:
    widths = [max(len(title), *(len(row[i]) for _, row in rows)) if rows else len(title)
              for i, title in enumerate(titles)]

    gap = '  ' if MARK + sum(widths) + 2 * len(widths) - 2 <= WIDTH else ' '

    def laid(cells: Sequence[str]) -> str:
        return gap.join(cell.ljust(n) for cell, n in zip(cells, widths)).rstrip()
    return [((' ' * MARK + laid(titles), 'bold'),),
            *(((MARKS[level].ljust(MARK), STYLES[level]), (laid(cells), ''))
              for level, cells in rows)]


def _wrapped(level: int, text: str) -> list[Line]:
    first, *more = textwrap.wrap(text, WIDTH - MARK, break_long_words=False,
                                 break_on_hyphens=False) or ['']
    return [((MARKS[level].ljust(MARK), STYLES[level]), (first, '')),
            *(((' ' * MARK + rest, ''),) for rest in more)]


def _verdict(report: CheckReport) -> list[Line]:
    """Return the verdict, one line: with the mend of the worst, however long it gets."""
    ready = [o.name for o in report.outlooks if o.replaced]
    failed = next((f'{o.name}: {o.text}' for o in report.outlooks if o.level == FAIL), '')
    first = next((str(f) for f in report.findings if f.level == FAIL), failed)
    if report.fails:
        count = 'one thing' if report.fails == 1 else f'{report.fails} things'
        return [((f'check: {count} would not work. First: {first}', STYLES[FAIL]),)]
    warned = [f for f in report.findings if f.level == WARN]
    if warned:
        return [((f'check: all would work, but: {warned[0]}', STYLES[WARN]),)]
    return [((f'check: all would work: {", ".join(ready) or "no sensor"} can be replaced',
              STYLES[NOTE]),)]


def show(lines: Sequence[Line]) -> None:
    """Print, in colour where somebody looks and rich is there."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors='backslashreplace')  # a unit may be °C
    lines = [tuple((clean(text), style) for text, style in line) for line in lines]
    try:
        if sys.stdout.isatty() and _print_in_colour(lines):
            return
        print('\n'.join(''.join(text for text, _ in line) for line in lines), flush=True)
    except BrokenPipeError:  # whoever read it has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_in_colour(lines: Sequence[Line]) -> bool:
    try:
        from rich.console import Console
        from rich.text import Text
    except ImportError:
        return False
    console = Console(highlight=False, markup=False)
    for line in lines:
        console.print(Text.assemble(*line), soft_wrap=True)
    return True
