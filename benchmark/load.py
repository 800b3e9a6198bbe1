"""
The messages that pass through the relay and the replacer, and the process that publishes them.

A driver's message carries its stamp twice: in the header, and as a mark in its last field, which
nobody on the way touches. So a listener knows a replaced message by a stamp that is not the mark.
The last digits of the stamp (16 us) count the messages of a topic, so that it sees which are lost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import signal
import struct
import sys
from threading import Event
import time
from typing import Any

import rclpy
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Float64

JOINTS = 30
COMMAND_TOPIC = '/benchmark/u1'
TIMER_TOPIC = '/benchmark/timer'
COMMAND_RATE = 20.0  # Hz
COUNTED = 2**14  # messages of a topic, then the count begins anew
STAMP = struct.Struct('<iI')  # after the four bytes that begin every serialized message
MARKS = {'JointState': struct.Struct('<d'), 'Range': struct.Struct('<f')}  # effort[29], variance
KINDS = {'JointState': JointState, 'Range': Range}


@dataclass(frozen=True)
class Load:
    """Topics that each carry messages of one type at one rate; sensor i is y1, y2, .."""

    message: str = 'JointState'  # or Range
    topics: int = 10
    rate: float = 100.0  # Hz, of each topic
    burst: int = 1  # messages of a topic that come at once

    @property
    def kind(self) -> Any:
        """The message class."""
        return KINDS[self.message]

    @property
    def field(self) -> str:
        """The field that is the sensor's reading."""
        return 'position[joint_7]' if self.message == 'JointState' else 'range'

    @property
    def outputs(self) -> list[str]:
        """The topics that the replacer serves; the drivers' end in _raw."""
        return [f'/benchmark/y{i + 1}' for i in range(self.topics)]

    def text(self) -> list[str]:
        """Return what `parse` reads, for a command line."""
        return [self.message, str(self.topics), str(self.rate), str(self.burst)]

    @classmethod
    def parse(cls, text: list[str]) -> Load:
        """Read back what `text` wrote."""
        return cls(text[0], int(text[1]), float(text[2]), int(text[3]))

    def message_of(self, reading: float) -> Any:
        """Return a message with this reading."""
        if self.message == 'Range':
            message = Range(range=reading, max_range=100.0)
        else:
            message = JointState(
                name=[f'joint_{j}' for j in range(JOINTS)], position=[reading] * JOINTS,
                velocity=[0.0] * JOINTS, effort=[0.0] * JOINTS)
        message.header.frame_id = 'base'
        return message

    def template(self, reading: float) -> bytearray:
        """Return a serialized message with this reading."""
        return bytearray(serialize_message(self.message_of(reading)))

    def sign(self, message: bytearray, stamp: int, count: int) -> None:
        """Write the stamp [ns] with the count, and its mark, into a serialized message."""
        mark = MARKS[self.message]
        stamp += count % COUNTED - stamp % COUNTED
        STAMP.pack_into(message, 4, *divmod(stamp, 10**9))
        mark.pack_into(message, len(message) - mark.size, stamp % 2**24)

    def read(self, message: bytes) -> tuple[int, bool]:
        """Return the stamp [ns] of a serialized message, and whether it is a replaced one."""
        mark = MARKS[self.message]
        seconds, nanoseconds = STAMP.unpack_from(message, 4)
        stamp = seconds * 10**9 + nanoseconds
        return stamp, mark.unpack_from(message, len(message) - mark.size)[0] != stamp % 2**24


def publish(load: Load, stop: Callable[[], bool]) -> None:
    """Publish at the load's rate, the topics one after the other, as unrelated drivers would."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('driver')
    # the levels of a row of tanks in equilibrium, which is what the design is for
    streams = [(node.create_publisher(load.kind, f'{topic}_raw', 10),
                load.template(float(load.topics - i)))
               for i, topic in enumerate(load.outputs)]
    command = node.create_publisher(Float64, COMMAND_TOPIC, 10)
    gap = load.burst / (load.rate * load.topics)
    due, turn = time.monotonic(), 0
    commanded = due
    while not stop():
        publisher, message = streams[turn % load.topics]
        first = turn // load.topics * load.burst
        for count in range(first, first + load.burst):
            load.sign(message, time.time_ns(), count)
            publisher.publish(bytes(message))
        if due >= commanded:
            command.publish(Float64(data=1.0))
            commanded += 1.0 / COMMAND_RATE
        turn += 1
        due += gap
        time.sleep(max(0.0, due - time.monotonic()))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    _stop = Event()
    for _number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(_number, lambda *_: _stop.set())
    publish(Load.parse(sys.argv[1:]), _stop.is_set)
