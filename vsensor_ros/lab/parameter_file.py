"""The replacer's parameters as ROS will read them: from files and from a command line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
import re
from typing import Any

import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.known import GENERAL, OVERRIDES, Refused
from vsensor_ros.node.parameter_file import check_files, fits, misaddressed, PARAMETERS

Group = tuple[str, dict[str, Any]]  # for which nodes, and the parameters by dotted name


@dataclass(frozen=True)
class Parameters:
    """What one replacer is told; `node` is its full name."""

    path: Path
    node: str
    given: Mapping[str, Any]    # by dotted name
    nodes: tuple[str, ...]      # as written: who is told something of it
    ros_args: tuple[str, ...]   # for all nodes beside it, after --ros-args

    @property
    def simulated(self) -> bool:
        """Tell whether its time is that of /clock."""
        return self.given.get('use_sim_time') is True

    def general(self, name: str) -> Any:
        """Return a parameter, by default that of the replacer; raise BadInput."""
        known = GENERAL[name]
        return known.check(self.given.get(name, known.default), self.path, name)

    def of(self, sensor: str, key: str) -> Any:
        """Return what counts for one sensor: its own parameter, else that of all."""
        known, name = GENERAL[OVERRIDES[key]], f'sensors.{sensor}.{key}'
        own = self.given.get(name, '')
        return self.general(OVERRIDES[key]) if own == '' else known.check(own, self.path, name)

    def command_line(self, changes: Path, **changed: Any) -> list[str]:
        """
        Return the arguments of this replacer with some parameters changed.

        Of two nodes' names that both fit, the later one counts for ROS; so what is changed is
        written for each of them, to the file `changes`.
        """
        changes.write_text(yaml.safe_dump({name: {PARAMETERS: dict(changed)} for name in (
            *self.nodes, self.node)}), encoding='utf-8')
        name = self.node.rpartition('/')[2]
        return ['--ros-args', '--params-file', str(self.path), *self.ros_args,
                *(('-r', f'__node:={name}') if name != 'replacer' else ()),
                *(('--params-file', str(changes)) if changed else ())]


def read_parameters(path: Path, ros_args: Sequence[str] = ()) -> Parameters:
    """
    Read a parameter file and the arguments after --ros-args that follow it; raise BadInput.

    The node is the one that the arguments name. Else it is /replacer, if the file has anything
    for it, else the one that the file names and gives sensors.
    """
    try:
        blocks = check_files(['--params-file', str(path), *ros_args])
    except Refused as refused:
        raise refused.problems[0] from None
    groups: dict[str, dict[str, Any]] = {}  # by node, in order of appearance
    try:
        for name, parameters in _told(['--params-file', str(path), *ros_args]):
            groups.setdefault(name, {}).update(parameters)
    except (yaml.YAMLError, ValueError) as error:  # a value of no type that ROS knows
        raise BadInput(path, 'parameter file', f'cannot be read: {error}', 'give numbers, '
                       'texts, true and false') from None
    name, namespace, rest = _identity(ros_args)
    if name or namespace or any(fits(n, '/replacer') and _has_sensors(p)
                                for n, p in groups.items()):
        node = f'/{(namespace or "").strip("/")}/{name or "replacer"}'.replace('//', '/')
    else:
        node = next((n for n, p in groups.items() if '*' not in n and _has_sensors(p)),
                    '/replacer')
    fitting = [n for n in groups if fits(n, node)]
    given = {key: value for n in fitting for key, value in groups[n].items()}
    if not _has_sensors(given):
        if meant := [b for b in blocks if b.path and not fits(b.nodes, node) and b.has_sensors]:
            raise misaddressed(meant, node)[0]
        raise BadInput(path, node, 'is told of no sensors', f'give {node}: ros__parameters: '
                       'with topic, type and field of each sensor and command')
    inside = node.rpartition('/')[0]
    return Parameters(path, node, given, tuple(fitting),
                      (*rest, *(('-r', f'__ns:={inside}') if inside else ())))


def _told(arguments: Sequence[str]) -> Iterator[Group]:
    """Yield the parameters that a command line has, each for the nodes of a name."""
    for flag, value in pairwise(arguments):
        if flag == '--params-file':
            yield from _groups(yaml.safe_load(Path(value).read_text(encoding='utf-8')), '')
        elif flag in ('-p', '--param'):
            if match := re.fullmatch(r'(?:([^:]*):)?([^:]+):=(.*)', value, re.DOTALL):
                node, name, text = match.groups()
                yield f'/{node}' if node else '/**', {name: yaml.safe_load(text)}


def _groups(tree: Mapping[str, Any], place: str) -> Iterator[Group]:
    """Yield each node's name in a parameter file, in full, with its parameters."""
    for key, below in tree.items():
        if key == PARAMETERS:
            yield place, dict(_leaves(below if isinstance(below, dict) else {}))
        else:
            yield from _groups(below, f'{place}/{str(key).strip("/")}')


def _leaves(tree: Mapping[str, Any], place: str = '') -> Iterator[tuple[str, Any]]:
    """Yield dotted names and values; ROS takes both ``a: {b: 1}`` and ``a.b: 1``."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, f'{place}{key}.')
        else:
            yield f'{place}{key}', value


def _has_sensors(parameters: Mapping[str, Any]) -> bool:
    return any(name.startswith('sensors.') for name in parameters)


def _identity(ros_args: Sequence[str]) -> tuple[str, str, list[str]]:
    """Return the name and the namespace that arguments give a node ('': none), and the others."""
    name = namespace = ''
    rest = list(ros_args)
    for i, (flag, value) in reversed(list(enumerate(pairwise(ros_args)))):
        match = re.fullmatch(r'__(ns|node|name):=(.+)', value)
        if flag in ('-r', '--remap') and match:
            if match[1] == 'ns':    # the first counts
                namespace = match[2]
            else:
                name = match[2]
            del rest[i:i + 2]
    return name, namespace, rest
