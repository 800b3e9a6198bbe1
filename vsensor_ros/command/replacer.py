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


def main(arguments: list[str] | None = None, name: str = 'replacer') -> int:
    """
    Run until SIGINT or SIGTERM; 0 then, 2 when it cannot start with what it was given.

    name: of the command, replacer or isolator.
    """
    usage = f'usage: {name} --ros-args --params-file replacer.yaml'
    arguments = sys.argv[1:] if arguments is None else arguments
    own = arguments[:arguments.index('--ros-args')] if '--ros-args' in arguments else arguments
    if {'-h', '--help'} & set(own):
        print(usage)
        return 0
    if own:
        print(f'{name}: {own[0]}: there is no such argument; {usage}', file=sys.stderr)
        return 2
    # nothing is open yet, and on a busy machine all that is to be loaded takes many seconds
    _on_signals(lambda: os._exit(0))
    prepare_environment()
    if not find_ros(name):
        return 2
    from vsensor_ros.node.lifecycle import ISOLATOR, REPLACER, start
    stop = Event()

    def end() -> None:
        stop.set()
        faulthandler.dump_traceback_later(LAST_RESORT, exit=True)
    _on_signals(end)
    try:
        return start(arguments, stop, ISOLATOR if name == 'isolator' else REPLACER)
    finally:
        faulthandler.cancel_dump_traceback_later()


def _on_signals(act: Callable[[], None]) -> None:
    for number in SIGNALS:
        signal.signal(number, lambda *_: act())


if __name__ == '__main__':
    sys.exit(main())
