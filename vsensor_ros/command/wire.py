"""
Write a parameter file from what is on the graph, and the remappings of the drivers.

Exit code 0: every sensor and command was found; 1: some were not; 2: bad input.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import sys

from vsensor_ros.command.run import run


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `wire`."""
    parser = argparse.ArgumentParser(
        prog='wire', description='Propose topic, type and field of each sensor and command of a '
        'plant from what is on the graph, ask where unsure, and write a parameter file with the '
        'reasons. Nothing is published.')
    parser.add_argument('plant', type=Path, metavar='PLANT',
                        help='plant file (YAML), or the design file itself')
    parser.add_argument('--design', type=Path, metavar='DESIGN',
                        help='design file (default: beside the output, called after the plant)')
    parser.add_argument('-o', '--output', type=Path, metavar='FILE', default=Path('replacer.yaml'),
                        help='parameter file to write (default: %(default)s)')
    parser.add_argument('--yes', action='store_true',
                        help='take the best where it is not sure, and mark it in a comment')
    parser.add_argument('--force', action='store_true', help='overwrite the output')
    parser.add_argument('--for', type=float, default=2.0, metavar='SECONDS', dest='seconds',
                        help='how long to listen (default: %(default)g)')
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[],
                        help='what follows is for ROS')
    given = parser.parse_args(arguments)
    if not 0.0 < given.seconds < math.inf:
        parser.error('--for must be positive')

    def act() -> int:
        from vsensor_ros.commissioning.wire import wire
        return wire(given.plant, given.design, given.output, given.yes, given.force,
                    given.seconds, given.ros_args)
    return run('wire', act)


if __name__ == '__main__':
    sys.exit(main())
