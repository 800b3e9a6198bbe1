"""What the package must know of a function or an operator of the plant language: one entry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import Any

from vsensor_ros.functions.interval import Interval

# of the value, and of the difference quotients along each argument, the others held
Bounds = tuple[Interval, tuple[Interval, ...]]


@dataclass(frozen=True, eq=False)
class Function:
    """
    One function or operator: everything that any part of the package asks about it.

    To add a function to the language, add its entry to CATALOGUE; nothing else changes but its
    row in docs/plant_file.md, which a test then asks for.
    """

    name: str
    arguments: tuple[str, ...]  # as the docs call them
    meaning: str  # one clause for the docs
    # numpy, elementwise; finite for finite arguments: continued outside of the domain, monotone
    # where it was monotone
    value: Callable[..., Any]
    # of numbers: the partial derivative by each argument; not finite at a kink
    slopes: tuple[Callable[..., float], ...]
    # of one interval for each argument, with the continuation
    bounds: Callable[..., Bounds]
    # (least, most) of the difference quotients along the first argument over the whole line, the
    # others held; None when there is no such bound
    slope_bounds: Interval | None = None
    # elementwise: whether the arguments lie outside of the domain, NaN being inside; None: never
    outside: Callable[..., Any] | None = None
    # of numbers, NaN for what is not constant: whether these constants alone, when they are not
    # outside, keep every argument in the domain
    kept_inside: Callable[..., bool] = lambda *numbers: False
    domain: str = 'all numbers'
    continuation: str = ''  # outside of the domain
    # whether at a jump it takes any value of the jump, as dry friction does at rest. The step of
    # the bank and the simulation are written for the one such function there is, sign; a term
    # of another is refused
    set_valued: bool = False
    precedence: int | None = None  # of an operator, the larger binds tighter; None: f(x, ..)

    @property
    def arity(self) -> int:
        """Number of arguments."""
        return len(self.arguments)

    def limited(self, *numbers: float) -> bool:
        """
        Tell whether some arguments lie outside of the domain.

        numbers: one for each argument, NaN where it is not a constant.
        """
        return self.outside is not None and not self.kept_inside(*numbers)

    @property
    def call(self) -> str:
        """How it is written, for the docs: 'sat(x, low, high)', 'a + b'."""
        if self.precedence is None:
            return f'{self.name}({", ".join(self.arguments)})'
        return f' {self.name} '.join(self.arguments) if self.arity > 1 else '-' + self.arguments[0]

    @property
    def row(self) -> str:
        """The row of the table in docs/plant_file.md."""
        cells = (f'`{self.call}`', self.meaning, self.domain, self.continuation)
        return '|' + '|'.join(f' {cell} '.replace('|', r'\|').replace('  ', ' ')
                              for cell in cells) + '|'


def constant(*numbers: float) -> bool:
    """Tell whether all are constants, as ``Function.kept_inside`` is told of them."""
    return not any(math.isnan(number) for number in numbers)
