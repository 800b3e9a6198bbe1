"""
A problem with some of its unknown inputs given up: they are to disturb as little as may be.

As many unknown inputs as can be are decoupled exactly; against the others stand Kalman filters for
which they are white noise of growing intensity. Source: method 2 (SVD fallback) and 3.6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vsensor_ros.designer import invariant_spaces
from vsensor_ros.designer.candidates import Ground, grounds, judged, JudgedCandidate
from vsensor_ros.designer.existence import avoidable_signs, examine, Existence
from vsensor_ros.designer.gain import peak_on_grid
from vsensor_ros.designer.noise import (
    Filter,
    kalman,
    mean_rate,
    noise_model,
    NoiseModel,
    usual_decay,
)
from vsensor_ros.designer.observer import Candidate
from vsensor_ros.designer.order_noise import SLUGGISH
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.plant import Plant

NOISE_FACTOR = 4.0  # the quietest's noise may grow so much for less disturbance
EXACT = 1.2  # decoupling from one input may raise what the others do by this factor
INTENSITIES = 10.0 ** np.arange(-1, 7)  # of unknown inputs, against the process noise
BISECTIONS = 4  # of the intensity, to the limit of the noise


@dataclass(frozen=True, eq=False)
class Disturbed(NoiseModel):
    """
    Noise together with unknown inputs that are not decoupled.

    A filter is made for both; what is then judged is noise and disturbance, each for itself.
    """

    D: np.ndarray  # (n, d), in the scaled coordinates, per unit of rho
    Cd: np.ndarray  # (l0, d)
    Vd: np.ndarray  # (p, d)
    v_size: np.ndarray  # (p,)
    weight: np.ndarray  # (d,) intensity that filters are made for
    limit: float  # of the noise, in the unit of the channel

    def drives(self, known):  # type: ignore[no-untyped-def]
        """Append the unknown inputs to the columns of the noise."""
        B, D = super().drives(known)
        return (np.hstack([B, (known.Phi @ self.D - known.J @ self.Cd) * self.weight]),
                np.hstack([D, known.R @ self.Cd * self.weight]))

    def variance(self, N: np.ndarray, B: np.ndarray, Cv: np.ndarray, Q: np.ndarray) -> float:
        """
        Return what a search is to make small.

        Where B holds the unknown inputs besides the noise (see ``drives``) this is the square of
        their gain, made larger where the noise is beyond the limit; else it is the noise.
        """
        noisy = len(self.process) + len(self.reading)
        if B.shape[1] == noisy:
            return super().variance(N, B, Cv, Q)
        size = self.v_size[:, None]
        noise = super().variance(N, B[:, :noisy], size * Cv, size * Q)
        gain = peak_on_grid(N, B[:, noisy:] / self.weight, size * Cv,
                        size * (self.Vd - Q @ self.Cd), self.sample_time)[0]
        return gain**2 * max(1.0, noise / self.limit**2) ** 4

    def gain(self, candidate: Candidate) -> float:
        """Return the peak over a grid of frequencies of the unknown inputs' gain."""
        size = self.v_size[:, None]
        return peak_on_grid(candidate.N, candidate.Phi @ self.D - candidate.J @ self.Cd,
                        size * candidate.Cv, size * (self.Vd - candidate.Q @ self.Cd),
                        self.sample_time)[0]


@dataclass(frozen=True, eq=False)
class Relaxed:
    """A problem with only those unknown inputs left that can be decoupled together."""

    original: Problem
    problem: Problem
    existence: Existence
    avoid: frozenset[int]  # nonlinear terms to be decoupled from besides
    kept: tuple[int, ...]  # unknown inputs that disturb
    floor: float  # noise of the quietest, when nothing is decoupled
    least: float  # disturbance of the least disturbed Kalman filter
    order: int  # of that filter
    quick: bool  # whether that filter is fast enough to be taken

    @property
    def limit(self) -> float:
        """Return the noise that is allowed, in the unit of the channel."""
        return NOISE_FACTOR * self.floor

    def noise(self, plain: NoiseModel, intensity: float) -> Disturbed:
        """Return the noise of the problem together with the unknown inputs that disturb."""
        problem, plant, kept = self.problem, self.original.plant, list(self.kept)
        rows = [plant.sensors.index(s) for s in problem.healthy]
        D = plant.D[:, kept] / problem.scale[:, None]
        Cd = plant.Cd[rows][:, kept] / problem.y0_size[:, None]
        Vd = self.original.wanted[2][:, kept] / problem.v_size[:, None]
        size = np.where(D.any(axis=0), np.linalg.norm(D, axis=0),
                        np.linalg.norm(np.vstack([Cd, Vd]), axis=0))
        size = np.where(size > 0, size, 1.0)
        rate = mean_rate(problem) * (1.0 if plain.sample_time is None else plain.sample_time)
        unit = max(_mean_square(plain.process), _mean_square(plain.reading) * np.sqrt(2 * rate))
        return Disturbed(plain.reading, plain.lasts, plain.process, plain.interval,
                         plain.sample_time, plain.assumed, plain.usual, D, Cd, Vd, problem.v_size,
                         intensity * unit / size, self.limit)


def relax(problem: Problem) -> Relaxed | None:
    """
    Give up decoupling from as few unknown inputs as leave a stable virtual sensor.

    The unknown inputs are tried one after the other, beginning with the one that would disturb
    most. One is decoupled if that is possible together with all that are decoupled already, and
    if the rest disturb not much more for it. None when no virtual sensor is stable even without
    decoupling.
    """
    plant = problem.plant
    several = range(len(plant.disturbances))
    best = decouple(problem, (), None) if several else None
    if best is None or len(several) == 1:
        return best
    ground = grounds_of(best, None)[0]
    noise = best.noise(ground.noise, 1.0)
    gains = [min((replace(noise, D=noise.D[:, [i]], Cd=noise.Cd[:, [i]], Vd=noise.Vd[:, [i]]).gain(
        c.candidate) for c in judged_filters(ground, [ground.filter])), default=0.0)
             for i in several]
    floor, enough = best.floor, EXACT * best.least
    decoupled: tuple[int, ...] = ()
    for i in sorted(several, key=lambda i: -gains[i]):
        chosen = tuple(sorted((*decoupled, i)))
        # that not all can be is known, though it may have taken exact arithmetic to tell
        more = decouple(problem, chosen, floor) if len(chosen) < len(several) else None
        if more is not None and more.least <= enough:
            best, decoupled = more, chosen
    return best


def decouple(problem: Problem, decoupled: tuple[int, ...], floor: float | None,
             ) -> Relaxed | None:
    """Decouple from some unknown inputs; None when there is no stable virtual sensor then."""
    plant = problem.plant
    columns = list(decoupled)
    easier = _posed(problem, replace(
        plant, disturbances=tuple(plant.disturbances[i] for i in columns),
        D=plant.D[:, columns], Cd=plant.Cd[:, columns]))
    existence = examine(easier)
    if existence.obstruction is not None:
        return None
    signs = avoidable_signs(easier)
    kept = tuple(i for i in range(len(plant.disturbances)) if i not in decoupled)
    relaxed = Relaxed(problem, easier, existence, signs, kept, np.inf, np.inf, 0, False)
    ground = grounds_of(relaxed, None)[0]
    filters = swept(relaxed, ground, floor)
    if not filters:
        return None
    floor = min(c.error for _, c in filters) if floor is None else floor
    inside = [(noise.gain(c.candidate), c.order, c.decay >= SLUGGISH * ground.decay)
              for noise, c in filters if c.error <= NOISE_FACTOR * floor]
    least, order, quick = min(inside, default=(np.inf, 0, False))
    return replace(relaxed, floor=floor, least=least, order=order, quick=quick)


def _posed(problem: Problem, plant: Plant) -> Problem:
    """Pose a problem for another plant of the same states."""
    sensor = problem.channel in plant.sensors
    return pose(plant, problem.fault_set, problem.channel, None if sensor else problem.wanted[0])


def grounds_of(relaxed: Relaxed, decay: float | None) -> list[Ground]:
    """Return the grounds of the relaxed problem, as ``candidates.grounds`` does."""
    problem = relaxed.problem
    return grounds(problem, relaxed.existence, relaxed.avoid, noise_model(problem),
                   usual_decay(problem) if decay is None else decay)


def judged_filters(ground: Ground, found: list[Filter | None], method: str = 'filter',
                   ) -> list[JudgedCandidate]:
    """Judge filters; None among them is a filter that does not exist."""
    return judged(ground, [invariant_spaces.filter_candidate(ground.known, f, ground.terms)
                           for f in found if f is not None], method)


def swept(relaxed: Relaxed, ground: Ground, floor: float | None,
          ) -> list[tuple[Disturbed, JudgedCandidate]]:
    """
    Return Kalman filters for unknown inputs of growing intensity, up to the noise limit.

    ``floor``: noise of the quietest filter, of which the limit is a multiple; by default the
    least noise of the filters found here.
    """
    found: list[tuple[Disturbed, JudgedCandidate]] = []

    def tried(intensity: float) -> bool:
        noise = relaxed.noise(ground.noise, intensity)
        for candidate in judged_filters(ground, [kalman(ground.known, noise)]):
            found.append((noise, candidate))
            least = min(c.error for _, c in found) if floor is None else floor
            return candidate.error > NOISE_FACTOR * least
        return False

    low = high = 0.0
    for intensity in INTENSITIES:
        if tried(intensity):
            high = intensity
            break
        low = intensity
    if low and high:
        for _ in range(BISECTIONS):
            middle = np.sqrt(low * high)
            low, high = (low, middle) if tried(middle) else (middle, high)
    return found


def _mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
