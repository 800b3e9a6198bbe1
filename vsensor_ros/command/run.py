"""What the commands do alike: find ROS, end in order, and say in one line what is wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from itertools import pairwise
import os
from pathlib import Path
import signal
import sys
import tempfile
from typing import Any

from vsensor_ros.bad_input import BadInput

ROS = ('rclpy', 'ament_index_python', 'builtin_interfaces.msg', 'diagnostic_msgs.msg',
       'lifecycle_msgs.msg', 'rcl_interfaces.msg', 'rosgraph_msgs.msg', 'std_msgs.msg',
       'std_srvs.srv')
SIGNALS = (signal.SIGINT, signal.SIGTERM)
INTERRUPTED = 130   # the exit status that says so


def run(command: str, act: Callable[[], int], stopped: int = INTERRUPTED,
        ros: bool = True) -> int:
    """
    Run what a command does where there is ROS; return its exit status.

    It is 2 where there is no ROS, if `ros` is needed, or the input is bad, `stopped` after Ctrl-C.
    What needs ROS is to be loaded by `act`, so that Ctrl-C meanwhile ends it as quietly as any
    other.
    """
    interrupt_once()
    prepare_environment()
    try:
        return act() if not ros or find_ros(command) else 2
    except ModuleNotFoundError as missing:
        print(f'{command}: {missing.name} is not installed: pip install it, or run in the .venv '
              'that make sets up', file=sys.stderr)
        return 2
    except BadInput as problem:
        print(f'{command}: {problem}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        if stopped:
            print(f'{command}: stopped', file=sys.stderr)
        return stopped


def check_output(path: Path | None, option: str, inputs: Sequence[str | Path] = ()) -> None:
    """Raise BadInput, before the work, where a file cannot be written or is one that is read."""
    if path is None:
        return
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise BadInput(path, option, 'cannot be written', 'name a file in a folder that exists')
    if path.exists() and any(os.path.exists(i) and path.samefile(i) for i in inputs):
        raise BadInput(path, option, 'is what is read: it would be lost', 'name another file')


def parameter_file(named: Path | None, ros_args: Sequence[str]) -> Path | None:
    """Return the parameter file of a command line: the one named, else the first for ROS."""
    return named or next((Path(value) for flag, value in pairwise(ros_args)
                          if flag == '--params-file'), None)


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


def interrupt_once() -> None:
    """Have the first SIGINT or SIGTERM raise KeyboardInterrupt, and no other disturb the end."""
    for number in SIGNALS:
        signal.signal(number, _interrupt)


def _interrupt(*_: Any) -> None:
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
