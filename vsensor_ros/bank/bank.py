"""What the virtual sensors of a design say, how sure they are, and why one says nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import islice
import math
from types import MappingProxyType

import numpy as np

from vsensor_ros.bank.commands import End
from vsensor_ros.bank.record import Rehearsal
from vsensor_ros.bank.state import State
from vsensor_ros.bank.steps import Steps
from vsensor_ros.observers import Design, Entry, Key, Refusal
from vsensor_ros.reason import Reason

_OUT_OF_LINE = 4.0  # standard deviations: a residual beyond is a fault that nobody has named yet
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
        self._of: list[int] = self._batch.of.tolist()
        tracked = {t.own: i for i, t in enumerate(self._batch.tracked)}
        # by output: which of the tracked it is of, and its longest guard [s]
        self._tracked = {output: tracked[row] for output, row in enumerate(self._of)
                         if row in tracked}
        self._guard = [max(self._guards[self.sensors[c]] for c in t.channels) * 1e-9
                       for t in self._batch.tracked]
        # by output of a sensor that shows a curve: it, and what that adds of commands (m,)
        self._curves = {i: (design.curves[name], np.array(
            [design.curves[name].beside.get(u, 0.0) for u in design.inputs]))
            for i, (_, name) in enumerate(self._batch.keys) if name in design.curves}

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
        value = self._shown(output, self._linear_now(output), self._past[-1])
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
        row = self._row(output)
        if not (before.running[row] and after.running[row]):
            return None
        there = float(self._estimates_at(before)[output])
        value = there
        if rest and after is not before:
            value += rest / self.period * (float(self._estimates_at(after)[output]) - there)
        if not math.isfinite(value):
            return None
        deviation = self._deviation(output, before, self._unseen_at(before))
        interval = self._batch.interval(output, self._runs.serving(before.z), before.told,
                                        self._age(output, before))
        if output in self._curves:
            deviation *= self._steepness(output, value, before)
            interval = self._shown_interval(output, interval, before)
            value = self._shown(output, value, before)
        return value, deviation, interval

    def started(self, fault_set: Iterable[str], channel: str) -> int | None:
        """Return the time [ns] since which the virtual sensor has been running, or None."""
        output = self._running(fault_set, channel)
        return None if output is None else self._at(
            int(self._past[-1].since[self._row(output)]))

    def run(self, fault_set: Iterable[str], channel: str) -> str:
        """Return which run says it: the one that never read the channel, or one that did."""
        output = self._output.get((frozenset(fault_set), channel))
        return FREE if output is not None and self._is_free(output) else INDEPENDENT

    def ready(self, fault_set: Iterable[str], channel: str) -> bool:
        """
        Tell whether the virtual sensor runs, has forgotten its start, and may be used.

        While the channels that track it are believed, it is enough that they have for a while.
        """
        output = self._output.get((frozenset(fault_set), channel))
        return output is not None and self.waiting(fault_set, channel) == 0.0 and \
            self._why_invalid(output) is None

    def converging(self, fault_set: Iterable[str], channel: str) -> bool:
        """Tell whether it runs and could be used, but for what is left of its start yet."""
        output = self._running(fault_set, channel)
        return output is not None and 0.0 < self._waiting(output) < math.inf \
            and self._why_invalid(output) is None

    def waiting(self, fault_set: Iterable[str], channel: str) -> float:
        """Return the time [s] until it is ready: 0 when it is, infinite when it does not run."""
        output = self._output.get((frozenset(fault_set), channel))
        if output is None or not self._past:
            return math.inf
        alone = self._waiting(output) if self._past[-1].running[self._row(output)] else math.inf
        return min(alone, self._until_tracked(output))

    def warm_up(self, fault_set: Iterable[str], channel: str) -> float:
        """Return how long [s] it takes to forget its start; infinite when that is not known."""
        output = self._output.get((frozenset(fault_set), channel))
        if output is None:
            return math.inf
        alone, i = float(self._batch.warm_up[output]), self._tracked.get(output)
        if i is None:
            return alone
        tracked = self._batch.tracked[i]
        followed = tracked.warm_up + self._guard[i]
        return followed if tracked.temporary else min(alone, followed)

    def grows(self, fault_set: Iterable[str], channel: str) -> bool:
        """Tell whether it only goes on from the channel's last readings, and drifts off then."""
        output = self._output.get((frozenset(fault_set), channel))
        i = None if output is None else self._tracked.get(output)
        return i is not None and self._batch.tracked[i].temporary

    def remaining(self, fault_set: Iterable[str], channel: str, limit: float) -> float:
        """Return how long [s] it is until its deviation passes a limit; inf: it does not grow."""
        output = self._output.get((frozenset(fault_set), channel))
        i = None if output is None else self._tracked.get(output)
        if output is None or i is None or not self._past:
            return math.inf
        limit /= self._steepness(output)
        if self._is_free(output) and self._runs.lost(i):
            age = self._age(output) if self._flies(i) else math.inf
            unseen = float(self._unseen_now()[output])
        elif self._batch.tracked[i].temporary:
            age, unseen = self._guard[i], 0.0
        else:
            return math.inf
        left = limit**2 - unseen**2
        return 0.0 if left <= 0.0 or age == math.inf else \
            self._measured.growth.until(i, age, math.sqrt(left))

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
        found = self._deviation_by_now(output)
        return found * self._steepness(output) if output in self._curves else found

    def _deviation_by_now(self, output: int) -> float:
        """Return the deviation of a linear reading, by the run that serves or would."""
        served = self._deviation(output, self._past[-1], self._unseen_now()) \
            if self._past[-1].running[self._row(output)] else math.inf
        i = self._tracked.get(output)
        if i is None or self._runs.lost(i):
            return served
        followed = math.inf if self._until_tracked(output) else self._widening(output) * \
            float(self._measured.growth.stated(i, self._guard[i]))
        temporary = self._batch.tracked[i].temporary
        if temporary or (followed < math.inf and self._waiting(output)):
            return followed
        return min(served, followed)

    def measured(self, fault_set: Iterable[str], channel: str) -> Rehearsal | None:
        """
        Return what rehearsal showed beside the healthy sensor in about the last minute of it.

        What a fault did before its isolation is not in it. None: they were not compared yet.
        """
        output = self._output.get((frozenset(fault_set), channel))
        found = None if output is None else self._measured.record.rehearsal(output)
        if output not in self._curves or found is None:
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
        return self._shown_interval(output, self._batch.interval(
            output, self._runs.serving(state.z), state.told, self._age(output)), state)

    def residual(self, fault_set: Iterable[str], channel: str) -> float | None:
        """
        Return the channel's last reading - the estimate at its time; None when there is none.

        Readings of an isolated sensor count here: it tells whether the sensor has recovered.
        """
        output = self._output.get((frozenset(fault_set), channel))
        if output is None or channel not in self.sensors:
            return None
        found = self._residual(output, self._at_grid_time(channel, self._told.said(channel)))
        return None if found is None else found * self._steepness(output)

    def disagreement(self, fault_set: Iterable[str], channel: str) -> float | None:
        """
        Return reading - estimate at the channel's last believed reading; None when not known.

        A reading that is out of line with what was measured before, some time ago, was faulty
        already: then it is the median of what was measured.
        """
        output = self._running(fault_set, channel)
        if output is None:
            return None
        last = None
        if channel in self._told.distrusted:
            last = self._farewells.get(channel)
        elif channel in self.sensors:
            last = self._at_grid_time(channel, self._told.samples[channel])
        if self._is_free(output):
            centre, spread = 0.0, self._spread_of_free(output, last)
        else:
            record = self._measured.record
            centre = float(record.centre[output])
            spread = self._batch.error[output] if math.isnan(centre) else record.spread[output]
        known = not math.isnan(centre)
        value, steep = self._residual(output, last), self._steepness(output)
        if value is not None and abs(value - (centre if known else 0.0)) <= _OUT_OF_LINE * spread:
            return value * steep
        return centre * steep if known else None

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
        output = self._output[frozenset(entry.fault_set), channel]
        i = self._tracked.get(output)
        if self._until_tracked(output) == 0.0:
            return self._why_invalid(output)
        if i is not None and self._batch.tracked[i].temporary and not self._flies(i):
            return self._why_not_tracked(output, i)
        if self.estimate(entry.fault_set, channel) is not None:
            wait = self.waiting(entry.fault_set, channel)
            if wait == math.inf:
                return Reason.of('start unknown')
            if wait:
                proved = self._batch.proved[output]
                return Reason.of('converging' if proved else 'converging, not proved',
                                 seconds=wait)
            return self._why_invalid(output)
        missing = self._told.missing(self._batch.starts_on[self._of[output]], self._now)
        if missing is not None:
            return missing
        if self._running(fault_set, channel) is not None:
            return Reason.of('estimate not finite')
        return Reason.of('about to start')

    def _why_not_tracked(self, output: int, i: int) -> Reason:
        """Return why a temporary one does not run freely, nor could."""
        tracked = self._batch.tracked[i]
        lack = self._told.missing(self._batch.starts_on[self._of[output]], self._now)
        if lack is not None or self._runs.lost(i):
            return lack or self._runs.why[i] or Reason.of('track lost')
        lack = self._told.missing(self._batch.starts_on[tracked.tracker], self._now)
        if lack is not None:
            own = [self.sensors[c] for c in tracked.channels]
            isolated = lack.code == 'input isolated' and lack.fact('name') in own
            return Reason.of('not tracked yet') if isolated else lack
        wait = self._until_tracked(output)
        return Reason.of('converging' if self._batch.proved[output] else 'converging, not proved',
                         seconds=wait) if 0.0 < wait < math.inf else Reason.of('about to start')

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

    def _unseen_at(self, state: State) -> np.ndarray:
        return self._measured.unseen(state.tick, self._told.ages_at(self._at(state.tick)))

    def _unseen_now(self) -> np.ndarray:
        if self._unseen is None:
            self._unseen = self._unseen_at(self._past[-1])
        return self._unseen

    def _deviation(self, output: int, state: State, unseen: np.ndarray) -> float:
        return self._deviation_of(output, self._row(output), state, unseen)

    def _deviation_of(self, output: int, row: int, state: State, unseen: np.ndarray) -> float:
        """Return the deviation of what an output says of one of its runs."""
        age = float(state.tick - state.since[row]) * self.period * 1e-9
        i, wider = self._tracked.get(output), self._widening(output)
        if i is not None and row == self._batch.tracked[i].free:
            # what the model errs more now reaches it in time as much as the independent run
            more = 0.0 if self._batch.tracked[i].temporary or wider == 1.0 else \
                math.sqrt(wider**2 - 1.0) * self._measured.base[output]
            found = math.hypot(unseen[output], more, wider * max(
                float(self._measured.growth.stated(i, age)), self._spreads.deviation(i, state)))
        else:
            found = math.hypot(
                wider * self._measured.base[output], unseen[output], self._batch.deviation(
                    output, state.z[:self._batch.size], state.told, age))
        return math.inf if math.isnan(found) else found

    def _widening(self, output: int) -> float:
        """Return by what factor it is worse now than usual, by what healthy sensors show."""
        elsewhere = self._measured.elsewhere
        if elsewhere.told_of[output]:
            oldest = self._past[0].tick
            for first, end in elsewhere.due(oldest, self._past[-1].tick):
                self._measured.look(*self._stacked(
                    islice(self._past, first - oldest, end - oldest)))
        return elsewhere.widening[output]

    def _running(self, fault_set: Iterable[str], channel: str) -> int | None:
        """Return the output of a virtual sensor that is running now."""
        output = self._output.get((frozenset(fault_set), channel))
        return output if output is not None and self._past \
            and self._past[-1].running[self._row(output)] else None

    def _age(self, output: int, state: State | None = None) -> float:
        """Return for how long [s] the virtual sensor of an output has been running; by now."""
        state = state or self._past[-1]
        return float(state.tick - state.since[self._row(output)]) * self.period * 1e-9

    def _waiting(self, output: int) -> float:
        """Return the time [s] until the run that serves has forgotten its start."""
        if self._is_free(output):
            return 0.0 if self._flies(self._tracked[output]) else math.inf
        return self._batch.waiting(output, self._past[-1].z[:self._batch.size],
                                   self._age(output))

    def _why_invalid(self, output: int) -> Reason | None:
        state = self._past[-1]
        return self._batch.invalid(output, self._runs.serving(state.z), state.told,
                                   self._age(output))

    def _linear_now(self, output: int) -> float:
        """Return the linear reading that is estimated now."""
        if self._estimates is None:
            self._estimates = self._estimates_at(self._past[-1])
        return float(self._estimates[output])

    def _shown(self, output: int, linear: float, state: State) -> float:
        """Return what a sensor shows of its linear reading."""
        if output not in self._curves:
            return linear
        curve, beside = self._curves[output]
        return curve.shown(linear, float(beside @ state.told.held) if curve.beside else 0.0)

    def _shown_interval(self, output: int, interval: tuple[float, float] | None,
                        state: State) -> tuple[float, float] | None:
        if output not in self._curves or interval is None:
            return interval
        low, high = sorted(self._shown(output, end, state) for end in interval)
        return low, high

    def _steepness(self, output: int, linear: float | None = None,
                   state: State | None = None) -> float:
        """Return by what a small difference of linear readings is to be multiplied; by now."""
        if output not in self._curves or not self._curves[output][0].text:
            return 1.0
        curve, beside = self._curves[output]
        linear = self._linear_now(output) if linear is None else linear
        state = state or self._past[-1]
        return curve.slope(linear, float(beside @ state.told.held) if curve.beside else 0.0)

    def _estimates_at(self, state: State) -> np.ndarray:
        with np.errstate(all='ignore'):
            return self._batch.estimates(self._runs.serving(state.z), state.told.y,
                                         state.told.held)

    def _residual(self, output: int, reading: tuple[int, float] | None) -> float | None:
        """Return reading (tick, value) - estimate then; None when that is not known any more."""
        if reading is None or not self._past or not \
                self._past[0].tick <= reading[0] <= self._past[-1].tick:
            return None
        state = self._past[reading[0] - self._past[0].tick]
        if not state.running[self._row(output)]:
            return None
        value = float(reading[1] - self._estimates_at(state)[output])
        if not math.isfinite(value):
            return None
        angle = self.angles.get(self._batch.keys[output][1])
        return value if angle is None else angle.shortest(value)

    # ------------------------------------------------------------------------ which run serves

    def advance(self, now: int) -> None:
        """Bring the state to the last grid time, see `Steps`; then choose who serves."""
        super().advance(now)
        self._choose()

    def distrust(self, names: Iterable[str], now: int | None = None,
                 onsets: Mapping[str, int] = MappingProxyType({})) -> None:
        """Take these sensors as not to be read, see `Steps`; then choose who serves."""
        super().distrust(names, now, onsets)
        self._choose()

    def _choose(self) -> None:
        """Let of the independent and the free run that serve whose deviation is the smaller."""
        if not self._runs.flying or not self._past:
            return
        state, unseen = self._past[-1], self._unseen_now()
        for output, i in self._tracked.items():
            own, free = self._of[output], self._batch.tracked[i].free
            if own == free or self._runs.seed(i) is None:
                continue
            alone = math.inf
            age = float(state.tick - state.since[own]) * self.period * 1e-9
            if state.running[own] and not self._batch.waiting(
                    output, state.z[:self._batch.size], age):
                # it knows no more of where it is than the free run, that its terms bend as much
                alone = max(self._deviation_of(output, own, state, unseen),
                            self._spreads.deviation(i, state))
            freely = self._deviation_of(output, free, state, unseen) \
                if state.running[free] else math.inf
            agree = max(alone, freely) == math.inf or \
                self._apart(output, i) <= _OUT_OF_LINE * math.hypot(alone, freely)
            proven = self._measured.record.proven(output)
            if self._runs.choose(i, alone, freely, proven, agree):
                self._estimates = None

    def _apart(self, output: int, i: int) -> float:
        """Return by how much the independent and the free run of a tracked one differ now."""
        state, tracked = self._past[-1], self._batch.tracked[i]
        z = state.z[:self._batch.size].copy()
        said = []
        for run in (tracked.own, tracked.free):
            z[tracked.own] = state.z[run]
            with np.errstate(all='ignore'):
                said.append(float(self._batch.estimates(
                    z, state.told.y, state.told.held)[output]))
        angle = self.angles.get(self._batch.keys[output][1])
        return abs(said[1] - said[0] if angle is None else angle.shortest(said[1] - said[0]))

    def _row(self, output: int) -> int:
        """Return the run that serves for an output."""
        return int(self._runs.rows[self._of[output]])

    def _is_free(self, output: int) -> bool:
        i = self._tracked.get(output)
        return i is not None and self._row(output) == self._batch.tracked[i].free

    def _flies(self, i: int) -> bool:
        """Tell whether a free run goes on now without its channels."""
        return self._runs.seed(i) is not None and bool(
            self._past[-1].running[self._batch.tracked[i].free])

    def _until_tracked(self, output: int) -> float:
        """Return the time [s] until there is a free run if the channels are lost then."""
        i = self._tracked.get(output)
        if i is None or not self._past or self._runs.lost(i):
            return math.inf
        return self._runs.waiting(i, self._past[-1], self._guard[i])

    def _spread_of_free(self, output: int, reading: tuple[int, float] | None) -> float:
        """Return the standard deviation of a reading (tick, value) - what a free run says."""
        seed = self._runs.seed(self._tracked[output])
        if seed is None or reading is None:
            return math.nan
        age = max(0.0, (reading[0] - seed.tick) * self.period * 1e-9)
        return math.hypot(seed.spread, float(
            self._measured.growth.stated(self._tracked[output], age)))
