"""Exact ranks against a brute force in Fractions, closed forms and the published cases."""

from fractions import Fraction
from pathlib import Path
import sys

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros.designer import exact

sys.path.append(str(Path(__file__).parent))
import brute_force

PRIME = exact.PRIMES[0]


def sparse(rng, shape, density):
    return rng.integers(-2, 3, shape) * (rng.random(shape) < density).astype(float)


@st.composite
def problems(draw, largest=5, terms=0):
    """
    Draw small plants full of coincidences: zeros, repeated modes, what no sensor sees.

    Units of states and readings are powers of ten, so that the data are short decimals.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, l0, d = draw(st.integers(1, largest)), draw(st.integers(1, 3)), draw(st.integers(0, 2))
    density = draw(st.sampled_from([0.15, 0.3, 0.5, 0.9]))
    A = sparse(rng, (n, n), density)
    if draw(st.booleans()):  # repeated eigenvalues, stable or not
        A = np.triu(A, 1) + draw(st.sampled_from([-1, 0, 2])) * np.eye(n)
    C0, V, G = (sparse(rng, (rows, n), density) for rows in (l0, draw(st.integers(1, 2)), terms))
    D, P = sparse(rng, (n, d), density), sparse(rng, (n, terms), density)
    if draw(st.booleans()):  # hide the zeros behind a change of states
        change, inverse = np.eye(n), np.eye(n)
        for i, j in rng.integers(0, n, (n, 2)):
            if i != j:
                step = np.eye(n)
                step[i, j] = rng.integers(-1, 2)
                change, inverse = change @ step, (2 * np.eye(n) - step) @ inverse
        A, C0, V, G, D, P = (inverse @ A @ change, C0 @ change, V @ change, G @ change,
                             inverse @ D, inverse @ P)
    Cd0, Vd = np.zeros((l0, d)), np.zeros((len(V), d))
    if draw(st.booleans()):
        Cd0 = sparse(rng, (l0, d), 0.6)
        if draw(st.booleans()):  # the target hears rho as the sensors do, or does not
            Q = rng.integers(-1, 2, (len(V), l0))
            V, Vd = V + Q @ C0, Q @ Cd0
        elif draw(st.booleans()):
            Vd = sparse(rng, Vd.shape, 0.4)
    if draw(st.booleans()):  # units
        x, y = 10.0 ** rng.integers(-4, 5, n), 10.0 ** rng.integers(-4, 5, l0)

        def decimals(M, left, right):
            return np.array([[float(f'{m:.12g}') for m in row] for row in M * left / right]
                            ).reshape(M.shape)
        A, D, P = (decimals(M, x[:, None], right) for M, right in ((A, x), (D, 1), (P, 1)))
        C0, Cd0 = decimals(C0, y[:, None], x), decimals(Cd0, y[:, None], 1)
        V, G = decimals(V, 1, x), decimals(G, 1, x)
    return {'A': A, 'C0': C0, 'V': V, 'D': D, 'Cd0': Cd0, 'Vd': Vd, 'P': P, 'G': G}


def check_orders(problem):
    """Compare existence, freedom at every order and fixed modes with the brute force."""
    A, C, V, D, Cd, Vd = (brute_force.meant(problem[name])
                          for name in ('A', 'C0', 'V', 'D', 'Cd0', 'Vd'))
    n = len(A)
    verdict = exact.verdict(*(problem[name] for name in ('A', 'C0', 'V', 'D')),
                            Cd0=problem['Cd0'], Vd=problem['Vd'], k_max=n)
    assert verdict.largest == n - len(brute_force.hidden_subspace(A, C, D, Cd))
    assert verdict.fixed == brute_force.fixed_dimension(A, C, D, Cd)
    for i, (v, vd) in enumerate(zip(V, Vd)):
        truth = [brute_force.freedom(A, C, v, D, Cd, vd, k) for k in range(n + 1)]
        assert verdict.solvable[i] == any(free is not None for free in truth)
        if verdict.solvable[i]:
            assert list(verdict.freedom[i]) == truth
    return verdict


def check_terms(problem):
    """Compare the forced closure and what is solvable after it with all sets of terms."""
    A, C, V, D, Cd, Vd, P, G = (brute_force.meant(problem[name])
                                for name in ('A', 'C0', 'V', 'D', 'Cd0', 'Vd', 'P', 'G'))
    verdict = exact.verdict(problem['A'], problem['C0'], problem['V'], problem['D'],
                            Cd0=problem['Cd0'], Vd=problem['Vd'], P=problem['P'],
                            G=[g[None, :] for g in problem['G']])
    forced, works = brute_force.forced_and_solvable(A, C, D, Cd, P, G, V, Vd)
    assert verdict.forced == forced
    assert all(verdict.solvable) == works
    return verdict


@pytest.mark.slow
@settings(max_examples=50)
@given(problems())
def test_orders_and_freedom_are_those_of_the_definition(problem):
    check_orders(problem)


@settings(max_examples=40)
@given(problems(largest=4, terms=3))
def test_forced_terms_are_those_of_all_sets_tried(problem):
    check_terms(problem)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(1 - 10**12, 10**12 - 1), st.integers(-290, 290)),
                min_size=1))
def test_residues_are_those_of_the_decimals(decimals):
    typed = np.array([[float(f'{digits}e{exponent}') for digits, exponent in decimals]])
    meant = [Fraction(repr(value)) for value in typed[0].tolist()]
    for residue, value in zip(exact.to_residues(typed, PRIME)[0].tolist(), meant):
        assert residue * value.denominator % PRIME == value.numerator % PRIME


def test_residues_of_what_was_computed():
    third, rest = 1 / 3, 1 - 2 * 0.35
    assert rest != 0.3
    residues = exact.to_residues(np.array([third, rest]), PRIME).tolist()
    assert residues[0] * 10**16 % PRIME == 3333333333333333 % PRIME
    assert residues[1] * 10 % PRIME == 3


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(1, 60), st.integers(0, 30))
def test_elimination_finds_rank_and_kernel(seed, m, n, r):
    rng = np.random.default_rng(seed)
    r = min(m, n, r)
    M = exact.product(rng.integers(0, PRIME, (m, r)), rng.integers(0, PRIME, (r, n)), PRIME)
    M[:, rng.random(n) < 0.2] = 0
    space, K = exact.basis(M, PRIME), exact.kernel(M, PRIME)
    assert exact.rank(M, PRIME) == len(space) <= r
    assert K.shape == (n, n - len(space)) and exact.rank(K.T, PRIME) == K.shape[1]
    assert not exact.product(M, K, PRIME).any()
    assert (space.rows[:, space.pivots] == np.eye(len(space))).all()
    assert not space.remainder(M).any()
    assert len(space.extended(M)) == len(space)


def test_products_are_exact_where_doubles_are_tight():
    rng = np.random.default_rng(1)
    for inner in (1, 2048, 2049, 5003):  # odd and even terms as large as can be
        X = PRIME - 1 - rng.integers(0, 2, (3, inner))
        Y = PRIME - 1 - rng.integers(0, 1000, (inner, 4))
        for left in (X, X & 2047 | 2047):
            truth = left.astype(object) @ Y.astype(object) % PRIME
            assert (exact.product(left, Y, PRIME) == truth).all()


def test_primes_are_primes_below_31_bits():
    for prime in exact.PRIMES:
        assert prime < 2**31 and (prime % np.arange(2, 46341)).all()


def test_what_was_computed_is_told_from_what_was_typed():
    assert exact.short_decimals(np.array([[0.1, -1.5e-3], [6.02214076e23, 1e-300]]), np.eye(2))
    assert not exact.short_decimals(np.eye(2), np.array([[1 / 3, 1.0]]))
    assert not exact.short_decimals(np.array([np.expm1(-0.1)]))
    assert exact.short_decimals(np.array([0.1 * 3, 1 - 0.99]))  # short but for their last bits
    assert exact.verdict(np.array([[1 / 3]]), *np.ones((3, 1, 1))) is None


def test_entries_that_a_prime_divides_do_not_decide():
    """A sensor that weighs the state by the first prime is not blind."""
    answer = exact.verdict(-np.eye(1), np.array([[float(PRIME)]]), np.eye(1), np.zeros((1, 0)))
    assert answer.solvable == (True,) and answer.freedom == ((0, 1),) and answer.fixed == 0


def test_a_chain_of_integrators_has_the_orders_of_its_closed_form():
    """Powers of A move along the chain: v A^j = e_{i+j}, of which readings give e_0 to e_k."""
    n = 40
    A = np.diag(np.full(n - 1, 0.1), 1)
    for i in (0, 1, 17, n - 1):
        answer = exact.verdict(A, np.eye(n)[:1], np.eye(n)[i:i + 1], np.zeros((n, 0)))
        assert answer.fixed == 0
        assert answer.freedom[0] == tuple(
            sum(i + j <= k or i + j >= n for j in range(k)) if i == 0 or i + k >= n else None
            for k in range(n + 1))


def test_without_healthy_sensors_only_a_copy_of_the_plant_is_left():
    A = np.diag([-1.0, -2.0, -3.0])
    answer = exact.verdict(A, np.zeros((0, 3)), np.array([[1.0, 1.0, 0.0]]), np.zeros((3, 0)))
    assert answer == exact.ExactVerdict(frozenset(), (True,), 3, 3, ((None, None, 0, 1),))
    disturbed = exact.verdict(A, np.zeros((0, 3)), np.eye(3)[:2], np.eye(3)[:, :1])
    assert disturbed.solvable == (False, True) and disturbed.freedom[0] == ()


def test_an_accelerometer_tells_the_force_that_it_feels():
    """x1' = x2, x2' = -x1 + rho; a = -x1 + rho and x1 are read: x2 is then an integral."""
    A, D = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[0.0], [1.0]])
    C0, Cd0 = np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([[0.0], [1.0]])
    speed = np.array([[0.0, 1.0]])
    answer = exact.verdict(A, C0, speed, D, Cd0=Cd0)
    assert answer.solvable == (True,) and answer.freedom == ((None, 1, 2),)
    blind = exact.verdict(A, C0, speed, D)
    assert blind.solvable == (False,)
    # the force itself is the difference of two readings, and not an observer's matter
    force = exact.verdict(A, C0, np.zeros((1, 2)), D, Cd0=Cd0, Vd=np.ones((1, 1)))
    assert force.freedom == ((0, 1, 2),)
    assert exact.verdict(A, C0, speed, D, Vd=np.ones((1, 1))).solvable == (False,)


def test_published_cases():
    """The servo (S) and the sampled three-tank (D)."""
    servo = np.array([[0.0, 1, 0], [0, -1, 1], [0, -1, -1]])
    x, rho = np.eye(3), np.eye(3)[:, :1]
    velocity = x[1:2]
    friction = {'P': x[:, 1:2], 'G': [velocity]}
    paper = exact.verdict(servo, x[[0, 2]], velocity, rho, **friction)
    assert (paper.forced, paper.largest, paper.freedom[0]) == (frozenset(), 2, (None, 1, 2))
    copied = exact.verdict(servo, x[:1], velocity, rho, **friction)
    assert (copied.largest, copied.fixed, copied.freedom[0]) == (2, 2, (None, None, 0))
    assert exact.verdict(servo, x[1:], x[:1], rho, **friction).solvable == (False,)
    both = np.array([[1.0, 1, 0]])  # sum of angle and velocity: y0 need not be free of rho
    assert exact.verdict(servo, x[[0, 2]], both, rho).freedom[0][:2] == (None, 1)

    a = 0.1
    tank = np.array([[1 - a, a, 0], [a, 1 - 2 * a, a], [0, a, 1 - 2 * a]])
    flows = {'P': a * np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 1]]),
             'G': [np.array([[1.0, -1, 0]]), np.array([[0.0, 1, -1]]), np.array([[0.0, 0, 1]])]}
    for A in (tank, np.eye(3)):  # formal addends change nothing; only level 2 is read
        answer = exact.verdict(A, x[1:2], x[[0, 2]], rho, **flows)
        assert answer.forced == {0} and answer.largest == 1
        assert answer.solvable == (False, True)
        assert answer.freedom[1] == (None, 0)  # the mode of level 3 is fixed
        quiet = exact.verdict(A, x[1:2], x[[0, 2]], np.zeros((3, 0)), **flows)
        assert (quiet.forced, quiet.largest, quiet.solvable) == (frozenset(), 3, (True, True))
