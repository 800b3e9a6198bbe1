"""The topics that the parameters name, and whether they go together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
import re
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import Accessor, compile_accessor
from vsensor_ros.node.disowned import heed_marks
from vsensor_ros.node.field_path import message_type
from vsensor_ros.node.known import DIAGNOSTICS, USE
from vsensor_ros.node.orientation import TURNING
from vsensor_ros.node.qos import DIAGNOSTICS_TOPIC, ESTIMATES, ISOLATION, STATUS
from vsensor_ros.node.stamp import compile_stamps, Stamp
from vsensor_ros.observers import Design

LONGEST_TOPIC = 247  # characters; rmw takes no more
ROS_TOPICS = {'/rosout': 'rcl_interfaces/msg/Log',
              '/parameter_events': 'rcl_interfaces/msg/ParameterEvent'}


@dataclass(frozen=True)
class Sensor:
    """Where a sensor's readings come from and where its channel goes out."""

    name: str
    input: str  # resolved topic of the driver
    output: str  # resolved topic that the others listen to
    type: str
    kind: Any  # the message class
    accessor: Accessor
    stamps: tuple[Stamp, ...]  # where a message has its time; the first counts
    publisher: str  # full name of the node whose messages alone count; '': any


@dataclass(frozen=True)
class Command:
    """Where a plant input's commands are heard."""

    name: str
    topic: str
    type: str
    kind: Any
    accessor: Accessor
    stamps: tuple[Stamp, ...]
    publisher: str  # full name of the node whose messages alone count; '': any


@dataclass(frozen=True)
class Endpoints:
    """All topics that parameters name, but those that were not understood."""

    sensors: tuple[Sensor, ...]
    commands: tuple[Command, ...]
    isolation: str | None

    def ends(self, node: Node) -> list[tuple[str, str]]:
        """Return each resolved topic with what the node opens on it."""
        topics = [*((s.input, 'subscription') for s in self.sensors),
                  *((s.output, 'publisher') for s in self.sensors),
                  *((c.topic, 'subscription') for c in self.commands),
                  *((node.resolve_topic_name(topic), 'publisher')
                    for topic in (DIAGNOSTICS_TOPIC, STATUS, ESTIMATES, ISOLATION))]
        if self.isolation is not None:
            topics.append((self.isolation, 'subscription'))
        return list(dict.fromkeys(topics))


def find_endpoints(design: Design | None, values: Mapping[str, Any], node: Node, where: str,
                   sim_time: bool, problems: list[BadInput], speaks: bool = True) -> Endpoints:
    """
    Resolve the topics that the values name; append a problem for each that will not do.

    speaks: whether the node publishes where the sensors go out.
    """
    def resolve(topic: str | None, key: str) -> str | None:
        return None if topic is None else _resolve(node, topic, where, key, problems)

    sensors, commands = [], []
    for name in design.sensors if design else ():
        prefix = f'sensors.{name}'
        field = find_field(values, prefix, where, problems)
        publisher = _publisher(values, prefix, node, where, problems)
        topic = values.get(f'{prefix}.topic')
        output = resolve(topic, f'{prefix}.topic')
        source = resolve(values.get(f'{prefix}.input') or (f'{topic}_raw' if output else None),
                         f'{prefix}.input')
        if speaks and source is not None and source == output:
            problems.append(BadInput(where, f'{prefix}.input', f'{source} is also the output',
                                     'remap the driver, to the topic + _raw say'))
        elif field is not None and source is not None and output is not None:
            sensors.append(Sensor(name, source, output, *field, publisher))
    for name in design.inputs if design else ():
        prefix = f'commands.{name}'
        field = find_field(values, prefix, where, problems)
        publisher = _publisher(values, prefix, node, where, problems)
        topic = resolve(values.get(f'{prefix}.topic'), f'{prefix}.topic')
        if field is not None and topic is not None:
            commands.append(Command(name, topic, *field, publisher))
    isolation = resolve(values.get('isolation.topic'), 'isolation.topic')
    own = [node.resolve_topic_name(topic) for topic in (STATUS, ESTIMATES, ISOLATION)]
    if speaks and isolation in own:
        problems.append(BadInput(where, 'isolation.topic', f'{isolation} is what this node says',
                                 'name the topic of whoever finds the faults'))
    if speaks:
        problems.extend(_crossed(sensors, where))
    outputs = {sensor.output: sensor.name for sensor in sensors}
    for command in commands:
        if speaks and command.topic in outputs:  # an estimate would come back as what led to it
            problems.append(BadInput(
                where, f'commands.{command.name}.topic', f'{command.topic} is where '
                f'{outputs[command.topic]} goes out', 'name the topic of whoever commands'))
    reserved = {**ROS_TOPICS, **dict.fromkeys([DIAGNOSTICS_TOPIC, *own], DIAGNOSTICS),
                **({'/clock': 'rosgraph_msgs/msg/Clock'} if sim_time else {})}
    found = Endpoints(tuple(sensors), tuple(commands), isolation)
    problems.extend(_two_types(found, values.get('isolation.type'), where, reserved))
    return found


def with_turns(design: Design, sensors: Sequence[Sensor], where: str,
               problems: list[BadInput]) -> Design:
    """
    Return the design with roll and yaw wrapping, where the plant does not say that they do.

    Appends a problem for one that the plant has in another unit.
    """
    turns = {name: abs(turn) for angles in design.wrap for name, turn in angles.items()}
    for sensor in sensors:
        if sensor.accessor.steps[-1].angle not in TURNING:
            continue
        if not math.isclose(turns.get(sensor.name, math.tau), math.tau, rel_tol=1e-6):
            problems.append(BadInput(
                where, f'sensors.{sensor.name}.field', f'{sensor.accessor.path} is in rad, but in '
                f'the plant a turn of {sensor.name} is {turns[sensor.name]:g}',
                'write the plant in rad, with wrap: 2*pi'))
        elif sensor.name not in turns:
            design = replace(design, wrap=(*design.wrap, {sensor.name: math.tau}))
    return design


def _resolve(node: Node, topic: str, where: str, key: str,
             problems: list[BadInput]) -> str | None:
    try:
        return str(node.resolve_topic_name(topic))
    except (InvalidTopicNameException, RuntimeError, ValueError):
        mend = 'write it like /tank/level2'
        if len(topic) > LONGEST_TOPIC:
            mend += f', with at most {LONGEST_TOPIC} characters'
        problems.append(BadInput(where, key, f'{topic!r:.80} is not a topic name', mend))
        return None


def find_field(values: Mapping[str, Any], prefix: str, where: str,
               problems: list[BadInput],
               ) -> tuple[str, Any, Accessor, tuple[Stamp, ...]] | None:
    """Return type, class, field and stamps of a sensor or command; append what is wrong."""
    kind_name, path = values.get(f'{prefix}.type'), values.get(f'{prefix}.field')
    if kind_name is None:
        return None
    try:
        kind = message_type(kind_name, where, f'{prefix}.type')
        stamps = compile_stamps(kind, values.get(f'{prefix}.stamp') or '',
                                values.get(f'{prefix}.stamp_unit') or '', where, f'{prefix}.stamp')
        if path is None:
            return None
        accessor = compile_accessor(kind, path, where, f'{prefix}.field')
        if values.get(f'{prefix}.disowned') != USE:
            accessor = heed_marks(accessor)
        return kind_name, kind, accessor, stamps
    except BadInput as problem:
        problems.append(problem)
        return None


def _publisher(values: Mapping[str, Any], prefix: str, node: Node, where: str,
               problems: list[BadInput]) -> str:
    """Return the full name of the node that was chosen to be heard; '': any."""
    given = values.get(f'{prefix}.publisher', '')
    name = given if not given or given.startswith('/') else \
        f'{node.get_namespace().rstrip("/")}/{given}'
    if name and not re.fullmatch(r'(/[A-Za-z_]\w*)+', name, re.ASCII):
        problems.append(BadInput(where, f'{prefix}.publisher', f'{given!r:.80} is not the name of '
                                 'a node', 'write it like /robot/driver'))
    return name


def _crossed(sensors: Sequence[Sensor], where: str) -> list[BadInput]:
    """Find pairs of sensors whose topics do not go together. Sharing both topics is right."""
    problems = []
    for i, a in enumerate(sensors):
        for b in sensors[:i]:
            key = f'sensors.{a.name}'
            if a.input == b.output or a.output == b.input:
                problems.append(BadInput(
                    where, f'{key}.topic', f'the output of one of {b.name}, {a.name} is the '
                    'input of the other', 'give each its own topics'))
            elif (a.input == b.input) != (a.output == b.output):
                problems.append(BadInput(
                    where, f'{key}.topic', f'shares one topic with {b.name} but not the other',
                    'sensors in one message share input and output'))
            elif a.input == b.input and a.accessor.steps == b.accessor.steps:
                problems.append(BadInput(where, f'{key}.field', f'is that of {b.name} too',
                                         'give each sensor its own field'))
            elif a.input == b.input and a.kind is b.kind and _times(a) != _times(b):
                problems.append(BadInput(where, f'{key}.stamp', f'is not that of {b.name}, which '
                                         'comes in the same message', 'give both the same'))
    return problems


def _times(sensor: Sensor) -> list[tuple[str, int | None]]:
    return [(stamp.path, stamp.unit) for stamp in sensor.stamps]


def _two_types(found: Endpoints, isolation_type: str | None, where: str,
               reserved: Mapping[str, str]) -> list[BadInput]:
    """Find topics that were given with two types; the first one counts."""
    types: dict[str | None, tuple[str, str | None]] = {
        topic: ('ROS', kind) for topic, kind in reserved.items()}
    problems = []
    for topic, kind, key in (
            *((s.input, s.type, f'sensors.{s.name}.type') for s in found.sensors),
            *((s.output, s.type, f'sensors.{s.name}.type') for s in found.sensors),
            *((c.topic, c.type, f'commands.{c.name}.type') for c in found.commands),
            (found.isolation, isolation_type, 'isolation.type')):
        first_key, first = types.setdefault(topic, (key, kind))
        if kind != first and key != first_key:
            problems.append(BadInput(where, key, f'is {kind}, but {topic} carries {first} '
                                     f'according to {first_key}', 'a topic has one type'))
    return problems
