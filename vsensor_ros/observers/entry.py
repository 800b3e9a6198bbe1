"""What a design has for a channel that has failed: a virtual sensor of some kind, or a refusal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vsensor_ros.observers.knowledge import Certificate, Noise, Proof

Key = tuple[tuple[str, ...], str]  # fault set and channel
FAULT = 'fault.'  # stands before the name of a sensor or an input: so its fault is called


class Entry(Protocol):
    """What can be asked of a virtual sensor of any kind."""

    @property
    def kind(self) -> str:
        """Name of its kind."""

    @property
    def channel(self) -> str:
        """Name of the sensor that it stands in for, or of the wanted functional."""

    @property
    def fault_set(self) -> tuple[str, ...]:
        """Names of the sensors that have failed, in the plant's order."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of all that it says: its channel, and maybe others of its fault set or wanted."""

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the healthy sensors whose readings it needs."""

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the commands it needs."""

    @property
    def order(self) -> int:
        """Return the number of its states."""

    @property
    def method(self) -> str:
        """Return how it was found, in a few words."""

    @property
    def decay(self) -> float:
        """Return the slowest rate [1/s] at which an error dies out; inf: there is nothing to."""

    @property
    def grade(self) -> str:
        """Return 'exact', when unknown inputs do not reach its error, or another word."""

    @property
    def noise(self) -> Noise | None:
        """Return what noise does to it in steady state; None: not known."""

    @property
    def proof(self) -> Proof | None:
        """Return what is proved of the least order; None: nothing."""

    @property
    def certificate(self) -> Certificate | None:
        """Return what is proved of its convergence; None: nothing."""


@dataclass(frozen=True)
class Refusal:
    """Why a channel cannot be replaced when a set of sensors has failed."""

    channel: str
    fault_set: tuple[str, ...]
    reason: str  # one sentence, in the user's names
    doubts: tuple[str, ...] = ()  # decisions on a rank that are ambiguous
    alternative: str = ''  # one sentence: there is one that unknown inputs disturb, bounded


def read_only(record: object) -> None:
    """Let nobody write to the arrays of a record: a fresh one and a loaded one are alike."""
    for value in vars(record).values():
        for array in value if isinstance(value, tuple) else (value,):
            if isinstance(array, np.ndarray):
                array.flags.writeable = False
