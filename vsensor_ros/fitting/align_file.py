"""Delays that were found, written into a plant file or a dataset file, whose comments stay."""

from __future__ import annotations

from pathlib import Path

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.fitting.align import Aligned
from vsensor_ros.fitting.plant_text import open_text, put, written
from vsensor_ros.fitting.result_file import rounded

DIGITS = 3


def into_plant(result: Aligned, plant: str | Path) -> tuple[str, dict[str, float]]:
    """
    Return the plant file with the late sensors' `stamp_offset`, and these by sensor [s].

    They come on top of those in the file. Raises BadInput.
    """
    content = open_text(plant)
    offsets = {}
    for name, found in result.late().items():
        entry = content['sensors'][name]
        before = _number(plant, f'sensors.{name}.stamp_offset', entry.get(
            'stamp_offset', 0.0) if isinstance(entry, dict) else 0.0)
        offsets[name] = _late(name, before + found, result)
        put(content, 'sensors', name, {'stamp_offset': offsets[name]}, 'measures')
    return written(content), offsets


def into_dataset(result: Aligned, dataset: str | Path) -> tuple[str, dict[str, float]]:
    """Return a dataset file with the late sensors' `delays`, as `into_plant` does."""
    content = open_text(dataset)
    delays = content.setdefault('delays', {})
    late = {}
    for name, found in result.late().items():
        late[name] = rounded(_number(dataset, f'delays.{name}', delays.get(name, 0.0)) + found,
                             DIGITS)
        delays[name] = late[name]
    if not delays:
        del content['delays']
    return written(content), late


def _number(where: str | Path, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise BadInput(where, key, f'{shown(value)} is no number', 'write it in seconds')
    return float(value)


def _late(name: str, delay: float, result: Aligned) -> float:
    if delay < -2.0 * result.errors[name]:
        raise BadInput('--reference', '', f'{name} is {-delay:.3g} s less late than '
                       f'{result.reference}, and no stamp_offset is below 0',
                       f'give --reference {name}, or none')
    return rounded(max(delay, 0.0), DIGITS)
