"""How good what went out for one channel was, over all windows, beside what is simple."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math

import numpy as np

from vsensor_ros.engine import Setup
from vsensor_ros.recordings.peers import peers
from vsensor_ros.recordings.recording import Recording, Track
from vsensor_ros.recordings.through_engine import Loss, Said
from vsensor_ros.recordings.trials import Case, Trials

PEERS = ('hold', 'regression', 'arx')


@dataclass(frozen=True, eq=False)
class Window:
    """What there is to see of one window: times (T,) [s], all values (T,), NaN where none is."""

    recording: str
    start: float  # s
    times: np.ndarray
    truth: np.ndarray
    values: np.ndarray
    deviations: np.ndarray
    peers: Mapping[str, np.ndarray]
    rmse: float  # of what went out; NaN where nothing did


@dataclass(frozen=True)
class Judgement:
    """
    What went out for one channel of one case, in its unit; NaN where it is not known.

    Errors are those of what went out, those of the peers are of the same times; where nothing went
    out at all, of all times.
    """

    channel: str
    fault_set: tuple[str, ...]
    kind: str  # of the fault
    unit: str
    grade: str  # of the virtual sensor; '' when none spoke
    windows: int
    windows_served: float  # share in which something went out
    served: float  # share of the time
    rmse: float
    median: float  # of the sizes of the errors at the windows' ends
    p90: float  # 90th percentile of those
    p99: float
    hold: float  # rmse of the last reading before the loss
    regression: float  # rmse of a static regression on the other channels
    arx: float  # rmse of an ARX model
    arx_order: int
    deviation: float  # rms of what was stated
    noise: float  # of a reading, known of the sensor; 0: it is not known
    coverage1: float  # share of errors within one deviation: stated, and the reading's noise
    coverage: float  # within two
    coverage3: float  # within three
    step: float  # median size of the first value that went out less the last reading before
    until: float  # s after the loss when the last went out, median where it ended; inf: nowhere
    found: float  # share of windows in which the isolator blamed all the lost
    delay: float  # s until it did, median
    blamed: float  # share of windows in which it blamed others
    alarms: float  # a day, false, while all was well
    why: Mapping[str, int]  # why nothing went out at the end of a window, and of how many
    shown: tuple[Window, ...] = field(default=(), repr=False)  # worst, median and best

    @property
    def best_peer(self) -> str:
        """The peer with the least error; '' when there is none."""
        known = [name for name in PEERS if not math.isnan(getattr(self, name))]
        return min(known, key=lambda name: float(getattr(self, name)), default='')

    @property
    def beaten(self) -> bool:
        """Whether something went out, and a peer is better."""
        best = self.best_peer
        return bool(best) and self.rmse > getattr(self, best)


def judge_trials(setup: Setup, trials: Trials) -> list[Judgement]:
    """Judge each channel of each case."""
    return [_judge(setup, trials, case, channel) for case in trials.heard
            for channel in case.names]


def _judge(setup: Setup, trials: Trials, case: Case, channel: str) -> Judgement:
    design, heard = setup.design, trials.heard[case]
    turn = next((abs(angles[channel]) for angles in design.wrap if channel in angles), None)
    recordings = list({id(recording): recording for recording, _, _ in heard}.values())
    order = {id(recording): i for i, recording in enumerate(recordings)}
    said = sorted(heard, key=lambda entry: (order[id(entry[0])], entry[1].start))
    others = [name for name in (*design.sensors, *design.inputs) if name not in case.names
              and all(name in recording.tracks for recording in recordings)]
    beside = peers(recordings, channel, others, setup.rate, trials.windows,
                   [s[channel].times for _, _, s in said], turn)
    tracks = {id(r): _unwrapped(r.tracks[channel], turn) for r in recordings}
    windows = [_window(entry, channel, tracks[id(entry[0])], turn, regression, arx)
               for entry, regression, arx in zip(said, beside.regression, beside.arx)]
    spoken = [s[channel] for _, _, s in said]
    error = _all([_error(w.values, w.truth, turn) for w in windows])
    stated = _all([w.deviations for w in windows])
    noise = design.noise.get(channel, 0.0)
    out = np.isfinite(error)
    counted = out if out.any() else np.ones(len(error), bool)

    def simple(name: str) -> float:
        missed = _all([_error(w.peers[name], w.truth, turn) for w in windows])[counted]
        if name == 'hold':  # nothing to hold where nothing was said before the loss
            missed = missed[np.isfinite(missed)]
        return _rms(missed)

    def covered(deviations: float) -> float:
        return _mean(np.abs(error[out]) <= deviations * np.hypot(stated[out], noise))

    ends = [float(e[np.isfinite(e)][-1]) for w in windows
            if np.isfinite(e := np.abs(_error(w.values, w.truth, turn))).any()]
    steps = [abs(float(_error(_spoken(s)[0], s.before, turn))) for s in spoken
             if len(_spoken(s)) and math.isfinite(s.before)]
    last = [float(s.times[np.isfinite(s.values)][-1]) - loss.start
            for (_, loss, _), s in zip(said, spoken) if len(_spoken(s)) and s.why is not None]
    found = [s.found for s in spoken if not math.isnan(s.found)]
    alone = bool(said) and said[0][1].told is None  # the own isolator was
    return Judgement(
        channel=channel, fault_set=case.names, kind=case.kind,
        unit=design.units.get(channel, ''), grade=next((s.grade for s in spoken if s.grade), ''),
        windows=len(windows), windows_served=_mean([len(_spoken(s)) > 0 for s in spoken]),
        served=_mean(out), rmse=_rms(error[out]), median=_percentile(ends, 50),
        p90=_percentile(ends, 90), p99=_percentile(ends, 99), hold=simple('hold'),
        regression=simple('regression'), arx=simple('arx'), arx_order=beside.order,
        deviation=_rms(stated[out]), noise=noise, coverage1=covered(1.0), coverage=covered(2.0),
        coverage3=covered(3.0), step=_percentile(steps, 50),
        until=float(np.median(last)) if last else math.inf,
        found=len(found) / len(spoken) if alone else math.nan, delay=_percentile(found, 50),
        blamed=_mean([bool(s.blamed) for s in spoken]) if alone else math.nan,
        alarms=len(trials.alarms) / trials.healthy_seconds * 86400.0
        if alone and trials.healthy_seconds else math.nan,
        why=_why(spoken), shown=_shown(windows))


def _spoken(said: Said) -> np.ndarray:
    return said.values[np.isfinite(said.values)]


def _window(entry: tuple[Recording, Loss, Mapping[str, Said]], channel: str, track: Track,
            turn: float | None, regression: np.ndarray, arx: np.ndarray) -> Window:
    recording, loss, said = entry
    s = said[channel]
    truth = track.at(s.times)
    error = _error(s.values, truth, turn)
    return Window(recording.name, loss.start, s.times, truth, s.values, s.deviations, {
        'hold': np.full(len(s.times), s.before), 'regression': regression, 'arx': arx},
        _rms(error[np.isfinite(error)]))


def _why(spoken: Sequence[Said]) -> dict[str, int]:
    """Count why nothing goes out at the end; sentences that differ in numbers alone are one."""
    first: dict[str, str] = {}
    counts: Counter[str] = Counter()
    for said in spoken:
        if said.why is not None:
            counts[first.setdefault(said.why.code, str(said.why))] += 1
    return dict(counts.most_common())


def _shown(windows: Sequence[Window]) -> tuple[Window, ...]:
    """Return the worst, the median and the best window of those in which something went out."""
    order = sorted((w for w in windows if not math.isnan(w.rmse)), key=lambda w: -w.rmse)
    return tuple(dict.fromkeys(
        (order[0], order[len(order) // 2], order[-1]))) if order else ()


def _unwrapped(track: Track, turn: float | None) -> Track:
    if turn is None:
        return track
    there = np.isfinite(track.values)
    return Track(track.stamps[there], np.unwrap(track.values[there], period=turn), track.origin)


def _error(values: np.ndarray | float, truth: np.ndarray | float,
           turn: float | None) -> np.ndarray:
    error = np.asarray(values, float) - truth
    return error if turn is None else (error + turn / 2.0) % turn - turn / 2.0


def _all(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.zeros(0), *parts])


def _mean(there: Sequence[bool] | np.ndarray) -> float:
    return float(np.mean(np.asarray(there, float))) if len(there) else math.nan


def _rms(values: np.ndarray) -> float:
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if len(there) and len(there) == len(values) \
        else math.nan


def _percentile(values: Sequence[float], part: float) -> float:
    return float(np.percentile(values, part)) if len(values) else math.nan
