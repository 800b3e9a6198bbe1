"""
Diagnosis by conflicts: the least sets of sensors that explain all alarms.

An alarm of a residual is a conflict: one of the sensors in its support is faulty. A quiet residual
exonerates nobody. Sensors are numbered; a set of them is a bit mask.
"""

from __future__ import annotations

from collections.abc import Iterable

MOST = 4  # sensors in a set that is looked for
LARGEST = 5000  # sets that are looked at; beyond nobody can be blamed anyway


def minimal(conflicts: Iterable[int]) -> list[int]:
    """Return the conflicts that contain no other one; who meets these meets all."""
    kept: list[int] = []
    for conflict in sorted(set(conflicts), key=lambda c: c.bit_count()):
        if not any(known & conflict == known for known in kept):
            kept.append(conflict)
    return kept


def least_hitting_sets(conflicts: Iterable[int], most: int = MOST) -> list[int]:
    """
    Return all sets of the smallest size that have a member in every conflict.

    [0] without conflicts; [] when no set of up to `most` sensors does, or a conflict is empty.
    """
    rest = minimal(conflicts)
    if 0 in rest:
        return []
    found = {0}
    for _ in range(most + 1):
        whole = sorted(mask for mask in found if all(mask & conflict for conflict in rest))
        if whole:
            return whole
        longer = set()
        for mask in found:
            conflict = next(conflict for conflict in rest if not mask & conflict)
            longer |= {mask | bit for bit in bits(conflict)}
            if len(longer) > LARGEST:
                return []
        found = longer
    return []


def bits(mask: int) -> list[int]:
    """Return the single members of a set."""
    return [1 << i for i in range(mask.bit_length()) if mask >> i & 1]
