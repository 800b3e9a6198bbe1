"""
Roll, pitch and yaw of a quaternion: read one of them, or change just this one.

As ROS has them (REP 103): turn about the fixed x axis, then y, then z. A quaternion that is no
rotation (all zeros, not normalised) has none of them. Components that are NaN say which angles are
not known: x roll, y pitch, z yaw.
"""

from __future__ import annotations

import math
import struct

from vsensor_ros.reason import Reason

ANGLES = {'roll': 'x', 'pitch': 'y', 'yaw': 'z'}  # and the components that stand for them
TURNING = {'roll', 'yaw'}  # go round; a pitch goes from -pi/2 to pi/2 and back
NORMALISED = 0.1  # by which the square of the length may be off
NO_ROTATION = 'no rotation'  # code of the reason

Quaternion = tuple[float, float, float, float]  # x, y, z, w
_NUMBERS = struct.Struct('<4d')


class EulerAngle:
    """
    One angle [rad] of the quaternion in a field of a message.

    Where a message has no rotation to change, that of the last one which had one is taken, and
    before there was any the identity: the other angles are kept, or 0.
    """

    def __init__(self, name: str, path: str) -> None:
        """Prepare for one of `ANGLES`; path: as configured, for people."""
        self._of = {'roll': roll, 'pitch': pitch, 'yaw': yaw}[name]
        self._turn = {'roll': _roll_by, 'pitch': _pitch_by, 'yaw': _yaw_by}[name]
        self._index = list(ANGLES).index(name)  # of its component
        self._back = self._index * 8  # bytes from there to the first
        self._none = Reason.of(NO_ROTATION, field=path)
        self._last: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def read(self, q: Quaternion) -> float | Reason:
        """Return the angle, NaN if there is one in the quaternion, or why there is none."""
        x, y, z, w = q
        off = x * x + y * y + z * z + w * w - 1.0
        if -NORMALISED <= off <= NORMALISED:
            self._last = q
            return self._of(x, y, z, w)
        return math.nan if math.isnan(off) else self._none

    def changed(self, q: Quaternion, value: float) -> Quaternion:
        """Return the unit quaternion with this angle, the others kept; NaN: not known."""
        unknown = [i for i in range(3) if math.isnan(q[i]) and i != self._index]
        if len(unknown) == 2 and math.isnan(q[3]):
            unknown = []  # all of it was blanked, not two angles
        off = sum(number * number for number in q) - 1.0
        whole = q if -NORMALISED <= off <= NORMALISED else self._last
        if not math.isfinite(value):
            unknown.append(self._index)
        else:
            whole = self._turn(whole, value - self._of(*whole))
            length = math.hypot(*whole)
            whole = whole[0] / length, whole[1] / length, whole[2] / length, whole[3] / length
        x, y, z = (math.nan if i in unknown else whole[i] for i in range(3))
        return x, y, z, whole[3]

    def unpack(self, raw: bytes, offset: int) -> float | Reason:
        """Read it from a serialized message; offset: of its component."""
        return self.read(_NUMBERS.unpack_from(raw, offset - self._back))

    def pack(self, raw: bytearray, offset: int, value: float) -> None:
        """Change it in a serialized message; offset: of its component."""
        at = offset - self._back
        _NUMBERS.pack_into(raw, at, *self.changed(_NUMBERS.unpack_from(raw, at), value))


def roll(x: float, y: float, z: float, w: float) -> float:
    """Return the turn about the x axis [rad], -pi to pi; the length does not matter."""
    return math.atan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)


def pitch(x: float, y: float, z: float, w: float) -> float:
    """Return the turn about the y axis [rad], -pi/2 to pi/2."""
    return math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x) / (
        x * x + y * y + z * z + w * w))))


def yaw(x: float, y: float, z: float, w: float) -> float:
    """Return the turn about the z axis [rad], -pi to pi."""
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _roll_by(q: Quaternion, by: float) -> Quaternion:
    return _product(q, (math.sin(by / 2.0), 0.0, 0.0, math.cos(by / 2.0)))


def _pitch_by(q: Quaternion, by: float) -> Quaternion:
    about, size = roll(*q), math.sin(by / 2.0)
    return _product(q, (0.0, size * math.cos(about), -size * math.sin(about), math.cos(by / 2.0)))


def _yaw_by(q: Quaternion, by: float) -> Quaternion:
    return _product((0.0, 0.0, math.sin(by / 2.0), math.cos(by / 2.0)), q)


def _product(p: Quaternion, q: Quaternion) -> Quaternion:
    (a, b, c, d), (x, y, z, w) = p, q
    return (d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x,
            d * z + a * y - b * x + c * w, d * w - a * x - b * y - c * z)
