"""How uncertain an estimate may be: beyond that it is not valid, and the reason says why."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math

from vsensor_ros.observers import Design, Entry
from vsensor_ros.reason import Reason

SHARE = 0.01  # of the range: a model that is so near is good, whatever was designed for
TIMES = 10.0  # the figure that it was designed for
# codes of the reasons why a deviation is too large
BEYOND = {'too uncertain', 'beyond the tolerance', 'beyond a tenth of the range'}


@dataclass(frozen=True)
class Limits:
    """
    The limits of a design's estimates.

    A number that is given for a sensor counts alone. Else a deviation may be at most the tolerance
    of the plant file, or a tenth of the sensor's range; and what was measured beside the healthy
    sensor at most TIMES the design's figure. What is not known is not limited. But where the
    deviation is bound to grow, as of temporary virtual sensors, there must be a limit.
    """

    design: Design
    given: Mapping[str, float | None]  # by sensor, in its unit; 0: no limit; None: those above

    def exceeded(self, entry: Entry, channel: str, deviation: float,
                 measured: Callable[[], float], grows: bool = False,
                 share: float = 1.0) -> Reason | None:
        """
        Return why the estimate of a channel is not good enough, or None when it is.

        deviation: of the estimate now, inf when not known. measured: returns its rms error while
        the sensor was healthy, NaN when not known. grows: its deviation is bound to. share: of the
        limits that it must be within.
        """
        limit = self.largest(channel, grows)
        if limit is None:
            return Reason('no limit')
        limit *= share
        # where the design sets the limit, what is not known is not beyond it
        if deviation > limit and (deviation < math.inf or grows
                                  or self.given[channel]):
            code = 'too uncertain' if self.given[channel] else 'beyond the tolerance' \
                if channel in self.design.tolerances else 'beyond a tenth of the range'
            return Reason.of(code, deviation=deviation, limit=limit)
        if self.given[channel] is not None or grows:
            return None
        return self._unlike(entry, channel, deviation, measured, share)

    def largest(self, channel: str, grows: bool) -> float | None:
        """Return the largest deviation with which it serves; inf: any; None: with none."""
        given = self.given[channel]
        if given or (given is not None and not grows):
            return given or math.inf
        limit = self.design.tolerance(channel)
        return limit if limit is not None or grows else math.inf

    def _unlike(self, entry: Entry, channel: str, deviation: float,
                measured: Callable[[], float], share: float) -> Reason | None:
        """
        Return that it is far worse than designed.

        A figure that is made of assumed noise, or of none, says nothing of that. Nor does what is
        left of the start, or a reading that comes late: that passes, and is in the deviation. But
        where something surer serves than what was measured, that was no good measure of it.
        """
        if entry.noise is None or entry.noise.assumed or not entry.noise.error:
            return None
        low, high = self.design.ranges.get(channel, (0.0, 0.0))
        limit = share * max(TIMES * entry.noise.error, SHARE * (high - low))
        if deviation > limit and (found := measured()) > limit:
            return Reason.of('worse than designed', measured=found, limit=limit,
                             figure=entry.noise.error)
        return None
