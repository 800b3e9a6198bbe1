"""What comes in: from messages to events of the engine, and on to the outputs."""

from __future__ import annotations

import traceback

from vsensor_ros.engine import Engine, Forward
from vsensor_ros.node.endpoints import Command
from vsensor_ros.node.inlet import Inlet
from vsensor_ros.node.log import Log
from vsensor_ros.node.polling import DEPTH
from vsensor_ros.node.topics import Topic
from vsensor_ros.reason import Reason

UNREADABLE = Reason('unreadable')


def take_readings(topic: Topic, inlet: Inlet, engine: Engine, log: Log) -> int:
    """Take what has arrived on a topic; return how many messages."""
    take, kind, count = inlet.take, topic.kind, 0
    while count < DEPTH and (taken := take(kind, True)) is not None:
        count += 1
        try:
            _hear(topic, engine, taken[0], taken[1]['received_timestamp'])
        except Exception as error:  # nothing that is wrong with one message ends the others
            name = topic.sensors[0].name
            engine.count(name, Reason.of('mistake', error=type(error).__name__))
            log.say(traceback.format_exc(), subject=(name, type(error)))
    return count


def _hear(topic: Topic, engine: Engine, raw: bytes, received: int) -> None:
    """Send a message on, then give what it says to the engine."""
    reading = topic.reader.read(raw)
    if reading is None:
        engine.unreadable(topic.index)
        return
    related = None
    if reading.foreign and (
            templates := engine.failed_templates(topic.index)) is not None:
        related = topic.related(raw, templates)
    verdict = engine.judge(topic.index, reading, raw, related)
    if verdict.__class__ is Forward:
        try:
            topic.forward(raw, reading, verdict)
        except RuntimeError as error:
            engine.count(topic.sensors[0].name, not_sent(error))
    engine.learn(topic.index, reading, received)


def take_commands(command: Command, inlet: Inlet, engine: Engine) -> int:
    """Take the commands that have arrived; return how many messages."""
    take, read, kind, count = inlet.take, inlet.reader.read, command.kind, 0
    while count < DEPTH and (taken := take(kind, True)) is not None:
        count += 1
        reading, received = read(taken[0]), taken[1]['received_timestamp']
        if reading is None:
            engine.command(command.name, UNREADABLE, None, received)
        else:
            engine.command(command.name, reading.values[0], reading.stamp, received)
    return count


def not_sent(error: RuntimeError) -> Reason:
    """Return the reason that the middleware (RCLError) gives for not sending a message."""
    return Reason.of('not sent', text=str(error).partition(', at ')[0])
