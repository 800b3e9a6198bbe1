"""
The replacer's parameters: declared with types, ranges and descriptions, and checked all at once.

The names below ``sensors`` and ``commands`` are those of the design file, so the design is loaded
here, first. Every problem is found before any is reported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import difflib
from itertools import pairwise
import math
from pathlib import Path
import stat
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import Accessor, compile_accessor, message_type
from vsensor_ros.virtual_sensor import Design

WITHOUT_ESTIMATE = ('stop', 'hold', 'nan', 'pass')
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
TEXT = 'std_msgs/msg/String'
PARAMETERS = 'ros__parameters'  # the key in a parameter file below which they stand
LARGEST_FILE = 2**20  # bytes of a parameter file
ROS_OWN = ('use_sim_time', 'start_type_description_service')
RESERVED = {'/diagnostics': DIAGNOSTICS, '/rosout': 'rcl_interfaces/msg/Log',
            '/parameter_events': 'rcl_interfaces/msg/ParameterEvent'}


class Refused(ValueError):
    """Parameters that the replacer cannot start with: one line each problem."""

    def __init__(self, problems: Sequence[BadInput]) -> None:
        super().__init__('\n'.join(str(problem) for problem in problems))
        self.problems = tuple(problems)


@dataclass(frozen=True)
class Sensor:
    """Where a sensor's readings come from and where its channel goes out."""

    name: str
    input: str  # resolved topic of the driver
    output: str  # resolved topic that the others listen to
    type: str
    kind: Any  # the message class
    accessor: Accessor


@dataclass(frozen=True)
class Command:
    """Where a plant input's commands are heard."""

    name: str
    topic: str
    type: str
    kind: Any
    accessor: Accessor


@dataclass(frozen=True)
class Settings:
    """All that the replacer was told, checked."""

    design: Design
    rate: float  # Hz
    max_age: float  # s
    without_estimate: str
    isolation_topic: str
    isolation_type: str
    sensors: tuple[Sensor, ...]  # in the design's order
    commands: tuple[Command, ...]


@dataclass(frozen=True)
class _Known:
    """One parameter there is."""

    type: type
    default: Any  # None: must be given
    description: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()


_GENERAL = {
    'design_file': _Known(str, None, 'design file, written by the designer'),
    'rate': _Known(float, 100.0, 'rate of the virtual sensors [Hz]', 0.001, 1000.0),
    'max_age': _Known(float, 0.5, 'age from which a reading is silence [s]', 0.001, 86400.0),
    'without_estimate': _Known(
        str, 'stop', 'what goes out for a failed sensor that no virtual sensor replaces: '
        'stop (nothing), hold (the last value), nan, pass (the failed reading)',
        choices=WITHOUT_ESTIMATE),
    'isolation.topic': _Known(str, '/isolation', 'topic that says which sensors are faulty'),
    'isolation.type': _Known(str, DIAGNOSTICS, 'its message type', choices=(DIAGNOSTICS, TEXT)),
}


def check_files(arguments: Sequence[str]) -> list[str]:
    """
    Look through the parameter files named on a ROS command line before rcl reads them.

    rcl keeps one of two entries of the same name in silence and reports the rest with a location
    in its own sources. Returns the names of the nodes that the files are for. Raises Refused.
    """
    problems = []
    nodes: dict[str, None] = {}
    for flag, path in pairwise(arguments):
        if flag != '--params-file':
            continue
        try:
            status = Path(path).stat()
            size = status.st_size
            if not stat.S_ISREG(status.st_mode):
                problems.append(BadInput(path, 'parameter file', 'is not a regular file',
                                         'name a YAML file'))
                continue
            if size > LARGEST_FILE:
                problems.append(BadInput(path, 'parameter file', f'has {size} bytes',
                                         f'at most {LARGEST_FILE} are read'))
                continue
            with open(path, encoding='utf-8') as file:
                root = yaml.compose(file, Loader=yaml.SafeLoader)
        except OSError as error:
            problems.append(BadInput(path, 'parameter file', f'cannot be read ({error.strerror})',
                                     'name a file that exists'))
        except UnicodeDecodeError:
            problems.append(BadInput(path, 'parameter file', 'is not a text file',
                                     'name a YAML file'))
        except RecursionError:
            problems.append(BadInput(path, 'parameter file', 'is nested beyond reason',
                                     'name a YAML file of parameters'))
        except yaml.YAMLError as error:
            mark = getattr(error, 'problem_mark', None)
            problem = ' '.join(str(getattr(error, 'problem', None) or error).split())
            problems.append(BadInput(path, f'line {mark.line + 1}' if mark else 'parameter file',
                                     f'is not YAML ({problem})', 'mend the file'))
        else:
            found = _check_tree(root, path)
            problems.extend(found)
            nodes.update(dict.fromkeys(() if found else _nodes(root)))
    if problems:
        raise Refused(problems)
    return list(nodes)


def check_addressed(node: Node, nodes: Sequence[str]) -> None:
    """Raise Refused when there are parameter files, for these nodes, but none for this one."""
    if nodes and not set(node.get_parameters_by_prefix('')) - set(ROS_OWN):
        name = node.get_fully_qualified_name()
        raise Refused([BadInput(name, 'parameter file', f'is for {", ".join(nodes)}; it has '
                                f'nothing for {name}', f'begin it with {node.get_name()}:')])


def _check_tree(root: yaml.Node | None, path: str) -> list[BadInput]:
    """Find names that stand there twice, values that are missing, and what rcl cannot read."""
    problems: list[BadInput] = []
    visited: set[int] = set()
    leaves: set[str] = set()

    def complain(key: str, problem: str, mend: str) -> None:
        problems.append(BadInput(path, key or 'parameter file', problem, mend))

    def walk(node: yaml.Node | None, place: str) -> None:
        if id(node) in visited:
            complain(place, 'is an alias, which ROS does not read', 'write it out')
            return
        visited.add(id(node))
        if isinstance(node, yaml.MappingNode):
            seen: set[str] = set()
            for key, value in node.value:
                if not isinstance(key, yaml.ScalarNode):
                    complain(place, f'has a key that is no name (line {key.start_mark.line + 1})',
                             'give names to values')
                    continue
                where = f'{place}.{key.value}' if place else key.value
                if key.value in seen or where in leaves:
                    complain(where, f'stands there twice (line {key.start_mark.line + 1})',
                             'leave one out')
                else:
                    seen.add(key.value)
                    walk(value, where)
            return
        leaves.add(place)
        if node is None or node.value == [] or node.tag.endswith(':null'):
            complain(place, 'has no value', 'give it one, or leave the line out')
        elif f'.{PARAMETERS}.' not in f'.{place}.':
            if not problems:  # the first will do
                complain(place, f'does not stand below {PARAMETERS}',
                         f'begin with the name of the node, and below it {PARAMETERS}')
        elif isinstance(node, yaml.SequenceNode) and (
                len({item.tag for item in node.value}) > 1
                or not isinstance(node.value[0], yaml.ScalarNode)):
            complain(place, 'is a list of other things than values of one type',
                     'give numbers, or texts')

    walk(root, '')
    return problems


def _nodes(root: yaml.Node | None, place: str = '') -> Iterator[str]:
    """Yield the names of the nodes that a parameter file is for."""
    for key, value in root.value if isinstance(root, yaml.MappingNode) else ():
        if key.value == PARAMETERS:
            yield place
        else:
            yield from _nodes(value, f'{place}/{key.value}' if place else key.value)


def read(node: Node) -> Settings:
    """
    Check the node's parameters, declare them with their descriptions, and load the design.

    The node must declare parameters from its overrides by itself. Raises Refused.
    """
    where = node.get_fully_qualified_name()
    given = {name: parameter.value for name, parameter in node.get_parameters_by_prefix('').items()
             if name not in ROS_OWN}
    problems: list[BadInput] = []
    sim_time = node.get_parameter('use_sim_time').value
    if not isinstance(sim_time, bool):
        problems.append(BadInput(where, 'use_sim_time', f'{sim_time!r:.80} is neither true nor '
                                 'false', 'give one of them'))

    known = dict(_GENERAL)
    values = _check(known, given, where, problems)
    design = None
    if 'design_file' in values:
        try:
            design = Design.load(_regular(values['design_file']))
        except BadInput as problem:
            problems.append(problem)
    if design is not None:
        # without the design the names of the sensors are not known, nor what is missing
        named = _named_parameters(design)
        values.update(_check(named, given, where, problems))
        known.update(named)
        for name in given:
            if name not in known:
                near = difflib.get_close_matches(name, known, 1)
                problems.append(BadInput(where, name, 'there is no such parameter',
                                         f'did you mean {near[0]}?' if near else 'leave it out'))
    sensors, commands = [], []
    if design is not None:
        sensors = _sensors(design, values, node, where, problems)
        commands = _commands(design, values, node, where, problems)
        problems.extend(_crossed(sensors, where))
    isolation = _resolve(node, values.get('isolation.topic'), where, 'isolation.topic', problems)
    reserved = {**RESERVED, **({'/clock': 'rosgraph_msgs/msg/Clock'} if sim_time else {})}
    problems.extend(_two_types(
        sensors, commands, isolation, values.get('isolation.type'), where, reserved))
    if problems:
        raise Refused(problems)
    assert design is not None and isolation is not None

    for name, entry in known.items():
        if name in values:
            _declare(node, name, entry, values[name])
    return Settings(design, values['rate'], values['max_age'], values['without_estimate'],
                    isolation, values['isolation.type'], tuple(sensors), tuple(commands))


def _regular(path: str) -> str:
    if Path(path).exists() and not Path(path).is_file():  # reading a pipe would never end
        raise BadInput(path, 'design file', 'is not a regular file',
                       'name the file that the designer wrote')
    return path


def _named_parameters(design: Design) -> dict[str, _Known]:
    known: dict[str, _Known] = {}
    for name in design.sensors:
        known[f'sensors.{name}.topic'] = _Known(str, None, f'topic on which {name} goes out')
        known[f'sensors.{name}.type'] = _Known(str, None, f'message type of {name}')
        known[f'sensors.{name}.field'] = _Known(str, None, f'field of the message that is {name}')
        known[f'sensors.{name}.input'] = _Known(
            str, '', f'topic on which the driver of {name} publishes; default: the topic + _raw')
    for name in design.inputs:
        known[f'commands.{name}.topic'] = _Known(str, None, f'topic on which {name} is commanded')
        known[f'commands.{name}.type'] = _Known(str, None, f'message type of {name}')
        known[f'commands.{name}.field'] = _Known(str, None, f'field of the message that is {name}')
    return known


def _check(known: Mapping[str, _Known], given: Mapping[str, Any], where: str,
           problems: list[BadInput]) -> dict[str, Any]:
    """Return the values that are right; append a problem for each that is not."""
    values = {}
    for name, entry in known.items():
        value = given.get(name, entry.default)
        if entry.type is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)  # `rate: 100` is as good as 100.0
        if value is None:
            problems.append(BadInput(where, name, 'is missing', f'give the {entry.description}'))
        elif not isinstance(value, entry.type):
            problems.append(BadInput(
                where, name, f'{value!r:.80} is not a {_TYPES[entry.type]}',
                f'give the {entry.description}'))
        elif isinstance(value, float) and not entry.low <= value <= entry.high:
            problems.append(BadInput(where, name, f'{value:g} is out of range',
                                     f'choose from {entry.low:g} to {entry.high:g}'))
        elif entry.choices and value not in entry.choices:
            problems.append(BadInput(where, name, f'{value!r:.80} is not a choice',
                                     f'choose from {", ".join(entry.choices)}'))
        elif name in given and value == '':
            problems.append(BadInput(where, name, 'is empty', f'give the {entry.description}'))
        else:
            values[name] = value
    return values


_TYPES = {str: 'text', float: 'number'}


def _declare(node: Node, name: str, entry: _Known, value: Any) -> None:
    """Declare a parameter anew, now with its description; values are fixed while running."""
    limits = []
    if entry.type is float:
        limits = [FloatingPointRange(from_value=entry.low, to_value=entry.high)]
    choices = f'one of {", ".join(entry.choices)}' if entry.choices else ''
    descriptor = ParameterDescriptor(
        description=entry.description, read_only=True, additional_constraints=choices,
        floating_point_range=limits)
    if node.has_parameter(name):
        node.undeclare_parameter(name)
    node.declare_parameter(name, value, descriptor, ignore_override=True)


def _resolve(node: Node, topic: str | None, where: str, key: str,
             problems: list[BadInput]) -> str | None:
    if topic is None:
        return None
    try:
        return node.resolve_topic_name(topic)
    except (InvalidTopicNameException, RuntimeError, ValueError):
        problems.append(BadInput(where, key, f'{topic!r:.80} is not a topic name',
                                 'write it like /tank/level2'))
        return None


def _field(values: Mapping[str, Any], prefix: str, where: str,
           problems: list[BadInput]) -> tuple[Any, Accessor] | None:
    kind_name, path = values.get(f'{prefix}.type'), values.get(f'{prefix}.field')
    if kind_name is None:
        return None
    try:
        kind = message_type(kind_name, where, f'{prefix}.type')
        if path is None:
            return None
        return kind, compile_accessor(kind, path, where, f'{prefix}.field')
    except BadInput as problem:
        problems.append(problem)
        return None


def _sensors(design: Design, values: Mapping[str, Any], node: Node, where: str,
             problems: list[BadInput]) -> list[Sensor]:
    sensors = []
    for name in design.sensors:
        prefix = f'sensors.{name}'
        field = _field(values, prefix, where, problems)
        topic = values.get(f'{prefix}.topic')
        output = _resolve(node, topic, where, f'{prefix}.topic', problems)
        given = values.get(f'{prefix}.input') or (f'{topic}_raw' if output else None)
        source = _resolve(node, given, where, f'{prefix}.input', problems)
        if source is not None and source == output:
            problems.append(BadInput(where, f'{prefix}.input', f'{source} is also the output',
                                     'remap the driver, to the topic + _raw say'))
        elif field is not None and source is not None and output is not None:
            sensors.append(Sensor(name, source, output, values[f'{prefix}.type'], *field))
    return sensors


def _commands(design: Design, values: Mapping[str, Any], node: Node, where: str,
              problems: list[BadInput]) -> list[Command]:
    commands = []
    for name in design.inputs:
        prefix = f'commands.{name}'
        field = _field(values, prefix, where, problems)
        topic = _resolve(node, values.get(f'{prefix}.topic'), where, f'{prefix}.topic', problems)
        if field is not None and topic is not None:
            commands.append(Command(name, topic, values[f'{prefix}.type'], *field))
    return commands


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
            elif a.input == b.input and a.accessor.path == b.accessor.path:
                problems.append(BadInput(where, f'{key}.field', f'is that of {b.name} too',
                                         'give each sensor its own field'))
    return problems


def _two_types(sensors: Sequence[Sensor], commands: Sequence[Command], isolation: str | None,
               isolation_type: str | None, where: str,
               reserved: Mapping[str, str]) -> list[BadInput]:
    """Find topics that were given with two types; the first one counts."""
    types: dict[str | None, tuple[str, str | None]] = {
        topic: ('ROS', kind) for topic, kind in reserved.items()}
    problems = []
    for topic, kind, key in (
            *((s.input, s.type, f'sensors.{s.name}.type') for s in sensors),
            *((s.output, s.type, f'sensors.{s.name}.type') for s in sensors),
            *((c.topic, c.type, f'commands.{c.name}.type') for c in commands),
            (isolation, isolation_type, 'isolation.type')):
        first_key, first = types.setdefault(topic, (key, kind))
        if kind != first and key != first_key:
            problems.append(BadInput(where, key, f'is {kind}, but {topic} carries {first} '
                                     f'according to {first_key}', 'a topic has one type'))
    return problems
