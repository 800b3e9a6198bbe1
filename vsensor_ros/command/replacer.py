"""Run the replacer node: ``replacer --ros-args --params-file replacer.yaml``."""

from __future__ import annotations

from importlib import import_module
import os
from pathlib import Path
import signal
import sys
import tempfile
from threading import Event

USAGE = 'usage: replacer --ros-args --params-file replacer.yaml'
ROS = ('rclpy', 'ament_index_python', 'builtin_interfaces.msg', 'diagnostic_msgs.msg',
       'lifecycle_msgs.msg', 'rcl_interfaces.msg', 'rosgraph_msgs.msg', 'std_msgs.msg',
       'std_srvs.srv')


def prepare_environment() -> None:
    """Give ROS what it needs to start where nobody has sourced a workspace or logged in."""
    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    if 'ROS_LOG_DIR' in os.environ or 'ROS_HOME' in os.environ:
        return
    home = Path(os.environ.get('HOME') or '/nonexistent')
    log = next((p for p in (home / '.ros' / 'log', home / '.ros', home) if p.exists()), home)
    if not os.access(log, os.W_OK | os.X_OK):
        os.environ['ROS_LOG_DIR'] = tempfile.mkdtemp(prefix='ros_log_')


def find_ros(command: str) -> bool:
    """Tell whether what is needed of ROS can be loaded; if not, say so in one line on stderr."""
    try:
        for module in ROS:
            import_module(module)
    except ImportError as error:
        print(f'{command}: ROS 2 is not found ({" ".join(str(error).split())}): source it (source '
              '/opt/ros/jazzy/setup.bash), or pip install -r requirements.txt', file=sys.stderr)
        return False
    return True


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
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    prepare_environment()
    # loaded only now, so that a signal meanwhile ends it as quietly as any other
    if not find_ros('replacer'):
        return 2
    from vsensor_ros.node.lifecycle import start
    return start(arguments, stop)


if __name__ == '__main__':
    sys.exit(main())
