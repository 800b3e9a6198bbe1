"""Write what a fit found back into the plant file: values, spreads, noise, and what it was of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.fitting.fit import Fit
from vsensor_ros.fitting.plant_text import open_text, put, written
from vsensor_ros.whole_file import write_whole

BEGIN, END = 'fitted by the command fit:', '(end of what fit wrote)'
DIGITS = 6
USUAL = 99.0  # Hz; without a rate one reading in 10 ms is assumed


def fitted_text(result: Fit, path: str | Path, comment: Sequence[str],
                content: Any = None) -> str:
    """
    Return the plant file with the values of a fit in it, and a comment at its head.

    content: what is written in place of what stands in the file, as `open_text` gives it. Raises
    BadInput, one line.
    """
    content = open_text(path) if content is None else content
    free = result.model.given.free
    for i, parameter in enumerate(free):
        numbers = {'value': rounded(result.values[i])}
        if np.isfinite(result.spreads[i]) and result.spreads[i] > 0.0:
            numbers['spread'] = rounded(result.spreads[i], 3)
        put(content, 'parameters', parameter.name, numbers, 'value')
    plant = result.model.given.plant
    for name, noise, rate, said in zip(result.model.sensors, result.noise.sensors, result.rates,
                                       plant.sensor_rate):
        numbers = {'noise': rounded(noise, 3)}
        if np.isnan(said) and plant.sample_time is None and rate < USUAL:
            numbers['rate'] = rounded(rate, 3)
        put(content, 'sensors', name, numbers, 'measures')
    for name, noise, told in zip(result.model.given.states, result.noise.driven,
                                 result.model.told()):
        if told:
            continue
        noise *= result.model.given.seconds**0.5
        put(content, 'states', name, {'process_noise': rounded(noise, 3)})
    text = written(content)
    return headed(text, comment)


def headed(text: str, comment: Sequence[str]) -> str:
    """Return a text under a comment, which replaces the one of an earlier fit."""
    lines = text.splitlines()
    if f'# {BEGIN}' in lines and f'# {END}' in lines:
        first, last = lines.index(f'# {BEGIN}'), lines.index(f'# {END}')
        del lines[first:last + 1]
    head = [f'# {BEGIN}', *(f'#   {line}'.rstrip() for line in comment), f'# {END}']
    return '\n'.join([*head, *lines]) + '\n'


def write_fitted(path: str | Path, text: str) -> None:
    """Write it whole or not at all; raise BadInput."""
    try:
        write_whole(path, text)
    except (OSError, ValueError) as error:
        raise BadInput(path, '', f'cannot be written ({reason(error)})',
                       'choose another -o') from None


def rounded(value: float, digits: int = DIGITS) -> float:
    """Return a number with so many digits."""
    return float(f'{value:.{digits}g}')
