"""The data of the kind fault_estimator."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import ClassVar

import numpy as np

from vsensor_ros.observers.entry import read_only


@dataclass(frozen=True, eq=False)
class FaultObserver:
    """
    An observer of all sensors of a fault set, and of actuator faults, in discrete time.

    V submodels, k variables, r healthy sensors, m inputs of the plant, p premises, o outputs.
    """

    kind: ClassVar[str] = 'fault_estimator'
    method: ClassVar[str] = 'descriptor form, one form of the error over the range'
    grade: ClassVar[str] = 'exact'  # faults, which are the unknown inputs, do not reach its error
    noise = proof = certificate = None

    channel: str
    fault_set: tuple[str, ...]
    outputs: tuple[str, ...]  # o: the fault set, then faults of inputs
    reads: tuple[str, ...]  # r
    inputs: tuple[str, ...]  # m
    sample_time: float  # s
    premises: tuple[str, ...]
    ranges: np.ndarray  # (p, 2)
    memberships: tuple[str, ...]  # V expressions of the premises
    from_readings: np.ndarray  # (p, r): premises are this times the readings
    from_inputs: np.ndarray  # (p, m) and this times the inputs
    N: np.ndarray  # (V, k, k)
    K: np.ndarray  # (V, k, r)
    M: np.ndarray  # (V, k, m)
    T2: np.ndarray  # (k, r)
    Cv: np.ndarray  # (o, k)
    P: np.ndarray  # (k, k) the form of the error: e' P e
    initial: np.ndarray  # (k,) it starts from this
    from_first: np.ndarray  # (k, r) and this times the first readings
    start: float  # of e' P e at the start, at most; 1 or more
    alpha: float  # of what e' P e is above 1, lost in a step
    deviations: np.ndarray  # (o,) standard deviations in steady state [unit of the output]

    def __post_init__(self) -> None:
        read_only(self)

    @property
    def order(self) -> int:
        """Number of its variables."""
        return self.N.shape[1]

    @property
    def decay(self) -> float:
        """Slowest rate [1/s] at which an error beyond the form dies out."""
        return -math.log1p(-self.alpha) / (2.0 * self.sample_time)

    @property
    def half_widths(self) -> np.ndarray:
        """Half-widths (o,) once the start is forgotten [unit of the output]."""
        return np.sqrt(np.einsum('ok,kl,ol->o', self.Cv, np.linalg.inv(self.P), self.Cv))

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the commands that move it, or schedule it."""
        used = np.any(self.M, axis=(0, 1)) | np.any(self.from_inputs, axis=0)
        return tuple(name for name, one in zip(self.inputs, used) if one)
