"""
What a message marks as not there, which is no reading, whatever number stands in its place.

The marks are those of sensor_msgs, geometry_msgs and nav_msgs, found by the shape of the type:

- a covariance whose first element is negative, or that of the number itself: Imu, MagneticField,
  NavSatFix, Odometry and all of the types ...WithCovariance; a negative ``variance``: Range, ...;
- a ``range`` beyond ``min_range`` and ``max_range``, ``ranges`` beyond ``range_min`` and
  ``range_max``, where these are given: Range, LaserScan, MultiEchoLaserScan;
- a ``status`` without a fix: NavSatFix;
- ``present: false`` of a BatteryState, a time of 0, a cell -1 of an OccupancyGrid.

Drivers leave some fields as the type has them: present false, a status that is not set. Such a
mark counts only of a driver that has set the field before.

An estimate that takes the place of a marked number must not carry the mark on. It is taken away
from the message, and what else it was on becomes NaN.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
import math
from typing import Any

from vsensor_ros.node.accessor import Accessor, compile_holder, Mark, Steps
from vsensor_ros.node.field_path import inner_type, INTEGER, LARGEST_FLOAT, step_into
from vsensor_ros.node.room import forget
from vsensor_ros.node.variance import GEODETIC, has_variance, matrix_of, POSITION
from vsensor_ros.reason import Reason

NOISE = -1e-9  # a computed variance may be a little below 0; a mark is -1
LIMITS = {'range': ('min_range', 'max_range'), 'ranges': ('range_min', 'range_max')}
MEASURED = ('voltage', 'temperature', 'current', 'charge', 'percentage')  # of a BatteryState
DISOWNED = 'disowned'  # code of the reason
ALL, NONE = (-math.inf, math.inf), (math.inf, -math.inf)  # the values that are readings
UNSURE = (-math.inf, math.inf)  # all so far; what else the message says may be different next time


def heed_marks(accessor: Accessor) -> Accessor:
    """Return an accessor that takes nothing that a message marks as not there for a number."""
    marks = tuple(mark for find in (_covariance, _variance, _limits, _fix, _battery, _time, _cell)
                  for mark in find(accessor.steps))
    if not marks:
        return accessor
    found = [(mark, _compile(mark), Reason.of(DISOWNED, field=accessor.path, mark=mark.text))
             for mark in marks]

    def get(message: Any) -> float | Reason:
        value = accessor.get(message)
        if isinstance(value, float):
            for mark, numbers, reason in found:
                if mark.is_on(numbers(message), value):
                    return reason
        return value
    return replace(accessor, get=get, marks=marks)


def compile_remover(accessor: Accessor) -> Callable[[Any, float], None]:
    """Return what takes the marks of a field from a message, before a value is written there."""
    found = [(mark, _compile(mark)) for mark in accessor.marks]

    def remove(message: Any, value: float) -> None:
        if isinstance(accessor.fit(value), Reason):
            return  # nor will it be written
        for mark, numbers in found:
            there = numbers(message)
            if None not in there and mark.is_on(there, value):
                mark.remove(message, value)
    return remove


def _compile(mark: Mark) -> Callable[[Any], list[Any]]:
    finders = [compile_holder(steps) for steps in mark.looks_at]
    return lambda message: [find(message) for find in finders]


def not_negative(first: float, *own: float) -> tuple[float, float]:
    """Return what is a reading beside some variances; a negative one says that there is none."""
    return NONE if first < NOISE or any(variance < NOISE for variance in own) else ALL


def _covariance(steps: Steps) -> list[Mark]:
    matrix = matrix_of(steps)
    if matrix is None:
        return []
    kind = inner_type(matrix.holder[-1].type.inner) if matrix.holder else steps[0].kind
    find = compile_holder(matrix.holder)
    places = dict.fromkeys((0, *((matrix.size + 1) * row for row in matrix.rows)))
    beside = steps[len(matrix.holder)].field  # the vector, or the pose, that has the covariance

    def remove(message: Any, value: float) -> None:
        holder = find(message)
        numbers = getattr(holder, matrix.field)
        if numbers[0] < NOISE:  # all that it covers was disowned
            if matrix.field == POSITION:
                _forget(holder, GEODETIC)
            else:
                forget(getattr(holder, beside))
        for place in places:
            numbers[place] = max(numbers[place], 0.0)

    return [Mark(f'{matrix.field} is negative', tuple(
        (*matrix.holder, step_into(kind, matrix.field, place)) for place in places),
        not_negative, remove)]


def _variance(steps: Steps) -> list[Mark]:
    if not has_variance(steps):
        return []
    find = compile_holder(steps[:-1])

    def remove(message: Any, value: float) -> None:
        find(message).variance = 0.0  # not known

    return [Mark('variance is negative', ((*steps[:-1], step_into(steps[-1].kind, 'variance')),),
                 not_negative, remove)]


def _limits(steps: Steps) -> list[Mark]:
    depth = next((depth for depth, step in enumerate(steps) if step.field in LIMITS), 0)
    before, step = steps[:depth], steps[depth]
    low, high = LIMITS.get(step.field, ('', ''))
    fields = step.kind.get_fields_and_field_types()
    if fields.get(low) not in LARGEST_FLOAT or fields.get(high) not in LARGEST_FLOAT:
        return []
    find = compile_holder(before)

    def remove(message: Any, value: float) -> None:
        holder = find(message)
        setattr(holder, low, min(float(value), getattr(holder, low)))
        setattr(holder, high, max(float(value), getattr(holder, high)))

    limits = tuple((*before, step_into(step.kind, limit)) for limit in (low, high))
    return [Mark(f'beyond {low} and {high}', limits, within, remove)]


def within(low: float, high: float) -> tuple[float, float]:
    """Return what is a reading between two limits; equal ones were not filled in."""
    return (low, high) if low < high else ALL


def _fix(steps: Steps) -> list[Mark]:
    last = steps[-1]
    fields = last.kind.get_fields_and_field_types()
    inner = fields.get('status', '')
    status: Any = inner_type(inner) if '/' in inner else None
    if not hasattr(status, 'STATUS_NO_FIX') or last.type.inner not in LARGEST_FLOAT or \
            INTEGER.fullmatch(status.get_fields_and_field_types().get('status', '')) is None:
        return []
    find, was_set = compile_holder(steps[:-1]), _Once()
    no_fix, fix = status.STATUS_NO_FIX, status.STATUS_FIX

    def found(status: float) -> tuple[float, float]:
        return NONE if status == no_fix else was_set.judge(status >= fix)

    def remove(message: Any, value: float) -> None:
        holder = find(message)
        holder.status.status = fix
        _forget(holder, GEODETIC.keys() & fields.keys())

    return [Mark('status: no fix', ((*steps[:-1], step_into(last.kind, 'status'),
                                     step_into(status, 'status')),), found, remove)]


def _battery(steps: Steps) -> list[Mark]:
    last = steps[-1]
    fields = last.kind.get_fields_and_field_types()
    if fields.get('present') != 'boolean' or last.field not in MEASURED or \
            not fields.keys() >= {*MEASURED}:
        return []
    find, was_set = compile_holder(steps[:-1]), _Once()

    def remove(message: Any, value: float) -> None:
        holder = find(message)
        holder.present = True
        _forget(holder, MEASURED)

    return [Mark('present: false', ((*steps[:-1], step_into(last.kind, 'present')),),
                 was_set.judge, remove)]


def _time(steps: Steps) -> list[Mark]:
    kind = steps[-1].kind
    if kind.get_fields_and_field_types() != {'sec': 'int32', 'nanosec': 'uint32'} or \
            kind.__name__ != 'Time':
        return []
    return [Mark('a time of 0', tuple((*steps[:-1], step_into(kind, field))
                                      for field in ('sec', 'nanosec')),
                 lambda seconds, nanoseconds: ALL if seconds or nanoseconds else NONE,
                 _nothing)]


def _cell(steps: Steps) -> list[Mark]:
    last = steps[-1]
    if last.kind.__name__ != 'OccupancyGrid' or last.field != 'data':
        return []
    return [Mark('an unknown cell', (), lambda: (0.0, math.inf), _nothing)]


class _Once:
    """Whether a driver has set a field that others leave as it is."""

    def __init__(self) -> None:
        self.set = False

    def judge(self, now: bool) -> tuple[float, float]:
        """Return what is a reading while it is set, or is not."""
        self.set = self.set or now
        return ALL if now else NONE if self.set else UNSURE


def _forget(holder: Any, fields: Iterable[str]) -> None:
    for field in fields:
        setattr(holder, field, math.nan)


def _nothing(message: Any, value: float) -> None:
    """Take nothing away: the number itself is the mark."""
