"""
How faults of sensors show, by ranks of the system matrix, in exact arithmetic.

A residual that feels neither unknown inputs nor any start is a left null vector ``(w, h)(s)`` of
``P(s) = [A - s, D; C, Cd]``, whose h says what it makes of the readings. Sensors that it may not
read are no rows of C. So a fault of sensor j shows iff some h_j is not zero, which is the rank of
``[P, e_j]`` above that of P at any s but a few. A constant one stays visible iff some polynomial h
has ``h_j(0)`` not zero. Where P(s) loses no rank at s = 0 (discrete: z = 1) that is the same rank
there. Else only those null vectors of P(0) count that go on to ones of P(s) nearby: the first of
power series ``w0 + w1 s + ..`` of n + 1 coefficients.
"""

from __future__ import annotations

import numpy as np

from vsensor_ros.designer.exact import kernel, PRIMES, short_decimals, to_residues
from vsensor_ros.observers import NONE, STRONG, WEAK

LARGEST = 1500  # rows of the matrix of a power series
_PLACE = 1_299_709  # an s that is no zero of a plant but by chance; two primes must agree


def strengths(A: np.ndarray, C: np.ndarray, D: np.ndarray, Cd: np.ndarray,
              sample_time: float | None) -> tuple[str, ...] | None:
    """
    Return for each row of C how faults of its sensor show: 'strong', 'weak' or 'none'.

    A (n, n), C (l, n), D (n, d), Cd (l, d) in the plant's units. None where the numbers are no
    short decimals, or exact arithmetic would take too long.
    """
    if not short_decimals(A, C, D, Cd):
        return None
    said: list[tuple[str, ...]] = []
    for prime in PRIMES:
        at_all = _null(A, C, D, Cd, _PLACE, prime)
        rests = 0 if sample_time is None else 1
        stays: np.ndarray | None = _null(A, C, D, Cd, rests, prime)
        if stays is not None and stays.shape[1] > at_all.shape[1]:
            stays = _going_on(A, C, D, Cd, rests, prime)
        if stays is None:
            return None
        n = len(A)
        answer = tuple(
            STRONG if stay else WEAK if any_ else NONE
            for stay, any_ in zip(map(np.any, stays[n:]), map(np.any, at_all[n:])))
        if answer in said:
            return answer
        said.append(answer)
    return None


def _matrix(A: np.ndarray, C: np.ndarray, D: np.ndarray, Cd: np.ndarray, s: int,
            prime: int) -> np.ndarray:
    P = to_residues(np.block([[A, D], [C, Cd]]), prime)
    rest = np.arange(len(A))
    P[rest, rest] = (P[rest, rest] - s) % prime
    return P


def _null(A: np.ndarray, C: np.ndarray, D: np.ndarray, Cd: np.ndarray, s: int,
          prime: int) -> np.ndarray:
    """Return the left null vectors of P(s) as columns (n + l, k)."""
    return kernel(_matrix(A, C, D, Cd, s, prime).T, prime)


def _going_on(A: np.ndarray, C: np.ndarray, D: np.ndarray, Cd: np.ndarray, s: int,
              prime: int) -> np.ndarray | None:
    """Return those of P(s) that go on to null vectors nearby; None: too many numbers."""
    P, n = _matrix(A, C, D, Cd, s, prime), len(A)
    rows, columns = P.shape
    if rows * (n + 1) > LARGEST:
        return None
    whole = np.zeros((rows * (n + 1), columns * (n + 1)), np.int64)
    for i in range(n + 1):
        whole[i * rows:(i + 1) * rows, i * columns:(i + 1) * columns] = P
        if i:
            # what the coefficient before this one does by the -s of A - s
            before = whole[(i - 1) * rows:, i * columns:]
            before[np.arange(n), np.arange(n)] = prime - 1
    return kernel(whole.T, prime)[:rows]
