"""
All losses of a recording, in parallel.

Each job plays the healthy machine itself, up to its last window, so that no engine travels between
processes. The jobs take windows one after the other: the first the most, because those of the last
begin when it has played all that was before.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Executor, FIRST_COMPLETED, wait
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple

import numpy as np

from vsensor_ros.engine import Setup
from vsensor_ros.recordings.dataset import Windows
from vsensor_ros.recordings.recording import Recording
from vsensor_ros.recordings.through_engine import Healthy, Loss, replay, Said

SLOWER = 5.0  # times that a second of a loss costs a healthy one

Progress = Callable[[int, int, str], None]
Heard = list[tuple[Loss, dict[str, Said]]]


class Case(NamedTuple):
    """Sensors that fail together, and how."""

    names: tuple[str, ...]
    kind: str


@dataclass(frozen=True)
class Trials:
    """What went out in all windows of all recordings, by case."""

    windows: Windows
    heard: Mapping[Case, Sequence[tuple[Recording, Loss, Mapping[str, Said]]]]
    healthy_seconds: float
    alarms: tuple[tuple[str, float, tuple[str, ...]], ...]  # recording, s, who was blamed wrongly


def losses_of(starts: Iterable[float], length: float, cases: Iterable[Case],
              sizes: Mapping[str, float], told: float | None) -> list[Loss]:
    """Return a loss for each case in each window."""
    cases = list(cases)
    return [Loss(case.names, float(start), float(start) + length, case.kind, sizes, told)
            for start in starts for case in cases]


def shares(starts: np.ndarray, jobs: int, lost: float) -> list[np.ndarray]:
    """
    Return the windows of each job, so that all take about the same time.

    starts: of the windows [s], in order. lost: seconds of losses in a window, over all cases.
    """
    low, high = 0.0, float(starts[-1]) + SLOWER * lost * len(starts) if len(starts) else 0.0
    for _ in range(50):
        middle = (low + high) / 2.0
        low, high = (low, middle) if len(_dealt(starts, middle, lost)) <= jobs else (middle, high)
    return _dealt(starts, high, lost)


def _dealt(starts: np.ndarray, budget: float, lost: float) -> list[np.ndarray]:
    """Deal windows to as many as it takes, when none may take longer than a budget."""
    found: list[np.ndarray] = []
    at = 0
    while at < len(starts):
        costs = starts[at:] + SLOWER * lost * np.arange(1, len(starts) - at + 1)
        taken = max(1, int((costs <= budget).sum()))
        found.append(starts[at:at + taken])
        at += taken
    return found


def run_trials(setup: Setup, recordings: Sequence[Recording], cases: Sequence[Case],
               windows: Windows, sizes: Mapping[str, float], told: float | None = 0.0,
               jobs: int = 1, executor: Executor | None = None,
               progress: Progress | None = None) -> Trials:
    """
    Lose the sensors of each case in each window of each recording.

    sizes: of faults, by sensor, see `fault`. told: s after a loss when isolation says so; None:
    nobody does, but the engine's own isolator. jobs: parts that the executor is given; without
    one all is done here. progress: is called with how many losses of how many are done.
    """
    lost = windows.length * len(cases)
    parts = [(recording, losses_of(part, windows.length, cases, sizes, told))
             for recording in recordings
             for part in shares(windows.starts(recording.seconds), max(
                 1, jobs if executor is not None else 1), lost)]
    total = sum(len(losses) for _, losses in parts)
    found: list[tuple[Recording, Heard, Healthy]] = []
    if executor is None:
        done = count(1)

        def tell(loss: Loss) -> None:
            if progress is not None:
                progress(next(done), total, f'{", ".join(loss.names)} at {loss.start:g} s')
        for recording, losses in parts:
            found.append((recording, *_part(setup, recording, losses, tell)))
    else:
        futures = {executor.submit(_part, setup, recording, losses): i
                   for i, (recording, losses) in enumerate(parts)}
        results: dict[int, tuple[Heard, Healthy]] = {}
        open_, finished = set(futures), 0
        while open_:
            if progress is not None:
                progress(finished, total, f'losses, {len(open_)} parts to go')
            over, open_ = wait(open_, return_when=FIRST_COMPLETED)
            for future in over:
                results[futures[future]] = future.result()
                finished += len(parts[futures[future]][1])
        found = [(recording, *results[i]) for i, (recording, _) in enumerate(parts)]
    heard: dict[Case, list[tuple[Recording, Loss, Mapping[str, Said]]]] = {c: [] for c in cases}
    for recording, part, _ in found:
        for loss, said in part:
            heard[Case(loss.names, loss.kind)].append((recording, loss, said))
    last = _last_of_each(found)
    return Trials(windows, heard, sum(healthy.until for _, healthy in last), tuple(
        (recording.name, at, names) for recording, healthy in last
        for at, names in healthy.alarms))


def _part(setup: Setup, recording: Recording, losses: Sequence[Loss],
          done: Callable[[Loss], object] | None = None) -> tuple[Heard, Healthy]:
    healthy = Healthy()
    return replay(setup, recording, losses, healthy, done), healthy


def _last_of_each(found: Sequence[tuple[Recording, Heard, Healthy]],
                  ) -> Collection[tuple[Recording, Healthy]]:
    """Return how the healthy machine went, from who went the farthest in each recording."""
    last: dict[int, tuple[Recording, Healthy]] = {}
    for recording, _, healthy in found:
        before = last.get(id(recording))
        if before is None or healthy.until > before[1].until:
            last[id(recording)] = recording, healthy
    return last.values()
