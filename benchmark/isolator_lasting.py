"""
The isolator beside faults that last: two at a time, and who is believed again.

    python -m benchmark.isolator_lasting [--plants servo tank drive] [--machines N] [--seed S]

Each machine has an isolator of its own, as on the machine, with `recovery: return`. 100 Hz,
parameters 2 % wrong, six minutes of learning. Seeds above 1000 are judged. Minutes of each plant.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from copy import deepcopy
import sys

import numpy as np
from numpy.typing import NDArray

from benchmark.isolator import ERROR, say, SEED
from benchmark.isolator_plants import bank_of, Case, cases, Floats, Machines, Observers, PERIOD
from benchmark.isolator_run import Faults
from vsensor_ros.isolator import Isolator, Settings, Verdict
from vsensor_ros.isolator.detector import ENOUGH

# kind: least and largest size (sigma, sigma/s, times)
KINDS = {'bias': (8.0, 30.0), 'drift': (0.3, 3.0), 'noise': (5.0, 5.0), 'freeze': (1.0, 1.0)}
SMALL = 3.0, 8.0  # sigma, of a bias that the model's error may hide for a while
FIRST = 1.0  # s, when a fault begins
SECOND = 20.0  # s, up to which a second one does
LASTS = 120.0  # s
ENDS = 30.0  # s, when a fault ends that does
AFTER = 60.0  # s, within which who came back has to be believed


class Watched:
    """Machines of a case, and what the isolator of each says."""

    def __init__(self, case: Case, count: int, seed: int) -> None:
        self.case, self.count, self.sensors = case, count, case.plant.sensors
        checks, observers = bank_of(case)
        self.machines = Machines(case, count, ERROR, seed)
        self.observers = Observers(observers, self.sensors, count)
        self.observers.start(self.machines.x)
        self.isolators = [Isolator(Settings(recovery='return'), self.sensors, checks, PERIOD)
                          for _ in range(count)]
        self.said = np.zeros((count, len(self.sensors)))
        self.random = np.random.default_rng(seed + 10**6)
        self.ticks = 0

    def tick(self, faults: Sequence[Faults] = (), time: float = 0.0) -> list[Verdict]:
        """Go on by a period."""
        said, commands = self.machines.step()
        for fault in faults:
            said = fault.put(said, self.said, time, self.case.noise,
                             self.random.standard_normal(self.count))
        self.said = said
        estimates = self.observers.step(said, commands)
        self.ticks += 1
        return [isolator.step(self.ticks * round(1e9 * PERIOD), *row)
                for isolator, *row in zip(self.isolators, said, estimates)]

    def faults(self, kind: str, sensor: NDArray[np.int64], start: Floats,
               random: np.random.Generator, sizes: tuple[float, float], end: float = np.inf,
               ) -> Faults:
        """Return one of a kind in each machine, of random size."""
        size = random.uniform(*sizes, self.count)
        if kind in ('bias', 'drift'):
            size = size * self.case.noise[sensor] * random.choice([-1.0, 1.0], self.count)
        return Faults(sensor, kind, start, size, end)


def two(learnt: Watched, kinds: Sequence[str], random: np.random.Generator) -> str:
    """Let a second sensor fail during the fault of a first; return what was found."""
    case, count = learnt.case, learnt.count
    sensors = np.array([case.plant.sensors.index(name) for name in case.isolable])
    pairs = np.array([random.permutation(sensors)[:2] for _ in range(count)])
    watched = deepcopy(learnt)
    faults = [watched.faults(kinds[0], pairs[:, 0], np.full(count, FIRST), random,
                             KINDS[kinds[0]]),
              watched.faults(kinds[1], pairs[:, 1], random.uniform(5.0, SECOND, count), random,
                             KINDS[kinds[1]])]
    named = [{case.plant.sensors[j] for j in pair} for pair in pairs]
    found, wrong = np.full(count, np.inf), np.zeros(count, dtype=bool)
    for k in range(round(2 * (SECOND + FIRST) / PERIOD)):
        now = k * PERIOD
        for m, verdict in enumerate(watched.tick(faults, now)):
            if verdict.faults:
                blamed = {fault.sensor for fault in verdict.faults}
                guilty = named[m] if now >= faults[1].start[m] else {
                    case.plant.sensors[pairs[m, 0]]}
                wrong[m] |= bool(blamed - guilty)
                if blamed == named[m]:
                    found[m] = min(found[m], now - faults[1].start[m])
    return (f'{kinds[0]}, then {kinds[1]}: pair found {100 * np.mean(np.isfinite(found)):.0f} %, '
            f'within 1 s {100 * np.mean(found <= 1.0):.0f} %, a healthy one blamed {wrong.sum()} '
            f'of {count}')


def back(learnt: Watched, kind: str, sizes: tuple[float, float], random: np.random.Generator,
         ) -> str:
    """Let a fault last, and another time end; return who was believed again."""
    case, count = learnt.case, learnt.count
    sensors = [case.plant.sensors.index(name) for name in case.isolable]
    parts = []
    for ends in (np.inf, ENDS):
        watched = deepcopy(learnt)
        fault = watched.faults(kind, random.choice(sensors, count), np.full(count, FIRST), random,
                               sizes, ends)
        blamed, found, believed = (np.zeros(count, dtype=bool) for _ in range(3))
        early, withdrawn = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        at = np.full(count, np.inf)
        for k in range(round((LASTS if ends == np.inf else ENDS + AFTER) / PERIOD)):
            now = k * PERIOD
            for m, verdict in enumerate(watched.tick([fault], now)):
                said = case.plant.sensors[fault.sensor[m]] in verdict.faulty
                if blamed[m] and not said and now < ends:
                    (early if verdict.state == 'healthy' else withdrawn)[m] = True
                elif blamed[m] and not said and not early[m]:
                    believed[m], at[m] = True, min(at[m], now - ends)
                blamed[m] = said
                found[m] |= said and now < ends
        if ends == np.inf:
            parts.append(f'{kind} {sizes[0]:g} to {sizes[1]:g}: found {found.sum()} of {count}, '
                         f'believed while faulty {100 * np.mean(early[found]):.1f} %, '
                         f'withdrawn {withdrawn.sum()}')
        else:
            came = found & ~early
            parts.append(f'came back {came.sum()}, believed {100 * np.mean(believed[came]):.0f} %'
                         + (f' after {np.median(at[believed]):.1f} s' if believed.any() else ''))
    return '; '.join(parts)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures; return 0."""
    parser = argparse.ArgumentParser(prog='python -m benchmark.isolator_lasting')
    parser.add_argument('--plants', nargs='+', default=[c.name for c in cases()])
    parser.add_argument('--machines', type=int, default=40, help='of each plant (40)')
    parser.add_argument('--seed', type=int, default=SEED)
    given = parser.parse_args(arguments)
    for case in cases():
        if case.name not in given.plants:
            continue
        learnt, random = Watched(case, given.machines, given.seed), np.random.default_rng(
            given.seed)
        for _ in range(round((ENOUGH + 60.0) / PERIOD)):
            learnt.tick()
        say(f'{case.name}, {given.machines} machines')
        for kinds in (('bias', 'bias'), ('drift', 'bias'), ('bias', 'drift'), ('freeze', 'noise'),
                      ('noise', 'freeze')):
            say(f'  {two(learnt, kinds, random)}')
        for kind, sizes in (('bias', SMALL), *KINDS.items()):
            say(f'  {back(learnt, kind, sizes, random)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
