"""
What a tick of the bank costs with tracking and rehearsal, beside the same design without.

Both banks take the same readings and lose the same sensor. In a tick each is asked as the engine
asks it: for an estimate and its deviation. In flight a free run goes on in ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import process_time

import numpy as np
from scipy.linalg import solve_continuous_are

from benchmark.bank import INPUTS, LATE, make_design, RATE, SIZES
from benchmark.row import Row
from vsensor_ros.bank import Bank
from vsensor_ros.observers import Design, Entry, Key, Tracking, VirtualSensor

GROUP = ('one tick of the bank with tracking and rehearsal, {}; '
         'peer: the same design without')
SITUATIONS = {'all healthy': 2.0, 'in flight': 2.0, 'as a sensor is lost': None}  # with bars
LOSSES = 4
WARM_UP = 250  # ticks
NOISE = 0.01  # standard deviation of a reading, and of what moves a state within 1 s
SLOWEST = 100  # one tick in so many is left out: the machine's


def make_tracked(design: Design) -> Design:
    """Let the channel of each virtual sensor correct it with the gain of its Kalman filter."""
    entries: dict[Key, Entry] = {}
    for key, v in design.entries.items():
        assert isinstance(v, VirtualSensor)
        W = NOISE**2 * np.eye(v.order)
        P = solve_continuous_are(v.N.T, v.Cv.T, W, np.array([[NOISE**2]]))
        entries[key] = replace(v, start=np.eye(v.order), tracking=Tracking(
            (v.channel,), P @ v.Cv.T / NOISE**2, v.Cv, v.Q, np.zeros((1, len(INPUTS))), P, W, 0.0,
            noise=np.array([NOISE])))
    return replace(design, entries=entries)


def measure(ticks: int, sizes: tuple[int, ...] = SIZES,
            progress: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Measure both in turns, tick by tick, so many healthy and in flight; compare means."""
    rows: dict[str, list[Row]] = {situation: [] for situation in SITUATIONS}
    for nonlinear in (False, True):
        for size in sizes:
            label = f'{size} virtual sensor{"s" * (size > 1)}, {"non" * nonlinear}linear'
            progress(f'tracking: {label}')
            spent = _ticks(make_design(size, nonlinear), max(1, ticks // LOSSES))
            for (situation, bar), (ours, peer) in zip(SITUATIONS.items(), spent):
                rows[situation].append(Row(
                    GROUP.format(situation), label, 'us', 1e6 * ours, 1e6 * peer, bar))
    return [row for of in rows.values() for row in of]


def _ticks(design: Design, ticks: int) -> list[tuple[float, float]]:
    """Return the mean CPU times (ours, peer) of ticks [s] in each situation."""
    names, served = design.sensors + INPUTS, design.virtual_sensors[-1]
    key = served.fault_set, served.channel
    spent: list[list[list[float]]] = [[] for _ in SITUATIONS]
    for _ in range(LOSSES):
        # anew each time: an independent run that was compared for long may serve at once
        banks = [Bank(make_tracked(design), RATE), Bank(design, RATE)]
        now = 0
        for times, count, lost in (([], WARM_UP, ()), (spent[0], ticks, ()),
                                   (spent[2], 1, key[0]), (spent[1], ticks, key[0])):
            for _ in range(count):
                now += banks[0].period
                values = (2.0 + np.sin(1e-9 * now + np.arange(len(names)))).tolist()
                said = list(zip(names, values))
                times.append([_tick(bank, said, now, lost, key) for bank in banks])
            if lost and count == 1 and not banks[0].run(*key):
                raise AssertionError(f'no free run serves of {len(design.virtual_sensors)}')
    means = [np.sort(times, axis=0)[:len(times) - len(times) // SLOWEST].mean(axis=0)
             for times in spent]
    return [(float(ours), float(peer)) for ours, peer in means]


def _tick(bank: Bank, said: list[tuple[str, float]], now: int, lost: tuple[str, ...],
          key: Key) -> float:
    """Return the CPU time of a tick [s]; others may be busy on this machine."""
    begin = process_time()
    for name, value in said:
        bank.take(name, now - LATE, value)
    bank.advance(now)
    bank.distrust(lost, now)
    bank.estimate(*key)
    bank.deviation(*key)
    return process_time() - begin
