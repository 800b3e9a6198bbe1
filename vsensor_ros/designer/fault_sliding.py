"""
The size of a fault by a sliding mode: the papers' identification, with its conditions corrected.

An observer ``d z = N z + J y + ..`` of Phi x reads all sensors, the faulty one, too. With
(E1) ``Phi A = N Phi + J C``, (E2) ``Phi D = 0`` and a residual ``R y - C_* z`` that the fault does
not reach directly (``R C = C_* Phi``, ``R Df = 0``) it moves by ``d e = N e + f d``. An injection
along f that keeps the residual at zero is d, if ``C_* f`` is not 0, the zeros of (N, f, C_*) are
stable, and it is larger than d. Source: paper S, section 4; method, section 2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm, solve_discrete_lyapunov

from vsensor_ros.designer.fault_walk import fault_columns, of_readings
from vsensor_ros.designer.invariant_spaces import filter_candidate
from vsensor_ros.designer.isolability import blind_to, Checks, checks
from vsensor_ros.designer.noise import Filter, noise_model, NoiseModel, riccati, usual_decay
from vsensor_ros.designer.observer import build
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.quotient import Quotient
from vsensor_ros.designer.stability import lasting
from vsensor_ros.designer.start import started
from vsensor_ros.designer.subspaces import kernel, left_kernel, RANK_TOLERANCE, unobservable
from vsensor_ros.observers import Noise, VirtualSensor
from vsensor_ros.observers.fault_size import Injection, observer_name, SLIDING
from vsensor_ros.observers.injection import first_order, super_twisting
from vsensor_ros.plant import Plant
from vsensor_ros.reason import Reason

FASTER = 1.5  # times the rate that would just make the error of the residual die out
STEPS = 100  # of a response, at most, in which noise is looked at
RUNS = 64
SEED = 1


@dataclass(frozen=True, eq=False)
class Sliding:
    """An observer whose output is the residual, and what moves that; k states, w noises."""

    observer: VirtualSensor
    injection: Injection
    drive: np.ndarray  # (k, w) of unit white noise per sqrt(s) to e, of what is given
    rough: np.ndarray  # (k, w) with the defaults of the process
    reading: float  # standard deviation of a single residual beside ``c e``
    interval: float  # s between readings

    def first_order(self, response: float, drive: np.ndarray) -> float:
        """Return the standard deviation of the size by the first order, filtered."""
        h, A, W, reading = self._steps(response, drive)
        k, of = len(A), self.injection
        size, step = first_order(replace(of, largest=np.inf), response, h)
        # it is linear while it does not saturate
        F = step(np.eye(size), np.zeros(size)).T
        b = step(np.zeros((1, size)), np.ones(1))[0]
        # e of the plant, then the state of the step, which hears c e
        moves = np.block([[A, np.zeros((k, size))], [np.outer(b, of.c @ A), F]])
        ways = np.vstack([np.eye(k), np.outer(b, of.c)])
        Q = ways @ W @ ways.T
        Q[k:, k:] += reading ** 2 * np.outer(b, b)
        return float(np.sqrt(max(0.0, solve_discrete_lyapunov(moves, Q)[-1, -1])))

    def change(self, response: float, plain: float) -> float | None:
        """Return the rate with which 63 % of a step ``plain`` is told in time; None: none is."""
        h, A, _, _ = self._steps(response, self.drive)
        of, k = self.injection, len(A)
        rates = plain / response * np.geomspace(0.1, 30.0, 60)
        size, step = super_twisting(of, h, rates)
        state: np.ndarray = np.zeros((len(rates), size))
        e, told = np.zeros(k), np.zeros(len(rates))
        held = expm(np.block([[of.N, of.f[:, None]], [np.zeros((1, k + 1))]]) * h)[:-1, -1]
        for _ in range(round(response / h)):
            e = A @ e + held * plain
            state = step(state, np.full(len(rates), of.c @ e))
            told = np.maximum(told, state[:, -1])
        enough = np.flatnonzero(told >= (1.0 - np.exp(-1.0)) * plain)
        return float(rates[enough[0]]) if len(enough) else None

    def twisting(self, response: float, change: float, drive: np.ndarray) -> float:
        """Return the standard deviation of the size by super-twisting, from random runs."""
        h, A, W, reading = self._steps(response, drive)
        k, of = len(A), self.injection
        values, vectors = np.linalg.eigh(W)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        random = np.random.default_rng(SEED)
        size, step = super_twisting(of, h, np.full(RUNS, change))
        state, e, squares = np.zeros((RUNS, size)), np.zeros((RUNS, k)), 0.0
        settle, count = 5 * round(response / h), 10 * round(response / h)
        for i in range(settle + count):
            e = e @ A.T + random.standard_normal((RUNS, k)) @ root.T
            state = step(state, e @ of.c + reading * random.standard_normal(RUNS))
            squares += float(np.mean(state[:, -1] ** 2)) if i >= settle else 0.0
        return float(np.sqrt(squares / count))

    def _steps(self, response: float, drive: np.ndarray,
               ) -> tuple[float, np.ndarray, np.ndarray, float]:
        """Return h [s], and of steps of h A (k, k), the noise of e (k, k), and of a reading."""
        h = max(self.interval, response / STEPS)
        N, k = self.injection.N, len(self.injection.N)
        moved = expm(np.block([[-N, drive @ drive.T], [np.zeros((k, k)), N.T]]) * h)  # Van Loan
        A = moved[k:, k:].T
        P = A @ moved[:k, k:]
        return h, A, (P + P.T) / 2.0, float(self.reading * np.sqrt(self.interval / h))


def sliding(plant: Plant, channel: str, largest: float) -> Sliding | Reason:
    """Return the observer for a channel and faults up to so large; else why there is none."""
    if plant.sample_time is not None:
        return Reason.of('sliding, sampled')
    problem, moves, shows = _posed(plant, channel)
    found = checks(problem)
    known = found.slopes
    if _reaches(known, shows):
        # as if the state that it reads were disturbed: what is left reads it, and checks others
        t = np.linalg.lstsq(problem.C0, problem.Y @ shows, rcond=None)[0]
        size = np.linalg.norm(t)
        if size > 0.0:  # it reads states, not commands alone
            found = checks(replace(problem, D=np.hstack([problem.D, (t / size)[:, None]])))
            known = found.slopes
        if _reaches(known, shows):
            return Reason.of('sliding, reads it', channel=channel)
    if not known.order or not len(known.E):
        return Reason.of('sliding, nothing checks', names=plant.disturbances)
    f = known.Phi @ moves - known.J @ shows
    seen = known.E @ f
    if np.linalg.norm(f) == 0.0 or np.linalg.norm(seen) <= (
            RANK_TOLERANCE * np.linalg.norm(known.E, 2) * np.linalg.norm(f)):
        return Reason.of('sliding, not in the derivative', channel=channel)
    noise = noise_model(problem)
    spread = (known.R * noise.reading) @ (known.R * noise.reading).T
    spread += 1e-12 * np.trace(spread) * np.eye(len(spread))
    p = np.linalg.solve(spread, seen)
    p /= p @ seen  # p E f = 1, as quiet as can be
    L = _gain(found, noise, f, p)
    return L if isinstance(L, Reason) else _built(plant, found, channel, f, p, L, largest)


def _reaches(known: Quotient, shows: np.ndarray) -> bool:
    """Tell whether a fault of the readings is in a residual directly."""
    return np.abs(known.R @ shows).max(initial=0.0) > RANK_TOLERANCE * np.abs(shows).max()


def _posed(plant: Plant, channel: str) -> tuple[Problem, np.ndarray, np.ndarray]:
    """Return the problem of all sensors, and the fault's columns in its scaled coordinates."""
    problem = blind_to(plant, ())
    moves, shows = fault_columns(plant, channel)
    return problem, moves / problem.scale, shows / problem.y0_size


def _gain(found: Checks, noise: NoiseModel, f: np.ndarray, p: np.ndarray) -> np.ndarray | Reason:
    """
    Return L (r, c) with stable ``N = A - L E`` and a stable motion where the residual is zero.

    There e = T w: that part of L decides what is left; along f, how the residual comes to zero.
    """
    known = found.slopes
    c = p @ known.E
    T = kernel(c[None, :])
    # rows that take w out of e, and nothing of f
    Y = np.linalg.pinv(T) @ (np.eye(known.order) - np.outer(f, c))
    A, E = Y @ known.A @ T, known.E @ T
    L: np.ndarray = np.zeros((known.order, len(known.E)))
    if len(A):
        hidden = unobservable(A, E)
        zeros, stay = lasting(hidden.T @ A @ hidden, None, known.speed)
        if stay.any():
            return Reason.of('sliding, zero stays', rate=float(zeros[stay].real.max()))
        if lasting(A, None, known.speed)[1].any():
            process = Y @ (known.Phi * noise.process)
            sigma = known.R * noise.intensity
            meter = sigma @ sigma.T + 1e-12 * np.trace(sigma @ sigma.T) * np.eye(len(sigma))
            W = process @ process.T
            W = W + 1e-6 * np.trace(W) / len(W) * np.eye(len(W))
            try:
                P = riccati(A, E, W, meter, np.zeros((len(A), len(meter))))
            except (np.linalg.LinAlgError, ValueError):
                return Reason.of('size, no filter')
            L = T @ np.linalg.solve(meter, E @ P).T
    push = max(abs(float(c @ known.A @ f)), known.speed, usual_decay(found.problem))
    for _ in range(40):
        whole = L + push * np.outer(f, p)
        if not lasting(known.A - whole @ known.E, None, known.speed)[1].any():
            return whole
        push *= FASTER
    return Reason.of('size, no filter')


def _built(plant: Plant, found: Checks, channel: str, f: np.ndarray, p: np.ndarray,
           L: np.ndarray, largest: float) -> Sliding | Reason:
    problem = replace(found.problem, channel=observer_name(channel))
    known = replace(found.known, v=np.zeros((1, found.known.order)),
                    q=np.zeros((1, len(problem.healthy))))
    steady = Filter(L, -p[None, :] @ known.E, p[None, :], np.nan)
    made = build(problem, filter_candidate(known, steady, found.arguments), SLIDING)
    if made is None:
        return Reason.of('size, no filter')
    slopes, noise = found.slopes, noise_model(problem)
    N, J, c = slopes.A - L @ slopes.E, slopes.J + L @ slopes.R, p @ slopes.E
    W = left_kernel(unobservable(N, c[None, :]))  # what the residual shows of e

    def drive(noise: NoiseModel) -> np.ndarray:
        return W @ np.hstack([slopes.Phi * noise.process, -J * noise.intensity])

    reading = float(np.linalg.norm(p @ slopes.R * noise.reading))
    made = replace(started(problem, made), noise=Noise(reading, reading, noise.assumed))
    return Sliding(made, Injection(W @ N @ W.T, W @ f, c @ W.T, largest, 0.0),
                   drive(of_readings(plant, noise)), drive(noise), reading, noise.interval)
