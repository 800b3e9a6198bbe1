"""YAML of plant files: what is in it is plain data, and nothing of it is ever executed."""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any, NoReturn

import yaml

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.text_file import read_text

LARGEST_FILE = 2**20    # bytes
_OCTAL = re.compile('[-+]?0[0-7_]+')


class _Loader(yaml.SafeLoader):
    """SafeLoader that refuses aliases (they grow without bound), repeated keys, odd values."""

    where: object = ''

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            line = self.peek_event().start_mark.line + 1
            raise BadInput(self.where, f'line {line}', 'an alias (*) is not read here',
                           'write the value out')
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen: dict[Any, int] = {}
        for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
            if key.value == 'slow' and isinstance(value, yaml.ScalarNode):
                value.tag = 'tag:yaml.org,2002:str'  # the one truth value there is
            line = key.start_mark.line + 1
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise BadInput(self.where, f'line {line}', f'{shown(key.value)} stands '
                                   f'there twice (first in line {seen[key.value]})',
                                   'give each name once')
                seen[key.value] = line
        return super().construct_mapping(node, deep)

    def refuse_bool(self, node: yaml.ScalarNode) -> NoReturn:
        raise BadInput(self.where, f'line {node.start_mark.line + 1}', f'YAML reads {node.value} '
                       'as a truth value (so with on, off, yes, no)', f"write '{node.value}'")

    def plain_int(self, node: yaml.ScalarNode) -> int:
        self._refuse_clock(node)
        if _OCTAL.fullmatch(node.value):
            raise BadInput(self.where, f'line {node.start_mark.line + 1}', f'YAML reads '
                           f'{shown(node.value)} as a number to the base of 8',
                           'leave out the zeros before it')
        return int(super().construct_yaml_int(node))

    def plain_float(self, node: yaml.ScalarNode) -> float:
        self._refuse_clock(node)
        return float(super().construct_yaml_float(node))

    def _refuse_clock(self, node: yaml.ScalarNode) -> None:
        if ':' in node.value:  # 1:30 is 90 in YAML 1.1
            raise BadInput(self.where, f'line {node.start_mark.line + 1}', f'YAML reads '
                           f'{shown(node.value)} as a number to the base of 60',
                           'write a plain number')


_Loader.add_constructor('tag:yaml.org,2002:bool', _Loader.refuse_bool)
_Loader.add_constructor('tag:yaml.org,2002:int', _Loader.plain_int)
_Loader.add_constructor('tag:yaml.org,2002:float', _Loader.plain_float)


def read_yaml(path: str | Path, what: str = 'plant file') -> Any:
    """Return what a file holds; raise BadInput, one line, for what is not read here."""
    text = read_text(path, '', f'name a {what} (YAML)', LARGEST_FILE)
    try:
        loader = _Loader(text)
        loader.where = path
        return loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise BadInput(path, f'line {mark.line + 1}' if mark else '',
                       f'is not YAML ({error.problem or error.context})',
                       'correct the line or the one before it') from None
    except BadInput:
        raise
    except (RecursionError, ValueError, OverflowError, TypeError, KeyError) as error:
        # dates that do not exist, integers of thousands of digits, thousands of brackets
        problem = 'is nested too deeply' if isinstance(error, RecursionError) \
            else f'holds a value that cannot be read ({shown(str(error))})'
        raise BadInput(path, '', problem, 'write numbers and names only') from None
