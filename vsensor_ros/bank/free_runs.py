"""
Free runs: what goes on from the last good readings when a channel is lost (method, 8).

While a tracker reads what is believed, its free run rehearses: it begins anew from the tracker's
state now and then. When something that the tracker reads is lost, the free run is put back to a
state from before the fault, and goes on from there without the channels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from vsensor_ros.bank.angle import ShortWay
from vsensor_ros.bank.state import State
from vsensor_ros.observers import Batch
from vsensor_ros.reason import Reason

AGES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # s at which rehearsals are compared with the channel
_LONGER = 3  # one rehearsal in so many goes on to the next age
_OUT_OF_LINE = 4.0  # standard deviations: so far nothing drifts by chance
_BETTER = 0.8  # of the deviation of the run that serves: with less another one takes over
_INNOVATIONS = 100  # states of a tracker that are looked at, at most
_MEDIAN = 1.4826  # times the median of what is Gaussian, without its sign, is its deviation


# the standard deviation of what a free run says, at an age [s]
Stated = Callable[[int, float], float]


class Seed(NamedTuple):
    """From where a free run goes on."""

    tick: int
    z: np.ndarray  # (k,)
    since: int  # tick since which it has not read the channels
    spread: float  # deviation of reading - estimate of the tracker before; NaN when not known


class FreeRuns:
    """
    The T free runs of a batch; ticks are grid indices.

    `rows` (V,): which run serves for each virtual sensor. `why`: by tracked one, why there is no
    free run though it was lost; None: nothing is to be said.
    """

    def __init__(self, batch: Batch, period: float, guards: Sequence[float],
                 short_way: ShortWay) -> None:
        """
        Prepare for a grid of this period [s].

        guards (T,): the longest guard [s] of each. short_way: of residuals (.., O) that wrap.
        """
        self.tracked = batch.tracked
        self._batch, self._period, self._short_way = batch, period, short_way
        self._trackers = np.array([t.tracker for t in self.tracked], dtype=int)
        self.free = np.array([t.free for t in self.tracked], dtype=int)
        warm = np.array([t.warm_up for t in self.tracked], dtype=float)
        self._warm = np.ceil(np.minimum(warm / period, 1e18))
        # steps after which one that is lost could go on from before its guard
        self._ready = self._warm + np.ceil(np.array(guards, dtype=float) / period) + 1
        self._cycle, self._begins = _rehearsals(period)
        self._alone = np.arange(batch.size)
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self._seeds: list[Seed | None] = [None] * len(self.tracked)
        self.why: list[Reason | None] = [None] * len(self.tracked)
        self._looked = b''  # who was good when that was looked at last, if nothing was lost since
        self._lost: np.ndarray = np.zeros(len(self.tracked), dtype=bool)
        self._followed: np.ndarray = np.zeros(len(self.tracked), dtype=bool)
        self._fresh: set[int] = set()  # of which no run was chosen yet
        self._spoilt: set[int] = set()  # by a fault from before the guard
        self.flights: tuple[int, ...] = ()  # those that have a seed
        self.steady = False  # all rehearse
        self.rows = self._alone

    def seed(self, i: int) -> Seed | None:
        """Return from where one goes on; None: it rehearses, or cannot go on."""
        return self._seeds[i]

    def lost(self, i: int) -> bool:
        """Tell whether one has lost its tracker, and has not got it back."""
        return bool(self._lost[i])

    def is_fresh(self, i: int) -> bool:
        """Tell whether it was not chosen yet who serves."""
        return i in self._fresh

    def waiting(self, i: int, state: State) -> float:
        """Return the time [s] until its tracker is ready to be lost; inf: it does not run."""
        row = self._trackers[i]
        if not state.running[row]:
            return np.inf
        return max(0.0, float(self._ready[i] - (state.tick - state.since[row])) * self._period)

    def _good(self, state: State) -> np.ndarray:
        """Tell whose trackers run and have forgotten their starts (T,)."""
        return np.asarray(state.running[self._trackers] & (
            state.tick - state.since[self._trackers] >= self._warm))

    def place(self, state: State) -> State:
        """Return a state in which those free runs stand anew that begin there."""
        new = self._begun_at(state.tick) if self.flights else {}
        if state.tick % self._cycle in self._begins:
            new.update((i, (state.z[self._trackers[i]], state.tick))
                       for i in np.flatnonzero(self._good(state)).tolist() if not self.lost(i))
        return self._placed(state, new) if new else state

    def place_flights(self, state: State) -> State:
        """Return a state in which those flights stand anew that begin there."""
        new = self._begun_at(state.tick)
        return self._placed(state, new) if new else state

    def _begun_at(self, tick: int) -> dict[int, tuple[np.ndarray, int]]:
        return {i: (seed.z, seed.since) for i in self.flights
                if (seed := self._seeds[i]) is not None and seed.tick == tick}

    def _placed(self, state: State, new: dict[int, tuple[np.ndarray, int]]) -> State:
        rows = self.free[list(new)]
        z, since, running = state.z.copy(), state.since.copy(), state.running.copy()
        z[rows], since[rows] = ([at[n] for at in new.values()] for n in range(2))
        running[rows] = True
        return state._replace(z=z, since=since, running=running)

    def stopped(self, state: State) -> list[int]:
        """
        Note who goes on and whose tracker is back; return who has lost it without being told.

        Of those it says nothing who could not go on for want of other readings. Who goes on does
        so until its tracker could be lost anew: nothing could serve in between.
        """
        good = self._good(state)
        for i in np.flatnonzero(good & self._lost).tolist():
            if self._seeds[i] is None or not self.waiting(i, state):
                self._land(i)
        if good.tobytes() == self._looked:
            return []
        gone = np.flatnonzero(self._followed & ~good).tolist()
        self._followed, self.steady = good, bool(good.all()) and not self.flights
        self._looked = good.tobytes()
        if not gone:
            return []
        lack = self._batch.runs_on[self.free[gone]] & ~state.told.there
        return [i for i, lacks in zip(gone, lack.any(axis=1)) if not self.lost(i) and not lacks]

    def _land(self, i: int) -> None:
        self._set(i, None, None)
        self._spoilt.discard(i)
        own = self.tracked[i].own
        if self.rows[own] != own:
            self._serve(own, own)

    def _set(self, i: int, seed: Seed | None, why: Reason | None) -> None:
        self._seeds[i], self.why[i] = seed, why
        self._looked = b''
        self._lost[i] = seed is not None or why is not None
        self.flights = tuple(i for i, seed in enumerate(self._seeds) if seed is not None)

    def serving(self, z: np.ndarray) -> np.ndarray:
        """Return of the states (R, k) those that serve (V, k)."""
        return z[:len(self.rows)] if self.rows is self._alone else z[self.rows]

    def choose(self, i: int, alone: float, free: float, proven: bool, agree: bool) -> bool:
        """
        Let that run serve whose deviation is the smaller; tell whether it is another one.

        No fault of the channel has reached the independent run. If that has proven good beside
        the channel, the free one must be clearly surer at the loss, too; and where the two do not
        agree the fault is in the free one, which does not serve any more.
        """
        better = 1.0 if i in self._fresh and not proven else _BETTER
        self._fresh.discard(i)
        if proven and not agree:
            self._spoilt.add(i)
        own, row = self.tracked[i].own, self.tracked[i].free
        if i in self._spoilt:
            new = own
        elif self.rows[own] == own:
            new = row if free <= better * alone else own
        else:
            new = own if alone < better * free else row
        if new == self.rows[own]:
            return False
        self._serve(own, new)
        return True

    def _serve(self, own: int, row: int) -> None:
        rows = self.rows.copy()
        rows[own] = row
        self.rows = rows if (rows != self._alone).any() else self._alone

    def goes_on(self, i: int, tick: int) -> bool:
        """Tell whether one goes on already from a state that is no later than a tick."""
        seed = self._seeds[i]
        return seed is not None and seed.tick <= tick

    def lose(self, i: int, tick: int, past: Sequence[State], stated: Stated) -> int | None:
        """
        Let one go on from the state at a tick, which is from before the fault.

        Where its rehearsal is further from the tracker than it can have drifted off, the fault
        began since the rehearsal did: then that goes on instead. Return the tick, where it must be
        put; None: it cannot go on, see `why`.
        """
        followed = bool(self._followed[i])
        self._land(i)
        self._followed[i] = self.steady = False
        first, last = past[0].tick, past[-1].tick
        tick = min(tick, last)
        if tick < first and followed:
            self._set(i, None, Reason.of(
                'tracked too long ago', seconds=(last - tick) * self._period,
                kept=(last - first) * self._period))
            return None
        state = past[max(tick - first, 0)]
        if tick < first or not self._good(state)[i]:
            self._set(i, None, Reason.of('not tracked yet'))
            return None
        row, since = self._trackers[i], tick
        if self._is_out_of_line(i, state, stated):
            row = self.free[i]
            since = int(state.since[row])
        self._set(i, Seed(tick, state.z[row].copy(), since, self._spread(i, since, past)), None)
        self._fresh.add(i)
        self.steady = False
        return tick

    def drop(self, i: int) -> None:
        """Let one end that has read what is lost."""
        self._land(i)
        self._followed[i] = self.steady = False

    def _is_out_of_line(self, i: int, state: State, stated: Stated) -> bool:
        """Tell whether the tracker differs from the rehearsal by more than that has drifted."""
        free, own = self.free[i], self.tracked[i].own
        age = float(state.tick - state.since[free]) * self._period
        if not state.running[free] or not age or self._batch.bent(i) is not None or \
                self._batch.along(i, state.z[free]):
            return False  # what bends an error by the way says more than an age does
        output = int(np.flatnonzero(self._batch.of == own)[0])
        said, rehearsed = (self._batch.estimate(
            output, state.z[row], state.told.y, state.told.held)
            for row in (self._trackers[i], free))
        apart = self._short_way.of([output])(np.array([said - rehearsed]))
        return bool(abs(apart[0]) > _OUT_OF_LINE * stated(i, age))

    def _spread(self, i: int, tick: int, past: Sequence[State]) -> float:
        """Return the deviation of a tracker's innovations up to a tick; NaN when there is none."""
        own, row = self.tracked[i].own, self._trackers[i]
        output = int(np.flatnonzero(self._batch.of == own)[0])
        sensor = self._batch.own[output]
        end = tick - past[0].tick + 1
        states = [past[at] for at in range(max(0, end - _INNOVATIONS), end)]
        states = [s for s in states if s.running[row] and s.told.there[sensor]]
        if sensor < 0 or not states:
            return np.nan
        said = np.array([s.told.y for s in states])
        off = said[:, sensor] - self._batch.estimate(
            output, np.array([s.z[row] for s in states]), said,
            np.array([s.told.held for s in states]))
        off = self._short_way.of([output])(off[:, None])
        return float(_MEDIAN * np.median(np.abs(off)))  # a spike says nothing of the others


def _rehearsals(period: float) -> tuple[int, frozenset[int]]:
    """Return after how many steps the rehearsals repeat, and at which of them one begins."""
    flights = [max(1, round(age / period)) + 1 for age in AGES if age >= 1.0]
    lengths = []
    for n in range(1, _LONGER**(len(flights) - 1) + 1):
        longer = 0
        while longer < len(flights) - 1 and n % _LONGER**(longer + 1) == 0:
            longer += 1
        lengths.append(flights[longer])
    begins = [0, *accumulate(lengths)]
    return begins[-1], frozenset(begins[:-1])
