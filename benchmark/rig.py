"""
Processes around one listener: the drivers, and in the middle the relay or the replacer.

All latencies end at the time that DDS stamps on a message as it comes in, so the listener may
look when it likes. That clock is the system's, as are the drivers' stamps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
from functools import cache
import os
from pathlib import Path
import sys
import tempfile
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile

from benchmark.load import COMMAND_TOPIC, Load, TIMER_TOPIC
from vsensor_ros import design, Plant
from vsensor_ros.lab.domain import (
    by_hand,
    open_nodes,
    reserved_domain,
    stay_on_this_computer,
)
from vsensor_ros.lab.process import Failed, Process
from vsensor_ros.node.private_rclpy import take_all
from vsensor_ros.observers import Design

PERIOD = 0.01  # s, of the virtual sensors
READY_WITHIN = 30.0  # s
SPEED = 40.0  # 1/s, of the tanks: such that their virtual sensors are warm after SETTLE
SETTLE = 1.0  # s between the first messages and the first that counts
ISOLATION_TOPIC = '/benchmark/isolation'


class Heard(NamedTuple):
    """One message as it came in."""

    topic: int
    stamp: int  # ns
    sent: int  # ns, by the process in the middle, as its middleware says
    received: int  # ns
    replaced: bool


class Rig:
    """Drivers that publish all the time, a listener, and room for one process in between."""

    def __init__(self, load: Load, rate: float, node: Node, work: Path, domain: int) -> None:
        self.load, self.rate, self.work, self.domain = load, rate, work, domain
        self.apart: list[int] = []  # sensors of which none's virtual sensor reads another
        self.processes: list[Process] = []
        self._outputs = [node.create_subscription(
            load.kind, topic, by_hand, QoSProfile(depth=1000), raw=True)
            for topic in (*load.outputs, TIMER_TOPIC)]
        self._isolation = node.create_publisher(DiagnosticArray, ISOLATION_TOPIC, 10)

    def relay(self) -> _Running:
        """Run the bare relay, in a with-statement."""
        return self._serve('the relay', ['benchmark.relay', *self.load.text()])

    def replacer(self) -> _Running:
        """Run the replacer, in a with-statement."""
        return self._serve('the replacer', [
            'vsensor_ros.command.replacer', '--ros-args', '--params-file',
            str(self.work / 'replacer.yaml')])

    @contextmanager
    def timer(self) -> Iterator[Process]:
        """Run the bare timer at the replacer's rate; it is the topic after the last."""
        arguments = ['benchmark.timer', str(self.rate), *self.load.text()]
        with self.run('the timer', arguments) as timer:
            self.wait(lambda heard: any(h.topic == self.load.topics for h in heard),
                      'the timer to tick')
            yield timer

    @contextmanager
    def run(self, name: str, arguments: list[str], ends: bool = False) -> Iterator[Process]:
        """Run a module as a process, dead at the end; ends: by itself before, as it should."""
        log = self.work / f'{name.replace(" ", "_")}.log'
        with Process(name, arguments, self.domain, log) as process:
            watched = [] if ends else [process]
            self.processes += watched
            try:
                yield process
            finally:
                for each in watched:
                    self.processes.remove(each)

    @contextmanager
    def _serve(self, name: str, arguments: list[str]) -> Iterator[Process]:
        """Run a process in the middle, and yield it when it passes all topics on."""
        with self.run(name, arguments) as process:
            seen: set[int] = set()

            def all_seen(heard: list[Heard]) -> bool:
                seen.update(h.topic for h in heard)
                return len(seen) == self.load.topics
            self.wait(all_seen, f'{name} to pass on every topic')
            self.listen(SETTLE)
            yield process
        self.take()  # what it sent last

    def take(self) -> list[Heard]:
        """Return what has come in since the last time."""
        heard = []
        for i, output in enumerate(self._outputs):
            for raw, info in take_all(output, raw=True):
                stamp, replaced = self.load.read(raw)
                heard.append(Heard(i, stamp, info['source_timestamp'],
                                   info['received_timestamp'], replaced))
        return heard

    def listen(self, seconds: float) -> list[Heard]:
        """Return what comes in meanwhile."""
        heard, end = self.take(), time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            time.sleep(min(left, 0.05))
            heard += self.take()
            for process in self.processes:
                process.check()
        return heard

    def wait(self, done: Callable[[list[Heard]], bool], what: str,
             seconds: float = READY_WITHIN) -> None:
        """Hand over what comes in until told that it is done; raise Failed when that is never."""
        end = time.monotonic() + seconds
        while not done(self.take()):
            for process in self.processes:
                process.check()
            if time.monotonic() > end:
                raise Failed(f'waited {seconds:g} s in vain for {what}')
            time.sleep(0.002)

    def isolate(self, sensor: int, faulty: bool) -> int:
        """Say that a sensor has failed or is well again; return the time [ns] just before."""
        level = DiagnosticStatus.ERROR if faulty else DiagnosticStatus.OK
        message = DiagnosticArray(status=[DiagnosticStatus(name=f'y{sensor + 1}', level=level)])
        at = time.time_ns()
        self._isolation.publish(message)
        return at


_Running = Any  # what contextlib makes of Rig._serve


@contextmanager
def set_up(load: Load, rate: float = 1.0 / PERIOD) -> Iterator[Rig]:
    """Start the drivers and the listener in a ROS domain of their own; rate of the bank [Hz]."""
    stay_on_this_computer()
    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    with ExitStack() as stack:
        work = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='benchmark_')))
        domain = stack.enter_context(reserved_domain())
        [node] = stack.enter_context(open_nodes('listener', domain=domain))
        rig = Rig(load, rate, node, work, domain)
        rig.apart = _write_parameters(load, rate, work)
        stack.enter_context(rig.run('the drivers', ['benchmark.load', *load.text()]))
        yield rig


def row_of_tanks(tanks: int) -> Plant:
    """
    Return a row of tanks; each flow is the root of a difference of levels.

    A long row is linear: the designer would take minutes.
    """
    n = tanks
    G = np.eye(n) - np.eye(n, k=1)  # differences of levels
    P = SPEED * (np.eye(n, k=-1) - np.eye(n))  # a flow leaves one tank and enters the next
    B = SPEED * np.eye(n)[:, :1]
    if n > 10:
        return Plant.from_matrices(P @ G, B, np.eye(n), name='row_of_tanks')
    return Plant.from_matrices(
        P @ G, B, np.eye(n), P=P, G=list(G),
        nonlinearities=['sqrt(w1) - w1'] * n, initial=np.arange(n, 0.0, -1.0), name='row_of_tanks')


def _write_parameters(load: Load, rate: float, work: Path) -> list[int]:
    """Write the design and the parameters; return sensors that may fail by turns."""
    made = _designed(load.topics)
    made.save(work / 'design.json')
    lines = ['replacer:', '  ros__parameters:', f'    design_file: {work / "design.json"}',
             f'    rate: {rate}', '    isolation:', f'      topic: {ISOLATION_TOPIC}',
             '    recovery:', '      dwell: 0.0', '    commands:',
             f'      u1: {{topic: {COMMAND_TOPIC}, type: std_msgs/msg/Float64, field: data}}',
             '    sensors:']
    lines += [f'      y{i + 1}: {{topic: {topic}, type: sensor_msgs/msg/{load.message}, '
              f'field: "{load.field}"}}' for i, topic in enumerate(load.outputs)]
    (work / 'replacer.yaml').write_text('\n'.join(lines) + '\n', encoding='utf-8')
    apart: list[int] = []
    read: set[str] = set()
    for i, name in enumerate(made.sensors):
        reads = getattr(made[(name,), name], 'reads', None)
        if reads is not None and name not in read and \
                not {made.sensors[j] for j in apart} & set(reads):
            apart.append(i)
            read.update(reads)
    return apart


@cache
def _designed(tanks: int) -> Design:
    return design(row_of_tanks(tanks))
