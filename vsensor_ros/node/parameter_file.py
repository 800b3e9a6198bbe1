"""The files of parameters on a command line, looked through before rcl reads them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
import stat

from rclpy.node import Node
import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.known import Refused

PARAMETERS = 'ros__parameters'  # the key in a parameter file below which they stand
LARGEST_FILE = 2**20  # bytes of a parameter file
ROS_OWN = ('use_sim_time', 'start_type_description_service')


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
