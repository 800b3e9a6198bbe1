"""What went out against the truth; pure, no ROS."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import NamedTuple

import numpy as np

from vsensor_ros.lab.injection.truth import Truth

PART = 0.05             # of a channel's range that any value may be wrong by
SIGMAS = 5.0            # of its stated deviation, if that is more
LONGEST_GAP = 0.5       # s without a value of a channel that should go on
NEAR = 0.03             # s about the stamp, else the arrival, of a value's deviation

Span = tuple[float, float]  # of arrivals


class Out(NamedTuple):
    """One message on an output topic."""

    topic: str
    arrival: float              # s, monotonic
    said: float                 # s, monotonic, of the stamp, else of the arrival
    stamp: int | None           # ns; None when the type has none
    time: float                 # s, the truth's, of the stamp, else of the arrival
    values: Mapping[str, float | str]   # by sensor: the value, or why there is none
    frame: str
    names: tuple[str, ...]      # of the elements, where the type names them


class Stated(NamedTuple):
    """The deviation that the replacer states of one estimate."""

    arrival: float              # s, monotonic
    stamp: int                  # ns
    deviation: float


class StatusHeard(NamedTuple):
    """One status message of the replacer."""

    arrival: float              # s, monotonic
    facts: Mapping[str, Mapping[str, str]]  # by channel


class Said(NamedTuple):
    """One message of the replacer's own isolator."""

    arrival: float              # s, monotonic
    state: str
    kinds: Mapping[str, str]    # of fault, by sensor that is blamed
    learning: float = math.inf  # s until it knows enough of the healthy machine


@dataclass
class Evidence:
    """All that was heard in one case, and what is known of when it may be what."""

    begun: float                # s, monotonic
    outs: list[Out] = field(default_factory=list)
    told: list[StatusHeard] = field(default_factory=list)
    stated: dict[str, list[Stated]] = field(default_factory=dict)   # by channel, in order
    said: list[Said] = field(default_factory=list)
    unreadable: int = 0         # messages on output topics that are none of their type
    blind: dict[str, list[Span]] = field(default_factory=dict)  # faults nobody knows of yet
    quiet: list[Span] = field(default_factory=list)     # nothing need go out
    loose: list[Span] = field(default_factory=list)     # stamps need not increase
    # output topics on which the replacer has spoken itself; till then it passes on what comes
    spoken: set[str] = field(default_factory=set)
    ended: float = math.nan     # s, monotonic
    late: float = 0.0           # s by which readings were played late, at worst


def judge(heard: Evidence, truth: Truth, frames: Mapping[str, tuple[str, tuple[str, ...]]],
          untimed: float, gives_numbers: bool) -> list[str]:
    """
    Return what was wrong in one case, in words; [] when nothing was.

    frames: by topic, frame_id and names as the driver gives them. untimed: s by which the time of
    a message without a stamp may be wrong. gives_numbers: the replacer was told to send numbers
    when it has no estimate (`hold`, `pass`), so that those are not judged.
    """
    wrong = [f'{heard.unreadable} messages went out that nobody can read'] \
        if heard.unreadable else []
    topics = dict.fromkeys(out.topic for out in heard.outs)
    for topic in topics:
        outs = [out for out in heard.outs if out.topic == topic]
        if topic in heard.spoken:
            wrong += _stamps(topic, outs, heard.loose)
        frame, names = frames[topic]
        strange = [o for o in outs if o.frame != frame or not set(names) >= set(o.names)]
        if strange:
            wrong.append(f'{topic}: {len(strange)} messages with another frame_id or other names '
                         f'({strange[0].frame!r} {strange[0].names})')
    for name in truth.value:
        outs = [out for out in heard.outs if name in out.values]
        none = intervals_without_source(heard.told, name)
        wrong += _values(name, outs, heard, truth, none, untimed, gives_numbers)
        wrong += _gaps(name, outs, heard, none)
    return wrong


def path_of(told: Sequence[StatusHeard], name: str) -> list[str]:
    """Return the sources that a channel has had, in order; a silent sensor is a real source."""
    path: list[str] = []
    for status in told:
        source = status.facts.get(name, {}).get('source', '')
        source = 'real' if source == 'silent' else source
        if source and path[-1:] != [source]:
            path.append(source)
    return path


def handovers_of(told: Sequence[StatusHeard], name: str) -> int:
    """Return how often one virtual sensor of a channel took over from another."""
    served = [(facts.get('source'), facts.get('fault_set'))
              for status in told if (facts := status.facts.get(name))]
    return sum(a[0] == b[0] == 'virtual' and a[1] != b[1] for a, b in zip(served, served[1:]))


def switches_of(facts: Mapping[str, Mapping[str, str]], name: str) -> int:
    """Return how often a channel has switched, as a status says; 0 when it does not."""
    text = facts.get(name, {}).get('switches', '0')
    return int(text) if text.isdigit() else 0


def intervals_without_source(told: Sequence[StatusHeard], name: str) -> list[Span]:
    """
    Return when a channel had no valid source as was said, widened by the statuses' delay.

    Statuses are some time apart: one that counts two switches more than the one before tells of a
    source in between that was too short to be told.
    """
    spans: list[Span] = []
    begun: float | None = None
    before: tuple[float, int] | None = None
    for status in told:
        if name not in status.facts:
            continue
        count = switches_of(status.facts, name)
        if before is not None and count - before[1] > 1:
            spans.append((before[0] - 0.3, status.arrival + 0.2))
        before = status.arrival, count
        if status.facts[name].get('source') in ('none', 'silent'):
            begun = status.arrival if begun is None else begun
        elif begun is not None:
            spans.append((begun - 0.3, status.arrival + 0.2))
            begun = None
    return spans if begun is None else [*spans, (begun - 0.3, math.inf)]


def _stamps(topic: str, outs: Sequence[Out], loose: Sequence[Span]) -> list[str]:
    back = [b for a, b in zip(outs, outs[1:]) if a.stamp is not None and b.stamp is not None
            and b.stamp <= a.stamp
            and not any(begin <= b.arrival and a.arrival <= end for begin, end in loose)]
    return [f'{topic}: {len(back)} stamps do not increase'] if back else []


def _values(name: str, outs: Sequence[Out], heard: Evidence, truth: Truth, none: Sequence[Span],
            untimed: float, gives_numbers: bool) -> list[str]:
    blind = heard.blind.get(name, ())   # what was said in time may have come late
    judged = [o for o in outs if not (_within(o.arrival, blind) or _within(o.said, blind))]
    values = [(o, v) for o in judged if isinstance(v := o.values[name], float)]
    no_numbers = [o for o, v in values if not math.isfinite(v)
                  and (math.isinf(v) or not _within(o.arrival, none))]
    wrong = []
    if no_numbers:
        wrong.append(f'{name}: {len(no_numbers)} values are no numbers')
    numbers = [(o, v) for o, v in values if math.isfinite(v)
               and not (gives_numbers and _within(o.arrival, none))]
    bars = _bars(name, [out for out, _ in numbers], heard, truth)
    worst, bad = ('', 0.0), []
    for (out, value), bar in zip(numbers, bars):
        # what was played late could not be known before
        around = np.linspace(out.time - heard.late, out.time, 9) if out.stamp is not None \
            else np.linspace(out.time - untimed, out.time + untimed, 9)
        error = float(np.min(np.abs(value - truth.at(name, around))))
        if error > bar:
            bad.append(out.arrival - heard.begun)
            if error / bar > worst[1]:
                worst = (f'{value:.4g} for {truth.at(name, out.time):.4g}, {bar:.2g} allowed',
                         error / bar)
    if bad:
        wrong.append(f'{name}: {len(bad)} of {len(numbers)} values are wrong ({worst[0]}; '
                     f'{bad[0]:.2f} to {bad[-1]:.2f} s from the begin)')
    return wrong


def _bars(name: str, outs: Sequence[Out], heard: Evidence, truth: Truth) -> list[float]:
    """Return the errors allowed: a part of the range, or several stated deviations."""
    # what a real one says has the noise of its sensor
    least = max(PART * truth.span[name], SIGMAS * truth.noise[name])
    stated = [s for s in heard.stated.get(name, []) if math.isfinite(s.deviation)]
    by_stamp, by_arrival = (sorted(stated, key=key) for key in (_stamp, _arrival))
    bars = []
    for out in outs:
        near = _about(by_arrival, _arrival, out.arrival, NEAR) if out.stamp is None else \
            _about(by_stamp, _stamp, out.stamp, NEAR * 1e9)
        bars.append(max(least, SIGMAS * max((s.deviation for s in near), default=0.0)))
    return bars


def _stamp(stated: Stated) -> float:
    return stated.stamp


def _arrival(stated: Stated) -> float:
    return stated.arrival


def _about(stated: Sequence[Stated], key: Callable[[Stated], float], at: float,
           near: float) -> Sequence[Stated]:
    return stated[bisect_left(stated, at - near, key=key):bisect_right(stated, at + near, key=key)]


def _gaps(name: str, outs: Sequence[Out], heard: Evidence, none: Sequence[Span]) -> list[str]:
    """Find gaps of what was heard; what came late, but is stamped without a gap, is none."""
    spoken = [o for o in outs if isinstance(v := o.values[name], float) and math.isfinite(v)]
    times = [heard.begun, *(o.arrival for o in spoken), heard.ended]
    stamped = [math.inf, *(b.time - a.time if a.stamp is not None else math.inf
                           for a, b in zip(spoken, spoken[1:])), math.inf]
    excused = [*heard.blind.get(name, ()), *heard.quiet, *none]
    longest = max(min(between, b - a - sum(max(0.0, min(b, end) - max(a, begin))
                                           for begin, end in excused))
                  for a, b, between in zip(times, times[1:], stamped))
    return [f'{name}: nothing went out for {longest:.2f} s'] if longest > LONGEST_GAP else []


def _within(time: float, spans: Sequence[Span]) -> bool:
    return any(begin <= time <= end for begin, end in spans)
