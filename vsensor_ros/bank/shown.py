"""What sensors show of the linear readings that are estimated: their offsets and curves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsensor_ros.functions.curve import Curve
from vsensor_ros.observers import Design, Key


class Shown:
    """The curves of some outputs; of all others the linear reading is what is shown."""

    def __init__(self, design: Design, keys: Sequence[Key]) -> None:
        """Prepare for the outputs of these keys."""
        # with what the curve adds of commands (m,), None: nothing
        self._curves: dict[int, tuple[Curve, np.ndarray | None]] = {}
        for output, (_, channel) in enumerate(keys):
            if channel in design.curves:
                curve = design.curves[channel]
                self._curves[output] = curve, np.array([
                    curve.beside.get(u, 0.0) for u in design.inputs]) if curve.beside else None

    def __contains__(self, output: int) -> bool:
        """Tell whether an output has a curve."""
        return output in self._curves

    def value(self, output: int, linear: float, held: np.ndarray) -> float:
        """Return what is shown of a linear reading; held (m,): the commands then."""
        if output not in self._curves:
            return linear
        curve, beside = self._curves[output]
        return curve.shown(linear, 0.0 if beside is None else float(beside @ held))

    def interval(self, output: int, interval: tuple[float, float] | None,
                 held: np.ndarray) -> tuple[float, float] | None:
        """Return the interval that is shown of one of linear readings."""
        if output not in self._curves or interval is None:
            return interval
        low, high = sorted(self.value(output, end, held) for end in interval)
        return low, high

    def steepness(self, output: int, linear: float, held: np.ndarray) -> float:
        """Return by what a small difference of linear readings is to be multiplied."""
        if output not in self._curves:
            return 1.0
        curve, beside = self._curves[output]
        return curve.slope(linear, 0.0 if beside is None else float(beside @ held))
