"""
What a sensor shows of the linear reading that the equations know: an offset, or a known curve.

All that computes works with the linear reading; a curve stands where readings come in, and where
estimates go out. Its scale is such that both are in the sensor's unit, and as steep as each other
at the operating point: figures of noise hold there as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
import math
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import compile_expression, parse

LOOKED_AT = 2000  # points at which a curve must rise, or fall, all along
LEAST_STEP = 1e-9  # from one to the next, of what the curve spans
END = 1.0 / 64.0  # of its range: how steep it is there tells how it goes on beyond


@dataclass(frozen=True)
class Curve:
    """
    ``shown = linear + offset``; where there is a text, ``shown = f(linear - d u) + d u``.

    text: f over w1, in the expression language, which rises or falls from `low` to `high`, and
    goes on straight beyond. `beside`: d, by command, of what is added to the curve.
    """

    offset: float = 0.0
    text: str = ''
    low: float = -math.inf
    high: float = math.inf
    beside: Mapping[str, float] = field(default_factory=dict)

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        """Go to another process as data; what was compiled of it is compiled there anew."""
        return Curve, (self.offset, self.text, self.low, self.high, dict(self.beside))

    def check(self, where: object, key: str) -> None:
        """Raise BadInput, one line, when it cannot be inverted."""
        if not self.text:
            return
        parse(self.text, where, key, known=('w1',))
        if not -math.inf < self.low < self.high < math.inf:
            raise BadInput(where, key, 'is a curve, and it is not known over which range',
                           'give the states in it a range')
        w = np.linspace(self.low, self.high, LOOKED_AT + 1)
        with np.errstate(all='ignore'):
            values = np.broadcast_to(self._run([w]), w.shape)
        if not np.isfinite(values).all():
            raise BadInput(where, key, 'is not finite all over the range of its states',
                           'narrow the range')
        steps = np.diff(values) * (1.0 if values[-1] > values[0] else -1.0)
        if not (steps > LEAST_STEP * np.ptp(values) / LOOKED_AT).all():
            raise BadInput(where, key, 'cannot be inverted: it does not rise, or fall, all over '
                           'the range of its states', 'narrow the range to where it does')

    @cached_property
    def _run(self) -> Callable[[Sequence[Any]], np.ndarray]:
        return compile_expression(self.text, ('w1',))

    @cached_property
    def _ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """(value, slope) at low and at high."""
        step = END * (self.high - self.low)
        first, second, last, end = (float(self._run([np.float64(w)])) for w in (
            self.low, self.low + step, self.high - step, self.high))
        return (first, (second - first) / step), (end, (end - last) / step)

    def shown(self, linear: float, commands: float = 0.0) -> float:
        """Return what the sensor shows; commands: d u at that time."""
        if not self.text:
            return linear + self.offset
        w = linear - commands
        return self._value(w) + commands if math.isfinite(w) else math.nan

    def linear(self, shown: float, commands: float = 0.0) -> float:
        """Return the linear reading of what the sensor shows; commands: d u at that time."""
        if not self.text:
            return shown - self.offset
        return self._inverted(shown - commands) + commands if math.isfinite(shown) else math.nan

    def slope(self, linear: float, commands: float = 0.0) -> float:
        """Return how steep it is, without its sign, at a linear reading."""
        if not self.text:
            return 1.0
        w, step = linear - commands, 1e-4 * (self.high - self.low)
        if not math.isfinite(w):
            return 1.0
        return abs(self._value(w + step) - self._value(w - step)) / (2.0 * step)

    def _value(self, w: float) -> float:
        if w < self.low or w > self.high:
            at, (value, slope) = (self.low, self._ends[0]) if w < self.low else \
                (self.high, self._ends[1])
            return value + slope * (w - at)
        return float(self._run([np.float64(w)]))

    @cached_property
    def _inverted(self) -> Callable[[float], float]:
        return lru_cache(maxsize=64)(self._invert)  # a reading counts at several grid times

    def _invert(self, value: float) -> float:
        from scipy.optimize import brentq  # only where there is a curve
        (first, by_first), (end, by_end) = self._ends
        rises = 1.0 if end > first else -1.0
        if rises * (value - first) <= 0.0:
            return self.low + (value - first) / by_first
        if rises * (value - end) >= 0.0:
            return self.high + (value - end) / by_end
        fine = 1e-12 * max(abs(self.low), abs(self.high))
        return float(brentq(lambda w: float(self._run([np.float64(w)])) - value, self.low,
                            self.high, xtol=fine, rtol=1e-14))
