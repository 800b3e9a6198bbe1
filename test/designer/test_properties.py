"""What must hold for every design, on random plants, with an independent test of the order."""

from fractions import Fraction

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros import design, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.subspaces import conditioned_invariant
from vsensor_ros.observers import VirtualSensor


@st.composite
def plants(draw):
    """Draw small plants, dense or sparse, with or without unknown inputs."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, outputs = draw(st.integers(2, 7)), draw(st.integers(1, 3))
    disturbances, inputs = draw(st.integers(0, 2)), draw(st.integers(0, 2))
    A = rng.normal(size=(n, n))
    if draw(st.booleans()):
        A *= rng.random((n, n)) < 0.5
    sample_time = draw(st.sampled_from([None, 0.1]))
    eigenvalues = np.linalg.eigvals(A)
    if sample_time is not None:
        A = A / max(np.abs(eigenvalues).max(), 0.1) * draw(st.sampled_from([0.9, 1.2]))
    elif draw(st.booleans()):
        A = A - (eigenvalues.real.max() + 0.2) * np.eye(n)
    C = np.eye(n)[rng.permutation(n)[:outputs]] if draw(st.booleans()) else (
        rng.normal(size=(outputs, n)))
    D = rng.normal(size=(n, disturbances)) if draw(st.booleans()) else (
        np.eye(n)[:, rng.permutation(n)[:disturbances]])
    return Plant.from_matrices(A, rng.normal(size=(n, inputs)), C, D=D, sample_time=sample_time)


def polynomial_test(A, C0, V, D, k):
    """
    Solve method 3.4 for order k: is there any polynomial, and is every one reachable.

    Independent of the designer: unknown p_0..p_{k-1} and M_0..M_k in one linear system.
    """
    A = A / max(np.linalg.norm(A, 2), 1e-300)  # a change of the unit of time
    n, l0 = A.shape[0], C0.shape[0]
    unknowns = k + (k + 1) * l0

    columns, rhs = [], []
    # phi_1 = V - M_k C0, phi_{i+1} = phi_i A + p_{k-i} V - M_{k-i} C0, phi_{k+1} = 0
    phi = np.zeros((unknowns + 1, n))  # affine in the unknowns; the last row is the constant
    phi[-1] = V
    phi[k + k * l0:k + (k + 1) * l0] = -C0
    for i in range(1, k + 1):
        columns.append(phi[:-1] @ D)
        rhs.append(-phi[-1] @ D)
        phi = phi @ A
        phi[k - i] += V[0]
        phi[k + (k - i) * l0:k + (k - i + 1) * l0] -= C0
    columns.append(phi[:-1])
    rhs.append(-phi[-1])
    matrix, wanted = np.hstack(columns).T, np.concatenate(rhs)
    if matrix.size == 0:
        return bool(np.all(np.abs(wanted) < 1e-7)), k == 0
    solution, _, _, sigma = np.linalg.lstsq(matrix, wanted, rcond=1e-10)
    feasible = np.linalg.norm(matrix @ solution - wanted) < 1e-7 * (1 + np.linalg.norm(wanted))
    _, s, Vt = np.linalg.svd(matrix)
    null = Vt[int(np.sum(s > 1e-9 * s[0])):].T
    free = np.linalg.matrix_rank(null[:k], tol=1e-6) if k else 0
    return bool(feasible), free == k


@pytest.mark.usefixtures('without_alternatives')
@settings(max_examples=15)
@given(plants())
def test_every_virtual_sensor_satisfies_its_equations(plant):
    for entry in design(plant).virtual_sensors:
        rows = [plant.sensors.index(s) for s in entry.healthy]
        C0, V = plant.C[rows], plant.C[[plant.sensors.index(entry.channel)]]
        assert entry.channel not in entry.healthy
        size = np.linalg.norm(entry.Phi) * np.linalg.norm(plant.A) + 1e-30
        assert np.linalg.norm(
            entry.Phi @ plant.A - entry.N @ entry.Phi - entry.J @ C0) < 1e-8 * size
        assert np.linalg.norm(V - entry.Cv @ entry.Phi - entry.Q @ C0) < 1e-8
        assert np.linalg.norm(entry.Phi @ plant.D) <= 1e-8 * max(np.linalg.norm(entry.Phi), 1)
        np.testing.assert_allclose(entry.B, entry.Phi @ plant.B, atol=1e-9)
        if entry.grade == 'temporary':
            continue
        eigenvalues = np.linalg.eigvals(entry.N)
        if plant.sample_time is None:
            assert np.all(eigenvalues.real < 0)
        else:
            assert np.all(np.abs(eigenvalues) < 1)


@pytest.mark.slow
@pytest.mark.usefixtures('without_alternatives')
@settings(max_examples=25)
@given(plants())
def test_smaller_orders_are_infeasible_and_refusals_are_true(plant):
    result = design(plant, prefer='least', temporary=False)
    for (fault_set, channel), entry in result.entries.items():
        rows = [i for i, s in enumerate(plant.sensors) if s not in fault_set]
        C0, V = plant.C[rows], plant.C[[plant.sensors.index(channel)]]
        tests = {k: polynomial_test(plant.A, C0, V, plant.D, k)
                 for k in range(len(plant.A) + 1)}
        if isinstance(entry, VirtualSensor):
            assert tests[entry.order][0]
            for k in range(entry.order):  # feasible with every spectrum would have been found
                assert not (tests[k][0] and tests[k][1])
        else:
            assert not any(feasible and any_spectrum for feasible, any_spectrum in tests.values())
            if 'unknown input' in entry.reason:
                assert not any(feasible for feasible, _ in tests.values())


@pytest.mark.usefixtures('without_alternatives')
@settings(max_examples=15)
@given(plants(), st.integers(0, 2**31))
def test_the_error_forgets_its_start_whatever_the_disturbance(plant, seed):
    """Simulate plant and virtual sensor as discrete maps; truth is the plant's own output."""
    if plant.sample_time is None:
        h = 0.05 / (1 + np.linalg.norm(plant.A, 2))  # the equations hold for I + h A as well
        plant = Plant.from_matrices(np.eye(len(plant.A)) + h * plant.A, h * plant.B, plant.C,
                                    D=h * plant.D, sample_time=h)
    rng = np.random.default_rng(seed)
    for entry in design(plant, temporary=False).virtual_sensors:
        C0 = plant.C[[plant.sensors.index(s) for s in entry.healthy]]
        V = plant.C[plant.sensors.index(entry.channel)]
        spectral = np.abs(entry.eigenvalues).max(initial=0.0)
        if spectral > 0.9:
            continue  # forgets too slowly for a short simulation
        x, z = rng.normal(size=len(plant.A)), rng.normal(size=entry.order)
        start = abs(V @ x - (entry.Cv @ z + entry.Q @ C0 @ x)[0])
        size = start + 1.0
        for _ in range(40):
            u = rng.normal(size=len(plant.inputs))
            rho = 1e3 * rng.normal(size=len(plant.disturbances))
            y0 = C0 @ x
            z = entry.N @ z + entry.J @ y0 + entry.B @ u
            x = plant.A @ x + plant.B @ u + plant.D @ rho
            size = max(size, np.linalg.norm(x))
        e = entry.Phi @ x - z
        # what is left is the start, contracted, and rounding of states that may have grown
        bound = np.linalg.norm(np.linalg.matrix_power(entry.N, 40)) * (
            np.linalg.norm(entry.Phi) * 10 + 10 * np.sqrt(entry.order))
        gain = 1 + np.linalg.norm(entry.J) + np.linalg.norm(entry.Phi)
        assert np.linalg.norm(e) <= bound + 1e-8 * gain * size


def exact_dimension(A, C0, D):
    """Dimension of T* by the same recursion in exact rational arithmetic."""
    def rref(rows):
        rows, pivots, r = [list(map(Fraction, x)) for x in rows], [], 0
        for c in range(len(rows[0]) if rows else 0):
            p = next((i for i in range(r, len(rows)) if rows[i][c]), None)
            if p is None:
                continue
            rows[r], rows[p] = rows[p], rows[r]
            rows[r] = [v / rows[r][c] for v in rows[r]]
            for i in range(len(rows)):
                if i != r and rows[i][c]:
                    rows[i] = [a - rows[i][c] * b for a, b in zip(rows[i], rows[r])]
            pivots.append(c)
            r += 1
        return rows[:r], pivots

    def null(rows, width):
        reduced, pivots = rref(rows) if rows else ([], [])
        basis = []
        for free in (c for c in range(width) if c not in pivots):
            v = [Fraction(0)] * width
            v[free] = Fraction(1)
            for row, p in zip(reduced, pivots):
                v[p] = -row[free]
            basis.append(v)
        return basis

    T = rref(D.T.tolist())[0]
    while True:
        # combinations t of T with C0 t = 0
        maps = [[sum(c * t for c, t in zip(row, vector)) for vector in T] for row in C0.tolist()]
        inside = [[sum(w * t[j] for w, t in zip(weights, T)) for j in range(len(A))]
                  for weights in null(maps, len(T))]
        moved = [[sum(a * v for a, v in zip(row, vector)) for row in A.tolist()]
                 for vector in inside]
        grown = rref(D.T.tolist() + moved)[0]
        if len(grown) == len(T):
            return len(T)
        T = grown


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.integers(1, 3), st.integers(1, 2))
def test_conditioned_invariant_subspace_against_rational_arithmetic(seed, n, outputs, inputs):
    rng = np.random.default_rng(seed)
    A = rng.integers(-2, 3, (n, n)) * (rng.random((n, n)) < 0.6)
    C0 = rng.integers(-1, 2, (outputs, n))
    D = rng.integers(-1, 2, (n, inputs))
    T = conditioned_invariant(A.astype(float), C0.astype(float), D.astype(float))
    assert T.shape[1] == exact_dimension(A, C0, D)


def test_fault_sets_are_given_in_any_order_and_names_are_checked():
    plant = Plant.from_matrices(-np.eye(3), None, np.eye(3))
    result = design(plant, [('y2', 'y1'), 'y3'])
    assert result[('y1', 'y2'), 'y1'] is result[('y2', 'y1'), 'y1']
    assert result['y3', 'y3'].order == 1
    with pytest.raises(BadInput, match='y9'):
        design(plant, [('y9',)])
    with pytest.raises(BadInput, match='newton'):
        design(plant, method='newton')
    with pytest.raises(KeyError, match='was not designed'):
        result['y1', 'y1']
