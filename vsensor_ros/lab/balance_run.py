"""
One run of a machine that falls, over real topics and in simulated time.

The machine moves on when it has heard the command for the next period, and stands still until
then: a busy computer makes a run longer, and changes nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
import math
from pathlib import Path
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock

from vsensor_ros.lab.balance_controller import ORIGIN
from vsensor_ros.lab.domain import (
    by_hand,
    open_nodes,
    reserved_domain,
    stay_on_this_computer,
)
from vsensor_ros.lab.parameter_file import read_parameters
from vsensor_ros.lab.play import LATCHED, to_stamp
from vsensor_ros.lab.played_driver import drivers_of
from vsensor_ros.lab.process import Failed, Process
from vsensor_ros.lab.screen import read_status
from vsensor_ros.lab.wiring import Wiring, wiring_of
from vsensor_ros.node.accessor import get_stamp
from vsensor_ros.node.private_rclpy import take_all, Waiting
from vsensor_ros.plant import Plant
from vsensor_ros.simulate.balance import Balance
from vsensor_ros.simulate.mujoco_machine import MujocoMachine

PATIENCE = 60.0         # s on the wall that an answer may take
AGAIN = 0.1             # s on the wall after which the first readings are said again
SHOWN = 0.1             # s on the wall between two reports of progress
LOOK = 50_000_000       # ns of a wait, after which it looks whether all are alive
AFTERMATH = 1.0         # s that a run goes on after a fall
SEED = 0
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


@dataclass(frozen=True)
class Moment:
    """Where a run is: its time, what is true, what the controller is told of the failed sensor."""

    time: float
    truth: dict[str, float]
    told: float
    isolated: bool


@dataclass(frozen=True, eq=False)
class Watched:
    """
    A run that is over, n periods of it; sensors in the plant's order.

    `told` is what the controller was told of the failed sensor, NaN where nothing; `deviation`
    that which the replacer gave with it. `latency_ms`: on the wall, from the isolation message to
    the first replacement.
    """

    failed_sensor: str
    replaced: bool
    time: NDArray[np.float64]       # (n,) s
    truth: NDArray[np.float64]      # (n, l)
    said: NDArray[np.float64]       # (n, l), by the sensors
    told: NDArray[np.float64]       # (n,)
    deviation: NDArray[np.float64]  # (n,)
    fell_at: float | None           # s
    latency_ms: float | None


def balance(story: Balance, plant: Plant, failed: str, replaced: bool, folder: Path,
            design_file: Path, work: Path, progress: Callable[[Moment], None]) -> Watched:
    """
    Let a sensor freeze while the machine is balanced, and go on until the end or past a fall.

    `folder` is the system's, `work` an existing one for the logs. Raise BadInput or Failed.
    """
    machine = MujocoMachine(story.model, plant.sensors, plant.inputs, story.initial, story.gusts,
                            SEED)
    parameters = read_parameters(folder / 'replacer.yaml')
    wiring = wiring_of(parameters)
    with ExitStack() as stack:
        domain = stack.enter_context(reserved_domain())
        stay_on_this_computer()

        def run(name: str, *arguments: str) -> Process:
            way = 'replaced' if replaced else 'alone'
            log = work / f'{folder.name}.{failed}.{way}.{name.split()[-1]}.log'
            log.unlink(missing_ok=True)
            return stack.enter_context(Process(name, arguments, domain, log))

        # without a replacer the controller hears the sensors themselves
        remappings = [] if replaced else [word for port in wiring.ports.values()
                                          for word in ('-r', f'{port.output}:={port.source}')]
        processes = [run('the controller', 'vsensor_ros.lab.balance_controller', str(folder),
                         '--ros-args', *remappings)]
        if replaced:
            processes.append(run('the replacer', 'vsensor_ros.command.replacer',
                                 *parameters.command_line(work / f'{folder.name}.changed.yaml',
                                                          design_file=str(design_file))))
        [node] = stack.enter_context(open_nodes('machine', domain=domain,
                                                ros_args=parameters.ros_args))
        graph = _Graph(node, wiring, plant, failed, parameters.node)
        waiting = stack.enter_context(Waiting(graph.subscriptions, node.context))
        return _Play(story, machine, graph, waiting, processes, replaced).play(progress)


class _Graph:
    """The machine's topics, its isolation, and what there is to hear."""

    def __init__(self, node: Node, wiring: Wiring, plant: Plant, failed: str,
                 replacer: str) -> None:
        def listen(kind: Any, topic: str, qos: QoSProfile) -> Subscription:
            return node.create_subscription(kind, topic, by_hand, qos)
        ports, deep = wiring.ports, QoSProfile(depth=1000)
        self.sensors, self.failed, self.port = plant.sensors, failed, ports[failed]
        self.drivers = drivers_of(node, (ports[name] for name in plant.sensors))
        self.motors = [ports[name] for name in plant.inputs]
        self.clock = node.create_publisher(Clock, '/clock', 10)
        self.isolation = node.create_publisher(DiagnosticArray, wiring.isolation, LATCHED)
        self.command = listen(self.motors[0].kind, self.motors[0].source, deep)
        self.output = listen(self.port.kind, self.port.output, deep)
        self.status = listen(DiagnosticArray, f'{replacer}/status', LATCHED)
        self.estimates = listen(DiagnosticArray, f'{replacer}/estimates', BEST_EFFORT)

    @property
    def subscriptions(self) -> list[Subscription]:
        """Return those that are worth waking up for."""
        return [self.command, self.output, self.status]

    def say(self, readings: NDArray[np.float64], stamp: int) -> None:
        """Publish the time and what the sensors read (l,)."""
        self.clock.publish(Clock(clock=to_stamp(stamp)))
        said = dict(zip(self.sensors, readings))
        for driver in self.drivers:
            driver.send([float(said[port.name]) for port in driver.ports], stamp)

    def isolate(self, faulty: Collection[str], stamp: int) -> None:
        """Publish which sensors are faulty, with all that are not."""
        message = DiagnosticArray(status=[
            DiagnosticStatus(name=name, message='frozen', level=DiagnosticStatus.ERROR)
            if name in faulty else DiagnosticStatus(name=name, level=DiagnosticStatus.OK)
            for name in self.sensors])
        message.header.stamp = to_stamp(stamp)
        self.isolation.publish(message)


class _Play:
    """A run while it lasts."""

    def __init__(self, story: Balance, machine: MujocoMachine, graph: _Graph, waiting: Waiting,
                 processes: list[Process], replaced: bool) -> None:
        self.story, self.machine, self.graph, self.waiting = story, machine, graph, waiting
        self.processes, self.replaced = processes, replaced
        rows, width = story.step(story.end) + 1, len(graph.sensors)
        self.period = round(story.period * 1e9)  # ns
        self.truth: NDArray[np.float64] = np.zeros((rows, width))
        self.said: NDArray[np.float64] = np.zeros((rows, width))
        self.told: NDArray[np.float64] = np.full(rows, np.nan)
        self.deviation: NDArray[np.float64] = np.full(rows, np.nan)
        self.commands: dict[int, list[float]] = {}  # that have come, by stamp
        self.heard = -1                     # the last period of which `told` is known
        self.isolated: float | None = None  # s, when by a steady clock
        self.heeded = False                 # the isolation, by the replacer
        self.latency: float | None = None   # s

    def play(self, progress: Callable[[Moment], None]) -> Watched:
        """Go from period to period, to the end or past a fall."""
        story, graph = self.story, self.graph
        failed = graph.sensors.index(graph.failed)
        command = [0.0] * len(graph.motors)
        fell: int | None = None
        shown, row = 0.0, 0
        graph.isolate((), ORIGIN)
        for row in range(len(self.told)):
            if self.replaced and row == story.step(story.isolated_at):
                self._isolate(row)
            self.truth[row], self.said[row] = self.machine.truth(), self.machine.readings()
            frozen = min(row, story.step(story.failed_at))
            self.said[row, failed] = self.said[frozen, failed]
            if not self.replaced:
                self.told[row] = self.said[row, failed]
            coming = self._command_after(row)
            self.machine.move(command, story.period)
            command = coming
            if fell is None and self._lies(row):
                fell = row
            if fell is not None and row - fell > story.step(AFTERMATH):
                break
            if time.monotonic() > shown + SHOWN:
                shown = time.monotonic()
                progress(Moment(row * story.period, dict(zip(graph.sensors, self.truth[row])),
                                self.told[row], self.isolated is not None))
        n = row + 1
        time_ = story.period * np.arange(n, dtype=np.float64)
        return Watched(graph.failed, self.replaced, time_, self.truth[:n], self.said[:n],
                       self.told[:n], self.deviation[:n],
                       None if fell is None else fell * story.period,
                       None if self.latency is None else 1e3 * self.latency)

    def _isolate(self, row: int) -> None:
        """Say that the sensor is faulty, and stand still until the replacer knows."""
        self.isolated = time.monotonic()
        self.graph.isolate((self.graph.failed,), ORIGIN + row * self.period)
        self._wait(lambda: self.heeded, 'the replacer did not heed the isolation')

    def _command_after(self, row: int) -> list[float]:
        """Say what the sensors read, and stand still until the next command has come."""
        stamp = ORIGIN + row * self.period
        say = partial(self.graph.say, self.said[row], stamp)
        say()
        # before anybody has answered it is not known who listens
        self._wait(partial(self.commands.__contains__, stamp + self.period), 'no command came',
                   again=None if row else say)
        if self.replaced:
            self._wait(lambda: self.heard >= row, 'the replacer said nothing')
        return self.commands.pop(stamp + self.period)

    def _lies(self, row: int) -> bool:
        sizes = dict(zip(self.graph.sensors, np.abs(self.truth[row])))
        return any(sizes[name] > most for name, most in self.story.fallen.items())

    def _wait(self, done: Callable[[], bool], trouble: str,
              again: Callable[[], None] | None = None) -> None:
        """Hear what comes until it is done; do something again until then. Raise Failed."""
        begun = repeated = time.monotonic()
        self._hear()
        while not done():
            for process in self.processes:
                process.check()
            now = time.monotonic()
            if now > begun + PATIENCE:
                logs = ' and '.join(str(process.log) for process in self.processes)
                raise Failed(f'{trouble} for {PATIENCE:g} s, see {logs}')
            if again is not None and now > repeated + AGAIN:
                repeated = now
                again()
            self.waiting.wait(LOOK)
            self._hear()

    def _hear(self) -> None:
        """Take what has come."""
        graph = self.graph
        for message, _ in take_all(graph.command):
            values = [port.field.get(message) for port in graph.motors]
            self.commands[get_stamp(message)] = [v for v in values if isinstance(v, float)]
        for message, _ in take_all(graph.output):
            value, row = graph.port.field.get(message), self._row(get_stamp(message))
            if row is None:
                continue
            self.heard = max(self.heard, row)
            if isinstance(value, float) and math.isfinite(value):
                self.told[row] = value
                if self.latency is None and self.isolated is not None \
                        and row >= self.story.step(self.story.isolated_at):
                    self.latency = time.monotonic() - self.isolated
        for message, _ in take_all(graph.status):
            self.heeded = any(channel.name == graph.failed and channel.source != 'real'
                              for channel in read_status(message).channels)
        for message, _ in take_all(graph.estimates):
            row = self._row(get_stamp(message))
            for channel in read_status(message).channels:
                if channel.name == graph.failed and row is not None:
                    self.deviation[row] = channel.number('deviation')

    def _row(self, stamp: int) -> int | None:
        """Return the period that begins at a stamp, if any does."""
        row, rest = divmod(stamp - ORIGIN, self.period)
        return row if rest == 0 and 0 <= row < len(self.told) else None
