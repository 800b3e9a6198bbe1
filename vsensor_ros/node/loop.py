"""
The loop: waits for messages and for the time of the next tick, and polls.

When much arrives it does not wait for each message but sleeps a little, and takes together what
came meanwhile: waking costs more than a message does.
"""

from __future__ import annotations

from collections.abc import Iterable
import sys
from threading import Event
import time

from vsensor_ros.node.isolator import Isolator
from vsensor_ros.node.private_rclpy import Waiting
from vsensor_ros.node.replacer import Replacer

LONGEST = 50_000_000  # ns of a wait: that soon it sees that it is to stop
OFTEN = 500_000  # ns between messages, in the mean, below which it sleeps instead of waiting
LONGEST_PAUSE = 2_000_000  # ns
SHARE = 4  # a pause lasts that many times as long as the poll before
SWITCH_INTERVAL = 0.0001  # s that another thread may keep the interpreter from the loop


def run(replacer: Replacer | Isolator, stop: Event, active: Event) -> None:
    """Poll until told to stop, or not active any more."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    with Waiting(replacer.subscriptions, replacer.node.context) as waiting:
        ready: Iterable[int] | None = None  # all, at first
        interval, last = 10 * OFTEN, time.monotonic_ns()  # between messages, in the mean
        while active.is_set() and not stop.is_set():
            begin = time.monotonic_ns()
            taken = replacer.poll(ready)
            if taken:
                interval += ((begin - last) // taken - interval) // 16
                last = begin
            left = LONGEST if replacer.simulated else max(0, min(
                LONGEST, replacer.due - time.time_ns()))
            if interval < OFTEN and begin - last < LONGEST_PAUSE:
                work = time.monotonic_ns() - begin
                time.sleep(min(max(OFTEN, SHARE * work), LONGEST_PAUSE, left) * 1e-9)
                ready = None
                continue
            ready = waiting.wait(left)
