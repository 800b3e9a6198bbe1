"""What an isolator is told, checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import math

from vsensor_ros.bad_input import BadInput, shown

MODES = ('off', 'advise', 'act')
RECOVERIES = ('hold', 'return')


@dataclass(frozen=True)
class Settings:
    """Raises BadInput where a value cannot be used."""

    mode: str = 'advise'  # off: looks at nothing; advise: says; act: sensors are not believed
    false_alarms_per_day: float = 1.0
    model_error: float = 0.1  # of motion beyond what was learnt is added to thresholds
    # by sensor, the fault [unit of the sensor] that has to be found; says when it cannot be
    smallest_fault: Mapping[str, float] = field(default_factory=dict)
    recovery: str = 'hold'  # hold: faulty until cleared; return: believed when it has come back
    dwell: float = 10.0  # s for which it has to have come back

    def __post_init__(self) -> None:
        for key, words in (('mode', MODES), ('recovery', RECOVERIES)):
            if getattr(self, key) not in words:
                raise BadInput('isolator', key, f'{shown(getattr(self, key))} is not one of '
                               f'{", ".join(words)}', 'choose one of them')
        for key in ('false_alarms_per_day', 'model_error', 'dwell'):
            _check(key, getattr(self, key))
        for name, value in self.smallest_fault.items():
            _check(f'smallest_fault.{name}', value)
        if not 1e-6 <= self.false_alarms_per_day <= 1e4:
            raise BadInput('isolator', 'false_alarms_per_day',
                           f'{self.false_alarms_per_day:g} is not between 1e-6 and 1e4',
                           '1 is usual')
        if self.model_error > 1.0:
            raise BadInput('isolator', 'model_error', f'{self.model_error:g} is more than 1',
                           'it is a share of the motion; 0.1 is usual')


def _check(key: str, value: object) -> None:
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not (
            math.isfinite(value) and value >= 0.0):
        raise BadInput('isolator', key, f'{shown(value)} is not a number of 0 or more',
                       'give a finite one')
