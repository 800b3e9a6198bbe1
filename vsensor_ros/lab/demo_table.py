"""What the demo found: a row for each failed sensor, the closing table and summary.json."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
import json
import math
import os
from pathlib import Path


@dataclass(frozen=True)
class Row:
    """One system's line of the summary; RMSEs in `unit`, None where nothing was measured."""

    system: str
    failed_sensor: str
    order: int
    fault_ms: float | None      # from the fault to the first replaced message
    latency_ms: float | None    # from the isolation message; None: nobody told
    rmse: float | None          # of the replacement, against the truth at the same stamps
    rmse_hold: float | None     # of the last reading before the fault, at the same stamps
    unit: str


@dataclass(frozen=True)
class Result:
    """One system's outcome."""

    row: Row
    bar: float
    bar_text: str
    passed: bool


def table(results: Sequence[Result]) -> str:
    """Return the closing table as text."""
    head = ['system', 'failed', 'order', 'fault to', 'isolation to', 'RMSE of', 'RMSE of last',
            'allowed', '']
    second = ['', 'sensor', '', 'replaced', 'replaced', 'replacement', 'value held', 'RMSE', '']
    lines = [head, second]
    for result in results:
        row = result.row
        lines.append([row.system, row.failed_sensor, str(row.order),
                      _number(row.fault_ms, 'ms'), _number(row.latency_ms, 'ms'),
                      _number(row.rmse, row.unit), _number(row.rmse_hold, row.unit),
                      _number(result.bar, row.unit),
                      'ok' if result.passed else 'FAILED'])
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    texts = ['  '.join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip()
             for line in lines]
    rule = '-' * max(map(len, texts))
    return '\n'.join([*texts[:2], rule, *texts[2:]])


def _number(value: float | None, unit: str) -> str:
    return 'none' if value is None else f'{value:.3g} {unit}'.rstrip()


def write_summary(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows as a JSON list, whole or not at all; what is not finite becomes null."""
    records = [{key: None if isinstance(value, float) and not math.isfinite(value) else value
                for key, value in asdict(row).items()} for row in rows]
    scratch = path.with_name(f'.{path.name}.{os.getpid()}')
    scratch.write_text(json.dumps(records, indent=1) + '\n', encoding='utf-8')
    scratch.replace(path)
