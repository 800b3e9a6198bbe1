"""
By how much the stamps of sensors are late, as far as the plant says what belongs together.

Only differences are seen, so that one sensor is the reference, whose stamps count as right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.fitting.align_search import CLEAR, Progress, Search
from vsensor_ros.fitting.align_windows import Channels
from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.windows import check_channels
from vsensor_ros.plant.checked import suggestion
from vsensor_ros.plant.free import FreePlant
from vsensor_ros.recordings import Recording


@dataclass(frozen=True, eq=False)
class Aligned:
    """
    What was found, by channel: delay [s] against the reference, and its standard error.

    delays: of sensors, by which their stamps are later than what they are of, besides what the
    plant file says; of commands, by which they act later. errors: inf where nothing tells it.
    """

    reference: str
    delays: dict[str, float]
    errors: dict[str, float]
    commands: tuple[str, ...]
    count: int
    seconds: float

    def clear(self, name: str) -> bool:
        """Tell whether a delay is more than none, or less, by three standard errors."""
        return name != self.reference and abs(self.delays[name]) > CLEAR * self.errors[name]

    def late(self) -> dict[str, float]:
        """Return the delays of sensors that are clear."""
        return {name: delay for name, delay in self.delays.items()
                if name not in self.commands and self.clear(name)}


def align(given: FreePlant, runs: Sequence[Recording], most: float | None = None,
          reference: str | None = None, progress: Progress = None) -> Aligned:
    """
    Find the delays of a plant's channels in recordings.

    given: by `load_free(path, every=True)`, so that its parameters float. most: the longest delay
    that is looked for [s]; without it 1 s, or 10 readings. reference: the sensor whose stamps are
    right; without one it is that which is late the least. Raises BadInput, one line.
    """
    model = Model(given)
    check_channels(runs, model, given.plant.name)
    channels = Channels.of(model, runs)
    most = max(1.0, 10.0 * channels.step) if most is None else most
    if most < channels.step:
        raise BadInput('--most', '', f'{most:g} s is less than between two readings',
                       f'give {channels.step:g} or more')
    seen = [s for i, s in enumerate(model.sensors) if any(len(r[i][0]) for r in channels.sensors)]
    if reference is not None and reference not in seen:
        raise BadInput('--reference', '', f'{reference} is no sensor of the recording',
                       suggestion(reference, seen))
    if len(seen) + len(model.inputs) < 2:
        raise BadInput(given.plant.name, '', 'only one channel is in the recording',
                       'record two that the plant relates')
    search = Search(channels, most, seen, progress)
    late, errors = search.run()
    names = [search.names[i] for i in search.free]
    at = _reference(late, errors, len(seen)) if reference is None else names.index(reference)
    signs = np.array([1.0 if name in seen else -1.0 for name in names])
    run, _, count = search.where
    return Aligned(names[at], dict(zip(names, ((late - late[at]) * signs).tolist())),
                   dict(zip(names, errors[at].tolist())), model.inputs, len(run),
                   count * channels.step)


def _reference(late: np.ndarray, errors: np.ndarray, sensors: int) -> int:
    """Return which sensor is known the best, of those than which none is clearly less late."""
    d, between = late[:sensors], errors[:sensors, :sensors]
    first = [i for i in range(sensors) if not (d - d[i] < -CLEAR * between[i])[
        np.arange(sensors) != i].any()]
    return min(first or range(sensors), key=lambda i: float(np.median(between[i])))
