"""
Every virtual sensor of a design, in step on one grid of times.

The bank has no clock: stamps and `now` are arguments, in integer nanoseconds. It keeps the state
at each grid time of the recent past. A reading or a command that arrives late, that is with a
stamp before the state's time, takes the bank back to the last grid time that it does not change
and everything after it is integrated again: held readings become interpolated ones.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping
import math
from typing import NamedTuple

import numpy as np

from vsensor_ros.bank.inputs import ages_of, Inputs, ISOLATED, LARGEST
from vsensor_ros.bank.record import Record
from vsensor_ros.bank.stack import make_stack
from vsensor_ros.observers import Design, Refusal

_LONGEST = 1000  # steps that can be taken back, at most
_REDONE = 4  # steps redone for each new one, in the mean: what late data may cost
_GAP = 3  # times the usual interval of a reading: what was missed then shows afterwards
_OUT_OF_LINE = 4.0  # standard deviations: a residual beyond is a fault that nobody has named yet


class _State(NamedTuple):
    """The bank at the grid time t_0 + index * period, and what it was told of that time."""

    tick: int
    z: np.ndarray  # (V, k), of no meaning where not running
    running: np.ndarray  # (V,) bool
    since: np.ndarray  # (V,) index at which it started
    restarts: np.ndarray  # (V,) how often it became infinite
    outside: np.ndarray  # (V,) steps with an argument outside its domain
    y: np.ndarray  # (L,) readings, 0 where there is none
    there: np.ndarray  # (L + m,) bool: which readings and commands there are
    held: np.ndarray  # (m,) commands that hold from then on; (0,) when nothing asks for them


class Bank:
    """
    Every virtual sensor of a design, in step, on the fixed grid t_k = t_0 + k * period.

    t_0 is the stamp of the first thing taken. A virtual sensor starts, from its initial state,
    at the first grid time at which all that it needs is there, and stops when a reading that it
    needs is older than its max_age; it starts anew when that reading is back. It is ready once it
    has run for its warm-up.

    Wanted functionals of one row are stepped, too: ``estimate((), 'v')``. Those of several rows
    are left out.
    """

    def __init__(self, design: Design, rate: float, max_age: float | Mapping[str, float] = 0.5,
                 jump_ahead: float | None = None) -> None:
        """
        Prepare for a rate [Hz] and readings of at most max_age [s], at least three periods.

        max_age may differ by sensor; those not named have 0.5 s. A clock that jumps ahead by more
        than jump_ahead [s], by default 1000 periods, restarts the virtual sensors. Raises
        ValueError, one line, when a number does not suit the design.
        """
        if not (math.isfinite(rate) and 0.0 < rate <= 1e6):
            raise ValueError(f'rate: {rate} is not a rate in Hz; give a number above 0')
        if design.sample_time is not None and abs(rate * design.sample_time - 1.0) > 1e-6:
            raise ValueError(f'rate: {rate:g} Hz does not suit a plant with the sample time '
                             f'{design.sample_time:g} s; give {1.0 / design.sample_time:g}')
        for name in set(design.sensors) & set(design.inputs):
            raise ValueError(f'{name}: is both a sensor and a command; rename one')
        self.sensors, self.inputs = design.sensors, design.inputs
        self.period = round(1e9 / rate)
        ages = ages_of(design.sensors, max_age, 3 * self.period)
        # steps that can be taken back; readings from before are as they were held
        self._span = min(2 * max(ages.values(), default=self.period) // self.period + 1, _LONGEST)
        if jump_ahead is not None and not jump_ahead > 0.0:
            raise ValueError(f'jump_ahead: {jump_ahead} is not a time in s; give a number above 0')
        self._jump = _LONGEST if jump_ahead is None else max(
            3, min(round(min(jump_ahead, 1e9) * 1e9 / self.period), 10 * _LONGEST))
        self._recent = np.array([ages[name] for name in design.sensors]) * 0.5e-9
        self._entries = {(frozenset(e.fault_set), e.channel): e for e in design.entries.values()}
        self._stack = stack = make_stack(design, self.period * 1e-9)
        self._step = stack.step
        self._seconds, self._sample_time = self.period * 1e-9, design.sample_time or 0.0
        self._row = {(frozenset(fault_set), channel): i
                     for i, (fault_set, channel) in enumerate(stack.keys)}
        self._warm = np.array([min(c.warm_up / (self.period * 1e-9), 1e18)
                               for c in stack.convergence])  # steps
        self._everyone = np.ones(len(stack.keys), dtype=bool)
        self._told = Inputs(ages, design.inputs, stack.Cu,
                            stack.Qu is not None or stack.Cu is not None)
        self._slowest = np.array([c.slowest for c in stack.convergence])
        self._record = Record(self._slowest, stack.own,
                              len(self.sensors), self.period * 1e-9, stack.error,
                              stack.assumed)
        self._base = self._record.in_steady_state()
        self.refused: Counter[tuple[str, str]] = Counter()  # by channel and reason
        self.jumps: Counter[str] = Counter()  # 'backwards', 'forwards': of the clock
        self.reset()

    def reset(self) -> None:
        """Forget readings, commands and states; counters, distrust and what is believed go on."""
        self._told.reset()
        self._usual = dict.fromkeys(self.sensors, 3 * self.period)  # ns between its readings
        self._farewells: dict[str, tuple[int, float] | None] = {}
        self._origin: int | None = None
        self._now: int | None = None
        self._began: int | None = None  # the clock's first time
        self._restart()

    def _restart(self) -> None:
        self._past: deque[_State] = deque()
        self._settled: list[_State] = []  # from before the past, for the record
        self._record.forget()
        self._redo: int | None = None  # the last index that late data leaves as it was
        self._credit = self._span  # steps that may be redone now
        self._estimates: np.ndarray | None = None
        self._held: np.ndarray | None = None
        # what gaps in the readings have left in the states (V,), when they ended last
        self._missed: np.ndarray = np.zeros(len(self._everyone))
        self._missed_at = 0

    @property
    def time(self) -> int | None:
        """Time of the state [ns]: the last grid time, or None before anything was taken."""
        return self._at(self._past[-1].tick) if self._past else None

    # ------------------------------------------------------------------------ what comes in

    def take(self, name: str, stamp: int, value: float, now: int | None = None) -> str | None:
        """
        Accept a reading or a command at its stamp [ns]; return None, or why it was not.

        now: the time by which a stamp lies ahead of the clock; by default a period after that of
        `advance`. Of two commands with one stamp (their messages have none of their own) the later
        one counts.
        """
        latest = math.inf if self._now is None else max(
            self._now, self._now + self.period if now is None else now)
        changed = self._told.take(name, int(stamp), float(value), latest)
        if isinstance(changed, str):
            if changed != ISOLATED:
                self.refused[name, changed] += 1
            return changed
        if self._origin is None:
            self._origin = int(stamp)
        stamps = self._told.samples[name].stamps
        if len(stamps) > 1 and name in self._usual:
            self._look_for_gap(name, stamps[-1] - stamps[-2])
        before = (changed - 1 - self._origin) // self.period
        if self._past and before < self._past[0].tick and name in self._told.ages and \
                stamp + self._told.ages[name] < self._at(self._past[0].tick):
            return None  # too old to count for any state that can be redone
        if self._redo is None or before < self._redo:
            self._redo = before
        return None

    def distrust(self, names: Iterable[str]) -> None:
        """
        Take these sensors, the complete set, as not to be read; KeyError if one is unknown.

        Their readings are forgotten and further ones refused, without counting. Every virtual
        sensor that reads one, or started from one, stops at once, at all times that can be redone
        too; it starts anew with the first reading from after the sensor has left the set.
        """
        names = frozenset(names)
        unknown = sorted(names - set(self.sensors))
        if unknown:
            raise KeyError(f'{", ".join(unknown)}: no such sensor')
        lost = names - self._told.distrusted
        for name in lost:
            self._farewells[name] = self._last_reading(name)
        # it may be trusted at any time before the next step
        self._told.distrust(names, None if self._now is None else self._now + self.period - 1)
        if lost:
            gone = np.array([name in lost for name in (*self.sensors, *self.inputs)], dtype=bool)
            rows, own = self._stack.starts_on[:, gone].any(axis=1), self._stack.own
            stop = [s._replace(running=s.running & ~rows, there=s.there & ~gone)
                    for s in (*self._settled, *self._past)]
            self._settled, self._past = stop[:len(self._settled)], deque(stop[len(self._settled):])
            self._record.forget(rows | (gone[own] & (own >= 0)), gone[:len(self.sensors)])
            self._estimates = self._held = None

    def silent(self, name: str, now: int) -> bool:
        """Tell whether a sensor's last reading, or else the beginning, is beyond its max_age."""
        return self._told.silent(name, now, self._began)

    def confirmed(self, time: int, without: Iterable[str] = ()) -> bool:
        """Tell whether every sensor that is not silent, nor named, has said what it is then."""
        return self._told.confirmed(time, without)

    # ------------------------------------------------------------------------- steps in time

    def advance(self, now: int) -> None:
        """
        Bring the state to the last grid time that is not after now [ns].

        A clock that goes back resets the bank; one that jumps ahead by more than jump_ahead
        restarts the virtual sensors. Both are counted in `jumps`.
        """
        if self._now is not None and now < self._now:
            self.reset()
            self.jumps['backwards'] += 1
        first, self._now = self._now is None, now
        if first:
            self._began = now
            self.refused.update(self._told.drop_ahead(now))
        if self._origin is None:
            return
        last = (now - self._origin) // self.period
        if self._past and last - self._past[-1].tick > self._jump:
            self._restart()
            self.jumps['forwards'] += 1
        self._take_back(last)
        if self._past and self._past[-1].tick >= last:
            return
        with np.errstate(all='ignore'):
            if not self._past:
                oldest = self._told.oldest_stamp(now)
                begin = max((oldest - self._origin) // self.period, last - self._span)
                if begin > last:
                    return
                self._past.append(self._first(begin))
            while self._past[-1].tick < last:
                self._past.append(self._next(self._past[-1]))
        self._estimates = self._held = None
        while self._past[0].tick < last - self._span:
            self._settled.append(self._past.popleft())
        if len(self._settled) >= self._record.block:
            self._settle()

    def _take_back(self, last: int) -> None:
        """Drop the states that late data changes; wait with it when that is often and far."""
        if not self._past:
            self._redo = None
            return
        newest = self._past[-1].tick
        self._credit = min(self._credit + _REDONE * max(0, last - newest), self._span)
        if self._redo is None:
            return
        steps = newest - max(self._redo, self._past[0].tick)
        if steps > self._credit:
            return
        self._redo = None
        if steps > 0:
            self._credit -= steps
            self._estimates = self._held = None
            while self._past[-1].tick > newest - steps:
                self._past.pop()

    def _at(self, index: int) -> int:
        assert self._origin is not None
        return self._origin + index * self.period

    def _first(self, index: int) -> _State:
        V = len(self._everyone)
        count = np.zeros(V, dtype=int)
        return self._start(_State(index, np.zeros_like(self._stack.z0), np.zeros(V, dtype=bool),
                                  count, count, count, *self._told.at(self._at(index))))

    def _start(self, state: _State) -> _State:
        """Start every virtual sensor that does not run and could."""
        new = ~state.running & ~(self._stack.starts_on & ~state.there).any(axis=1)
        if not new.any():
            return state
        z = np.where(new[:, None], self._stack.z0 + self._stack.z0_gain @ state.y, state.z)
        new &= np.isfinite(z).all(axis=1)
        z[~np.isfinite(z)] = 0.0
        running = state.running | new
        return state._replace(z=z, running=self._everyone if running.all() else running,
                              since=np.where(new, state.tick, state.since))

    def _next(self, state: _State) -> _State:
        """Step to the next grid time."""
        z, index = state.z, state.tick + 1
        running, restarts, outside = state.running, state.restarts, state.outside
        y, there, held = self._told.at(self._at(index))
        broken = None
        if self._step is not None and (running is self._everyone or running.any()):
            u0, u1, u = self._told.over(self._at(state.tick), self._at(index))
            z, out = self._step(z, state.y, y, u0, u1, u, state.held, held)
            if out.any():
                outside = outside + (out & running)
            alive = running
            if there is not self._told.everything:
                alive = running & ~(self._stack.runs_on & ~there).any(axis=1)
            if alive is not self._everyone or not (np.abs(z) < LARGEST).all():
                finite = (np.abs(z) < LARGEST).all(axis=1)
                broken = alive & ~finite
                restarts = restarts + broken
                running = alive & finite
                z = np.where(running[:, None], z, 0.0)
        state = _State(index, z, running, state.since, restarts, outside, y, there, held)
        if running is self._everyone:
            return state
        if broken is not None and broken.any():
            return state  # what broke starts anew with the next step
        return self._start(state)

    # ----------------------------------------------------------------------- what comes out

    def estimate(self, fault_set: Iterable[str], channel: str) -> float | None:
        """Return what the failed sensor would say at `time`; None when there is no answer."""
        row = self._running(fault_set, channel)
        if row is None:
            return None
        if self._estimates is None:
            state = self._past[-1]
            with np.errstate(all='ignore'):
                self._estimates = self._stack.estimates(state.z, state.y, state.held)
        value = float(self._estimates[row])
        return value if math.isfinite(value) else None

    def started(self, fault_set: Iterable[str], channel: str) -> int | None:
        """Return the time [ns] since which the virtual sensor has been running, or None."""
        row = self._running(fault_set, channel)
        return None if row is None else self._at(int(self._past[-1].since[row]))

    def ready(self, fault_set: Iterable[str], channel: str) -> bool:
        """Tell whether the virtual sensor runs and has forgotten its start."""
        return self.waiting(fault_set, channel) == 0.0

    def waiting(self, fault_set: Iterable[str], channel: str) -> float:
        """Return the time [s] until it is ready: 0 when it is, infinite when it does not run."""
        row = self._running(fault_set, channel)
        if row is None:
            return math.inf
        return max(0.0, self._stack.convergence[row].warm_up - self._age(row))

    def warm_up(self, fault_set: Iterable[str], channel: str) -> float:
        """Return how long [s] it takes to forget its start; infinite when that is not known."""
        row = self._row.get((frozenset(fault_set), channel))
        return math.inf if row is None else self._stack.convergence[row].warm_up

    def outside_region(self, fault_set: Iterable[str], channel: str) -> bool:
        """
        Tell whether it runs outside the region in which it is proved to converge.

        It is ready there all the same: most converge far beyond what could be proved of them.
        """
        row = self._running(fault_set, channel)
        if row is None:
            return False
        state = self._past[-1]
        return self._stack.outside(row, state.z, state.y, state.held)

    def deviation(self, fault_set: Iterable[str], channel: str) -> float:
        """
        Return the standard deviation of the estimate [unit of the channel]; infinite if unknown.

        It has three parts: what noise and an imperfect model do in steady state, as designed and
        as measured while the channel was healthy; what is left of the unknown start; and what
        readings may have moved since the last ones that came.
        """
        row = self._running(fault_set, channel)
        if row is None:
            return math.inf
        if self._held is None:
            self._held = self._unseen()
        found = math.hypot(self._base[row], self._held[row],
                           self._stack.convergence[row].deviation(self._age(row)))
        return math.inf if math.isnan(found) else found

    def disagreement(self, fault_set: Iterable[str], channel: str) -> float | None:
        """
        Return reading - estimate at the channel's last reading; None when that is not known.

        A reading that is out of line with what was measured before, some time ago, was faulty
        already: then it is the median of what was measured.
        """
        row = self._running(fault_set, channel)
        last = self._farewells.get(channel) if channel in self._told.distrusted else (
            self._last_reading(channel) if channel in self.sensors else None)
        if row is None:
            return None
        centre = float(self._record.centre[row])
        known = not math.isnan(centre)
        spread = self._record.spread[row] if known else self._stack.error[row]
        if last is not None and last[0] >= self._past[0].tick:
            state = self._past[last[0] - self._past[0].tick]
            value = last[1] - self._stack.estimates(state.z, state.y, state.held)[row]
            if state.running[row] and (
                    abs(value - (centre if known else 0.0)) <= _OUT_OF_LINE * spread):
                return float(value)
        return centre if known else None

    def why_not(self, fault_set: Iterable[str], channel: str) -> str | None:
        """Return in words why there is no estimate that is ready, or None when there is one."""
        entry = self._entries.get((frozenset(fault_set), channel))
        if entry is None:
            failed = ', '.join(sorted(fault_set)) or 'nothing'
            return f'no design for {channel} when {failed} failed'
        if isinstance(entry, Refusal):
            return entry.reason
        if len(entry.Cv) > 1:
            return f'{channel} has {len(entry.Cv)} rows; design one for each'
        row = self._row[frozenset(entry.fault_set), channel]
        if self.estimate(entry.fault_set, channel) is not None:
            wait = self.waiting(entry.fault_set, channel)
            if wait == math.inf:
                return 'it is not known when it has forgotten its start'
            unproved = '' if self._stack.convergence[row].proved else ' (not proved)'
            return f'converging, {wait:.1f} s more{unproved}' if wait else None
        missing = self._told.missing(self._stack.starts_on[row], self._now)
        if missing is not None:
            return missing
        if self._past and self._past[-1].running[row]:
            return 'its estimate is not finite'
        return 'starts with the next step'

    @property
    def outside_domain(self) -> Counter[tuple[tuple[str, ...], str]]:
        """Steps with an argument outside a function's domain, by (fault set, channel)."""
        return self._count('outside')

    @property
    def restarts(self) -> Counter[tuple[tuple[str, ...], str]]:
        """Restarts because a state became infinite, by (fault set, channel)."""
        return self._count('restarts')

    def _count(self, what: str) -> Counter[tuple[tuple[str, ...], str]]:
        counts = getattr(self._past[-1], what) if self._past else []
        return Counter({key: int(n) for key, n in zip(self._stack.keys, counts) if n})

    def _running(self, fault_set: Iterable[str], channel: str) -> int | None:
        """Return the row of a virtual sensor that is running now."""
        row = self._row.get((frozenset(fault_set), channel))
        return row if row is not None and self._past and self._past[-1].running[row] else None

    def _age(self, row: int) -> float:
        """Return for how long [s] a virtual sensor has been running."""
        state = self._past[-1]
        return float(state.tick - state.since[row]) * self.period * 1e-9

    # ------------------------------------------------------------------- what is measured

    def _last_reading(self, name: str) -> tuple[int, float] | None:
        """Return a sensor's last reading, put at the grid time before it: (index, value)."""
        samples = self._told.samples[name]
        if not samples.stamps or not self._past:
            return None
        index = min((samples.stamps[-1] - self._at(0)) // self.period, self._past[-1].tick)
        value = samples.interpolated(self._at(index), self._told.ages[name])
        return None if value is None else (index, value)

    def _settle(self) -> None:
        """Hand a block of states that nothing can change any more to the record."""
        states, self._settled, stack = self._settled, [], self._stack
        index, z, running, since, _, _, y, there, held = map(np.array, zip(*states))
        heard = np.array([-1 if stamp is None else (stamp - self._at(0)) // self.period
                          for stamp in self._told.last_stamps()], dtype=int)
        # a value that is only held says nothing
        there = there[:, :len(self.sensors)] & (index[:, None] <= heard)
        with np.errstate(all='ignore'):
            estimates = stack.estimates(z, y, held)
            readings = y if stack.Cu is None else y + held @ stack.Cu.T
            counts = running & there[:, stack.own] & (stack.own >= 0) \
                & (index[:, None] - since >= 2.0 * self._warm)  # nothing is left of the start
            self._record.add(int(index[-1]), readings[:, stack.own] - estimates, counts, y, there)
        self._base = self._record.in_steady_state()
        self._told.forget(self._at(self._past[0].tick))

    def _look_for_gap(self, name: str, gap: int) -> None:
        """Note what a virtual sensor that ran on may have missed in an unusually long interval."""
        usual, age = self._usual[name], self._told.ages[name]
        if gap <= _GAP * usual:
            self._usual[name] = max(3 * self.period, usual + (gap - usual) // 8)
        elif gap <= age and self._past:
            self._usual[name] = min(2 * usual, gap)
            ages = np.array([gap * 1e-9 * (s == name) for s in self.sensors])
            slopes = np.nan_to_num(self._record.slope)
            with np.errstate(all='ignore'):
                more = self._stack.reach(slopes, ages, self._sample_time, False)
            now = self._past[-1].tick
            self._missed, self._missed_at = np.hypot(self._left_of_gaps(now), more), now

    def _left_of_gaps(self, tick: int) -> np.ndarray:
        """Return what gaps have left in the states (V,): it dies out as they do."""
        ages = max(0, tick - self._missed_at) * self._seconds
        return self._missed * np.exp(-ages / np.maximum(self._slowest, 1e-9))

    def _unseen(self) -> np.ndarray:
        """Return the standard deviations (V,) because readings may have moved since they came."""
        ages = self._told.ages_at(self._at(self._past[-1].tick))
        slopes = self._record.slope
        # before slopes are known: nothing is said of readings that are far from silent
        slopes = np.where(np.isnan(slopes), np.where(ages > self._recent, np.inf, 0.0), slopes)
        with np.errstate(all='ignore'):
            held = self._stack.reach(slopes, ages, self._sample_time)
        return np.hypot(held, self._left_of_gaps(self._past[-1].tick)) \
            if self._missed.any() else held
