"""
The replacer's parameters: checked all at once, then declared, and watched while the node runs.

The names below ``sensors`` and ``commands`` are those of the design file, so the design is loaded
here, first. Every problem is found before any is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
import difflib
from hashlib import sha256
import math
import os
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import End
from vsensor_ros.engine import Live, Policy, Setup, StreamPlan
from vsensor_ros.engine.isolation_names import Names, Wrong
from vsensor_ros.isolator import Settings as IsolatorSettings
from vsensor_ros.node.endpoints import (
    Command,
    Endpoints,
    find_endpoints,
    Sensor,
    with_turns,
)
from vsensor_ros.node.known import AUTO, DIAGNOSTICS, GENERAL, Known, named, OVERRIDES, Refused
from vsensor_ros.node.orientation import TURNING
from vsensor_ros.node.parameter_file import (
    Block,
    check_addressed,
    check_files,
    for_others,
    ROS_OWN,
    source_of,
)
from vsensor_ros.node.qos import QOS, qos_parameters
from vsensor_ros.observers import Design
from vsensor_ros.text_file import looked_in

__all__ = ['DIAGNOSTICS', 'Block', 'Command', 'Refused', 'Sensor', 'Settings', 'check_addressed',
           'check_files', 'read', 'watch']

LONGEST_NAME = 100  # characters of a sensor's name, which services have in theirs
LARGEST_NUMBER = 1000  # of sensors and commands: each is a topic or two, and a dozen parameters
MOST_LISTED = 10  # of what can be wrong without end: names that there are not, and answers
LEAVE_OUT = 'leave it out'
JUMP = 10  # periods that a clock may jump ahead at least


@dataclass(frozen=True)
class Settings:
    """All that the replacer was told, checked."""

    design: Design
    rate: float  # Hz
    max_age: Mapping[str, float]  # s, by sensor
    jump_ahead: float  # s; a clock that jumps further ahead starts the virtual sensors anew
    autostart: bool
    isolation_topic: str
    isolation_type: str
    isolation_names: Names
    sensors: tuple[Sensor, ...]  # in the design's order
    commands: tuple[Command, ...]
    live: Live
    command_ends: Mapping[str, End]  # of those that do not hold for ever
    guard: Mapping[str, float]  # s, by sensor
    isolator: IsolatorSettings
    isolator_record: str  # path, auto or none
    design_hash: str  # of the file
    for_others: tuple[str, ...] = ()  # parameters that were given to all nodes of the robot


def read(node: Node, blocks: Sequence[Block] = (), speaks: bool = True) -> Settings:
    """
    Check the node's parameters and load the design; the node stays as it is.

    The node must declare parameters from its overrides by itself. blocks: where these come from;
    of what is given otherwise, none may be unknown. speaks: the node replaces sensors; one that
    does not may listen where they go out. Raises Refused.
    """
    where = node.get_fully_qualified_name()
    given = {name: parameter.value for name, parameter in node.get_parameters_by_prefix('').items()
             if name not in ROS_OWN and not _declared_with_topic(node, name)}
    problems: list[BadInput] = []
    sim_time = node.get_parameter('use_sim_time').value
    if not isinstance(sim_time, bool):
        problems.append(BadInput(where, 'use_sim_time', f'{sim_time!r:.80} is neither true nor '
                                 'false', 'give one of them'))
    known = dict(GENERAL)
    values = _check(known, given, where, problems)
    design, design_hash = None, ''
    try:
        if 'design_file' in values:
            path = _find(values['design_file'], source_of('design_file', blocks, where))
            design, design_hash = _load(path), sha256(Path(path).read_bytes()).hexdigest()
    except BadInput as problem:
        problems.append(problem)
    if design is not None:
        # without the design the names of the sensors are not known, nor what is missing
        values.update(_check(named(design), given, where, problems))
        known.update(named(design))
    names = _names(design, values, where, problems)
    endpoints = find_endpoints(design, values, node, where, sim_time is True, problems, speaks)
    others: list[str] = []
    if design is not None:
        design = with_turns(design, endpoints.sensors, where, problems)
        quality = qos_parameters(endpoints.ends(node))
        known.update(quality)
        _check({name: quality[name] for name in given if name in quality}, given, where, problems)
        unknown = [name for name in given if name not in known]
        others = for_others(unknown, blocks, where, {'design_file', *named(design)})
        problems.extend(_unknown(  # nor is a quality judged while topics are not known
            [name for name in unknown if name not in others
             and not (problems and name.startswith(f'{QOS}.'))], known, where,
            f'leave it out; if it is for others, write {where}: above what is for this node'
            if any(block.for_all for block in blocks) else LEAVE_OUT))
    if problems:
        raise Refused(problems)
    assert design is not None and endpoints.isolation is not None and names is not None
    return Settings(
        design, values['rate'], {s: _own(values, s, 'max_age') for s in design.sensors},
        max(values['max_jump'], JUMP / values['rate']), values['autostart'],
        endpoints.isolation, values['isolation.type'], names, endpoints.sensors,
        endpoints.commands, _live(design, values), _command_ends(design, values),
        {s: values[f'sensors.{s}.guard'] for s in design.sensors}, _isolator(design, values),
        values['isolator.record'], design_hash, tuple(others))


def setup_of(design: Design, given: Mapping[str, Any], where: object) -> Setup:
    """
    Return what parameters, by dotted name, tell the engine of a design, on a simulated clock.

    That is for who plays recordings, without a graph. Raises BadInput.
    """
    problems: list[BadInput] = []
    values = _check({**GENERAL, **named(design)}, given, str(where), problems)
    if problems:
        raise problems[0]
    sharing: dict[str, list[str]] = {}
    turning = set()
    for s in design.sensors:
        topic = values[f'sensors.{s}.topic']
        sharing.setdefault(values[f'sensors.{s}.input'] or f'{topic}_raw', []).append(s)
        if values[f'sensors.{s}.field'].startswith(tuple(f'{angle}(' for angle in TURNING)) \
                and not any(s in angles for angles in design.wrap):
            turning.add(s)
    if turning:
        design = replace(design, wrap=(*design.wrap, *({s: math.tau} for s in turning)))
    isolator: IsolatorSettings | None = _isolator(design, values)
    if values['isolator.mode'] == 'advise' and (
            design.isolability is None or not design.isolability.residuals):
        isolator = None
    return Setup(
        design, values['rate'], {s: _own(values, s, 'max_age') for s in design.sensors},
        max(values['max_jump'], JUMP / values['rate']),
        tuple(StreamPlan(tuple(names), source, values[f'sensors.{names[0]}.topic'], True)
              for source, names in sharing.items()),
        True, _live(design, values), _command_ends(design, values),
        {s: values[f'sensors.{s}.guard'] for s in design.sensors}, isolator)


def watch(node: Node, settings: Settings, apply: Callable[[Live], None]) -> Callable[[], None]:
    """
    Declare the parameters of a node whose topics are open, and answer whoever sets them.

    Those that may change are checked, all of a list or none, and what comes of them is given to
    `apply`, in the thread that sets them; the others are refused with a reason. Returns what ends
    the watch. What was declared as fixed is so for good: rclpy cannot take that back.
    """
    endpoints = Endpoints(settings.sensors, settings.commands, settings.isolation_topic)
    known = {**GENERAL, **named(settings.design), **qos_parameters(endpoints.ends(node))}
    for name, entry in known.items():
        _declare(node, name, entry)
    live = {name: entry for name, entry in known.items() if entry.live}

    def refusal(parameters: Sequence[Parameter]) -> str:
        problems, unknown = [], []
        for parameter in parameters:
            name = parameter.name
            if name in live:
                try:
                    live[name].check(parameter.value, '', name)
                except BadInput as problem:
                    problems.append(problem)
            elif name in known or name in ROS_OWN:
                problems.append(BadInput('', name, 'is fixed while the node runs',
                                         'change it in the file and restart'))
            elif not node.has_parameter(name):
                unknown.append(name)
        problems = [*problems[:MOST_LISTED], *_unknown(unknown, known, '')]
        return ' | '.join(str(problem) for problem in problems)

    def convert(parameters: list[Parameter]) -> list[Parameter]:
        """Make numbers of whole ones: `ros2 param set ... 1` is as good as 1.0."""
        return [Parameter(p.name, value=float(p.value))
                if p.name in live and live[p.name].type is float and type(p.value) is int else p
                for p in parameters]

    def check(parameters: list[Parameter]) -> SetParametersResult:
        reason = refusal([p for p in parameters if p.name in live])  # others are being declared
        return SetParametersResult(successful=not reason, reason=reason)

    def take(parameters: list[Parameter]) -> None:
        if any(p.name in live for p in parameters):
            apply(_live(settings.design, {name: node.get_parameter(name).value for name in live}))

    def set_atomically(parameters: list[Parameter]) -> SetParametersResult:
        reason = refusal(parameters)
        if reason:
            return SetParametersResult(successful=False, reason=reason)
        return type(node).set_parameters_atomically(node, parameters)

    node.add_pre_set_parameters_callback(convert)
    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(take)
    # What the services call. rclpy refuses fixed and unknown ones before it asks any callback,
    # and names neither the reason nor, of unknown ones, the parameter.
    node.set_parameters_atomically = set_atomically

    def unwatch() -> None:
        node.remove_pre_set_parameters_callback(convert)
        node.remove_on_set_parameters_callback(check)
        node.remove_post_set_parameters_callback(take)
        del node.set_parameters_atomically
    return unwatch


def _find(given: str, beside: str) -> str:
    """
    Return the path of the design file; raise BadInput where another was meant.

    Relative paths begin in the working directory. beside: the parameter file that gives it, or ''.
    """
    path = os.path.expanduser(given)
    there = os.path.join(os.path.dirname(os.path.abspath(beside)), path) if beside else path
    if not os.path.exists(path) and os.path.exists(there):
        raise BadInput(given, 'design file', f'lies beside {beside}{looked_in(path)}',
                       f'write design_file: {there}')
    return path


def _load(path: str) -> Design:
    if Path(path).exists() and not Path(path).is_file():  # reading a pipe would never end
        raise BadInput(path, 'design file', 'is not a regular file',
                       'name the file that the designer wrote')
    design = Design.load(path)
    names = (*design.sensors, *design.inputs)
    if len(names) > LARGEST_NUMBER:
        raise BadInput(path, 'plant', f'has {len(names)} sensors and commands',
                       f'at most {LARGEST_NUMBER} are served')
    for name in names:
        if len(name) > LONGEST_NAME:
            raise BadInput(path, name, f'is a name of {len(name)} characters',
                           f'choose one of at most {LONGEST_NAME}')
    return design


def _check(known: Mapping[str, Known], given: Mapping[str, Any], where: str,
           problems: list[BadInput]) -> dict[str, Any]:
    """Return the values that are right; append a problem for each that is not."""
    values = {}
    for name, entry in known.items():
        try:
            values[name] = entry.check(given.get(name, entry.default), where, name)
        except BadInput as problem:
            problems.append(problem)
    return values


def _unknown(names: Sequence[str], known: Iterable[str], where: str,
             mend: str = LEAVE_OUT) -> list[BadInput]:
    problems = []
    for name in names[:MOST_LISTED]:  # looking for one that is like it takes its time
        near = difflib.get_close_matches(name[:LONGEST_NAME], known, 1)
        problems.append(BadInput(where, name, 'there is no such parameter',
                                 f'did you mean {near[0]}?' if near else mend))
    if len(names) > MOST_LISTED:
        problems.append(BadInput(where, '', f'and {len(names) - MOST_LISTED} more parameters '
                                 'that there are not', 'leave them out'))
    return problems


def _names(design: Design | None, values: Mapping[str, Any], where: str,
           problems: list[BadInput]) -> Names | None:
    """Return by which names isolation speaks of the sensors; append a problem if it is wrong."""
    if design is None or 'isolation.names' not in values:
        return None
    try:
        return Names.of(design.sensors, values['isolation.names'])
    except Wrong as wrong:
        problems.append(BadInput(where, 'isolation.names', wrong.problem, wrong.mend))
        return None


def _own(values: Mapping[str, Any], sensor: str, key: str) -> Any:
    """Return what counts for one sensor: its own value, else the general one."""
    value = values[f'sensors.{sensor}.{key}']
    return values[OVERRIDES[key]] if value == '' else value


def _command_ends(design: Design, values: Mapping[str, Any]) -> dict[str, End]:
    """Return what becomes of each command that comes no more; those that hold are left out."""
    ends = {}
    for name in design.inputs:
        age, at_end = values[f'commands.{name}.max_age'], values[f'commands.{name}.at_end']
        if at_end != 'hold':
            ends[name] = End(values['max_age'] if age == '' else age,
                             at_end if isinstance(at_end, float) else None,
                             only_periodic=age == '' and at_end == '')
    return ends


def _isolator(design: Design, values: Mapping[str, Any]) -> IsolatorSettings:
    """Return what the parameters of the node's own isolator amount to."""
    smallest = {s: values[f'sensors.{s}.smallest_fault'] for s in design.sensors}
    return IsolatorSettings(
        **{key: values[f'isolator.{key}'] for key in (
            'mode', 'false_alarms_per_day', 'model_error', 'recovery', 'dwell')},
        smallest_fault={s: value for s, value in smallest.items() if value})


def _live(design: Design, values: Mapping[str, Any]) -> Live:
    """Return what the live parameters amount to."""
    return Live(
        values['without_estimate'], values['time_constant'],
        {s: Policy(_own(values, s, 'recovery'), _own(values, s, 'dwell'),
                   _own(values, s, 'silent') == 'replace') for s in design.sensors},
        {s: None if (limit := _own(values, s, 'max_deviation')) in ('', AUTO) else limit
         for s in design.sensors})


def _declared_with_topic(node: Node, name: str) -> bool:
    """Tell whether rclpy declared this quality of a topic, as opposed to the user."""
    return name.startswith(f'{QOS}.') and bool(node.describe_parameter(name).description)


def _declare(node: Node, name: str, entry: Known) -> None:
    """Declare a parameter, or declare it anew with its description."""
    value = entry.default
    if node.has_parameter(name):
        if node.describe_parameter(name).description:
            return  # the topic was opened, or the node configured, before
        value = entry.check(node.get_parameter(name).value, '', name)
        node.undeclare_parameter(name)
    elif name.startswith(f'{QOS}.'):
        return  # a topic that was opened without
    node.declare_parameter(name, value, entry.descriptor(), ignore_override=True)
