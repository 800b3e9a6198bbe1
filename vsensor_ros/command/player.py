"""Play a table of readings and commands as ROS messages, as the machine would have sent them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import sys

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.replacer import find_ros, prepare_environment
from vsensor_ros.lab.interrupt import interrupt_once
from vsensor_ros.simulate.table import read_table

LATE = 0.05             # s on the wall; what is played later than this is another machine
LATE_CODE = 3           # the exit code that says so


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `player`."""
    parser = argparse.ArgumentParser(prog='player', description=__doc__)
    parser.add_argument('table', type=Path, help='CSV file: time [s], then a column a channel')
    parser.add_argument('wiring', type=Path, help="the replacer's parameter file: the topics")
    parser.add_argument('--speed', type=float, default=1.0,
                        help='times real time; other than 1 publishes /clock')
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[],
                        help='what follows is for ROS')
    given = parser.parse_args(arguments)
    if not 0.0 < given.speed < math.inf:
        parser.error('--speed must be positive')
    prepare_environment()
    if not find_ros('player'):
        return 2
    # loaded only now, for there may be no ROS
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from vsensor_ros.lab.play import play
    from vsensor_ros.lab.wiring import read_wiring
    try:
        channels = read_table(given.table)
        wiring = read_wiring(given.wiring)
        for name in channels:
            if name not in wiring.ports:
                raise BadInput(given.table, name, f'has no topic in {given.wiring}',
                               'name the columns as the sensors and commands there')
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    try:
        interrupt_once()
        rclpy.init(args=['--ros-args', *given.ros_args],
                   signal_handler_options=SignalHandlerOptions.NO)
        late = play(rclpy.create_node('player'), channels, wiring.ports, given.speed)
    except KeyboardInterrupt:
        return 0
    finally:
        rclpy.try_shutdown()
    if late > LATE:
        print(f'{late:.2f} s late at worst: this machine is too busy', file=sys.stderr)
        return LATE_CODE
    return 0


if __name__ == '__main__':
    sys.exit(main())
