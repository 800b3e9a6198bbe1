"""
The nonlinear terms of a plant: psi(w, u) = f(w, u) - slope @ w, with w = G x.

f is written in the expression language over w1..wr and the plant's input names; its
functions come from the catalogue, continued outside their domains (the method, section 5).
The slope is the formal addend that was moved into the matrix A (the method, 3.2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.catalogue import CATALOGUE
from vsensor_ros.functions.expression import (
    Apply,
    Closure,
    compile_node,
    compile_outside,
    fold,
    gradient,
    Name,
    Node,
    Number,
    parse,
    to_text,
)
from vsensor_ros.functions.function import Function

__all__ = [
    'CATALOGUE', 'Function', 'NonlinearTerm', 'argument_names', 'check_term',
    'compile_outside_domain', 'compile_term', 'evaluate', 'make_term', 'outside_domain',
    'set_valued', 'slope_at', 'slope_bounds']

SIGN = 'sign'  # the one set-valued function that step and simulation can hold at rest


@dataclass(frozen=True, eq=False)
class NonlinearTerm:
    """psi(w, u) = f(w, u) - slope @ w: one nonlinear term, r arguments w = G x."""

    name: str            # for people, in the plant's names: 'sqrt(level1 - level2)'
    text: str            # f in the expression language: 'sqrt(w1)'
    slope: np.ndarray    # (r,), the formal addend
    short: str = ''      # for sentences, where the name is long: 'term 3 (of tr, ca)'

    def __post_init__(self) -> None:
        object.__setattr__(self, 'short', self.short or self.name)
        self.slope.flags.writeable = False


def argument_names(r: int) -> tuple[str, ...]:
    """Return ('w1', .., 'wr')."""
    return tuple(f'w{i + 1}' for i in range(r))


def check_term(term: NonlinearTerm, inputs: Sequence[str], where: object = 'nonlinearity',
               key: str = '') -> None:
    """
    Raise BadInput unless f is in the language, over w1..wr and the inputs only.

    Also where f is a set-valued function other than sign: nothing here can hold it at rest.
    """
    parse(term.text, where, key, known=(*argument_names(len(term.slope)), *inputs))
    function = _single(term)
    if function is not None and function.set_valued and function.name != SIGN:
        raise BadInput(where, key, f'{function.name} is set-valued, which only {SIGN} may be',
                       f'write it with {SIGN}')


def make_term(text: str | float, r: int, inputs: Sequence[str], where: object = 'nonlinearity',
              key: str = '', name: str = '') -> NonlinearTerm:
    """
    Make a term without addend of a text over w1..wr and the inputs.

    name: the text when empty. Raises BadInput as check_term.
    """
    node = fold(parse(text, where, key, known=(*argument_names(r), *inputs)), where, key)
    text = to_text(node)
    term = NonlinearTerm(name or text, text, np.zeros(r))
    check_term(term, inputs, where, key)
    return term


@lru_cache(maxsize=4096)
def _compiled(text: str, r: int, inputs: tuple[str, ...]) -> tuple[Node, Closure, Closure | None]:
    node = fold(parse(text, 'nonlinearity', text, known=(*argument_names(r), *inputs)))
    fetch: dict[str, Closure] = {n: _row(1, i) for i, n in enumerate(inputs)}
    fetch.update({n: _row(0, i) for i, n in enumerate(argument_names(r))})
    return node, compile_node(node, fetch), compile_outside(node, fetch)


def _row(which: int, index: int) -> Closure:
    return lambda at: at[which][index]


def compile_term(term: NonlinearTerm, inputs: Sequence[str]) -> Callable[[Any, Any], Any]:
    """
    Return f(w, u), without the addend, for a hot loop.

    w: (r, ...) and u: (m, ...), arrays or sequences of rows; the value broadcasts their
    trailing shapes, and is a bare number when f depends on nothing. Overflow warns as numpy
    does: wrap the loop in np.errstate(all='ignore').
    """
    run = _compiled(term.text, len(term.slope), tuple(inputs))[1]
    return lambda w, u: run((w, u))


def compile_outside_domain(term: NonlinearTerm,
                           inputs: Sequence[str]) -> Callable[[Any, Any], Any] | None:
    """Return outside(w, u), elementwise, for a hot loop; None when f has no domain limit."""
    run = _compiled(term.text, len(term.slope), tuple(inputs))[2]
    return None if run is None else lambda w, u: run((w, u))


def _trailing(w: np.ndarray, u: np.ndarray) -> tuple[int, ...]:
    # a term without arguments, a plant without inputs: that side says nothing of the shape
    return np.broadcast_shapes(w.shape[1:], u.shape[1:] if u.size else ())


def evaluate(term: NonlinearTerm, w: Any, inputs: Sequence[str], u: Any) -> np.ndarray:
    """Return psi(w, u) = f(w, u) - slope @ w; w (r, ...), u (m, ...), result (...)."""
    w, u = np.asarray(w, dtype=float), np.asarray(u, dtype=float)
    with np.errstate(all='ignore'):
        value = compile_term(term, inputs)(w, u)
        if term.slope.any():
            value = value - np.tensordot(term.slope, w, axes=1)
    return np.array(np.broadcast_to(value, _trailing(w, u)), dtype=float)


def outside_domain(term: NonlinearTerm, w: Any, inputs: Sequence[str], u: Any) -> np.ndarray:
    """Return (...), whether any function in f sees an argument outside its domain."""
    w, u = np.asarray(w, dtype=float), np.asarray(u, dtype=float)
    run = compile_outside_domain(term, inputs)
    with np.errstate(all='ignore'):
        value = False if run is None else run(w, u)
    return np.array(np.broadcast_to(value, _trailing(w, u)), dtype=bool)


def slope_at(term: NonlinearTerm, w: Any, inputs: Sequence[str], u: Any) -> np.ndarray:
    """
    Return df/dw (r,) at a point, 0 where f has a kink or no finite slope there.

    Outside the domain of f it is 0 too. This is the formal addend that makes A the
    linearisation (the method, 3.2).
    """
    r = len(term.slope)
    if outside_domain(term, w, inputs, u).any():
        return np.zeros(r)
    node = _compiled(term.text, r, tuple(inputs))[0]
    at = {**dict(zip(inputs, map(float, u))), **dict(zip(argument_names(r), map(float, w)))}
    slope = gradient(node, at, argument_names(r))[1]
    return np.where(np.isfinite(slope), slope, 0.0)


def _single(term: NonlinearTerm) -> Function | None:
    # the catalogue function when f is one function of w1 with constants, else None
    node = fold(parse(term.text, 'nonlinearity', term.name))
    if (len(term.slope) == 1 and isinstance(node, Apply) and node.function in CATALOGUE
            and node.arguments[0] == Name('w1')
            and all(isinstance(a, Number) for a in node.arguments[1:])):
        return CATALOGUE[node.function]
    return None


def set_valued(term: NonlinearTerm) -> bool:
    """Whether f is exactly sign(w1) of one argument: dry friction, which can hold at rest."""
    function = _single(term)
    return function is not None and function.set_valued


def slope_bounds(term: NonlinearTerm) -> tuple[float, float] | None:
    """
    Return (a, b) of all difference quotients of psi (the addend included), continuation too.

    None unless f is one catalogue function of the single argument w1 and has such bounds.
    """
    function = _single(term)
    if function is None or function.slope_bounds is None:
        return None
    a, b = function.slope_bounds
    return a - float(term.slope[0]), b - float(term.slope[0])
