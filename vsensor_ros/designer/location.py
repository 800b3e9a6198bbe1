"""
Where one more sensor would help: which others could be lost that cannot be lost now.

The rules of the first paper count ranks: with H0 = [H; Hv] and D0 the faults of the sensors in
F, the annihilator of D0 leaves the healthy rows C0 and the new one, and

(30) ``rank [C0; Hv] > rank C0``: else the new sensor tells nothing new when F has failed;
(31) of two new sensors the one with the larger rank is preferred;
(32) ``rank [H; Hv] = n``: every state is then measured.

Of readings that hold unknown inputs directly, H and C0 are the combinations free of them. (30) is
necessary for a gain, not enough: a rank says nothing of unknown inputs that act on the states, nor
of modes that stay. The practical form decides, for every fault set, by existence itself. Source:
method, section 2 (sensor location) and 3.1 to 3.3; paper S, conditions (30) to (32), corrected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.designer.existence import examine
from vsensor_ros.designer.isolability import blind_to, checks
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.designer.subspaces import in_row_space, rank
from vsensor_ros.functions.expression import check_name
from vsensor_ros.observers import STRENGTHS, STRONG
from vsensor_ros.plant import Plant

Loss = tuple[tuple[str, ...], str]  # a fault set and a channel of it


@dataclass(frozen=True, eq=False)
class Location:
    """What one more sensor of ``row @ x`` would be good for."""

    name: str
    row: np.ndarray  # (n,)
    gained: tuple[Loss, ...]  # what could be replaced with it and cannot without
    raised: tuple[tuple[str, ...], ...]  # fault sets for which (30) holds
    rank: int  # of [H; Hv]
    complete: bool  # (32): that rank is n
    # whose faults could be told from those of a set of others, of none: seen; at all, or constant
    # ones, too; empty unless asked for
    isolable: tuple[Loss, ...] = ()

    def __post_init__(self) -> None:
        self.row.flags.writeable = False


def locations(plant: Plant, candidates: Mapping[str, Any] | None = None,
              up_to: int = 1, isolate: bool = False) -> tuple[Location, ...]:
    """
    Tell for each candidate sensor what could be lost for good that cannot be now; best first.

    ``candidates``: rows (n,) of what the new sensor would measure, by name; by default each state
    that no sensor measures alone. The new sensor is taken to stay healthy, and to read neither
    commands nor unknown inputs directly. ``up_to``: fault sets of so many sensors are looked at.
    Best is what gains most; then what raises the rank for more fault sets, (31); then what makes
    it complete, (32). ``isolate``: decide, too, whose faults could be seen, and told from those of
    one other, which counts next to the gain; then every state is a candidate, for a second sensor
    tells of the first. Only whether virtual sensors and residuals exist is decided, none is
    designed. Raises BadInput. Source: see above, and isolability.py.
    """
    rows = _rows(plant, candidates, isolate)
    if isinstance(up_to, bool) or not isinstance(up_to, int) or up_to < 1:
        raise BadInput('locations', 'up_to', f'{shown(up_to)} is not a number of sensors',
                       'give 1, 2, ..')
    sets = [s for size in range(1, min(up_to, len(plant.sensors)) + 1)
            for s in combinations(plant.sensors, size)]
    lost: dict[Loss, Problem] = {}
    kept: dict[tuple[str, ...], np.ndarray] = {}  # C0 of each fault set
    for fault_set in sets:
        for channel in fault_set:
            problem = pose(plant, fault_set, channel)
            kept[fault_set] = problem.C0
            if _within(fault_set, channel, lost) or examine(problem).obstruction is not None:
                lost[fault_set, channel] = problem
    healthy = pose(plant, (), plant.sensors[0])
    told = _told(plant) if isolate else {}
    found = []
    for name, row in rows.items():
        gained: dict[Loss, None] = {}
        stays: dict[Loss, None] = {}
        for (fault_set, channel), problem in lost.items():
            if not _within(fault_set, channel, stays) and _exists(_with(problem, name, row)):
                gained[fault_set, channel] = None
            else:
                stays[fault_set, channel] = None
        new = _scaled(healthy, row)
        raised = tuple(s for s, C0 in kept.items() if not in_row_space(C0, new))
        total = rank(np.vstack([healthy.C0, new]))
        found.append(Location(name, row, tuple(gained), raised, total,
                              total == len(plant.states), _isolable(told, name, row)))
    return tuple(sorted(found, key=lambda f: (-len(f.gained), -len(f.isolable), -len(f.raised),
                                              not f.complete)))


def _told(plant: Plant) -> dict[tuple[str, ...], tuple[Problem, dict[str, str]]]:
    """Return for no and each single other sensor the problem, and how faults show beside it."""
    return {others: (problem := blind_to(plant, others), checks(problem).strengths())
            for others in ((), *((s,) for s in plant.sensors))}


def _isolable(told: Mapping[tuple[str, ...], tuple[Problem, dict[str, str]]], name: str,
              row: np.ndarray) -> tuple[Loss, ...]:
    """Return whose faults show better beside which others with one more healthy sensor."""
    better = []
    for others, (problem, now) in told.items():
        wider = _with(problem, name, row, even_known=True)
        if wider is None or set(now.values()) == {STRONG}:
            continue
        then = checks(wider).strengths()
        better += [(others, s) for s, strength in now.items()
                   if STRENGTHS.index(then[s]) > STRENGTHS.index(strength)]
    return tuple(better)


def _within(fault_set: tuple[str, ...], channel: str, lost: Mapping[Loss, Any]) -> bool:
    """Whether fewer faults were too many already: less knowledge mends nothing."""
    return any((fewer, channel) in lost for size in range(1, len(fault_set))
               for fewer in combinations(fault_set, size) if channel in fewer)


def _with(problem: Problem, name: str, row: np.ndarray,
          even_known: bool = False) -> Problem | None:
    """Give a problem one more healthy sensor; None when it tells nothing new."""
    new = _scaled(problem, row)
    if not even_known and in_row_space(problem.C0, new):
        return None
    wider = np.zeros((len(problem.Y) + 1, problem.Y.shape[1] + 1))
    wider[:-1, :-1], wider[-1, -1] = problem.Y, 1.0
    return replace(
        problem, healthy=(*problem.healthy, name), C0=np.vstack([problem.C0, new]), Y=wider,
        F=np.pad(problem.F, ((0, 0), (0, 1))), Qv=np.pad(problem.Qv, ((0, 0), (0, 1))),
        y0_size=np.append(problem.y0_size, np.linalg.norm(row * problem.scale)))


def _exists(problem: Problem | None) -> bool:
    return problem is not None and examine(problem).obstruction is None


def _scaled(problem: Problem, row: np.ndarray) -> np.ndarray:
    """Return a row of states as one of length one (1, n) in the problem's units."""
    new = row * problem.scale
    return new[None, :] / np.linalg.norm(new)


def _rows(plant: Plant, candidates: Mapping[str, Any] | None,
          twice: bool) -> dict[str, np.ndarray]:
    """Return the rows (n,) of the candidates by name."""
    n = len(plant.states)
    if candidates is None:
        alone = {int(np.flatnonzero(row)[0]) for row, direct in zip(
            plant.C, np.hstack([plant.Cu, plant.Cd]))
            if np.count_nonzero(row) == 1 and not direct.any()}
        return {name: np.eye(n)[i] for i, name in enumerate(plant.states)
                if twice or i not in alone}
    mend = f"give {{'name': row}} with rows of {n} numbers"
    if not isinstance(candidates, Mapping):
        raise BadInput('locations', 'candidates', f'{shown(candidates)} is not a mapping', mend)
    rows = {}
    for name, given in candidates.items():
        check_name(name, 'locations', 'candidates')
        try:
            row = np.array(given, dtype=float)
        except (TypeError, ValueError):
            raise BadInput('locations', f'candidates.{name}', f'{shown(given)} is not numbers',
                           mend) from None
        if row.shape != (n,) or not np.isfinite(row).all() or not row.any():
            raise BadInput('locations', f'candidates.{name}',
                           f'{shown(given)} is not a row that measures something', mend)
        rows[name] = row
    return rows
