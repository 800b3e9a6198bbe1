"""The filters of a design for the bank, all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.batch import Batch, StepOfSome, Told, Tracked
from vsensor_ros.observers.kinds.extended.filter import (
    ANYWHERE,
    Filter,
    LOST,
    MILD,
)
from vsensor_ros.observers.kinds.extended.sensor import ExtendedSensor, Model
from vsensor_ros.reason import add_sentences, Reason

add_sentences({'model lost': 'the healthy sensors say {size:.2g} times what the model expects '
               'of them, at most {limit:g}'})

# rad of deviation: of an angle that is less sure nothing is known. Standing bases with noisy
# odometry, never told where they head, thought it surer than this in 0.05 % of the time, than
# 0.3 in 0.8 %
KNOWN = 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class ExtendedBatch(Batch):
    """
    V filters of one output that go on without their channels, then those that track them.

    Of an angle the first V start by themselves, and are ready once they know it; V more go on
    from those that are tracked.
    """

    filter: Filter
    model: Model
    ages: tuple[np.ndarray, ...]  # V
    drifts: tuple[np.ndarray, ...]  # V

    def start(self, told: Told) -> np.ndarray:
        """Start those that their channels track; the others start from these."""
        z = self.filter.start(told)
        z[[t.free for t in self.tracked]] = np.nan
        return z

    def step(self, z: np.ndarray, before: Told, after: Told,
             commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step all at once; of an angle those that start by themselves do so anew when lost."""
        z = self.filter.step(z, after, commands)
        if self.model.angle:
            z[:self.size][z[:self.size, -1] > LOST] = np.nan
        return z, np.zeros(len(z), dtype=bool)

    def step_of(self, rows: np.ndarray) -> StepOfSome:
        """Take their readings alone."""
        some = self.filter.of(rows)
        return lambda z, before, after, commands: (
            some.step(z, after, commands), np.zeros(len(z), dtype=bool))

    def estimates(self, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return C x + Cu u of each, or its angle."""
        found = (z[..., :len(self.model.states)] * self.model.C[self.own]).sum(axis=-1)
        if self.model.angle:
            found = found + self.model.factors[self.own] * z[..., -2]
        return found + held @ self.model.Cu[self.own].T if held.shape[-1] else found

    def estimate(self, output: int, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return that of one."""
        own = self.own[output]
        found = z[..., :len(self.model.states)] @ self.model.C[own]
        if self.model.angle:
            found = found + self.model.factors[own] * z[..., -2]
        return np.asarray(found + held @ self.model.Cu[own] if held.shape[-1] else found)

    def waiting(self, output: int, z: np.ndarray, age: float) -> float:
        """Return that of the start; of an angle 0 when it is known, not known before."""
        if not self.model.angle:
            return super().waiting(output, z, age)
        return 0.0 if self._is_known(output, self._deviation(output, z[output])) else math.inf

    def invalid(self, output: int, z: np.ndarray, told: Told, age: float) -> Reason | None:
        """Return that the model does not hold, if it has shown that since the channels went."""
        worst = float(z[output, -1])
        return Reason.of('model lost', size=math.sqrt(worst), limit=math.sqrt(LOST)) \
            if worst > LOST else None

    def deviation(self, output: int, z: np.ndarray, told: Told, age: float) -> float:
        """Return what its covariance says."""
        return self._deviation(output, z[output])

    def along(self, i: int, z: np.ndarray) -> float:
        """Return what the covariance of a free run says; of an angle that is lost it is no end."""
        found = self._deviation(i, z)
        lost = self.model.angle and (z[-1] > LOST or not self._is_known(i, found))
        return math.inf if lost else found

    def _deviation(self, output: int, z: np.ndarray) -> float:
        own = self.own[output]
        found = self.filter.deviation(self.filter.row(own, z), z)
        if not self.model.angle:
            return found
        found *= math.sqrt(max(1.0, float(self.filter.off_circle(z[None])[0]) / MILD))
        return found if self._is_known(output, found) else \
            ANYWHERE * abs(float(self.model.factors[own]))

    def _is_known(self, output: int, deviation: float) -> bool:
        """Tell whether so small a deviation of an angle says where it is."""
        return deviation < KNOWN * abs(float(self.model.factors[self.own[output]]))

    def drift(self, i: int, ages: np.ndarray) -> np.ndarray:
        """
        Return what was worked out; beyond it nobody knows unless it had settled.

        Of an angle that of the loss: where it comes to rest its covariance grows, and tells.
        """
        drift: np.ndarray = self.drifts[i]
        if self.model.angle:
            return np.full(np.shape(ages), float(drift[0]))
        settled = drift[-1] <= 1.05 * np.interp(self.ages[i][-1] / 2, self.ages[i], drift)
        return np.asarray(np.interp(ages, self.ages[i], drift,
                                    right=drift[-1] if settled else np.inf))


def make_batch(entries: Sequence[ExtendedSensor], design: Contents, period: float,
               Cu: np.ndarray | None) -> ExtendedBatch:
    """Stack filters of one model; raises BadInput where they have several."""
    sensors, model, V = design.sensors, entries[0].model, len(entries)
    if not all(model.same(entry.model) for entry in entries):
        raise BadInput('', 'entries', 'of the kind extended have several models',
                       'design them together')
    healthy = np.array([[name in e.reads for name in sensors] for e in entries], dtype=bool)
    angle = bool(model.angle)
    told = np.column_stack([model.C, *[model.factors] * angle])
    tracked = [tuple(name in e.reads or (name in e.fault_set and bool(told[i].any()))
                     for i, name in enumerate(sensors)) for e in entries]
    trackers = list(dict.fromkeys(tracked))  # while all is believed many are the same
    commands = np.array([name in entries[0].commands for name in design.inputs], dtype=bool)
    # those that go on alone come first; of an angle they are not those that were tracked
    reads = np.concatenate([healthy, np.array(trackers, dtype=bool), *[healthy] * angle])
    judged = reads.copy()
    judged[V:V + len(trackers)] = False
    needs = np.hstack([reads, np.tile(commands, (len(reads), 1))])
    filter_ = Filter(model, period, reads, judged, Cu is not None)
    longest = design.sample_time or period
    warm_up = np.array([max(e.warm_up, longest) for e in entries])
    return ExtendedBatch(
        keys=tuple((e.fault_set, e.channel) for e in entries), of=np.arange(V),
        width=filter_.width, runs_on=needs, starts_on=needs.copy(),
        own=np.array([sensors.index(e.channel) for e in entries], dtype=int),
        error=np.zeros(V), assumed=np.zeros(V, dtype=bool),
        slowest=np.array([min(1.0 / max(e.decay, 1e-9), e.ages[-1]) for e in entries]),
        # of an angle that depends on how it moves, see `waiting`
        warm_up=np.full(V, np.inf) if angle else warm_up, proved=np.zeros(V, dtype=bool),
        wants_held=bool(model.Cu.any()), wants_ages=True,
        tracked=tuple(Tracked(
            i, V + trackers.index(tracked[i]), V + len(trackers) + i if angle else i,
            tuple(j for j, name in enumerate(sensors) if name in e.fault_set and tracked[i][j]),
            float(warm_up[i])) for i, e in enumerate(entries)),
        filter=filter_, model=model, ages=tuple(e.ages for e in entries),
        drifts=tuple(e.drift for e in entries))
