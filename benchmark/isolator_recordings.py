"""
The isolator on recordings of real machines: the first half is learnt, the second is judged.

    VSENSOR_DATA=FOLDER python -m benchmark.isolator_recordings [--trials N]

Of each channel that varies: whether it is taken for stuck, and how soon it is when it freezes. Of
the temperature board, whose two sensors share their only residual: alarms, and biases. Minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
import os
from pathlib import Path
import sys

import numpy as np

from benchmark.recordings import ARM, CONFIG, DRIVE
from vsensor_ros import design, load_plant
from vsensor_ros.engine.own_isolator import OwnIsolator
from vsensor_ros.isolator import Settings
from vsensor_ros.isolator.channels import Bools, Channels
from vsensor_ros.isolator.watch import batch_of, Floats
from vsensor_ros.recordings import settings
from vsensor_ros.simulate.recording import load_columns
from vsensor_ros.simulate.table import read_table

BOARD = 'tclab/tclab_kuntz_rawlings_2022.mat'
BOARD_COLUMNS = {f'{name}{i + 1}': f'data.{of}[{i}]'
                 for name, of in (('T', 'ydat'), ('Q', 'udat')) for i in range(2)}
LAG = 0.05  # s over which the estimates of channels are means: they follow, and are late
BEFORE = 256  # samples of a channel before it freezes
SOON = 0.2  # s
WATCHED = 120.0  # s after a bias


@dataclass(frozen=True)
class Logged:
    """What all channels of a recording said that vary: values (T, c), one row a period [s]."""

    label: str
    names: tuple[str, ...]
    values: Floats
    period: float

    @classmethod
    def of(cls, label: str, columns: dict[str, Floats], period: float) -> Logged:
        """Make one of the columns that vary."""
        varying = {name: column for name, column in columns.items() if np.ptp(column) > 0.0}
        return cls(label, tuple(varying), np.stack(list(varying.values()), axis=1), period)

    def estimates(self) -> Floats:
        """Return means over the lag up to each sample."""
        count = max(3, round(LAG / self.period))
        padded = np.vstack([np.repeat(self.values[:1], count, axis=0), self.values])
        sums = np.cumsum(padded, axis=0)
        return (sums[count:] - sums[:-count]) / count

    def learnt(self) -> tuple[Channels, Bools]:
        """Let channels learn the first half; return them, and which were ever taken for stuck."""
        channels = Channels(self.period, batch_of(self.period), len(self.names))
        return channels, _feed(channels, self.values, self.estimates(),
                               range(len(self.values) // 2), True)[0]


def logs(data: Path) -> Iterator[Logged]:
    """Yield all recordings, each by the clock of its channels."""
    yield Logged.of('drive', load_columns(data / DRIVE, {
        name: name for name in ('qm', 'qg', 'vir')}), 0.001)
    yield Logged.of('board', load_columns(data / BOARD, BOARD_COLUMNS), 1.0)
    for number in range(5):
        found = read_table(data / ARM.format(number))
        times = next(iter(found.values())).time
        yield Logged.of(f'arm {number}', {name: s.value for name, s in found.items()},
                        float(np.median(np.diff(times))))


def _feed(channels: Channels, values: Floats, estimates: Floats, rows: range, learn: bool,
          ) -> tuple[Bools, Floats]:
    """Go through samples; return which channels were ever stuck, and since which sample."""
    first = np.full(values.shape[1], np.inf)
    for start in range(rows.start, rows.stop - channels.batch + 1, channels.batch):
        part = slice(start, start + channels.batch)
        channels.step(values[part], values[part] - estimates[part], estimates[part], learn)
        stuck = channels.stuck(estimates[part][-1])
        first[stuck & np.isinf(first)] = part.stop - rows.start
    return np.isfinite(first), first


def falsely_stuck(log: Logged) -> Bools:
    """Tell which channels are taken for stuck anywhere."""
    channels, learning = log.learnt()
    rows = range(len(log.values) // 2, len(log.values))
    return learning | _feed(channels, log.values, log.estimates(), rows, False)[0]


def frozen(log: Logged, trials: int, seconds: float = 2.0) -> Floats:
    """Freeze all channels at random times of the second half; return delays [s] (trials, c)."""
    learnt, _ = log.learnt()
    learnt.restart()
    half, random, delays = len(log.values) // 2, np.random.default_rng(1001), []
    count = max(round(seconds / log.period), 40)
    estimates = log.estimates()
    for start in random.integers(half, len(log.values) - BEFORE - count, trials).tolist():
        channels, at, end = deepcopy(learnt), start + BEFORE, start + BEFORE + count
        _feed(channels, log.values, estimates, range(start, at), False)
        values = log.values.copy()
        values[at:end] = values[at - 1]
        delays.append(_feed(channels, values, estimates, range(at, end), False)[1])
    return np.array(delays) * log.period


class Board:
    """The temperature board beside the isolator of its design."""

    def __init__(self, data: Path) -> None:
        columns = load_columns(data / BOARD, BOARD_COLUMNS)
        self.names, self.values = tuple(columns), np.stack(list(columns.values()), axis=1)
        made = design(load_plant(CONFIG / 'tclab' / 'plant.yaml'), isolate=True)
        self.own = OwnIsolator(replace(settings(made, 1.0, max_age=20.0), isolator=Settings()))
        self.half = len(self.values) // 2
        self.states: dict[str, int] = {}

    def go_on(self, rows: range, bias: dict[str, float] | None = None) -> None:
        """Hear what was recorded, one row a second; bias: added to some channels."""
        self.states = {}
        for k in rows:
            now = (k + 1) * 10**9
            for name, value in zip(self.names, self.values[k].tolist()):
                self.own.take(name, now, value + (bias or {}).get(name, 0.0), now)
            self.own.step(now)
            self.states.setdefault(self.own.verdict.state, k)


def biases(board: Board, trials: int, seed: int = 1001) -> tuple[list[float], int]:
    """Let one sensor err by 2 to 5 degC; return delays [s] until it is suspected, and blames."""
    random, delays, blamed = np.random.default_rng(seed), [], 0
    board = deepcopy(board)
    starts = np.sort(random.integers(board.half + 60, len(board.values) - WATCHED, trials))
    heard = board.half
    for start in starts.tolist():
        board.go_on(range(heard, start))
        heard, ill = start, deepcopy(board)
        size = float(random.uniform(2.0, 5.0) * random.choice([-1, 1]))
        ill.go_on(range(start, start + round(WATCHED)), {str(random.choice(['T1', 'T2'])): size})
        found = ill.states.get('suspected')
        delays.append(np.inf if found is None else found - start + 1.0)
        blamed += bool({'isolated', 'model'} & set(ill.states))
    return delays, blamed


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures; return 0, 2 without recordings."""
    parser = argparse.ArgumentParser(prog='python -m benchmark.isolator_recordings')
    parser.add_argument('--trials', type=int, default=100, help='freezes, biases (100)')
    given = parser.parse_args(arguments)
    folder = os.environ.get('VSENSOR_DATA')
    if not folder:
        print('benchmark.isolator_recordings: set VSENSOR_DATA to the folder with the recordings',
              file=sys.stderr)
        return 2
    for log in logs(Path(folder)):
        stuck, delays = falsely_stuck(log), frozen(log, given.trials)
        for name, false, delay in zip(log.names, stuck, delays.T):
            found = delay[np.isfinite(delay)]
            print(f'{log.label} {name}: {"FALSELY" if false else "never"} stuck; frozen, found '
                  f'{100 * np.mean(delay <= SOON):.0f} % within {SOON:g} s, '
                  f'{100 * len(found) / len(delay):.0f} % ever, median '
                  f'{np.median(found) if len(found) else np.inf:.3g} s', flush=True)
    board = Board(Path(folder))
    board.go_on(range(board.half))
    healthy = deepcopy(board)
    healthy.go_on(range(board.half, len(board.values)))
    print(f'board, second half: {healthy.states}')
    delays, blamed = biases(board, given.trials)
    print(f'board, bias of 2 to 5 degC: found {100 * np.mean(np.isfinite(delays)):.1f} %, median '
          f'{np.median(delays):.0f} s; one blamed, or the model: {blamed} of {len(delays)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
