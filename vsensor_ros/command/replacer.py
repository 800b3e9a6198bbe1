"""Run the replacer node: ``replacer --ros-args --params-file replacer.yaml``."""

from __future__ import annotations

from collections.abc import Callable
import faulthandler
import os
import signal
import sys
from threading import Event

from vsensor_ros.command.run import find_ros, prepare_environment, SIGNALS

LAST_RESORT = 9.0  # s after a signal: then it says where it hangs, and is gone
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
    # nothing is open yet, and on a busy machine all that is to be loaded takes many seconds
    _on_signals(lambda: os._exit(0))
    prepare_environment()
    if not find_ros('replacer'):
        return 2
    from vsensor_ros.node.lifecycle import start
    stop = Event()

    def end() -> None:
        stop.set()
        faulthandler.dump_traceback_later(LAST_RESORT, exit=True)
    _on_signals(end)
    try:
        return start(arguments, stop)
    finally:
        faulthandler.cancel_dump_traceback_later()


def _on_signals(act: Callable[[], None]) -> None:
    for number in SIGNALS:
        signal.signal(number, lambda *_: act())


if __name__ == '__main__':
    sys.exit(main())
