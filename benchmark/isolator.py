"""
The isolator on three plants, 100 Hz, parameters 2 % wrong; truth from the simulation.

Beside it a peer, an extended Kalman filter of all states with a 5 sigma gate. Seeds above 1000 are
judged; what was chosen was chosen on those below.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import sys
import time

import numpy as np

from benchmark.isolator_plants import Case, cases
from benchmark.isolator_run import Faults, Fleet, Outcome
from vsensor_ros.isolator.detector import ENOUGH

ERROR = 0.02
SEED = 1001
# kind, least and largest size (sigma, sigma/s, times), s that it is watched, within which s
CAMPAIGNS = (('bias', 8.0, 30.0, 2.0, 0.2), ('bias', 5.0, 8.0, 2.5, 1.0),
             ('bias', 3.0, 5.0, 2.5, 1.0), ('drift', 0.3, 3.0, 40.0, 40.0),
             ('noise', 5.0, 5.0, 2.5, 1.0), ('freeze', 1.0, 1.0, 2.0, 0.2))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures beside their bars; return 0."""
    parser = argparse.ArgumentParser(prog='python -m benchmark.isolator', description=__doc__)
    parser.add_argument('--quick', action='store_true', help='a tenth of it, in minutes')
    parser.add_argument('--plants', nargs='+', default=[c.name for c in cases()])
    parser.add_argument('--machines', type=int, help='of each plant, at once (100, quick: 40)')
    parser.add_argument('--hours', type=float, help='healthy hours of each plant (100, quick: 4)')
    parser.add_argument('--rounds', type=int, help='of each campaign (6, quick: 1)')
    parser.add_argument('--seed', type=int, default=SEED)
    given = parser.parse_args(arguments)
    machines = given.machines or (40 if given.quick else 100)
    hours = given.hours if given.hours is not None else 4.0 if given.quick else 100.0
    rounds = given.rounds or (1 if given.quick else 6)
    for case in cases():
        if case.name in given.plants:
            judge(case, machines, hours, rounds, given.seed)
    return 0


def judge(case: Case, machines: int, hours: float, rounds: int, seed: int) -> None:
    """Let machines of a plant learn; then healthy hours, faults, and three times the motion."""
    began = time.process_time()
    fleet = Fleet(case, machines, ERROR, seed)
    told, _ = fleet.healthy(ENOUGH + 60.0, compare=False)
    say(f'{case.name}, {machines} machines: {len(told)} alarms while learning')
    learnt = fleet.copy()
    told, peer = fleet.healthy(3600.0 * hours / machines)
    say(f'  healthy {hours:g} h: {counted(told)}; {len(told) / hours * 24:.2f} a day  (bar: 2); '
        f'peer: {counted(peer)}')
    fleet = learnt.copy()
    fleet.machines.motion = 3.0
    told, peer = fleet.healthy(3600.0 * min(4.0, hours) / machines)
    say(f'  motion tripled, {min(4.0, hours):g} h: {counted(told)}  (bar: 5 in 4 h); '
        f'peer: {counted(peer)}')
    random = np.random.default_rng(seed)
    sensors = [fleet.sensors.index(name) for name in case.isolable]
    for kind, least, largest, seconds, within in CAMPAIGNS:
        outcomes = []
        for _ in range(rounds):
            size = random.uniform(least, largest, machines)
            sensor = random.choice(sensors, machines)
            if kind in ('bias', 'drift'):
                size = size * case.noise[sensor] * random.choice([-1.0, 1.0], machines)
            faults = Faults(sensor, kind, random.uniform(0.2, 0.5, machines), size)
            outcomes.append((faults, learnt.copy().campaign(faults, seconds)))
        say(f'  {kind} {least:g} to {largest:g}: {told_of(case, outcomes, sensors, within)}')
    say(f'  {time.process_time() - began:.0f} s of computing')


def counted(told: Sequence[tuple[float, int, str]]) -> str:
    """Return how many alarms were of which state."""
    states = [state for _, _, state in told]
    machines = len({machine for _, machine, _ in told})
    return ', '.join([*(f'{states.count(state)} {state}' for state in sorted(set(states))),
                      f'on {machines} machines']) if told else 'none'


def told_of(case: Case, outcomes: Sequence[tuple[Faults, Outcome]], sensors: Sequence[int],
            within: float) -> str:
    """Return the figures of a campaign, by sensor."""
    parts = []
    for j in sensors:
        ours, late, peer, peer_wrong, times, caught = [], [], [], [], [], []
        for faults, outcome in outcomes:
            mine = faults.sensor == j
            right = outcome.sensor == j
            ours += (right & (outcome.time <= within))[mine].tolist()
            late += right[mine].tolist()
            times += np.where(right, outcome.time, np.inf)[mine].tolist()
            peer += ((outcome.peer_sensor == j) & (outcome.peer_time <= within))[mine].tolist()
            peer_wrong += ((outcome.peer_sensor >= 0) & (outcome.peer_sensor != j))[mine].tolist()
            caught += np.abs(faults.size * outcome.time / case.noise[j])[mine & right].tolist()
        at = np.quantile(times, [0.5, 0.9], method='lower')
        sigma = f', at {np.median(caught):.1f} sigma' if faults.kind == 'drift' and caught else ''
        parts.append(
            f'{case.plant.sensors[j]} {100 * np.mean(ours):.1f} % within {within:g} s '
            f'(ever {100 * np.mean(late):.1f}), p50 {at[0]:.2f} p90 {at[1]:.2f} s{sigma}; '
            f'peer {100 * np.mean(peer):.0f} %, wrong {100 * np.mean(peer_wrong):.0f} %')
    wrong = sum(outcome.wrong for _, outcome in outcomes)
    believed = sum(outcome.believed for _, outcome in outcomes)
    count = sum(len(outcome.sensor) for _, outcome in outcomes)
    return '\n      '.join([f'{count} faults, {wrong} wrong, {believed} believed while faulty',
                            *parts])


def say(line: str) -> None:
    """Print a line at once."""
    print(line, flush=True)


if __name__ == '__main__':
    sys.exit(main())
