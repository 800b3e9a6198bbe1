"""The live view of one replacer: what is heard on its ~/status, drawn anew or line by line."""

from __future__ import annotations

from collections.abc import Sequence
import os
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.validate_full_topic_name import validate_full_topic_name

from vsensor_ros.bad_input import BadInput
from vsensor_ros.lab.domain import by_hand, open_nodes
from vsensor_ros.lab.screen import changes, duration, Line, OLD, read_status, screen, StatusMessage
from vsensor_ros.node.private_rclpy import take_all

LOOK = 0.1  # s that a look at the topic takes at most
POLL = 0.01  # s
DRAW = 0.5  # s between two pictures when nothing comes: ages grow
PATIENCE = 5.0  # s after which --once gives up
TYPE = 'diagnostic_msgs/msg/DiagnosticArray'


def monitor(name: str, once: bool, plain: bool, ros_args: Sequence[str]) -> int:
    """Show the replacer of a full name, until interrupted; return the exit status."""
    with open_nodes('monitor', ros_args=ros_args) as (node,):
        listener = Listener(node, name)
        try:
            if once:
                return _once(listener, plain)
            if plain or not sys.stdout.isatty() or not _has_rich():
                _print_changes(listener)
            else:
                _watch(listener)
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
        self.name = '/' + name.strip('/')
        self.topic = f'{self.name}/status'
        try:
            expand_topic_name(self.topic, 'monitor', '/')
            validate_full_topic_name(self.topic)
        except (ValueError, NameValidationException):
            raise BadInput('', '--node', f'{name!r} is no name of a node',
                           'give one of `ros2 node list`') from None
        self.node = node
        self.told: StatusMessage | None = None
        self.at = self.since = time.monotonic()
        self._status = node.create_subscription(DiagnosticArray, self.topic, by_hand, QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    @property
    def age(self) -> float:
        """Return for how long [s] nothing was heard."""
        return time.monotonic() - self.at

    def look(self) -> bool:
        """Wait a moment for a status; tell whether one came."""
        end = time.monotonic() + LOOK
        while time.monotonic() < end:
            for array, _ in take_all(self._status):
                self.told, self.at = read_status(array), time.monotonic()
                return True
            time.sleep(POLL)
        return False

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


def _once(listener: Listener, plain: bool) -> int:
    """Show the first status that comes; return 1 when none does."""
    while listener.told is None:
        if listener.age > PATIENCE:
            print(f'monitor: {listener.why_nothing()}', file=sys.stderr)
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
