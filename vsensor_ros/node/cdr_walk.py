"""
The way through a serialized message: where each number stands in its bytes.

See `cdr` for what is known of the bytes, and what is made of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
import struct
from typing import Any, NamedTuple

from vsensor_ros.node.accessor import NOT_THERE, TOO_SHORT
from vsensor_ros.node.field_path import field_type, inner_type, Step
from vsensor_ros.node.room import columns

LONGEST_LAYOUT = 2**16  # bytes that settle it; longer ones are walked through every time
BODY = 4  # where the bytes begin that alignment counts from
LETTERS = {'boolean': '?', 'int8': 'b', 'uint8': 'B', 'int16': 'h', 'uint16': 'H',
           'int32': 'i', 'uint32': 'I', 'int64': 'q', 'uint64': 'Q', 'float': 'f', 'double': 'd'}
SIZES = {'octet': 1,
         **{kind: struct.calcsize('<' + letter) for kind, letter in LETTERS.items()}}
LENGTH = struct.Struct('<I')


class Broken(Exception):
    """A sequence is longer than its type allows."""


class Walk:
    """The way through one message: its work is bounded by the bytes of lengths there are."""

    def __init__(self, raw: bytes) -> None:
        self.raw = raw
        self.marks: list[tuple[int, int]] = []  # [start, stop) that settle it, while it is short
        self.marked = 0
        self.begins: dict[tuple[Struct, int], list[int]] = {}
        self.indices: dict[int, dict[str, int]] = {}

    def mark(self, start: int, stop: int) -> None:
        """Note that a stretch settles where everything stands."""
        self.marked += stop - start
        if self.marked <= LONGEST_LAYOUT:
            self.marks.append((start, stop))

    def length(self, at: int, most: int | None = None) -> tuple[int, int]:
        """Return the length at an offset (beyond the end?) and where what it counts begins."""
        at += -at % 4
        length: int = LENGTH.unpack_from(self.raw, at)[0]
        self.mark(at, at + 4)
        if most is not None and length > most:
            raise Broken
        return length, at + 4

    def names(self, array: Array, at: int) -> dict[str, int]:
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


class Number:
    """A number; its size in bytes."""

    varies: bool = False

    def __init__(self, size: int) -> None:
        self.size = size

    def skip(self, walk: Walk, at: int) -> int:
        """Return where it ends that begins at an offset."""
        return at + (BODY - at) % self.size + self.size


class Text:
    """A string."""

    varies: bool = True

    def skip(self, walk: Walk, at: int) -> int:
        """Return where it ends that begins at an offset."""
        length, at = walk.length(at)
        return at + length


class Struct:
    """A message, with its fields in order."""

    def __init__(self, members: dict[str, Node]) -> None:
        self.members = members
        self.varies: bool = any(member.varies for member in members.values())

    def skip(self, walk: Walk, at: int) -> int:
        """Return where it ends that begins at an offset."""
        for member in self.members.values():
            at = member.skip(walk, at)
        return at

    def begins(self, walk: Walk, at: int) -> list[int]:
        """Return where each field of the struct at an offset begins (unaligned), and its end."""
        begins = walk.begins.get((self, at))
        if begins is None:
            begins = walk.begins[self, at] = [at]
            for member in self.members.values():
                begins.append(member.skip(walk, begins[-1]))
        return begins

    def begin(self, walk: Walk, at: int, field: str) -> int:
        """Return where a field of the struct at an offset begins, before it is aligned."""
        return self.begins(walk, at)[list(self.members).index(field)]


class Array:
    """An array or a sequence of elements of one kind."""

    def __init__(self, element: Node, is_sequence: bool, size: int | None) -> None:
        self.element, self.is_sequence, self.size = element, is_sequence, size
        self.varies: bool = is_sequence or element.varies

    def open(self, walk: Walk, at: int) -> tuple[int, int]:
        """Return how many elements there are and where the first begins."""
        return walk.length(at, self.size) if self.is_sequence else (self.size or 0, at)

    def skip(self, walk: Walk, at: int) -> int:
        """Return where it ends that begins at an offset."""
        count, at = self.open(walk, at)
        return self.beyond(walk, at, count)

    def beyond(self, walk: Walk, at: int, count: int) -> int:
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


Node = Number | Text | Struct | Array


@cache
def compile_structure(kind: Any) -> Struct:
    """Return the structure of a message class. Raises KeyError, BadInput for what is not known."""
    members: dict[str, Node] = {}
    for field, text in kind.get_fields_and_field_types().items():
        of = field_type(text)
        node: Node
        if of.inner == 'string':
            node = Text()
        elif '/' in of.inner:
            node = compile_structure(inner_type(of.inner))
        else:
            node = Number(SIZES[of.inner])
        members[field] = Array(node, of.is_sequence, of.size) if of.is_array else node
    return Struct(members or {'': Number(1)})  # a message without fields takes a byte


class Place(NamedTuple):
    """Where a number stands, or why there is none."""

    offset: int | None
    lack: str = ''  # the reason, without the path
    absent: bool = False  # its name is not among the names there are
    aligned: frozenset[str] = frozenset()  # arrays beside it with an element for each name


def find_place(root: Struct, walk: Walk, steps: Sequence[Step]) -> Place:
    """Find the number at the end of a path."""
    struct_, at = root, BODY
    above = struct_, at
    aligned: frozenset[str] = frozenset()
    for step in steps:
        begin, node = struct_.begin(walk, at, step.field), struct_.members[step.field]
        if isinstance(node, Array):
            count, begin = node.open(walk, begin)
            i = -1 if step.index is None else step.index
            if step.names is not None:
                owner, there = above if step.above else (struct_, at)
                names, begins = owner.members[step.names], owner.begin(walk, there, step.names)
                assert isinstance(names, Array)
                if step.name is not None:
                    i = walk.names(names, begins).get(step.name, -1)
                    if i < 0:
                        return Place(None, NOT_THERE, absent=True)
                aligned |= _aligned(struct_, walk, at, step, names.open(walk, begins)[0])
            if i >= count:
                return Place(None, TOO_SHORT if step is steps[-1] else NOT_THERE,
                              aligned=aligned)
            begin, node = node.beyond(walk, begin, i), node.element
        if isinstance(node, Number):
            return Place(begin + (BODY - begin) % node.size, aligned=aligned)
        assert isinstance(node, Struct)
        above = struct_, at
        struct_, at = node, begin
    raise AssertionError('unreachable: a path ends at a number')


def _aligned(struct_: Struct, walk: Walk, at: int, step: Step, count: int) -> frozenset[str]:
    """Return the arrays beside that of a step, and it itself, that have so many elements."""
    return frozenset(field for field in columns(step.kind) if count and _count(
        struct_.members[field], walk, struct_.begin(walk, at, field)) == count)


def _count(node: Node, walk: Walk, at: int) -> int:
    assert isinstance(node, Array)
    return node.open(walk, at)[0]
