"""
What it costs to share a sweep among processes: beside `design(plant)` in one process.

The plant is a network of which all states are measured, and any one or two sensors fail: many
small tasks, to which sending them matters most. The same design is made in three ways, in turns:
in this process, with the tasks sent to one other, and to two, as with `--jobs 2`. With one the
ratio is what pickling and dispatch add to a task; with two, on two idle cores, 0.5 would be twice
as fast. The processes are warm: how long the first takes to load numpy and scipy is a row by
itself. Seconds of the wall clock.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np

from benchmark.designer import network
from benchmark.row import Row
from vsensor_ros import design, Plant
from vsensor_ros.designer.processes import Processes

STATES = 8
ROUNDS = 3


def measure(n: int = STATES, rounds: int = ROUNDS,
            progress: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Time the same sweep in this process, in one other, and in two; medians of the rounds."""
    wires = network(n, 0)
    plant = Plant.from_matrices(wires.A, wires.B, np.eye(n))
    spent: dict[str, list[float]] = {'alone': [], 'one': [], 'two': []}
    with Processes(1) as one, Processes(2) as two:
        began = perf_counter()
        one.submit(int).result()
        started = perf_counter() - began
        for executor in (None, one, two):
            design(plant, executor=executor)
        for turn in range(rounds):
            for who, executor in (('alone', None), ('one', one), ('two', two)):
                progress(f'sweep {turn + 1} of {rounds}, {who}')
                began = perf_counter()
                tasks = len(design(plant, up_to=2, executor=executor).entries)
                spent[who].append(perf_counter() - began)
    seconds = {who: median(times) for who, times in spent.items()}
    group = f'sweep of {tasks} tasks, a network of {n} states; peer: the loop in one process'
    return [Row(group, 'sent to one process, a task', 'ms', 1e3 * seconds['one'] / tasks,
                1e3 * seconds['alone'] / tasks, bar=1.1),
            Row(group, 'two processes', 's', seconds['two'], seconds['alone'], bar=0.6),
            Row(group, 'the start of a process', 's', started, seconds['alone'])]
