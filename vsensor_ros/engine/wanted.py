"""What is to go out for failed channels, now or as it was at an earlier time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
from typing import NamedTuple

from vsensor_ros.bank import Disagreement


class Wanted(NamedTuple):
    """What is to go out for a failed channel."""

    value: float | None  # NaN marks it as failed; None: nothing is to go out
    fault_set: tuple[str, ...] | None = None  # of the virtual sensor that says so
    deviation: float = math.inf  # standard deviation; inf when not known
    interval: tuple[float, float] | None = None  # in which the truth lies
    grade: str = ''
    above: Disagreement | None = None  # see Channel.serve
    run: str = ''  # of the virtual sensor


# what a virtual sensor (fault set, channel) said of a time [ns]: value, deviation, interval
Recall = Callable[[tuple[str, ...], str, int],
                  'tuple[float, float, tuple[float, float] | None] | None']


def recalled(wanted: Mapping[str, Wanted], time: int, recall: Recall) -> dict[str, Wanted]:
    """Return what is to go out as it was at an earlier time [ns]; NaN where nothing is known."""
    found = {}
    for name, now in wanted.items():
        found[name] = now
        if now.fault_set is not None:
            then = recall(now.fault_set, name, time)
            found[name] = Wanted(math.nan) if then is None else now._replace(
                value=then[0], deviation=then[1], interval=then[2])
    return found
