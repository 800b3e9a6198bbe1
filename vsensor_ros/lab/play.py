"""What the player does on the graph: a table of readings and commands as ROS messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import sys
import time

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

from vsensor_ros.bad_input import BadInput
from vsensor_ros.lab.domain import open_nodes
from vsensor_ros.lab.parameter_file import read_parameters
from vsensor_ros.lab.played_driver import drivers_of
from vsensor_ros.lab.wiring import Port, wiring_of
from vsensor_ros.simulate.fault import Recorded
from vsensor_ros.simulate.table import read_table

LATE = 0.05             # s on the wall; what is played later than this is another machine
LATE_CODE = 3           # the exit status that says so
CLOCK_STEP = 0.005      # s on the wall between two messages on /clock
START_TOPIC = '/player/start'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def to_stamp(nanoseconds: int) -> Time:
    """Return a time as ROS writes it."""
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def play(node: Node, channels: dict[str, Recorded], ports: dict[str, Port], speed: float,
         simulated: bool = False) -> float:
    """
    Publish every row at its time, once every topic has a listener; return the worst delay [s].

    Stamps are the wall clock's time of the start, said on START_TOPIC, plus the time in the
    table. Time is on /clock, too, if it is `simulated`, and with a `speed` other than 1: there it
    runs that much faster than the wall's.
    """
    drivers = drivers_of(node, (ports[name] for name in channels))
    plays = [[channels[port.name] for port in driver.ports] for driver in drivers]
    # a message goes out when any of its channels speaks; the silent ones are NaN in it
    due = [np.any([channel.sent for channel in each], axis=0) for each in plays]
    start_topic = node.create_publisher(Time, START_TOPIC, LATCHED)
    clock = node.create_publisher(Clock, '/clock', 10) if simulated or speed != 1.0 else None
    complained = time.monotonic() + 10.0
    while deaf := [d for d in drivers if not d.heard]:
        if time.monotonic() > complained:
            node.get_logger().warning(f'nobody listens to {deaf[0].topic} yet')
            complained += 10.0
        time.sleep(0.01)

    times = next(iter(channels.values())).time
    node.get_logger().info(f'playing {times[-1] - times[0]:g} s, {speed:g} times real time')
    wall, origin = time.monotonic(), time.time_ns()
    start_topic.publish(to_stamp(origin))
    late = 0.0
    for row, elapsed in enumerate(times - times[0]):
        when = wall + elapsed / speed
        while (left := when - time.monotonic()) > 0.0:
            time.sleep(min(left, CLOCK_STEP))
            if clock:
                passed = min(time.monotonic() - wall, elapsed / speed) * speed
                clock.publish(Clock(clock=to_stamp(origin + int(passed * 1e9))))
        late = max(late, -left)
        stamp = origin + round(elapsed * 1e9)
        if clock:
            clock.publish(Clock(clock=to_stamp(stamp)))
        for driver, each, at in zip(drivers, plays, due):
            if at[row]:
                driver.send([c.value[row] if c.sent[row] else np.nan for c in each], stamp)
    time.sleep(0.2)     # let the last messages leave
    return late


def play_table(table: Path, params_file: Path, speed: float, ros_args: Sequence[str]) -> int:
    """Play a table on the topics of a replacer; return the exit status. Raise BadInput."""
    channels = read_table(table)
    parameters = read_parameters(params_file, ros_args)
    ports = wiring_of(parameters).ports
    for name in channels:
        if name not in ports:
            raise BadInput(table, name, f'has no topic in {params_file}',
                           'name the columns as the sensors and commands there')
    with open_nodes('player', ros_args=parameters.ros_args) as (node,):
        late = play(node, channels, ports, speed, parameters.simulated)
    if late > LATE:
        print(f'player: {late:.2f} s late at worst: this machine is too busy', file=sys.stderr)
        return LATE_CODE
    return 0
