"""What a message costs that is only passed on: CPU and latency, relay and replacer in turns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
import time

import numpy as np

from benchmark.load import COUNTED, Load
from benchmark.rig import Heard, Process, Rig
from benchmark.row import Row
from vsensor_ros.lab.process import Failed


@dataclass(frozen=True)
class Bars:
    """How much at most: times the relay's, or in itself."""

    cpu: float | None = None
    p50: float | None = None
    core: float | None = None  # %
    lost: float | None = None  # messages


EDGE = 0.5  # s
LOADS = ((10, 100.0, 1, Bars(cpu=0.25, p50=1.5)),  # topics, Hz, messages at once
         (1, 1000.0, 1, Bars(cpu=0.5)),
         (1, 1000.0, 50, Bars(lost=0)),
         (50, 100.0, 1, Bars(core=60.0, lost=0)))


@dataclass(frozen=True)
class Leg:
    """One process in the middle for a while."""

    cpu: float  # us a message
    p50: float  # us, latency
    p99: float
    core: float  # % of one
    arrived: int  # messages
    lost: int
    rate: float  # messages a second that the drivers managed


def measure(rig: Rig, seconds: float, rounds: int,
            progress: Callable[[str], None]) -> dict[str, list[Leg]]:
    """Measure the relay and the replacer in turns, so that a drift of the machine hits both."""
    legs: dict[str, list[Leg]] = {'relay': [], 'replacer': []}
    for i in range(rounds):
        for name, serve in (('relay', rig.relay), ('replacer', rig.replacer)):
            progress(f'healthy path, round {i + 1} of {rounds}: {name}')
            with serve() as process:
                legs[name].append(_leg(rig, process, seconds))
    return legs


def _leg(rig: Rig, process: Process, seconds: float) -> Leg:
    rig.take()
    before, began = process.cpu(), time.monotonic()
    heard: list[Heard] = rig.listen(seconds)
    used, lasted = process.cpu() - before, time.monotonic() - began
    if not heard:
        raise Failed(f'{process.name} passed nothing on')
    latency = np.array([h.received - h.stamp for h in heard]) * 1e-3
    if latency.min() <= 0.0:
        raise Failed('messages came in before they were sent: the clock was set meanwhile, or '
                     'this middleware does not stamp receptions')
    p50, p99 = np.percentile(latency, [50, 99])
    missing = lost([h for h in heard if h.topic < rig.load.topics], rig.load)
    return Leg(used / len(heard) * 1e6, float(p50), float(p99), 100.0 * used / lasted,
               len(heard), missing, (len(heard) + missing) / lasted)


def lost(heard: Sequence[Heard], load: Load) -> int:
    """
    Return how many messages are missing.

    All topics are counted alike, so one that falls silent is known by the others; EDGE seconds
    at either end may be on their way.
    """
    counts: dict[int, set[int]] = {topic: set() for topic in range(load.topics)}
    for h in heard:
        since = h.stamp - heard[0].stamp  # half of what is counted, either way
        counts[h.topic].add((since + COUNTED // 2) % COUNTED - COUNTED // 2)
    first, last = min(map(min, filter(None, counts.values()))), \
        max(map(max, filter(None, counts.values())))
    edge = EDGE * load.rate
    missing = 0
    for count in counts.values():
        begin, end = (min(count), max(count)) if count else (last + 1, last)
        begin = begin if begin - first <= edge else first
        end = end if last - end <= edge else last
        missing += end - begin + 1 - len(count)
    return missing


def rows(legs: dict[str, list[Leg]], load: Load, bars: Bars) -> list[Row]:
    """Compare medians over the rounds, and the sums of what was lost."""
    at_once = f' in bursts of {load.burst}' if load.burst > 1 else ''
    group = (f'healthy path, {load.topics} topic{"s" * (load.topics > 1)} x {load.rate:g} Hz'
             f'{at_once} of {load.message}, {load.topics} virtual sensor'
             f'{"s" * (load.topics > 1)}; peer: bare typed rclpy relay')

    ours, peer = (legs[name] for name in ('replacer', 'relay'))

    def row(label: str, unit: str, what: str, factor: float = 1.0, bar: float | None = None,
            most: float | None = None) -> Row:
        middle = [factor * median(getattr(leg, what) for leg in of) for of in (ours, peer)]
        return Row(group, label, unit, middle[0], middle[1], bar, most)

    sent = sum(leg.arrived + leg.lost for leg in ours)
    return [row('CPU per message', 'us', 'cpu', bar=bars.cpu),
            row('latency p50', 'ms', 'p50', 1e-3, bars.p50),
            row('latency p99', 'ms', 'p99', 1e-3),
            row('of one core', '%', 'core', most=bars.core),
            row('messages sent a second', '1/s', 'rate'),
            Row(group, f'messages lost of {sent}', '', float(sum(leg.lost for leg in ours)),
                float(sum(leg.lost for leg in peer)), most=bars.lost)]
