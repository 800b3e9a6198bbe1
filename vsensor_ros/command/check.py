"""
Say before the first drive what would not work when a sensor fails; it listens, and says nothing.

Exit code 0: all would work; 1: something would not; 2: bad input.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import sys

from vsensor_ros.command.run import parameter_file, run


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `check`."""
    parser = argparse.ArgumentParser(
        prog='check', description='Listen beside a robot and say what would not work when a '
        'sensor fails: topics, types, QoS, rates, stamps, fields, and whether each sensor could '
        'be replaced now. Nothing is published.')
    parser.add_argument('--params-file', type=Path, metavar='FILE',
                        help="the replacer's parameter file; or the first after --ros-args")
    parser.add_argument('--for', type=float, default=5.0, metavar='SECONDS', dest='seconds',
                        help='how long to listen (default: %(default)g); until the virtual '
                        'sensors have warmed up, if it is to be seen that they do')
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[],
                        help='what follows is for ROS, as the replacer is to be given it')
    given = parser.parse_args(arguments)
    if not 0.0 < given.seconds < math.inf:
        parser.error('--for must be positive')
    path = parameter_file(given.params_file, given.ros_args)
    if path is None:
        parser.error('--params-file is needed')

    def act() -> int:
        from vsensor_ros.commissioning.check import check
        return check(path, given.seconds, given.ros_args)
    return run('check', act)


if __name__ == '__main__':
    sys.exit(main())
