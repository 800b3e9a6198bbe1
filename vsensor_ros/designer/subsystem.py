"""
The part of a plant that a channel has to do with: nothing else decides its virtual sensor.

What reaches the channel belongs to it, and what reaches a reading that shares a state or an
unknown input with it. Other states and sensors are strangers: no equation of the part holds them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from vsensor_ros.observers import Limit, Refusal, VirtualSensor
from vsensor_ros.plant import Plant


@dataclass(frozen=True, eq=False)
class Subsystem:
    """A part of a plant, as a plant, and how to say of the whole what was found for it."""

    whole: Plant
    fault_set: tuple[str, ...]  # of the whole
    plant: Plant
    states: np.ndarray  # (r,) indices in the whole, as all others
    terms: np.ndarray  # (q,)

    @property
    def lost(self) -> tuple[str, ...]:
        """The sensors of the fault set that belong to the part."""
        return tuple(s for s in self.fault_set if s in self.plant.sensors)

    def entry_of_whole(self, found: VirtualSensor | Refusal) -> VirtualSensor | Refusal:
        """Say of the whole plant what was found for its part."""
        if self.plant is self.whole:
            return found
        if isinstance(found, Refusal):
            return replace(found, fault_set=self.fault_set)
        whole = self.whole
        healthy = tuple(s for s in whole.sensors if s not in self.fault_set)
        read = [healthy.index(s) for s in found.healthy]
        l0, n, q = len(healthy), len(whole.states), len(whole.terms)

        def wide(M: np.ndarray, where: np.ndarray | list[int], width: int) -> np.ndarray:
            placed = np.zeros((len(M), width))
            placed[:, where] = M
            return placed

        place = {int(i): at for at, i in enumerate(self.terms)}

        def of_terms(given: tuple[np.ndarray, ...], width: int) -> tuple[np.ndarray, ...]:
            return tuple(given[place[i]] if i in place else np.zeros((len(g), width))
                         for i, g in enumerate(whole.G))

        certificate, tracking = found.certificate, found.tracking
        if certificate is not None:
            certificate = replace(certificate, region=tuple(
                Limit(None if at.term is None else int(self.terms[at.term]), *at[1:])
                for at in certificate.region))
        if tracking is not None:
            tracking = replace(tracking, Q=wide(tracking.Q, read, l0))
        return replace(
            found, fault_set=self.fault_set, healthy=healthy, terms=whole.terms,
            Phi=wide(found.Phi, self.states, n), J=wide(found.J, read, l0),
            Q=wide(found.Q, read, l0), z0_gain=wide(found.z0_gain, read, l0),
            P=wide(found.P, self.terms, q), Gz=of_terms(found.Gz, found.order),
            Gy=of_terms(tuple(wide(g, read, l0) for g in found.Gy), l0),
            Gu=of_terms(found.Gu, len(whole.inputs)), certificate=certificate, tracking=tracking)


def subsystem(plant: Plant, fault_set: tuple[str, ...], channel: str,
              wanted: np.ndarray | None = None) -> Subsystem:
    """
    Return the part of a plant that a channel has to do with when a set of sensors has failed.

    ``wanted`` (p, n): rows of a functional of the states, instead of the sensor ``channel``.
    """
    count, n = plant.C.shape
    failed = np.array([s in fault_set for s in plant.sensors])
    if wanted is None:
        own = plant.sensors.index(channel)
        goal, direct = plant.C[[own]], plant.Cd[[own]]
    else:
        goal, direct = wanted, np.zeros((len(wanted), len(plant.disturbances)))
    acts = plant.A != 0
    for g, column in zip(plant.G, plant.P.T):
        acts |= np.outer(column != 0, g.any(axis=0))
    # who reaches the sensors and the goal: states, then unknown inputs
    reached = _reach(np.vstack([plant.C, goal]) != 0, acts)
    through = np.asarray(reached.astype(float) @ (plant.D != 0) > 0)
    reached = np.hstack([reached, through | (np.vstack([plant.Cd, direct]) != 0)])
    kept = np.asarray(reached[count:].any(axis=0))
    heard = np.zeros(count, dtype=bool)
    while True:
        more = ~failed & (reached[:count] & kept).any(axis=1)
        if (more == heard).all():
            break
        heard, kept = more, kept | reached[:count][more].any(axis=0)
    # a failed sensor may correct what it reads of the part
    heard |= failed & reached[:count].any(axis=1) & ~(reached[:count] & ~kept).any(axis=1)
    whole = kept[:n].all() and (heard | failed).all()
    if whole or not kept[:n].any():
        return Subsystem(plant, fault_set, plant, np.arange(n), np.arange(len(plant.terms)))
    states = np.flatnonzero(kept[:n])
    terms = np.flatnonzero(plant.P[states].any(axis=0))
    part = _part(plant, *(tuple(chosen.tolist()) for chosen in (
        states, np.flatnonzero(heard), np.flatnonzero(kept[n:]), terms)))
    return Subsystem(plant, fault_set, part, states, terms)


_part = lru_cache(maxsize=8)(Plant.part)  # one plant for many channels: what is known of it stays


def _reach(rows: np.ndarray, acts: np.ndarray) -> np.ndarray:
    """Return which states reach rows (s, n) of states; ``acts[i, j]``: j acts on i."""
    reached = rows
    while True:
        more = reached | (reached.astype(float) @ acts > 0)
        if (more == reached).all():
            return np.asarray(reached)
        reached = more
