"""Where the time of a message stands: in its header, or in fields that the parameters name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
import re
from typing import Any

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import Accessor, compile_accessor, compile_holder, has_stamp
from vsensor_ros.node.field_path import LARGEST_FLOAT, trace
from vsensor_ros.node.known import UNITS
from vsensor_ros.reason import Reason

LARGEST = 2**62  # ns; no clock says that
TIME, HEADER = 'builtin_interfaces/Time', 'header.stamp'


@dataclass(frozen=True)
class Stamp:
    """One field of a message with its time, compiled. Times are in ns."""

    path: str
    unit: int | None  # ns of one in a number; None: it is of type TIME
    numbers: tuple[Accessor, ...]  # of seconds and nanoseconds, or the one number
    get: Callable[[Any], int | None]  # the time, None when there is none or it is 0
    put: Callable[[Any, int], Reason | None]  # None when written, or the reason why it was not


def compile_stamps(kind: Any, fields: str = '', unit: str = '', where: str = 'stamp',
                   key: str = 'stamp') -> tuple[Stamp, ...]:
    """
    Return where a message class has its time: in its header, and in fields that are named.

    fields: dotted, as `trace` takes them, with commas between; each a time or a number. unit: of
    those that are numbers, of UNITS. The first of them all is what counts. Raises BadInput.
    """
    if unit and unit not in UNITS:
        raise BadInput(where, f'{key}_unit', f'{unit!r:.80} is not a unit of time',
                       f'choose from {", ".join(UNITS)}')
    paths = [path for path in re.split(r'[,\s]+', fields) if path not in ('', HEADER)]
    stamps = [_time(kind, HEADER, where, key)] if has_stamp(kind) else []
    for path in paths:
        try:
            stamps.append(_time(kind, path, where, key))
        except BadInput as no_time:
            steps = trace(kind, path, where, key)  # raises when it is no number, either
            if steps[-1].kind.__name__ == 'Duration':
                raise BadInput(where, key, f'{path} is in a duration, not a time',
                               'name a field with the time of the message') from None
            if unit not in UNITS:
                raise BadInput(where, f'{key}_unit', f'{path} is a number, and its unit is not '
                               'given', f'choose from {", ".join(UNITS)}') from no_time
            stamps.append(_count(compile_accessor(kind, path, where, key), UNITS[unit]))
    return tuple(stamps)


def to_ns(number: float, unit: int) -> int | None:
    """Return the time that a number says, None when it says none."""
    if not math.isfinite(number):
        return None
    most = LARGEST // unit
    return round(min(max(number, -most), most) * unit) or None


def _time(kind: Any, path: str, where: str, key: str) -> Stamp:
    seconds = compile_accessor(kind, f'{path}.sec', where, key)
    nanoseconds = compile_accessor(kind, f'{path}.nanosec', where, key)
    if seconds.steps[-1].kind.__name__ != 'Time':
        raise BadInput(where, key, f'{path} is not a time', f'name a field of type {TIME}')

    def get(message: Any) -> int | None:
        s, ns = seconds.get(message), nanoseconds.get(message)
        if isinstance(s, Reason) or isinstance(ns, Reason):
            return None
        return int(s) * 1_000_000_000 + int(ns) or None

    def put(message: Any, stamp: int) -> Reason | None:
        s, ns = divmod(stamp, 1_000_000_000)
        return _put(seconds, message, s) or _put(nanoseconds, message, ns)
    return Stamp(path, None, (seconds, nanoseconds), get, put)


def _count(number: Accessor, unit: int) -> Stamp:
    find = compile_holder(number.steps)  # for a float does not hold every nanosecond
    is_float = number.steps[-1].type.inner in LARGEST_FLOAT

    def get(message: Any) -> int | None:
        value = find(message)
        return None if value is None else to_ns(value, unit)

    def put(message: Any, stamp: int) -> Reason | None:
        # up to the next whole one: so it is newer than what went out, if only by a nanosecond
        return _put(number, message, stamp / unit if is_float else -(-stamp // unit))
    return Stamp(number.path, unit, (number,), get, put)


def _put(number: Accessor, message: Any, value: float) -> Reason | None:
    """Write a number where there is one; an array without its element has no time to be told."""
    return None if isinstance(number.get(message), Reason) else number.put(message, value)
