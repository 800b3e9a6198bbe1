"""How long a failed sensor is missed: from the isolation message to the first replaced one."""

from __future__ import annotations

from collections.abc import Callable
import random
from statistics import median

from benchmark.rig import Heard, PERIOD, Rig
from benchmark.row import Row

BAR = 1.0
WARM_WITHIN = 30.0  # s, until a virtual sensor has converged


def measure(rig: Rig, isolations: int, progress: Callable[[str], None]) -> list[float]:
    """Let sensors fail and recover, at any phase of the period; return each latency [s]."""
    chance = random.Random(1)
    latencies = []
    with rig.replacer():
        for i in range(-len(rig.apart), isolations):
            sensor = rig.apart[i % len(rig.apart)]
            progress(f'isolation {i + 1} of {isolations}')
            latency = until(rig, sensor, True, 5.0 if i >= 0 else WARM_WITHIN)
            if i >= 0:  # before, they were not warm
                latencies.append(latency)
            rig.listen(chance.uniform(0.03, 0.06))
            until(rig, sensor, False)
            rig.listen(chance.uniform(0.03, 0.06))
    return latencies


def until(rig: Rig, sensor: int, faulty: bool, seconds: float = 5.0) -> float:
    """Report a sensor and wait until its channel follows; return how long that took [s]."""
    rig.take()
    at = rig.isolate(sensor, faulty)
    first: list[int] = []

    def followed(heard: list[Heard]) -> bool:
        first.extend(h.received for h in heard if h.topic == sensor and h.received >= at
                     and h.replaced is faulty)
        return bool(first)
    rig.wait(followed, f'y{sensor + 1} to be {"replaced" if faulty else "passed on"}', 5.0)
    return (min(first) - at) * 1e-9


def rows(latencies: list[float], relay_latency: float) -> list[Row]:
    """Compare the median with one period and the median latency of the relay [s]."""
    group = (f'isolation message to first replaced message, {len(latencies)} times; '
             'peer: one period + latency p50 of the relay')
    allowed = 1e3 * (PERIOD + relay_latency)
    return [Row(group, 'median', 'ms', 1e3 * median(latencies), allowed, BAR),
            Row(group, 'longest', 'ms', 1e3 * max(latencies), allowed)]
