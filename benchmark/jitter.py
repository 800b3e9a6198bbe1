"""
How evenly the replacer ticks, beside a bare timer of rclpy at the same rate and the same time.

A tick is seen from outside: while a sensor is failed, each sends one estimate, and the middleware
stamps it when it is sent. The timer sends one message of the same type a tick. So neither is
asked for its own opinion, and the way of the messages does not count.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack

import numpy as np

from benchmark.isolation import until, WARM_WITHIN
from benchmark.rig import Heard, Rig, SETTLE
from benchmark.row import Row
from vsensor_ros.lab.process import Failed

BAR = 1.0
FAILED = 0  # the sensor that does


def measure(rig: Rig, seconds: float, rounds: int, busy: bool,
            progress: Callable[[str], None]) -> tuple[list[float], list[float]]:
    """Return how far intervals between ticks are from the period [s]: replacer's, timer's."""
    ours: list[float] = []
    peer: list[float] = []
    for i in range(rounds):  # anew, so that the phase of one to the other is another
        progress(f'ticks, {"busy" if busy else "idle"}, round {i + 1} of {rounds}')
        with ExitStack() as stack:
            stack.enter_context(rig.replacer())
            stack.enter_context(rig.timer())
            until(rig, FAILED, True, WARM_WITHIN)
            if busy:
                stack.enter_context(rig.run('the busy one', ['benchmark.busy']))
            rig.listen(SETTLE)
            heard = rig.listen(seconds)
            ours += deviations([h for h in heard if h.topic == FAILED and h.replaced], rig.rate)
            peer += deviations([h for h in heard if h.topic == rig.load.topics], rig.rate)
    return ours, peer


def deviations(heard: Sequence[Heard], rate: float) -> list[float]:
    """Return how far the intervals between messages sent are from the period [s]."""
    if len(heard) < 10:
        raise Failed(f'only {len(heard)} ticks were seen')
    sent = np.array([h.sent for h in heard])
    if sent.min() <= 0:
        raise Failed('this middleware does not stamp what it sends')
    deviation: list[float] = np.abs(np.diff(sent) * 1e-9 - 1.0 / rate).tolist()
    return deviation


def rows(ours: Sequence[float], peer: Sequence[float], rate: float, label: str) -> list[Row]:
    """Compare the percentiles."""
    group = (f'|interval between ticks - period| at {rate:g} Hz, {len(ours)} ticks, {label}; '
             'peer: bare rclpy timer')

    def row(part: int, bar: float | None = None) -> Row:
        return Row(group, f'p{part}', 'us', 1e6 * float(np.percentile(ours, part)),
                   1e6 * float(np.percentile(peer, part)), bar)

    return [row(50), row(99, BAR)]
