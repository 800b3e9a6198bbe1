"""
The life of one channel: where its values come from, why, since when, and how often that changed.

Here alone it is decided what a channel *is*, as its listeners see it: 'real', 'silent' (healthy,
but not heard), 'virtual' or 'none'.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from vsensor_ros.bank import Angle, Disagreement
from vsensor_ros.engine.bumpless import Bumpless
from vsensor_ros.engine.decision import Decision, Source
from vsensor_ros.reason import Reason

REAL, SILENT, VIRTUAL = 'real', 'silent', 'virtual'
NONE = 'none'  # nothing, or something in place of a value: the last one, NaN, the failed reading


@dataclass(eq=False)
class Channel:
    """
    What goes out of one channel. Times are in ns, with the jumps of clocks taken out.

    A switch is counted when the first message of another source goes out, or when none does.
    """

    name: str
    max_age: int  # of what went out, to be continued without a step
    blend: Bumpless  # what is left of the offset of the last switch
    source: str = REAL  # of what went out last: real, virtual or none
    fault_set: tuple[str, ...] = ()  # of the virtual sensor, if that is the source
    run: str = ''  # of it
    since: int | None = None  # the last switch
    virtual: int = 0  # in all in virtual mode, up to the last switch
    switches: int = 0
    value: float = math.nan  # that went out last
    deviation: float = 0.0  # of that, without its offset; inf when not known
    sent: int | None = None  # when
    readings: int = 0  # that came in
    why: Reason | None = None  # there is no valid value of it, though there should be one
    angle: Angle | None = None  # how it wraps, if it does

    def state(self, decision: Decision, silent: Reason | None,
              odd: Reason | None = None) -> tuple[str, Reason | None]:
        """
        Return what it is, and why, given who is to serve it.

        silent: why its driver is not heard. odd: what is to be said of it while it is.
        """
        if decision.source is Source.REAL:
            if silent is not None:
                return SILENT, silent
            return (REAL, odd or decision.reason) if self.why is None else (NONE, self.why)
        if self.why is None and decision.source is Source.VIRTUAL:
            return VIRTUAL, decision.reason
        return NONE, self.why or decision.reason

    def serve(self, source: str, fault_set: tuple[str, ...], value: float, now: int,
              above: Disagreement | None = None, deviation: float = 0.0, run: str = '') -> float:
        """
        Return what is to go out for the value of a source, which may be another one than before.

        run: which of the runs of a virtual sensor says it. There is no step when that changes, but
        it is no switch.

        above: by how much the old source lies above the new one, NaN if that is not known; None:
        by what went out last. There is no offset to what was no value, or is too long ago. What
        may be a fault passes soon. So does, from one virtual sensor to a surer one, or from one
        run to another, what is beyond the deviation of that: the error of the old one is not to
        burden it. What wraps is put into its driver's range, but for a reading with nothing added.
        """
        turned = (source, fault_set) != (self.source, self.fault_set)
        if turned or run != self.run:
            before, usual, rest = math.nan, math.nan, math.nan
            if self.source != NONE and self.sent is not None and now - self.sent <= self.max_age:
                before = self.value
                if above is None:
                    whole = usual = self.shortest(before - value)
                    if not turned or (self.source == source == VIRTUAL
                                      and deviation < self.deviation):
                        usual = max(-deviation, min(usual, deviation))
                else:
                    usual = above.usual
                    whole = self.shortest(usual + above.rest + self.blend.left(now))
                rest = whole - usual
            if turned:
                self._turn(source, fault_set, now)
            self.blend, self.run = self.blend.begin(now, usual, before, rest), run
        output = self.blend.add(value, now)
        if self.angle is None:
            self.blend = self.blend.sent(output)
        else:
            if source != REAL or output != value:
                output = self.angle.put(output, value if source == REAL else self.value)
            self.blend = self.blend.sent(self.angle.next_to(output, self.blend.before))
        self.value, self.sent, self.deviation = output, now, deviation
        return output

    def shortest(self, difference: float) -> float:
        """Return a difference of two of its values, the short way round if it wraps."""
        return difference if self.angle is None else self.angle.shortest(difference)

    def as_said(self, value: float, near: float = math.nan) -> float:
        """Return a value as its driver would say it; near: next to this, if it need be."""
        return value if self.angle is None else self.angle.put(value, near)

    def beside(self, interval: tuple[float, float] | None, estimate: float | None,
               now: int) -> tuple[float, float] | None:
        """Return an interval about an estimate as one about what went out instead of it."""
        if self.angle is None or interval is None or estimate is None:
            return interval
        turns = self.angle.whole(self.value - self.blend.left(now) - estimate)
        return interval[0] + turns, interval[1] + turns

    def stop(self, now: int) -> None:
        """Note that no value goes out from now on."""
        if self.source != NONE:
            self._turn(NONE, (), now)
            self.blend = self.blend.begin(now, 0.0)

    def virtual_time(self, now: int) -> int:
        """Return how long in all it was virtual."""
        return self.virtual + (now - (self.since or 0) if self.source == VIRTUAL else 0)

    def _turn(self, source: str, fault_set: tuple[str, ...], now: int) -> None:
        self.virtual = self.virtual_time(now)
        self.source, self.fault_set, self.since = source, fault_set, now
        self.switches += 1
