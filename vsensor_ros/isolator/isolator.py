"""The isolator of one machine: from readings and estimates to who failed, how and since when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsensor_ros.bad_input import BadInput
from vsensor_ros.isolator.channels import ROUGH
from vsensor_ros.isolator.detector import ENOUGH, TESTS, WINDOWS
from vsensor_ros.isolator.diagnosis import Diagnosis
from vsensor_ros.isolator.recovery import Recovery
from vsensor_ros.isolator.settings import Settings
from vsensor_ros.isolator.shape import BIAS, DRIFT, FEWEST, shape_of
from vsensor_ros.isolator.verdict import (
    DROPPED,
    Fault,
    HEALTHY,
    ISOLATED,
    MODEL,
    NOISE,
    STUCK,
    SUSPECTED,
    UNKNOWN,
    Verdict,
)
from vsensor_ros.isolator.watch import Watch
from vsensor_ros.observers import Residual
from vsensor_ros.reason import Reason

DAY = 86400.0  # s
SHORT = 16  # samples of the mean that is a deviation
AGAIN = 0.5  # s between two looks at the shape of a fault
LATELY = 10.0  # s for which spikes are told
EARLY = 16  # samples of a window in which a fault may have begun that was there before it
LARGEST = 1e75  # so that its square is a number; what is beyond is no reading
GRID = 0.5  # of a period, by which a step may be off the grid


@dataclass
class _Known:
    """A fault, and what comes of it."""

    fault: Fault
    recovery: Recovery
    looked: float = -np.inf  # s, at its shape
    dated: bool = False  # its onset was seen


class Isolator:
    """
    Whose fault it is, by the residuals of a design; one `step` for each time of the grid.

    sensors: names, c of them. residuals: r of them, of the design. period [s] of the grid. wraps:
    of sensors whose residual counts modulo so much. units: for what is said.
    """

    def __init__(self, settings: Settings, sensors: Sequence[str], residuals: Sequence[Residual],
                 period: float, wraps: Mapping[str, float] = MappingProxyType({}),
                 units: Mapping[str, str] = MappingProxyType({})) -> None:
        """Prepare; raises BadInput."""
        _check(sensors, residuals, settings)
        self.settings, self.sensors, self.period = settings, tuple(sensors), period
        self.residuals = tuple(residuals)
        self._units = dict(units)
        own = [self.sensors.index(r.channel) if r.channel in self.sensors else -1
               for r in residuals]
        gains = np.zeros((len(own), len(sensors)))
        for i, r in enumerate(residuals):
            for name, gain in r.motion().items():
                gains[i, self.sensors.index(name)] = gain
        best = [min((i for i, of in enumerate(own) if of == j), default=-1,
                    key=lambda i: len(residuals[i].support)) for j in range(len(sensors))]
        wanted = settings.false_alarms_per_day / DAY / (TESTS * max(len(own), 1))
        supports = np.array([[name in r.support for name in sensors] for r in residuals], bool)
        self.watch = Watch(period, np.array(own, dtype=np.int64),
                           supports.reshape(len(own), len(sensors)), gains,
                           np.array([r.noise for r in residuals], dtype=float),
                           np.array(best, dtype=np.int64), wanted, settings.model_error,
                           np.array([wraps.get(r.channel, np.inf) for r in residuals]))
        self._diagnosis = Diagnosis([sum(1 << self.sensors.index(name) for name in r.support)
                                     for r in residuals])
        self._known: dict[int, _Known] = {}  # by sensor
        self._readings = np.empty((self.watch.batch, len(sensors)))
        self._estimates = np.empty((self.watch.batch, len(residuals)))
        self._held = 0  # samples of the batch that is being gathered
        self._time: int | None = None
        # by sensor, ns: since when it has been believed
        self._believed = np.zeros(len(sensors), dtype=np.int64)
        self._set_back = 0  # ns by which the clock was, in all: what lasts goes on
        self._spikes = [(0, -np.inf)] * len(sensors)  # count, and when [s] it grew
        self._spiking = [False] * len(sensors)
        self._verdict = Verdict(0)

    def step(self, time: int, readings: ArrayLike, estimates: ArrayLike, confirmed: bool = True,
             ) -> Verdict:
        """
        Take what was read and estimated at a time of the grid [ns]; return what is known by now.

        readings (c,): NaN where none came; infinite is none. estimates (r,): of the channel of
        each residual, or the residual itself where it has none; NaN while it does not run. A time
        that is not confirmed, because readings may still come in late, is not looked at; it has to
        be given again.
        """
        if not confirmed or self.settings.mode == 'off':
            return self._verdict
        if self._time is None:
            self._believed[:] = time
        elif abs(time - self._time - 1e9 * self.period) \
                > GRID * 1e9 * self.period:
            self._set_back += max(0, self._time - time)
            self._start_anew(time)
        self._time = time
        self._readings[self._held], self._estimates[self._held] = readings, estimates
        self._held += 1
        if self._held == self.watch.batch:
            self._held = 0
            self._judge(time)
        return self._verdict

    @property
    def verdict(self) -> Verdict:
        """What is known by now."""
        return self._verdict

    @property
    def learning(self) -> bool:
        """Whether nothing is wrong, so that this is what the healthy machine shows."""
        return not self._diagnosis.stands

    def clear(self, sensor: str) -> None:
        """Believe a sensor again, because somebody says so; raises KeyError for a stranger."""
        if sensor not in self.sensors:
            raise KeyError(f'{sensor}: no such sensor; there are {", ".join(self.sensors)}')
        if self._time is not None:
            j = self.sensors.index(sensor)
            checks = self._diagnosis.excusable()
            if checks.size:  # so says who looked after it
                self._diagnosis.dismiss(self._lasting(self._time))
                self._admit(checks)
            else:
                self._forgive(j, self._time)
            self._say(self._time)

    def _start_anew(self, time: int) -> None:
        """Forget the samples, not what was learnt: time has jumped."""
        self._held = 0
        self._believed[:] = time
        self.watch.restart()

    def _judge(self, time: int) -> None:
        watch, diagnosis, now = self.watch, self._diagnosis, self._lasting(time)
        for kept in (self._readings, self._estimates):
            flat = kept.reshape(-1)
            if not flat.dot(flat) < LARGEST:  # the sum of squares: not NaN, and far below
                kept[~(np.abs(kept) < LARGEST)] = np.nan
        healthy = not diagnosis.stands
        excusable = diagnosis.excusable() if diagnosis.model else None
        alarms = watch.step(self._readings, self._estimates, healthy, healthy)
        direct = self._direct()
        if diagnosis.stands or direct or np.count_nonzero(alarms):
            diagnosis.update(now, alarms, watch.running(), [1 << j for j in direct],
                             lambda: [1 << j for j in np.flatnonzero(
                                 watch.channels.stepped()).tolist()])
            if excusable is not None and not diagnosis.stands \
                    and self.watch.detector.full(excusable):
                self._admit(excusable)
            self._follow(time, direct)
        if self._count_spikes(now) or not healthy or diagnosis.stands or self._verdict.time == 0 \
                or self._known or self._verdict.notes:
            self._say(time)
        else:
            self._verdict = Verdict(time)

    def _direct(self) -> dict[int, str]:
        """Return whose readings alone show a fault, and of what kind."""
        channels = self.watch.channels
        found: dict[int, str] = {}
        for kind, which in ((NOISE, channels.noisy()), (STUCK, channels.stuck(self.watch.said)),
                            (DROPPED, channels.dropped())):
            if np.count_nonzero(which):
                found |= dict.fromkeys(np.flatnonzero(which).tolist(), kind)
        return found

    def _follow(self, time: int, direct: Mapping[int, str]) -> None:
        """Keep the faults that are known: new ones, those withdrawn, and those that ended."""
        found = {s.bit_length() - 1 for s in self._diagnosis.found}
        for j in [j for j in self._known if j not in found]:
            del self._known[j]
        for j in sorted(found):
            if j not in self._known:
                self._known[j] = _Known(Fault(self.sensors[j], UNKNOWN, time, time, None,
                                              self._units.get(self.sensors[j], '')),
                                        Recovery(self.settings.dwell))
            self._look(j, time, direct.get(j))
        if self.settings.recovery == 'return':
            for j in [j for j, known in self._known.items() if self._is_back(j, known, time)]:
                self._forgive(j, time)

    def _look(self, j: int, time: int, direct: str | None) -> None:
        """Draw the kind, the onset and the size of a fault from its channel and residual."""
        known, now = self._known[j], self._lasting(time)
        fault, channels = known.fault, self.watch.channels
        if direct == NOISE:
            size = float(channels.rough[j] / channels.roughness[j])
            begun = fault.onset if fault.kind == NOISE else self._ago(time, ROUGH)
            fault = replace(fault, kind=NOISE, size=size, onset=min(fault.onset, begun))
        elif direct is not None:
            run = channels.run[j] if direct == STUCK else channels.gap[j]
            fault = replace(fault, kind=direct, size=None, onset=self._ago(time, int(run)))
        elif fault.kind in (UNKNOWN, BIAS, DRIFT) and now - known.looked >= AGAIN:
            known.looked = now
            best = int(self.watch.best[j])
            past = self.watch.detector.past(best, 5 * WINDOWS[-1]) if best >= 0 else np.empty(0)
            if len(past) >= FEWEST:
                shape = shape_of(past - self.watch.centre(best))
                if len(past) - shape.samples > EARLY:
                    known.dated = True
                    fault = replace(fault, kind=shape.kind, size=shape.size,
                                    onset=self._ago(time, shape.samples))
                else:  # it began before what is remembered
                    fault = replace(fault, size=self._deviation(j))
                    if not known.dated:  # perhaps before its observer did
                        fault = replace(fault, kind=shape.kind, onset=int(self._believed[j]))
        known.fault = fault

    def _lasting(self, time: int) -> float:
        """Return a time in s that is never set back."""
        return (time + self._set_back) * 1e-9

    def _ago(self, time: int, samples: int) -> int:
        return time - round(samples * self.period * 1e9)

    def _deviation(self, j: int) -> float | None:
        best = int(self.watch.best[j])
        if best < 0:
            return None
        return float(self.watch.detector.level(SHORT)[best]) - self.watch.centre(best)

    def _is_back(self, j: int, known: _Known, time: int) -> bool:
        channels = self.watch.channels
        sound = not (channels.run[j] or channels.gap[j] or channels.noisy()[j]) \
            if known.fault.kind in (STUCK, DROPPED) else not channels.noisy()[j]
        return known.recovery.step(self._lasting(time), self._deviation(j), bool(sound),
                                   known.fault.kind in (BIAS, DRIFT, UNKNOWN))

    def _forgive(self, j: int, time: int) -> None:
        self._diagnosis.forgive(1 << j, self._lasting(time), self.watch.running())
        # those that did not alarm have felt it, too
        self.watch.detector.restart(np.flatnonzero(self.watch.supports[:, j]))
        self._known.pop(j, None)
        self._believed[j] = time

    def _admit(self, checks: NDArray[np.int64]) -> None:
        """Learn from alarms for which no sensor was to blame, and which are over."""
        if checks.size:
            self.watch.detector.admit(checks)
            self.watch.detector.restart(checks)

    def _count_spikes(self, now: float) -> bool:
        new = False
        if not self.watch.channels.spiked:
            return new
        for j in np.flatnonzero(self.watch.channels.spikes).tolist():
            count = int(self.watch.channels.spikes[j])
            if count > self._spikes[j][0]:
                # one alone, once in hours, is what noise does
                self._spiking[j] = now - self._spikes[j][1] <= LATELY
                self._spikes[j], new = (count, now), new or self._spiking[j]
        return new

    def _say(self, time: int) -> None:
        now, diagnosis = self._lasting(time), self._diagnosis
        faults = tuple(self._known[j].fault for j in sorted(self._known))
        candidates = tuple(self._names(mask) for mask in diagnosis.candidates)
        notes = []
        if diagnosis.model:
            notes.append(Reason.of('fault of model', names=tuple(
                self.residuals[i].name for i in sorted(diagnosis.conflicts))))
        notes += [Reason.of('fault spikes', sensor=self.sensors[j], count=count)
                  for j, (count, when) in enumerate(self._spikes)
                  if self._spiking[j] and now - when <= LATELY]
        learnt = self.watch.detector.learnt.min(initial=np.iinfo(np.int64).max) * self.period
        if learnt < ENOUGH:
            notes.append(Reason.of('fault learning', seconds=ENOUGH - float(learnt)))
        state = MODEL if diagnosis.model else ISOLATED if faults else SUSPECTED if candidates \
            else HEALTHY
        self._verdict = Verdict(time, state, faults, candidates, tuple(notes))

    def _names(self, mask: int) -> tuple[str, ...]:
        return tuple(name for j, name in enumerate(self.sensors) if mask >> j & 1)

    def smallest(self) -> dict[str, float]:
        """Return of each sensor that a residual shows the least constant fault that is found."""
        level = self.watch.detector.thresholds[:2 * len(WINDOWS)].reshape(2, len(WINDOWS), -1)
        width = level.sum(axis=0).min(axis=0) / 2  # of the best window; the means cancel
        return {self.sensors[j]: float(width[best]) for j, best in enumerate(self.watch.best)
                if best >= 0}

    def too_small(self) -> tuple[Reason, ...]:
        """Say which of the smallest faults that were asked for cannot be found."""
        least = self.smallest()
        return tuple(
            Reason.of('fault too small', sensor=name, wanted=wanted, least=least.get(name, np.inf))
            for name, wanted in self.settings.smallest_fault.items()
            if not least.get(name, np.inf) <= wanted)


def _check(sensors: Sequence[str], residuals: Sequence[Residual], settings: Settings) -> None:
    for r in residuals:
        strange = sorted(set(r.support) - set(sensors))
        if strange or not r.support:
            raise BadInput('isolator', r.name, f'{", ".join(strange) or "nobody"} is no sensor',
                           f'the sensors are {", ".join(sensors)}')
        if not 0.0 < r.noise < np.inf:
            raise BadInput('isolator', r.name, f'its noise is {r.noise:g}',
                           'give the noise of the sensors in the plant file, and design again')
    strange = sorted(set(settings.smallest_fault) - set(sensors))
    if strange:
        raise BadInput('isolator', 'smallest_fault', f'{", ".join(strange)} is no sensor',
                       f'the sensors are {", ".join(sensors)}')
