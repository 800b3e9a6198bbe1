"""Who is blamed: from the alarms of an episode to the sensors that explain them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from operator import and_, or_

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.isolator.conflicts import bits, least_hitting_sets
from vsensor_ros.isolator.detector import Bools

AT_ONCE = 5.0  # s within which all alarms together mean the model, and no sensor
ANEW = 300.0  # s after a verdict of the model has ended, in which alarms are the model's, too,
PASSES = 10.0  # unless they last longer than so many s
JUST = 1.0  # s in which a step belongs to a conflict that began, and that nobody explains yet
FORGOTTEN = 10.0  # s without an alarm, after which conflicts that blamed nobody are over


class Diagnosis:
    """
    The conflicts of one machine, and what they mean. Sensors are bits.

    supports: of each check. Time is in s, and only ever goes on.
    """

    def __init__(self, supports: Iterable[int]) -> None:
        self.supports = list(supports)
        self._apart = _apart(self.supports)
        self.conflicts: dict[int, float] = {}  # check: since when
        self.direct: dict[int, float] = {}  # sensor whose readings alone show its fault
        self.found: dict[int, float] = {}  # sensor: since when it is blamed
        self.candidates: tuple[int, ...] = ()  # sets that explain all, when there are several
        self.model = False
        self._last = -np.inf  # alarm
        self._excused = -np.inf  # the last end of a verdict that blamed the model
        self._errs = False  # the model is blamed because it was lately

    @property
    def stands(self) -> bool:
        """Whether something is wrong: then nothing may be learnt."""
        return bool(self.conflicts or self.direct)

    def update(self, time: float, alarms: Bools, running: Bools,
               direct: Iterable[int] = (),
               stepped: Callable[[], Iterable[int]] = tuple) -> None:
        """
        Take who alarms and who runs at all (checks,), and whose readings show a fault.

        stepped: returns whose readings jumped just now; asked when a check begins to alarm.
        """
        new = False
        for check in np.flatnonzero(alarms):
            new |= self.conflicts.setdefault(int(check), time) == time
        for sensor in (*direct, *self._hastened(time, stepped)):
            new |= self.direct.setdefault(sensor, time) == time
        if alarms.any():
            self._last = time
        if new or self._errs and self.conflicts and not self._errs_again(time):
            self._judge(time, running)
        elif self.conflicts and not self.found and time - self._last > FORGOTTEN:
            if self.model:
                self._excused = time
            self.conflicts.clear()
            self._judge(time, running)

    def _hastened(self, time: float, stepped: Callable[[], Iterable[int]]) -> list[int]:
        """Return who stepped as a check that reads it began to alarm, and can be told apart."""
        known = sum(self.found.keys() | self.direct.keys())
        begun = [self.supports[check] for check, since in self.conflicts.items()
                 if time - since <= JUST and not self.supports[check] & known]
        who = [sensor for sensor in stepped() if sensor & self._apart] if begun else []
        return who if len(who) == 1 and any(who[0] & support for support in begun) else []

    def _judge(self, time: float, running: Bools) -> None:
        masks = [*(self.supports[check] for check in self.conflicts), *self.direct]
        sets = least_hitting_sets(masks) if masks else [0]
        known = sum(self.found)
        # who was found stays, as long as that is as likely as anything else
        sets = [mask for mask in sets if mask & known == known] or sets
        self._errs = self._errs_again(time)
        self.model = self._errs or not self.direct and self._all_at_once(time, running, sets)
        if self.model or not sets:
            self.model = True
            blamed = {s for s, since in self.found.items() if time - since > AT_ONCE}
            blamed |= set(self.direct)
            self.candidates = ()
        else:
            common = sets[0]
            for mask in sets:
                common &= mask
            blamed = set(bits(common))
            self.candidates = tuple(mask & ~common for mask in sets) if len(sets) > 1 else ()
        self.found = {s: self.found.get(s, time) for s in sorted(blamed)}

    def _all_at_once(self, time: float, running: Bools, sets: list[int]) -> bool:
        """Tell whether all checks that run were broken together, by no single sensor."""
        if not sets or sets[0].bit_count() < 2:
            return False
        broken = [check in self.conflicts for check in np.flatnonzero(running)]
        return all(broken) and time - min(self.conflicts.values()) <= AT_ONCE

    def _errs_again(self, time: float) -> bool:
        """Tell whether the model was blamed lately, and what alarms has no other reason."""
        reasons = sum(self.found.keys() | self.direct.keys())
        return time - self._excused <= ANEW and any(
            not self.supports[check] & reasons for check in self.conflicts) and \
            time - min(self.conflicts.values()) <= PASSES

    def forgive(self, sensor: int, time: float, running: Bools) -> list[int]:
        """Believe a sensor again; return the checks whose conflicts it has taken along."""
        gone = [check for check in self.conflicts if self.supports[check] & sensor]
        for check in gone:
            del self.conflicts[check]
        self.direct.pop(sensor, None)
        self._judge(time, running)
        return gone

    def excusable(self) -> NDArray[np.int64]:
        """Return the checks of the conflicts, if the model is blamed and no sensor; else none."""
        checks = sorted(self.conflicts) if self.model and not self.found else []
        return np.array(checks, dtype=np.int64)

    def dismiss(self, time: float) -> None:
        """End a verdict that blames the model."""
        self.model, self._excused = False, time
        self.conflicts.clear()


def _apart(supports: Sequence[int]) -> int:
    """Return the sensors that the checks can tell from all others: none is in all theirs, too."""
    apart = 0
    for sensor in bits(reduce(or_, supports, 0)):
        shared = reduce(and_, (support for support in supports if support & sensor))
        apart |= sensor * (shared == sensor)
    return apart
