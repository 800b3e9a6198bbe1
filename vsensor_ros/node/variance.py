"""
Where the variance of a number stands in its message, found by the shape of the type.

These are recognised, by names and sizes of fields as sensor_msgs and geometry_msgs use them:

- ``v.x`` beside ``v_covariance``, 3 by 3 in the order x, y, z: Imu, MagneticField;
- ``pose.position.x`` or ``twist.angular.z`` beside ``covariance``, 6 by 6 with position or linear
  before angular: Odometry and all of the types ...WithCovariance;
- ``latitude`` beside ``position_covariance``, 3 by 3 in the order East, North, Up: NavSatFix;
- a float beside ``variance`` that is the only one, or has the name of the type: Range, ...

A component of a quaternion has none: the covariance of an orientation is that of roll, pitch and
yaw, as ``yaw(orientation)`` is written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
import re
import sys
from typing import Any, NamedTuple

from vsensor_ros.node.accessor import compile_holder
from vsensor_ros.node.field_path import Step, trace

SetVariance = Callable[[Any, float], None]  # message, standard deviation in the field's unit

AXES = {'x': 0, 'y': 1, 'z': 2}
QUATERNION = {*AXES, 'w'}
BLOCKS = {'position': 0, 'orientation': 3, 'linear': 0, 'angular': 3}  # of a 6 by 6 covariance
POSITION = 'position_covariance'
GEODETIC = {'longitude': 0, 'latitude': 1, 'altitude': 2}
TYPE_UNKNOWN, TYPE_DIAGONAL_KNOWN = 0, 2  # of a position_covariance_type
WGS84_RADIUS, WGS84_E2 = 6378137.0, 6.69437999014e-3  # m, semi-major axis; eccentricity squared
LARGEST = {'float': 3.4e38, 'double': sys.float_info.max}  # that the checks of messages let pass


class Matrix(NamedTuple):
    """The covariance that a number belongs to."""

    holder: Sequence[Step]  # to the object that has it
    field: str
    size: int  # of its rows
    rows: tuple[int, ...]  # those of the number; of one of a quaternion those of all angles


def compile_variance(kind: Any, path: str) -> SetVariance | None:
    """
    Return what writes the variance of a dotted field, or None when the type has no place for it.

    A deviation that is not finite is unknown, which these messages say by 0. The covariances with
    other quantities become 0, and so does a -1 in the first element, by which a message disowns
    the whole vector. Raises BadInput.
    """
    steps = trace(kind, path)
    if has_variance(steps):
        return _in_scalar(steps)
    matrix = matrix_of(steps)
    if matrix is None or len(matrix.rows) > 1:
        return None
    return _in_position(steps, matrix) if matrix.field == POSITION else _in_matrix(matrix)


def has_variance(steps: Sequence[Step]) -> bool:
    """Tell whether the variance of a number stands beside it."""
    last = steps[-1]
    fields = last.kind.get_fields_and_field_types()
    floats = [field for field, kind in fields.items() if kind in LARGEST and field != 'variance']
    return fields.get('variance') in LARGEST and last.field in floats and (
        floats == [last.field] or last.field == _snake(last.kind.__name__))


def matrix_of(steps: Sequence[Step]) -> Matrix | None:
    """Return the covariance that the number at the end of a path belongs to, or None."""
    last = steps[-1]
    fields = last.kind.get_fields_and_field_types()
    if last.field in GEODETIC and fields.get(POSITION) == 'double[9]' and \
            f'{POSITION}_type' in fields and GEODETIC.keys() <= fields.keys():
        return Matrix(steps[:-1], POSITION, 3, (GEODETIC[last.field],))
    if len(steps) < 2 or fields.keys() not in (AXES.keys(), QUATERNION):
        return None
    rows = (0, 1, 2) if fields.keys() == QUATERNION and not last.angle else (AXES[last.field],)
    vector = steps[-2]
    name = f'{vector.field}_covariance'
    if not vector.type.is_array and \
            vector.kind.get_fields_and_field_types().get(name) == 'double[9]':
        return Matrix(steps[:-2], name, 3, rows)
    if len(steps) < 3 or vector.field not in BLOCKS:
        return None
    outer = steps[-3].kind.get_fields_and_field_types()
    if outer.get('covariance') != 'double[36]' or len(outer) != 2 or steps[-3].type.is_array:
        return None
    return Matrix(steps[:-3], 'covariance', 6, tuple(BLOCKS[vector.field] + row for row in rows))


def _in_scalar(steps: Sequence[Step]) -> SetVariance:
    find, last = compile_holder(steps[:-1]), steps[-1]
    largest = LARGEST[last.kind.get_fields_and_field_types()['variance']]

    def put(message: Any, deviation: float) -> None:
        holder = find(message)
        if holder is not None:
            holder.variance = _variance(deviation, largest)
    return put


def _in_position(steps: Sequence[Step], matrix: Matrix) -> SetVariance:
    find, field = compile_holder(matrix.holder), steps[-1].field
    write = _in_matrix(matrix)

    def put(message: Any, deviation: float) -> None:
        holder = find(message)
        if holder is None:
            return
        if field != 'altitude':
            north, east = metres_per_degree(holder.latitude)
            deviation *= north if field == 'latitude' else east
        write(message, deviation)
        if holder.position_covariance_type == TYPE_UNKNOWN and math.isfinite(deviation):
            holder.position_covariance_type = TYPE_DIAGONAL_KNOWN
    return put


def _in_matrix(matrix: Matrix) -> SetVariance:
    find, size, (row,) = compile_holder(matrix.holder), matrix.size, matrix.rows

    def put(message: Any, deviation: float) -> None:
        holder = find(message)
        if holder is None:
            return
        numbers = getattr(holder, matrix.field)
        numbers[size * row:size * (row + 1)] = 0.0
        numbers[row::size] = 0.0
        if numbers[0] < 0:
            numbers[0] = 0.0
        numbers[(size + 1) * row] = _variance(deviation, LARGEST['double'])
    return put


def _variance(deviation: float, largest: float) -> float:
    deviation = float(deviation)  # a numpy scalar is refused by the checks of the messages
    return min(deviation * deviation, largest) if math.isfinite(deviation) else 0.0


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Return the length in m of a degree of latitude and of longitude (WGS84, at height 0)."""
    if not math.isfinite(latitude):
        return math.nan, math.nan
    angle = math.radians(latitude)
    flattening = 1 - WGS84_E2 * math.sin(angle) ** 2
    across = math.radians(WGS84_RADIUS) / math.sqrt(flattening)
    return across * (1 - WGS84_E2) / flattening, across * math.cos(angle)


def _snake(name: str) -> str:
    return re.sub(r'(?<=[a-z0-9])(?=[A-Z])', '_', name).lower()
