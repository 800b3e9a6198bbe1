"""The filters of a design for the bank, all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.batch import Batch, StepOfSome, Told, Tracked
from vsensor_ros.observers.kinds.extended.filter import Filter, LOST
from vsensor_ros.observers.kinds.extended.sensor import ExtendedSensor, Model
from vsensor_ros.reason import add_sentences, Reason

add_sentences({'model lost': 'the healthy sensors say {size:.2g} times what the model expects '
               'of them, at most {limit:g}'})


@dataclass(frozen=True, eq=False, kw_only=True)
class ExtendedBatch(Batch):
    """V filters of one output that go on without their channels, then those that track them."""

    filter: Filter
    model: Model
    ages: tuple[np.ndarray, ...]  # V
    drifts: tuple[np.ndarray, ...]  # V

    def start(self, told: Told) -> np.ndarray:
        """Start those that their channels track; the others start from these."""
        z = self.filter.start(told)
        z[:self.size] = np.nan
        return z

    def step(self, z: np.ndarray, before: Told, after: Told,
             commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step all at once."""
        return self.filter.step(z, after, commands), np.zeros(len(z), dtype=bool)

    def step_of(self, rows: np.ndarray) -> StepOfSome:
        """Take their readings alone."""
        some = self.filter.of(rows)
        return lambda z, before, after, commands: (
            some.step(z, after, commands), np.zeros(len(z), dtype=bool))

    def estimates(self, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return C x + Cu u of each."""
        found = (z[..., :len(self.model.states)] * self.model.C[self.own]).sum(axis=-1)
        return found + held @ self.model.Cu[self.own].T if held.shape[-1] else found

    def estimate(self, output: int, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return that of one."""
        found = z[..., :len(self.model.states)] @ self.model.C[self.own[output]]
        return np.asarray(found + held @ self.model.Cu[self.own[output]]
                          if held.shape[-1] else found)

    def invalid(self, output: int, z: np.ndarray, told: Told, age: float) -> Reason | None:
        """Return that the model does not hold, if it has shown that since the channels went."""
        worst = float(z[output, -1])
        return Reason.of('model lost', size=math.sqrt(worst), limit=math.sqrt(LOST)) \
            if worst > LOST else None

    def deviation(self, output: int, z: np.ndarray, told: Told, age: float) -> float:
        """Return what its covariance says."""
        return self.along(output, z[output])

    def along(self, i: int, z: np.ndarray) -> float:
        """Return what the covariance of a free run says."""
        return self.filter.deviation(self.model.C[self.own[i]], z)

    def drift(self, i: int, ages: np.ndarray) -> np.ndarray:
        """Return what was worked out; beyond it nobody knows unless it had settled."""
        drift = self.drifts[i]
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
    tracked = [tuple(name in e.reads or (name in e.fault_set and bool(model.C[i].any()))
                     for i, name in enumerate(sensors)) for e in entries]
    trackers = list(dict.fromkeys(tracked))  # while all is believed many are the same
    reads = np.concatenate([healthy, np.array(trackers, dtype=bool)])
    commands = np.array([name in entries[0].commands for name in design.inputs], dtype=bool)
    needs = np.hstack([reads, np.tile(commands, (len(reads), 1))])
    filter_ = Filter(model, period, reads, np.concatenate(
        [healthy, np.zeros((len(trackers), len(sensors)), dtype=bool)]), Cu is not None)
    longest = design.sample_time or period
    warm_up = np.array([max(e.warm_up, longest) for e in entries])
    return ExtendedBatch(
        keys=tuple((e.fault_set, e.channel) for e in entries), of=np.arange(V),
        width=filter_.width, runs_on=needs, starts_on=needs.copy(),
        own=np.array([sensors.index(e.channel) for e in entries], dtype=int),
        error=np.zeros(V), assumed=np.zeros(V, dtype=bool),
        slowest=np.array([min(1.0 / max(e.decay, 1e-9), e.ages[-1]) for e in entries]),
        warm_up=warm_up, proved=np.zeros(V, dtype=bool), wants_held=bool(model.Cu.any()),
        wants_ages=True,
        tracked=tuple(Tracked(i, V + trackers.index(tracked[i]), i, tuple(
            j for j, name in enumerate(sensors) if name in e.fault_set and tracked[i][j]),
            float(warm_up[i])) for i, e in enumerate(entries)),
        filter=filter_, model=model, ages=tuple(e.ages for e in entries),
        drifts=tuple(e.drift for e in entries))
