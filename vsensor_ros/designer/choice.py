"""
Which of several virtual sensors is handed out: the one that holds where the plant works.

They come in the order of their rank. What is certified everywhere goes before what is certified
on the declared ranges, that before what is certified in a region, and that before the rest; among
equals the rank decides. A first one that holds everywhere, as a linear error does, costs no more
than its own certificate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import islice

from vsensor_ros.designer.certificate import (
    Box,
    certify,
    everywhere,
    MOST_TRIED,
    near_the_point,
    nowhere,
    on_ranges,
    promising,
    WORTHWHILE,
)
from vsensor_ros.designer.uncovered import unstable_at
from vsensor_ros.observers import Certificate, VirtualSensor
from vsensor_ros.plant.plant import Plant

Certified = tuple[VirtualSensor, Certificate]


def most_valid(plant: Plant, ranked: Iterable[VirtualSensor]) -> Certified:
    """Return the one of most validity, of these the first, with its certificate."""
    ranked = iter(ranked)
    first = next(ranked)
    try:
        certificate = everywhere(plant, first)
        if certificate is not None:
            return first, certificate
        sensors = [first, *ranked]
        found = _first(plant, sensors[1:], None, everywhere)
        for share in (WORTHWHILE, 0.0):
            found = found or _first(plant, sensors, (plant.ranges, plant.input_range),
                                    partial(on_ranges, share=share))
        if found is None:
            # those that are unstable nowhere on the declared ranges before the others
            sensors.sort(key=lambda one: unstable_at(plant, one) != '')
            found = near_the_point(plant, sensors)
        return found or (sensors[0], nowhere(plant, sensors[0]))
    except ImportError:
        return first, certify(plant, first)


def _first(plant: Plant, sensors: Sequence[VirtualSensor], box: Box | None,
           proved: Callable[[Plant, VirtualSensor], Certificate | None]) -> Certified | None:
    """Return the first of which it is proved, if it is one of the first that are promising."""
    promised = (sensor for sensor in sensors if promising(plant, sensor, box))
    for sensor in islice(promised, MOST_TRIED):
        certificate = proved(plant, sensor)
        if certificate is not None:
            return sensor, certificate
    return None
