"""What nonlinear terms are called in a sentence: long ones by number, listed once in full."""

from __future__ import annotations

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import names, parse

LONGEST = 32  # characters of a name that a sentence can hold


def short_name(index: int, name: str) -> str:
    """Return the name, or 'term 3 (of tr, ca)' for a long one; index from 0."""
    if len(name) <= LONGEST:
        return name
    try:
        used = names(parse(name))
    except BadInput:  # a name that somebody made up
        return name
    return f'term {index + 1}' + (f' (of {", ".join(used)})' if used else '')


def full_name(index: int, name: str) -> str:
    """Return the name, with its number where a sentence has that."""
    short = short_name(index, name)
    return name if short == name else f'{short}: {name}'
