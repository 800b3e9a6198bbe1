"""Run the isolator node: ``isolator --ros-args --params-file replacer.yaml``."""

from __future__ import annotations

import sys

from vsensor_ros.command import replacer


def main(arguments: list[str] | None = None) -> int:
    """Run until SIGINT or SIGTERM; 0 then, 2 when it cannot start with what it was given."""
    return replacer.main(arguments, 'isolator')


if __name__ == '__main__':
    sys.exit(main())
