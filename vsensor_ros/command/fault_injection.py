"""
Inject faults into a replacer from outside and judge what comes out against the truth.

Exit code 0: every case passed or was skipped for a reason; 1: one failed; 2: bad input.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys
import tempfile
import time

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.replacer import find_ros, prepare_environment
from vsensor_ros.lab.interrupt import interrupt_once


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `fault_injection`."""
    parser = argparse.ArgumentParser(prog='fault_injection', description=(
        'Inject faults into a replacer from outside, on real topics, and judge what comes out '
        'against the truth of a simulated plant.'))
    parser.add_argument('--plant', type=Path, required=True, help='plant file')
    parser.add_argument('--params-file', type=Path, required=True,
                        help="the replacer's parameter file")
    parser.add_argument('--scenario', type=Path, help='a demo.yaml: what drives the plant, which '
                        'sensor fails (default: the one beside the plant file, if any)')
    parser.add_argument('--only', default='', metavar='CASE,..', help='these cases alone')
    parser.add_argument('--running', action='store_true', help='attach to the replacer that '
                        'runs in this ROS domain, in place of starting one in another')
    parser.add_argument('--list', action='store_true', help='list the cases and end')
    parser.add_argument('--report', type=Path, metavar='FILE', help='write the results as JSON')
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[],
                        help='what follows is for ROS: for the replacer and for these nodes')
    given = parser.parse_args(arguments)
    interrupt_once()
    prepare_environment()
    try:
        if not find_ros('fault_injection'):
            return 2
        return _run(given)
    except ModuleNotFoundError as missing:
        print(f'fault_injection: {missing.name} is not installed', file=sys.stderr)
        return 2
    except BadInput as problem:
        print(problem, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('stopped', file=sys.stderr)
        return 130


def _run(given: argparse.Namespace) -> int:
    # imported here so that Ctrl-C while they load ends as quietly as any other
    from vsensor_ros.lab.injection.setup import read_setup
    from vsensor_ros.lab.injection.show import closing, Screen, write_report
    from vsensor_ros.lab.injection.suite import ALL, run_suite

    cases = list(ALL)
    if given.only:
        known = {case.name: case for case in ALL}
        for name in (names := given.only.split(',')):
            if name not in known:
                raise BadInput('fault_injection', '--only', f'there is no case {name}',
                               f'choose from {", ".join(known)}')
        cases = [case for case in ALL if case.name in names]
    if given.list:
        for case in cases:
            doc = ' '.join((case.act.__doc__ or '').split())
            print(f'{case.name:18} {case.expected}{"  - " if doc else ""}{doc}')
        return 0
    beside = given.plant.parent / 'demo.yaml'
    scenario = given.scenario or (beside if beside.is_file() else None)
    ros_args = ['--ros-args', *given.ros_args] if given.ros_args else []
    with tempfile.TemporaryDirectory(prefix='fault_injection_') as folder:
        began = time.monotonic()
        setup = read_setup(given.plant, given.params_file, scenario, Path(folder), ros_args)
        results = run_suite(setup, scenario, cases, Path(folder), given.running,
                            Screen(setup).say)
        failed = [result for result in results if result.outcome == 'FAIL']
        print(closing(results, time.monotonic() - began))
        log = Path(folder) / 'replacer.log'
        if failed and log.exists():
            print('The last lines of the replacer:', *_tail(log), sep='\n  ')
        if given.report:
            write_report(given.report, results)
    return int(bool(failed) or not results)


def _tail(log: Path) -> list[str]:
    return log.read_text(errors='replace').splitlines()[-8:]


if __name__ == '__main__':
    sys.exit(main())
