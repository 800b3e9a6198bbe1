"""What the arguments of nonlinear terms are called."""

from __future__ import annotations

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import Apply, Name, Node, parse, to_text
from vsensor_ros.functions.nonlinearity import argument_names, NonlinearTerm


def argument_name(term: NonlinearTerm, argument: int) -> str:
    """
    Return what an argument of a term is in the plant's names: 'level1 - level2'.

    It is found where the text, 'sqrt(w1)', and the name, 'sqrt(level1 - level2)', differ. Where
    they have nothing in common it is 'w1 of' the name.
    """
    letter = argument_names(len(term.slope))[argument]
    try:
        found = _counterpart(letter, parse(term.text), parse(term.name))
    except BadInput:  # a name that somebody made up
        found = None
    return f'{letter} of {term.name}' if found in (None, Name(letter)) else to_text(found)


def _counterpart(letter: str, text: Node, name: Node) -> Node | None:
    if text == Name(letter):
        return name
    if isinstance(text, Apply) and isinstance(name, Apply) and text.function == name.function:
        for inner, other in zip(text.arguments, name.arguments):
            found = _counterpart(letter, inner, other)
            if found is not None:
                return found
    return None
