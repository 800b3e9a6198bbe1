"""Play a table of readings and commands as ROS messages, as the machine would have sent them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import sys

from vsensor_ros.command.run import run


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `player`; return 3 when this computer was too busy to play in time."""
    parser = argparse.ArgumentParser(prog='player', description=__doc__)
    parser.add_argument('table', type=Path, help='CSV file: time [s], then a column a channel')
    parser.add_argument('wiring', type=Path, help="the replacer's parameter file: the topics")
    parser.add_argument('--speed', type=float, default=1.0, help='times real time; other than 1 '
                        'publishes /clock, as does use_sim_time in the parameter file')
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[],
                        help='what follows is for ROS')
    given = parser.parse_args(arguments)
    if not 0.0 < given.speed < math.inf:
        parser.error('--speed must be positive')

    def act() -> int:
        from vsensor_ros.lab.play import play_table
        return play_table(given.table, given.wiring, given.speed, given.ros_args)
    return run('player', act, stopped=0)


if __name__ == '__main__':
    sys.exit(main())
