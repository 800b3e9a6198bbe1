"""What a message costs that is only passed on: CPU and latency, relay and replacer in turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import numpy as np

from benchmark.load import Load
from benchmark.rig import Heard, Process, Rig
from benchmark.row import Row
from vsensor_ros.command.failover import Failed

CPU_BAR = 0.5


@dataclass(frozen=True)
class Leg:
    """One process in the middle for a while."""

    cpu: float  # us a message
    p50: float  # us, latency
    p99: float
    arrived: float  # part of the messages sent


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
    before = process.cpu()
    heard: list[Heard] = rig.listen(seconds)
    used = process.cpu() - before
    if not heard:
        raise Failed(f'{process.name} passed nothing on')
    latency = np.array([h.received - h.stamp for h in heard]) * 1e-3
    if latency.min() <= 0.0:
        raise Failed('messages came in before they were sent: the clock was set meanwhile, or '
                     'this middleware does not stamp receptions')
    p50, p99 = np.percentile(latency, [50, 99])
    sent = rig.load.topics * rig.load.rate * seconds
    return Leg(used / len(heard) * 1e6, float(p50), float(p99), len(heard) / sent)


def rows(legs: dict[str, list[Leg]], load: Load) -> list[Row]:
    """Compare medians over the rounds."""
    group = (f'healthy path, {load.topics} topics x {load.rate:g} Hz of {load.message}; '
             'peer: bare typed rclpy relay')

    def middle(name: str, what: str) -> float:
        return median(getattr(leg, what) for leg in legs[name])

    def row(label: str, unit: str, what: str, factor: float, bar: float | None = None) -> Row:
        return Row(group, label, unit, factor * middle('replacer', what),
                   factor * middle('relay', what), bar)

    return [row('CPU per message', 'us', 'cpu', 1.0, CPU_BAR),
            row('latency p50', 'ms', 'p50', 1e-3),
            row('latency p99', 'ms', 'p99', 1e-3),
            row('messages that arrived', '%', 'arrived', 100.0)]
