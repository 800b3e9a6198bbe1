"""What comes in: from messages to the bank, and on to the streams. Times are in ns."""

from __future__ import annotations

import traceback

from rclpy.subscription import Subscription

from vsensor_ros.bank import Bank
from vsensor_ros.engine.channel import Channel
from vsensor_ros.engine.clock import NodeClock
from vsensor_ros.node.cdr import Reader
from vsensor_ros.node.log import Log
from vsensor_ros.node.parameters import Command
from vsensor_ros.node.polling import DEPTH
from vsensor_ros.node.reports import UNREADABLE
from vsensor_ros.node.topics import Stream

SLOW = 3  # intervals longer than max_age in a row that make a slow sensor of a silent one


class Intake:
    """Takes readings and commands. What is not used is counted, by channel and reason."""

    def __init__(self, bank: Bank, clock: NodeClock, log: Log) -> None:
        self.held: dict[str, float] = {}  # by sensor: the last value worth holding
        self._bank, self._clock, self._log = bank, clock, log
        self._last: dict[str, int] = {}  # by sensor: its last stamp
        self._long: dict[str, int] = {}  # by sensor: long intervals in a row
        self._slow: set[str] = set()  # sensors that were said to be

    def forget(self) -> None:
        """Begin anew after the clock jumped."""
        self._last.clear()
        self._long.clear()

    def take_readings(self, stream: Stream) -> int:
        """Take what has arrived on a stream; return how many messages."""
        take, kind, count = stream.subscription.handle.take_message, stream.kind, 0
        while count < DEPTH and (taken := take(kind, True)) is not None:
            count += 1
            try:
                self._hear(stream, taken[0], taken[1]['received_timestamp'])
            except Exception as error:  # nothing that is wrong with one message ends the others
                self._log.count(stream.names[0],
                                f'a mistake of this node ({type(error).__name__})')
                self._log.say(traceback.format_exc(), subject=(stream.names, type(error)))
        return count

    def take_commands(self, command: Command, reader: Reader, subscription: Subscription) -> int:
        """Take what has arrived of a command; return how many messages."""
        take, kind, count = subscription.handle.take_message, command.kind, 0
        while count < DEPTH and (taken := take(kind, True)) is not None:
            count += 1
            reading = reader.read(taken[0])
            value = UNREADABLE if reading is None else reading.values[0]
            if reading is None or isinstance(value, str):
                self._log.count(command.name, str(value))
                continue
            stamp = reading.stamp or self._unstamped(taken[1]['received_timestamp'])
            if stamp:
                reason = self._bank.take(command.name, stamp, value, self._clock.now)
                if reason is not None:
                    self._log.count(command.name, str(reason))
        return count

    def _hear(self, stream: Stream, raw: bytes, received: int) -> None:
        """Send a message on, then give what it says to the bank."""
        reading = stream.reader.read(raw)
        if reading is None:
            stream.lacks(UNREADABLE, self._clock.now)
            self._log.count(stream.names[0], UNREADABLE)
            return
        try:
            problem = stream.accept(raw, reading)
        except RuntimeError as error:  # RCLError
            problem = 'not sent: ' + str(error).partition(', at ')[0]
        if problem is not None:
            self._log.count(stream.names[0], problem)
        stamp = reading.stamp or self._unstamped(received)
        for channel, value in zip(stream.channels, reading.values):
            if value.__class__ is float:
                channel.readings += 1
                if stamp:
                    self._feed(channel, stamp, value)
            elif not reading.foreign and not (
                    value in stream.absent and stream.fresh(channel.name, self._clock.now)):
                self._log.count(channel.name, str(value))  # no other driver sends it, either

    def _unstamped(self, received: int) -> int:
        """Return the time that counts for a message without a stamp; 0: time has not begun."""
        return self._clock.now if self._clock.simulated else received

    def _feed(self, channel: Channel, stamp: int, value: float) -> None:
        name = channel.name
        reason = self._bank.take(name, stamp, value, self._clock.now)
        if reason is None:
            self.held[name] = value
            before, self._last[name] = self._last.get(name, stamp), stamp
            if stamp - before > channel.max_age:
                self._time(channel, stamp - before)
            elif name in self._long:
                del self._long[name]
        elif reason.code != 'isolated':  # what it says then is not worth a word
            self._log.count(name, str(reason))

    def _time(self, channel: Channel, interval: int) -> None:
        """Say once when a sensor is slower than the silence that makes it invalid."""
        name = channel.name
        self._long[name] = self._long.get(name, 0) + 1
        if self._long[name] == SLOW and name not in self._slow:
            self._slow.add(name)
            self._log.say(
                f'{name}: its readings are {interval * 1e-9:.3g} s apart, so between them it '
                f'counts as silent after {channel.max_age * 1e-9:.3g} s; raise max_age',
                'warning')
