"""
How readings go between the times of the grid: parabolas through three, not straight lines.

A straight line is off by -h^2 y''/12 in the mean over a step. Of one reading that averages out,
of its square it does not: a motor's current at 30 rad/s, read 100 times a second, shifts its
energy by more than noise does. The parabola through the reading before, too, is off by a 24th of
the third difference, which is how far the cubic is from it: by that the error is told. It has a
sign, so that what noise does to it averages out as it does in z.

Of a sensor slower than the grid there are readings on straight lines; they are put right by how
fast the slopes of these have changed of late. That is late by about a reading and a half, so that
a part of it is counted as error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

FAST = 1.5  # steps between two readings at most of a sensor that is as fast as the grid
LATE = 0.25  # of what slow sensors are put right by: what that may be off

# takes the share of a step; returns readings and inputs there (R, L + m), and their rates
Way = Callable[[float], tuple[np.ndarray, np.ndarray]]


class Bends:
    """
    The bends of those C of L sensors that are integrated.

    lasts (L,): s between two readings, at least the period [s] of the steps. A state has the steps
    since the start, slopes (C,) and bends (C,) of the last step.
    """

    def __init__(self, integrated: Sequence[bool], lasts: np.ndarray, period: float) -> None:
        self._which, self._h, self._L = np.flatnonzero(integrated), period, len(lasts)
        self._lasts = lasts[self._which]
        self._fast = self._lasts <= FAST * period
        self._kept = np.where(self._fast, 0.0, np.exp(-period / self._lasts))
        self.width = 1 + 2 * len(self._which)

    def over(self, told: np.ndarray, begin: np.ndarray, end: np.ndarray,
             ages: np.ndarray) -> tuple[np.ndarray, Way, np.ndarray]:
        """
        Return states after a step, the way of readings, and what is left that they are off.

        told (R, width): states; begin, end (L + m,): readings and inputs; ages (2, L) as in
        `Told`. What is left is (R, L), the mean over the step.
        """
        h, C, which = self._h, len(self._which), self._which
        steps, slope, bend = told[:, :1], told[:, 1:1 + C], told[:, 1 + C:]
        rate = (end - begin) / h
        now = np.where(steps > 0.0, self._kept * bend + (
            rate[which] - slope) / np.where(self._fast, h, self._lasts), 0.0)
        # squares of the distances to readings: of straight lines, not where the next has not come
        gap = (ages[:, which]**2).mean(axis=0)
        gap = np.where(gap <= self._lasts**2 / 4.0, gap, 0.0)
        third = np.where(steps > 1.0, bend - now, 0.0) * (h * h / 12.0 + gap)
        left = np.zeros((len(told), self._L))
        left[:, which] = np.where(self._fast, third, LATE * now * gap) / 2.0
        curved, lower = np.zeros((2, len(told), len(begin)))
        curved[:, which], lower[:, which] = np.where(self._fast, now, 0.0), now * gap

        def way(share: float) -> tuple[np.ndarray, np.ndarray]:
            off = (curved * h * h * share * (share - 1.0) - lower) / 2.0
            return begin + share * (end - begin) + off, rate + curved * h * (share - 0.5)
        return np.concatenate([np.minimum(steps + 1.0, 2.0), np.broadcast_to(
            rate[which], now.shape), now], axis=1), way, left
