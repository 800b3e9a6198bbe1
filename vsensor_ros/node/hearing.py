"""What a node hears of the machine: its sensors and commands, on their way into an engine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from rclpy.node import Node
from rclpy.subscription import Subscription

from vsensor_ros.bad_input import BadInput
from vsensor_ros.engine import Engine, Setup
from vsensor_ros.isolator import Settings as IsolatorSettings
from vsensor_ros.node.cdr import Reader
from vsensor_ros.node.endpoints import Command, Sensor
from vsensor_ros.node.inlet import Inlet
from vsensor_ros.node.intake import take_commands, take_readings
from vsensor_ros.node.log import Log
from vsensor_ros.node.parameters import Refused, Settings
from vsensor_ros.node.polling import LISTEN, Polled, subscribe
from vsensor_ros.node.topics import Topic


@dataclass(frozen=True)
class Hearing:
    """The ways in, and what takes all that has come by each: it returns how many messages."""

    inlets: tuple[Inlet, ...]
    takers: tuple[tuple[Subscription, Callable[[], int]], ...]


def start_engine(node: Node, settings: Settings, topics: Sequence[Topic], simulated: bool,
                 isolator: IsolatorSettings | None) -> Engine:
    """Make the engine that the parameters describe; raises Refused."""
    try:
        return Engine(Setup(
            settings.design, settings.rate, settings.max_age, settings.jump_ahead,
            tuple(topic.plan for topic in topics), simulated, settings.live,
            settings.command_ends, settings.guard, isolator))
    except BadInput as error:
        raise Refused([BadInput(node.get_fully_qualified_name(), error.key,
                                error.problem, error.mend)]) from None


def hear(node: Node, group: Polled, topics: Sequence[Topic], commands: Sequence[Command],
         engine: Engine, log: Log) -> Hearing:
    """Open what is not open yet, and let all that comes go into the engine."""
    inlets: list[Inlet] = []
    takers: list[tuple[Subscription, Callable[[], int]]] = []

    def inlet(subscription: Subscription, reader: Reader,
              sources: Sequence[Sensor | Command]) -> Inlet:
        inlets.append(Inlet(node, subscription, reader, sources,
                            partial(engine.leave_out, sources[0].name)))
        return inlets[-1]

    for topic in topics:
        way = inlet(topic.subscription, topic.reader, topic.sensors)
        takers.append((topic.subscription, partial(take_readings, topic, way, engine, log)))
    for command in commands:
        subscription = subscribe(node, group, command.kind, command.topic, LISTEN)
        way = inlet(subscription, Reader(command.kind, [command.accessor], command.stamps),
                    [command])
        takers.append((subscription, partial(take_commands, command, way, engine)))
    return Hearing(tuple(inlets), tuple(takers))
