"""
Slow truths for small plants, in Fractions and from the definitions (method 3.1, 3.2, 3.4).

Nothing of the designer is used. Matrices are lists of rows of Fractions. Readings are
y0 = C x + Cd rho and the target is v = V x + Vd rho.
"""

from fractions import Fraction
from itertools import combinations


def meant(M):
    """Return the decimals that the floats of a matrix stand for."""
    return [[Fraction(repr(float(value))) for value in row] for row in M]


def eliminate(rows):
    """Return the reduced echelon form without zero rows, and its pivot columns."""
    rows, pivots = [list(row) for row in rows], []
    done = 0
    for column in range(len(rows[0]) if rows else 0):
        at = next((i for i in range(done, len(rows)) if rows[i][column]), None)
        if at is None:
            continue
        rows[done], rows[at] = rows[at], rows[done]
        rows[done] = [value / rows[done][column] for value in rows[done]]
        for i in range(len(rows)):
            if i != done and rows[i][column]:
                factor = rows[i][column]
                rows[i] = [a - factor * b for a, b in zip(rows[i], rows[done])]
        pivots.append(column)
        done += 1
    return rows[:done], pivots


def rank(rows):
    return len(eliminate(rows)[1])


def null_vectors(rows, width):
    """Return a basis of all x with rows x = 0."""
    reduced, pivots = eliminate(rows)
    vectors = []
    for free in sorted(set(range(width)) - set(pivots)):
        x = [Fraction(int(i == free)) for i in range(width)]
        for row, pivot in zip(reduced, pivots):
            x[pivot] = -row[free]
        vectors.append(x)
    return vectors


def dot(a, b):
    return sum((x * y for x, y in zip(a, b)), Fraction(0))


def times(M, x):
    return [dot(row, x) for row in M]


def beside(M, N):
    """Join two matrices side by side."""
    return [a + b for a, b in zip(M, N)]


def freedom(A, C, V, D, Cd, Vd, k):
    """
    Count the free coefficients of the characteristic polynomial at order k; None when unsolvable.

    All of p_0 .. p_{k-1} and the rows M_0 .. M_k are unknown at once. With feedthrough (E2) reads
    phi_i D = J_i Cd with J_i = M_{k-i} - p_{k-i} M_k, and Vd = M_k Cd. V and Vd are one row each.
    """
    n, l0, d = len(A), len(C), len(Vd)
    width = k + (k + 1) * l0 + 1  # the last one is the constant

    def unit(i):
        return [Fraction(int(i == j)) for j in range(width)]

    def known(M_at, column):
        """Return M_j times a column, affine in the unknowns."""
        row = [Fraction(0)] * width
        for s in range(l0):
            row[k + M_at * l0 + s] = column[s]
        return row

    def combined(*terms):
        return [sum((c * row[j] for c, row in terms), Fraction(0)) for j in range(width)]

    def column(M, j):
        return [row[j] for row in M]

    equations = [combined((Vd[j], unit(-1 % width)), (-1, known(k, column(Cd, j))))
                 for j in range(d)]
    phi = [combined((V[j], unit(-1 % width)), (-1, known(k, column(C, j)))) for j in range(n)]
    for i in range(1, k + 1):
        equations += [
            combined(*((D[s][j], phi[s]) for s in range(n)), (Vd[j], unit(k - i)),
                     (-1, known(k - i, column(Cd, j)))) for j in range(d)]
        phi = [combined(*((A[s][j], phi[s]) for s in range(n)), (V[j], unit(k - i)),
                        (-1, known(k - i, column(C, j)))) for j in range(n)]
    equations += phi
    left = [row[:-1] for row in equations]
    if rank(left) < rank(equations):
        return None
    return k - (rank(left) - rank([row[k:] for row in left]))


def solvable(A, C, V, D, Cd, Vd):
    """Whether some order up to n is solvable; one row of V and Vd."""
    return any(freedom(A, C, V, D, Cd, Vd, k) is not None for k in range(len(A) + 1))


def unseen(T, C, Cd):
    """Return a basis of all (x, rho) with x in T (rows) and C x + Cd rho = 0."""
    n, d = len(C[0]), len(Cd[0])
    T = null_vectors(null_vectors(T, n), n)  # independent
    readings = [times(C, x) for x in T] + [[row[j] for row in Cd] for j in range(d)]
    weights = null_vectors([list(row) for row in zip(*readings)], len(readings))
    return [[sum((w[i] * x[j] for i, x in enumerate(T)), Fraction(0)) for j in range(n)]
            + w[len(T):] for w in weights]


def hidden_subspace(A, C, D, Cd):
    """Return T*, the least T with A x + D rho in T for all unseen (x, rho), as rows."""
    T = []
    while True:
        grown = eliminate([times(beside(A, D), w) for w in unseen(T, C, Cd)])[0]
        if grown == T:
            return T
        T = grown


def fixed_dimension(A, C, D, Cd):
    """
    Count the modes of the plant modulo T* that no injection moves and no known output shows.

    One injection K that keeps T*, (A + K C) x + (D + K Cd) rho in T*, is solved for; then the
    largest invariant subspace is sought in which all combinations of readings vanish that rho and
    T* leave alone.
    """
    n, l0 = len(A), len(C)
    T = hidden_subspace(A, C, D, Cd)
    Phi = null_vectors(T, n)
    inputs = [[*x, *[Fraction(0)] * len(Cd[0])] for x in T] + [
        [Fraction(0)] * n + [Fraction(int(i == j)) for i in range(len(Cd[0]))]
        for j in range(len(Cd[0]))]
    equations = [[a * b for a in phi for b in times(beside(C, Cd), w)]
                 + [dot(phi, times(beside(A, D), w))] for phi in Phi for w in inputs]
    reduced, pivots = eliminate(equations)
    K = [Fraction(0)] * (n * l0)
    for row, pivot in zip(reduced, pivots):
        K[pivot] = -row[-1]
    closed = [[A[i][j] + sum((K[i * l0 + s] * C[s][j] for s in range(l0)), Fraction(0))
               for j in range(n)] for i in range(n)]
    alone = null_vectors([times(beside(C, Cd), w) for w in inputs], l0)
    outputs = [[dot(r, [row[j] for row in C]) for j in range(n)] for r in alone]
    rows = outputs
    for _ in range(n):
        outputs = [[dot(w, [row[j] for row in closed]) for j in range(n)] for w in outputs]
        rows = rows + outputs
    return n - len(T) - rank(rows)


def forced_and_solvable(A, C, D, Cd, P, G, V, Vd):
    """
    Try all sets S of decoupled nonlinear terms: the others must know their arguments.

    Returns the least S in which that holds, and whether in some such S all of V is solvable, too.
    G: one row for each column of P.
    """
    q, d = len(G), len(Cd[0])
    fit, works = [], False
    for size in range(q + 1):
        for S in combinations(range(q), size):
            D_S = [row + [p[i] for i in S] for row, p in zip(D, P)]
            Cd_S = [row + [Fraction(0)] * size for row in Cd]
            none = [Fraction(0)] * (d + size)
            if all(solvable(A, C, G[i], D_S, Cd_S, none) for i in range(q) if i not in S):
                fit.append(frozenset(S))
                works = works or all(
                    solvable(A, C, v, D_S, Cd_S, vd + [Fraction(0)] * size)
                    for v, vd in zip(V, Vd))
    return frozenset.intersection(*fit), works
