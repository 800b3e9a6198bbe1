"""Room in the arrays of a message, so that they have an element for each of their names."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import cache
import math
from typing import Any

from vsensor_ros.node.field_path import (
    field_type,
    FieldType,
    inner_type,
    LARGEST_FLOAT,
    name_array,
    Step,
)


def fillable(of: FieldType) -> bool:
    """Tell whether an element of such an array can say that nothing is known: by NaN."""
    return of.inner in LARGEST_FLOAT or '/' in of.inner


@cache
def columns(kind: Any) -> dict[str, FieldType]:
    """Return the arrays of a message class that grow, of things that may be unknown."""
    found = {field: field_type(text)
             for field, text in kind.get_fields_and_field_types().items()}
    return {field: of for field, of in found.items() if of.is_sequence and fillable(of)}


def forget(message: Any) -> None:
    """Make NaN of each float in a message, of arrays in it as well."""
    for field, text in message.get_fields_and_field_types().items():
        of = field_type(text)
        value = getattr(message, field)
        if of.inner in LARGEST_FLOAT:
            if not of.is_array:
                setattr(message, field, math.nan)
                continue
            for i in range(len(value)):
                value[i] = math.nan
        elif '/' in of.inner:
            for inner in value if of.is_array else (value,):
                forget(inner)


def lengthen(holder: Any, field: str, of: FieldType, count: int) -> None:
    """Give an array so many elements at least; nothing is known of those that are new."""
    array = getattr(holder, field)
    if of.inner in LARGEST_FLOAT:
        array.extend([math.nan] * (count - len(array)))
        return
    for _ in range(count - len(array)):
        element = inner_type(of.inner)()
        forget(element)
        array.append(element)


def named_arrays(owner: Any, step: Step) -> Iterator[tuple[Any, str, FieldType]]:
    """
    Yield the arrays whose elements have the names in an object, as (holder, field, type).

    step: to one of them. They are those beside the names or, where that one is not, those in all
    messages of the same type below: each point of a path has its positions.
    """
    if not step.above:
        holders = [owner]
    else:
        holders = []
        for field, text in owner.get_fields_and_field_types().items():
            of = field_type(text)
            if '/' in of.inner and inner_type(of.inner) is step.kind:
                value = getattr(owner, field)
                holders += value if of.is_array else [value]
    for holder in holders:
        kind: Any = type(holder)
        for field, of in columns(kind).items():
            yield holder, field, of


def complete(owner: Any, step: Step, ever: Collection[str]) -> None:
    """
    Give the arrays of some fields an element for each name in an object, and no more.

    step: see `named_arrays`. ever: the fields whose arrays have had one for each name before.
    """
    names = name_array(type(owner))
    count = len(getattr(owner, names)) if names else 0
    if count == 0:
        return  # what there is has no names
    for holder, field, of in named_arrays(owner, step):
        if field in ever:
            lengthen(holder, field, of, count)
            del getattr(holder, field)[count:]
