"""What a sensor says while it is faulty, reading by reading."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

import numpy as np

KINDS = ('drop_out', 'freeze', 'bias', 'drift', 'noise', 'nan')

Fault = Callable[[float, float], 'float | None']  # (s since its start, reading): what is said


def fault(kind: str, before: float, size: float, length: float,
          seed: Sequence[int] = (0,)) -> Fault:
    """
    Return a fault of one sensor; it says None where nothing comes.

    before: its last reading. size: of a bias [unit of the sensor]; a drift reaches it after
    `length` [s], noise has a third of it as its standard deviation.
    """
    if kind == 'freeze':
        return lambda elapsed, reading: before
    if kind == 'bias':
        return lambda elapsed, reading: reading + size
    if kind == 'drift':
        return lambda elapsed, reading: reading + size * elapsed / length
    if kind == 'noise':
        random = np.random.default_rng(list(seed))
        return lambda elapsed, reading: reading + size / 3.0 * random.standard_normal()
    if kind == 'nan':
        return lambda elapsed, reading: math.nan
    if kind != 'drop_out':
        raise ValueError(f'{kind} is none of {", ".join(KINDS)}')
    return lambda elapsed, reading: None
