"""
Listen beside a robot, and say what would not work when a sensor fails.

The replacer itself is run, without a voice: with its parameters, its subscriptions and its engine.
What it would need and lacks is explained by what is heard on each topic and who is on the graph.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
import sys
import time

from rclpy.node import Node

from vsensor_ros.bad_input import BadInput
from vsensor_ros.commissioning.check_table import CheckReport, lay_out, show
from vsensor_ros.commissioning.ear import Ear
from vsensor_ros.commissioning.findings import (
    COMMAND,
    FAIL,
    Finding,
    INPUT,
    ISOLATION,
    judge,
    judge_clock,
    logged,
    OUTPUT,
    Use,
    World,
)
from vsensor_ros.commissioning.neighbours import listeners, publishers, types_of_topics
from vsensor_ros.commissioning.rehearsal import outlook
from vsensor_ros.commissioning.silent_node import (
    open_context,
    open_silent,
    own_name,
    SilentNode,
)
from vsensor_ros.lab.parameter_file import read_parameters
from vsensor_ros.node.cdr import Reader
from vsensor_ros.node.parameters import check_files, Command, read, Refused, Sensor, Settings
from vsensor_ros.node.polling import LISTEN, Polled
from vsensor_ros.node.private_rclpy import lacking, Waiting
from vsensor_ros.node.qos import QOS
from vsensor_ros.node.replacer import Replacer

FOUND = 3.0  # s that the first message may take, before the seconds of listening begin
PAUSE = 5_000_000  # ns of a wait for messages


def check(path: Path, seconds: float, ros_args: Sequence[str]) -> int:
    """
    Print what was found, the worst in the last line; return the exit status.

    0: all would work; 1: something would not; 2: the parameters are wrong. Raises BadInput.
    """
    arguments = ['--params-file', str(path), *ros_args]
    parameters = read_parameters(path, ros_args)
    namespace, _, name = parameters.node.rpartition('/')
    if missing := lacking():
        raise BadInput('rclpy', '', f'lacks {missing[0]}', 'use the one of ROS 2 Jazzy')
    with open_context(arguments) as context:
        try:
            with open_silent(context, name, namespace) as told:
                settings = read(told, check_files(arguments))
                kept = [told.get_parameter(key) for key in told.get_parameters_by_prefix('')
                        if key == 'use_sim_time' or key.startswith(f'{QOS}.')]
            with open_silent(context, own_name('check'), namespace, kept, False) as node:
                report = listen(node, settings, parameters.node, path, seconds)
        except Refused as refused:
            for problem in refused.problems:
                print(f'check: {problem}', file=sys.stderr)
            return 2
    show(lay_out(replace(report, start=_start(parameters.node, ros_args))))
    return 1 if report.fails else 0


def _start(node: str, ros_args: Sequence[str]) -> str:
    """Return the remappings with which the replacer must be started to be this node."""
    namespace, _, name = node.rpartition('/')
    given = ' '.join(ros_args)
    return ' '.join(f'-r {key}:={value}' for key, value, usual in (
        ('__ns', namespace, ''), ('__node', name, 'replacer')) if value != usual
        and f'{key}:=' not in given and not (key == '__node' and '__name:=' in given))


def listen(node: SilentNode, settings: Settings, name: str, path: Path,
           seconds: float) -> CheckReport:
    """Listen for so long and judge; name: full name of the replacer that is checked."""
    replacer = Replacer(node, settings)
    group = Polled()
    uses = uses_of(settings)
    ears = {(use.topic, use.role): Ear(node, group, use.topic, LISTEN, _readers(replacer, use),
                                          _choosing(settings, use))
            for use in uses if use.role in (INPUT, COMMAND)}
    _hear(replacer, ears.values(), seconds)
    seen = {(use.topic, use.role): _seen(node, replacer, use, ears.get((use.topic, use.role)))
            for use in uses}
    state = replacer.snapshot()
    world = World(
        name, seconds, types_of_topics(node),
        frozenset(use.topic for use in uses), settings.max_age,
        settings.isolator.mode == 'act' or
        all(policy.silent_is_faulty for policy in settings.live.policies.values()),
        replacer.simulated, replacer.engine.now != 0 and state.stopped is None,
        tuple(p.node for p in publishers(node, '/clock')), replacer.engine.now * 1e-9)
    findings = judge_clock(world)
    for use in seen.values():
        findings += judge(use, seen, world)
    findings += logged(node.notebook.errors, (use.topic for use in uses))
    if state.faulty:
        findings.append(Finding(
            FAIL, (settings.isolation_topic,), '', 'isolation says that '
            f'{", ".join(state.faulty)} is faulty now', 'repair it, or have isolation say that '
            'all are healthy'))
    findings.sort(key=lambda f: -f.level)
    outlooks = [outlook(c, replacer.engine.reserve(c.name), settings.design,
                        tuple(seen.values()), findings, state.faulty)
                for c in sorted(state.channels,
                                key=lambda c: settings.design.sensors.index(c.name))]
    replacer.close()
    return CheckReport(name, str(path), seconds, tuple(seen.values()), tuple(findings),
                       tuple(outlooks), settings.design.units)


def uses_of(settings: Settings) -> list[Use]:
    """Return the topics that the parameters name, each once for each role."""
    uses: dict[tuple[str, str], Use] = {}

    def add(topic: str, role: str, end: Sensor | Command, output: str = '') -> None:
        use = uses.get((topic, role), Use(topic, end.type, role, {}, output=output))
        uses[topic, role] = replace(
            use, channels={**use.channels, end.name: end.accessor.path},
            chosen={**use.chosen, **({end.name: end.publisher} if end.publisher else {})})
    for sensor in settings.sensors:
        add(sensor.input, INPUT, sensor, sensor.output)
    for command in settings.commands:
        add(command.topic, COMMAND, command)
    for sensor in settings.sensors:
        add(sensor.output, OUTPUT, sensor)
    isolation = Use(settings.isolation_topic, settings.isolation_type, ISOLATION, {})
    return [*uses.values(), isolation]


def _readers(replacer: Replacer, use: Use) -> list[Reader]:
    """Return what the replacer itself reads a topic with."""
    if use.role == INPUT:
        return [topic.reader for topic in replacer.topics if topic.plan.source == use.topic]
    inlets = replacer.inlets[len(replacer.topics):]  # one a command
    return [inlet.reader for inlet, command in zip(inlets, replacer.settings.commands)
            if command.name in use.channels]


def _choosing(settings: Settings, use: Use) -> list[Sensor | Command]:
    """Return the ends by which messages of some publishers are left out, as the replacer does."""
    if use.role == COMMAND and len(use.chosen) < len(use.channels):
        return []  # another command there hears them all
    ends: Sequence[Sensor | Command] = settings.sensors if use.role == INPUT else settings.commands
    return [end for end in ends if end.name in use.chosen]


def _hear(replacer: Replacer, ears: Collection[Ear], seconds: float) -> None:
    """Let the replacer and the ears take all that comes, from the first message on so long."""
    begin = time.monotonic()
    end = begin + FOUND + seconds
    began = False
    with Waiting(replacer.subscriptions, replacer.node.context) as waiting:
        while (now := time.monotonic()) < end:
            replacer.poll()
            simulated = replacer.engine.now if replacer.simulated else None
            for ear in ears:
                ear.listen(simulated)
            if not began and any(ear.heard.count for ear in ears):
                began, end = True, min(end, now + seconds)
            waiting.wait(PAUSE)


def _seen(node: Node, replacer: Replacer, use: Use, ear: Ear | None) -> Use:
    """Add to a topic who is there and what was heard."""
    ends = [s.qos_profile for s in replacer.reports.subscriptions] if use.role == ISOLATION \
        else [ear.subscription.qos_profile] if ear is not None else []
    ours = None
    if use.role == OUTPUT:
        ours = next(t.publisher.qos_profile for t in replacer.topics
                    if t.plan.output == use.topic)
    seen = replace(use, publishers=publishers(node, use.topic, ends))
    if use.role == OUTPUT:
        return replace(seen, listeners=listeners(node, use.topic, ours))
    return seen if ear is None else replace(seen, heard=ear.heard, fields=ear.heard.fields)
