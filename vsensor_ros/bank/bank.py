"""What the virtual sensors of a design say, how sure they are, and why one says nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import islice
import math
from types import MappingProxyType

import numpy as np

from vsensor_ros.bank.commands import End
from vsensor_ros.bank.deviations import Deviations
from vsensor_ros.bank.estimates import Disagreement, Estimates
from vsensor_ros.bank.lacks import Lacks
from vsensor_ros.bank.record import Rehearsal
from vsensor_ros.bank.serving import Serving
from vsensor_ros.bank.shown import Shown
from vsensor_ros.bank.state import stacked
from vsensor_ros.bank.steps import Steps
from vsensor_ros.observers import Design, Entry, Key, Refusal
from vsensor_ros.reason import Reason

INDEPENDENT, FREE = '', 'from the last good readings'  # runs


class Bank(Steps):
    """
    Every virtual sensor of a design, stepped as told in `Steps`, and what each says.

    They are asked for by fault set and channel: ``estimate(('y1', 'y2'), 'y1')``. Wanted
    functionals are stepped, too: ``estimate((), 'v')``.
    """

    def __init__(self, design: Design, rate: float, max_age: float | Mapping[str, float] = 0.5,
                 jump_ahead: float | None = None,
                 command_ends: Mapping[str, End] = MappingProxyType({}),
                 guard: Mapping[str, float] = MappingProxyType({})) -> None:
        """Prepare, see `Steps`; raises BadInput."""
        super().__init__(design, rate, max_age, jump_ahead, command_ends, guard)
        self._entries = {(frozenset(fault_set), channel): entry
                         for (fault_set, channel), entry in design.entries.items()}
        self._output = {(frozenset(fault_set), channel): i
                        for i, (fault_set, channel) in enumerate(self._batch.keys)}
        self._serving = Serving(self._batch, self._runs, self._past, self._of_tracked,
                                self.period * 1e-9, self._short_way)
        self._deviations = Deviations(
            self._batch, self._runs, self._spreads, self._measured, self._past,
            self.period * 1e-9, self._ages_at, self._widening)
        self._estimates = Estimates(self._batch, self._runs, self._serving, self._measured,
                                    self._past, self.period * 1e-9, self.angles)
        self._shown = Shown(design, self._batch.keys)
        self._lacks = Lacks(self._batch, self._runs, self._flights, self._serving,
                            self._deviations, self._told, self._past)

    def entry(self, fault_set: Iterable[str], channel: str) -> Entry | Refusal | None:
        """Return what was designed for a channel; None: nothing."""
        return self._entries.get((frozenset(fault_set), channel))

    def estimate(self, fault_set: Iterable[str], channel: str) -> float | None:
        """Return what the failed sensor would say at `time`; None when there is no answer."""
        output = self._running(fault_set, channel)
        if output is None:
            return None
        if channel in self._shifts:  # it would speak of earlier
            said = self.recall(fault_set, channel, self._at(self._past[-1].tick))
            return None if said is None else said[0]
        value = float(self._estimates.at(self._past[-1])[output])
        if output in self._shown:
            value = self._shown.value(output, value, self._past[-1].told.held)
        return value if math.isfinite(value) else None

    def recall(self, fault_set: Iterable[str], channel: str, time: int,
               ) -> tuple[float, float, tuple[float, float] | None] | None:
        """
        Return what is known by now of an earlier time [ns]: estimate, deviation, interval.

        Between grid times it is interpolated; after the last it is the last. None when the
        virtual sensor did not run then, or nothing is known of that time any more.
        """
        output = self._output.get((frozenset(fault_set), channel))
        time += self._shifts.get(channel, 0)
        if output is None or not self._past or time < self._at(self._past[0].tick):
            return None
        steps, rest = divmod(time - self._at(self._past[0].tick), self.period)
        last = len(self._past) - 1
        before, after = self._past[min(steps, last)], self._past[min(steps + 1, last)]
        row = self._serving.row(output)
        if not (before.running[row] and after.running[row]):
            return None
        there = float(self._estimates.at(before)[output])
        value = there
        if rest and after is not before:
            value += rest / self.period * (float(self._estimates.at(after)[output]) - there)
        if not math.isfinite(value):
            return None
        deviation = self._deviations.of_run_at(output, row, before)
        interval = self._batch.interval(output, self._runs.serving(before.z), before.told,
                                        self._serving.age(output, before))
        if output in self._shown:
            held = before.told.held
            deviation *= self._shown.steepness(output, value, held)
            interval = self._shown.interval(output, interval, held)
            value = self._shown.value(output, value, held)
        return value, deviation, interval

    def started(self, fault_set: Iterable[str], channel: str) -> int | None:
        """Return the time [ns] since which the virtual sensor has been running, or None."""
        output = self._running(fault_set, channel)
        return None if output is None else self._at(
            int(self._past[-1].since[self._serving.row(output)]))

    def run(self, fault_set: Iterable[str], channel: str) -> str:
        """Return which run says it: the one that never read the channel, or one that did."""
        output = self._output.get((frozenset(fault_set), channel))
        return FREE if output is not None and self._serving.is_free(output) else INDEPENDENT

    def ready(self, fault_set: Iterable[str], channel: str) -> bool:
        """
        Tell whether the virtual sensor runs, has forgotten its start, and may be used.

        While the channels that track it are believed, it is enough that they have for a while.
        """
        output = self._output.get((frozenset(fault_set), channel))
        return output is not None and self.waiting(fault_set, channel) == 0.0 and \
            self._lacks.invalid(output) is None

    def converging(self, fault_set: Iterable[str], channel: str) -> bool:
        """Tell whether it runs and could be used, but for what is left of its start yet."""
        output = self._running(fault_set, channel)
        return output is not None and 0.0 < self._serving.waiting(output) < math.inf \
            and self._lacks.invalid(output) is None

    def waiting(self, fault_set: Iterable[str], channel: str) -> float:
        """Return the time [s] until it is ready: 0 when it is, infinite when it does not run."""
        output = self._output.get((frozenset(fault_set), channel))
        return math.inf if output is None else self._serving.until_ready(output)

    def warm_up(self, fault_set: Iterable[str], channel: str) -> float:
        """Return how long [s] it takes to forget its start; infinite when that is not known."""
        output = self._output.get((frozenset(fault_set), channel))
        if output is None:
            return math.inf
        alone, i = float(self._batch.warm_up[output]), self._serving.tracked.get(output)
        if i is None:
            return alone
        tracked = self._batch.tracked[i]
        followed = tracked.warm_up + self._serving.guards[i]
        return followed if tracked.temporary else min(alone, followed)

    def grows(self, fault_set: Iterable[str], channel: str) -> bool:
        """Tell whether it only goes on from the channel's last readings, and drifts off then."""
        output = self._output.get((frozenset(fault_set), channel))
        i = None if output is None else self._serving.tracked.get(output)
        return i is not None and self._batch.tracked[i].temporary

    def remaining(self, fault_set: Iterable[str], channel: str, limit: float) -> float:
        """Return how long [s] it is until its deviation passes a limit; inf: it does not grow."""
        output = self._output.get((frozenset(fault_set), channel))
        i = None if output is None else self._serving.tracked.get(output)
        if output is None or i is None or not self._past:
            return math.inf
        if self._serving.is_free(output) and self._runs.lost(i):
            age = self._serving.age(output) if self._serving.flies(i) else math.inf
            unseen = self._deviations.unseen(output)
        elif self._batch.tracked[i].temporary:
            age, unseen = self._serving.guards[i], 0.0
        else:
            return math.inf
        return self._deviations.until(output, age, unseen, limit / self._steepness(output))

    def outside_region(self, fault_set: Iterable[str], channel: str) -> bool:
        """
        Tell whether it runs outside the region in which it is proved to converge.

        It is ready there all the same: most converge far beyond what could be proved of them.
        """
        output = self._running(fault_set, channel)
        if output is None:
            return False
        state = self._past[-1]
        return self._batch.outside_region(output, self._runs.serving(state.z), state.told)

    def deviation(self, fault_set: Iterable[str], channel: str) -> float:
        """
        Return the standard deviation of the estimate [unit of the channel]; infinite if unknown.

        It has three parts: what noise and an imperfect model do in steady state, as designed and
        as measured while the channel was healthy, and more off the operating point, where other
        healthy sensors show that; what its kind says of it now, such as what is left of the
        unknown start; and what readings may have moved since the last that came.
        Of a free run it is what came since its start, as computed or as rehearsed. While the
        channels are believed it is what it would be if they were lost now.
        """
        output = self._output.get((frozenset(fault_set), channel))
        if output is None or not self._past:
            return math.inf
        found = self._deviation(output)
        return found * self._steepness(output) if output in self._shown else found

    def _deviation(self, output: int) -> float:
        """Return the deviation of a linear reading, by the run that serves or would."""
        served = self._deviations.of_run(output, self._serving.row(output)) \
            if self._serving.runs(output) else math.inf
        i = self._serving.tracked.get(output)
        if i is None or self._runs.lost(i):
            return served
        followed = math.inf if self._serving.until_tracked(output) else \
            self._deviations.if_lost(output, self._serving.guards[i])
        temporary = self._batch.tracked[i].temporary
        if temporary or (followed < math.inf and self._serving.waiting(output)):
            return followed
        return min(served, followed)

    def measured(self, fault_set: Iterable[str], channel: str) -> Rehearsal | None:
        """
        Return what rehearsal showed beside the healthy sensor in about the last minute of it.

        What a fault did before its isolation is not in it. None: they were not compared yet.
        """
        output = self._output.get((frozenset(fault_set), channel))
        found = None if output is None else self._measured.record.rehearsal(output)
        if output is None or found is None or output not in self._shown:
            return found
        steep = self._steepness(output)
        return found._replace(mean=steep * found.mean, rms=steep * found.rms,
                              worst=steep * found.worst, error=steep * found.error)

    def beside(self, channel: str) -> float | None:
        """Return the channel's believed reading at `time`; None when there is none."""
        if channel in self._told.distrusted or not self._past:
            return None
        time = self._at(self._past[-1].tick) + self._shifts.get(channel, 0)
        return self._told.shown(channel, self._told.samples[channel].interpolated(
            time, self._told.ages[channel]), time)

    def interval(self, fault_set: Iterable[str], channel: str) -> tuple[float, float] | None:
        """
        Return (low, high), between which the truth lies by the design; None: nothing is known.

        That is as sure as what the design was told. Not every kind of virtual sensor knows one.
        """
        output = self._running(fault_set, channel)
        if output is None:
            return None
        state = self._past[-1]
        return self._shown.interval(output, self._batch.interval(
            output, self._runs.serving(state.z), state.told, self._serving.age(output)),
            state.told.held)

    def residual(self, fault_set: Iterable[str], channel: str) -> float | None:
        """
        Return the channel's last reading - the estimate at its time; None when there is none.

        Readings of an isolated sensor count here: it tells whether the sensor has recovered.
        """
        output = self._output.get((frozenset(fault_set), channel))
        if output is None or channel not in self.sensors:
            return None
        found = self._estimates.residual(
            output, self._at_grid_time(channel, self._told.said(channel)))
        return None if found is None else found * self._steepness(output)

    def disagreement(self, fault_set: Iterable[str], channel: str) -> Disagreement | None:
        """
        Return reading - estimate at the channel's last believed reading; None when not known.

        That reading may have been faulty already, so it is told what of it is usual by what was
        measured before, some time ago. If it is out of line with that it counts for nothing: then
        it is the median of what was measured.
        """
        output = self._running(fault_set, channel)
        if output is None:
            return None
        last = None
        if channel in self._told.distrusted:
            last = self._farewells.get(channel)
        elif channel in self.sensors:
            last = self._at_grid_time(channel, self._told.samples[channel])
        found, steep = self._estimates.disagreement(output, last), self._steepness(output)
        return None if found is None else Disagreement(found.usual * steep, found.rest * steep)

    def why_not(self, fault_set: Iterable[str], channel: str) -> Reason | None:
        """Return why there is no estimate that is ready, or None when there is one."""
        entry = self.entry(fault_set, channel)
        if entry is None:
            return Reason.of('not designed', channel=channel,
                             failed=', '.join(sorted(fault_set)) or 'nothing')
        if isinstance(entry, Refusal):
            return Reason.of('refused', text=entry.reason)
        key: Key = entry.fault_set, channel
        if key in self._batch.left_out:
            return self._batch.left_out[key]
        says = self.estimate(entry.fault_set, channel) is not None
        return self._lacks.reason(self._output[frozenset(entry.fault_set), channel], says,
                                  self._now)

    @property
    def outside_domain(self) -> Counter[Key]:
        """Steps with an argument outside a function's domain, by (fault set, channel)."""
        return self._count('outside')

    @property
    def restarts(self) -> Counter[Key]:
        """Restarts because a state became infinite, by (fault set, channel)."""
        return self._count('restarts')

    def _count(self, what: str) -> Counter[Key]:
        if not self._past:
            return Counter()
        counts = getattr(self._past[-1], what)[self._batch.of]
        return Counter({key: int(n) for key, n in zip(self._batch.keys, counts) if n})

    def _ages_at(self, tick: int) -> np.ndarray:
        """Return how old [s] the last reading of each sensor is (L,)."""
        return self._told.ages_at(self._at(tick))

    def _widening(self, output: int) -> float:
        """Return by what factor it is worse now than usual, by what healthy sensors show."""
        elsewhere = self._measured.elsewhere
        if elsewhere.told_of[output]:
            oldest = self._past[0].tick
            for first, end in elsewhere.due(oldest, self._past[-1].tick):
                self._measured.look(*stacked(islice(
                    self._past, first - oldest, end - oldest)), self._heard())
        return elsewhere.widening[output]

    def _running(self, fault_set: Iterable[str], channel: str) -> int | None:
        """Return the output of a virtual sensor that is running now."""
        output = self._output.get((frozenset(fault_set), channel))
        return output if output is not None and self._serving.runs(output) else None

    def _steepness(self, output: int) -> float:
        """Return by what a small difference of linear readings is to be multiplied now."""
        return 1.0 if output not in self._shown else self._shown.steepness(
            output, float(self._estimates.at(self._past[-1])[output]), self._past[-1].told.held)

    # ------------------------------------------------------------------------ which run serves

    def advance(self, now: int) -> None:
        """Bring the state to the last grid time, see `Steps`; then choose who serves."""
        super().advance(now)
        self._serving.choose(self._deviations)

    def distrust(self, names: Iterable[str], now: int | None = None,
                 onsets: Mapping[str, int] = MappingProxyType({})) -> None:
        """Take these sensors as not to be read, see `Steps`; then choose who serves."""
        super().distrust(names, now, onsets)
        self._serving.choose(self._deviations)
