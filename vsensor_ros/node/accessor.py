"""
Numbers in and out of ROS messages: ``range``, ``pose.pose.position.x``, ``position[elbow]``.

Everything about a message's type is settled once, at start (see `trace`); what can still go wrong
with a single message (an array too short, a joint that is not there) is a reason, never an
exception. Writing makes room for what is missing where it can: a failed driver may leave its
element out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
import math
from typing import Any

from vsensor_ros.node.field_path import (
    field_type,
    inner_type,
    INTEGER,
    LARGEST_FLOAT,
    message_type,
    NAME_ARRAYS,
    Step,
    trace,
)
from vsensor_ros.node.orientation import EulerAngle
from vsensor_ros.node.room import fillable, lengthen, named_arrays
from vsensor_ros.reason import Reason

__all__ = ['LARGEST_FLOAT', 'NAME_ARRAYS', 'Accessor', 'Step', 'compile_accessor',
           'compile_holder', 'field_type', 'get_stamp', 'has_stamp', 'inner_type', 'message_type',
           'put_stamp', 'trace']

NOT_THERE, TOO_SHORT = 'not in the message', 'too short'  # codes of reasons

Find = Callable[[Any], Any]  # message -> an object in it, None when missing
Index = Callable[[Any], int]  # message -> the index of an element, -1 when not there
Steps = tuple[Step, ...]


@dataclass(frozen=True)
class Mark:
    """What in a message says that a number of it is none. See `heed_marks`."""

    text: str  # for people
    looks_at: tuple[Steps, ...]  # to the numbers that tell
    # of these numbers: the least and the largest value that is a reading
    bounds: Callable[..., tuple[float, float]]
    remove: Callable[[Any, float], None]  # from a message that has it, for what is to be written

    def is_on(self, numbers: Sequence[float], value: float) -> bool:
        """Tell whether these numbers make none of a value; NaN is none by itself."""
        low, high = self.bounds(*numbers)
        return value < low or value > high


@dataclass(frozen=True)
class Accessor:
    """One numeric field of a message type, compiled."""

    path: str  # as configured
    steps: Steps
    get: Callable[[Any], float | Reason]  # the number, or the reason why there is none
    put: Callable[[Any, float], Reason | None]  # None when written, or the reason why it was not
    fit: Callable[[float], float | int | Reason]  # what the field would hold, or why it cannot
    absent: Callable[[Any], bool]  # lacks the name of it; may be sound all the same
    names: Callable[[Any], Collection[str]]  # those among which its name is, or should be
    marks: tuple[Mark, ...] = ()  # those that `get` heeds
    angle: EulerAngle | None = None  # that it is, of the quaternion in which the steps end


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
    """Compile a dotted field of a message class (see `trace`). Raises BadInput."""
    steps = trace(kind, path, where, key)
    named = [(compile_holder(steps[:depth]), compile_names(steps[:depth + 1]), step.name)
             for depth, step in enumerate(steps) if step.name is not None]

    def absent(message: Any) -> bool:
        return any(find(message) is not None and name not in (there(message) or ())
                   for find, there, name in named)

    def names(message: Any) -> Collection[str]:
        return (named[-1][1](message) or ()) if named else ()

    get, put, fit = _leaf(path, steps)
    if not steps[-1].angle:
        return Accessor(path, steps, get, put, fit, absent, names)
    angle = EulerAngle(steps[-1].angle, path)
    get, put = _angle_leaf(steps, angle, get, put)
    return Accessor(path, steps, get, put, fit, absent, names, angle=angle)


def compile_holder(steps: Sequence[Step]) -> Find:
    """Return what finds the object that these steps lead to, from the message."""
    ways = [(step.field, _compile_index(steps[:depth + 1]) if step.type.is_array else None)
            for depth, step in enumerate(steps)]

    def find(message: Any) -> Any:
        here = message
        for field, index in ways:
            value = getattr(here, field)
            if index is not None:
                i = index(message)
                if not 0 <= i < len(value):
                    return None
                value = value[i]
            here = value
        return here
    return find


def owner_of_names(steps: Sequence[Step]) -> Sequence[Step]:
    """Return the steps to the object that names the elements of the array at the last step."""
    return steps[:-2] if steps[-1].above else steps[:-1]


def compile_names(steps: Sequence[Step]) -> Callable[[Any], list[str] | None]:
    """Return what finds the names of the elements of the array at the last step."""
    find, names = compile_holder(owner_of_names(steps)), steps[-1].names
    assert names is not None

    def found(message: Any) -> list[str] | None:
        owner = find(message)
        return None if owner is None else getattr(owner, names)
    return found


def _compile_index(steps: Sequence[Step]) -> Index:
    index, name = steps[-1].index, steps[-1].name
    if index is not None:
        return lambda message: index
    assert name is not None
    names = compile_names(steps)

    def find(message: Any) -> int:
        try:
            return (names(message) or []).index(name)
        except ValueError:
            return -1
    return find


def _compile_room(steps: Sequence[Step]) -> Callable[[Any], bool]:
    """
    Return what gives the array at the last step the element that is meant; False: it cannot.

    Its name is added if need be; then the arrays beside it grow, too. An empty one stays so.
    """
    step, find, owner = steps[-1], compile_holder(steps[:-1]), None
    if step.names is not None:
        owner = compile_holder(owner_of_names(steps))
    growing = step.type.is_sequence and fillable(step.type) and (
        step.names is not None or step.type.inner in LARGEST_FLOAT)

    def make_room(message: Any) -> bool:
        holder = find(message)
        if holder is None or not growing:
            return False
        count = 0 if step.index is None else step.index + 1
        if owner is not None and step.names is not None:
            there = owner(message)
            names = getattr(there, step.names)
            if step.name is not None and step.name not in names:
                names.append(step.name)
                for beside, field, of in named_arrays(there, step):
                    if len(getattr(beside, field)):  # an empty one means: not known
                        lengthen(beside, field, of, len(names))
            count = max(count, len(names))
        lengthen(holder, step.field, step.type, count)
        return True
    return make_room


def _leaf(path: str, steps: Sequence[Step]) -> tuple[
        Callable[[Any], float | Reason], Callable[[Any, float], Reason | None],
        Callable[[float], float | int | Reason]]:
    """Return get, put and fit of the field at the end of a path."""
    find, last = compile_holder(steps[:-1]), steps[-1]
    field = last.field
    index = _compile_index(steps) if last.type.is_array else None
    names = None if last.name is None else compile_names(steps)

    def places(message: Any) -> list[int]:
        """Return where the element stands: more than once if its driver says a name twice."""
        if names is not None:
            return [i for i, name in enumerate(names(message) or ()) if name == last.name]
        return [] if index is None else [index(message)]
    rooms = [(compile_holder(steps[:depth + 1]), _compile_room(steps[:depth + 1]))
             for depth, step in enumerate(steps) if step.type.is_array]
    missing, too_short = Reason.of(NOT_THERE, field=path), Reason.of(TOO_SHORT, field=path)
    convert = _conversion(last.type.inner)

    def get(message: Any) -> float | Reason:
        holder = find(message)
        if holder is None:
            return missing
        value = getattr(holder, field)
        if index is None:
            return float(value)
        i = index(message)
        if i < 0:
            return missing
        return float(value[i]) if i < len(value) else too_short

    def fit(value: float) -> float | int | Reason:
        fitted = convert(value)
        return Reason.of('does not fit', value=f'{value:g}', field=path, type=last.type.inner) \
            if fitted is None else fitted

    def put(message: Any, value: float) -> Reason | None:
        fitted = fit(value)
        if isinstance(fitted, Reason):
            return fitted
        lack = get(message)
        if isinstance(lack, Reason) and not all(
                there(message) is not None or make_room(message) for there, make_room in rooms):
            return lack
        holder = find(message)
        if index is None:
            setattr(holder, field, fitted)
        else:
            array = getattr(holder, field)
            for i in places(message):
                if i < len(array):
                    array[i] = fitted
        return None

    return get, put, fit


def _angle_leaf(
        steps: Sequence[Step], angle: EulerAngle, get_component: Callable[[Any], float | Reason],
        put_component: Callable[[Any, float], Reason | None],
        ) -> tuple[Callable[[Any], float | Reason], Callable[[Any, float], Reason | None]]:
    """Return get and put of an angle, given those of the component at the end of its path."""
    find = compile_holder(steps[:-1])

    def get(message: Any) -> float | Reason:
        q = find(message)
        return get_component(message) if q is None else angle.read((q.x, q.y, q.z, q.w))

    def put(message: Any, value: float) -> Reason | None:
        if find(message) is None:  # room is made
            problem = put_component(message, math.nan)
            if problem is not None:
                return problem
        q = find(message)
        q.x, q.y, q.z, q.w = angle.changed((q.x, q.y, q.z, q.w), float(value))
        return None

    return get, put


def _conversion(kind: str) -> Callable[[float], float | int | None]:
    """Return what turns a float into a number of the field's type (None: it does not fit)."""
    if kind in LARGEST_FLOAT:
        largest = LARGEST_FLOAT[kind]

        def to_float(value: float) -> float | None:
            value = float(value)  # a numpy scalar is refused by the checks of the messages
            return None if largest < abs(value) < math.inf else value  # what was read passes
        return to_float
    match = INTEGER.fullmatch(kind)
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
