"""The grid of times on which a bank is stepped, and how far back it goes. Times are in ns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank.inputs import ages_of
from vsensor_ros.observers import Design

_LONGEST = 1000  # steps that can be taken back, at most


@dataclass(frozen=True)
class Grid:
    """What a rate, and what is known of when readings come, make of the times of a design."""

    period: int
    ages: Mapping[str, int]  # by sensor: its max_age, on the shifted stamps
    shifts: Mapping[str, int]  # put on stamps: a reading tells of earlier, a command acts later
    span: int  # steps that can be taken back; readings from before are as they were held
    jump: int  # steps that the clock may jump ahead without a restart


def grid_of(design: Design, rate: float, max_age: float | Mapping[str, float],
            jump_ahead: float | None) -> Grid:
    """Return the grid of a bank, see `Steps`; raises BadInput when a number does not suit."""
    if not (math.isfinite(rate) and 0.0 < rate <= 1e6):
        raise BadInput('', 'rate', f'{rate} is not a rate in Hz', 'give a number above 0')
    if design.sample_time is not None and abs(rate * design.sample_time - 1.0) > 1e-6:
        raise BadInput('', 'rate', f'{rate:g} Hz does not suit a plant with the sample time '
                       f'{design.sample_time:g} s', f'give {1.0 / design.sample_time:g}')
    if jump_ahead is not None and not jump_ahead > 0.0:
        raise BadInput('', 'jump_ahead', f'{jump_ahead} is not a time in s',
                       'give a number above 0')
    period = round(1e9 / rate)
    ages = ages_of(design.sensors, max_age, 3 * period)
    shifts = {name: round(1e9 * (-delay if name in ages else delay))
              for name, delay in design.delays.items()}
    for name, shift in shifts.items():
        if (steps := -shift / period) >= _LONGEST:
            raise BadInput('', name, f'is {-shift * 1e-9:g} s late, {steps:.4g} steps at '
                           f'{rate:g} Hz, of which {_LONGEST} are kept',
                           'lower the rate, or the delay in the plant file')
    ages = {name: age - shifts.get(name, 0) for name, age in ages.items()}
    span = min(2 * max(ages.values(), default=period) // period + 1, _LONGEST)
    jump = _LONGEST if jump_ahead is None else max(
        3, min(round(min(jump_ahead, 1e9) * 1e9 / period), 10 * _LONGEST))
    return Grid(period, ages, shifts, span, jump)
