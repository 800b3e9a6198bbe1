"""
Numbers straight out of serialized messages, and into them, without decoding.

The bytes are CDR (OMG DDS-XTypes 7.4.1: XCDR1, little endian): each number stands at a multiple
of its size counted from the fifth byte, sequences and strings begin with their length. So the
lengths and the names of joints settle where everything stands. A message is walked through once,
wholly; of the next only those lengths and names are compared, and if they are the same the numbers
are where they were. Whatever lies between, padding too, may be anything.

What the walk does not know (wide strings, other encodings) is decoded instead. The answers are
those of `Accessor` on the decoded message. Two kinds of broken message are refused though Jazzy's
rmw_fastrtps decodes them: a sequence beyond the bound of its type (ROS_PYTHON_CHECK_FIELDS refuses
it, too), and a message in the message that cannot be read (what follows it is garbage then).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
import struct
from typing import Any, NamedTuple

from rclpy.serialization import deserialize_message, serialize_message

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import Accessor, compile_accessor, Mark
from vsensor_ros.node.cdr_walk import (
    BODY,
    Broken,
    compile_structure,
    find_place,
    LETTERS,
    LONGEST_LAYOUT,
    Place,
    Struct,
    Walk,
)
from vsensor_ros.node.disowned import DISOWNED, UNSURE
from vsensor_ros.node.orientation import EulerAngle
from vsensor_ros.node.stamp import compile_stamps, Stamp, to_ns
from vsensor_ros.reason import Reason

LAYOUTS = 16  # kept of one topic: so many drivers may share it and stay cheap
NEAR = 16  # bytes between two stretches that are cheaper compared as one

_LITTLE_ENDIAN = b'\x00\x01'


class Reading(NamedTuple):
    """What a message says of the fields of a reader, in their order."""

    stamp: int | None  # ns, mostly the header's; None when it has none or it is not filled in
    values: tuple[float | Reason, ...]  # the number, or the reason why there is none
    foreign: bool  # lacks the names of all the fields; may be sound all the same
    offsets: tuple[int | None, ...]  # of the numbers in the bytes, where known


def decode(kind: Any, raw: bytes) -> Any:
    """Return the message in these bytes, or None when there is none."""
    try:
        return deserialize_message(raw, kind)
    except (RuntimeError, ValueError, MemoryError, TypeError):  # all that rclpy raises
        return None


class Reader:
    """Reads and writes some numeric fields of serialized messages of one type."""

    def __init__(self, kind: Any, fields: Sequence[str | Accessor],
                 stamps: Sequence[Stamp] | None = None) -> None:
        """
        Read fields of a message class: dotted (see `trace`), or compiled, with the marks heeded.

        stamps: where its time stands, the first counts; in its header if not given. Raises
        BadInput.
        """
        self.kind = kind
        self.accessors = accessors = tuple(
            compile_accessor(kind, field) if isinstance(field, str) else field for field in fields)
        self.aligned: list[set[str]] = [set() for _ in accessors]  # of all so far, see `Place`
        self._stamp = next(iter(compile_stamps(kind) if stamps is None else stamps), None)
        self._marks = [[(mark, [LETTERS[steps[-1].type.inner] for steps in mark.looks_at])
                        for mark in a.marks] for a in accessors]
        stamp = [] if self._stamp is None else [n.steps for n in self._stamp.numbers]
        self._steps = [*(a.steps for a in accessors), *stamp]
        self._letters = [LETTERS[steps[-1].type.inner] for steps in self._steps]
        self._root: Struct | None
        try:
            self._root = compile_structure(kind)
        except (BadInput, KeyError):  # a type inside that is not installed, or not known here
            self._root = None
        self._layouts: list[_Layout] = []

    def read(self, raw: bytes) -> Reading | None:
        """Return what a message says, or None when these bytes are not a message of the type."""
        if self._root is None or raw[:2] != _LITTLE_ENDIAN:
            return self._decode(raw)
        for layout in self._layouts:
            if layout.holds(raw):
                return layout.read(raw)
        found = self._walk(self._root, raw)
        return None if found is None else found.read(raw)

    def write(self, raw: bytes, reading: Reading, values: Mapping[int, float]) -> bytes | Reason:
        """
        Return the message of a reading with some of its fields changed, or why it cannot be.

        The values are by index into the fields; all else stays as it is. An element that is not
        there gets room where `Accessor.put` makes it.
        """
        patched = bytearray(raw)
        for i, value in values.items():
            offset = reading.offsets[i]
            if offset is None:
                return self._rewrite(raw, values)
            fitted = self.accessors[i].fit(value)
            if isinstance(fitted, Reason):
                return fitted
            angle = self.accessors[i].angle
            if angle is not None:
                angle.pack(patched, offset, fitted)
                continue
            struct.pack_into('<' + self._letters[i], patched, offset, fitted)
        return bytes(patched)

    def _rewrite(self, raw: bytes, values: Mapping[int, float]) -> bytes | Reason:
        message = decode(self.kind, raw)
        for i, value in values.items():
            problem = self.accessors[i].put(message, value)
            if problem is not None:
                return problem
        return serialize_message(message)

    def _decode(self, raw: bytes) -> Reading | None:
        message = decode(self.kind, raw)
        if message is None:
            return None
        return Reading(None if self._stamp is None else self._stamp.get(message),
                       tuple(a.get(message) for a in self.accessors),
                       all(a.absent(message) for a in self.accessors),
                       (None,) * len(self.accessors))

    def _walk(self, root: Struct, raw: bytes) -> _Layout | None:
        """Find out how a message is laid out, or that it is none."""
        walk = Walk(raw)
        try:
            end = root.begins(walk, BODY)[-1]
            if end > len(raw):
                return None
            places = [find_place(root, walk, steps) for steps in self._steps]
            marks = self._find_marks(root, walk, places)
        except (Broken, struct.error):  # the latter: a length that stands beyond the end
            return None
        letters = {place.offset: letter for place, letter in zip(places, self._letters)
                   if place.offset is not None}
        order, form, at = sorted(letters), '<', 0
        for offset in order:
            form += f'{offset - at}x{letters[offset]}'
            at = offset + struct.calcsize('<' + letters[offset])
        ranks = [place.lack if place.offset is None else order.index(place.offset)
                 for place in places]
        count = len(self.accessors)
        for i, place in enumerate(places[:count]):
            self.aligned[i] |= place.aligned
        picks = tuple(Reason.of(rank, field=accessor.path) if isinstance(rank, str) else rank
                      for rank, accessor in zip(ranks, self.accessors))
        pair = counted = None
        times = [rank for rank in ranks[count:] if isinstance(rank, int)]
        if self._stamp is not None and len(times) == len(self._stamp.numbers):
            if self._stamp.unit is None:
                pair = times[0], times[1]
            else:
                counted = times[0], self._stamp.unit
        first = len(order) - count
        angles = tuple((i, a.angle, place.offset) for i, (a, place) in enumerate(
            zip(self.accessors, places)) if a.angle is not None and place.offset is not None)
        plain = picks == tuple(range(first, len(order))) and set(self._letters[:count]) <= {*'fd'}
        layout = (_AngleLayout if angles else _MarkedLayout if marks else _Layout)(
            end, _runs(raw, walk.marks), struct.Struct(form), picks, first if plain else None,
            pair, counted, marks, all(place.absent for place in places[:count]),
            tuple(place.offset for place in places[:count]), angles)
        if walk.marked <= LONGEST_LAYOUT:
            self._layouts = [layout, *self._layouts[:LAYOUTS - 1]]
        return layout

    def _find_marks(self, root: Struct, walk: Walk,
                    places: Sequence[Place]) -> tuple[_Marked, ...]:
        """Return what says of the fields that are there whether they are readings at all."""
        found = []
        for i, accessor in enumerate(self.accessors):
            for mark, letters in self._marks[i] if places[i].offset is not None else ():
                at = [find_place(root, walk, steps).offset for steps in mark.looks_at]
                offsets = [offset for offset in at if offset is not None]
                if len(offsets) == len(at):
                    found.append(_Marked(i, mark, Reason.of(
                        DISOWNED, field=accessor.path, mark=mark.text), offsets, letters))
        return tuple(found)


class _Marked:
    """What says of a field whether it is a reading at all; remembered while its bytes stay."""

    __slots__ = ('_bounds', '_numbers', 'field', 'high', 'low', 'reason', 'seen', 'start', 'stop')

    def __init__(self, field: int, mark: Mark, reason: Reason, offsets: Sequence[int],
                 letters: Sequence[str]) -> None:
        self.field, self.reason, self._bounds = field, reason, mark.bounds
        self._numbers = [(struct.Struct('<' + letter), offset)
                         for letter, offset in zip(letters, offsets)]
        self.start = min(offsets, default=0)
        self.stop = max((at + number.size for number, at in self._numbers), default=0)
        self.seen: bytes | None = None
        self.low = self.high = math.nan

    def look(self, raw: bytes) -> None:
        """Find out which values are readings, beside what a message says now."""
        bounds = self._bounds(*[number.unpack_from(raw, at)[0] for number, at in self._numbers])
        self.low, self.high = bounds
        self.seen = None if bounds is UNSURE else bytes(raw[self.start:self.stop])


class _Run(NamedTuple):
    """A stretch of bytes; those under the mask are the same in each message of a layout."""

    start: int
    stop: int
    seen: bytes  # compared first: mostly the rest is the same, too
    mask: int
    masked: int


class _Layout(NamedTuple):
    """Where everything stands in messages that agree in all lengths and in the names."""

    end: int  # anything may follow
    runs: tuple[_Run, ...]
    numbers: struct.Struct  # of the fields and the stamp, in the order of their offsets
    picks: tuple[int | Reason, ...]  # of each field: its rank among the numbers, or its reason
    first: int | None  # rank of the first field, when they are just the last numbers, and floats
    stamp: tuple[int, int] | None  # ranks of seconds and nanoseconds
    counted: tuple[int, int] | None  # or the rank of one number that is the stamp, and its unit
    marks: tuple[_Marked, ...]
    foreign: bool
    offsets: tuple[int | None, ...]
    angles: tuple[tuple[int, EulerAngle, int], ...] = ()  # fields that are, with their offsets

    def holds(self, raw: bytes) -> bool:
        """Tell whether a message is laid out like this."""
        if len(raw) < self.end:
            return False
        for start, stop, seen, mask, masked in self.runs:
            here = raw[start:stop]
            if here != seen and int.from_bytes(here, 'little') & mask != masked:
                return False
        return True

    def read(self, raw: bytes) -> Reading:
        """Read a message that is laid out like this."""
        numbers = self.numbers.unpack_from(raw)
        if self.first is not None:
            values = numbers[self.first:]
        else:
            values = tuple([pick if isinstance(pick, Reason) else float(numbers[pick])
                            for pick in self.picks])
        stamp = None
        if self.stamp is not None:
            seconds, nanoseconds = self.stamp
            stamp = numbers[seconds] * 1_000_000_000 + numbers[nanoseconds] or None
        elif self.counted is not None:
            rank, unit = self.counted
            stamp = to_ns(numbers[rank], unit)
        return Reading(stamp, values, self.foreign, self.offsets)


class _MarkedLayout(_Layout):
    """The same where fields may be marked as not there; the others need not pay for it."""

    __slots__ = ()

    def read(self, raw: bytes) -> Reading:
        """Read a message that is laid out like this."""
        reading = _Layout.read(self, raw)  # super() takes its time
        values = reading.values
        for mark in self.marks:
            if raw[mark.start:mark.stop] != mark.seen:
                mark.look(raw)
            value = values[mark.field]
            if value.__class__ is float and (value < mark.low or value > mark.high):
                values = (*values[:mark.field], mark.reason, *values[mark.field + 1:])
        return reading if values is reading.values else reading._replace(values=values)


class _AngleLayout(_MarkedLayout):
    """The same where fields are angles of quaternions; the others need not pay for it."""

    __slots__ = ()

    def read(self, raw: bytes) -> Reading:
        """Read a message that is laid out like this."""
        reading = _MarkedLayout.read(self, raw)
        values = list(reading.values)
        for i, angle, offset in self.angles:
            if values[i].__class__ is float:  # a component, not marked as not there
                values[i] = angle.unpack(raw, offset)
        return reading._replace(values=tuple(values))


def _runs(raw: bytes, marks: list[tuple[int, int]]) -> tuple[_Run, ...]:
    """Bring the stretches [start, stop) that settle a layout together into few."""
    groups: list[list[tuple[int, int]]] = []
    for mark in sorted(set(marks)):
        if groups and mark[0] - groups[-1][-1][1] < NEAR:
            groups[-1].append(mark)
        else:
            groups.append([mark])
    runs = []
    for group in groups:
        first, last = group[0][0], group[-1][1]
        cover = bytearray(last - first)
        for start, stop in group:
            cover[start - first:stop - first] = b'\xff' * (stop - start)
        mask, seen = int.from_bytes(cover, 'little'), raw[first:last]
        runs.append(_Run(first, last, seen, mask, int.from_bytes(seen, 'little') & mask))
    return tuple(runs)
