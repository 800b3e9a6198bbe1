"""What the arguments of nonlinear terms are called, and where they lie, in the user's words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import inf

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.affine import affine, OFFSET
from vsensor_ros.functions.expression import Apply, Name, Node, parse, to_text
from vsensor_ros.functions.nonlinearity import argument_names, NonlinearTerm

ROUNDING = 1e-9  # relative
Place = tuple[str, float, float]  # what lies between which limits


def argument_name(term: NonlinearTerm, argument: int) -> str:
    """
    Return what an argument of a term is in the plant's names: 'level1 - level2'.

    It is found where the text, 'sqrt(w1)', and the name, 'sqrt(level1 - level2)', differ. Where
    they have nothing in common it is 'w1 of' the name.
    """
    letter = argument_names(len(term.slope))[argument]
    found = _found(letter, term)
    return f'{letter} of {term.name}' if found is None else to_text(found)


def argument_place(term: NonlinearTerm, argument: int, low: float, high: float) -> Place:
    """
    Say where the states lie when an argument lies between low and high.

    '0.0008*id' and '-id' both tell of id; what is made of several states is told as it stands.
    """
    found = _found(argument_names(len(term.slope))[argument], term)
    form = None if found is None else affine(found)
    if not form or OFFSET in form:
        return argument_name(term, argument), low, high
    return sum_place(form, low, high)


def sum_place(form: Mapping[str, float], low: float, high: float) -> Place:
    """Say where states lie of which a sum, {name: factor, ..}, lies between low and high."""
    first = next(iter(form.values()))
    alike = all(abs(factor) == abs(first) for factor in form.values())
    factor = first if alike else abs(first) / first
    least, most = sorted((low / factor, high / factor))
    return _sum({name: value / factor for name, value in form.items()}), least, most


def _sum(form: dict[str, float]) -> str:
    text = ''
    for name, factor in form.items():
        sign = '-' if factor < 0 else '+' if text else ''
        size = '' if abs(factor) == 1.0 else f'{abs(factor):.4g}*'
        text += f' {sign} {size}{name}' if text else f'{sign}{size}{name}'
    return text


def together(places: Iterable[Place]) -> tuple[Place, ...]:
    """Name each once, within all of its limits; what has none, or what others say, is left out."""
    found: dict[str, tuple[float, float]] = {}
    for name, low, high in places:
        least, most = found.get(name, (low, high))
        found[name] = max(low, least), min(high, most)
    return tuple((name, low, high) for name, (low, high) in found.items()
                 if (low > -inf or high < inf) and not _follows(name, low, high, found))


def _follows(name: str, low: float, high: float,
             limits: Mapping[str, tuple[float, float]]) -> bool:
    """Whether a sum lies between low and high because of the limits of its parts."""
    try:
        form = affine(parse(name))
    except BadInput:  # an argument that has no name
        return False
    if not form or len(form) < 2 or not form.keys() <= limits.keys():
        return False
    ends = [sorted(factor * end for end in limits[part]) for part, factor in form.items()]
    least, most = (sum(side) for side in zip(*ends))
    fine = ROUNDING * max(abs(end) for end in (least, most))
    return least >= low - fine and most <= high + fine


def _found(letter: str, term: NonlinearTerm) -> Node | None:
    try:
        found = _counterpart(letter, parse(term.text), parse(term.name))
    except BadInput:  # a name that somebody made up
        return None
    return None if found == Name(letter) else found


def _counterpart(letter: str, text: Node, name: Node) -> Node | None:
    if text == Name(letter):
        return name
    if isinstance(text, Apply) and isinstance(name, Apply) and text.function == name.function:
        for inner, other in zip(text.arguments, name.arguments):
            found = _counterpart(letter, inner, other)
            if found is not None:
                return found
    return None
