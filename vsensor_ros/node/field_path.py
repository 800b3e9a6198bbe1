"""
The way from a message type to a number in it: ``range``, ``data[2]``, ``yaw(orientation)``.

Types are loaded and dotted fields followed once, at start. In brackets stands what element of an
array is meant. A name counts where the type has names for the elements, an index where it has
none. Where both could be meant, quotes make a name of it (``position["1"]``), and # an index
(``position[#1]``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
import difflib
from functools import cache
import importlib
import math
import re
from typing import Any, NamedTuple

from ament_index_python.resources import get_resource, get_resources, InvalidResourceNameError

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.orientation import ANGLES

INTERFACES = 'rosidl_interfaces'  # the ament resource that lists a package's messages
NAME_ARRAYS = ('name', 'joint_names', 'interface_names')  # fields that name what is beside them
LONGEST = 2**16  # elements of an array that a message is made room for; an index lies below
LARGEST_FLOAT = {'float': 3.4028234663852886e38, 'double': math.inf}
INTEGER = re.compile(r'(u?)int(8|16|32|64)')

_TYPE = re.compile(r'([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)')
_ELEMENT = r'"[^"]+"|' r"'[^']+'|" r'[^\[\]"\'][^\[\]]*'
_STEP = re.compile(rf'([A-Za-z][A-Za-z0-9_]*)(?:\[({_ELEMENT})\])?')  # field, field[element]
_ANGLE = re.compile(rf'({"|".join(ANGLES)})\((.*)\)')  # yaw(pose.orientation)
_PATH = re.compile(rf'(?:{_STEP.pattern})(?:\.(?:{_STEP.pattern}))*')
_SEQUENCE = re.compile(r'sequence<(.+?)(?:, (\d+))?>')
_ARRAY = re.compile(r'(.+)\[(\d+)\]')


_standing_in: dict[str, Any] = {}  # see `standing_in`


class FieldType(NamedTuple):
    """The type of a field, taken apart."""

    inner: str  # of the elements, when it is an array
    is_array: bool
    is_sequence: bool  # an array whose length is said in each message
    size: int | None  # of an array, or the most a sequence may have; None: any


@dataclass(frozen=True)
class Step:
    """One step of a path: a field, and an element of it when it is an array."""

    kind: Any  # the message class that has the field
    field: str
    type: FieldType
    index: int | None = None  # of the element
    name: str | None = None  # of the element; either of them, of an array
    names: str | None = None  # the field that has names for its elements, if there are such
    above: bool = False  # that field is not in this message, but in the one that has this
    angle: str = ''  # of ANGLES, of the quaternion of which this is the component for it


def message_type(name: str, where: str = 'message type', key: str = 'type') -> Any:
    """
    Return the class of a ROS message given as ``package/msg/Name``.

    Only interfaces listed in the ament index are imported. Raises BadInput.
    """
    match = _TYPE.fullmatch(name)
    if match is None:
        raise BadInput(where, key, f'{name!r:.80} is not a message type',
                       "write it like 'sensor_msgs/msg/Range'")
    if name in _standing_in:
        return _standing_in[name]
    package, message = match.groups()
    try:
        listing, _ = get_resource(INTERFACES, package)
    except (LookupError, InvalidResourceNameError):
        near = difflib.get_close_matches(package, get_resources(INTERFACES), 1)
        raise BadInput(where, key, f'there is no package of interfaces named {package}',
                       f'did you mean {near[0]}?' if near else
                       'install it, and source its workspace') from None
    except OSError:
        raise BadInput(where, key, 'no ROS installation is found (AMENT_PREFIX_PATH is not set)',
                       'source the workspace first') from None
    messages = {m[1] for m in re.finditer(r'^msg/(\w+)\.\w+$', listing, re.MULTILINE)}
    if message not in messages:
        near = difflib.get_close_matches(message, messages, 1)
        raise BadInput(where, key, f'{package} has no message {message}',
                       f'did you mean {near[0]}?' if near else 'name a message of that package')
    try:
        return getattr(importlib.import_module(f'{package}.msg'), message)
    except ImportError as error:
        raise BadInput(where, key, f'{package} is listed but cannot be loaded ({error})',
                       'build it with Python support and source its workspace') from None


@contextmanager
def standing_in(kinds: Mapping[str, Any]) -> Iterator[None]:
    """
    Let these classes, by name (package/msg/Name), stand in for those that are installed.

    They are of a recording, which has the types of its day. While it lasts, all in this process
    are given them, so it is for the desk.
    """
    _standing_in.update(kinds)
    inner_type.cache_clear()
    try:
        yield
    finally:
        _standing_in.clear()
        inner_type.cache_clear()


def field_type(text: str) -> FieldType:
    """Take a type apart as ``get_fields_and_field_types`` writes it."""
    if match := _SEQUENCE.fullmatch(text):
        return FieldType(match[1], True, True, int(match[2]) if match[2] else None)
    if match := _ARRAY.fullmatch(text):
        return FieldType(match[1], True, False, int(match[2]))
    return FieldType(text, False, False, None)


@cache
def inner_type(inner: str, where: str = 'message type', key: str = 'type') -> Any:
    """Return the message class of a field whose type is itself a message. Raises BadInput."""
    return message_type(inner.replace('/', '/msg/'), where, key)


def trace(kind: Any, path: str, where: str = 'field', key: str = 'field') -> tuple[Step, ...]:
    """
    Follow a dotted field of a message class down to a number.

    ``a.b`` goes into a field, ``data[2]`` into an array, ``position[elbow]`` into the array whose
    elements the field ``name`` (or ``joint_names``) beside it names, or one level above.
    ``yaw(a.b)`` is an angle of the quaternion there; its last step is the component that stands
    for it. Raises BadInput, listing the fields there are.
    """
    if match := _ANGLE.fullmatch(path):
        return _to_angle(kind, match[1], match[2], where, key)
    steps = _follow(kind, path, where, key)
    inner = steps[-1].type.inner
    if inner not in LARGEST_FLOAT and not INTEGER.fullmatch(inner):
        mend = 'name a numeric field'
        if '/' in inner:
            mend = f'write yaw({path}), roll or pitch, or name a field below {path}' \
                if _is_quaternion(inner) else f'name a field below {path}'
        raise BadInput(where, key, f'{path} is a {inner}, not a number', mend)
    return steps


def _to_angle(kind: Any, angle: str, path: str, where: str, key: str) -> tuple[Step, ...]:
    steps = _follow(kind, path, where, key)
    inner = steps[-1].type.inner
    if not _is_quaternion(inner):
        raise BadInput(where, key, f'{path} is a {inner}, which has no {angle}',
                       'name a quaternion, such as pose.pose.orientation')
    return (*steps, Step(inner_type(inner), ANGLES[angle], field_type('double'), angle=angle))


def _is_quaternion(inner: str) -> bool:
    return '/' in inner and inner_type(inner).get_fields_and_field_types() == dict.fromkeys(
        'xyzw', 'double')


def _follow(kind: Any, path: str, where: str, key: str) -> tuple[Step, ...]:
    """Follow a dotted field, to whatever is there."""
    if _PATH.fullmatch(path) is None:
        raise BadInput(where, key, f'{path!r:.80} is not a field',
                       'write it like range, pose.position.x, data[2] or position[elbow]')
    steps: list[Step] = []
    for field, element in (step.groups() for step in _STEP.finditer(path)):
        above = None
        if steps:
            above = kind if steps[-1].name is None else None  # names are used once
            inner = steps[-1].type.inner
            if '/' not in inner:
                before = steps[-1].field
                raise BadInput(where, key, f'{before} of {type_name(kind)} is a {inner}, which '
                               'has no fields', f'end the field at {before}')
            kind = inner_type(inner, where, key)
        steps.append(_step(kind, above, field, element, where, key))
    return tuple(steps)


def step_into(kind: Any, field: str, index: int | None = None) -> Step:
    """Return the step from a message class to a field that it has, or an element of that."""
    return Step(kind, field, field_type(kind.get_fields_and_field_types()[field]), index)


def _step(kind: Any, above: Any, field: str, element: str | None, where: str, key: str) -> Step:
    fields = kind.get_fields_and_field_types()
    if field not in fields:
        raise BadInput(where, key, f'{type_name(kind)} has no field {field}',
                       f'its fields are {", ".join(fields)}')
    split = field_type(fields[field])
    names, is_above = _names_for(kind, above, split)
    if element is None:
        if split.is_array:
            raise BadInput(where, key, f'{field} of {type_name(kind)} is an array',
                           f'say which element: {field}[a name]' if names else
                           f'say which element: {field}[0]')
        return Step(kind, field, split)
    if not split.is_array:
        raise BadInput(where, key, f'{field} of {type_name(kind)} is not an array',
                       'leave out the brackets')
    name = element[1:-1] if element[0] in '"\'' else element
    number = re.fullmatch(r'(#?)(-?[0-9]+)', element)
    if number is None:
        if names is None:
            raise BadInput(where, key, f'the elements of {field} of {type_name(kind)} have no '
                           'names', f'give an index from 0: {field}[0]')
        return Step(kind, field, split, None, name, names, is_above)
    if not is_above and _hands_down(split):
        names = None
    if names is not None and split.is_sequence and not number[1]:
        said = element[:20]
        raise BadInput(where, key, f'{field}[{said}] may be the element that {names} calls '
                       f'{said}, or an index', f'write {field}[{in_brackets(said)}] for the name, '
                       f'{field}[#{said}] for the index')
    index = int(number[2][:20])
    size = LONGEST if split.size is None else min(split.size, LONGEST)
    if not 0 <= index < size:
        raise BadInput(where, key, f'{field} of {type_name(kind)} has no element {element:.20}',
                       f'its indices are 0 to {size - 1}' if index >= 0 else 'indices begin at 0')
    return Step(kind, field, split, index, None, names, is_above)


def in_brackets(name: str) -> str:
    """Return how a name is written in brackets: in quotes, where it needs them."""
    if re.fullmatch(r'[A-Za-z_][^\[\]"\']*', name):
        return name
    return f"'{name}'" if '"' in name else f'"{name}"'


def name_array(kind: Any) -> str | None:
    """Return the field of a message class that has names for others, None when it has none."""
    fields = kind.get_fields_and_field_types()
    return next((name for name in NAME_ARRAYS if fields.get(name) == 'sequence<string>'), None)


def _names_for(kind: Any, above: Any, of: FieldType) -> tuple[str | None, bool]:
    """Return the field that names the elements of an array, and whether it stands one above."""
    if not of.is_array or of.inner == 'string':
        return None, False
    names = name_array(kind)
    if names is None and above is not None:
        names = name_array(above)
        return names, names is not None
    return names, False


def _hands_down(of: FieldType) -> bool:
    """Tell whether names beside an array may be those of arrays in its elements, as of a path."""
    if '/' not in of.inner:
        return False
    inner = inner_type(of.inner)
    return name_array(inner) is None and any(
        field_type(text).is_sequence for text in inner.get_fields_and_field_types().values())


def type_name(kind: Any) -> str:
    """Return the name of a message class as ROS writes it."""
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
