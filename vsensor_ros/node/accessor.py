"""
Numbers in and out of ROS messages: ``range``, ``pose.pose.position.x``, ``position[elbow]``.

Everything about a message's type is settled once, at start; what can still go wrong with a single
message (an array too short, a joint that is not there) is a reason, never an exception. Writing
makes room for what is missing where it can: a failed driver may leave its element out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
import difflib
import importlib
import math
import re
from typing import Any, NamedTuple

from ament_index_python.resources import get_resource, get_resources, InvalidResourceNameError

from vsensor_ros.bad_input import BadInput
from vsensor_ros.reason import Reason

INTERFACES = 'rosidl_interfaces'  # the ament resource that lists a package's messages
NAME_ARRAYS = ('name', 'joint_names')  # fields that give names to the arrays beside them
LONGEST = 2**16  # elements of an array that a message is made room for; an index lies below
LARGEST_FLOAT = {'float': 3.4028234663852886e38, 'double': math.inf}
NOT_THERE, TOO_SHORT = 'not in the message', 'too short'  # codes of reasons

_TYPE = re.compile(r'([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)')
_STEP = re.compile(r'([A-Za-z][A-Za-z0-9_]*)(?:\[([^\[\]]+)\])?')  # field, field[element]
_PATH = re.compile(rf'(?:{_STEP.pattern})(?:\.(?:{_STEP.pattern}))*')
_INTEGER = re.compile(r'(u?)int(8|16|32|64)')
_SEQUENCE = re.compile(r'sequence<(.+?)(?:, (\d+))?>')
_ARRAY = re.compile(r'(.+)\[(\d+)\]')

Holder = Callable[[Any], Any]  # message -> the object that has the field, None when missing
Index = Callable[[Any], int]  # that object -> the index of the element, -1 when not there


@dataclass(frozen=True)
class Accessor:
    """One numeric field of a message type, compiled."""

    path: str  # as configured
    get: Callable[[Any], float | Reason]  # the number, or the reason why there is none
    put: Callable[[Any, float], Reason | None]  # None when written, or the reason why it was not
    fit: Callable[[float], float | int | Reason]  # what the field would hold, or why it cannot
    absent: Callable[[Any], bool]  # lacks the name of it; may be sound all the same
    names: Callable[[Any], Collection[str]]  # those among which its name is, or should be


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
    element: str | None  # as configured: an index or a name
    names: str | None  # the field that has the names, when the element is found by its name


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


def field_type(text: str) -> FieldType:
    """Take a type apart as ``get_fields_and_field_types`` writes it."""
    if match := _SEQUENCE.fullmatch(text):
        return FieldType(match[1], True, True, int(match[2]) if match[2] else None)
    if match := _ARRAY.fullmatch(text):
        return FieldType(match[1], True, False, int(match[2]))
    return FieldType(text, False, False, None)


def inner_type(inner: str, where: str = 'message type', key: str = 'type') -> Any:
    """Return the message class of a field whose type is itself a message. Raises BadInput."""
    return message_type(inner.replace('/', '/msg/'), where, key)


def trace(kind: Any, path: str, where: str = 'field', key: str = 'field') -> tuple[Step, ...]:
    """
    Follow a dotted field of a message class down to a number.

    ``a.b`` goes into a field, ``data[2]`` into an array, ``position[elbow]`` into the array whose
    elements the field ``name`` (or ``joint_names``) beside it names. Raises BadInput, listing the
    fields there are.
    """
    if _PATH.fullmatch(path) is None:
        raise BadInput(where, key, f'{path!r:.80} is not a field',
                       'write it like range, pose.position.x, data[2] or position[elbow]')
    steps: list[Step] = []
    for field, element in (step.groups() for step in _STEP.finditer(path)):
        if steps:
            inner = steps[-1].type.inner
            if '/' not in inner:
                before = steps[-1].field
                raise BadInput(where, key, f'{before} of {_name(kind)} is a {inner}, which has '
                               'no fields', f'end the field at {before}')
            kind = inner_type(inner, where, key)
        steps.append(_step(kind, field, element, where, key))
    inner = steps[-1].type.inner
    if inner not in LARGEST_FLOAT and not _INTEGER.fullmatch(inner):
        raise BadInput(where, key, f'{path} is a {inner}, not a number',
                       f'name a field below {path}' if '/' in inner else 'name a numeric field')
    return tuple(steps)


def _step(kind: Any, field: str, element: str | None, where: str, key: str) -> Step:
    fields = kind.get_fields_and_field_types()
    if field not in fields:
        raise BadInput(where, key, f'{_name(kind)} has no field {field}',
                       f'its fields are {", ".join(fields)}')
    split = field_type(fields[field])
    names = next((name for name in NAME_ARRAYS if fields.get(name) == 'sequence<string>'), None)
    if element is None:
        if split.is_array:
            raise BadInput(where, key, f'{field} of {_name(kind)} is an array',
                           f'say which element: {field}[0]' +
                           (f', or {field}[a name]' if names else ''))
        return Step(kind, field, split, None, None)
    if not split.is_array:
        raise BadInput(where, key, f'{field} of {_name(kind)} is not an array',
                       'leave out the brackets')
    if not re.fullmatch(r'-?[0-9]+', element):
        if names is None:
            raise BadInput(where, key, f'the elements of {field} of {_name(kind)} have no names',
                           f'give an index from 0: {field}[0]')
        return Step(kind, field, split, element, names)
    index = int(element[:20])
    size = LONGEST if split.size is None else min(split.size, LONGEST)
    if not 0 <= index < size:
        raise BadInput(where, key, f'{field} of {_name(kind)} has no element {element:.20}',
                       f'its indices are 0 to {size - 1}' if index >= 0 else 'indices begin at 0')
    return Step(kind, field, split, element, None)


def _name(kind: Any) -> str:
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'


def compile_accessor(kind: Any, path: str, where: str = 'field', key: str = 'field') -> Accessor:
    """Compile a dotted field of a message class (see `trace`). Raises BadInput."""
    steps = trace(kind, path, where, key)
    named = [(compile_holder(steps[:depth]), _compile_index(step), step.names)
             for depth, step in enumerate(steps) if step.names is not None]

    def absent(message: Any) -> bool:
        return any((holder := find(message)) is not None and index(holder) < 0
                   for find, index, _ in named)

    def names(message: Any) -> Collection[str]:
        for find, _, field in reversed(named):
            holder = find(message)
            return () if holder is None else getattr(holder, field)
        return ()

    get, put, fit = _leaf(path, steps)
    return Accessor(path, get, put, fit, absent, names)


def compile_holder(steps: Sequence[Step]) -> Holder:
    """Return what finds the object that these steps lead to, from the message."""
    ways = [(step.field, None if step.element is None else _compile_index(step))
            for step in steps]

    def find(message: Any) -> Any:
        for field, index in ways:
            value = getattr(message, field)
            if index is not None:
                i = index(message)
                if not 0 <= i < len(value):
                    return None
                value = value[i]
            message = value
        return message
    return find


def _compile_index(step: Step) -> Index:
    element, field = step.element, step.names
    assert element is not None
    if field is None:
        number = int(element)
        return lambda holder: number

    def find(holder: Any) -> int:
        try:
            return getattr(holder, field).index(element)
        except ValueError:
            return -1
    return find


def _make_room(holder: Any, step: Step) -> int:
    """Lengthen the array with NaN, and those beside it when a name is added; return where."""
    assert step.element is not None
    grown = [step.field]
    if step.names is None:
        index = int(step.element)
    else:
        names = getattr(holder, step.names)
        if step.element not in names:
            names.append(step.element)
            grown += [field for field, text in holder.get_fields_and_field_types().items()
                      if (split := field_type(text)).is_sequence and split.inner in LARGEST_FLOAT
                      and len(getattr(holder, field))]  # an empty one means: not known
        index = names.index(step.element)
    for field in grown:
        array = getattr(holder, field)
        array.extend([math.nan] * (index + 1 - len(array)))
    return index


def _leaf(path: str, steps: Sequence[Step]) -> tuple[
        Callable[[Any], float | Reason], Callable[[Any, float], Reason | None],
        Callable[[float], float | int | Reason]]:
    """Return get, put and fit of the field at the end of a path."""
    find, last = compile_holder(steps[:-1]), steps[-1]
    field = last.field
    index = None if last.element is None else _compile_index(last)
    growing = last.type.is_sequence and last.type.inner in LARGEST_FLOAT
    missing, too_short = Reason.of(NOT_THERE, field=path), Reason.of(TOO_SHORT, field=path)
    convert = _conversion(last.type.inner)

    def get(message: Any) -> float | Reason:
        holder = find(message)
        if holder is None:
            return missing
        value = getattr(holder, field)
        if index is None:
            return float(value)
        i = index(holder)
        if i < 0:
            return missing
        return float(value[i]) if i < len(value) else too_short

    def fit(value: float) -> float | int | Reason:
        fitted = convert(value)
        return Reason.of('does not fit', value=f'{value:g}', field=path, type=last.type.inner) \
            if fitted is None else fitted

    def put(message: Any, value: float) -> Reason | None:
        holder = find(message)
        if holder is None:
            return missing
        fitted = fit(value)
        if isinstance(fitted, Reason):
            return fitted
        if index is None:
            setattr(holder, field, fitted)
            return None
        i = index(holder)
        if not 0 <= i < len(getattr(holder, field)):
            if not growing:
                return missing if i < 0 else too_short
            i = _make_room(holder, last)
        getattr(holder, field)[i] = fitted
        return None

    return get, put, fit


def _conversion(kind: str) -> Callable[[float], float | int | None]:
    """Return what turns a float into a number of the field's type (None: it does not fit)."""
    if kind in LARGEST_FLOAT:
        largest = LARGEST_FLOAT[kind]

        def to_float(value: float) -> float | None:
            value = float(value)  # a numpy scalar is refused by the checks of the messages
            return None if largest < abs(value) < math.inf else value  # what was read passes
        return to_float
    match = _INTEGER.fullmatch(kind)
    assert match is not None, 'trace lets numbers pass only'
    unsigned, bits = bool(match[1]), int(match[2])
    low = 0 if unsigned else -2**(bits - 1)
    high = 2**bits - 1 if unsigned else 2**(bits - 1) - 1

    def to_integer(value: float) -> int | None:
        if not math.isfinite(value):
            return None
        whole = round(value)
        return whole if low <= whole <= high else None
    return to_integer
