"""For how long a temporary virtual sensor is good, in words."""

from __future__ import annotations

import numpy as np

from vsensor_ros.designer.slow import unlearnt
from vsensor_ros.observers import Design, deviation_after, horizon, VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.report.design_text import number

DECADES = 3  # of tolerances, where none is given
GROWN, ROWS = 10.0, 7  # times what it is at the loss; of the table of its growth
TELLING = 1.2  # times as long, from which on learning a slow offset is worth a word
_UNITS = ((120.0, 1.0, 's'), (7200.0, 60.0, 'min'), (172800.0, 3600.0, 'h'),
          (np.inf, 86400.0, 'days'))  # up to so many s, a unit of so many


def tolerances(design: Design, entry: VirtualSensor) -> list[float]:
    """Return how far off it may be: what is given or a tenth of the range, else decades."""
    given = design.tolerance(entry.channel)
    if given is not None:
        return [given]
    first = float(deviation_after(entry, 0.0))
    if not 0.0 < first < np.inf:
        return []
    decade = np.floor(np.log10(first)) + 1.0
    return [float(f'1e{decade + i:.0f}') for i in range(DECADES)]


def good_for(entry: VirtualSensor, allowed: list[float], unit: str) -> str:
    """Say until when it is good for what: 'for 4.1 s to 0.01 rad, for 38 s to 0.1 rad'."""
    said = []
    for tolerance in allowed:
        seconds = horizon(entry, tolerance)
        to = f'to {number(tolerance, unit)}'
        if not np.isfinite(seconds):
            said.append(f'for years {to}')
            break
        said.append(f'for {duration(seconds)} {to}' if seconds else f'never {to}')
    first = f'{number(float(deviation_after(entry, 0.0)), unit)} at the loss'
    assumed = entry.tracking is not None and entry.tracking.assumed
    return '; '.join([*([', '.join(said)] if said else []), first,
                      *['assumed noise'] * assumed])


def learning(plant: Plant, entry: VirtualSensor, allowed: list[float], unit: str) -> str:
    """Say what it is worth to learn the slow offsets while the channel is healthy, or ''."""
    without = unlearnt(plant, entry)
    if without is None:
        return ''
    slow = ', '.join(name for name, is_slow in zip(plant.states, plant.slow) if is_slow)
    for tolerance in allowed:
        known, not_known = horizon(entry, tolerance), horizon(without, tolerance)
        if known > TELLING * not_known:
            return (f'good for {duration(known)} to {number(tolerance, unit)} with {slow} learnt, '
                    f'instead of {duration(not_known)}')
    return ''


def growth(entry: VirtualSensor, unit: str) -> list[tuple[str, str]]:
    """Return times after the loss, up to where it has grown, and the deviation then."""
    times = [step * 10.0**decade for decade in range(-1, 7) for step in (1.0, 3.0)]
    grown = deviation_after(entry, times) > GROWN * deviation_after(entry, 0.0)
    end = max(int(np.argmax(grown)) if grown.any() else len(times) - 1, ROWS - 1)
    times = [0.0, *times[end + 1 - ROWS:end + 1]]
    return [(duration(t), number(d, unit)) for t, d in zip(times, deviation_after(entry, times))]


def duration(seconds: float) -> str:
    """Return a time of two digits: '4.1 s', '6.5 min'."""
    size, unit = next((size, unit) for limit, size, unit in _UNITS if seconds < limit)
    value = seconds / size
    return f'{value:.2g} {unit}' if value < 99.5 else f'{value:.0f} {unit}'
