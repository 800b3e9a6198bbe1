"""What every sensor and command has said so far, and which of them is believed."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
import math
from types import MappingProxyType

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank.angle import Angle, samples_of
from vsensor_ros.bank.commands import Command, End
from vsensor_ros.bank.readings import BACKWARDS, Curved, Samples, Seen
from vsensor_ros.functions.curve import Curve
from vsensor_ros.observers import Told
from vsensor_ros.reason import Reason

LARGEST = 1e100  # a number beyond it is as good as infinite
NOT_FINITE = Reason.of('not finite')
ISOLATED = Reason.of('isolated')  # not used, but kept apart
AHEAD = Reason.of('ahead of the clock')
_NOTHING = np.zeros(0)
# ns that a stamp may lie ahead: clocks of two machines differ by milliseconds, and that of a
# simulation comes in steps. For so long one bad stamp shuts out the good ones after it
MOST_AHEAD = 100_000_000


class Inputs:
    """
    Samples of L sensors and m commands, all times in ns.

    `ages`: the max_age of each sensor. `Cu` (L, m): what is taken out of a reading, None: nothing.
    `held`: whether somebody asks for the commands that hold at a time. `ends`: of commands that do
    not hold for ever, with a max_age of at least `least`. `wrap`: of each angle the sensors that
    wrap; `curves`: of sensors, what they show of their linear readings; see `Contents`. `shifts`:
    of stamps, by name; a command's lie ahead by so much. `wants_ages`: whether somebody asks how
    old readings are.
    """

    def __init__(self, ages: Mapping[str, int], commands: Sequence[str], Cu: np.ndarray | None,
                 held: bool, ends: Mapping[str, End], least: int,
                 wrap: Sequence[Mapping[str, float]] = (),
                 curves: Mapping[str, Curve] = MappingProxyType({}),
                 shifts: Mapping[str, int] = MappingProxyType({}),
                 wants_ages: bool = False) -> None:
        self.ages, self.commands, self._wants_held = ages, commands, held
        self._wants_ages = wants_ages
        self._ends, self._least = dict(ends), least
        self.oldest = max(ages.values(), default=0)
        self._Cu = np.zeros((len(ages), len(commands))) if Cu is None else Cu
        self.everything: np.ndarray = np.ones(len(ages) + len(commands), dtype=bool)
        self._there: np.ndarray = self.everything  # the last that was not everything
        self.distrusted: frozenset[str] = frozenset()
        self._wrap, self._curves, self._shifts = wrap, curves, shifts
        self.angles = {name: Angle(abs(turn)) for turns in wrap for name, turn in turns.items()}
        self._floors: dict[str, float] = {}  # by sensor: up to this stamp it is not believed
        self.reset()

    def reset(self) -> None:
        """Forget everything but who is distrusted, and up to which stamp."""
        held = {name: Command(self._ends.get(name), self._least) for name in self.commands}
        samples: dict[str, Samples] = {**{name: Samples() for name in self.ages}, **held}
        for turns in self._wrap:
            samples |= samples_of(turns, self.angles, self.ages, self._curves)
        for name, curve in self._curves.items():
            if name not in self.angles:
                beside = [(gain, held[u]) for u, gain in curve.beside.items()]
                samples[name] = Curved(curve, beside)
        self.samples, self._held = samples, held
        seen: list[Seen] = [[(float(gain), held[name])
                             for gain, name in zip(row, self.commands) if gain]
                            for row in self._Cu]
        self._readings = [(samples[name], age, gains)
                          for (name, age), gains in zip(self.ages.items(), seen)]
        self._stoppable = [(i, command) for i, command in enumerate(held.values(), len(self.ages))
                           if command.may_stop]
        # by command: the readings that see it directly
        self._seers = {name: [r[0] for r, gain in zip(self._readings, column) if gain]
                       for name, column in zip(self.commands, self._Cu.T)}
        self._heard: dict[str, int] = {}  # by sensor: its last stamp, isolated or not
        # readings of sensors that are or were isolated: nothing is computed from them
        self._apart: dict[str, Samples] = {}

    def take(self, name: str, stamp: int, value: float, latest: float) -> int | Reason:
        """
        Accept a sample whose stamp is at most its max_age, and 0.1 s, after the latest time.

        Return the first time at which something has a new value, or why it was not accepted.
        """
        age = self.ages.get(name)
        if age is None:
            return self._take_command(name, stamp, value, latest)
        samples = self.samples[name]
        if not -LARGEST < value < LARGEST:
            return NOT_FINITE
        if stamp > latest + min(age, MOST_AHEAD):
            return AHEAD
        if self._floors and stamp <= self._floors.get(name, -math.inf):
            self._heard[name] = max(stamp, self._heard.get(name, stamp))
            if name not in self._apart:
                self._apart[name] = samples.apart()
            self._apart[name].add(stamp, value)
            return ISOLATED
        last = samples.stamps[-1] if samples.stamps else None
        reason = samples.add(stamp, value)
        if reason is not None:
            return reason
        self._heard[name] = stamp
        return stamp if last is None or stamp - last > age else last + 1

    def _take_command(self, name: str, stamp: int, value: float, latest: float) -> int | Reason:
        command, reason = self._held[name], None
        if not -LARGEST < value < LARGEST:
            reason = NOT_FINITE
        elif stamp > latest + self._ahead(name):
            reason = AHEAD
        elif not command.take(stamp, value):
            reason = BACKWARDS
        if reason is not None:
            command.spoil(int(min(stamp, latest)))
            return reason
        for reading in self._seers[name]:  # later ones that see it are cleaned anew
            if reading.stamps and reading.stamps[-1] >= command.stamps[-1]:
                stamp = min(stamp, reading.before(command.stamps[-1]) + 1)
        return stamp

    def spoil(self, name: str, time: int) -> None:
        """Note that what came of a command could not be used; see `Command`."""
        self._held[name].spoil(time)

    def begin(self, now: int) -> None:
        """Note when time began."""
        for command in self._held.values():
            command.begin(now)

    def drop_ahead(self, now: int) -> Iterator[tuple[str, Reason]]:
        """Forget what lies ahead of the clock after all; tell of which channel, and why."""
        for name in self._floors.keys() - self.distrusted:  # of a clock that was set back since
            self._floors[name] = min(self._floors[name], now)
        for name, samples in self.samples.items():
            for _ in range(samples.drop_after(now + self._ahead(name))):
                self._heard.pop(name, None)
                yield name, AHEAD
        for name, samples in self._apart.items():
            samples.drop_after(now + self._ahead(name))

    def _ahead(self, name: str) -> int:
        return min(self.ages.get(name, self.oldest), MOST_AHEAD) + max(
            self._shifts.get(name, 0), 0)

    def distrust(self, names: Collection[str], now: int | None) -> None:
        """Believe only readings of these sensors that come after they are trusted again."""
        for name in self.distrusted.difference(names):
            self._floors[name] = -math.inf if now is None else now
        for name in set(names) - self.distrusted:
            self._floors[name] = math.inf
            if self.samples[name].stamps:
                self._apart[name] = self.samples[name].moved()
        self.distrusted = frozenset(names)

    def silent(self, name: str, now: int, began: int | None) -> bool:
        """Tell whether a sensor's last reading, or else the beginning, is beyond its max_age."""
        last = self._heard.get(name, began)
        return last is not None and now - last > self.ages[name]

    def confirmed(self, time: int, without: Iterable[str]) -> bool:
        """Tell whether every sensor that is not silent, nor named, has said what it is then."""
        return all(stamps[-1] >= time + self._shifts.get(name, 0) or time - stamps[-1] > age
                   for name, age in self.ages.items()
                   if name not in without and (stamps := self.samples[name].stamps))

    def missing(self, needs: np.ndarray, now: int | None) -> Reason | None:
        """Return which of these (L + m,) bool is not there; None when all are."""
        for name, needed in zip(self.samples, needs):
            if needed and (lack := self.lack(name, now)) is not None:
                return lack
        return None

    def lack(self, name: str, now: int | None) -> Reason | None:
        """Return why a sensor or a command is not there; None when it is."""
        if name in self.distrusted:
            return Reason.of('input isolated', name=name)
        stamps = self.samples[name].stamps
        if name in self._held:
            return self._lack_of(name, now)
        if not stamps:
            return Reason.of('no reading yet', name=name)
        age = 0 if now is None else now - stamps[-1]
        if age > self.ages[name]:
            return Reason.of('input silent', name=name, seconds=age * 1e-9)
        return None

    def _lack_of(self, name: str, now: int | None) -> Reason | None:
        command = self._held[name]
        if now is None or not command.stamps:
            there = command.stamps or (now is not None and command.held(now) is not None)
            return None if there else Reason.of('no command yet', name=name)
        if not command.stopped(max(now, command.stamps[-1])):
            return None
        age = (now - command.stamps[-1]) * 1e-9
        return Reason.of('command ended' if command.spoilt is None else 'command unusable',
                         name=name, seconds=age)

    def oldest_stamp(self, default: int) -> int:
        """Return the stamp of the oldest sample that is kept."""
        return min((s.stamps[0] for s in self.samples.values() if s.stamps), default=default)

    def said(self, name: str) -> Samples:
        """Return what a sensor has said last, believed or kept apart."""
        samples = self.samples[name]
        return samples if samples.stamps else self._apart.get(name, samples)

    def shown(self, name: str, linear: float | None, time: int) -> float | None:
        """Return what a sensor shows of a linear reading of a time."""
        if linear is None or name not in self._curves:
            return linear
        curve = self._curves[name]
        return curve.shown(linear, sum(gain * (self._held[u].held(time) or 0.0)
                                       for u, gain in curve.beside.items()))

    def last_stamps(self) -> list[int | None]:
        """Return the last stamp of each sensor."""
        return [samples.stamps[-1] if samples.stamps else None for samples, _, _ in self._readings]

    def at(self, time: int) -> Told:
        """Return what was told of a time."""
        y = [samples.interpolated(time, age, seen) for samples, age, seen in self._readings]
        held = [command.held(time) for command in self._held.values()]
        stopped = [i for i, command in self._stoppable if command.stopped(time)]
        there: np.ndarray = self.everything
        if None in y or None in held or stopped:
            found = np.array([v is not None for v in (*y, *held)], dtype=bool)
            found[stopped] = False
            if found.tobytes() != self._there.tobytes():  # mostly it is as before
                self._there = found
            there = self._there
            y, held = [v or 0.0 for v in y], [v or 0.0 for v in held]
        return Told(np.array(y, dtype=float), there,
                    np.array(held, dtype=float) if self._wants_held else _NOTHING,
                    np.array([samples.age(time) for samples, _, _ in self._readings]) * 1e-9
                    if self._wants_ages else _NOTHING)

    def over(self, start: int, end: int) -> np.ndarray:
        """Return the commands at the start and at the end of a step, and their means (3, m)."""
        commands = [command.over(start, end) for command in self._held.values()]
        return np.array(commands, dtype=float).reshape(-1, 3).T

    def ages_at(self, time: int) -> np.ndarray:
        """Return how old [s] the last reading of each sensor is (L,); 0 where there is none."""
        return np.array([max(0, time - samples.stamps[-1]) * 1e-9 if samples.stamps else 0.0
                         for samples, _, _ in self._readings])

    def forget(self, before: int) -> None:
        """Drop what nothing at or after this time depends on."""
        for samples, _, _ in self._readings:
            samples.forget(before)
        for samples in self._held.values():  # the readings from before have seen them
            samples.forget(before - self.oldest)
        for samples in self._apart.values():
            samples.forget(before)


def ages_of(sensors: tuple[str, ...], max_age: float | Mapping[str, float],
            least: int) -> dict[str, int]:
    """
    Return the max_age of each sensor in ns, at least so many; 0.5 s for those not named.

    Raises BadInput when a name or a time is none.
    """
    given = max_age if isinstance(max_age, Mapping) else dict.fromkeys(sensors, max_age)
    for name, age in given.items():
        if name not in sensors:
            raise BadInput('', 'max_age', f'{name} is no sensor',
                           f'name one of {", ".join(sensors)}')
        if not age > 0.0:
            raise BadInput('', 'max_age', f'{age} is not a time in s', 'give a number above 0')
    return {name: max(round(min(given.get(name, 0.5), 1e9) * 1e9), least) for name in sensors}
