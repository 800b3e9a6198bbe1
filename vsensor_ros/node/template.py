"""The message that composed ones are made of, and what in it was measured."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from vsensor_ros.node.field_path import field_type, LARGEST_FLOAT


@dataclass(eq=False)
class Template:
    """A decoded message, with what was put into it since."""

    raw: bytes | None  # as it came; None: an empty message
    message: Any
    blanked: bool = False  # what was measured is no longer in it


def blank(message: Any, first: Any, last: Any) -> None:
    """
    Make NaN of each float of a message that differs between the first and the last of a driver.

    Such a number is a measurement; one that does not change is a property of the sensor.
    """
    for field, text in last.get_fields_and_field_types().items():
        kind = field_type(text)
        target, before, after = (getattr(m, field) for m in (message, first, last))
        if kind.inner in LARGEST_FLOAT:
            if not kind.is_array:
                if before != after:
                    setattr(message, field, math.nan)
                continue
            here = min(len(target), len(after))  # it may have been cut to its names
            shared = min(len(before), here)
            for i in np.flatnonzero(np.asarray(before[:shared]) != np.asarray(after[:shared])):
                target[i] = math.nan
            for i in range(shared, here):
                target[i] = math.nan
        elif '/' in kind.inner:
            if not kind.is_array:
                blank(target, before, after)
                continue
            unknown = type(after[0])() if len(after) > len(before) else None
            for i, element in enumerate(after[:len(target)]):
                blank(target[i], before[i] if i < len(before) else unknown, element)
