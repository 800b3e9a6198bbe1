"""
The bridge between the designer and the replacer: virtual sensors, and what is known of each.

Letters are those of the method: order k, p rows of the wanted functional (one for a sensor's
channel), l0 healthy sensors, m inputs, q nonlinear terms with r_i arguments. How they are written
to a file is in ``design_file.py``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vsensor_ros.functions.expression import names, parse
from vsensor_ros.functions.nonlinearity import NonlinearTerm


@dataclass(frozen=True)
class OrderStep:
    """What is known of the virtual sensors of one order."""

    order: int
    verdict: str  # 'impossible', 'possible' or 'open'
    why: str  # one sentence
    freedom: int  # free coefficients of the characteristic polynomial; 0 when impossible
    # largest singular value taken for zero, smallest taken for nonzero (inf: none); relative
    gap: tuple[float, float]


@dataclass(frozen=True)
class Proof:
    """Between which bounds the least order lies, and why. Source: method, 3.4 and 3.7."""

    lower: int
    upper: int
    steps: tuple[OrderStep, ...]
    doubts: tuple[str, ...]  # decisions on a rank that are ambiguous

    @property
    def least(self) -> bool:
        """Whether the least order is known."""
        return self.lower == self.upper


@dataclass(frozen=True)
class Rung:
    """One order of the ladder that a person may choose from, and what it costs."""

    order: int
    noise: float  # standard deviation of the error of vhat in steady state, unit of the channel
    noise_gain: float  # as that of the virtual sensor
    decay: float  # 1/s; inf when there is nothing that must die out
    method: str


@dataclass(frozen=True)
class Noise:
    """What the noise of sensors and process does to vhat in steady state."""

    error: float  # standard deviation of v - vhat, unit of the channel
    floor: float  # the same for the Kalman filter on the same healthy sensors; inf: it has none
    assumed: bool  # whether some noise figures are defaults, not given

    @property
    def ratio(self) -> float:
        """Return error / floor: 1 when both are 0, inf when only the floor is."""
        if self.floor == 0.0:
            return 1.0 if self.error == 0.0 else np.inf
        return self.error / self.floor


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proved of the error ``e = Phi x - z`` with its nonlinear terms (method, 3.5)."""

    status: str  # 'global', 'region' or 'none'
    rate: float  # 1/s at which the error is proved to decay; 0 when none
    bound: float  # sup |v - vhat| per unit of sup |error of the readings|; inf when none
    S: np.ndarray  # (k, k), of V = e' S e; zeros when none
    # where it holds: (argument of a term, low, high), in the argument's unit; empty when global
    region: tuple[tuple[str, float, float], ...]
    lipschitz: tuple[float, float] | None  # the papers' condition holds when left < right
    reason: str  # one sentence

    def __post_init__(self) -> None:
        self.S.flags.writeable = False


@dataclass(frozen=True, eq=False)
class VirtualSensor:
    """
    A functional observer that says what a failed sensor would have said.

    ``d z = N z + J y0 + B u + sum_i P[:, i] psi_i(Gz_i z + Gy_i y0 + Gu_i u, u)``,
    ``vhat = Cv z + Q y0 + Qu u``, where d is the derivative or, with a sample time, the next
    value. What the healthy sensors read directly of the inputs, y0 = C0 x + Cu0 u, is taken out:
    B = Phi B_plant - J Cu0, P = Phi P_plant, Gu_i = -Gy_i Cu0, Qu = Vu - Q Cu0.
    Source: equations (E1) to (E4) of the method.
    """

    channel: str  # the sensor it stands in for, or the wanted functional
    fault_set: tuple[str, ...]  # the sensors that have failed, in the plant's order
    healthy: tuple[str, ...]  # y0: what the columns of J, Q and Gy stand for
    inputs: tuple[str, ...]  # u: what the columns of B, Qu and Gu stand for
    Phi: np.ndarray  # (k, n), z = Phi x when converged
    N: np.ndarray  # (k, k)
    J: np.ndarray  # (k, l0)
    B: np.ndarray  # (k, m)
    P: np.ndarray  # (k, q)
    Cv: np.ndarray  # (p, k)
    Q: np.ndarray  # (p, l0)
    Gz: tuple[np.ndarray, ...]  # q arrays (r_i, k)
    Gy: tuple[np.ndarray, ...]  # q arrays (r_i, l0)
    terms: tuple[NonlinearTerm, ...]  # q
    sample_time: float | None  # s; None: continuous
    z0: np.ndarray  # (k,); the start is z = z0 + z0_gain y0
    z0_gain: np.ndarray  # (k, l0)
    eigenvalues: np.ndarray  # (k,) complex, of N
    noise_gain: float  # peak over frequency of |Cv (s - N)^-1 J + Q|
    method: str  # how it was found
    Qu: np.ndarray = None  # type: ignore[assignment]  # (p, m); zeros when left out
    Gu: tuple[np.ndarray, ...] = None  # type: ignore[assignment]  # q arrays (r_i, m); as Qu
    grade: str = 'exact'  # 'exact': rho does not reach the error; 'bounded': it does
    disturbance_gain: float = 0.0  # peak over frequency from rho to the error
    proof: Proof | None = None
    ladder: tuple[Rung, ...] = ()
    noise: Noise | None = None
    certificate: Certificate | None = None
    # (k, k) covariance of Phi x - z at the start; None: not known
    start: np.ndarray | None = None

    def __post_init__(self) -> None:
        m = len(self.inputs)
        if self.Qu is None:
            object.__setattr__(self, 'Qu', np.zeros((len(self.Cv), m)))
        if self.Gu is None:
            object.__setattr__(self, 'Gu', tuple(np.zeros((len(g), m)) for g in self.Gz))
        # a fresh one and a loaded one are alike: not to be written to
        for value in vars(self).values():
            for array in value if isinstance(value, tuple) else (value,):
                if isinstance(array, np.ndarray):
                    array.flags.writeable = False

    @property
    def order(self) -> int:
        """Number of states."""
        return self.N.shape[0]

    @property
    def active(self) -> tuple[int, ...]:
        """Indices of the nonlinear terms that enter the observer."""
        return tuple(int(i) for i in np.flatnonzero(self.P.any(axis=0)))

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the commands it needs, linearly or in a nonlinear term."""
        used = {name for i in self.active for name in names(parse(self.terms[i].text))}
        linear = np.vstack([self.B, self.Qu, *(self.Gu[i] for i in self.active)])
        return tuple(name for name, column in zip(self.inputs, linear.T)
                     if column.any() or name in used)

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the healthy sensors whose readings it needs."""
        used = np.vstack([self.J, self.Q, *(self.Gy[i] for i in self.active)]).any(axis=0)
        return tuple(self.healthy[i] for i in np.flatnonzero(used))


@dataclass(frozen=True)
class Refusal:
    """Why a channel cannot be replaced when a set of sensors has failed."""

    channel: str
    fault_set: tuple[str, ...]
    reason: str  # one sentence, in the user's names
    doubts: tuple[str, ...] = ()  # decisions on a rank that are ambiguous
    alternative: str = ''  # one sentence: there is one that unknown inputs disturb, bounded


@dataclass(frozen=True, eq=False)
class Design:
    """All virtual sensors of one plant, by fault set and channel."""

    plant_name: str
    plant_hash: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    sensors: tuple[str, ...]
    units: dict[str, str]
    sample_time: float | None
    entries: dict[tuple[tuple[str, ...], str], VirtualSensor | Refusal]
    wanted: tuple[str, ...] = ()  # functionals that are no sensors: their fault set may be ()
    Cu: np.ndarray | None = None  # (l, m) what sensors read directly of inputs; None: not known

    def __post_init__(self) -> None:
        if self.Cu is not None:
            self.Cu.flags.writeable = False

    def __getitem__(self, key: tuple[Iterable[str], str]) -> VirtualSensor | Refusal:
        """
        Look up ``design[fault_set, channel]``; raise KeyError when it was not designed.

        ``design[(), 'v']`` is the wanted functional v with all sensors healthy.
        """
        try:
            fault_set, channel = key if isinstance(key, tuple) else ()
            names = {fault_set} if isinstance(fault_set, str) else set(fault_set)
            unknown = sorted(map(str, (names | ({channel} - set(self.wanted)))
                                 - set(self.sensors)))
        except (TypeError, ValueError):
            raise KeyError(f'{key!r:.80}: is not a fault set and a channel; write '
                           "design[('y1', 'y2'), 'y1']") from None
        if unknown:
            wanted = f' and, wanted, {", ".join(self.wanted)}' if self.wanted else ''
            raise KeyError(f'{", ".join(unknown)}: no such sensor; there are '
                           f'{", ".join(self.sensors)}{wanted}')
        ordered = tuple(name for name in self.sensors if name in names)
        if channel in self.sensors and channel not in names:
            raise KeyError(f'channel {channel} of fault set {{{", ".join(ordered)}}}: has not '
                           'failed there; name it in the fault set, too')
        try:
            return self.entries[ordered, channel]
        except KeyError:
            designed = ', '.join('{' + ', '.join(s) + '}' for s in self.fault_sets)
            raise KeyError(f'channel {channel} of fault set {{{", ".join(ordered)}}} was not '
                           f'designed; the fault sets are {designed}') from None

    @property
    def fault_sets(self) -> tuple[tuple[str, ...], ...]:
        """The sets of failed sensors that were designed for; () when something is wanted."""
        return tuple(dict.fromkeys(fault_set for fault_set, _ in self.entries))

    @property
    def virtual_sensors(self) -> tuple[VirtualSensor, ...]:
        """All virtual sensors, those of wanted functionals too, without the refusals."""
        return tuple(e for e in self.entries.values() if isinstance(e, VirtualSensor))

    @property
    def refusals(self) -> tuple[Refusal, ...]:
        """All refusals."""
        return tuple(e for e in self.entries.values() if isinstance(e, Refusal))

    def save(self, path: str | Path) -> None:
        """
        Write the design file; the old file stays whole until the new one is complete.

        A link stays a link, a pipe or a device is written into. Raises BadInput when the file
        cannot be written, or when it would not be loaded.
        """
        from vsensor_ros.observers.design_file import write  # which is made of the classes above
        write(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Design:
        """
        Read a design file without executing anything in it.

        Raises BadInput, one line, when the file is missing, malformed, of another version, not
        finite, inconsistent in itself or unstable.
        """
        from vsensor_ros.observers.design_file import read
        return read(path)


def is_stable(eigenvalues: np.ndarray, sample_time: float | None) -> bool:
    """Tell whether a linear error with these eigenvalues dies out."""
    if sample_time is None:
        return bool(np.all(eigenvalues.real < 0.0))
    return bool(np.all(np.abs(eigenvalues) < 1.0))
