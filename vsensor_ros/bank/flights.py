"""
What is lost, and how what it leaves behind goes on: free runs take off, and are brought to now.

A flight begins at a state from before the fault. Only its own run is stepped from there; all else
is known of those times already. A long way is not gone at once, so that a loss holds up nobody:
see `catch_up`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank.free_runs import FreeRuns
from vsensor_ros.bank.inputs import Inputs, LARGEST
from vsensor_ros.bank.measured import Measured
from vsensor_ros.bank.spread import Spreads
from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch

GUARD = 0.5  # s, by default
LONGEST_GUARD = 10.0  # s
# steps that flights are brought nearer to now between two ticks, at least: at 100 Hz the way of a
# guard of 2 s and of a silence of 0.5 s; some 50 ms, once a loss
AT_ONCE = 300


class Flights:
    """
    The flights of the free runs of a batch; `past` is that of the bank. Times are in ns.

    guards: by sensor, see `guards_of`. time_of: the time of a tick.
    """

    def __init__(self, batch: Batch, runs: FreeRuns, spreads: Spreads, told: Inputs,
                 past: deque[State], guards: Mapping[str, int], time_of: Callable[[int], int],
                 measured: Measured) -> None:
        """Begin with none."""
        self._batch, self._runs, self._spreads, self._told = batch, runs, spreads, told
        self._past, self._guards, self._time_of = past, guards, time_of
        self._measured = measured
        self._sensors = tuple(guards)
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self._behind: tuple[int, ...] = ()  # who is not known by now yet
        self._tick = 0  # but by then
        self._at_once = False  # they must be, whatever that costs

    def behind(self, i: int) -> bool:
        """Tell whether a flight has not been brought to now yet."""
        return i in self._behind

    def lose(self, lost: Collection[str], gone: np.ndarray, now: int | None,
             onsets: Mapping[str, int]) -> np.ndarray:
        """
        Let those take off whose trackers read what is lost, (L + m,) bool, and end who read it.

        now: the time, by default that of the state, and onsets of those lost that began before
        it. Return who goes on as before (R,): `stop` all others, then `catch_up`.
        """
        if now is None:
            now = self._time_of(self._past[-1].tick)
        reads = self._batch.starts_on
        moved = []
        for i, tracked in enumerate(self._runs.tracked):
            if reads[tracked.free, gone].any():
                self._runs.drop(i)
            elif reads[tracked.tracker, gone].any():
                began = min([now, *(onsets.get(name, now) for name in lost if reads[
                    tracked.tracker, self._sensors.index(name)])])
                tick = self._clean(i, began)
                if not self._runs.goes_on(i, tick):
                    moved.append((i, tick))
        return self._take_off(moved) & ~reads[:, gone].any(axis=1)

    def follow(self) -> None:
        """Let those take off whose trackers have stopped: their channels are silent."""
        gone = self._runs.stopped(self._past[-1])
        if gone:
            now = self._time_of(self._past[-1].tick)
            stop(self._past, self._take_off([(i, self._clean(i, now)) for i in gone]))

    def _clean(self, i: int, time: int) -> int:
        """Return the last tick of a tracker that a fault does not reach: see `distrust`."""
        found = time
        for sensor in self._runs.tracked[i].channels:
            name = self._sensors[sensor]
            samples = self._told.samples[name]
            last = min([time, *samples.stamps[-1:]])
            # a reading at the very end of the guard is between two others, and may be bad
            found = min(found, samples.before(last - self._guards[name]))
        zero, period = self._time_of(0), self._time_of(1) - self._time_of(0)
        return (found - zero) // period

    def _take_off(self, moved: Collection[tuple[int, int]]) -> np.ndarray:
        """Begin flights (which, at which tick), so that they are behind; return all else (R,)."""
        # who serves already must not stop
        self._at_once = self._at_once or any(
            self._runs.seed(i) is not None and i not in self._behind for i, _ in moved)
        begun = {i: tick for i, at in moved if (tick := self._runs.lose(
            i, at, self._past, self._measured.growth.stated)) is not None}
        for i in begun:
            if (seed := self._runs.seed(i)) is not None:
                self._measured.take_off(i, seed.since)
        if begun:
            first = min(begun.values())
            self._tick = min(first, self._tick) if self._behind else first
            self._behind = tuple(sorted({*self._behind, *begun}))
        stay = np.ones(len(self._batch.runs_on), dtype=bool)
        stay[self._runs.free[[i for i, _ in moved]]] = False
        return stay

    def taken_back(self, tick: int) -> None:
        """Note that all states after a tick were dropped, and will be stepped with all runs."""
        if tick <= self._tick:
            self._behind = ()

    def catch_up(self, most: int) -> None:
        """Bring those that are behind nearer to now, by so many steps at most, mostly."""
        past = self._past
        behind = tuple(i for i in self._behind if self._runs.seed(i) is not None)
        self._behind = behind
        if not behind:
            return
        at = self._tick - past[0].tick
        end = len(past) - 1 if self._at_once else min(at + most, len(past) - 1)
        self._at_once = False
        past[at] = self._placed(past[at])
        with np.errstate(all='ignore'):
            while at < end:
                past[at + 1] = self._placed(self._next(behind, past[at], past[at + 1]))
                at += 1
        self._tick = past[at].tick
        if at == len(past) - 1:
            self._behind = ()

    def _placed(self, state: State) -> State:
        placed = self._runs.place_flights(state)
        return state if placed is state else self._spreads.begin(placed)

    def _next(self, flights: tuple[int, ...], before: State, after: State) -> State:
        """Return a state in which these have been stepped to it from the one before."""
        rows, told = self._runs.free[list(flights)], after.told
        commands = self._told.over(self._time_of(before.tick), self._time_of(after.tick))
        ended, outside, spread = self._spreads.step(
            flights, True, before, told, commands, after.spread)
        z, running, since = after.z.copy(), after.running.copy(), after.since.copy()
        alive = before.running[rows] & ~(self._batch.runs_on[rows] & ~told.there).any(axis=1)
        finite = (np.abs(ended) < LARGEST).all(axis=1)
        running[rows], since[rows] = alive & finite, before.since[rows]
        z[rows] = np.where(running[rows, None], ended, 0.0)
        restarts, out = after.restarts.copy(), after.outside.copy()
        restarts[rows] = before.restarts[rows] + (alive & ~finite)
        out[rows] = before.outside[rows] + (outside & before.running[rows])
        return State(after.tick, z, running, since, restarts, out, told, spread)


def stop(states: deque[State] | list[State], stay: np.ndarray,
         there: np.ndarray | None = None) -> None:
    """Stop all runs in states but some (R,) bool, and let them have read only what is `there`."""
    # there may be thousands, and most share their arrays
    running: dict[int, np.ndarray] = {}
    read: dict[int, np.ndarray] = {}
    for at, (tick, z, runs, since, restarts, outside, told, spread) in enumerate(states):
        if id(runs) not in running:
            running[id(runs)] = runs & stay
        if there is not None:
            if id(told.there) not in read:
                read[id(told.there)] = told.there & there
            told = told._replace(there=read[id(told.there)])
        states[at] = State(tick, z, running[id(runs)], since, restarts, outside, told, spread)


def guards_of(sensors: tuple[str, ...], given: Mapping[str, float]) -> dict[str, int]:
    """Return the guard of each sensor in ns, GUARD for those not given; raises BadInput."""
    for name, guard in given.items():
        if name not in sensors:
            raise BadInput('', 'guard', f'{name} is no sensor',
                           f'name one of {", ".join(sensors)}')
        if not 0.0 <= guard <= LONGEST_GUARD:
            raise BadInput('', 'guard', f'{guard} is not a time in s up to {LONGEST_GUARD:g}',
                           'give one')
    return {name: round(given.get(name, GUARD) * 1e9) for name in sensors}
