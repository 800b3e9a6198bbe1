"""
Numbers in and out of ROS messages: ``range``, ``pose.pose.position.x``, ``position[elbow]``.

Everything about a message's type is settled once, at start; what can still go wrong with a single
message (an array too short, a joint that is not there) is a reason, never an exception. Writing
makes room for what is missing where it can: a failed driver may leave its element out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
import difflib
import importlib
import math
import re
from typing import Any

from ament_index_python.resources import get_resource, get_resources, InvalidResourceNameError

from vsensor_ros.bad_input import BadInput

INTERFACES = 'rosidl_interfaces'  # the ament resource that lists a package's messages
NAME_ARRAYS = ('name', 'joint_names')  # fields that give names to the arrays beside them
LONGEST = 2**16  # elements of an array that a message is made room for; an index lies below
LARGEST_FLOAT = {'float': 3.4028234663852886e38, 'double': math.inf}

_TYPE = re.compile(r'([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)')
_STEP = re.compile(r'([A-Za-z][A-Za-z0-9_]*)(?:\[([^\[\]]+)\])?')  # field, field[element]
_PATH = re.compile(rf'(?:{_STEP.pattern})(?:\.(?:{_STEP.pattern}))*')
_INTEGER = re.compile(r'(u?)int(8|16|32|64)')
_SEQUENCE = re.compile(r'sequence<(.+?)(?:, (\d+))?>')
_ARRAY = re.compile(r'(.+)\[(\d+)\]')
_ANY = 2**63  # the size of an array that has no fixed one

Parent = Callable[[Any], Any]  # message -> the object that holds the field, None when missing


@dataclass(frozen=True)
class Accessor:
    """One numeric field of a message type, compiled."""

    path: str  # as configured
    get: Callable[[Any], float | str]  # the number, or the reason why there is none
    put: Callable[[Any, float], str | None]  # None when written, or the reason why it was not
    absent: Callable[[Any], bool]  # lacks the name of it; may be sound all the same
    names: Callable[[Any], Collection[str]]  # those among which its name is, or should be


def message_type(name: str, where: str = 'message type', key: str = 'type') -> Any:
    """
    Return the class of a ROS message given as ``package/msg/Name``.

    Only interfaces listed in the ament index are imported. Raises BadInput.
    """
    match = _TYPE.fullmatch(name)
    if match is None:
        raise BadInput(where, key, f'{name!r:.80} is not a message type',
                       "write it like 'sensor_msgs/msg/Range'")
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


def has_stamp(kind: Any) -> bool:
    """Tell whether a message type begins with a header, hence has a stamp."""
    return kind.get_fields_and_field_types().get('header') == 'std_msgs/Header'


def get_stamp(message: Any) -> int:
    """Return the header's stamp in ns."""
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def put_stamp(message: Any, stamp: int) -> None:
    """Write the header's stamp, given in ns."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)


def compile_accessor(kind: Any, path: str, where: str = 'field', key: str = 'field') -> Accessor:
    """
    Compile a dotted field of a message class into a getter and a setter.

    ``a.b`` goes into a field, ``data[2]`` into an array, ``position[elbow]`` into the array whose
    elements the field ``name`` (or ``joint_names``) beside it names. Raises BadInput, listing the
    fields there are.
    """
    if _PATH.fullmatch(path) is None:
        raise BadInput(where, key, f'{path!r:.80} is not a field',
                       'write it like range, pose.position.x, data[2] or position[elbow]')
    steps = [step.groups() for step in _STEP.finditer(path)]
    parent: Parent = _itself
    absent: Callable[[Any], bool] = _never
    names: Callable[[Any], Collection[str]] = _none
    for depth, (field, element) in enumerate(steps):
        fields = kind.get_fields_and_field_types()
        if field not in fields:
            raise BadInput(where, key, f'{_name(kind)} has no field {field}',
                           f'its fields are {", ".join(fields)}')
        inner = fields[field]
        array = _SEQUENCE.fullmatch(inner) or _ARRAY.fullmatch(inner)
        if array is not None and element is None:
            raise BadInput(where, key, f'{field} of {_name(kind)} is an array',
                           f'say which element: {field}[0]' + (
                               f', or {field}[a name]' if _name_array(fields) else ''))
        if array is None and element is not None:
            raise BadInput(where, key, f'{field} of {_name(kind)} is not an array',
                           'leave out the brackets')
        index: _Index | None = None
        if array is not None:
            inner, size = array.groups()
            index, beside = _compile_index(
                kind, fields, field, element, int(size or _ANY), where, key)
            if beside is not None:
                absent, names = _absence(absent, parent, index), _names(parent, beside)
        if depth == len(steps) - 1:
            room = None
            if array is not None and array.re is _SEQUENCE and inner in LARGEST_FLOAT:
                room = _Room(fields, field, element, beside)
            return _leaf(path, parent, field, index, inner, room, absent, names, where, key)
        if '/' not in inner:
            raise BadInput(where, key, f'{field} of {_name(kind)} is a {inner}, which has no '
                           'fields', f'end the field at {field}')
        parent = _descend(parent, field, index)
        kind = message_type(inner.replace('/', '/msg/'), where, key)
    raise AssertionError('unreachable: the last step returns')


_Index = Callable[[Any], int]  # the object that holds the array -> the index, -1 when not there


def _itself(message: Any) -> Any:
    return message


def _never(message: Any) -> bool:
    return False


def _none(message: Any) -> Collection[str]:
    return ()


def _names(parent: Parent, field: str) -> Callable[[Any], Collection[str]]:
    def names(message: Any) -> Collection[str]:
        holder = parent(message)
        return () if holder is None else getattr(holder, field)
    return names


def _absence(before: Callable[[Any], bool], parent: Parent,
             index: _Index) -> Callable[[Any], bool]:
    def absent(message: Any) -> bool:
        holder = parent(message)
        return before(message) or (holder is not None and index(holder) < 0)
    return absent


def _name(kind: Any) -> str:
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'


def _name_array(fields: dict[str, str]) -> str | None:
    return next((name for name in NAME_ARRAYS if fields.get(name) == 'sequence<string>'), None)


def _compile_index(kind: Any, fields: dict[str, str], field: str, element: str, size: int,
                   where: str, key: str) -> tuple[_Index, str | None]:
    """Return the function that finds the element, and the field of names if it does by name."""
    if re.fullmatch(r'-?[0-9]+', element):
        index = int(element[:20])
        size = min(size, LONGEST)
        if not 0 <= index < size:
            raise BadInput(where, key, f'{field} of {_name(kind)} has no element {element:.20}',
                           f'its indices are 0 to {size - 1}' if index >= 0 else
                           'indices begin at 0')
        return lambda holder: index, None
    names_field = _name_array(fields)
    if names_field is None:
        raise BadInput(where, key, f'the elements of {field} of {_name(kind)} have no names',
                       f'give an index from 0: {field}[0]')
    last = 0

    def find(holder: Any) -> int:
        nonlocal last  # names keep their places, mostly
        names = getattr(holder, names_field)
        if last < len(names) and names[last] == element:
            return last
        try:
            last = names.index(element)
        except ValueError:
            return -1
        return last

    return find, names_field


def _descend(parent: Parent, field: str, index: _Index | None) -> Parent:
    if index is None:
        def inside(message: Any) -> Any:
            holder = parent(message)
            return None if holder is None else getattr(holder, field)
        return inside

    def element(message: Any) -> Any:
        holder = parent(message)
        if holder is None:
            return None
        i = index(holder)
        array = getattr(holder, field)
        return array[i] if 0 <= i < len(array) else None
    return element


@dataclass(frozen=True)
class _Room:
    """How to make room for one element of an array of floats."""

    fields: dict[str, str]
    field: str
    element: str
    names: str | None  # the field of names, when the element is found by its name

    def make(self, holder: Any) -> int:
        """Lengthen the array with NaN, and those beside it when a name is added; return where."""
        if self.names is None:
            index = int(self.element)
            grown = [self.field]
        else:
            names = getattr(holder, self.names)
            if self.element not in names:
                names.append(self.element)
                grown = [f for f, kind in self.fields.items()  # an empty one means: not known
                         if f != self.field and (m := _SEQUENCE.fullmatch(kind))
                         and m[1] in LARGEST_FLOAT and len(getattr(holder, f))]
            else:
                grown = []
            index = names.index(self.element)
            grown.append(self.field)
        for field in grown:
            array = getattr(holder, field)
            array.extend([math.nan] * (index + 1 - len(array)))
        return index


def _leaf(path: str, parent: Parent, field: str, index: _Index | None, kind: str,
          room: _Room | None, absent: Callable[[Any], bool],
          names: Callable[[Any], Collection[str]], where: str, key: str) -> Accessor:
    convert = _conversion(kind)
    if convert is None:
        raise BadInput(where, key, f'{path} is a {kind}, not a number',
                       f'name a field below {path}' if '/' in kind else 'name a numeric field')
    missing = f'{path} is not in the message'

    if index is None:
        def get(message: Any) -> float | str:
            holder = parent(message)
            return missing if holder is None else float(getattr(holder, field))

        def put(message: Any, value: float) -> str | None:
            holder = parent(message)
            if holder is None:
                return missing
            converted = convert(value)
            if converted is None:
                return f'{value:g} does not fit into {path} ({kind})'
            setattr(holder, field, converted)
            return None
        return Accessor(path, get, put, absent, names)

    too_short = f'the array is too short for {path}'

    def get_element(message: Any) -> float | str:
        holder = parent(message)
        i = -1 if holder is None else index(holder)
        if i < 0:
            return missing
        array = getattr(holder, field)
        return float(array[i]) if i < len(array) else too_short

    def put_element(message: Any, value: float) -> str | None:
        holder = parent(message)
        if holder is None:
            return missing
        converted = convert(value)
        if converted is None:
            return f'{value:g} does not fit into {path} ({kind})'
        i = index(holder)
        if not 0 <= i < len(getattr(holder, field)):
            if room is None:
                return missing if i < 0 else too_short
            i = room.make(holder)
        getattr(holder, field)[i] = converted
        return None
    return Accessor(path, get_element, put_element, absent, names)


def _conversion(kind: str) -> Callable[[float], float | int | None] | None:
    """Return what turns a float into the field's type (None: does not fit); None if no number."""
    if kind in LARGEST_FLOAT:
        largest = LARGEST_FLOAT[kind]

        def to_float(value: float) -> float | None:
            value = float(value)  # a numpy scalar is refused by the checks of the messages
            return None if largest < abs(value) < math.inf else value  # what was read passes
        return to_float
    match = _INTEGER.fullmatch(kind)
    if match is None:
        return None
    unsigned, bits = bool(match[1]), int(match[2])
    low = 0 if unsigned else -2**(bits - 1)
    high = 2**bits - 1 if unsigned else 2**(bits - 1) - 1

    def to_integer(value: float) -> int | None:
        if not math.isfinite(value):
            return None
        whole = round(value)
        return whole if low <= whole <= high else None
    return to_integer
