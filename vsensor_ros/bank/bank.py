"""
Every virtual sensor of a design, in step on one grid of times.

The bank has no clock: stamps and `now` are arguments, in integer nanoseconds. It keeps the state
at each grid time of the recent past. A reading or a command that arrives late, that is with a
stamp before the state's time, takes the bank back to the last grid time that it does not change
and everything after it is integrated again: held readings become interpolated ones.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass
import math

import numpy as np

from vsensor_ros.bank.readings import Samples
from vsensor_ros.bank.step import make_step, NOTHING, pad, widen
from vsensor_ros.virtual_sensor import Design, Refusal, VirtualSensor

_LONGEST = 1000  # steps: a clock that jumps further ahead restarts the bank
_REDONE = 4  # steps redone for each new one, in the mean: what late data may cost
_LARGEST = 1e100  # a number beyond it is as good as infinite


@dataclass(frozen=True, eq=False)
class _State:
    """The bank at the grid time t_0 + index * period."""

    index: int
    z: np.ndarray  # (V, k), 0 where not running
    running: np.ndarray  # (V,) bool
    since: np.ndarray  # (V,) index at which it started
    restarts: np.ndarray  # (V,) how often it became infinite
    outside: np.ndarray  # (V,) steps with an argument outside its domain


class Bank:
    """
    Every virtual sensor of a design, in step, on the fixed grid t_k = t_0 + k * period.

    t_0 is the stamp of the first thing taken. A virtual sensor starts, from its initial state,
    at the first grid time at which all that it needs is there, and stops when a reading that it
    needs is older than max_age; it starts anew when that reading is back.

    Wanted functionals of one row are stepped, too: ``estimate((), 'v')``. Those of several rows
    are left out.
    """

    def __init__(self, design: Design, rate: float, max_age: float = 0.5) -> None:
        """
        Prepare for a rate [Hz] and readings of at most max_age [s], at least three periods.

        Raises ValueError, one line, when the rate does not suit the design.
        """
        if not (math.isfinite(rate) and 0.0 < rate <= 1e6):
            raise ValueError(f'rate: {rate} is not a rate in Hz; give a number above 0')
        if design.sample_time is not None and abs(rate * design.sample_time - 1.0) > 1e-6:
            raise ValueError(f'rate: {rate:g} Hz does not suit a plant with the sample time '
                             f'{design.sample_time:g} s; give {1.0 / design.sample_time:g}')
        if not max_age > 0.0:
            raise ValueError(f'max_age: {max_age} is not a time in s; give a number above 0')
        for name in set(design.sensors) & set(design.inputs):
            raise ValueError(f'{name}: is both a sensor and a command; rename one')
        self.sensors, self.inputs = design.sensors, design.inputs
        self.period = round(1e9 / rate)
        self._max_age = max(round(min(max_age, 1e9) * 1e9), 3 * self.period)
        # steps that can be taken back; readings from before are as they were held
        self._span = min(2 * self._max_age // self.period + 1, _LONGEST)
        self._entries = {(frozenset(e.fault_set), e.channel): e for e in design.entries.values()}
        kept = [v for v in design.virtual_sensors if len(v.Cv) == 1]
        self._row = {(frozenset(v.fault_set), v.channel): i for i, v in enumerate(kept)}
        self._keys = [(v.fault_set, v.channel) for v in kept]
        self._step = make_step(kept, self.sensors, self.period * 1e-9) if kept else None
        L, k = len(self.sensors), max((v.order for v in kept), default=0)
        # pad one more and drop it, so that a design without virtual sensors has shapes, too
        self._z0 = pad([v.z0 for v in kept] + [np.zeros(k)])[:-1]
        self._Cv = pad([v.Cv[0] for v in kept] + [np.zeros(k)])[:-1]
        self._Q = pad([widen(v, self.sensors, v.Q[0]) for v in kept] + [np.zeros(L)])[:-1]
        self._z0_gain = pad([widen(v, self.sensors, v.z0_gain) for v in kept]
                            + [np.zeros((k, L))])[:-1]
        # None where no virtual sensor reads a command directly: nothing is spent on it
        direct = any(v.Qu.any() or any(v.Gu[i].any() for i in v.active) for v in kept)
        self._Qu = np.array([v.Qu[0] for v in kept]) if direct else None
        # over readings, then commands: what each needs to run, and what it needs to start
        self._runs_on = np.array([_needs(v, self.sensors) for v in kept], dtype=bool).reshape(
            len(kept), L + len(self.inputs))
        self._starts_on = self._runs_on.copy()
        self._starts_on[:, :L] |= self._z0_gain.any(axis=1)
        self.refused: Counter[tuple[str, str]] = Counter()  # by channel and reason
        self.jumps: Counter[str] = Counter()  # 'backwards', 'forwards': of the clock
        self.reset()

    def reset(self) -> None:
        """Forget all readings, commands and states; counters of refusals and jumps go on."""
        self._samples = {name: Samples() for name in (*self.sensors, *self.inputs)}
        self._origin: int | None = None
        self._now: int | None = None
        self._restart()

    def _restart(self) -> None:
        self._past: deque[_State] = deque()
        self._redo: int | None = None  # the last index that late data leaves as it was
        self._credit = self._span  # steps that may be redone now
        self._seen: tuple[int, np.ndarray, np.ndarray, np.ndarray] | None = None
        self._estimates: np.ndarray | None = None

    @property
    def time(self) -> int | None:
        """Time of the state [ns]: the last grid time, or None before anything was taken."""
        return self._at(self._past[-1].index) if self._past else None

    def take(self, name: str, stamp: int, value: float, now: int | None = None) -> str | None:
        """
        Accept a reading or a command at its stamp [ns]; return None, or why it was not.

        now: the time by which a stamp lies ahead of the clock; by default that of `advance`. Of
        two commands with one stamp (their messages have none of their own) the later one counts.
        """
        samples = self._samples[name]
        last = samples.stamps[-1] if samples.stamps else None
        if not abs(value) < _LARGEST:
            reason: str | None = 'not finite'
        elif self._now is not None and stamp > max(self._now, now or 0) + self._max_age:
            reason = 'stamp ahead of the clock'
        else:
            reason = samples.add(int(stamp), float(value), latest_wins=name in self.inputs)
        if reason is not None:
            self.refused[name, reason] += 1
            return reason
        if self._origin is None:
            self._origin = stamp
        changed = stamp  # the first time at which the channel has a new value
        if name in self.sensors:
            if self._past and stamp + self._max_age < self._at(self._past[0].index):
                return None  # too old to count for any state that can be redone
            if last is not None and stamp - last <= self._max_age:
                changed = last + 1
        before = (changed - 1 - self._origin) // self.period
        if self._redo is None or before < self._redo:
            self._redo = before
        return None

    def confirmed(self, time: int, without: Iterable[str] = ()) -> bool:
        """Tell whether every sensor that is not silent, nor named, has said what it is then."""
        return all(stamps[-1] >= time or time - stamps[-1] > self._max_age
                   for name in self.sensors
                   if name not in without and (stamps := self._samples[name].stamps))

    def advance(self, now: int) -> None:
        """
        Bring the state to the last grid time that is not after now [ns].

        A clock that goes back resets the bank; one that jumps ahead by more than 1000 periods
        restarts the virtual sensors. Both are counted in `jumps`.
        """
        if self._now is not None and now < self._now:
            self.reset()
            self.jumps['backwards'] += 1
        first, self._now = self._now is None, now
        if first:
            self._drop_ahead()
        if self._origin is None:
            return
        last = (now - self._origin) // self.period
        if self._past and last - self._past[-1].index > _LONGEST:
            self._restart()
            self.jumps['forwards'] += 1
        self._take_back(last)
        if self._past and self._past[-1].index >= last:
            return
        with np.errstate(all='ignore'):
            if not self._past:
                oldest = min((s.stamps[0] for s in self._samples.values() if s.stamps),
                             default=now)
                begin = max((oldest - self._origin) // self.period, last - self._span)
                if begin > last:
                    return
                self._past.append(self._first(begin))
            while self._past[-1].index < last:
                self._past.append(self._next(self._past[-1]))
        self._estimates = None
        while self._past[0].index < last - self._span:
            self._past.popleft()
        for samples in self._samples.values():
            samples.forget(self._at(self._past[0].index))

    def _take_back(self, last: int) -> None:
        """Drop the states that late data changes; wait with it when that is often and far."""
        if not self._past or self._redo is None:
            self._redo = None
            return
        newest = self._past[-1].index
        self._credit = min(self._credit + _REDONE * max(0, last - newest), self._span)
        steps = newest - max(self._redo, self._past[0].index)
        if steps > self._credit:
            return
        self._redo = None
        if steps > 0:
            self._credit -= steps
            self._seen = self._estimates = None
            while self._past[-1].index > newest - steps:
                self._past.pop()

    def estimate(self, fault_set: Iterable[str], channel: str) -> float | None:
        """Return what the failed sensor would say at `time`; None when there is no answer."""
        row = self._row.get((frozenset(fault_set), channel))
        if row is None or not self._past or not self._past[-1].running[row]:
            return None
        if self._estimates is None:
            state = self._past[-1]
            y, _, u = self._inputs_at(state.index)
            with np.errstate(all='ignore'):
                self._estimates = (self._Cv * state.z).sum(axis=1) + self._Q @ y
                if self._Qu is not None:
                    self._estimates += self._Qu @ u
        value = float(self._estimates[row])
        return value if math.isfinite(value) else None

    def started(self, fault_set: Iterable[str], channel: str) -> int | None:
        """Return the time [ns] since which the virtual sensor has been running, or None."""
        row = self._row.get((frozenset(fault_set), channel))
        if row is None or not self._past or not self._past[-1].running[row]:
            return None
        return self._at(int(self._past[-1].since[row]))

    def why_not(self, fault_set: Iterable[str], channel: str) -> str | None:
        """Return in words why there is no estimate, or None when there is one."""
        entry = self._entries.get((frozenset(fault_set), channel))
        if entry is None:
            failed = ', '.join(sorted(fault_set)) or 'nothing'
            return f'no design for {channel} when {failed} failed'
        if isinstance(entry, Refusal):
            return entry.reason
        if len(entry.Cv) > 1:
            return f'{channel} has {len(entry.Cv)} rows; design one for each'
        if self.estimate(entry.fault_set, channel) is not None:
            return None
        row = self._row[frozenset(entry.fault_set), channel]
        for name, needed in zip((*self.sensors, *self.inputs), self._starts_on[row]):
            stamps = self._samples[name].stamps
            if needed and not stamps:
                kind = 'reading' if name in self.sensors else 'command'
                return f'no {kind} of {name} yet'
            if needed and name in self.sensors and self._now is not None:
                age = self._now - stamps[-1]
                if age > self._max_age:
                    return f'{name} silent for {age * 1e-9:.1f} s'
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
        return Counter({key: int(n) for key, n in zip(self._keys, counts) if n})

    def _at(self, index: int) -> int:
        assert self._origin is not None
        return self._origin + index * self.period

    def _drop_ahead(self) -> None:
        """Forget what was taken before the clock was known and lies ahead of it."""
        assert self._now is not None
        for name, samples in self._samples.items():
            while samples.stamps and samples.stamps[-1] > self._now + self._max_age:
                samples.stamps.pop()
                samples.values.pop()
                self.refused[name, 'stamp ahead of the clock'] += 1

    def _inputs_at(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return the readings (L,), 0 where there is none, and what is there (L + m,).

        And the commands that hold from then on (m,), or (0,) when nothing reads them directly.
        """
        if self._seen is None or self._seen[0] != index:
            time = self._at(index)
            values = [self._samples[name].interpolated(time, self._max_age)
                      for name in self.sensors]
            held = [self._samples[name].held(time) for name in self.inputs]
            there = [v is not None for v in (*values, *held)]
            self._seen = (index, np.array([v or 0.0 for v in values]), np.array(there, dtype=bool),
                          NOTHING if self._Qu is None else np.array([v or 0.0 for v in held]))
        return self._seen[1:]

    def _first(self, index: int) -> _State:
        V = len(self._keys)
        count = np.zeros(V, dtype=int)
        return self._start(_State(index, np.zeros_like(self._z0), np.zeros(V, dtype=bool),
                                  count, count, count))

    def _start(self, state: _State) -> _State:
        """Start every virtual sensor that does not run and could."""
        y, there, _ = self._inputs_at(state.index)
        new = ~state.running & ~(self._starts_on & ~there).any(axis=1)
        if not new.any():
            return state
        z = np.where(new[:, None], self._z0 + self._z0_gain @ y, state.z)
        new &= np.isfinite(z).all(axis=1)
        z[~np.isfinite(z)] = 0.0
        return _State(state.index, z, state.running | new,
                      np.where(new, state.index, state.since), state.restarts, state.outside)

    def _next(self, state: _State) -> _State:
        """Step to the next grid time."""
        z, index = state.z, state.index + 1
        running, restarts, outside = state.running, state.restarts, state.outside
        y0, _, held0 = self._inputs_at(state.index)
        y1, there, held1 = self._inputs_at(index)
        broken = None
        if self._step is not None and running.any():
            t0, t1 = self._at(state.index), self._at(index)
            commands = [self._samples[name].over(t0, t1) for name in self.inputs]
            u0, u1, u = np.array(commands).reshape(-1, 3).T
            z, out = self._step(z, y0, y1, u0, u1, u, held0, held1)
            if out.any():
                outside = outside + (out & running)
            alive = running & ~(self._runs_on & ~there).any(axis=1)
            finite = (np.abs(z) < _LARGEST).all(axis=1)
            if not (finite & alive).all():
                broken = alive & ~finite
                restarts = restarts + broken
                running = alive & finite
                z = np.where(running[:, None], z, 0.0)
        state = _State(index, z, running, state.since, restarts, outside)
        if running.all():
            return state
        if broken is not None and broken.any():
            return state  # what broke starts anew with the next step
        return self._start(state)


def _needs(v: VirtualSensor, sensors: Iterable[str]) -> list[bool]:
    """Tell which sensors, then which commands, v cannot run without."""
    return [name in v.reads for name in sensors] + [name in v.commands for name in v.inputs]
