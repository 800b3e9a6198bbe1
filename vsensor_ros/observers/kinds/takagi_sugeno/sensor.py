"""The data of the kind takagi_sugeno."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from vsensor_ros.observers.entry import read_only


@dataclass(frozen=True, eq=False)
class ScheduledSensor:
    """
    A virtual sensor with scheduled injection, in continuous time.

    V submodels, k states, r healthy sensors, m inputs of the plant, p premises.
    """

    kind: ClassVar[str] = 'takagi_sugeno'
    method: ClassVar[str] = 'scheduled injection, one form over the range'
    noise = proof = certificate = None

    channel: str
    fault_set: tuple[str, ...]
    reads: tuple[str, ...]  # r
    inputs: tuple[str, ...]  # m
    grade: str  # 'exact' or 'bounded'
    premises: tuple[str, ...]
    ranges: np.ndarray  # (p, 2)
    memberships: tuple[str, ...]  # V expressions of the premises
    from_readings: np.ndarray  # (p, r): premises are this times the readings
    from_inputs: np.ndarray  # (p, m) and this times the inputs
    N: np.ndarray  # (V, k, k)
    J: np.ndarray  # (V, k, r)
    B: np.ndarray  # (V, k, m)
    a: np.ndarray  # (V, k)
    Cv: np.ndarray  # (1, k)
    Q: np.ndarray  # (1, r)
    S: np.ndarray  # (k, k) the form of the error: e' S e
    initial: np.ndarray  # (k,)
    start: float  # of e' S e at the start, at most; 1 or more
    decay: float  # 1/s
    half_width: float  # once e' S e <= 1 [unit of the channel]
    direct: float  # of that, what noise of the readings does without the states
    why: str = ''  # it stands there and not one with constant gains
    # (p,) of premises that are angles: by so much more all is the same; 0, or (0,): by nothing
    turns: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        read_only(self)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Name of what it says."""
        return (self.channel,)

    @property
    def order(self) -> int:
        """Number of states."""
        return self.N.shape[1]

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the commands that move it, or schedule it."""
        used = np.any(self.B, axis=(0, 1)) | np.any(self.from_inputs, axis=0)
        return tuple(name for name, one in zip(self.inputs, used) if one)
