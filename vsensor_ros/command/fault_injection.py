"""
Inject faults into a replacer from outside and judge what comes out against the truth.

Exit code 0: every case passed or was skipped for a reason; 1: one failed; 2: bad input.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys

from vsensor_ros.command.run import parameter_file, run


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `fault_injection`."""
    parser = argparse.ArgumentParser(prog='fault_injection', description=(
        'Inject faults into a replacer from outside, on real topics, and judge what comes out '
        'against the truth of a simulated plant.'))
    parser.add_argument('--plant', type=Path, help='plant file')
    parser.add_argument('--params-file', type=Path, help="the replacer's parameter file")
    parser.add_argument('--scenario', type=Path, help='a demo.yaml: what drives the plant, which '
                        'sensor fails (default: the one beside the plant file, if any)')
    parser.add_argument('--only', default='', metavar='CASE,..', help='these cases alone')
    parser.add_argument('--quick', action='store_true',
                        help='half of the cases, the quick ones of each kind')
    parser.add_argument('--running', action='store_true', help='attach to the replacer that '
                        'runs in this ROS domain, in place of starting one in another')
    parser.add_argument('--alone', action='store_true', help='nobody tells the replacer who has '
                        'failed: its own isolator has to find out')
    parser.add_argument('--list', action='store_true', help='list the cases and end')
    parser.add_argument('--report', type=Path, metavar='FILE', help='write the results as JSON')
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[],
                        help='what follows is for ROS: for the replacer and for these nodes')
    given = parser.parse_args(arguments)
    path = parameter_file(given.params_file, given.ros_args)
    if not given.list and (given.plant is None or path is None):
        parser.error('--plant and --params-file are needed, but for --list')

    if given.alone and given.running:
        parser.error('--alone starts a replacer of its own, without --running')

    def act() -> int:
        from vsensor_ros.lab.injection.suite import choose
        from vsensor_ros.lab.injection.table import inject_and_show, list_cases
        cases = choose(given.only, given.quick, given.alone)
        if given.list or path is None:
            list_cases(cases)
            return 0
        return inject_and_show(given.plant, path, given.scenario, cases,
                               given.running, given.report, given.ros_args, given.alone)
    return run('fault_injection', act)


if __name__ == '__main__':
    sys.exit(main())
