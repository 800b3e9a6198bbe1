"""
What is in a recording: of each channel its rate, its stamps, its values, and what is suspicious.

Recordings may be huge: they go by once, piece by piece, and of each channel some counts and a
sample are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from zlib import crc32

import numpy as np

from vsensor_ros.reason import add_sentences, Reason

MOST = 2**17  # intervals, or values, that are kept of a channel
GAP = 5.0  # times the usual interval from which on it is a gap
COARSE = 1000  # steps in the range of a channel below which its steps are worth a word
HELD = 0.5  # share of values that are as the one before, from which on that is
LATE = 1.0  # s between the clocks of stamps and recording that are worth a word
TURNS = (math.tau, 360.0, 180.0, math.pi)  # by which angles wrap

add_sentences({
    'constant': 'never changes',
    'coarse': 'in steps of {step:.4g}, {count} over its range',
    'mostly held': 'most values are as the one before: it changes {rate:.3g} times a second',
    'same as another': 'says the same as {name}',
    'wraps': 'jumps by a turn ({turn:.4g}), {count} in all: declare wrap, or unwrap it',
    'not numbers': '{count} of its values NaN or infinite',
    'stamps back': '{count} of its stamps older than the one before',
    'stamps twice': '{count} of its stamps those of the one before',
    'gaps': 'gaps: {count}, the longest {seconds:.3g} s',
    'clocks apart': 'stamps are {seconds:.3g} s behind the clock of the recording',
    'nothing said': 'nothing was heard',
})


@dataclass(frozen=True)
class Channel:
    """What was found of one channel; NaN where it is not known. Times are in s."""

    name: str
    unit: str
    count: int
    rate: float  # Hz, of most of the time
    gap: float  # the longest interval
    jitter: float  # 99 % of the intervals are within so much of the usual
    late: float  # by how much the stamps are older than the clock of the recording, median
    late_spread: float  # from the 1st to the 99th percentile of that
    low: float
    high: float
    suspicions: tuple[Reason, ...]
    digest: int = 0  # of the first values: channels that say the same have the same


@dataclass(frozen=True)
class Survey:
    """What was found in a recording."""

    name: str
    form: str  # ROS 2, CSV, ..
    begin: int  # ns, its first stamp
    seconds: float
    channels: tuple[Channel, ...]
    notes: tuple[str, ...] = ()  # what was left out


class Sample:
    """Every so manyth number of a stream: evenly over all of it, and never more than MOST."""

    def __init__(self) -> None:
        self._kept: list[np.ndarray] = []
        self._count, self._next, self._stride = 0, 0, 1

    def take(self, values: np.ndarray) -> None:
        """Take the next numbers."""
        self._kept.append(values[self._next::self._stride])
        self._next = (self._next - len(values)) % self._stride
        self._count += len(self._kept[-1])
        while self._count > MOST:
            kept = np.concatenate(self._kept)
            self._next += self._stride * (len(kept) % 2)
            self._kept, self._stride = [kept[::2]], 2 * self._stride
            self._count = len(self._kept[0])

    @property
    def values(self) -> np.ndarray:
        """The numbers that were kept."""
        return np.concatenate([np.zeros(0), *self._kept])


class ClockTally:
    """The stamps of a channel, or of a topic [ns]."""

    def __init__(self) -> None:
        self.count = self.back = self.twice = 0
        self.first = self.last = 0
        self.longest = 0
        self._intervals, self._late = Sample(), Sample()

    def take(self, stamps: np.ndarray, recorded: np.ndarray | None = None) -> None:
        """Take the next stamps, and when they were recorded."""
        if not len(stamps):
            return
        steps = np.diff(stamps, prepend=self.last if self.count else stamps[0])
        if not self.count:
            steps = steps[1:]
            self.first = int(stamps[0])
        self.last, self.count = int(stamps[-1]), self.count + len(stamps)
        self.back += int((steps < 0).sum())
        self.twice += int((steps == 0).sum())
        forward = steps[steps > 0]
        self.longest = max(self.longest, int(forward.max(initial=0)))
        self._intervals.take(forward * 1e-9)
        if recorded is not None:
            self._late.take((recorded - stamps) * 1e-9)

    def fill(self, channel: Channel) -> Channel:
        """Return a channel with what is known of its stamps."""
        found: list[Reason] = []
        steps, late = self._intervals.values, self._late.values
        usual = float(np.median(steps)) if len(steps) else math.nan
        jitter = float(np.percentile(np.abs(steps - usual), 99)) if len(steps) else math.nan
        if self.back:
            found.append(Reason.of('stamps back', count=self.back))
        if self.twice:
            found.append(Reason.of('stamps twice', count=self.twice))
        gap = self.longest * 1e-9
        gaps = int((steps > GAP * usual).sum()) if len(steps) else 0
        if gap > GAP * usual:
            found.append(Reason.of('gaps', count=max(gaps, 1), seconds=gap))
        middle = spread = math.nan
        if len(late):
            low, middle, high = np.percentile(late, (1, 50, 99)).tolist()
            spread = high - low
            if abs(middle) > LATE:
                found.append(Reason.of('clocks apart', seconds=middle))
        return replace(channel, count=self.count, rate=1.0 / usual if usual else math.nan, gap=gap,
                       jitter=jitter, late=middle, late_spread=spread,
                       suspicions=(*channel.suspicions, *found))


class ValueTally:
    """The values of a channel."""

    def __init__(self) -> None:
        self.count = self.strange = self.same = 0
        self.low, self.high = math.inf, -math.inf
        self._before = math.nan
        self._first: list[np.ndarray] = []  # as they came, so many at most
        self._room = MOST

    def take(self, values: np.ndarray) -> None:
        """Take the next values."""
        there = np.isfinite(values)
        self.strange += int((~there).sum())
        found = values[there]
        if not len(found):
            return
        steps = np.diff(found, prepend=self._before)
        if math.isnan(self._before):
            steps = steps[1:]
        self.same += int((steps == 0.0).sum())
        self.count += len(found)
        self._before = float(found[-1])
        self.low, self.high = min(self.low, float(found.min())), max(self.high, float(found.max()))
        self._first.append(found[:self._room])
        self._room -= len(self._first[-1])

    def fill(self, channel: Channel, rate: float) -> Channel:
        """Return a channel with what is known of its values; rate: of its messages [Hz]."""
        found: list[Reason] = []
        first = np.concatenate([np.zeros(0), *self._first])
        if self.strange:
            found.append(Reason.of('not numbers', count=self.strange))
        if not self.count:
            return replace(channel, suspicions=(
                *channel.suspicions, *(found or [Reason.of('nothing said')])))
        if self.low == self.high:
            found.append(Reason.of('constant'))
        else:
            if self.same > HELD * self.count and math.isfinite(rate):
                found.append(Reason.of('mostly held', rate=rate * (1.0 - self.same / self.count)))
            found += _coarse(first) + _wraps(first)
        return replace(channel, low=self.low, high=self.high, digest=crc32(first.tobytes()),
                       suspicions=(*channel.suspicions, *found))


def _coarse(values: np.ndarray) -> list[Reason]:
    """Find out whether values come in few even steps."""
    levels = np.unique(values)
    if not 2 < len(levels) <= min(COARSE, len(values) / 4):
        return []
    steps = np.diff(levels)
    step, whole = float(steps.min()), np.round(steps / steps.min())
    count = round((levels[-1] - levels[0]) / step)
    if count > COARSE or not np.allclose(steps, whole * step, rtol=0.0, atol=0.05 * step):
        return []
    return [Reason.of('coarse', step=step, count=count)]


def _wraps(values: np.ndarray) -> list[Reason]:
    """Find out whether an angle jumps by whole turns from one end of its range to the other."""
    steps = np.abs(np.diff(values))
    if not len(steps):
        return []
    span = float(values.max() - values.min())
    for turn in TURNS:
        jumps = steps > 0.8 * turn
        if jumps.any() and abs(span - turn) < 0.1 * turn and jumps.mean() < 0.1 and \
                steps[~jumps].max(initial=0.0) < 0.5 * turn:
            return [Reason.of('wraps', turn=turn, count=int(jumps.sum()))]
    return []


def nothing_of(name: str, unit: str = '') -> Channel:
    """Return a channel of which nothing is known yet."""
    nan = math.nan
    return Channel(name, unit, 0, nan, nan, nan, nan, nan, nan, nan, ())


def with_copies(channels: Sequence[Channel]) -> tuple[Channel, ...]:
    """Return the channels, those that say the same as one before them being told of it."""
    before: dict[tuple[int, int, float, float], str] = {}
    found = []
    for c in channels:
        name = before.setdefault((c.digest, c.count, c.low, c.high), c.name)
        constant = not c.low < c.high
        found.append(c if name == c.name or constant else replace(
            c, suspicions=(*c.suspicions, Reason.of('same as another', name=name))))
    return tuple(found)
