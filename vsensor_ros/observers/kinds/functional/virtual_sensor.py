"""
The data of the kind functional: an observer of linear functionals of the plant's state.

Letters are those of the method: order k, p rows of the wanted functional (one for a sensor's
channel), l0 healthy sensors, m inputs, q nonlinear terms with r_i arguments, f channels that
track.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from vsensor_ros.functions.expression import names, parse
from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.observers.entry import read_only
from vsensor_ros.observers.kinds.functional.argument_name import argument_place, together
from vsensor_ros.observers.knowledge import Certificate, Noise, Proof, Rung


@dataclass(frozen=True, eq=False)
class Tracking:
    """
    How readings of the failed channels correct z while they are still believed (method 3.12).

    ``d z = N z + J y0 + .. + L r`` with ``r = y_f - (C z + Q y0 + Qu u)``, and without them
    ``d P = N P + P N' + W`` for the covariance P of ``e = Phi x - z``.
    """

    channels: tuple[str, ...]  # f of the fault set: those that z and y0 tell; the own one first
    L: np.ndarray  # (k, f) steady Kalman gain
    C: np.ndarray  # (f, k)
    Q: np.ndarray  # (f, l0)
    Qu: np.ndarray  # (f, m)
    P: np.ndarray  # (k, k) covariance of e in steady state while they correct
    W: np.ndarray  # (k, k) growth of that of e per s (discrete: per step) without them
    direct: float  # variance of vhat by the noise of y0 through its Q, unit of the channel squared
    assumed: bool = False  # some of the noise that this is made of was not given
    noise: np.ndarray | None = None  # (f,) standard deviation of one reading; None: not known
    # (k, k) N with the terms' slopes at the operating point, by which P moves; None: it is N
    slopes: np.ndarray | None = None

    def __post_init__(self) -> None:
        read_only(self)


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

    kind: ClassVar[str] = 'functional'

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
    # 'exact': rho does not reach the error; 'bounded': it does; 'temporary': exact, but an error
    # stays or grows, so that it serves for a time after its channel was lost
    grade: str = 'exact'
    disturbance_gain: float = 0.0  # peak over frequency from rho to the error
    proof: Proof | None = None
    ladder: tuple[Rung, ...] = ()
    noise: Noise | None = None
    certificate: Certificate | None = None
    # (k, k) covariance of Phi x - z at the start; None: not known
    start: np.ndarray | None = None
    tracking: Tracking | None = None  # None: nothing to track, or not known how
    why: str = ''  # it stands there, and what there would be in its place; '': nothing to say

    def __post_init__(self) -> None:
        m = len(self.inputs)
        if self.Qu is None:
            object.__setattr__(self, 'Qu', np.zeros((len(self.Cv), m)))
        if self.Gu is None:
            object.__setattr__(self, 'Gu', tuple(np.zeros((len(g), m)) for g in self.Gz))
        read_only(self)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of what it says."""
        return (self.channel,)

    @property
    def order(self) -> int:
        """Number of states."""
        return self.N.shape[0]

    @property
    def decay(self) -> float:
        """Slowest rate [1/s] at which a linear error dies out, below 0: grows; inf: no states."""
        return decay_of(self.eigenvalues, self.sample_time)

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

    @property
    def region(self) -> tuple[tuple[str, float, float], ...]:
        """Where its certificate holds: states, sums of states and commands, with their limits."""
        c = self.certificate
        if c is None or c.where:
            return () if c is None else c.where
        return together((self.inputs[argument], low, high) if term is None
                        else argument_place(self.terms[term], argument, low, high)
                        for term, argument, low, high in c.region)


def is_stable(eigenvalues: np.ndarray, sample_time: float | None) -> bool:
    """Tell whether a linear error with these eigenvalues dies out."""
    if sample_time is None:
        return bool(np.all(eigenvalues.real < 0.0))
    return bool(np.all(np.abs(eigenvalues) < 1.0))


def worst_of(eigenvalues: np.ndarray, sample_time: float | None) -> complex:
    """Return that of the eigenvalues by which a linear error dies out last, or grows most."""
    size = eigenvalues.real if sample_time is None else np.abs(eigenvalues)
    return complex(eigenvalues[int(np.argmax(size))])


def decay_of(eigenvalues: np.ndarray, sample_time: float | None) -> float:
    """Return the slowest rate [1/s] at which a linear error with these eigenvalues dies out."""
    if len(eigenvalues) == 0:
        return np.inf
    if sample_time is None:
        return float(-eigenvalues.real.max())
    return float(-np.log(max(np.abs(eigenvalues).max(), 1e-12)) / sample_time)
