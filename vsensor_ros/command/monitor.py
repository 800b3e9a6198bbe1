"""
Watch a replacer: who speaks for each sensor, how well and why, on one screen.

It only listens to ~/status of the replacer, so that it may run on any computer that hears it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os
import sys
import time
from typing import Any, TYPE_CHECKING

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.replacer import find_ros, prepare_environment
from vsensor_ros.lab.interrupt import interrupt_once
from vsensor_ros.lab.screen import changes, duration, Line, OLD, read_status, screen, Told

if TYPE_CHECKING:
    from rclpy.node import Node

LOOK = 0.1  # s between two looks at the topic
DRAW = 0.5  # s between two pictures when nothing comes: ages grow
PATIENCE = 5.0  # s after which --once gives up
TYPE = 'diagnostic_msgs/msg/DiagnosticArray'


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
    interrupt_once()
    prepare_environment()
    try:
        if not find_ros('monitor'):
            return 2
        with _listener(given.node, given.ros_args) as listener:
            if given.once:
                return _once(listener, given.plain)
            if given.plain or not sys.stdout.isatty() or not _has_rich():
                _print_changes(listener)
            else:
                _watch(listener)
    except BadInput as problem:
        print(problem, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        pass
    except BrokenPipeError:  # whoever read it has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _has_rich() -> bool:
    try:
        import rich  # noqa: F401
    except ImportError:
        print('monitor: rich is not installed, so a line on each change: apt install python3-rich,'
              ' or pip install rich', file=sys.stderr)
        return False
    return True


class Listener:
    """The last status of one replacer, and when it came."""

    def __init__(self, node: Node, name: str) -> None:
        """Listen to the replacer of a full name; raise BadInput when there can be none."""
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.exceptions import NameValidationException
        from rclpy.expand_topic_name import expand_topic_name
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from rclpy.validate_full_topic_name import validate_full_topic_name
        self.name = '/' + name.strip('/')
        self.topic = f'{self.name}/status'
        try:
            expand_topic_name(self.topic, 'monitor', '/')
            validate_full_topic_name(self.topic)
        except (ValueError, NameValidationException):
            raise BadInput('monitor', '--node', f'{name!r} is no name of a node',
                           'give one of `ros2 node list`') from None
        self.node = node
        self.told: Told | None = None
        self.at = self.since = time.monotonic()
        node.create_subscription(DiagnosticArray, self.topic, self._hear, QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    def _hear(self, array: Any) -> None:
        self.told, self.at = read_status(array), time.monotonic()

    @property
    def age(self) -> float:
        """Return for how long [s] nothing was heard."""
        return time.monotonic() - self.at

    def look(self) -> bool:
        """Wait a moment for a status; tell whether one came."""
        import rclpy
        before = self.at
        rclpy.spin_once(self.node, timeout_sec=LOOK)
        return self.at != before

    def why_nothing(self) -> str:
        """Say in one line why there is nothing to see, and what to do."""
        if self.node.count_publishers(self.topic):
            return (f'{self.topic} is published, but nothing is heard on it: does its type or QoS '
                    f'fit? ros2 topic info -v {self.topic}')
        line = f'no replacer on {self.topic}: is it running? ros2 node list'
        others = [topic.removesuffix('/status')
                  for topic, types in self.node.get_topic_names_and_types()
                  if topic.endswith('/status') and TYPE in types and topic != self.topic]
        return f'{line}; or is it {", ".join(f"--node {o}" for o in others)}?' if others else line


@contextmanager
def _listener(name: str, ros_arguments: Sequence[str]) -> Iterator[Listener]:
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    try:
        rclpy.init(args=['--ros-args', *ros_arguments],
                   signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node('monitor')
    except RuntimeError as error:  # what rcl raises
        raise BadInput('monitor', 'arguments', str(error).partition(', at ')[0],
                       'correct the arguments after --ros-args') from None
    try:
        yield Listener(node, name)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _once(listener: Listener, plain: bool) -> int:
    """Show the first status that comes; return 1 when none does."""
    while listener.told is None:
        if listener.age > PATIENCE:
            print(listener.why_nothing(), file=sys.stderr)
            return 1
        listener.look()
    if plain:
        print('\n'.join(changes(None, listener.told)), flush=True)
    else:
        width = os.get_terminal_size().columns if sys.stdout.isatty() else 100
        lines = screen(listener.told, listener.age, listener.name, width, 10**6)
        print('\n'.join(map(_text, lines)), flush=True)
    return 0


def _text(line: Line) -> str:
    return ''.join(text for text, _ in line)


def _print_changes(listener: Listener) -> None:
    """Print a line on each change, until interrupted."""
    shown, silent = None, False

    def say(line: str) -> None:
        print(time.strftime('%H:%M:%S'), line, flush=True)
    while True:
        if listener.look() and listener.told is not None:
            for line in changes(None if silent else shown, listener.told):
                say(line)
            shown, silent = listener.told, False
        elif not silent and listener.age > OLD:
            silent = True
            say(listener.why_nothing() if shown is None else
                f'{listener.name} SILENT since {duration(listener.age)}: is it running? '
                'ros2 node list')


def _watch(listener: Listener) -> None:
    """Draw the screen anew on each status, until interrupted."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text
    console = Console(highlight=False, markup=False)

    def picture() -> Text:
        width, height = console.size
        if listener.told is not None:
            lines = screen(listener.told, listener.age, listener.name, width, height)
        elif listener.age < OLD:
            lines = [((f'waiting for {listener.topic}', ''),)]
        else:
            lines = [((listener.why_nothing(), 'bold red'),)]
        rows = [Text.assemble(*line) for line in lines]
        return Text('\n').join(rows)
    drawn = time.monotonic()
    with Live(picture(), console=console, screen=True, auto_refresh=False) as live:
        while True:
            if listener.look() or time.monotonic() - drawn > DRAW:
                live.update(picture(), refresh=True)
                drawn = time.monotonic()


if __name__ == '__main__':
    sys.exit(main())
