"""
Ranks decided by exact arithmetic: the referee where a singular value leaves doubt.

People type decimals (0.1, -1.5e-3). The decimal that a float stands for is known exactly, so
existence and least order can be decided without any tolerance. The arithmetic is done modulo a
large prime, so that no number grows. A rank comes out wrong (too low) only when the prime divides
the minors that matter, hence two primes must agree. Data that were computed (1/3, a discretised
plant) keep their relations up to rounding only, and exact arithmetic would break these: ask
``short_decimals`` first. Likewise 0.333333 typed for 1/3 is taken at its word. The matrices are
those of the plant in its own units, not scaled ones.

Source: method 3.1, 3.2 and 3.4; section 3.4 in coordinates of the quotient by T*, see
``polynomial_freedom``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

PRIMES = (2147483629, 2147483587, 2147483579, 2147483563)  # below 2**31
SHORT = 12  # significant digits of a number that somebody typed
ROUNDING = 1e-15  # relative, of a sum or product of two such numbers
_FEW = 8  # rows that are eliminated one by one
_INNER = 2048  # length of inner products of 11 by 31 bits that doubles hold exactly


def short_decimals(*matrices: np.ndarray) -> bool:
    """Whether all entries are numbers of at most 12 digits, up to the last bits of a double."""
    return all(_typed(value) for M in matrices for value in np.unique(M).tolist())


def to_residues(M: np.ndarray, prime: int) -> np.ndarray:
    """
    Take the decimals that the entries of M stand for exactly, modulo a prime.

    1 - 2*0.35 stands for 0.3; what is no short decimal stands for the shortest one that reads back
    as the same double. Returns int64 of the shape of M. Raises ValueError for entries that are not
    finite.
    """
    values, where = np.unique(np.asarray(M, float), return_inverse=True)
    residues = np.array([_residue(_typed(value) or repr(value), prime)
                         for value in values.tolist()], np.int64)
    return residues[where].reshape(np.shape(M))


def _typed(value: float) -> str | None:
    text = f'{value:.{SHORT}g}'
    return text if abs(float(text) - value) <= ROUNDING * abs(value) else None


def _residue(decimal: str, prime: int) -> int:
    mantissa, _, exponent = decimal.partition('e')
    whole, _, fraction = mantissa.partition('.')
    return int(whole + fraction) * _power(int(exponent or 0) - len(fraction), prime) % prime


@lru_cache(4096)
def _power(exponent: int, prime: int) -> int:
    return pow(10, exponent, prime)


def product(X: np.ndarray, Y: np.ndarray, prime: int) -> np.ndarray:
    """Multiply matrices of residues. X goes in three parts, so that doubles stay exact."""
    if X.shape[1] > _INNER:
        return (product(X[:, :_INNER], Y[:_INNER], prime)
                + product(X[:, _INNER:], Y[_INNER:], prime)) % prime
    parts = np.vstack([X >> 22, X >> 11 & 2047, X & 2047]).astype(float)
    high, middle, low = np.split((parts @ Y.astype(float)).astype(np.int64), 3)
    return (((high % prime << 11) + middle) % prime * 2048 + low) % prime


@dataclass(frozen=True, eq=False)
class Basis:
    """Basis of a space of rows modulo a prime, reduced: ``rows[:, pivots]`` is the unit matrix."""

    prime: int
    rows: np.ndarray  # (r, n) int64
    pivots: np.ndarray  # (r,) columns; each the first nonzero of its row when that was added

    def __len__(self) -> int:
        return len(self.rows)

    def remainder(self, rows: np.ndarray) -> np.ndarray:
        """Subtract from rows (m, n) what lies in the basis; zero for a row in its span."""
        if not len(self) or not len(rows):
            return rows
        factors = rows[:, self.pivots]
        inside = (factors * self.rows if len(self) == 1  # one number at a time grows a long chain
                  else product(factors, self.rows, self.prime))
        return (rows - inside) % self.prime

    def extended(self, rows: np.ndarray) -> Basis:
        """Return the basis of the sum; what the rows (m, n) add to it comes last."""
        fresh, pivots = _eliminated(self.remainder(rows), self.prime)
        if not len(fresh):
            return self
        addition = Basis(self.prime, fresh, pivots)
        return Basis(self.prime, np.vstack([addition.remainder(self.rows), fresh]),
                     np.concatenate([self.pivots, pivots]))


def _nothing(width: int, prime: int) -> Basis:
    return Basis(prime, np.zeros((0, width), np.int64), np.zeros(0, np.int64))


def basis(rows: np.ndarray, prime: int) -> Basis:
    """Return the reduced basis of the span of rows (m, n)."""
    return Basis(prime, *_eliminated(rows, prime))


def rank(M: np.ndarray, prime: int) -> int:
    """Count the independent rows of residues M (m, n)."""
    return len(basis(M, prime))


def kernel(M: np.ndarray, prime: int) -> np.ndarray:
    """Return all x with M x = 0 as independent columns (n, n - rank)."""
    return _kernel(basis(M, prime))[0]


def _kernel(space: Basis) -> tuple[np.ndarray, np.ndarray]:
    """Return the kernel as columns, which are unit ones in the components returned with it."""
    n = space.rows.shape[1]
    free = np.setdiff1d(np.arange(n), space.pivots)
    columns = np.zeros((n, len(free)), np.int64)
    columns[free] = np.eye(len(free), dtype=np.int64)
    columns[space.pivots] = -space.rows[:, free] % space.prime
    return columns, free


def _eliminated(rows: np.ndarray, prime: int) -> tuple[np.ndarray, np.ndarray]:
    """Reduce rows by halves, so that nearly all the work is matrix products."""
    if len(rows) <= _FEW:
        return _eliminated_singly(rows, prime)
    half = len(rows) // 2
    whole = Basis(prime, *_eliminated(rows[:half], prime)).extended(rows[half:])
    return whole.rows, whole.pivots


def _eliminated_singly(rows: np.ndarray, prime: int) -> tuple[np.ndarray, np.ndarray]:
    kept, pivots = [], []
    for i in range(len(rows)):
        nonzero = np.flatnonzero(rows[i])
        if not nonzero.size:
            continue
        column = nonzero[0]
        pivot_row = rows[i] * pow(int(rows[i, column]), -1, prime) % prime
        rows = (rows - rows[:, column, None] * pivot_row) % prime  # products below 2**62
        rows[i] = pivot_row
        kept.append(i)
        pivots.append(column)
    return rows[kept], np.array(pivots, np.int64)


@dataclass(frozen=True, eq=False)
class Residues:
    """The problem of one fault set modulo a prime, its readings free of unknown inputs."""

    prime: int
    A: np.ndarray  # (n, n)
    C0: np.ndarray  # (l, n)
    V: np.ndarray  # (p, n)
    D: np.ndarray  # (n, d)
    P: np.ndarray  # (n, q)
    G: tuple[np.ndarray, ...]  # q of (r_i, n)
    direct: tuple[bool, ...]  # (p,): the sensors carry what rho does to this row directly


def residues(A: np.ndarray, C0: np.ndarray, V: np.ndarray, D: np.ndarray, prime: int, *,
             Cd0: np.ndarray | None = None, Vd: np.ndarray | None = None,
             P: np.ndarray | None = None, G: Sequence[np.ndarray] = ()) -> Residues:
    """
    Take a problem modulo a prime, and eliminate rho by the readings that carry it.

    A (n, n), C0 (l0, n), V (p, n), D (n, d), Cd0 (l0, d), Vd (p, d), P (n, q), G q of (r_i, n),
    in the units of the plant. Row operations make of y0 the readings ``y1 = C1 x + Cd1 rho``, Cd1
    of full row rank, and ``y2 = C2 x``. With a right inverse R of Cd1 and the kernel K of Cd0,
    ``rho = R (y1 - C1 x) + K rho2``: what is left is the plant ``A - D R C1, D K`` with the
    sensors C2 and the known input y1, and the target ``V - Vd R C1``, provided that Vd K = 0.
    (E2) Phi D = J Cd0 and Vd = Q Cd0 fix J1 = Phi D R and Q1 = Vd R; all else stays free. An
    argument G_i x must not carry rho, hence it is to be known from Phi x and y2 alone.
    """
    n, d = np.shape(D)
    A, C0, V, D = (to_residues(M, prime) for M in (A, C0, V, D))
    P = to_residues(np.zeros((n, 0)) if P is None else P, prime)
    arguments = tuple(to_residues(g, prime) for g in G)
    if Cd0 is None or not np.any(Cd0):
        direct = tuple(not np.any(row) for row in (np.zeros((len(V), d)) if Vd is None else Vd))
        return Residues(prime, A, C0, V, D, P, arguments, direct)
    Vd = to_residues(np.zeros((len(V), d)) if Vd is None else Vd, prime)
    readings = basis(np.hstack([to_residues(Cd0, prime), C0]), prime)
    carry = readings.pivots < d
    Cd1, C1 = np.split(readings.rows[carry], [d], axis=1)
    chosen = readings.pivots[carry]  # Cd1 is the unit matrix there: R picks these inputs
    K = _kernel(Basis(prime, Cd1, chosen))[0]
    return Residues(
        prime, (A - product(D[:, chosen], C1, prime)) % prime, readings.rows[~carry][:, d:],
        (V - product(Vd[:, chosen], C1, prime)) % prime, product(D, K, prime), P, arguments,
        tuple(not row.any() for row in product(Vd, K, prime)))


def conditioned_invariant(A: np.ndarray, C0: np.ndarray, D: np.ndarray,
                          prime: int) -> np.ndarray:
    """
    Return T*, the least T with Im D in T and A (T with C0 x = 0) in T, as columns (n, t).

    Source: method 3.1. Each vector of T enters once, as a row [C0 x, x]. In a basis whose pivots
    come as early as possible the vectors with C0 x = 0 show by their pivot; A carries them on.
    """
    l0, new = len(C0), D.T
    found = _nothing(l0 + len(A), prime)
    while len(new):
        old = len(found)
        found = found.extended(np.hstack([product(new, C0.T, prime), new]))
        unseen = found.rows[old:][found.pivots[old:] >= l0, l0:]
        new = product(unseen, A.T, prime)
    return found.rows[:, l0:].T


@dataclass(frozen=True, eq=False)
class DecoupledObserver:
    """
    The largest decoupled observer Phi* = ann(T*), and the functionals in its coordinates.

    ``Phi A = N Phi + J C0``; the rows E span what of the readings is a function of Phi x.
    """

    T: np.ndarray  # (n, t)
    known: Basis  # rows [w T, w] for w in R(C0)
    free: np.ndarray  # (n - t,) components in which the rows of Phi are unit rows
    N: np.ndarray  # (n - t, n - t)
    E: np.ndarray  # (e, n - t)

    def coordinates(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x with w - x Phi in R(C0), and whether there is one, for each row of w (m, n)."""
        prime, t = self.known.prime, self.T.shape[1]
        rest = self.known.remainder(np.hstack([product(w, self.T, prime), w]))
        return rest[:, t:][:, self.free], (rest[:, :t] == 0).all(axis=1)


def quotient(problem: Residues, T: np.ndarray) -> DecoupledObserver:
    """Take the plant modulo T*, (n, t) columns of ``conditioned_invariant``."""
    prime, t = problem.prime, T.shape[1]
    Phi, free = _kernel(basis(T.T, prime))
    known = basis(np.hstack([product(problem.C0, T, prime), problem.C0]), prime)
    E = known.rows[known.pivots >= t][:, t:][:, free]
    result = DecoupledObserver(T, known, free, np.zeros((0, 0), np.int64), E)
    N, _ = result.coordinates(product(Phi.T, problem.A, prime))
    return DecoupledObserver(T, known, free, N, E)


def forced_closure(problem: Residues, forced: frozenset[int] = frozenset(),
                   ) -> tuple[frozenset[int], DecoupledObserver]:
    """
    Return the nonlinear terms that must be decoupled and the quotient by the T* this leads to.

    ``forced``: terms to decouple from in any case. Source: method 3.2.
    """
    while True:
        D = np.hstack([problem.D, problem.P[:, sorted(forced)]])
        T = conditioned_invariant(problem.A, problem.C0, D, problem.prime)
        observer = quotient(problem, T)
        grown = forced | {i for i, g in enumerate(problem.G)
                          if not observer.coordinates(g)[1].all()}
        if grown == forced:
            return forced, observer
        forced = grown


def solvable(problem: Residues, observer: DecoupledObserver) -> tuple[bool, ...]:
    """Whether (E1) to (E3) have a solution, for each row of V. Source: method 3.1."""
    return tuple(bool(inside) and direct for inside, direct
                 in zip(observer.coordinates(problem.V)[1], problem.direct))


def fixed_dimension(observer: DecoupledObserver) -> int:
    """Count the modes of the largest decoupled observer that no injection moves (method 3.3)."""
    prime = observer.known.prime
    seen = basis(observer.E, prime)
    fresh = seen.rows
    while len(fresh):
        old = len(seen)
        seen = seen.extended(product(fresh, observer.N, prime))
        fresh = seen.rows[old:]
    return len(observer.N) - len(seen)


def polynomial_freedom(v: np.ndarray, observer: DecoupledObserver,
                       k_max: int | None = None) -> tuple[int | None, ...]:
    """
    Count, for k = 0, 1, .., the free coefficients of the characteristic polynomial of order k.

    ``v`` (1, n - t): one solvable functional in the observer's coordinates. None where there is
    no observer of order k; k where the spectrum may be any. ``k_max``: n - t by default, where
    there always is one, and where what is not free is the number of fixed modes that v sees.

    Every phi_i of method 3.4 is annihilated by T*, and modulo R(C0) its recursion reads
    ``phi_{i+1} = phi_i N + p_{k-i} v - e_i`` with any e_i in R(E). So p is achievable iff
    ``v p(N)`` lies in ``O_k = R[E; EN; ..; EN^k]``. There is such a p of order k iff v N^k lies
    in ``U_k = O_k + R[v; ..; vN^(k-1)]``, and k - dim U_k + dim O_k of its coefficients are free.
    """
    prime, r = observer.known.prime, len(observer.N)
    k_max = r if k_max is None else k_max
    readings = both = _nothing(r, prime)  # O_k and U_k
    fresh, exists = observer.E, False
    freedom: list[int | None] = []
    for k in range(k_max + 1):
        old = len(readings)
        readings, both = readings.extended(fresh), both.extended(fresh)
        fresh = product(readings.rows[old:], observer.N, prime)
        exists = exists or not both.remainder(v).any()
        freedom.append(k - len(both) + len(readings) if exists else None)
        if exists and len(both) == len(readings):
            return (*freedom, *range(k + 1, k_max + 1))
        if not exists:
            both, v = both.extended(v), product(v, observer.N, prime)
    return tuple(freedom)


@dataclass(frozen=True)
class ExactVerdict:
    """What exact arithmetic says of a problem."""

    forced: frozenset[int]  # nonlinear terms that must be decoupled
    solvable: tuple[bool, ...]  # for each row of V
    largest: int  # order of the largest decoupled observer, n - dim T*
    fixed: int  # so many of its modes cannot be moved
    freedom: tuple[tuple[int | None, ...], ...]  # of each row, see ``polynomial_freedom``


def verdict(A: np.ndarray, C0: np.ndarray, V: np.ndarray, D: np.ndarray, *,
            Cd0: np.ndarray | None = None, Vd: np.ndarray | None = None,
            P: np.ndarray | None = None, G: Sequence[np.ndarray] = (),
            forced: frozenset[int] = frozenset(), k_max: int | None = None,
            as_given: bool = False) -> ExactVerdict | None:
    """
    Decide existence, fixed modes and orders exactly; None when the data do not allow it.

    Arguments as of ``residues``; ``forced``: terms to decouple from in any case. The data do not
    allow it when they are not short decimals, unless each number is to be taken ``as_given``, to
    its last digit. Two primes must agree.
    """
    given = [M for M in (A, C0, V, D, Cd0, Vd, P, *G) if M is not None]
    if not as_given and not short_decimals(*given):
        return None
    said: list[ExactVerdict] = []
    for prime in PRIMES:
        problem = residues(A, C0, V, D, prime, Cd0=Cd0, Vd=Vd, P=P, G=G)
        closed, observer = forced_closure(problem, forced)
        passes = solvable(problem, observer)
        v = observer.coordinates(problem.V)[0]
        answer = ExactVerdict(
            closed, passes, len(observer.N), fixed_dimension(observer),
            tuple(polynomial_freedom(v[i:i + 1], observer, k_max) if passes[i] else ()
                  for i in range(len(v))))
        if answer in said:
            return answer
        said.append(answer)
    return None
