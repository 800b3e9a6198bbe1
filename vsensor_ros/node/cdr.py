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
from functools import cache
import math
import struct
from typing import Any, NamedTuple

from rclpy.serialization import deserialize_message, serialize_message

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import Accessor, Mark, NOT_THERE, TOO_SHORT
from vsensor_ros.node.disowned import DISOWNED, UNSURE
from vsensor_ros.node.field_path import field_type, inner_type, Step
from vsensor_ros.node.room import columns
from vsensor_ros.node.stamp import compile_stamps, Stamp, to_ns
from vsensor_ros.reason import Reason

LAYOUTS = 16  # kept of one topic: so many drivers may share it and stay cheap
LONGEST_LAYOUT = 2**16  # bytes that settle it; longer ones are walked through every time
NEAR = 16  # bytes between two stretches that are cheaper compared as one

_LITTLE_ENDIAN = b'\x00\x01'
_BODY = 4  # where the bytes begin that alignment counts from
_LETTERS = {'boolean': '?', 'int8': 'b', 'uint8': 'B', 'int16': 'h', 'uint16': 'H',
            'int32': 'i', 'uint32': 'I', 'int64': 'q', 'uint64': 'Q', 'float': 'f', 'double': 'd'}
_SIZES = {'octet': 1,
          **{kind: struct.calcsize('<' + letter) for kind, letter in _LETTERS.items()}}
_LENGTH = struct.Struct('<I')


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

    def __init__(self, kind: Any, accessors: Sequence[Accessor],
                 stamps: Sequence[Stamp] | None = None) -> None:
        """Read these fields of a message class; stamps: its, the first counts; the header's."""
        self.kind = kind
        self.accessors = tuple(accessors)
        self.aligned: list[set[str]] = [set() for _ in accessors]  # see `_Place`, of all so far
        self._stamp = next(iter(compile_stamps(kind) if stamps is None else stamps), None)
        self._marks = [[(mark, [_LETTERS[steps[-1].type.inner] for steps in mark.looks_at])
                        for mark in a.marks] for a in accessors]
        stamp = [] if self._stamp is None else [n.steps for n in self._stamp.numbers]
        self._steps = [*(a.steps for a in accessors), *stamp]
        self._letters = [_LETTERS[steps[-1].type.inner] for steps in self._steps]
        self._root: _Struct | None
        try:
            self._root = _compile(kind)
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

    def _walk(self, root: _Struct, raw: bytes) -> _Layout | None:
        """Find out how a message is laid out, or that it is none."""
        walk = _Walk(raw)
        try:
            end = root.begins(walk, _BODY)[-1]
            if end > len(raw):
                return None
            places = [_find(root, walk, steps) for steps in self._steps]
            marks = self._find_marks(root, walk, places)
        except (_Broken, struct.error):  # the latter: a length that stands beyond the end
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
        plain = picks == tuple(range(first, len(order))) and set(self._letters[:count]) <= {*'fd'}
        layout = (_MarkedLayout if marks else _Layout)(
            end, _runs(raw, walk.marks), struct.Struct(form), picks, first if plain else None,
            pair, counted, marks, all(place.absent for place in places[:count]),
            tuple(place.offset for place in places[:count]))
        if walk.marked <= LONGEST_LAYOUT:
            self._layouts = [layout, *self._layouts[:LAYOUTS - 1]]
        return layout

    def _find_marks(self, root: _Struct, walk: _Walk,
                    places: Sequence[_Place]) -> tuple[_Marked, ...]:
        """Return what says of the fields that are there whether they are readings at all."""
        found = []
        for i, accessor in enumerate(self.accessors):
            for mark, letters in self._marks[i] if places[i].offset is not None else ():
                at = [_find(root, walk, steps).offset for steps in mark.looks_at]
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


class _Broken(Exception):
    """A sequence is longer than its type allows."""


class _Walk:
    """The way through one message: its work is bounded by the bytes of lengths there are."""

    def __init__(self, raw: bytes) -> None:
        self.raw = raw
        self.marks: list[tuple[int, int]] = []  # [start, stop) that settle it, while it is short
        self.marked = 0
        self.begins: dict[tuple[_Struct, int], list[int]] = {}
        self.indices: dict[int, dict[str, int]] = {}

    def mark(self, start: int, stop: int) -> None:
        self.marked += stop - start
        if self.marked <= LONGEST_LAYOUT:
            self.marks.append((start, stop))

    def length(self, at: int, most: int | None = None) -> tuple[int, int]:
        """Return the length at an offset (beyond the end?) and where what it counts begins."""
        at += -at % 4
        length: int = _LENGTH.unpack_from(self.raw, at)[0]
        self.mark(at, at + 4)
        if most is not None and length > most:
            raise _Broken
        return length, at + 4

    def names(self, array: _Array, at: int) -> dict[str, int]:
        """Return the index of each name in the array of strings at an offset."""
        if at not in self.indices:
            indices: dict[str, int] = {}
            count, here = array.open(self, at)
            for i in range(count):
                length, start = self.length(here)
                here = start + length
                self.mark(start, here)
                text = self.raw[start:here].split(b'\0')[0]
                indices.setdefault(text.decode('utf-8', 'replace'), i)
            self.indices[at] = indices
        return self.indices[at]


class _Number:
    varies: bool = False

    def __init__(self, size: int) -> None:
        self.size = size

    def skip(self, walk: _Walk, at: int) -> int:
        return at + (_BODY - at) % self.size + self.size


class _Text:
    varies: bool = True

    def skip(self, walk: _Walk, at: int) -> int:
        length, at = walk.length(at)
        return at + length


class _Struct:

    def __init__(self, members: dict[str, _Node]) -> None:
        self.members = members
        self.varies: bool = any(member.varies for member in members.values())

    def skip(self, walk: _Walk, at: int) -> int:
        for member in self.members.values():
            at = member.skip(walk, at)
        return at

    def begins(self, walk: _Walk, at: int) -> list[int]:
        """Return where each field of the struct at an offset begins (unaligned), and its end."""
        begins = walk.begins.get((self, at))
        if begins is None:
            begins = walk.begins[self, at] = [at]
            for member in self.members.values():
                begins.append(member.skip(walk, begins[-1]))
        return begins

    def begin(self, walk: _Walk, at: int, field: str) -> int:
        """Return where a field of the struct at an offset begins, before it is aligned."""
        return self.begins(walk, at)[list(self.members).index(field)]


class _Array:

    def __init__(self, element: _Node, is_sequence: bool, size: int | None) -> None:
        self.element, self.is_sequence, self.size = element, is_sequence, size
        self.varies: bool = is_sequence or element.varies

    def open(self, walk: _Walk, at: int) -> tuple[int, int]:
        """Return how many elements there are and where the first begins."""
        return walk.length(at, self.size) if self.is_sequence else (self.size or 0, at)

    def skip(self, walk: _Walk, at: int) -> int:
        count, at = self.open(walk, at)
        return self.beyond(walk, at, count)

    def beyond(self, walk: _Walk, at: int, count: int) -> int:
        """Return where so many elements end that begin at an offset."""
        element = self.element
        if element.varies:
            for _ in range(count):
                at = element.skip(walk, at)
            return at
        seen: dict[int, tuple[int, int]] = {}  # by alignment: the count and the offset there
        while count and at % 8 not in seen:
            seen[at % 8] = count, at
            at, count = element.skip(walk, at), count - 1
        if count:  # from here on it repeats
            before, there = seen[at % 8]
            rounds, count = divmod(count, before - count)
            at += rounds * (at - there)
            for _ in range(count):
                at = element.skip(walk, at)
        return at


_Node = _Number | _Text | _Struct | _Array


@cache
def _compile(kind: Any) -> _Struct:
    """Return the structure of a message class. Raises KeyError, BadInput for what is not known."""
    members: dict[str, _Node] = {}
    for field, text in kind.get_fields_and_field_types().items():
        of = field_type(text)
        node: _Node
        if of.inner == 'string':
            node = _Text()
        elif '/' in of.inner:
            node = _compile(inner_type(of.inner))
        else:
            node = _Number(_SIZES[of.inner])
        members[field] = _Array(node, of.is_sequence, of.size) if of.is_array else node
    return _Struct(members or {'': _Number(1)})  # a message without fields takes a byte


class _Place(NamedTuple):
    """Where a number stands, or why there is none."""

    offset: int | None
    lack: str = ''  # the reason, without the path
    absent: bool = False  # its name is not among the names there are
    aligned: frozenset[str] = frozenset()  # of the arrays that its name is for, those with
    # as many elements as there are names


def _find(root: _Struct, walk: _Walk, steps: Sequence[Step]) -> _Place:
    struct_, at = root, _BODY
    above = struct_, at
    aligned: frozenset[str] = frozenset()
    for step in steps:
        begin, node = struct_.begin(walk, at, step.field), struct_.members[step.field]
        if isinstance(node, _Array):
            count, begin = node.open(walk, begin)
            i = -1 if step.index is None else step.index
            if step.names is not None:
                owner, there = above if step.above else (struct_, at)
                names, begins = owner.members[step.names], owner.begin(walk, there, step.names)
                assert isinstance(names, _Array)
                if step.name is not None:
                    i = walk.names(names, begins).get(step.name, -1)
                    if i < 0:
                        return _Place(None, NOT_THERE, absent=True)
                aligned |= _aligned(struct_, walk, at, step, names.open(walk, begins)[0])
            if i >= count:
                return _Place(None, TOO_SHORT if step is steps[-1] else NOT_THERE,
                              aligned=aligned)
            begin, node = node.beyond(walk, begin, i), node.element
        if isinstance(node, _Number):
            return _Place(begin + (_BODY - begin) % node.size, aligned=aligned)
        assert isinstance(node, _Struct)
        above = struct_, at
        struct_, at = node, begin
    raise AssertionError('unreachable: a path ends at a number')


def _aligned(struct_: _Struct, walk: _Walk, at: int, step: Step, count: int) -> frozenset[str]:
    """Return the arrays beside that of a step, and it itself, that have so many elements."""
    return frozenset(field for field in columns(step.kind) if count and _count(
        struct_.members[field], walk, struct_.begin(walk, at, field)) == count)


def _count(node: _Node, walk: _Walk, at: int) -> int:
    assert isinstance(node, _Array)
    return node.open(walk, at)[0]
