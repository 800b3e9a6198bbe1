"""What a person sees of the suite: a line as each case ends, and the closing sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
import json
from pathlib import Path
import shutil
import sys
import textwrap

from vsensor_ros.bad_input import BadInput
from vsensor_ros.lab.injection.setup import Setup
from vsensor_ros.lab.injection.suite import Result

NAME, EXPECTED = 18, 44     # columns


class Screen:
    """Prints a table, line by line."""

    def __init__(self, setup: Setup) -> None:
        self.width = max(100, min(160, shutil.get_terminal_size().columns))
        self.coloured = sys.stdout.isatty()
        virtual = setup.virtual
        print(f'{setup.plant.name}: {setup.target} fails, replaced out of '
              f'{", ".join((*virtual.reads, *virtual.commands)) or "nothing"}; without an '
              f'estimate: {setup.without_estimate}')
        head = f'{"case":{NAME}}{"expected":{EXPECTED}}seen'
        print(head, '-' * self.width, sep='\n', flush=True)

    def say(self, result: Result) -> None:
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


def closing(results: Sequence[Result], seconds: float) -> str:
    """Return the last sentence."""
    count = {outcome: sum(r.outcome == outcome for r in results)
             for outcome in ('PASS', 'FAIL', 'skipped')}
    text = f'{count["PASS"]} passed, {count["FAIL"]} failed, {count["skipped"]} skipped'
    failed = ', '.join(r.case for r in results if r.outcome == 'FAIL')
    return f'{text} in {seconds:.0f} s' + (f': {failed} FAILED' if failed else '')


def write_report(path: Path, results: Sequence[Result]) -> None:
    """Write the results as JSON; raise BadInput."""
    try:
        path.write_text(json.dumps([asdict(r) for r in results], indent=1) + '\n',
                        encoding='utf-8')
    except OSError as problem:
        raise BadInput(path, '', problem.strerror or '', 'give another --report') from None
