"""Run the replacer node: ``replacer --ros-args --params-file replacer.yaml``."""

from __future__ import annotations

import signal
import sys
from threading import Event

from vsensor_ros.command.run import find_ros, prepare_environment, SIGNALS

USAGE = 'usage: replacer --ros-args --params-file replacer.yaml'


def main(arguments: list[str] | None = None) -> int:
    """Run until SIGINT or SIGTERM; 0 then, 2 when it cannot start with what it was given."""
    arguments = sys.argv[1:] if arguments is None else arguments
    own = arguments[:arguments.index('--ros-args')] if '--ros-args' in arguments else arguments
    if {'-h', '--help'} & set(own):
        print(USAGE)
        return 0
    if own:
        print(f'replacer: {own[0]}: there is no such argument; {USAGE}', file=sys.stderr)
        return 2
    stop = Event()
    for number in SIGNALS:
        signal.signal(number, lambda *_: stop.set())
    prepare_environment()
    # loaded only now, so that a signal meanwhile ends it as quietly as any other
    if not find_ros('replacer'):
        return 2
    from vsensor_ros.node.lifecycle import start
    return start(arguments, stop)


if __name__ == '__main__':
    sys.exit(main())
