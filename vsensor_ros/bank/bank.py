"""What the virtual sensors of a design say, how sure they are, and why one says nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
import math
from types import MappingProxyType

import numpy as np

from vsensor_ros.bank.commands import End
from vsensor_ros.bank.steps import State, Steps
from vsensor_ros.observers import Design, Entry, Key, Refusal
from vsensor_ros.reason import Reason

_OUT_OF_LINE = 4.0  # standard deviations: a residual beyond is a fault that nobody has named yet


class Bank(Steps):
    """
    Every virtual sensor of a design, stepped as told in `Steps`, and what each says.

    They are asked for by fault set and channel: ``estimate(('y1', 'y2'), 'y1')``. Wanted
    functionals are stepped, too: ``estimate((), 'v')``.
    """

    def __init__(self, design: Design, rate: float, max_age: float | Mapping[str, float] = 0.5,
                 jump_ahead: float | None = None,
                 command_ends: Mapping[str, End] = MappingProxyType({})) -> None:
        """Prepare, see `Steps`; raises BadInput."""
        super().__init__(design, rate, max_age, jump_ahead, command_ends)
        self._entries = {(frozenset(fault_set), channel): entry
                         for (fault_set, channel), entry in design.entries.items()}
        self._output = {(frozenset(fault_set), channel): i
                        for i, (fault_set, channel) in enumerate(self._batch.keys)}
        self._of: list[int] = self._batch.of.tolist()

    def entry(self, fault_set: Iterable[str], channel: str) -> Entry | Refusal | None:
        """Return what was designed for a channel; None: nothing."""
        return self._entries.get((frozenset(fault_set), channel))

    def estimate(self, fault_set: Iterable[str], channel: str) -> float | None:
        """Return what the failed sensor would say at `time`; None when there is no answer."""
        output = self._running(fault_set, channel)
        if output is None:
            return None
        if self._estimates is None:
            self._estimates = self._estimates_at(self._past[-1])
        value = float(self._estimates[output])
        return value if math.isfinite(value) else None

    def recall(self, fault_set: Iterable[str], channel: str, time: int,
               ) -> tuple[float, float, tuple[float, float] | None] | None:
        """
        Return what is known by now of an earlier time [ns]: estimate, deviation, interval.

        Between grid times it is interpolated; after the last it is the last. None when the
        virtual sensor did not run then, or nothing is known of that time any more.
        """
        output = self._output.get((frozenset(fault_set), channel))
        if output is None or not self._past or time < self._at(self._past[0].tick):
            return None
        steps, rest = divmod(time - self._at(self._past[0].tick), self.period)
        last = len(self._past) - 1
        before, after = self._past[min(steps, last)], self._past[min(steps + 1, last)]
        if not (before.running[self._of[output]] and after.running[self._of[output]]):
            return None
        there = float(self._estimates_at(before)[output])
        value = there
        if rest and after is not before:
            value += rest / self.period * (float(self._estimates_at(after)[output]) - there)
        if not math.isfinite(value):
            return None
        deviation = self._deviation(output, before, self._unseen_at(before))
        return value, deviation, self._batch.interval(
            output, before.z, before.told, self._age(output, before))

    def started(self, fault_set: Iterable[str], channel: str) -> int | None:
        """Return the time [ns] since which the virtual sensor has been running, or None."""
        output = self._running(fault_set, channel)
        return None if output is None else self._at(
            int(self._past[-1].since[self._of[output]]))

    def ready(self, fault_set: Iterable[str], channel: str) -> bool:
        """Tell whether the virtual sensor runs, has forgotten its start, and may be used."""
        output = self._running(fault_set, channel)
        return output is not None and self._waiting(output) == 0.0 \
            and self._invalid(output) is None

    def waiting(self, fault_set: Iterable[str], channel: str) -> float:
        """Return the time [s] until it is ready: 0 when it is, infinite when it does not run."""
        output = self._running(fault_set, channel)
        return math.inf if output is None else self._waiting(output)

    def warm_up(self, fault_set: Iterable[str], channel: str) -> float:
        """Return how long [s] it takes to forget its start; infinite when that is not known."""
        output = self._output.get((frozenset(fault_set), channel))
        return math.inf if output is None else float(self._batch.warm_up[output])

    def outside_region(self, fault_set: Iterable[str], channel: str) -> bool:
        """
        Tell whether it runs outside the region in which it is proved to converge.

        It is ready there all the same: most converge far beyond what could be proved of them.
        """
        output = self._running(fault_set, channel)
        if output is None:
            return False
        state = self._past[-1]
        return self._batch.outside_region(output, state.z, state.told)

    def deviation(self, fault_set: Iterable[str], channel: str) -> float:
        """
        Return the standard deviation of the estimate [unit of the channel]; infinite if unknown.

        It has three parts: what noise and an imperfect model do in steady state, as designed and
        as measured while the channel was healthy; what its kind says of it now, such as what is
        left of the unknown start; and what readings may have moved since the last that came.
        """
        output = self._running(fault_set, channel)
        if output is None:
            return math.inf
        state = self._past[-1]
        if self._unseen is None:
            self._unseen = self._unseen_at(state)
        return self._deviation(output, state, self._unseen)

    def interval(self, fault_set: Iterable[str], channel: str) -> tuple[float, float] | None:
        """
        Return (low, high), between which the truth lies by the design; None: nothing is known.

        That is as sure as what the design was told. Not every kind of virtual sensor knows one.
        """
        output = self._running(fault_set, channel)
        if output is None:
            return None
        state = self._past[-1]
        return self._batch.interval(output, state.z, state.told, self._age(output))

    def residual(self, fault_set: Iterable[str], channel: str) -> float | None:
        """
        Return the channel's last reading - the estimate at its time; None when there is none.

        Readings of an isolated sensor count here: it tells whether the sensor has recovered.
        """
        output = self._output.get((frozenset(fault_set), channel))
        return None if output is None or channel not in self.sensors else \
            self._residual(output, self._at_grid_time(channel, self._told.said(channel)))

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
        record = self._measured.record
        centre = float(record.centre[output])
        known = not math.isnan(centre)
        spread = record.spread[output] if known else self._batch.error[output]
        value = self._residual(output, last)
        if value is not None and abs(value - (centre if known else 0.0)) <= _OUT_OF_LINE * spread:
            return value
        return centre if known else None

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
        if self.estimate(entry.fault_set, channel) is not None:
            wait = self._waiting(output)
            if wait == math.inf:
                return Reason.of('start unknown')
            if wait:
                proved = self._batch.proved[output]
                return Reason.of('converging' if proved else 'converging, not proved',
                                 seconds=wait)
            return self._invalid(output)
        missing = self._told.missing(self._batch.starts_on[self._of[output]], self._now)
        if missing is not None:
            return missing
        if self._running(fault_set, channel) is not None:
            return Reason.of('estimate not finite')
        return Reason.of('about to start')

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

    def _deviation(self, output: int, state: State, unseen: np.ndarray) -> float:
        found = math.hypot(self._measured.base[output], unseen[output],
                           self._batch.deviation(output, state.z, state.told,
                                                 self._age(output, state)))
        return math.inf if math.isnan(found) else found

    def _running(self, fault_set: Iterable[str], channel: str) -> int | None:
        """Return the output of a virtual sensor that is running now."""
        output = self._output.get((frozenset(fault_set), channel))
        return output if output is not None and self._past \
            and self._past[-1].running[self._of[output]] else None

    def _age(self, output: int, state: State | None = None) -> float:
        """Return for how long [s] the virtual sensor of an output has been running; by now."""
        state = state or self._past[-1]
        return float(state.tick - state.since[self._of[output]]) * self.period * 1e-9

    def _waiting(self, output: int) -> float:
        return self._batch.waiting(output, self._past[-1].z, self._age(output))

    def _invalid(self, output: int) -> Reason | None:
        state = self._past[-1]
        return self._batch.invalid(output, state.z, state.told, self._age(output))

    def _estimates_at(self, state: State) -> np.ndarray:
        with np.errstate(all='ignore'):
            return self._batch.estimates(state.z, state.told.y, state.told.held)

    def _residual(self, output: int, reading: tuple[int, float] | None) -> float | None:
        """Return reading (tick, value) - estimate then; None when that is not known any more."""
        if reading is None or not self._past or not \
                self._past[0].tick <= reading[0] <= self._past[-1].tick:
            return None
        state = self._past[reading[0] - self._past[0].tick]
        if not state.running[self._of[output]]:
            return None
        value = float(reading[1] - self._estimates_at(state)[output])
        if not math.isfinite(value):
            return None
        angle = self.angles.get(self._batch.keys[output][1])
        return value if angle is None else angle.shortest(value)
