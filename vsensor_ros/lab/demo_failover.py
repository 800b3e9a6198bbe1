"""One failover over real topics: a replacer, a machine that is played, an isolator, a listener."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
import subprocess
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile

from vsensor_ros.lab.domain import (
    by_hand,
    open_nodes,
    reserved_domain,
    stay_on_this_computer,
)
from vsensor_ros.lab.parameter_file import read_parameters
from vsensor_ros.lab.play import LATCHED, LATE_CODE, START_TOPIC, to_stamp
from vsensor_ros.lab.process import Failed, Process
from vsensor_ros.lab.screen import read_status, StatusMessage
from vsensor_ros.lab.wiring import Wiring, wiring_of
from vsensor_ros.node.accessor import get_stamp, has_stamp
from vsensor_ros.node.private_rclpy import take_all
from vsensor_ros.simulate.judge import Heard
from vsensor_ros.simulate.scenario import Scenario
from vsensor_ros.simulate.table import write_table

READY_WITHIN = 30.0     # s; discovery takes 0.1 s idle, some seconds on a busy machine
POLL = 0.0005           # s between looks at the topics; bounds the error of the latency


@dataclass(frozen=True)
class Moment:
    """Where a run is: its time, the last value heard (NaN: none yet), whether it is replaced."""

    time: float
    value: float
    isolated: bool


@dataclass(frozen=True, eq=False)
class Run:
    """
    A failover that is over.

    `in_time` tells whether the machine was played in time. If not (this computer was too busy),
    commands without a stamp took effect later than in the truth. `step` is the replacer's own
    word on its switch (NaN: none), `deviation` on its estimates: rows of time, standard deviation.
    """

    heard: Heard
    in_time: bool
    step: float
    deviation: NDArray[np.float64]


def fail_over(scenario: Scenario, config: Path, design_file: Path, work: Path,
              progress: Callable[[Moment], None]) -> Run:
    """
    Run a scenario in real processes; return what was heard on the failed sensor's topic.

    `config` is the system's folder, `work` an existing folder for the table and the logs, whose
    names begin with that of the system. Raise Failed.
    """
    parameters = read_parameters(config / 'replacer.yaml')
    wiring = wiring_of(parameters)
    table = work / f'{config.name}.table.csv'
    write_table(table, scenario.channels)
    changed: dict[str, object] = {'design_file': str(design_file)}
    if scenario.alone:
        changed |= {'isolator.mode': 'act', 'isolator.record': 'none'}
    if scenario.speed != 1.0:
        changed['use_sim_time'] = True
    with ExitStack() as stack:
        domain = stack.enter_context(reserved_domain())
        stay_on_this_computer()

        def run(name: str, *arguments: str) -> Process:
            log = work / f'{config.name}.{name.split()[-1]}.log'
            log.unlink(missing_ok=True)
            return stack.enter_context(Process(name, arguments, domain, log))

        replacer = run('the replacer', 'vsensor_ros.command.replacer',
                       *parameters.command_line(work / f'{config.name}.changed.yaml', **changed))
        [node] = stack.enter_context(open_nodes('demo', domain=domain,
                                                ros_args=parameters.ros_args))
        listener = _Listener(node, wiring, scenario, parameters.node)
        _wait(listener.ready, [replacer])
        # the player begins by itself once the replacer hears every topic
        player = run('the player', 'vsensor_ros.command.player', str(table),
                     str(config / 'replacer.yaml'), '--speed', str(scenario.speed))
        _wait(listener.started, [replacer, player])
        heard = listener.listen([replacer, player], progress)
        try:
            in_time = player.popen.wait(5.0) != LATE_CODE
        except subprocess.TimeoutExpired:
            in_time = False
        return Run(heard, in_time, listener.step, np.array(listener.deviation).reshape(-1, 2))


class _Listener:
    """The isolator and the second subscriber; polled, so that the latency is not an executor's."""

    def __init__(self, node: Node, wiring: Wiring, scenario: Scenario, replacer: str) -> None:
        self.scenario = scenario
        self.port = wiring.ports[scenario.failed_sensor]
        if not has_stamp(self.port.kind):
            raise Failed(f'{self.port.output} has no stamps to compare with the truth')
        self.output = node.create_subscription(self.port.kind, self.port.output, by_hand,
                                               QoSProfile(depth=1000))
        self.start = node.create_subscription(Time, START_TOPIC, by_hand, LATCHED)
        self.status = node.create_subscription(DiagnosticArray, f'{replacer}/status', by_hand,
                                               LATCHED)
        self.isolation = node.create_publisher(wiring.isolation_kind, wiring.isolation, 10)
        self.node = node
        self.origin = 0     # ns, the stamp of the table's first row
        self.began = 0.0    # s, the wall's monotonic time of it
        self.heard: list[tuple[float, float, float]] = []
        self.step = np.nan
        self.deviation: list[tuple[float, float]] = []

    def ready(self) -> bool:
        return (self.isolation.get_subscription_count() > 0
                and self.node.count_publishers(self.port.output) > 0)

    def started(self) -> bool:
        for message, _ in take_all(self.start):
            self.origin = message.sec * 10**9 + message.nanosec
            self.began = time.monotonic() - 1e-9 * (time.time_ns() - self.origin)
            return True
        return False

    def isolate(self) -> None:
        name = self.scenario.failed_sensor
        if isinstance(message := self.isolation.msg_type(), DiagnosticArray):
            message.header.stamp = to_stamp(time.time_ns())
            message.status = [DiagnosticStatus(name=name, level=DiagnosticStatus.ERROR,
                                               message='frozen')]
        else:
            message.data = name
        self.isolation.publish(message)

    def note(self, told: StatusMessage, now: float) -> None:
        """Note what the replacer says of the estimates that go out for the failed sensor."""
        for channel in told.channels:
            if channel.name == self.scenario.failed_sensor and channel.source == 'virtual':
                self.step = channel.number('last_step')
                self.deviation.append((now, channel.number('deviation')))

    def listen(self, processes: list[Process],
               progress: Callable[[Moment], None]) -> Heard:
        scenario = self.scenario
        isolated: float | None = None
        shown, now = 0.0, scenario.start
        end = scenario.end + 0.1 * scenario.speed
        while now < end:
            wall = time.monotonic()
            now = scenario.start + (wall - self.began) * scenario.speed
            if isolated is None and now >= scenario.isolated_at:
                isolated = time.monotonic()
                if not scenario.alone:
                    self.isolate()
            for message, _ in take_all(self.output):
                value = self.port.field.get(message)
                if isinstance(value, float):
                    stamp = scenario.start + 1e-9 * (get_stamp(message) - self.origin)
                    self.heard.append((stamp, value, time.monotonic()))
            for message, _ in take_all(self.status):
                self.note(read_status(message), now)
            if wall - shown > 0.1:
                shown = wall
                value = self.heard[-1][1] if self.heard else np.nan
                known = bool(self.deviation) if scenario.alone else isolated is not None
                progress(Moment(min(now, scenario.end), value, known))
                for process in processes:
                    process.check(0, LATE_CODE)
            time.sleep(POLL)
        time_, value_, arrival = np.array(self.heard).reshape(-1, 3).T
        return Heard(time_, value_, arrival - (isolated or np.inf))


def _wait(ready: Callable[[], bool], processes: list[Process]) -> None:
    """Wait for the last of the processes."""
    deadline = time.monotonic() + READY_WITHIN
    while not ready():
        for process in processes:
            process.check(0, LATE_CODE)
        if time.monotonic() > deadline:
            raise Failed(f'{processes[-1].name} was not ready after {READY_WITHIN:g} s, '
                         f'see {processes[-1].log}')
        time.sleep(0.01)
