"""What a person sees of the suite: a line as each case ends, the closing sentence, a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
import json
from pathlib import Path
import shutil
import sys
import tempfile
import textwrap
import time

from vsensor_ros.bad_input import BadInput
from vsensor_ros.lab.injection.case import Case
from vsensor_ros.lab.injection.suite import CaseResult, run_suite, truth_for
from vsensor_ros.lab.injection.under_test import read_under_test, UnderTest

NAME, EXPECTED = 18, 44     # columns
LOG_LINES = 8               # of the replacer, shown when a case failed


class Table:
    """Prints a table, line by line."""

    def __init__(self, tested: UnderTest) -> None:
        self.width = max(100, min(160, shutil.get_terminal_size().columns))
        self.coloured = sys.stdout.isatty()
        virtual = tested.virtual
        print(f'{tested.plant.name}: {tested.target} fails, replaced out of '
              f'{", ".join((*virtual.reads, *virtual.commands)) or "nothing"}; without an '
              f'estimate: {tested.without_estimate}'
              f'{"; nobody tells it who failed" if tested.alone else ""}')
        head = f'{"case":{NAME}}{"expected":{EXPECTED}}seen'
        print(head, '-' * self.width, sep='\n', flush=True)

    def say(self, result: CaseResult) -> None:
        """Show one case."""
        room = self.width - NAME - EXPECTED - 9
        lines = textwrap.wrap(result.seen, room) or ['']
        expected = textwrap.wrap(result.expected, EXPECTED - 2) or ['']
        for i in range(max(len(lines), len(expected))):
            name = result.case if i == 0 else ''
            outcome = result.outcome if i == 0 else ''
            wanted = expected[i] if i < len(expected) else ''
            seen = lines[i] if i < len(lines) else ''
            print(f'{name:{NAME}}{wanted:{EXPECTED}}{seen:{room + 1}}{self._colour(outcome)}'
                  .rstrip(), flush=True)

    def _colour(self, outcome: str) -> str:
        number = {'PASS': 32, 'FAIL': 31, 'skipped': 33}.get(outcome)
        return f'\033[{number}m{outcome}\033[0m' if self.coloured and number else outcome


def closing(results: Sequence[CaseResult], seconds: float) -> str:
    """Return the last sentence."""
    count = {outcome: sum(r.outcome == outcome for r in results)
             for outcome in ('PASS', 'FAIL', 'skipped')}
    text = f'{count["PASS"]} passed, {count["FAIL"]} failed, {count["skipped"]} skipped'
    failed = ', '.join(r.case for r in results if r.outcome == 'FAIL')
    return f'{text} in {seconds:.0f} s' + (f': {failed} FAILED' if failed else '')


def write_report(path: Path, results: Sequence[CaseResult]) -> None:
    """Write the results as JSON; raise BadInput."""
    try:
        path.write_text(json.dumps([asdict(r) for r in results], indent=1) + '\n',
                        encoding='utf-8')
    except OSError as problem:
        raise BadInput(path, '', problem.strerror or '', 'give another --report') from None


def list_cases(cases: Sequence[Case]) -> None:
    """Print a line for each case."""
    for case in cases:
        doc = (case.act.__doc__ or '').strip().partition('\n')[0]
        print(f'{case.name:{NAME}} {case.expected}{"  - " if doc else ""}{doc}')


def inject_and_show(plant: Path, params_file: Path, scenario: Path | None, cases: Sequence[Case],
                    running: bool, report: Path | None, ros_args: Sequence[str],
                    alone: bool = False) -> int:
    """Run cases, show and report what becomes of them; return the exit status. Raise BadInput."""
    with tempfile.TemporaryDirectory(prefix='fault_injection_') as folder:
        began, work = time.monotonic(), Path(folder)
        tested = read_under_test(plant, params_file, scenario, work, ros_args, alone)
        if report:  # that it cannot be written is not found in the end
            write_report(report, [])
        truth = truth_for(tested, cases)
        results = run_suite(tested, truth, cases, running, Table(tested).say)
        failed = any(result.outcome == 'FAIL' for result in results)
        print(closing(results, time.monotonic() - began))
        log = work / 'replacer.log'
        if failed and log.exists():
            lines = log.read_text(errors='replace').splitlines()
            print('The last lines of the replacer:', *lines[-LOG_LINES:], sep='\n  ')
    if report:
        write_report(report, results)
    return int(failed or not results)
