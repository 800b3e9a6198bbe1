"""What a design holds, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from vsensor_ros.functions.curve import Curve
from vsensor_ros.observers.entry import Entry, Key, Refusal
from vsensor_ros.observers.fault_size import FaultSizes
from vsensor_ros.observers.isolability import Isolability


@dataclass(frozen=True, eq=False)
class Contents:
    """What a design file holds: a plant in names, and its entries by fault set and channel."""

    plant_name: str
    plant_hash: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    sensors: tuple[str, ...]
    units: dict[str, str]
    sample_time: float | None
    # a virtual sensor of several outputs stands under each of them
    entries: Mapping[Key, Entry | Refusal]
    wanted: tuple[str, ...] = ()  # functionals that are no sensors: their fault set may be ()
    Cu: np.ndarray | None = None  # (l, m) what sensors read directly of inputs; None: not known

    # how far off an estimate may be to be of use, and where readings lie, by sensor, in its unit
    tolerances: Mapping[str, float] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # sensors that wrap: of each angle who reads it, and what a turn is in that reading, negative
    # if it runs the other way
    wrap: tuple[Mapping[str, float], ...] = ()
    # by sensor that shows an offset, or a curve, of its linear reading
    curves: Mapping[str, Curve] = field(default_factory=dict)
    # [s] by command: when it acts after it was given; by sensor: what it says is so old
    delays: Mapping[str, float] = field(default_factory=dict)
    # standard deviation of one reading, by sensor of which it is known, in its unit
    noise: Mapping[str, float] = field(default_factory=dict)
    isolability: Isolability | None = None  # None: it was not asked for
    fault_sizes: FaultSizes | None = None  # likewise

    def __post_init__(self) -> None:
        if self.Cu is not None:
            self.Cu.flags.writeable = False

    def tolerance(self, channel: str) -> float | None:
        """Return what is given for a sensor, else a tenth of its range; None: neither is known."""
        if channel in self.tolerances:
            return self.tolerances[channel]
        low, high = self.ranges.get(channel, (0.0, 0.0))
        return (high - low) / 10 or None

    def each_once(self) -> tuple[Entry | Refusal, ...]:
        """Return all entries; a virtual sensor of several outputs counts once."""
        return tuple({(entry.fault_set, entry.channel): entry
                      for entry in self.entries.values()}.values())
