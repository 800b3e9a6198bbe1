"""
The steps of extended Kalman filters that consider their parameters, many of one model at once.

A state of k numbers is: the n states, their covariance, that with the parameters (n, p), the mean
over a while of what each of the L sensors said beside what was expected, the angle where the model
has one, and the worst of those means. Of an angle states are cosine and sine: then a sensor of it
is read as two more, of its cosine and of its sine, and the angle goes on and on.
"""

from __future__ import annotations

from itertools import pairwise
import math

import numpy as np

from vsensor_ros.observers.kinds.batch import Told
from vsensor_ros.observers.kinds.extended.motion import Motion
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
        self._motion = Motion(model, period)
        n, p = self._n, self._p = len(model.states), len(model.parameters)
        # sensors of the angle, and of all that are read which of the L that is
        self._turning = np.flatnonzero(model.factors)
        of = np.concatenate([np.arange(len(model.C)), self._turning, self._turning])
        self._own, self._factors = of, model.factors[self._turning]
        self.width = n + n * n + n * p + len(of) + bool(model.angle) + 1
        self._cuts = [slice(a, b) for a, b in pairwise(np.cumsum(
            [0, n, n * n, n * p, len(of), int(bool(model.angle)), 1]).tolist())]
        self._reads, self._healthy = reads[:, of], healthy[:, of]
        self._all, noise = model.C, model.noise
        if model.angle:
            circle = np.repeat(np.eye(n)[list(model.circle)], len(self._turning), axis=0)
            self._all = np.vstack([model.C, circle])
            noise = np.concatenate([noise, *[noise[self._turning] / np.abs(self._factors)] * 2])
        self._Cu = np.zeros((len(of), model.Cu.shape[1])) if clean else model.Cu[of]
        # of readings that are rarer than steps, each counts for many of these
        self._meter = noise**2 * np.maximum(model.lasts[of] / period, 1.0)
        # of P (n n,): what readings beside what is expected vary by
        self._squares = (self._all[:, :, None] * self._all[:, None, :]).reshape(len(of), -1).T
        self._stale = STALE * np.maximum(model.lasts, period)
        self._fresh: tuple[bytes, Filter] = b'', self
        self._variance = model.spreads**2
        root = 1.0 if self._discrete else math.sqrt(period)  # white noise, of one step
        self._moves, self._drive = root * np.diag(model.process_noise), root * self._motion.drive
        self._one = np.eye(n)
        self._share = min(1.0, period / WHILE)  # of a new value in the mean over a while
        self._usual = self._share / (2.0 - self._share) * np.maximum(
            self._healthy.sum(axis=1, keepdims=True), 1)
        self._compress()

    def _compress(self) -> None:
        """Make of the readings of each n that tell as much, with noise of 1: that is less work."""
        scaled = self._all * (self._reads / np.sqrt(self._meter))[:, :, None]
        turn, self._C = np.linalg.qr(scaled)
        self._turn = _turned(turn) / np.sqrt(self._meter)
        self._unit = np.eye(self._C.shape[1])

    def of(self, rows: np.ndarray) -> Filter:
        """Return one of some of the filters alone; rows (r,) int may repeat."""
        found = object.__new__(Filter)
        found.__dict__.update(self.__dict__)
        for name in ('_reads', '_healthy', '_C', '_turn', '_usual'):
            setattr(found, name, getattr(self, name)[rows])
        found._fresh = b'', found
        return found

    def _with(self, ages: np.ndarray) -> Filter:
        """Return one that leaves out what is no reading any more; ages (L,) s, or (0,)."""
        if not (ages.size and (stale := ages > self._stale).any()):
            return self
        which = stale.tobytes()
        if self._fresh[0] != which:  # mostly it is as before
            found = object.__new__(Filter)
            found.__dict__.update(self.__dict__)
            fresh = ~stale[self._own]
            found._reads, found._healthy = self._reads & fresh, self._healthy & fresh
            found._compress()
            found._fresh = b'', found  # what it was made from would keep all that were before
            self._fresh = which, found
        return self._fresh[1]

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
        if self._model.angle:
            for _ in range(NEARER):  # it may be anywhere, however far that is from the expected
                x = fresh._nearer(x, fresh.gain(P), fresh._off(x, told))
        return fresh._corrected(x, P, X, mean, said, np.zeros((R, 1)), told)

    def step(self, z: np.ndarray, after: Told, commands: np.ndarray) -> np.ndarray:
        """Step the states (R, k) to readings at the end, by commands (3, m): see `Batch.step`."""
        x, P, X, mean, said, worst = [z[:, part] for part in self._cuts]
        P = P.reshape(len(z), self._n, self._n)
        x, middle, slopes = self._motion.step(x, commands)
        if self._model.angle:
            slopes = self._beside(middle, commands[2], P)
        P, X = self.spread_step(*self._matrices(slopes), P,
                                X.reshape(len(z), self._n, self._p))
        return self._with(after.ages)._corrected(x, P, X, mean, said, worst, after)

    def linear(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return F (1, n, n), G (1, n, p) and Q (1, n, n) of a step at a point that is known."""
        nothing = np.zeros((1, self._n, self._n))
        return self._matrices(self._beside(x[None], u, nothing) if self._model.angle
                              else self._motion.slopes(x[None], u))

    def spread_step(self, F: np.ndarray, G: np.ndarray, Q: np.ndarray, P: np.ndarray,
                    X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the covariances of the states (R, n, n), and with the parameters (R, n, p)."""
        if not self._p:
            return F @ P @ _turned(F) + Q, X
        moved = F @ X + G * self._variance
        return (F @ P + G @ _turned(X)) @ _turned(F) + moved @ _turned(G) + Q, moved

    def gain(self, P: np.ndarray) -> np.ndarray:
        """Return gains (R, n, r) of the readings that `_compress` makes."""
        seen = self._C @ P
        S = seen @ _turned(self._C) + self._unit
        # two sensors of one state that nobody knows yet differ by less than there are digits
        S *= 1.0 + FAINTEST * self._unit
        if not np.isfinite(S).all():
            S[~np.isfinite(S).all(axis=(1, 2))] = self._unit
        return _turned(np.linalg.solve(S, seen))

    def variances(self, P: np.ndarray) -> np.ndarray:
        """Return by how much readings (R, L) vary beside what is expected of them."""
        # rounding may take it off
        return np.maximum(P.reshape(len(P), -1) @ self._squares, 0.0) + self._meter

    def spread_correction(self, K: np.ndarray, P: np.ndarray, X: np.ndarray,
                          ) -> tuple[np.ndarray, np.ndarray]:
        """Return the covariances after a correction, in the form that keeps them positive."""
        left = self.after(K)
        P = left @ P @ _turned(left) + K @ _turned(K)
        return (P + _turned(P)) * 0.5, left @ X if self._p else X

    def after(self, K: np.ndarray) -> np.ndarray:
        """Return what of an error in the states (R, n) gains leave (R, n, n)."""
        return self._one - K @ self._C

    def _nearer(self, x: np.ndarray, K: np.ndarray, off: np.ndarray) -> np.ndarray:
        """Return states corrected by gains."""
        return x + (K @ (self._turn @ off[:, :, None]))[:, :, 0]

    def _corrected(self, x: np.ndarray, P: np.ndarray, X: np.ndarray, mean: np.ndarray,
                   said: np.ndarray, worst: np.ndarray, told: Told) -> np.ndarray:
        off, K = self._off(x, told), self.gain(P)
        white = np.where(self._healthy, off / np.sqrt(self.variances(P)), 0.0)
        x = self._nearer(x, K, off)
        P, X = self.spread_correction(K, P, X)
        mean = mean + self._share * (white - mean)
        worst = np.maximum(worst, (mean * mean).sum(axis=1, keepdims=True) / self._usual)
        if self._model.angle:
            said = self._angle(x, said, told)
        R = len(x)
        return np.concatenate([x, P.reshape(R, -1), X.reshape(R, -1), mean, said, worst], axis=1)

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

    def _beside(self, x: np.ndarray, u: np.ndarray, P: np.ndarray) -> np.ndarray:
        """
        Return slopes (3 R, n, ..) at states (R, n) of a model with an angle.

        Noise on what drives an angle acts along a direction that is not known well: slopes a
        deviation of cosine and sine beside the states are the second R, and the third.
        """
        R, (c, s) = len(x), self._model.circle
        first = np.sqrt(np.maximum(P[:, c, c], 0.0))
        across = P[:, c, s] / np.where(first > 0.0, first, 1.0)
        points = np.concatenate([x, x, x])
        points[R:2 * R, c] += first
        points[R:2 * R, s] += across
        points[2 * R:, s] += np.sqrt(np.maximum(P[:, s, s] - across**2, 0.0))
        return self._motion.slopes(points, u)

    def _matrices(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return F, G and Q of slopes (R, n, ..), of an angle as in `_beside`."""
        n, h = self._n, self._h
        A, drive, by = (slopes[:, :, part] for part in (
            slice(n), slice(n, slopes.shape[2] - self._p), slice(slopes.shape[2] - self._p, None)))
        push = self._moves  # what noise of 1 does to the states
        if drive.shape[2]:
            drive = drive * self._drive
            if self._model.angle:
                drive, *beside = np.split(drive, 3)
                A, by = A[:len(drive)], by[:len(drive)]
                drive = np.concatenate([drive, *(other - drive for other in beside)], axis=2)
            push = np.concatenate([np.broadcast_to(push, A.shape), drive], axis=2)
        elif self._model.angle:
            A, by = np.split(A, 3)[0], np.split(by, 3)[0]
        if not self._discrete:
            A = h * A
            AA = A @ A
            held = self._one + 0.5 * A + AA / 6.0
            A, by, push = self._one + A + 0.5 * AA, h * (held @ by), held @ push
        return A, by, push @ _turned(push)

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
    # a copy, of which products take less time
    return np.ascontiguousarray(matrices.transpose(0, 2, 1))
