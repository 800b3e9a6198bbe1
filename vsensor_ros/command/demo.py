"""
Watch failed sensors being replaced, over real topics.

Every folder of config/ that has a demo.yaml is a system to show; what its truth needs and is not
here (a recording, MuJoCo) is said. Exit code 0: every replacement met its bar; 1: one did not, or
a process died; 2: bad input.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys

from vsensor_ros.command.run import run


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `demo`."""
    parser = argparse.ArgumentParser(
        prog='demo', description='Watch failed sensors being replaced, over real ROS 2 topics.')
    parser.add_argument('systems', nargs='*', metavar='SYSTEM',
                        help='folders of config/ (default: all that have a demo.yaml)')
    parser.add_argument('--output', type=Path, default=Path('build/demo'),
                        help='folder for summary.json, the pictures, designs and logs')
    given = parser.parse_args(arguments)

    def act() -> int:
        from vsensor_ros.lab.demo_runner import show_all
        return show_all(given.systems, given.output)
    return run('demo', act)


if __name__ == '__main__':
    sys.exit(main())
