"""
The steps of one nonlinear virtual sensor, several runs of it at once.

A state is z; what was said last (of an angle: which turn), and its standard deviation; the
covariance of z (k, k); and `bends.py`: by how much z may be off as readings are curved. Continuous
ones are stepped by the exponential Rosenbrock method exprb32 (Hochbruck, Ostermann): exact where F
is linear, so that it may be stiff, and of the third order else, in as many parts as the slopes ask
for.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from scipy.linalg import expm

from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Apply, names, Node, Number, parse, walk
from vsensor_ros.observers.kinds.nonlinear.bends import Bends
from vsensor_ros.observers.kinds.nonlinear.sensor import names_in, NonlinearSensor

FINE = 0.1  # of the largest slope times a part of a step
MOST_PARTS = 8  # of a step
SMALL, TERMS = 0.2, 10  # slopes whose series of so many terms is exact but for rounding
STALE = 1.5  # times what is between readings, or steps: then a reading is one no more
OFF = 2.0  # standard deviations: so far off it is looked at what would be said there
BLIND = 1e99  # the deviation where nothing is known
BENT = 1e-2  # of a variance: what slopes may not say of it
FAINTEST = 1e-12  # of a variance: what is less is lost in its digits
_BENDING = ('/', 'sqrt', 'log', '**', 'tan', 'asin')  # what may have no finite slope


class Motion:
    """Steps runs of one virtual sensor over a period [s], for readings of these L sensors."""

    def __init__(self, entry: NonlinearSensor, sensors: Sequence[str], inputs: Sequence[str],
                 period: float) -> None:
        self.k, self._L = len(entry.z), len(sensors)
        k = self.k
        self.value, self.deviating = k, k + 1  # where they stand
        self._P, self._off = slice(k + 2, k + 2 + k * k), slice(k + 2 + k * k, 2 * k + 2 + k * k)
        self._entry, self.continuous = entry, entry.sample_time is None
        self._h = period if self.continuous else 1.0
        known = (*entry.z, *sensors, *inputs)

        def compiled(texts: Sequence[str]) -> Equations:
            return Equations([parse(text) for text in texts], known)
        self._F, self._out = compiled(entry.F), compiled([entry.out])
        self._driven = compiled(entry.driven)
        self._validity = compiled([c.positive for c in entry.validity])
        # nothing but what is proved may change one that converges
        kept = entry.residuals if entry.grade == 'temporary' else ()
        self._free = compiled(kept)
        self._tracked = compiled((*kept, *entry.tracks))
        noise, lasts = (np.array([by.get(name, 0.0) for name in sensors])
                        for by in (entry.noise_of, entry.lasts))
        self._variance = noise**2
        self._bends = Bends([self.continuous and name in names_in(entry.F) for name in sensors],
                            np.maximum(lasts, self._h), self._h)
        self._told = slice(self._off.stop, self._off.stop + self._bends.width)
        self.width = self._told.stop
        # a reading that is held for so long pushes for so long
        self._push = self._variance * np.maximum(lasts, self._h)
        self._meter = self._variance * np.maximum(lasts / period, 1.0)
        self._stale = STALE * np.maximum(lasts, period)
        self._reads = [np.array([name in used for name in sensors], dtype=bool) for used in (
            names_in(kept), names_in((*kept, *entry.tracks)))]
        self._heard = [i for i, name in enumerate(sensors)
                       if name in names_in([entry.out]) and noise[i]]
        divisors = {name for text in entry.F for name in steep_names(parse(text))}
        self._stops = np.array([not divisors.isdisjoint(names(parse(c.positive)))
                                for c in entry.validity], dtype=bool)

    def start(self, y: np.ndarray, u: np.ndarray, count: int, tracked: bool) -> np.ndarray:
        """Return the first states (count, width); NaN where it cannot run."""
        z = np.tile(self.state(self._entry.initial, self._entry.start), (count, 1))
        if tracked:
            for _ in range(3):  # it may be anywhere: the slopes are those of where it ends
                fresh = self.corrected(z, y, u, True)
                z[:, :self.k] = fresh[:, :self.k]
            z = fresh
        return self.said(z, y, u)

    def state(self, x: np.ndarray, P: np.ndarray) -> np.ndarray:
        """Return a state (width,) of z (k,) and its covariance (k, k)."""
        return np.concatenate([x, np.zeros(2), P.ravel(), np.zeros(self.width - self._P.stop)])

    def covariance(self, z: np.ndarray) -> np.ndarray:
        """Return the covariances (R, k, k) in states."""
        return z[:, self._P].reshape(len(z), self.k, self.k)

    def step(self, z: np.ndarray, begin: np.ndarray, end: np.ndarray,
             ages: np.ndarray) -> np.ndarray:
        """
        Step states from readings and inputs (L + m,) at the beginning to those at the end.

        ages (2, L): how far from readings they are, see `Told`.
        """
        if not self.k:
            return z
        z, P = z.copy(), self.covariance(z)
        x = z[:, :self.k]
        if not self.continuous:
            f, J, _, W, _ = self._slopes(x, begin, np.zeros_like(begin))
            z[:, :self.k], P = f, J @ P @ J.transpose(0, 2, 1) + W
        else:
            P = self._flown(z, P, begin, end, ages)
        z[:, self._P] = P.reshape(len(z), -1)
        return z

    def _flown(self, z: np.ndarray, P: np.ndarray, begin: np.ndarray, end: np.ndarray,
               ages: np.ndarray) -> np.ndarray:
        """Put z, what it may be off and what is told of bends in place; return covariances."""
        x, off, parts, at = z[:, :self.k], z[:, self._off], 0, 0
        z[:, self._told], way, left = self._bends.over(z[:, self._told], begin, end, ages)
        while at < max(parts, 1):
            share = at / max(parts, 1)
            f, J, drift, W, by = self._slopes(x, *way(share))
            if not parts:
                steepest = np.abs(J[np.isfinite(J).all(axis=(1, 2))]).sum(axis=2).max(initial=0.0)
                parts = int(min(max(1.0, math.ceil(self._h * steepest / FINE)), MOST_PARTS))
            h = self._h / parts
            E, one, two, three = _phi(np.where(np.isfinite(J), J, 0.0) * h)
            first = x + h * _times(one, f) + h * h * _times(two, drift)
            ended = self._F.values(self._at(first, way(share + 1 / parts)[0])).T
            bent = ended - f - _times(J, first - x) - h * drift
            x = first + 2.0 * h * _times(three, bent)
            off = _times(E, off) + h * _times(one, _times(by, left))
            P = E @ P @ E.transpose(0, 2, 1) + h * W
            at += 1
        z[:, :self.k], z[:, self._off] = x, off
        return P

    def _slopes(self, x: np.ndarray, v: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, ...]:
        """
        Return F (R, k) and more, at readings and inputs (.., L + m) that change at a rate.

        That is its slopes by z (R, k, k), what the rate adds (R, k), noise (R, k, k), and the
        slopes by readings (R, k, L).
        """
        f, slopes = self._F.slopes(self._at(x, v))
        slopes = slopes.transpose(2, 0, 1)
        by = slopes[:, :, self.k:self.k + self._L]
        W = (by * self._push) @ by.transpose(0, 2, 1) + np.diag(self._entry.process_noise**2)
        if self._entry.driven:
            G = self._driven.values(self._at(x, v)).T.reshape(len(x), self.k, -1)
            W = W + G @ G.transpose(0, 2, 1)
        return f.T, slopes[:, :, :self.k], (slopes[:, :, self.k:] @ rate[..., None])[..., 0], \
            W, by

    def linear(self, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return slopes of F by z and what noise drives it by (R, k, k), at z and readings."""
        _, J, _, W, _ = self._slopes(x, v, np.zeros_like(v))
        return J, W

    def deviation(self, z: np.ndarray, y: np.ndarray, u: np.ndarray) -> float:
        """Return the standard deviation of what one state (1, width) says."""
        return float(self.said(z, y, u)[0, self.deviating])

    def _at(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.concatenate([x.T, np.broadcast_to(v, (len(x), v.shape[-1])).T])

    def fresh(self, ages: np.ndarray, tracked: bool) -> bool:
        """Tell whether all that corrects was read just now; ages (L,) s, or (0,)."""
        return not (ages.size and (ages > self._stale)[self._reads[tracked]].any())

    def corrected(self, z: np.ndarray, y: np.ndarray, u: np.ndarray, tracked: bool) -> np.ndarray:
        """Return states corrected by what is 0 in truth, as a Kalman filter does."""
        k, by = self.k, self._tracked if tracked else self._free
        x, P = z[:, :k], self.covariance(z)
        off, slopes = by.slopes(self._at(x, np.concatenate([y, u])))
        if not len(off):
            return z
        slopes = slopes.transpose(2, 0, 1)
        H, G = slopes[:, :, :k], slopes[:, :, k:k + self._L]
        meter = (G * self._meter) @ G.transpose(0, 2, 1)
        one = np.eye(meter.shape[1])
        if k > 1:  # a circle tells less of where P is along it than its slopes say
            sizes = (np.abs(H) @ np.sqrt(np.abs(np.diagonal(P, axis1=1, axis2=2)))[:, :, None])**2
            meter = meter + BENT * one * (sizes + np.diagonal(meter, axis1=1, axis2=2)[:, :, None])
        S = H @ P @ H.transpose(0, 2, 1) + meter
        S = S + FAINTEST * np.trace(S, axis1=1, axis2=2)[:, None, None] * one
        known = np.isfinite(S).all(axis=(1, 2)) & (np.trace(S, axis1=1, axis2=2) > 0.0)
        S = np.where(known[:, None, None], S, one)
        K = np.linalg.solve(S, H @ P).transpose(0, 2, 1)
        K[~known] = 0.0
        left = np.eye(k) - K @ H
        P = left @ P @ left.transpose(0, 2, 1) + K @ meter @ K.transpose(0, 2, 1)
        z = z.copy()
        z[:, :k] = x - _times(K, off.T)
        z[:, self._P] = ((P + P.transpose(0, 2, 1)) / 2.0).reshape(len(z), -1)
        z[:, self._off] = _times(left, z[:, self._off])
        return z

    def said(self, z: np.ndarray, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return states with what they say; NaN where a condition of F fails."""
        at = self._at(z[:, :self.k], np.concatenate([y, u]))
        found, deviation = self._spoken(at, z)
        z = z.copy()
        told = self.turned(found, z[:, self.value])
        z[:, self.value] = np.where(np.isfinite(told), told, z[:, self.value])
        z[:, self.deviating] = np.minimum(np.where(np.isfinite(found), deviation, BLIND), BLIND)
        failing = self.failing(z, y, u)[self._stops].any(axis=0)
        z[failing] = np.nan
        return z

    def _spoken(self, at: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return what is said (R,) at points (.., R), and its standard deviation.

        By slopes, and by what is said two standard deviations off to either side: near a pole or
        the end of a root the slope tells less. Beyond that end nothing is known.
        """
        k, R = self.k, len(z)
        values, vectors = np.linalg.eigh(np.where(np.isfinite(P := self.covariance(z)), P, 0.0))
        own = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]).transpose(2, 1, 0)
        off = np.zeros((k + 1 + len(self._heard), len(at), R))
        off[:k, :k], off[k, :k] = own, z[:, self._off].T
        for j, sensor in enumerate(self._heard, k + 1):
            off[j, k + sensor] = math.sqrt(self._variance[sensor])
        points = (at + OFF * np.concatenate([off, -off])).transpose(1, 0, 2).reshape(len(at), -1)
        with np.errstate(all='ignore'):
            found, slopes = self._out.slopes(at)
            apart = self._out.values(points).reshape(2, len(off), R) - found[0]
        if self._entry.turn:
            apart = self.turned(apart, np.zeros(1))
        steps = np.maximum(np.abs(apart).max(axis=0) / OFF, np.abs((slopes[0] * off).sum(axis=1)))
        return found[0], np.sqrt((np.where(np.isfinite(steps), steps, BLIND)**2).sum(axis=0))

    def turned(self, value: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Return values, of what goes round next to others."""
        turn = self._entry.turn
        return value if not turn else near + np.remainder(
            value - near + turn / 2.0, turn) - turn / 2.0

    def failing(self, z: np.ndarray, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return which conditions fail (conditions, R)."""
        if not len(self._stops):
            return np.zeros((0, len(z)), dtype=bool)
        return np.logical_not(self._validity.values(
            self._at(z[:, :self.k], np.concatenate([y, u]))) > 0.0)

    def says(self, z: np.ndarray, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return what states (N, ..) say with readings (N, L) and inputs (N, m)."""
        value = self._out.values(np.concatenate([z[:, :self.k].T, y.T, u.T]))[0]
        return self.turned(value, z[:, self.value])


def _phi(M: np.ndarray) -> list[np.ndarray]:
    """Return exp(M) of matrices (R, k, k), and phi_1, phi_2, phi_3: (phi_n - 1/n!) / M is next."""
    k = M.shape[1]
    whole = np.zeros((len(M), 4 * k, 4 * k))
    whole[:, :k, :k] = M
    for n in range(3):
        whole[:, n * k:(n + 1) * k, (n + 1) * k:(n + 2) * k] = np.eye(k)
    if np.abs(M).sum(axis=2).max(initial=0.0) > SMALL:
        found = expm(whole)
    else:
        found = power = np.eye(4 * k)
        for n in range(1, TERMS):
            power = power @ whole / n
            found = found + power
    return [found[:, :k, n * k:(n + 1) * k] for n in range(4)]


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return the products of (R, i, j) and (R, j)."""
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def steep_names(node: Node) -> set[str]:
    """Return the names in those parts that could have no finite value or slope."""
    found: set[str] = set()
    for part in walk(node):
        if isinstance(part, Apply) and part.function in _BENDING:
            argument = part.arguments[1 if part.function == '/' else 0]
            whole = part.function == '**' and isinstance(part.arguments[1], Number) and \
                part.arguments[1].value >= 1.0
            if not whole:
                found.update(names(argument))
    return found
