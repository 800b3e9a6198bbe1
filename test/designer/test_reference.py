"""The designer against the verified numbers of the papers' cases (test/reference.json)."""

import json
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import design, Plant
from vsensor_ros.designer import papers
from vsensor_ros.designer.canonical import identification_rows, jordan_rows
from vsensor_ros.designer.existence import examine, forced_closure
from vsensor_ros.designer.observer import build, Candidate, close_loop, equation_residuals
from vsensor_ros.designer.problem import pose
from vsensor_ros.designer.subspaces import in_row_space
from vsensor_ros.observers import Refusal, VirtualSensor

REFERENCE = json.loads((Path(__file__).parents[1] / 'reference.json').read_text())
TANK, SERVO = REFERENCE['b_tank_continuous'], REFERENCE['a_servo']


def tank() -> Plant:
    """Return the continuous three-tank plant of paper R, with its formal addends."""
    return Plant.from_matrices(
        [[-1, 1, 0], [1, -2, 1], [0, 1, -2]], [[1, 0], [0, 1], [0, 0]], [[0, 1, 0], [0, 0, 1]],
        P=[[1, 0, 0], [-1, 1, 0], [0, -1, 1]], G=[[1, -1, 0], [0, 1, -1], [0, 0, 1]],
        nonlinearities=['w1 - sqrt(w1)'] * 3, initial=[4, 3, 1], name='tank')


def servo(k7: float = -1.0, sensors: tuple[int, ...] = (0, 1, 2)) -> Plant:
    """Return the servo of paper S (33) with k1 = k3 = k6 = 1, k2 = k4 = k5 = -1."""
    names = ['angle', 'velocity', 'current']
    return Plant.from_matrices(
        [[0, 1, 0], [0, -1, 1], [0, -1, -1]], [0, 0, 1], np.eye(3)[list(sensors)], D=[1, 0, 0],
        P=[0, k7, 0], G=[[0, 1, 0]], nonlinearities=['sign(w1)'], states=names,
        sensors=[names[i] for i in sensors], inputs=['voltage'], disturbances=['rho'])


def discrete_tank() -> Plant:
    """Return the sampled three-tank plant of paper D (26), with addends of slope 0.1."""
    a = 0.1
    return Plant.from_matrices(
        [[1 - a, a, 0], [a, 1 - 2 * a, a], [0, a, 1 - 2 * a]], [[a, 0], [0, 2 * a], [0, 0]],
        np.eye(3), D=[1, 0, 0], sample_time=1.0,
        P=[[a, 0, 0], [-a, a, 0], [0, -a, a]], G=[[1, -1, 0], [0, 1, -1], [0, 0, 1]],
        nonlinearities=['w1 - sqrt(w1)'] * 3)


def sorted_spectrum(values):
    return np.sort_complex(np.asarray(values, dtype=complex))


def pairs(values):
    return [complex(*v) if isinstance(v, list) else complex(v) for v in values]


def in_coordinates(problem, Phi):
    """Write rows of Phi given for the plant's states in the problem's scaled ones."""
    return np.asarray(Phi, dtype=float) * problem.scale


@pytest.fixture(name='tank_y1')
def _tank_y1():
    return pose(tank(), ('y1',), 'y1')


def test_paper_tank_observer_closes_to_the_reference(tank_y1):
    paper = TANK['JCF_paper']
    sensor = build(tank_y1, close_loop(tank_y1, in_coordinates(tank_y1, paper['Phi'])), 'paper')
    np.testing.assert_allclose(sensor.Phi, paper['Phi'], atol=1e-12)
    np.testing.assert_allclose(sensor.N, paper['N_closed_loop'], atol=1e-12)
    np.testing.assert_allclose(sorted_spectrum(sensor.eigenvalues),
                               sorted_spectrum(paper['eig_N']), atol=1e-6)
    np.testing.assert_allclose(sensor.B, paper['Bstar'], atol=1e-12)
    np.testing.assert_allclose(sensor.P, paper['Pstar'], atol=1e-12)
    np.testing.assert_allclose(sensor.Cv[0], paper['Cv'], atol=1e-12)
    for term, name in enumerate(('G1', 'G2')):
        np.testing.assert_allclose(np.hstack([sensor.Gz[term], sensor.Gy[term]])[0],
                                   paper['Gz_Gy'][name], atol=1e-12)


def test_same_eigenvalues_other_rows_are_unstable_and_never_handed_out(tank_y1):
    """The paper's own -1, -2 with Phi_2 = (1, -1, -5) closes to +3.236 (erratum 10)."""
    bad = TANK['JCF_same_lambda_unstable']
    candidate = close_loop(tank_y1, in_coordinates(tank_y1, bad['Phi']))
    np.testing.assert_allclose(sorted_spectrum(np.linalg.eigvals(candidate.N)),
                               sorted_spectrum(pairs(bad['eig_N'])), atol=1e-6)
    assert build(tank_y1, candidate, 'paper') is None


def test_both_papers_choices_are_solutions_of_the_same_jordan_equation():
    plant = tank()
    C = np.vstack([plant.C[1], plant.C[0]])
    for key in ('JCF_paper', 'JCF_same_lambda_unstable'):
        for row, value in zip(TANK[key]['Phi'], TANK[key]['eig_Astar']):
            rows, gains = jordan_rows(plant.A, C, np.zeros((3, 0)), value)
            assert in_row_space(rows, np.array([row], dtype=float))
            np.testing.assert_allclose(rows @ plant.A, value * rows + gains @ C, atol=1e-12)
            assert len(rows) == 2  # keep all of the null space


@pytest.mark.parametrize('k', [1, 2, 3])
def test_identification_form_has_as_many_solutions_as_the_corrected_rank_says(k):
    plant = tank()
    C, C0, V = np.vstack([plant.C[1], plant.C[0]]), plant.C[[1]], plant.C[[0]]
    solutions = identification_rows(plant.A, C, np.zeros((3, 0)), k, C0)
    expected = TANK['ICF'][f'k={k}']
    # the reference counts null rows; those with phi_1 = 0 give no observer and are dropped
    assert 1 <= len(solutions) <= expected['dim_solutions']
    for Phi, J in solutions:
        shifted = np.vstack([Phi[1:], np.zeros((1, 3))])
        np.testing.assert_allclose(Phi @ plant.A, shifted + J @ C, atol=1e-9)
    rng = np.random.default_rng(1)
    satisfied = 0
    for _ in range(50):
        Phi = np.einsum('s,skn', rng.normal(size=len(solutions)),
                        np.array([p for p, _ in solutions]))
        satisfied += in_row_space(np.vstack([Phi, C0]), V)
    assert f'{satisfied}/50' == expected['random_solutions_satisfying_eq12']


def test_identification_form_of_order_three_and_its_correct_gain(tank_y1):
    """Erratum 8 and 9: k = 3 solves the tank, and K = (3, 1, 3) gives -1, -2, -3."""
    paper = TANK['ICF_k3_explicit']
    Phi = in_coordinates(tank_y1, paper['Phi'])
    A_star = np.eye(3, k=1)
    Cv = np.array([[0, 1, 0]])  # v = z2 = x2
    J = np.array(paper['J_cols_y1_y2'])
    N = A_star + J[:, [0]] @ Cv
    np.testing.assert_allclose(sorted_spectrum(np.linalg.eigvals(N)),
                               sorted_spectrum(paper['eig_N_without_K']), atol=1e-6)
    candidate = Candidate(Phi, N, J[:, [1]] * tank_y1.y0_size, Cv / tank_y1.v_size,
                          np.zeros((1, 1)))
    placed = next(papers.with_residual(tank_y1, candidate, np.array([-1.0, -2.0, -3.0])))
    gain = (candidate.N - placed.N)[:, 0]
    np.testing.assert_allclose(gain, paper['K_correct'], atol=1e-8)
    sensor = build(tank_y1, placed, 'identification')
    np.testing.assert_allclose(sorted_spectrum(sensor.eigenvalues), [-3, -2, -1], atol=1e-7)


@pytest.mark.slow
def test_tank_orders_and_existence(tank_y1):
    result = design(tank(), [('y1',), ('y2',), ('y1', 'y2')])
    assert result[('y1',), 'y1'].order == TANK['unified_failed_y1']['k_min_from_Vext'] == 2
    assert result[('y2',), 'y2'].order == len(TANK['failed_y2_order1']['Phi']) == 1
    np.testing.assert_allclose(result[('y2',), 'y2'].Phi, [[0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(result[('y2',), 'y2'].N, [[-2]], atol=1e-12)
    np.testing.assert_allclose(result[('y2',), 'y2'].P, [[0, -1, 1]], atol=1e-12)
    assert result[('y1', 'y2'), 'y1'].order == REFERENCE['b_tank_continuous'][
        'sim_both_failed']['order']
    assert forced_closure(tank_y1)[0] == frozenset()


def test_servo_velocity_from_angle_and_current():
    plant = servo()
    sensor = design(plant)[('velocity',), 'velocity']
    assert sensor.order == 1
    assert sensor.reads == ('current',)
    np.testing.assert_array_equal(sensor.Phi @ plant.D, 0.0)
    # a member of the family z = x2 + b x3, b = (lambda - k2) / k4 (erratum 3)
    lam, b = sensor.N[0, 0], sensor.Phi[0, 2] / sensor.Phi[0, 1]
    assert b == pytest.approx((lam + 1) / -1)
    assert sensor.J[0, 1] / sensor.Phi[0, 1] == pytest.approx(1 - b - lam * b)


@pytest.mark.parametrize('member', SERVO['family_any_rate']['members'],
                         ids=lambda m: f'lambda={m["lam"]}')
def test_servo_family_of_any_rate(member):
    problem = pose(servo(), ('velocity',), 'velocity')
    sensor = build(problem, close_loop(problem, in_coordinates(problem, member['Phi'])), 'paper')
    size = sensor.Phi[0, 1]  # our rows have largest entry one
    np.testing.assert_allclose(sensor.N, member['N'], atol=1e-12)
    np.testing.assert_allclose(sensor.J / size, member['J'], atol=1e-12)
    np.testing.assert_allclose(sensor.B / size, member['Bstar'], atol=1e-12)
    np.testing.assert_allclose(sensor.Q, member['Q'], atol=1e-12)
    np.testing.assert_allclose(sensor.Gy[0][0], member['Gy'], atol=1e-12)


def test_friction_of_a_measured_speed_is_kept_out():
    """At rest the sign of a measured speed is not known; z = current needs no friction."""
    sensor = design(servo())[('current',), 'current']
    assert sensor.active == ()
    np.testing.assert_allclose(sensor.Phi, [[0, 0, 1]], atol=1e-12)
    assert sensor.N[0, 0] == pytest.approx(-1.0)


def test_friction_of_a_measured_speed_is_named_where_it_cannot_be_kept_out():
    """A spring behind dry friction: the force is seen through the speed's equation only."""
    plant = Plant.from_matrices(
        [[-1, 1, 0], [0, 0, -1], [0, 0, -0.5]], [0, 0, 1], np.eye(3), D=[0, 1, 0],
        P=[-1, 0, 0], G=[[0, 1, 0]], nonlinearities=['sign(w1)'],
        states=['lag', 'speed', 'force'])
    sensor = design(plant)[('y1',), 'y1']
    assert sensor.active == (0,)
    assert 'at rest unsure of sign(speed)' in sensor.method


def test_servo_fault_sets_follow_the_reference():
    only_angle = design(servo(), [('velocity', 'current')])
    for channel in ('velocity', 'current'):
        sensor = only_angle[('velocity', 'current'), channel]
        assert sensor.order == SERVO['failed_y2']['order']
        np.testing.assert_allclose(sorted_spectrum(sensor.eigenvalues),
                                   sorted_spectrum(pairs(SERVO['failed_y2']['fixed_modes'])),
                                   atol=1e-9)
    refusal = design(servo())[('angle',), 'angle']
    assert isinstance(refusal, Refusal)
    assert 'rho' in refusal.reason and 'velocity and current' in refusal.reason


def test_discrete_tank_x3_is_decoupled_with_fixed_mode_and_x1_is_refused():
    result = design(discrete_tank(), [('y1', 'y3')])
    sensor = result[('y1', 'y3'), 'y3']
    np.testing.assert_allclose(np.abs(sensor.Phi), [[0, 0, 1]], atol=1e-12)
    assert sensor.N[0, 0] == pytest.approx(REFERENCE['c_tank_discrete']['LD_x3']['N_closed'])
    np.testing.assert_allclose(sensor.P, [[0, -0.1, 0.1]], atol=1e-12)
    refusal = result[('y1', 'y3'), 'y1']
    assert isinstance(refusal, Refusal) and 'rho' in refusal.reason


def test_forced_closure_of_the_discrete_tank():
    problem = pose(discrete_tank(), ('y1', 'y3'), 'y3')
    assert sorted(forced_closure(problem)[0]) == REFERENCE['c_tank_discrete'][
        'unified A=I (no addends)']['decoupled x3']['forced'] == [0]


def test_output_that_contains_the_disturbance_may_be_used():
    """Erratum 17: v = x1 + x2 is exact through vhat = z + y1 although y1 carries rho."""
    plant = servo()
    C = np.vstack([plant.C[[0, 2]], plant.C[0] + plant.C[1]])
    summed = Plant.from_matrices(
        plant.A, plant.B, C, D=plant.D, P=plant.P, G=plant.G, nonlinearities=['sign(w1)'])
    sensor = design(summed)[('y3',), 'y3']
    assert isinstance(sensor, VirtualSensor)
    assert sensor.Q[0, 0] == pytest.approx(1.0)
    np.testing.assert_allclose(sensor.Phi @ plant.D, 0.0, atol=1e-12)


@pytest.mark.parametrize('method', ['jordan', 'identification'])
def test_each_canonical_form_solves_the_tank(method):
    plant = tank()
    result = design(plant, method=method)
    for channel in plant.sensors:
        sensor = result[(channel,), channel]
        assert sensor.method == method
        assert sensor.eigenvalues.real.max() < 0
        problem = pose(plant, (channel,), channel)
        assert max(equation_residuals(problem, sensor).values()) < 1e-9


def test_unstable_hidden_mode_is_named():
    """Two decoupled axes; the sensor of the unstable one has failed."""
    plant = Plant.from_matrices([[-1, 0], [0, 0.3]], [[1], [1]], np.eye(2),
                                states=['left', 'right'])
    refusal = design(plant, temporary=False)[('y2',), 'y2']
    assert 'real part 0.3 in right' in refusal.reason
    assert examine(pose(plant, ('y2',), 'y2')).quotient is None


def test_unknown_argument_of_a_nonlinear_term_is_named():
    plant = Plant.from_matrices(
        [[-1, 0], [0, -1]], None, np.eye(2), D=[0, 1], P=[1, 0], G=[[0, 1]],
        nonlinearities=['sin(w1)'], states=['arm', 'load'])
    refusal = design(plant, [('y1', 'y2')])[('y1', 'y2'), 'y1']
    assert 'sin(load)' in refusal.reason


@pytest.mark.slow
def test_a_row_of_tanks_reads_the_neighbours_only():
    """All levels are measured; those next to the failed one are enough."""
    n = 6
    G = np.eye(n) - np.eye(n, k=1)
    P = -np.eye(n) + np.eye(n, k=-1)
    plant = Plant.from_matrices(P @ G, np.eye(n)[:, :1], np.eye(n), P=P, G=list(G),
                                nonlinearities=['sqrt(w1) - w1'] * n)
    result = design(plant)
    for i in range(n):
        sensor = result[(f'y{i + 1}',), f'y{i + 1}']
        neighbours = {f'y{j + 1}' for j in (i - 1, i + 1) if 0 <= j < n}
        assert sensor.order == 1 and set(sensor.reads) <= neighbours
        assert sensor.J.shape == sensor.Q.shape == (1, n - 1)
        problem = pose(plant, sensor.fault_set, sensor.channel)
        assert max(equation_residuals(problem, sensor).values()) < 1e-12
