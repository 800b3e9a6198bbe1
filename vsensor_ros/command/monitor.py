"""
Watch a replacer: who speaks for each sensor, how well and why, on one screen.

It only listens to ~/status of the replacer, so that it may run on any computer that hears it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import sys

from vsensor_ros.command.run import run


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `monitor`; return 0, 1 when --once hears nothing, 2 for bad input."""
    parser = argparse.ArgumentParser(
        prog='monitor', description='Watch a replacer: who speaks for each sensor, and why.')
    parser.add_argument('--node', default='/replacer',
                        help='full name of the replacer (default: %(default)s)')
    parser.add_argument('--once', action='store_true', help='show what it says now, and end')
    parser.add_argument('--plain', action='store_true',
                        help='print a line on each change, as is done when this is no terminal')
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[],
                        help='what follows is for ROS')
    given = parser.parse_args(arguments)

    def act() -> int:
        from vsensor_ros.lab.monitor import monitor
        return monitor(given.node, given.once, given.plain, given.ros_args)
    return run('monitor', act, stopped=0)


if __name__ == '__main__':
    sys.exit(main())
