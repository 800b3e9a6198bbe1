"""A checked reader of JSON: whatever is not as it must be is one line that says where and what."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from vsensor_ros.bad_input import BadInput, check_text
from vsensor_ros.functions.expression import check_name
from vsensor_ros.text_file import read_text

LARGEST_FILE = 64 * 2**20
LARGEST_SIDE = 10_000  # rows or columns of one matrix; keeps a forged file from eating the memory
INF = float('inf')
MEND = 'write the file anew with the designer'


def or_null(value: float, infinite: float = INF) -> float | None:
    """Write the infinity that a number may be as null; JSON has none."""
    return None if value == infinite else value


def read_json(path: str | Path) -> Any:
    """Read a file as JSON without constants, repeated keys or other surprises; raises BadInput."""
    return parse_json(read_text(path, 'design file', 'name a file that the designer wrote',
                                LARGEST_FILE), path)


def parse_json(text: str, path: str | Path, first: int = 1) -> Any:
    """Parse a part of a file as `read_json` does; first: the number of its first line."""
    def no_constant(name: str) -> NoReturn:
        raise BadInput(path, name, 'is not a finite number', MEND)

    def no_repeat(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        record = dict(pairs)
        if len(record) < len(pairs):
            counts = Counter(key for key, _ in pairs)
            twice = next(key for key, count in counts.items() if count > 1)
            raise BadInput(path, twice, 'stands there twice', MEND)
        return record

    try:
        return json.loads(text, parse_constant=no_constant, object_pairs_hook=no_repeat)
    except json.JSONDecodeError as error:
        raise BadInput(path, f'line {error.lineno + first - 1}', f'is not JSON ({error.msg})',
                       MEND) from error
    except (RecursionError, ValueError) as error:  # ValueError: an integer of 5000 digits
        if isinstance(error, BadInput):
            raise
        raise BadInput(path, 'design file', 'is nested or written beyond reason',
                       MEND) from error


@dataclass(frozen=True)
class CheckedObject:
    """One JSON object being checked, and where it stands in the file."""

    path: str | Path
    place: str
    record: dict[str, Any]

    def fail(self, key: str, problem: str, mend: str = MEND) -> BadInput:
        """Return what is to be raised because of a key."""
        return BadInput(self.path, f'{self.place}{key}', problem, mend)

    def only(self, keys: Iterable[str]) -> None:
        """Refuse keys other than these."""
        for key in self.record:
            if key not in keys:
                raise self.fail(key[:80], 'is not a key of the design file')

    def without(self, keys: Iterable[str]) -> CheckedObject:
        """Return the same object without some keys, which somebody else reads."""
        return CheckedObject(self.path, self.place,
                      {key: value for key, value in self.record.items() if key not in keys})

    def get(self, key: str, kind: type | tuple[type, ...], what: str) -> Any:
        """Read a value of a JSON type."""
        if key not in self.record:
            raise self.fail(key, 'is missing')
        value = self.record[key]
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self.fail(key, f'must be {what}')
        return value

    def text(self, key: str) -> str:
        """Read a text of one line."""
        return check_text(self.get(key, str, 'a text'), self.path, f'{self.place}{key}')

    def number(self, key: str) -> float:
        """Read a finite number."""
        value = _as_float(self.get(key, (int, float), 'a number'))
        if not np.isfinite(value):
            raise self.fail(key, 'is not finite')
        return value

    def limit(self, key: str, infinite: float) -> float:
        """Read a number that may be infinite: null."""
        return infinite if self.record.get(key, 0.0) is None else self.number(key)

    def size(self, key: str, infinite: bool = False) -> float:
        """Read a number that is not negative, and infinite only where it may be: null."""
        value = self.limit(key, INF) if infinite else self.number(key)
        if value < 0.0:
            raise self.fail(key, 'must not be negative')
        return value

    def positive(self, key: str) -> float:
        """Read a number above 0."""
        value = self.number(key)
        if not value > 0.0:
            raise self.fail(key, 'must be positive')
        return value

    def pair(self, key: str, infinite: tuple[bool, bool]) -> tuple[float, float]:
        """Read two numbers as `size` does; infinite: which of them may be so."""
        value = self.get(key, list, 'a list of two numbers')
        if len(value) != 2:
            raise self.fail(key, 'is not 2 numbers')
        items = CheckedObject(self.path, self.place,
                              {f'{key}[{i}]': v for i, v in enumerate(value)})
        first, second = (items.size(f'{key}[{i}]', infinite[i]) for i in range(2))
        return first, second

    def whole(self, key: str) -> int:
        """Read a size or an index."""
        value = self.get(key, int, 'a whole number')
        if not 0 <= value <= LARGEST_SIDE:
            raise self.fail(key, f'must lie in 0..{LARGEST_SIDE}')
        return value

    def flag(self, key: str) -> bool:
        """Read a truth value."""
        if not isinstance(self.record.get(key), bool):
            raise self.fail(key, 'must be true or false' if key in self.record else 'is missing')
        return self.record[key]

    def word(self, key: str, known: tuple[str, ...]) -> str:
        """Read one of a few words."""
        value = self.text(key)
        if value not in known:
            raise self.fail(key, f'{value:.80} is not one of {", ".join(known)}')
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """Read texts of one line."""
        value = self.get(key, list, 'a list of texts')
        return tuple(check_text(text, self.path, f'{self.place}{key}') for text in value)

    def names(self, key: str) -> tuple[str, ...]:
        """Read names of the expression language, none of them twice."""
        value = self.get(key, list, 'a list of names')
        if len(value) > LARGEST_SIDE:
            raise self.fail(key, f'has more than {LARGEST_SIDE} names')
        for name in value:
            check_name(name, self.path, f'{self.place}{key}')
        if len(set(value)) < len(value):
            raise self.fail(key, 'holds a name twice')
        return tuple(value)

    def array(self, key: str, *shape: int) -> np.ndarray:
        """Read nested lists as a float array of just this shape."""
        value = self.get(key, list, 'a list of numbers')
        if not _has_shape(value, shape):
            size = ' x '.join(str(side) for side in shape)
            raise self.fail(key, f'is not {size} numbers')
        array = np.array(value, dtype=float).reshape(shape)
        if not np.all(np.isfinite(array)):
            raise self.fail(key, 'is not finite')
        return array

    def object(self, key: str) -> CheckedObject:
        """Read an object."""
        return CheckedObject(self.path, f'{self.place}{key}.', self.get(key, dict, 'an object'))

    def optional(self, key: str) -> CheckedObject | None:
        """Read an object, or null."""
        return None if self.record.get(key, 0) is None else self.object(key)

    def objects(self, key: str) -> list[CheckedObject]:
        """Read a list of objects."""
        value = self.get(key, list, 'a list')
        readers = []
        for i, item in enumerate(value):
            if not isinstance(item, dict):
                raise self.fail(f'{key}[{i}]', 'must be an object')
            readers.append(CheckedObject(self.path, f'{self.place}{key}[{i}].', item))
        return readers


def _as_float(value: int | float) -> float:
    """Convert a JSON number, however long, to a float (infinite when too large)."""
    try:
        return float(value)
    except OverflowError:
        return float('inf')


def _has_shape(value: Any, shape: tuple[int, ...]) -> bool:
    if not shape:
        return isinstance(value, (int, float)) and not isinstance(value, bool) \
            and np.isfinite(_as_float(value))
    return isinstance(value, list) and len(value) == shape[0] and (
        all(_has_shape(item, shape[1:]) for item in value))
