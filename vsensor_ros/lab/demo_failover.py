"""One failover over real topics: a replacer, a machine that is played, an isolator, a listener."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
import ctypes
from dataclasses import dataclass
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from vsensor_ros.command.player import LATE_CODE
from vsensor_ros.lab.play import LATCHED, START_TOPIC, to_stamp
from vsensor_ros.lab.screen import read_status, Told
from vsensor_ros.lab.wiring import read_wiring, Wiring
from vsensor_ros.node.accessor import get_stamp, has_stamp
from vsensor_ros.simulate.judge import Heard
from vsensor_ros.simulate.scenario import Scenario
from vsensor_ros.simulate.table import write_table

READY_WITHIN = 30.0     # s; discovery takes 0.1 s idle, some seconds on a busy machine
POLL = 0.0005           # s between looks at the topics; bounds the error of the latency
DOMAIN_PORT = 27400     # TCP port held while domain 1, 2, .. is in use; the tests hold the same

_libc = ctypes.CDLL(None) if sys.platform == 'linux' else None


class Failed(RuntimeError):
    """A run that could not be finished; str() is one line."""


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


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Yield a ROS domain that no other demo or test on this machine uses meanwhile."""
    for domain in range(1, 101):
        with socket.socket() as held:
            try:
                held.bind(('127.0.0.1', DOMAIN_PORT + domain))
            except OSError:
                continue
            yield domain
            return
    raise Failed('all ROS domains from 1 to 100 are in use on this machine')


def fail_over(scenario: Scenario, config: Path, design_file: Path, work: Path,
              progress: Callable[[Moment], None]) -> Run:
    """
    Run a scenario in real processes; return what was heard on the failed sensor's topic.

    `config` is the system's folder, `work` an existing folder for the table and the logs, whose
    names begin with that of the system. Raise Failed.
    """
    wiring = read_wiring(config / 'replacer.yaml')
    table = work / f'{config.name}.table.csv'
    write_table(table, scenario.channels)
    clock = ['-p', 'use_sim_time:=true'] if scenario.speed != 1.0 else []
    with ExitStack() as stack:
        domain = stack.enter_context(reserved_domain())
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        profile = config.parent / 'fastdds_localhost.xml'
        if profile.is_file():   # discovery is quicker with it
            os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))
        replacer = stack.enter_context(_process(
            'the replacer', work / f'{config.name}.replacer.log', domain, [
                'vsensor_ros.command.replacer', '--ros-args', '--params-file',
                str(config / 'replacer.yaml'), '-p', f'design_file:={design_file}', *clock]))
        node = stack.enter_context(_node(domain))
        listener = _Listener(node, wiring, scenario)
        _wait(listener.ready, [replacer])
        # the player begins by itself once the replacer hears every topic
        player = stack.enter_context(_process(
            'the player', work / f'{config.name}.player.log', domain, [
                'vsensor_ros.command.player', str(table), str(config / 'replacer.yaml'),
                '--speed', str(scenario.speed)]))
        _wait(listener.started, [replacer, player])
        heard = listener.listen([replacer, player], progress)
        try:
            in_time = player.popen.wait(5.0) != LATE_CODE
        except subprocess.TimeoutExpired:
            in_time = False
        return Run(heard, in_time, listener.step, np.array(listener.deviation).reshape(-1, 2))


class _Listener:
    """The isolator and the second subscriber; polled, so that the latency is not an executor's."""

    def __init__(self, node: Node, wiring: Wiring, scenario: Scenario) -> None:
        self.scenario = scenario
        self.port = wiring.ports[scenario.failed_sensor]
        if not has_stamp(self.port.kind):
            raise Failed(f'{self.port.output} has no stamps to compare with the truth')
        self.output = node.create_subscription(self.port.kind, self.port.output, _ignore,
                                               QoSProfile(depth=1000))
        self.start = node.create_subscription(Time, START_TOPIC, _ignore, LATCHED)
        self.status = node.create_subscription(DiagnosticArray, '/replacer/status', _ignore,
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
        for message in _take(self.start):
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

    def note(self, told: Told, now: float) -> None:
        """Note what the replacer says of the estimates that go out for the failed sensor."""
        for channel in told.channels:
            if channel.name == self.scenario.failed_sensor and channel.source == 'virtual':
                self.step = channel.number('last_step')
                self.deviation.append((now, channel.number('deviation')))

    def listen(self, processes: list[_Process],
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
                self.isolate()
            for message in _take(self.output):
                value = self.port.field.get(message)
                if isinstance(value, float):
                    stamp = scenario.start + 1e-9 * (get_stamp(message) - self.origin)
                    self.heard.append((stamp, value, time.monotonic()))
            for message in _take(self.status):
                self.note(read_status(message), now)
            if wall - shown > 0.1:
                shown = wall
                value = self.heard[-1][1] if self.heard else np.nan
                progress(Moment(min(now, scenario.end), value, isolated is not None))
                for process in processes:
                    process.check()
            time.sleep(POLL)
        time_, value_, arrival = np.array(self.heard).reshape(-1, 3).T
        return Heard(time_, value_, arrival - (isolated or np.inf))


def _ignore(message: Any) -> None:
    """No executor runs here; messages are taken by hand."""


def _take(subscription: Any) -> Iterator[Any]:
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, False)):
            yield taken[0]


@dataclass(frozen=True)
class _Process:
    """A child of ours."""

    name: str
    popen: subprocess.Popen[bytes]
    log: Path

    def check(self) -> None:
        """Raise Failed if it has died; the player ends by itself."""
        if self.popen.poll() not in (None, 0, LATE_CODE):
            said = self.log.read_text(errors='replace').strip().splitlines()
            raise Failed(f'{self.name} ended with {self.popen.returncode}: '
                         f'{said[-1] if said else "it said nothing"} ({self.log})')


def _wait(ready: Callable[[], bool], processes: list[_Process]) -> None:
    """Wait for the last of the processes."""
    deadline = time.monotonic() + READY_WITHIN
    while not ready():
        for process in processes:
            process.check()
        if time.monotonic() > deadline:
            raise Failed(f'{processes[-1].name} was not ready after {READY_WITHIN:g} s, '
                         f'see {processes[-1].log}')
        time.sleep(0.01)


@contextmanager
def _process(name: str, log: Path, domain: int, arguments: list[str]) -> Iterator[_Process]:
    """Run a module of ours as a process, dead at the end whatever happens."""
    root = str(Path(__file__).parents[2])
    paths = [root, *filter(None, [os.environ.get('PYTHONPATH')])]
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain),
                   'PYTHONPATH': os.pathsep.join(paths), 'ROS_LOG_DIR': str(log.parent / 'log')}
    with open(log, 'wb') as file:
        popen = subprocess.Popen([sys.executable, '-m', *arguments], env=environment,
                                 stdin=subprocess.DEVNULL, stdout=file, stderr=file,
                                 preexec_fn=_die_with_parent)
    try:
        yield _Process(name, popen, log)
    finally:
        popen.terminate()
        try:
            popen.wait(5.0)
        except subprocess.TimeoutExpired:
            popen.kill()
            popen.wait()


def _die_with_parent() -> None:
    """Have Linux kill this process when the demo is killed and cannot do it any more."""
    if _libc:
        _libc.prctl(1, signal.SIGKILL)


@contextmanager
def _node(domain: int) -> Iterator[Node]:
    context = Context()
    # Ctrl-C stays Python's, so that the processes are ended in order
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('demo', context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
