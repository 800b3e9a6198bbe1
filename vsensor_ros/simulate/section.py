"""A section of a YAML file that answers in the right type, or with one clear line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import Node, parse
from vsensor_ros.text_file import read_text

LARGEST_FILE = 2**20  # bytes


@dataclass(frozen=True)
class Section:
    """A mapping of a YAML file that answers in the right type, or with one clear line."""

    where: str
    place: str
    content: Mapping[str, Any]

    @classmethod
    def of(cls, path: Path) -> Section:
        """Read a file; raise BadInput."""
        text = read_text(path, '', 'give a demo.yaml', LARGEST_FILE)
        try:
            content = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise BadInput(path, '', f'is not YAML: {error}'[:200], 'mend it') from None
        return cls(str(path), '', {}).inner('', content)

    def bad(self, key: str, problem: str, mend: str) -> BadInput:
        """Return what is wrong with a key, to be raised."""
        return BadInput(self.where, '.'.join(part for part in (self.place, key) if part),
                        problem, mend)

    def inner(self, key: str, content: Any = None) -> Section:
        """Return the section below a key, or given content as if it stood there."""
        content = self.content.get(key) if content is None else content
        if not isinstance(content, dict) or not all(isinstance(k, str) for k in content):
            raise self.bad(key, 'is not a mapping', 'write name: value pairs')
        return Section(self.where, '.'.join(p for p in (self.place, key) if p), content)

    def expect(self, needed: Set[str], optional: Set[str] = frozenset()) -> None:
        """Raise BadInput unless it has the needed keys, and no others but the optional."""
        for key in sorted(needed - self.content.keys()):
            raise self.bad(key, 'is missing', 'add it')
        for key in sorted(self.content.keys() - needed - optional):
            raise self.bad(key, 'is not known here',
                           f'known are {", ".join(sorted(needed | optional))}')

    def text(self, key: str) -> str:
        """Return a text."""
        value = self.content.get(key)
        if not isinstance(value, str):
            raise self.bad(key, 'is not a text', 'write a text')
        return value

    def number(self, key: str) -> float:
        """Return a finite number."""
        value = self.content.get(key, np.nan)
        if type(value) not in (int, float) or not np.isfinite(value):
            raise self.bad(key, 'is not a finite number', 'write a number')
        return float(value)

    def list(self, key: str) -> list[Any]:
        """Return a list."""
        value = self.content.get(key)
        if not isinstance(value, list):
            raise self.bad(key, 'is not a list', 'write a list')
        return value

    def numbers(self, key: str, names: tuple[str, ...]) -> dict[str, float]:
        """Return the numbers that are given for some of these names."""
        part = self.inner(key, self.content.get(key, {}))
        part.expect(set(), set(names))
        return {name: part.number(name) for name in part.content}

    def expressions(self, key: str, names: Sequence[str],
                    known: Sequence[str]) -> tuple[Node, ...]:
        """Return an expression of known names for each of these; what is absent is zero."""
        part = self.inner(key, self.content.get(key, {}))
        part.expect(set(), set(names))
        return tuple(parse(part.content.get(name, 0.0), self.where, f'{part.place}.{name}', known)
                     for name in names)
