"""Measure everything, and print the ratios with their bars: held or MISSED."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Sequence
from dataclasses import asdict
import json
import os
from pathlib import Path
import platform
from statistics import median
import sys
import time

from benchmark import (
    bank,
    designer,
    estimators,
    healthy_path,
    isolation,
    jitter,
    memory,
    sweeps,
    tracking,
)
from benchmark.load import KINDS, Load
from benchmark.rig import set_up
from benchmark.row import Row
from vsensor_ros.command.run import interrupt_once
from vsensor_ros.lab.process import Failed

SECONDS = 3.0  # of each process in the middle, each round
ROUNDS = 3
ISOLATIONS = 40
TICKING = 6.0  # s, each round
TICKING_ROUNDS = 2
IDLE = 2, 20.0  # topics, Hz
TICKS = 1000
PARTS = ('replacer', 'bank', 'tracking', 'estimators', 'designer', 'sweeps')


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0, 2 when a measurement failed, 130 when interrupted; a missed bar is no failure."""
    parser = argparse.ArgumentParser(prog='python -m benchmark', description=__doc__)
    parser.add_argument('--message', choices=list(KINDS), default='JointState',
                        help='type of the messages (default: %(default)s, of 30 joints)')
    parser.add_argument('--only', nargs='+', choices=PARTS, default=PARTS, metavar='PART',
                        help=f'what to measure: {", ".join(PARTS)} (default: all)')
    parser.add_argument('--states', nargs='+', type=int, default=designer.SIZES, metavar='N',
                        help='sizes of the plants to design for (default: 20 50 100 200)')
    parser.add_argument('--output', type=Path, default=Path('build/benchmark.json'))
    given = parser.parse_args(arguments)
    began = time.monotonic()
    try:
        rows, details = measure(Load(given.message), given.only, given.states)
    except KeyboardInterrupt:
        return 130
    except Failed as failed:
        print(f'\nbenchmark: {failed}', file=sys.stderr)
        return 2
    except ModuleNotFoundError as missing:
        if (missing.name or '').split('.')[0] not in ('control', 'filterpy'):
            raise
        print(f'\nbenchmark: {missing.name} is not installed: pip install control filterpy, or '
              'choose other parts with --only', file=sys.stderr)
        return 2
    progress('')
    print(table(rows))
    missed = [row for row in rows if row.missed]
    print(f'{len(missed) or "no"} bar{"s" * (len(missed) != 1)} missed; '
          f'{time.monotonic() - began:.0f} s; {given.output}')
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(json.dumps({
        'machine': {'cores': os.cpu_count(), 'system': platform.platform(),
                    'python': platform.python_version(),
                    'threads': os.environ.get('OPENBLAS_NUM_THREADS')},
        'rows': [{**asdict(row), 'ratio': row.ratio if row.peer else None,
                  'missed': row.missed} for row in rows],
        **details,
    }, indent=1) + '\n', encoding='utf-8')
    return 0


def measure(load: Load, only: Collection[str], states: Sequence[int],
            ) -> tuple[list[Row], dict[str, object]]:
    """Run the chosen parts; return the comparisons, and what their medians were taken of."""
    rows: list[Row] = []
    details: dict[str, object] = {}
    ticks = bank.measure(TICKS, progress=progress) if 'bank' in only else []
    if 'replacer' in only:
        replacer(load.message, rows, details)
    rows += ticks
    if 'tracking' in only:
        rows += tracking.measure(TICKS, progress=progress)
    if 'estimators' in only:
        rows += estimators.measure(progress)
    if 'designer' in only:
        rows += designer.measure(states, progress)
    if 'sweeps' in only:
        rows += sweeps.measure(progress=progress)
    return rows, details


def replacer(message: str, rows: list[Row], details: dict[str, object]) -> None:
    """Measure the node beside its peers; add to rows and details."""
    even: list[Row] = []
    for topics, rate, burst, bars in healthy_path.LOADS:
        load = Load(message, topics, rate, burst)
        progress(f'set-up of {topics} topics x {rate:g} Hz')
        with set_up(load) as rig:
            legs = healthy_path.measure(rig, SECONDS, ROUNDS, progress)
            rows += healthy_path.rows(legs, load, bars)
            details[f'legs, {topics} x {rate:g} Hz, {burst} at once'] = {
                name: [asdict(leg) for leg in of] for name, of in legs.items()}
            if topics == healthy_path.LOADS[0][0]:
                latencies = isolation.measure(rig, ISOLATIONS, progress)
                passing = 1e-6 * median(leg.p50 for leg in legs['relay'])
                details['isolation_s'] = latencies
                ours, peer = jitter.measure(rig, TICKING, TICKING_ROUNDS, True, progress)
                even = jitter.rows(ours, peer, rig.rate, f'{topics} topics x {rate:g} Hz and one '
                                   'core kept busy')
    rows += isolation.rows(latencies, passing)
    with set_up(Load(message, *IDLE)) as rig:
        ours, peer = jitter.measure(rig, TICKING, TICKING_ROUNDS, False, progress)
        rows += jitter.rows(ours, peer, rig.rate, f'idle: {IDLE[0]} topics x {IDLE[1]:g} Hz')
    rows += even
    with set_up(Load(message, *IDLE), memory.RATE) as rig:
        grown = memory.measure(rig, memory.TICKS, progress)
        details['memory'] = [asdict(growth) for growth in grown]
        rows += memory.rows(*grown)


def table(rows: Sequence[Row]) -> str:
    """Return the rows as text, one line each, below the heading of their group."""
    lines: list[str] = []
    group = None
    for row in rows:
        if row.group != group:
            group = row.group
            lines += ['', group, f'{"ours":>42}{"peer":>9}{"ratio":>15}']
        bar = '' if row.bar is None else f'   <= {row.bar:g}'
        bar += '' if row.most is None else f'   ours <= {row.most:g} {row.unit}'.rstrip()
        bar += f' {"MISSED" if row.missed else "held"}' if bar else ''
        lines.append(f'  {row.what:<32}{figure(row.ours):>8} {figure(row.peer):>8} {row.unit:<5}'
                     f'{row.ratio:>9.2f}{bar}')
    return '\n'.join(lines[1:])


def figure(value: float) -> str:
    """Return three digits that count, without an exponent."""
    return f'{value:.0f}' if value >= 99.5 else f'{value:.3g}'


def progress(text: str) -> None:
    """Show on one line what is being measured, if somebody looks."""
    if sys.stderr.isatty():
        print(f'\r\033[K{text}', end='', file=sys.stderr, flush=True)


if __name__ == '__main__':
    interrupt_once()  # so that all processes are ended
    sys.exit(main())
