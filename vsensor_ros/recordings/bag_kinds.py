"""
Message classes made of a bag's own type definitions, so that nothing need be installed.

They have what the accessors ask of a class: its name, its fields with their types, its constants.
A bag's definitions are data: no code is made of them here.
"""

from __future__ import annotations

from collections.abc import Mapping
import struct
from typing import Any

from vsensor_ros.node.cdr_walk import BODY, LENGTH, LETTERS
from vsensor_ros.node.field_path import field_type, inner_type

_NAMES = {'bool': 'boolean', 'byte': 'octet', 'char': 'uint8', 'float32': 'float',
          'float64': 'double'}
_LETTERS = {**LETTERS, 'octet': 'B'}


class RecordedMessage:
    """A message as a bag defines it."""

    _fields: Mapping[str, str] = {}

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Return the types of the fields, as generated classes do."""
        return dict(cls._fields)


def kinds_of(definitions: Mapping[str, Any]) -> dict[str, Any]:
    """Return a class for each name (package/msg/Name) of the `fielddefs` of a rosbags store."""
    kinds = {}
    for name, (constants, fields) in definitions.items():
        package, _, short = name.partition('/msg/')
        if short:
            kinds[name] = type(short, (RecordedMessage,), {
                **{constant: value for constant, _, value in constants if constant.isupper()},
                '__module__': f'{package}.msg',
                '_fields': {field: _type_text(of) for field, of in fields}})
    return kinds


def _type_text(of: Any) -> str:
    """Return a type as ROS writes it: ``double``, ``sequence<double>``, ``std_msgs/Header``."""
    node, what = of
    if node.name == 'BASE':
        return _NAMES.get(what[0], what[0])
    if node.name == 'NAME':
        return str(what).replace('/msg/', '/')
    inner, size = what
    if node.name == 'ARRAY':
        return f'{_type_text(inner)}[{size}]'
    return f'sequence<{_type_text(inner)}, {size}>' if size else f'sequence<{_type_text(inner)}>'


def decode(kind: Any, raw: bytes) -> Any:
    """
    Return the message of such a class in bytes of CDR; None when they are not one.

    To be called while the classes are `standing_in`. It is for a look: to read many, use `Reader`.
    """
    try:
        return _message(kind, raw, BODY)[0]
    except (struct.error, KeyError, ValueError):  # too short; of a type that nobody reads here
        return None


def _message(kind: Any, raw: bytes, at: int) -> tuple[Any, int]:
    found = kind()
    fields = kind.get_fields_and_field_types()
    for name, text in fields.items():
        of = field_type(text)
        if not of.is_array:
            value, at = _value(of.inner, raw, at)
        else:
            count = of.size or 0
            if of.is_sequence:
                count, at = _length(raw, at)
            value, at = _array(of.inner, raw, at, count)
        setattr(found, name, value)
    return found, at if fields else at + 1


def _value(inner: str, raw: bytes, at: int) -> tuple[Any, int]:
    if inner == 'string':
        count, at = _length(raw, at)
        return raw[at:at + count].split(b'\0')[0].decode('utf-8', 'replace'), at + count
    if '/' in inner:
        return _message(inner_type(inner), raw, at)
    values, at = _array(inner, raw, at, 1)
    return values[0], at


def _array(inner: str, raw: bytes, at: int, count: int) -> tuple[Any, int]:
    if count > len(raw):
        raise ValueError(f'{count} elements')
    if inner == 'string' or '/' in inner:
        values = []
        for _ in range(count):
            value, at = _value(inner, raw, at)
            values.append(value)
        return values, at
    form = f'<{count}{_LETTERS[inner]}'
    if count:
        at += (BODY - at) % struct.calcsize('<' + _LETTERS[inner])
    return struct.unpack_from(form, raw, at), at + struct.calcsize(form)


def _length(raw: bytes, at: int) -> tuple[int, int]:
    at += -at % 4
    return LENGTH.unpack_from(raw, at)[0], at + 4


def cdr_of(kind: Any, raw: bytes) -> bytes:
    """
    Return a message of ROS 1 as CDR; of bytes that are none, bytes that are none.

    ROS 1 writes the same numbers in the same order, but packed, and texts without a zero at the
    end. To be called while the classes are `standing_in`.
    """
    made = bytearray(b'\0\1\0\0')
    try:
        at = _append_message(kind, raw, 0, made)
    except (struct.error, KeyError):
        return b''
    return bytes(made) if at <= len(raw) else b''


def _append_message(kind: Any, raw: bytes, at: int, made: bytearray) -> int:
    for text in kind.get_fields_and_field_types().values():
        of = field_type(text)
        count = 1 if not of.is_array else of.size or 0
        if of.is_sequence:
            count, at = LENGTH.unpack_from(raw, at)[0], at + 4
            _append_length(count, made)
        if count > len(raw):
            raise struct.error('ends early')
        at = _append(of.inner, raw, at, count, made)
        if at > len(raw):
            raise struct.error('ends early')
    return at


def _append(inner: str, raw: bytes, at: int, count: int, made: bytearray) -> int:
    if inner == 'string':
        for _ in range(count):
            length, at = LENGTH.unpack_from(raw, at)[0], at + 4
            _append_length(length + 1, made)
            made += raw[at:at + length] + b'\0'
            at += length
        return at
    if '/' in inner:
        for _ in range(count):
            at = _append_message(inner_type(inner), raw, at, made)
        return at
    size = struct.calcsize('<' + _LETTERS[inner])
    if count:
        made += bytes((BODY - len(made)) % size)
    made += raw[at:at + count * size]
    return at + count * size


def _append_length(length: int, made: bytearray) -> None:
    made += bytes(-len(made) % 4)
    made += LENGTH.pack(length)
