"""
Whether memory grows: bank and switch over 10^6 ticks, and the node as long as that takes.

The bank and the switch run in a process of their own, at stamps that are not waited for; every
FAULT ticks a sensor fails or recovers. The node runs meanwhile at 1 kHz, with faults, too. Both
are compared with themselves after the first tenth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
from pathlib import Path
from statistics import median
import sys
import time
from types import SimpleNamespace

from benchmark.bank import make_design
from benchmark.rig import Rig
from benchmark.row import Row
from vsensor_ros.bank import Bank
from vsensor_ros.engine import Switch
from vsensor_ros.lab.process import Failed

BAR = 1.005  # a page now and then is no growth
TICKS = 1_000_000
RATE = 1000.0  # Hz
FAULT = 5000  # ticks
PARTS = 100


@dataclass(frozen=True)
class Growth:
    """Resident memory [kB] at even distances."""

    ticks: float
    resident: list[int]

    @property
    def first(self) -> float:
        """After the first tenth."""
        tenth = max(1, len(self.resident) // 10)
        return median(self.resident[tenth:2 * tenth] or self.resident)

    @property
    def last(self) -> float:
        """At the end."""
        tenth = max(1, len(self.resident) // 10)
        return median(self.resident[-tenth:])


def step(ticks: int) -> Growth:
    """Run bank and switch in this process."""
    design = make_design(1, nonlinear=True)  # of three sensors, one can be replaced
    bank, switch = Bank(design, RATE), Switch.of(design)
    asked = SimpleNamespace(ready=bank.ready, converges=bank.converging, deviation=bank.deviation,
                            why_not=bank.why_not)
    resident = []
    for tick in range(ticks):
        now = (tick + 1) * bank.period
        if tick % FAULT == 0:
            failed = tick // FAULT % (1 + len(design.sensors))
            switch = switch.isolate(design.sensors[:failed][-1:], now)
            bank.distrust(switch.faulty)
        for i, name in enumerate((*design.sensors, *design.inputs)):
            bank.take(name, now, 2.0 + math.sin(1e-9 * now + i), now)
        bank.advance(now)
        decided = switch.decide(now, asked)
        if decided.faulty != switch.faulty:
            bank.distrust(decided.faulty)
        switch = decided
        bank.estimate(('y1',), 'y1')
        if (tick + 1) % (ticks // PARTS) == 0:
            resident.append(resident_kb('self'))
    return Growth(ticks, resident)


def measure(rig: Rig, ticks: int, progress: Callable[[str], None]) -> tuple[Growth, Growth]:
    """Return how bank and switch grew, and the node that ran as long."""
    resident: list[int] = []
    faulty = False
    with rig.replacer() as node, \
            rig.run('bank and switch', ['benchmark.memory', str(ticks)], ends=True) as bank:
        began = time.monotonic()
        while bank.popen.poll() is None:
            progress(f'memory: {time.monotonic() - began:.0f} s')
            faulty = not faulty
            rig.isolate(0, faulty)
            rig.listen(0.5)
            resident.append(resident_kb(node.popen.pid))
        said = bank.log.read_text(errors='replace').strip().splitlines()
        if bank.popen.returncode or not said:
            raise Failed(f'bank and switch ended with {bank.popen.returncode}: {said[-1:]}')
    alone = Growth(ticks, [int(word) for word in said[-1].split()])
    return alone, Growth((time.monotonic() - began) * rig.rate, resident)


def resident_kb(process: int | str) -> int:
    """Return the resident memory of a process [kB]."""
    for line in Path(f'/proc/{process}/status').read_text(encoding='ascii').splitlines():
        if line.startswith('VmRSS:'):
            return int(line.split()[1])
    raise Failed(f'process {process} has ended')


def rows(alone: Growth, node: Growth) -> list[Row]:
    """Compare the end with the end of the first tenth."""
    group = ('resident memory at the end of all ticks, faults among them; '
             'peer: the same process after the first tenth')
    return [Row(group, f'{what}, {growth.ticks:.2g} ticks', 'kB', growth.last, growth.first, BAR)
            for what, growth in (('bank and switch', alone), (f'node at {RATE:g} Hz', node))]


if __name__ == '__main__':
    print(*step(int(sys.argv[1])).resident)
