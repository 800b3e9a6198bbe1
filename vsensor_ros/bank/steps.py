"""
Every virtual sensor of a design, in step on one grid of times.

There is no clock: stamps and `now` are arguments, in integer nanoseconds. The state at each grid
time of the recent past is kept. A reading or a command that arrives late, that is with a stamp
before the state's time, takes everything back to the last grid time that it does not change, and
what comes after is integrated again: held readings become interpolated ones.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping
import math
from types import MappingProxyType

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank.angle import ShortWay
from vsensor_ros.bank.commands import check_ends, End
from vsensor_ros.bank.composite import batch_of
from vsensor_ros.bank.flights import AT_ONCE, Flights, guards_of, stop
from vsensor_ros.bank.free_runs import FreeRuns
from vsensor_ros.bank.grid import grid_of
from vsensor_ros.bank.inputs import Inputs, ISOLATED, LARGEST
from vsensor_ros.bank.late import Late
from vsensor_ros.bank.measured import Measured
from vsensor_ros.bank.readings import Samples
from vsensor_ros.bank.spread import Spreads
from vsensor_ros.bank.state import stacked, State
from vsensor_ros.observers import Design, Told
from vsensor_ros.reason import Reason


class Steps:
    """
    Every virtual sensor of a design, in step, on the fixed grid t_k = t_0 + k * period.

    t_0 is the stamp of the first thing taken. A virtual sensor starts, from its initial state,
    at the first grid time at which all that it needs is there, and stops when a reading that it
    needs is older than its max_age, or a command that it needs has ended; it starts anew when
    that is back.
    """

    def __init__(self, design: Design, rate: float, max_age: float | Mapping[str, float] = 0.5,
                 jump_ahead: float | None = None,
                 command_ends: Mapping[str, End] = MappingProxyType({}),
                 guard: Mapping[str, float] = MappingProxyType({})) -> None:
        """
        Prepare for a rate [Hz] and readings of at most max_age [s], at least three periods.

        max_age may differ by sensor; those not named have 0.5 s. A clock that jumps ahead by more
        than jump_ahead [s], by default 1000 periods, restarts the virtual sensors. command_ends:
        what becomes of commands that come no more; those not named hold for ever. guard: what a
        sensor said in so many s before it was lost is not believed afterwards; GUARD for those not
        named. Raises BadInput when a number does not suit the design.
        """
        grid = grid_of(design, rate, max_age, jump_ahead)
        for name in set(design.sensors) & set(design.inputs):
            raise BadInput('', name, 'is both a sensor and a command', 'rename one')
        for name in {name for turns in design.wrap for name in turns} & set(design.curves):
            if design.curves[name].text:
                raise BadInput('', name, 'shows a curve, and wraps', 'write it without a curve')
        self.sensors, self.inputs = design.sensors, design.inputs
        self.period, self._shifts, self._span, self._jump = \
            grid.period, grid.shifts, grid.span, grid.jump
        # a discrete plant's readings are of the instants at which its commands begin
        Cu = design.Cu if design.sample_time is None else None
        Cu = Cu if Cu is not None and Cu.any() else None
        self._batch = batch_of(design, self.period * 1e-9, Cu)
        self._guards = guards_of(design.sensors, guard)
        turns = {name: abs(turn) for angle in design.wrap for name, turn in angle.items()}
        self._short_way = ShortWay([turns.get(name) for _, name in self._batch.keys])
        self._of_tracked = [max(self._guards[self.sensors[c]] for c in t.channels) * 1e-9
                            for t in self._batch.tracked]  # s
        self._runs = FreeRuns(self._batch, self.period * 1e-9, self._of_tracked, self._short_way)
        # the states that are kept; of a silent sensor they are wanted from before its last reading
        self._kept = self._span
        if self._runs.tracked:
            self._kept += max(self._guards.values()) // self.period + 1
        self._spreads = Spreads(self._batch, self._runs.free)
        self._step = self._batch.step if len(self._batch.runs_on) else None
        self._everyone = np.ones(len(self._batch.runs_on), dtype=bool)
        self._by_itself = self._everyone.copy()  # who starts when all that it needs is there
        self._by_itself[self._runs.free] = False
        check_ends(command_ends, design.inputs)
        held = Cu is not None or any(curve.beside for curve in design.curves.values())
        self._told = Inputs(grid.ages, design.inputs, Cu, self._batch.wants_held or held,
                            command_ends, 3 * self.period, design.wrap, design.curves,
                            self._shifts, self._batch.wants_ages)
        self.angles = self._told.angles  # by sensor that wraps
        self._past: deque[State] = deque()
        # what comes late by itself is paid for
        self._late = Late(self._span, -min(self._shifts.values(), default=0) // self.period)
        self._measured = Measured(self._batch, grid.ages, self.period, Cu, self._short_way)
        self._flights = Flights(self._batch, self._runs, self._spreads, self._told, self._past,
                                self._guards, self._at, self._measured)
        # who lacks what there was last: (L + m,) bool, and (R,) those that stop, or cannot start
        self._lack = self._told.everything, ~self._everyone, ~self._everyone
        # what was not used, but of isolated sensors, by channel and reason
        self.refused: Counter[tuple[str, Reason]] = Counter()
        self.jumps: Counter[str] = Counter()  # 'backwards', 'forwards': of the clock
        self.reset()

    def reset(self) -> None:
        """Forget readings, commands and states; counters, distrust and what is believed go on."""
        self._told.reset()
        self._measured.reset()
        self._farewells: dict[str, tuple[int, float] | None] = {}
        self._origin: int | None = None
        self._now: int | None = None
        self._began: int | None = None  # the clock's first time
        self._restart()

    def _restart(self) -> None:
        self._past.clear()
        self._settled: list[State] = []  # from before the past, for the record
        self._measured.restart()
        self._runs.reset()
        self._flights.reset()
        self._late.reset()

    @property
    def time(self) -> int | None:
        """Time of the state [ns]: the last grid time, or None before anything was taken."""
        return self._at(self._past[-1].tick) if self._past else None

    # ------------------------------------------------------------------------ what comes in

    def take(self, name: str, stamp: int, value: float, now: int | None = None) -> Reason | None:
        """
        Accept a reading or a command at its stamp [ns]; return None, or why it is not used.

        now: the time by which a stamp lies ahead of the clock; by default a period after that of
        `advance`. Of two commands with one stamp (their messages have none of their own) the later
        one counts. Readings of an isolated sensor are kept all the same, for `residual`.
        """
        latest = math.inf if self._now is None else max(
            self._now, self._now + self.period if now is None else now)
        if name in self._shifts:
            stamp, latest = stamp + self._shifts[name], latest + min(0, self._shifts[name])
        changed = self._told.take(name, int(stamp), float(value), latest)
        if isinstance(changed, Reason):
            if changed is not ISOLATED:
                self.refused[name, changed] += 1
            return changed
        if self._origin is None:
            self._origin = int(stamp)
        stamps = self._told.samples[name].stamps
        if len(stamps) > 1 and name in self._told.ages:
            interval = stamps[-1] - stamps[-2]
            if not self._measured.is_usual(name, interval) and self._past:
                self._measured.miss(name, interval, self._past[-1].tick)
        before = (changed - 1 - self._origin) // self.period
        if self._past and before < self._past[0].tick and name in self._told.ages and \
                stamp + self._told.ages[name] < self._at(self._past[0].tick):
            return None  # too old to count for any state that can be redone
        self._late.note(before)
        return None

    def spoil(self, name: str, time: int) -> None:
        """Note that a command came at a time [ns] that could not be read; KeyError if unknown."""
        self._told.spoil(name, time + self._shifts.get(name, 0))

    def distrust(self, names: Iterable[str], now: int | None = None,
                 onsets: Mapping[str, int] = MappingProxyType({})) -> None:
        """
        Take these sensors, the complete set, as not to be read; KeyError if one is unknown.

        now: the time, when that is later than the one of `advance`. onsets: when those whose
        faults began before now are known to have begun.

        Their readings are forgotten and further ones not used, without counting. Every virtual
        sensor that reads one, or started from one, stops at once, at all times that can be redone
        too; it starts anew with the first reading from after the sensor has left the set.
        """
        names = frozenset(names)
        unknown = sorted(names - set(self.sensors))
        if unknown:
            raise KeyError(f'{", ".join(unknown)}: no such sensor')
        lost = names - self._told.distrusted
        for name in lost:
            self._farewells[name] = self._at_grid_time(name, self._told.samples[name])
        gone = np.array([name in lost for name in (*self.sensors, *self.inputs)], dtype=bool)
        if lost and self._past:
            stay = self._flights.lose(lost, gone, now, onsets)
        if self._now is not None:  # it may be trusted at any time before the next step
            now = max(self._now, now or self._now) + self.period - 1
        self._told.distrust(names, now)
        if lost:
            stopped = np.asarray(self._batch.starts_on[:, gone].any(axis=1))
            began = min([self._now or 0, *(onsets[name] for name in lost if name in onsets)])
            self._measured.forget(gone[:len(self.sensors)], stopped,
                                  (began - (self._origin or 0)) // self.period)
            stop(self._settled, ~stopped, ~gone)
            if self._past:
                stop(self._past, stay, ~gone)
                self._flights.catch_up(AT_ONCE)
        self._measured.all_trusted = not names

    def silent(self, name: str, now: int) -> bool:
        """Tell whether a sensor's last reading, or else the beginning, is beyond its max_age."""
        return self._told.silent(name, now, self._began)

    def lack(self, name: str) -> Reason | None:
        """Return why nothing counts of a sensor or a command now; None: something does."""
        return self._told.lack(name, self._now)

    def confirmed(self, time: int, without: Iterable[str] = ()) -> bool:
        """Tell whether every sensor that is not silent, nor named, has said what it is then."""
        return self._told.confirmed(time, without)

    def _at_grid_time(self, name: str, samples: Samples) -> tuple[int, float] | None:
        """Return a sensor's last reading, put at the grid time before it: (tick, value)."""
        if not samples.stamps or not self._past:
            return None
        tick = min((samples.stamps[-1] - self._at(0)) // self.period, self._past[-1].tick)
        value = samples.interpolated(self._at(tick), self._told.ages[name])
        return None if value is None else (tick, value)

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
            self._told.begin(now)
            self.refused.update(self._told.drop_ahead(now))
        if self._origin is None:
            return
        last = (now - self._origin) // self.period
        if self._past and last - self._past[-1].tick > self._jump:
            self._restart()
            self.jumps['forwards'] += 1
        if not self._past:
            self._late.forget()
        elif steps := self._late.due(self._past[0].tick, self._past[-1].tick, last):
            self._drop_after(self._past[-1].tick - steps)
        if self._past and self._past[-1].tick >= last:
            return
        steps = last - self._past[-1].tick if self._past else 0
        with np.errstate(all='ignore'):
            if not self._past:
                oldest = self._told.oldest_stamp(now)
                begin = max((oldest - self._origin) // self.period, last - self._span)
                if begin > last:
                    return
                self._past.append(self._first(begin))
            while self._past[-1].tick < last:
                self._past.append(self._next(self._past[-1]))
        if self._runs.tracked and not (
                self._runs.steady and self._past[-1].running is self._everyone):
            self._flights.follow()
            self._flights.catch_up(AT_ONCE + steps)
        while self._past[0].tick < last - self._kept:
            self._settled.append(self._past.popleft())
        if len(self._settled) >= self._measured.record.block:
            self._settle()

    def step_back(self, to: int) -> int:
        """Forget the states after a time [ns], to step them anew; return the time of the last."""
        first = self._past[0].tick
        self._drop_after(max(first, (to - self._at(0)) // self.period))
        last = self._at(self._past[-1].tick)
        self._now = min(to, last)
        return last

    def _drop_after(self, tick: int) -> None:
        while self._past[-1].tick > tick:
            self._past.pop()
        self._flights.taken_back(self._past[-1].tick)

    def _at(self, tick: int) -> int:
        assert self._origin is not None
        return self._origin + tick * self.period

    def _first(self, tick: int) -> State:
        V = len(self._everyone)
        count = np.zeros(V, dtype=int)
        return self._start(State(tick, np.zeros((V, self._batch.width)), np.zeros(V, dtype=bool),
                                 count, count, count, self._told.at(self._at(tick))))

    def _start(self, state: State) -> State:
        """Start every virtual sensor that does not run and could."""
        new = ~state.running & self._by_itself
        if not new.any():
            return state
        new &= ~self._lacking(state.told)[1]
        if not new.any():
            return state
        z = np.where(new[:, None], self._batch.start(state.told), state.z)
        new &= np.isfinite(z).all(axis=1)
        z[~np.isfinite(z)] = 0.0
        running = state.running | new
        return state._replace(z=z, running=self._everyone if running.all() else running,
                              since=np.where(new, state.tick, state.since))

    def _next(self, state: State) -> State:
        """Step to the next grid time."""
        z, tick = state.z, state.tick + 1
        running, restarts, outside = state.running, state.restarts, state.outside
        told, broken, spread = self._told.at(self._at(tick)), None, None
        if self._step is not None and (running is self._everyone or running.any()):
            commands = self._told.over(self._at(state.tick), self._at(tick))
            if self._runs.flights:
                z, out, spread = self._spreads.step(
                    self._runs.flights, False, state, told, commands)
            else:
                z, out = self._step(z, state.told, told, commands)
            if out.any():
                outside = outside + (out & running)
            alive = running
            if told.there is not self._told.everything:
                alive = running & ~self._lacking(told)[0]
            if not (np.abs(z) < LARGEST).all():
                finite = (np.abs(z) < LARGEST).all(axis=1)
                broken = alive & ~finite
                restarts = restarts + broken
                alive = alive & finite
            if alive is not self._everyone:
                z = np.where(alive[:, None], z, 0.0)
            running = alive
        state = State(tick, z, running, state.since, restarts, outside, told, spread)
        # what broke starts anew with the next step
        if running is not self._everyone and not (broken is not None and broken.any()):
            state = self._start(state)
        return self._placed(state) if self._runs.tracked else state

    def _lacking(self, told: Told) -> tuple[np.ndarray, np.ndarray]:
        """Return who stops (R,) for want of what is not there, and who cannot start (R,)."""
        if told.there is not self._lack[0]:  # mostly it is as before
            self._lack = told.there, *((needs & ~told.there).any(axis=1) for needs in (
                self._batch.runs_on, self._batch.starts_on))
        return self._lack[1:]

    def _placed(self, state: State) -> State:
        """Let those free runs stand anew that begin there."""
        placed = self._runs.place(state)
        if placed is state:
            return placed
        if self._runs.flights:
            placed = self._spreads.begin(placed)
        if not placed.running.all():
            return placed
        return placed._replace(running=self._everyone)

    def _settle(self) -> None:
        """Hand over a block of states that nothing can change any more, to be measured."""
        states, self._settled = self._settled, []
        self._measured.add(*stacked(states), self._heard(), self._past[-1].tick)
        self._told.forget(self._at(self._past[0].tick))

    def _heard(self) -> np.ndarray:
        """Return the tick of the last reading of each sensor (L,); -1: there is none."""
        return np.array([-1 if stamp is None else (stamp - self._at(0)) // self.period
                         for stamp in self._told.last_stamps()], dtype=int)
