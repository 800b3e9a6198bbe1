"""The files of parameters on a command line, looked through before rcl reads them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
import re

from rclpy.node import Node
import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.known import Refused
from vsensor_ros.text_file import read_text

PARAMETERS = 'ros__parameters'  # the key in a parameter file below which they stand
LARGEST_FILE = 2**20  # bytes of a parameter file
ROS_OWN = ('use_sim_time', 'start_type_description_service')
LAUNCHED = 'autostart'  # a launch file gives it to whichever node it starts


@dataclass(frozen=True)
class Block:
    """The parameters that a file, or -p, gives to all nodes whose full name fits a pattern."""

    path: str  # of the file; '': -p
    nodes: str  # /robot/replacer, /*/replacer, /**
    names: frozenset[str]  # dotted

    @property
    def for_all(self) -> bool:
        """Whether it is a file's for nodes of any name."""
        return bool(self.path) and self.nodes.endswith('*')

    @property
    def has_sensors(self) -> bool:
        """Whether it wires any."""
        return any(n.startswith('sensors.') for n in self.names)

    @property
    def tells_of_topics(self) -> bool:
        """Whether only a replacer can be meant."""
        return any(n == 'design_file' or n.startswith(('sensors.', 'commands.'))
                   for n in self.names)


def check_files(arguments: Sequence[str]) -> list[Block]:
    """
    Look through the parameter files named on a ROS command line before rcl reads them.

    rcl keeps one of two entries of the same name in silence and reports the rest with a location
    in its own sources. Returns who is given what, -p included. Raises Refused.
    """
    problems: list[BadInput] = []
    blocks: list[Block] = []
    for flag, value in pairwise(arguments):
        if flag == '--params-file':
            try:
                root = _compose(value)
            except BadInput as problem:
                problems.append(problem)
                continue
            found = _check_tree(root, value)
            problems.extend(found)
            blocks.extend(() if found else _blocks(root, value))
        elif flag in ('-p', '--param') and (
                match := re.match(r'(?:([^:]*):)?([^:]+):=', value)):
            blocks.append(Block('', f'/{match[1]}' if match[1] else '/**', frozenset([match[2]])))
    if problems:
        raise Refused(problems)
    return blocks


def check_addressed(node: Node, blocks: Sequence[Block]) -> None:
    """Raise Refused when what this node lacks stands in a file, for a node named otherwise."""
    name, given = node.get_fully_qualified_name(), set(node.get_parameters_by_prefix(''))
    if 'design_file' in given and any(n.startswith('sensors.') for n in given):
        return
    others = [block for block in blocks if block.path and not fits(block.nodes, name)]
    meant = [block for block in others if block.tells_of_topics]
    if not meant and not given.difference(ROS_OWN, [LAUNCHED]):
        meant = others
    if meant:
        raise Refused(misaddressed(meant, name))


def misaddressed(blocks: Sequence[Block], node: str) -> list[BadInput]:
    """Say of each file with these blocks that it is for other nodes than the one meant."""
    return [BadInput(path, '', f'is for {", ".join(b.nodes for b in blocks if b.path == path)}, '
                     f'but this node is {node}', f'write /**: or {node}: above it')
            for path in dict.fromkeys(block.path for block in blocks)]


def fits(pattern: str, node: str) -> bool:
    """Tell whether a node's name fits one in a parameter file: * is a part of it, ** any."""
    parts = [r'(/[^/]+)*' if part == '**' else r'/[^/]+' if part == '*' else f'/{re.escape(part)}'
             for part in pattern.strip('/').split('/')]
    return re.fullmatch(''.join(parts), node) is not None


def for_others(names: Sequence[str], blocks: Sequence[Block], node: str,
               ours: Collection[str]) -> list[str]:
    """
    Return which of these names given to a node are meant for others: for all nodes of a robot.

    Those given only in blocks for any node (/**, /robot/*) without any of `ours`.
    """
    robot_wide: set[str] = set()
    named: set[str] = set()
    for block in blocks:
        if fits(block.nodes, node):
            wide = block.for_all and block.names.isdisjoint(ours)
            (robot_wide if wide else named).update(block.names)
    return [name for name in names if name in robot_wide - named]


def source_of(name: str, blocks: Sequence[Block], node: str) -> str:
    """Return the path of the file that gives a parameter to a node; '': none does."""
    fitting = [block for block in blocks if fits(block.nodes, node)]
    order = list(dict.fromkeys(block.nodes for block in fitting))  # as rcl puts them together
    givers = sorted((block for block in fitting if name in block.names),
                    key=lambda block: order.index(block.nodes))
    return givers[-1].path if givers else ''


def _compose(path: str) -> yaml.Node | None:
    """Read a file as a tree of YAML; raise BadInput."""
    key = 'parameter file'
    if Path(path).exists() and not Path(path).is_file():  # reading a pipe would leave rcl none
        raise BadInput(path, key, 'is not a regular file', 'name a YAML file')
    text = read_text(path, key, 'name a YAML file that exists', LARGEST_FILE)
    try:
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except RecursionError:
        raise BadInput(path, key, 'is nested beyond reason',
                       'name a YAML file of parameters') from None
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        problem = ' '.join(str(getattr(error, 'problem', None) or error).split())
        raise BadInput(path, f'line {mark.line + 1}' if mark else key,
                       f'is not YAML ({problem})', 'mend the file') from None


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


def _blocks(root: yaml.Node | None, path: str, place: str = '') -> Iterator[Block]:
    """Yield what a parameter file, whose tree was checked, gives to whom."""
    for key, value in root.value if isinstance(root, yaml.MappingNode) else ():
        if key.value == PARAMETERS:
            yield Block(path, place, frozenset(_leaves(value)))
        else:
            yield from _blocks(value, path, f'{place}/{key.value.strip("/")}')


def _leaves(tree: yaml.Node, place: str = '') -> Iterator[str]:
    """Yield dotted names; ROS takes both ``a: {b: 1}`` and ``a.b: 1``."""
    for key, value in tree.value if isinstance(tree, yaml.MappingNode) else ():
        if isinstance(value, yaml.MappingNode):
            yield from _leaves(value, f'{place}{key.value}.')
        else:
            yield f'{place}{key.value}'
