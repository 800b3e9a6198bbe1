"""Which sensor's fault can be told from which, by the plant and by the residuals at hand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from vsensor_ros.observers.entry import Entry

# how a fault shows: a constant one stays visible; only its onset does; not at all
STRONG, WEAK, NONE = 'strong', 'weak', 'none'
STRENGTHS = (NONE, WEAK, STRONG)  # ascending


@dataclass(frozen=True)
class Residual:
    """
    A number that is zero but for noise while the sensors of its support are healthy.

    Unknown inputs do not reach it. It is ``y - vhat`` of ``entries[fault_set, channel]`` of the
    design, as that runs while its channel is believed: a temporary one tracks. A dedicated filter
    puts it out itself: its channel is no sensor, and it stands in ``Isolability.filters``.
    """

    name: str
    fault_set: tuple[str, ...]  # of its observer
    channel: str  # of its observer
    support: tuple[str, ...]  # the sensors that it is made of, in the plant's order
    # for each of the support what a constant fault of one unit makes of it in the end; 0: only the
    # onset shows; None: not known
    gains: tuple[float | None, ...]
    noise: float  # standard deviation while all are healthy, in the unit of its channel
    threshold: float  # what white noise of that size exceeds once a day; a start, not a figure
    assumed: bool = False  # some of the noise was not given and is a default

    def shows(self, sensor: str) -> str:
        """Return how a fault of a sensor shows in it: 'strong', 'weak' or 'none'."""
        if sensor not in self.support:
            return NONE
        return STRONG if self.gains[self.support.index(sensor)] else WEAK

    def motion(self) -> dict[str, float]:
        """
        Return how much of the motion of which sensors is in it, as far as the model errs.

        Of ``y - vhat`` all that its channel does. One that is corrected by its channel, and a
        dedicated filter, keep of their readings what their gains say.
        """
        gains = dict(zip(self.support, self.gains))
        if gains.get(self.channel, 0.0) != 0.0:
            return {self.channel: 1.0}
        return {sensor: abs(gain or 0.0) for sensor, gain in gains.items()}


@dataclass(frozen=True)
class Distinction:
    """How well a fault of a sensor can be told from faults of others; of none: be detected."""

    sensor: str
    others: tuple[str, ...]  # in the plant's order
    strength: str  # of the best residual of this plant that reads the sensor and none of others


@dataclass(frozen=True, eq=False)
class Isolability:
    """What can be isolated: the residuals, their dedicated filters, and what a plant allows."""

    residuals: tuple[Residual, ...]
    # filters that are there for their residual only, by its channel: ``vhat`` is the residual.
    # Their fault set is what they do not read
    filters: Mapping[str, Entry] = field(default_factory=dict)
    plant: tuple[Distinction, ...] = ()  # what any residuals could do
    gaps: tuple[str, ...] = ()  # what cannot be told, and why: one sentence each

    def by_residuals(self, sensor: str, others: Iterable[str] = ()) -> str:
        """Return how well these residuals tell a fault of a sensor from faults of others."""
        return max((r.shows(sensor) for r in self.residuals
                    if not set(others) & set(r.support)), key=STRENGTHS.index, default=NONE)

    def sharpness(self, sensor: str, others: Iterable[str] = ()) -> float:
        """Return by how many standard deviations a constant fault of 1 shows, beside others'."""
        return max((abs(r.gains[r.support.index(sensor)] or 0.0) / r.noise
                    for r in self.residuals if r.noise > 0.0 and sensor in r.support
                    and not set(others) & set(r.support)), default=0.0)
