"""What a sensor must do to be believed again after a fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

from vsensor_ros.observers import Design

RECOVERY = {'automatic': 'recovering', 'hold': 'held', 'latched': 'latched'}  # reasons' codes


@dataclass(frozen=True)
class Policy:
    """
    What one sensor must do to be believed again after a fault.

    'automatic': be healthy for the dwell; 'hold': be cleared, too; 'latched': all are reset.
    Raises ValueError, one line.
    """

    recovery: str = 'automatic'
    dwell: float = 2.0  # s of health without interruption before it is believed; 0: none
    silent_is_faulty: bool = False

    def __post_init__(self) -> None:
        if self.recovery not in RECOVERY:
            raise ValueError(f'recovery: {self.recovery!r} is none of {", ".join(RECOVERY)}')
        if not (math.isfinite(self.dwell) and self.dwell >= 0.0):
            raise ValueError(f'dwell: {self.dwell} is not a time in s; give 0 or more')


def complete(design: Design, policies: Mapping[str, Policy]) -> dict[str, Policy]:
    """Return the policies of all sensors, the default where none is given; raises KeyError."""
    unknown = sorted(set(policies).difference(design.sensors))
    if unknown:
        raise KeyError(f'{", ".join(unknown)}: no such sensor')
    return {s: policies.get(s, Policy()) for s in design.sensors}
