"""
The steps of extended Kalman filters that consider their parameters, many of one model at once.

A state of k numbers is: the n states, their covariance, that with the parameters (n, p), the mean
over a while of what each of the L sensors said beside what was expected, the angle where the model
has one, and the worst of those means. Of an angle states are cosine and sine: then a sensor of it
is read as two more, of its cosine and of its sine, and the angle goes on and on.
"""

from __future__ import annotations

import math

import numpy as np

from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse
from vsensor_ros.observers.kinds.batch import Told
from vsensor_ros.observers.kinds.extended.sensor import Model

WHILE = 0.1  # s over which the mean of what sensors say beside what is expected is taken
# the mean square of such means, in their own standard deviations: beyond the one the deviation is
# widened, beyond the other nothing is served any more. Of white noise 1 is usual; chosen on runs
# 0 to 2 of the two-link arm, where up to 21 was seen and all was well, and on simulated ones
MILD, LOST = 4.0, 25.0
STALE = 1.5  # times what is between readings, or steps: then a reading is one no more
FAINTEST = 1e-12  # of a variance: what is less is lost in its digits
ANYWHERE = math.pi / math.sqrt(3.0)  # rad, deviation of an angle of which nothing is known
NEARER = 5  # times that the first readings are taken to tell where an immersed model starts


class Filter:
    """
    Steps R filters of one model over a period [s].

    reads (R, L) bool: who corrects each; healthy (R, L): whose readings tell that the model does
    not hold, of nobody while the channels correct. clean: readings come without Cu u.
    """

    def __init__(self, model: Model, period: float, reads: np.ndarray, healthy: np.ndarray,
                 clean: bool = False) -> None:
        self._model, self._discrete = model, model.sample_time is not None
        self._h = 1.0 if self._discrete else period
        self._equations = Equations([parse(text) for text in model.equations], (
            *model.states, *model.inputs, *model.unknown, *model.parameters))
        self._n, self._p = len(model.states), len(model.parameters)
        n, p = self._n, self._p
        # sensors of the angle, and of all that are read which of the L that is
        self._turning = np.flatnonzero(model.factors)
        of = np.concatenate([np.arange(len(model.C)), self._turning, self._turning])
        self._own, self._factors = of, model.factors[self._turning]
        self.width = n + n * n + n * p + len(of) + bool(model.angle) + 1
        self._cuts = np.cumsum([n, n * n, n * p, len(of), int(bool(model.angle))]).tolist()
        self._reads, self._healthy = reads[:, of], healthy[:, of]
        self._all, noise = model.C, model.noise
        if model.angle:
            circle = np.repeat(np.eye(n)[list(model.circle)], len(self._turning), axis=0)
            self._all = np.vstack([model.C, circle])
            noise = np.concatenate([noise, *[noise[self._turning] / np.abs(self._factors)] * 2])
        self._C = self._all * self._reads[:, :, None]
        self._Cu = np.zeros((len(of), model.Cu.shape[1])) if clean else model.Cu[of]
        # of readings that are rarer than steps, each counts for many of these
        self._meter = np.diag(noise**2 * np.maximum(model.lasts[of] / period, 1.0))
        self._stale = STALE * np.maximum(model.lasts, period)
        self._drive = np.concatenate([model.input_noise, model.unknown_noise])**2
        self._variance = model.spreads**2
        self._share = min(1.0, period / WHILE)  # of a new value in the mean over a while
        self._usual = self._share / (2.0 - self._share) * np.maximum(
            self._healthy.sum(axis=1), 1)

    def of(self, rows: np.ndarray) -> Filter:
        """Return one of some of the filters alone; rows (r,) int may repeat."""
        found = object.__new__(Filter)
        found.__dict__.update(self.__dict__)
        for name in ('_reads', '_healthy', '_C', '_usual'):
            setattr(found, name, getattr(self, name)[rows])
        return found

    def _with(self, ages: np.ndarray) -> Filter:
        """Return one that leaves out what is no reading any more; ages (L,) s, or (0,)."""
        if not (ages.size and (stale := ages > self._stale).any()):
            return self
        found = object.__new__(Filter)
        found.__dict__.update(self.__dict__)
        fresh = ~stale[self._own]
        found._reads, found._healthy = self._reads & fresh, self._healthy & fresh
        found._C = self._C * fresh[:, None]
        return found

    def start(self, told: Told) -> np.ndarray:
        """
        Return the first states (R, k): what readings say of the start that is expected.

        Readings (L,) are those of all; here and in `step` they may be (R, L), of each its own.
        """
        R, n = len(self._reads), self._n
        x, P = np.tile(self._model.initial, (R, 1)), np.tile(np.diag(self._model.start**2),
                                                             (R, 1, 1))
        X, mean = np.zeros((R, n, self._p)), np.zeros(self._reads.shape)
        said, fresh = np.zeros((R, int(bool(self._model.angle)))), self._with(told.ages)
        if not self._model.angle:
            return fresh._corrected(x, P, X, mean, said, np.zeros(R), told)
        for _ in range(NEARER):  # it may be anywhere, however far that is from what is expected
            x = x + (fresh.gain(P)[0] @ fresh._off(x, told)[:, :, None])[:, :, 0]
        return fresh._corrected(x, P, X, mean, said, np.zeros(R), told)

    def step(self, z: np.ndarray, after: Told, commands: np.ndarray) -> np.ndarray:
        """Step the states (R, k) to readings at the end, by commands (3, m): see `Batch.step`."""
        x, P, X, mean, said, worst = np.split(z, self._cuts, axis=1)
        P = P.reshape(len(z), self._n, self._n)
        x, (F, G, Q) = self._moved(x, commands, P)
        P, X = self.spread_step(F, G, Q, P, X.reshape(len(z), self._n, self._p))
        return self._with(after.ages)._corrected(x, P, X, mean, said, worst[:, 0], after)

    def linear(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return F (1, n, n), G (1, n, p) and Q (1, n, n) of a step at a point that is known."""
        return self._matrices(self._slopes(x[None], u, np.zeros((1, self._n, self._n)))[1])

    def spread_step(self, F: np.ndarray, G: np.ndarray, Q: np.ndarray, P: np.ndarray,
                    X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the covariances of the states (R, n, n), and with the parameters (R, n, p)."""
        cross = F @ X @ _turned(G)
        moved = F @ P @ _turned(F) + cross + _turned(cross) + (G * self._variance) @ _turned(G) + Q
        return moved, F @ X + G * self._variance

    def gain(self, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return gains (R, n, L) and the variances of what is read beside what is expected."""
        seen = self._C @ P
        S = seen @ _turned(self._C) + self._meter
        known, one = np.isfinite(S).all(axis=(1, 2)), np.eye(S.shape[1])
        # two sensors of one state that nobody knows yet differ by less than there are digits
        S = np.where(known[:, None, None], S * (1.0 + FAINTEST * one), one)
        return _turned(np.linalg.solve(S, seen)), np.diagonal(S, axis1=1, axis2=2)

    def spread_correction(self, K: np.ndarray, P: np.ndarray, X: np.ndarray,
                          ) -> tuple[np.ndarray, np.ndarray]:
        """Return the covariances after a correction, in the form that keeps them positive."""
        left = self.after(K)
        P = left @ P @ _turned(left) + K @ self._meter @ _turned(K)
        return (P + _turned(P)) / 2.0, left @ X

    def after(self, K: np.ndarray) -> np.ndarray:
        """Return what of an error in the states (R, n) gains leave (R, n, n)."""
        return np.eye(self._n) - K @ self._C

    def _corrected(self, x: np.ndarray, P: np.ndarray, X: np.ndarray, mean: np.ndarray,
                   said: np.ndarray, worst: np.ndarray, told: Told) -> np.ndarray:
        off = self._off(x, told)
        K, variances = self.gain(P)
        x = x + (K @ off[:, :, None])[:, :, 0]
        P, X = self.spread_correction(K, P, X)
        variances = np.maximum(variances, np.diagonal(self._meter))  # rounding may take it off
        white = np.where(self._healthy, off / np.sqrt(variances), 0.0)
        mean = mean + self._share * (white - mean)
        worst = np.maximum(worst, (mean * mean).sum(axis=1) / self._usual)
        if self._model.angle:
            said = self._angle(x, said, told)
        R = len(x)
        return np.concatenate([x, P.reshape(R, -1), X.reshape(R, -1), mean, said,
                               worst[:, None]], axis=1)

    def _off(self, x: np.ndarray, told: Told) -> np.ndarray:
        """Return what was read beside what is expected of states (R, n)."""
        y = told.y
        if self._model.angle:
            angles = y[..., self._turning] / self._factors
            y = np.concatenate([y, np.cos(angles), np.sin(angles)], axis=-1)
        expected = x @ self._all.T
        if told.held.size:
            expected = expected + self._Cu @ told.held
        return np.where(self._reads, y - expected, 0.0)

    def _angle(self, x: np.ndarray, said: np.ndarray, told: Told) -> np.ndarray:
        """Return the angles (R, 1) of states, next to what is read of them, or was said before."""
        cos, sin = self._model.circle
        for sensor, factor in zip(self._turning, self._factors):
            said = np.where(self._reads[:, sensor, None], told.y[..., sensor, None] / factor, said)
        return said + np.remainder(
            np.arctan2(x[:, sin], x[:, cos])[:, None] - said + np.pi, 2 * np.pi) - np.pi

    def _at(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return where to evaluate the equations: states (R, n) and commands (m,)."""
        m = self._model
        others = np.concatenate([u, np.zeros(len(m.unknown)), m.values])
        return np.concatenate([x.T, np.broadcast_to(others[:, None], (len(others), len(x)))])

    def _moved(self, x: np.ndarray, commands: np.ndarray, P: np.ndarray,
               ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return states (R, n) a step on, by Runge and Kutta, and its matrices, at the middle."""
        begin, end, mean = commands
        if self._discrete:
            found, slopes = self._slopes(x, mean, P)
            return found.T, self._matrices(slopes)
        f, h = self._equations, self._h
        k1 = f.values(self._at(x, begin)).T
        k2 = f.values(self._at(x + h / 2 * k1, mean)).T
        k3, slopes = self._slopes(x + h / 2 * k2, mean, P)
        k4 = f.values(self._at(x + h * k3.T, end)).T
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3.T + k4), self._matrices(slopes)

    def _slopes(self, x: np.ndarray, u: np.ndarray,
                P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return values (n, R) and slopes (n, .., R) at states; of an angle (n, .., 3 R).

        Noise on what drives an angle acts along a direction that is not known well: slopes a
        deviation of cosine and sine beside the states are the second R, and the third.
        """
        if not self._model.angle:
            return self._equations.slopes(self._at(x, u))
        R, (c, s) = len(x), self._model.circle
        first = np.sqrt(np.maximum(P[:, c, c], 0.0))
        across = P[:, c, s] / np.where(first > 0.0, first, 1.0)
        points = np.concatenate([x, x, x])
        points[R:2 * R, c] += first
        points[R:2 * R, s] += across
        points[2 * R:, s] += np.sqrt(np.maximum(P[:, s, s] - across**2, 0.0))
        found, slopes = self._equations.slopes(self._at(points, u))
        return found[:, :R], slopes

    def _matrices(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return F, G and Q of derivatives (n, n + m + d + p, R), of an angle as in `_slopes`."""
        n, h = self._n, self._h
        slopes = slopes.transpose(2, 0, 1)
        A, drive, by = np.split(slopes, [n, slopes.shape[2] - self._p], axis=2)
        one, driven = np.eye(n), self._drive
        if self._model.angle:
            drive, *beside = np.split(drive, 3)
            A, by = A[:len(drive)], by[:len(drive)]
            drive = np.concatenate([drive, *(other - drive for other in beside)], axis=2)
            driven = np.tile(driven, 3)
        W = (drive * driven) @ _turned(drive) + np.diag(self._model.process_noise**2)
        if self._discrete:
            return A, by, W
        AA = A @ A
        F, held = one + h * A + h * h / 2 * AA, h * one + h * h / 2 * A + h**3 / 6 * AA
        return F, held @ by, held @ W @ _turned(held) / h

    def row(self, sensor: int, x: np.ndarray) -> np.ndarray:
        """Return the slopes (n,) of what a sensor reads at states (n,); infinite: not known."""
        m = self._model
        row = m.C[sensor]
        if m.angle and m.factors[sensor]:
            cos, sin = m.circle
            square = x[cos]**2 + x[sin]**2
            row = row.copy()
            row[[cos, sin]] = m.factors[sensor] * np.array([-x[sin], x[cos]]) / square \
                if square else math.inf
        return row

    def off_circle(self, z: np.ndarray) -> np.ndarray:
        """Return by how many variances (R,) cosine and sine of (R, k) are off the circle."""
        n, at = self._n, list(self._model.circle)
        x, P = z[:, at], z[:, n:n + n * n].reshape(-1, n, n)[:, at][:, :, at]
        radius = np.hypot(x[:, 0], x[:, 1])
        along = np.where(radius[:, None] > 0.0, x, 1.0)
        along = along / np.hypot(along[:, 0], along[:, 1])[:, None]
        return np.asarray((1.0 - radius)**2 / np.maximum(
            (along[:, None] @ P @ along[:, :, None])[:, 0, 0], FAINTEST))

    def deviation(self, row: np.ndarray, z: np.ndarray) -> float:
        """Return the standard deviation of row @ x (n,), of one state (k,)."""
        n = self._n
        with np.errstate(all='ignore'):
            variance = float(row @ z[n:n + n * n].reshape(n, n) @ row)
            found = math.sqrt(max(variance, 0.0) * max(1.0, float(z[-1]) / MILD)) \
                if math.isfinite(variance) else math.inf
        return found if math.isfinite(found) else math.inf


def _turned(matrices: np.ndarray) -> np.ndarray:
    return matrices.transpose(0, 2, 1)
