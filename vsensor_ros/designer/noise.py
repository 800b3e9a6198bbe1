"""
What noise does to an estimate, and the least that it can do: the Kalman filter's error.

Readings carry white noise of the plant's standard deviations, one value each INTERVAL (or, when
the plant's own rates ask for it, faster), or at the rate that is given of the sensor; states are
moved by the plant's process noise. Where the plant gives no figures, readings err by RELATIVE of
what their states' natural sizes make of them (see natural_size.py), and the process moves a state
by ROUGH times as much within a mean time constant: the model is rougher than the sensors. A slow
state is moved by SLOW of that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import (
    schur,
    solve_continuous_lyapunov,
    solve_discrete_lyapunov,
)

from vsensor_ros.designer.natural_size import couplings, RELATIVE
from vsensor_ros.designer.observer import Candidate
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.quotient import Quotient

INTERVAL = 0.01  # s, between readings of a continuous plant: the replacer's default rate
PER_TIME_CONSTANT = 10.0  # readings, at least, in a mean time constant of the plant
ROUGH = 3.0
SLOW = 0.01
FAINTEST = 1e-6  # a noise of zero is taken as this much of the largest


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise in the scaled coordinates of a problem."""

    reading: np.ndarray  # (l0,) standard deviations of single readings
    lasts: np.ndarray  # (l0,) s, or steps, between readings of each sensor
    process: np.ndarray  # (n,) standard deviations per sqrt(s), or per step
    interval: float  # s between readings; 1 for a discrete plant
    sample_time: float | None
    assumed: bool  # some figures are defaults
    usual: float  # of process, where it is not given

    @property
    def intensity(self) -> np.ndarray:
        """Intensity (l0,) of white noise in the readings, per sqrt(Hz), or per step."""
        return np.asarray(self.reading * np.sqrt(self.lasts))

    def drives(self, known: Quotient) -> tuple[np.ndarray, np.ndarray]:
        """
        Return B (r, n + l0) and D (c, n + l0) of unit white noise in the quotient's terms.

        ``d xi = A xi + B w``, ``R y0 = E xi + D w`` as a filter sees them, that takes in y0.
        """
        sigma = self.intensity
        return (np.hstack([known.Phi * self.process, -known.J * sigma]),
                np.hstack([np.zeros((len(known.E), len(self.process))), known.R * sigma]))

    def error(self, problem: Problem, candidate: Candidate) -> float:
        """Return the standard deviation of vhat's steady-state error, largest row, in its unit."""
        B = np.hstack([candidate.Phi * self.process, -candidate.J * self.intensity])
        size = problem.v_size[:, None]
        return float(np.sqrt(max(0.0, self.variance(candidate.N, B, size * candidate.Cv,
                                                    size * candidate.Q))))

    def variance(self, N: np.ndarray, B: np.ndarray, Cv: np.ndarray, Q: np.ndarray) -> float:
        """Return the steady-state variance of ``Cv e - Q n``, ``d e = N e + B w``, largest row."""
        direct = np.sum((Q * self.reading) ** 2, axis=1)
        if len(N):
            try:
                X = (solve_continuous_lyapunov(N, -B @ B.T) if self.sample_time is None
                     else solve_discrete_lyapunov(N, B @ B.T))
            except (np.linalg.LinAlgError, ValueError):  # on the boundary, or beyond numbers
                return np.inf
            direct = direct + np.einsum('pi,ij,pj->p', Cv, X, Cv)
        return float(direct.max(initial=0.0))


def mean_rate(problem: Problem) -> float:
    """Return the geometric mean [1/s] of the plant's own rates, integrators left out."""
    return couplings(problem.plant).mean_rate


def usual_decay(problem: Problem) -> float:
    """Return a rate [1/s] at which an engineer wants errors to die out, if nothing is said."""
    values, h = problem.modes, problem.plant.sample_time
    rates = -values.real if h is None else -np.log(np.maximum(np.abs(values), 1e-9)) / h
    mean = mean_rate(problem)
    return float(min(0.5 * mean, rates[rates > 1e-6 * mean].min(initial=np.inf)))


def noise_model(problem: Problem) -> NoiseModel:
    """Collect the noise of a problem's plant, with defaults where it gives none."""
    plant, rate = problem.plant, mean_rate(problem)
    h, interval = plant.sample_time, interval_of(problem)
    given = plant.noise[[plant.sensors.index(s) for s in problem.healthy]] / problem.y0_size
    process = plant.process_noise / problem.scale
    usual = float(ROUGH * RELATIVE * np.sqrt(2.0 * rate * (1.0 if h is None else h)))
    return NoiseModel(
        given_or(given),
        lasts_of(problem, [plant.sensors.index(s) for s in problem.healthy], interval),
        np.where(np.isnan(process), np.where(plant.slow, SLOW, 1.0) * usual, process),
        interval, h, bool(np.isnan(given).any() or np.isnan(process).any()), usual)


def interval_of(problem: Problem) -> float:
    """Return the time [s] between readings of which no rate is given; a step when discrete."""
    return 1.0 if problem.plant.sample_time is not None else \
        min(INTERVAL, 1.0 / (PER_TIME_CONSTANT * mean_rate(problem)))


def lasts_of(problem: Problem, sensors: list[int], interval: float) -> np.ndarray:
    """Return the time [s], or steps, between readings of sensors by index."""
    own = 1.0 / problem.plant.sensor_rate[sensors]
    h = problem.plant.sample_time
    return np.where(np.isnan(own), interval, own if h is None else np.maximum(own / h, 1.0))


def given_or(given: np.ndarray) -> np.ndarray:
    """Return the noise of readings of natural size one: the usual one, where none is given."""
    reading = np.where(np.isnan(given), RELATIVE, given)
    return np.asarray(np.maximum(reading, FAINTEST * max(reading.max(initial=0.0), RELATIVE)))


@dataclass(frozen=True, eq=False)
class Filter:
    """The steady filter ``d z = A z + L (R y0 - E z) + ..``, ``v = Cv z + g R y0 + q y0``."""

    L: np.ndarray  # (r, c)
    Cv: np.ndarray  # (p, r)
    g: np.ndarray  # (p, c)
    variance: float  # of its estimate of v, largest row
    floor: float = 0.0  # the same with the newest reading used at once: nothing is better


def kalman(known: Quotient, noise: NoiseModel, shift: float = 0.0) -> Filter | None:
    """
    Return the steady Kalman filter in a quotient: no estimate from these readings is quieter.

    With ``shift`` [1/s] the quietest whose error decays at that rate. Discrete: the reading of
    the same instant is used. None where a mode on the boundary is not driven by noise.
    """
    B, D = noise.drives(known)
    cross, meter, W = B @ D.T, D @ D.T, B @ B.T
    A, E, r = known.A, known.E, known.order
    none = np.zeros((len(known.v), len(E)))
    if not len(E):
        alone = noise.variance(A, B, known.v, known.q) if shift == 0 else np.inf
        return Filter(np.zeros((r, 0)), known.v, none, alone, alone)
    meter = meter + np.eye(len(meter)) * FAINTEST**2 * np.trace(meter)
    W = W + np.eye(r) * FAINTEST**2 * np.trace(W) / r
    try:
        if noise.sample_time is None:
            P = riccati(A + shift * np.eye(r), E, W, meter, cross)
            L, Cv, g = np.linalg.solve(meter, (P @ E.T + cross).T).T, known.v, none
        else:
            grow = np.exp(shift * noise.sample_time)
            P = riccati_in_steps(grow * A, grow * E, W, meter, grow * cross)
            seen = E @ P @ E.T
            L = np.linalg.solve(grow**2 * seen + meter,
                                (grow**2 * A @ P @ E.T + grow * cross).T).T / grow
            g = np.linalg.solve(seen + meter, E @ P @ known.v.T).T
            Cv = known.v - g @ E
        N = A - L @ E
        variance = noise.variance(N, B - L @ D, Cv, g @ known.R + known.q)
        floor = variance if noise.sample_time else min(variance, _at_once(known, noise, P))
    except (np.linalg.LinAlgError, ValueError):
        return None
    return Filter(L, Cv, g, variance, floor)


def _at_once(known: Quotient, noise: NoiseModel, P: np.ndarray) -> float:
    """Return the variance of v, largest row, when a reading is added to an estimate of error P."""
    E, R = known.E, known.R * noise.reading
    q = known.q * noise.reading
    g = np.linalg.lstsq((E @ P @ E.T + R @ R.T).T, (known.v @ P @ E.T - q @ R.T).T,
                        rcond=None)[0].T
    rest = known.v - g @ E
    return float((np.einsum('pi,ij,pj->p', rest, P, rest)
                  + np.sum((g @ R + q) ** 2, axis=1)).max(initial=0.0))


def riccati_in_steps(A: np.ndarray, E: np.ndarray, W: np.ndarray, meter: np.ndarray,
                      cross: np.ndarray) -> np.ndarray:
    """
    Solve ``P = A P A' + W - K (E P E' + meter) K'``, ``K`` the gain, for the stabilising P.

    By doubling (Anderson, 1978): as many steps as the filter takes time constants, in powers of
    two. scipy's pencil takes ten times as long at 400 states.
    """
    A = A - cross @ np.linalg.solve(meter, E)
    P: np.ndarray = W - cross @ np.linalg.solve(meter, cross.T)
    G = E.T @ np.linalg.solve(meter, E)
    A = A.T
    for _ in range(60):
        inner = np.linalg.solve(np.eye(len(A)) + G @ P, np.hstack([A, G]))
        step, gain = inner[:, :len(A)], inner[:, len(A):]
        moved = A.T @ P @ step
        G = G + A @ gain @ A.T
        P = P + 0.5 * (moved + moved.T)
        A = A @ step
        if not np.isfinite(P).all():
            break
        if np.linalg.norm(moved) <= 1e-14 * np.linalg.norm(P):
            return P
    raise np.linalg.LinAlgError('a mode on the boundary')


def riccati(A: np.ndarray, E: np.ndarray, W: np.ndarray, meter: np.ndarray,
             cross: np.ndarray) -> np.ndarray:
    """
    Solve ``A P + P A' + W = (P E' + cross) meter^-1 (P E' + cross)'`` for the stabilising P.

    By the stable subspace of the Hamiltonian matrix, three times as fast as scipy's pencil.
    """
    r = len(A)
    A = A - cross @ np.linalg.solve(meter, E)
    W = W - cross @ np.linalg.solve(meter, cross.T)
    _, Z, stable = schur(np.block([[A.T, -E.T @ np.linalg.solve(meter, E)], [-W, -A]]),
                         sort='lhp')
    if stable != r:
        raise np.linalg.LinAlgError('a mode on the boundary')
    P = np.linalg.solve(Z[:r, :r].T, Z[r:, :r].T).T
    return np.asarray(0.5 * (P + P.T))
