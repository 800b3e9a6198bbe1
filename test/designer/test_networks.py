"""Large sparse plants: orders by exact arithmetic, strides, and a least order of no use."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
import sys

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros import design, Plant
from vsensor_ros.designer import exact
from vsensor_ros.designer.order_walk import by_strides, LARGE
from vsensor_ros.observers import Design
from vsensor_ros.report.design_text import order as said_of_order

sys.path.append(str(Path(__file__).parent))
import brute_force

MERSENNE = 2**61 - 1  # a prime that is none of ours, beyond the reach of our arithmetic


def grid(buses, seed, sensors):
    """
    Make the swing equations of a small-world grid: angles and speeds, some angles measured.

    Couplings are computed numbers, and the angles of all buses may turn together.
    """
    rng = np.random.default_rng(seed)
    coupling = np.zeros((buses, buses))
    for i in range(buses):
        for j in {(i + 1) % buses, int(rng.integers(buses)) if rng.random() < 0.2 else i} - {i}:
            coupling[i, j] = coupling[j, i] = rng.uniform(1.0, 3.0)
    stiffness = (np.diag(coupling.sum(axis=1)) - coupling) / rng.uniform(1.0, 2.0, (buses, 1))
    A = np.block([[np.zeros((buses, buses)), np.eye(buses)],
                  [-stiffness, -np.diag(rng.uniform(0.3, 0.6, buses))]])
    at = rng.permutation(buses)[:sensors]
    return A, np.eye(2 * buses)[at]


def directed(nodes, seed):
    """Make a network of three states a node, the third of which no other state hears."""
    rng = np.random.default_rng(seed)
    A = np.kron(np.diag(rng.uniform(2, 5, nodes)), [[-1.0, -1, 0], [1, -1, 0], [1, 0, -1]])
    for i in range(nodes):
        for j in {(i + 1) % nodes, (i - 1) % nodes, int(rng.integers(nodes))} - {i}:
            A[3 * i + 1, [3 * j + 1, 3 * i + 1]] += [1, -1]
    return A, np.eye(3 * nodes)[3 * rng.permutation(nodes)]


def residues(M):
    numbers = [[Fraction(repr(float(x))) for x in row] for row in M]
    return [[x.numerator * pow(x.denominator, -1, MERSENNE) % MERSENNE for x in row]
            for row in numbers]


def freedom_by_flint(flint, A, C, v, k_max):
    """Count as ``exact.polynomial_freedom`` does, by FLINT's ranks modulo another prime."""
    def matrix(rows):
        return flint.nmod_mat(len(rows), len(A), [x for row in rows for x in row], MERSENNE)

    def moved(rows):
        return [[int(x) for x in row] for row in (matrix(rows) * by).tolist()]

    by, rows = matrix(residues(A)), residues(C)
    last, seen, own, found = residues(v[None, :]), [], [], []
    exists = False
    for _ in range(k_max + 1):
        seen = seen + rows
        rank, both = matrix(seen).rank(), matrix(seen + own).rank() if own else 0
        both = max(both, rank)
        exists = exists or matrix(seen + own + last).rank() == both
        found.append(len(own) - both + rank if exists else None)
        if not exists:
            own, last = own + last, moved(last)
        else:  # the number of free coefficients grows by what the readings add
            own = own + last
            last = moved(last)
        rows = moved(rows)
    return tuple(found)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 7))
def test_a_rank_modulo_a_prime_is_never_above_that_of_the_rationals(seed, m, n):
    rng = np.random.default_rng(seed)
    M = rng.integers(-3, 4, (m, n)) * (rng.random((m, n)) < 0.5).astype(float)
    truth = brute_force.rank(brute_force.meant(M))
    small = 7  # unlucky now and then
    assert exact.rank(M.astype(np.int64) % small, small) <= truth
    assert exact.rank(exact.to_residues(M, exact.PRIMES[0]), exact.PRIMES[0]) == truth


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(2, 5), st.integers(1, 2))
def test_orders_of_numbers_as_given_are_those_of_the_definition(seed, n, sensors):
    """The numbers have all their digits; what each stands for is its shortest decimal."""
    rng = np.random.default_rng(seed)
    A = np.where(rng.random((n, n)) < 0.5, rng.uniform(-1, 1, (n, n)), 0.0)
    C, v = np.eye(n)[rng.permutation(n)[:sensors]], np.eye(n)[[rng.integers(n)]]
    D = np.zeros((n, 0))
    assert exact.verdict(A + np.pi * np.eye(n), C, v, D) is None
    answer = exact.verdict(A, C, v, D, k_max=n, as_given=True)
    A, C, v, D = map(brute_force.meant, (A, C, v, D))
    truth = [brute_force.freedom(A, C, v[0], D, [[] for _ in C], [], k) for k in range(n + 1)]
    assert answer.solvable == (any(free is not None for free in truth),)
    assert not answer.solvable[0] or list(answer.freedom[0]) == truth


@pytest.mark.parametrize('seed', [0, 1])
def test_orders_of_a_grid_are_those_of_another_arithmetic(seed):
    flint = pytest.importorskip('flint', reason='python-flint is the referee: not installed')
    A, C = grid(30, seed, 4)
    orders = exact.verdict(A, C[1:], C[:1], np.zeros((60, 0)), k_max=24, as_given=True)
    assert orders.freedom[0][:25] == freedom_by_flint(flint, A, C[1:], C[0], 24)
    assert any(free is not None for free in orders.freedom[0][:25])


@given(st.integers(0, 400), st.integers(0, 300), st.integers(0, 300))
def test_strides_find_the_least_of_what_stays_good(least, first, more):
    asked = []

    def good(k):
        asked.append(k)
        return k >= least

    last = first + more
    found = by_strides(good, first, last)
    assert found == (None if least > last else max(least, first))
    assert len(asked) == len(set(asked)) <= 2 * np.log2(more + 2) + 2
    assert all(first <= k <= last for k in asked)


@pytest.fixture(scope='module')
def lost_angle():
    A, C = grid(LARGE // 2 + 2, 0, 3)
    plant = Plant.from_matrices(A, None, C)
    return plant, design(plant, [('y1',)])


@pytest.mark.slow
def test_a_least_order_of_no_use_is_said_to_be_so(lost_angle, tmp_path):
    plant, result = lost_angle
    sensor = result[('y1',), 'y1']
    freedom = exact.verdict(plant.A, plant.C[1:], plant.C[:1], plant.D, as_given=True).freedom[0]
    least = next(k for k, free in enumerate(freedom) if free is not None)
    proof = sensor.proof
    assert proof.modulo and least <= proof.lower <= proof.upper < sensor.order
    assert all(s.verdict == 'impossible' for s in proof.steps if s.order < least)
    found = {rung.order: rung.noise for rung in sensor.ladder}
    useless = next(s for s in proof.steps if s.order == proof.upper)
    assert 'of no use' in useless.why and found[proof.upper] > 4 * sensor.noise.error
    assert len([s for s in proof.steps if s.order > least]) < 12  # strides
    assert f'between {proof.lower} and {proof.upper}' in said_of_order(sensor)
    unbuilt = replace(sensor, ladder=tuple(r for r in sensor.ladder if r.order != proof.upper))
    assert 'of no use: its gains are beyond double precision' in said_of_order(unbuilt)
    known = replace(unbuilt, proof=replace(proof, lower=proof.upper))
    assert f'the least is {proof.upper}, modulo two primes' in said_of_order(known)
    result.save(tmp_path / 'design.json')
    assert Design.load(tmp_path / 'design.json')[('y1',), 'y1'].proof == proof


@pytest.mark.slow
def test_what_serves_instead_is_as_quiet_as_the_filter(lost_angle):
    plant, result = lost_angle
    sensor = result[('y1',), 'y1']
    assert sensor.noise.ratio < 2.0 and (sensor.eigenvalues.real < 0).all()
    residual = sensor.Phi @ plant.A - sensor.N @ sensor.Phi - sensor.J @ plant.C[1:]
    assert np.abs(residual).max() < 1e-7 * np.abs(plant.A).max()


def test_many_functionals_of_a_large_plant_are_had_at_once_with_honest_bounds():
    """The first is read: its own bounds say nothing of the others'."""
    nodes, sensors, wanted = LARGE // 2 + 2, 6, 25
    A, firsts = directed(nodes, 0)
    plant = Plant.from_matrices(A, None, firsts[:sensors])
    rows = firsts[sensors - 1:sensors + wanted]
    sensor = design(plant, wanted={'v': rows})[(), 'v']
    # less than all that the sensors hear, two states a node, and no noisier
    assert sensor.order < 2 * nodes - sensors and sensor.noise.ratio < 2.0
    assert wanted <= sensor.proof.lower <= sensor.proof.upper <= sensor.order
    np.testing.assert_allclose(sensor.Cv @ sensor.Phi + sensor.Q @ plant.C, rows, atol=1e-8)
    residual = sensor.Phi @ A - sensor.N @ sensor.Phi - sensor.J @ plant.C
    assert np.abs(residual).max() < 1e-8 * np.abs(A).max()
