"""Orders with their proofs, the choice among them, and the noise that is claimed."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from scipy.linalg import block_diag, solve_continuous_are, solve_continuous_lyapunov

from vsensor_ros import design, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.noise import kalman, noise_model
from vsensor_ros.designer.observer import equation_residuals
from vsensor_ros.designer.order import families
from vsensor_ros.designer.problem import pose
from vsensor_ros.designer.quotient import quotient
from vsensor_ros.designer.stabilise import stable_members
from vsensor_ros.observers import Refusal, VirtualSensor
from vsensor_ros.observers.kinds.functional import decay_of


def heat_rod():
    """Return 20 cells in a row that exchange heat, measured at cells 1, 5 and 10."""
    A = 0.04 * (np.eye(20, k=1) + np.eye(20, k=-1) - 2 * np.eye(20))
    return Plant.from_matrices(A, np.eye(20)[:, :1], np.eye(20)[[0, 4, 9]])


def test_heat_rod_is_proved_least_at_eleven():
    """A search of canonical forms stopped at 15; the copy of cells 6 to 20 is not the least."""
    sensor = design(heat_rod(), [('y3',)], prefer='least')['y3', 'y3']
    assert (sensor.proof.lower, sensor.proof.upper, sensor.order) == (11, 11, 11)
    assert [s.verdict for s in sensor.proof.steps] == ['impossible'] * 11 + ['possible']
    assert all(s.gap[0] < 1e-12 and s.gap[1] > 1e-3 for s in sensor.proof.steps)
    assert sensor.proof.doubts == ()


def chain(n, measured, sample_time=None):
    """Return a chain of equal tanks, each filled by the one before: repeated modes."""
    A = -np.eye(n) + np.eye(n, k=-1)
    if sample_time is not None:
        A = np.eye(n) + sample_time * A
    return Plant.from_matrices(A, np.eye(n)[:, :1], np.eye(n)[measured], sample_time=sample_time)


@pytest.mark.parametrize('sample_time', [None, 0.1])
def test_repeated_hidden_modes_are_copied_and_no_more(sample_time):
    """Only the last of six tanks is measured; what the fourth holds is a copy."""
    plant = chain(6, [3, 5], sample_time)
    sensor = design(plant, [('y1', 'y2')], prefer='least')[('y1', 'y2'), 'y1']
    assert sensor.order == sensor.proof.lower == 4
    np.testing.assert_allclose(sensor.eigenvalues, -1 if sample_time is None else 0.9, atol=1e-3)


def test_one_free_coefficient_is_decided_exactly():
    """Order 2 leaves s^2 + t s + 1 - t: stable just for 0 < t < 1."""
    # v = x1 of a chain of three integrators, x3 measured with a mix that fixes p1 + p0 = 1
    plant = Plant.from_matrices([[0, 1, 0], [0, 0, 1], [0, 0, 0]], None,
                                [[1, 0, 0], [0, 1, -1]])
    problem = pose(plant, ('y1',), 'y1')
    known = quotient(problem, np.eye(3))
    for _, family, _ in families(known):
        if family is not None and len(family.F) == 1:
            roots = [family.roots(np.array([t])) for t in np.linspace(-50, 50, 20001)]
            best = max(decay_of(r, None) for r in roots)
            members, none = stable_members(family, None, 1.0)
            assert bool(members) == (best > 1e-6)
            assert members or none.proved


def test_a_crossing_at_infinity_does_not_hide_a_stable_interval():
    """Four masses without damping; one coefficient is free at order 3, and large ones serve."""
    K = 2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
    K[3, 3] = 1
    plant = Plant.from_matrices(
        np.block([[np.zeros((4, 4)), np.eye(4)], [-K, np.zeros((4, 4))]]), None,
        np.eye(8)[[6, 1, 4]], D=np.eye(8)[:, 1], Cd=[[1], [0], [0]])
    sensor = design(plant, wanted={'w': [-1, -1, 0, -1, -1, 0, 0, -1]}, prefer='least')[(), 'w']
    assert sensor.order == sensor.proof.lower == 3


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_a_stable_member_is_found_where_a_scan_finds_one(seed):
    """Families of one free coefficient, against a dense scan of it."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    A = rng.normal(size=(n, n))
    if rng.random() < 0.5:
        A -= (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(n)
    plant = Plant.from_matrices(A, None, rng.normal(size=(2, n)))
    known = quotient(pose(plant, ('y1',), 'y1'), np.eye(n))
    for _, family, _ in families(known):
        if family is None or len(family.F) != 1:
            continue
        size = np.linalg.norm(family.M, 2)
        scan = size * np.concatenate([-np.geomspace(1e-4, 1e3, 2000), [0],
                                      np.geomspace(1e-4, 1e3, 2000)])
        best = max(decay_of(family.roots(np.array([t])), None) for t in scan)
        members, none = stable_members(family, None, 1.0)
        if best > 1e-6 * size:
            assert members
        if members:
            assert decay_of(family.roots(members[0]), None) > 0
        else:
            assert none.proved


def noisy(n=4, seed=0):
    """Return a discrete plant with given noise of sensors and process."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    return Plant.from_matrices(A, None, rng.normal(size=(3, n)), sample_time=0.1,
                               noise=[0.1, 0.2, 0.3], process_noise=[0.05] * n)


@pytest.mark.parametrize('prefer', ['quiet', 'least'])
def test_noise_that_is_claimed_is_the_noise_of_a_simulation(prefer):
    plant = noisy()
    rng = np.random.default_rng(1)
    steps, many = 400, 200  # runs side by side
    for channel in plant.sensors:
        sensor = design(plant, [(channel,)], prefer=prefer)[channel, channel]
        assert not sensor.noise.assumed
        rows = [plant.sensors.index(s) for s in sensor.healthy]
        x, z = np.zeros((4, many)), np.zeros((sensor.order, many))
        errors = np.zeros((steps, many))
        for i in range(steps):
            y0 = plant.C[rows] @ x + plant.noise[rows, None] * rng.normal(size=(2, many))
            v = plant.C[plant.sensors.index(channel)] @ x
            errors[i] = v - (sensor.Cv @ z + sensor.Q @ y0)[0]
            z = sensor.N @ z + sensor.J @ y0
            x = plant.A @ x + plant.process_noise[:, None] * rng.normal(size=(4, many))
        assert np.std(errors[200:]) == pytest.approx(sensor.noise.error, rel=0.06)
        assert sensor.noise.floor <= sensor.noise.error * (1 + 1e-9)


def test_the_floor_is_the_error_of_a_kalman_filter():
    """Iterate the covariance of the textbook's filter until it stands."""
    plant = noisy(seed=3)
    sensor = design(plant, [('y1',)])['y1', 'y1']
    C, R, W = plant.C[1:], np.diag(plant.noise[1:] ** 2), np.diag(plant.process_noise**2)
    P = np.eye(4)
    for _ in range(2000):
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        filtered = (np.eye(4) - K @ C) @ P
        P = plant.A @ filtered @ plant.A.T + W
    assert sensor.noise.floor == pytest.approx(
        np.sqrt(plant.C[0] @ filtered @ plant.C[0]), rel=1e-4)


@pytest.mark.slow
@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_no_design_is_quieter_than_the_filter(seed, discrete):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    A = rng.normal(size=(n, n))
    A = (0.9 * A / np.abs(np.linalg.eigvals(A)).max() if discrete
         else A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n))
    plant = Plant.from_matrices(A, None, rng.normal(size=(3, n)),
                                sample_time=0.1 if discrete else None)
    for entry in design(plant, prefer='least').virtual_sensors:
        problem = pose(plant, entry.fault_set, entry.channel)
        noise = noise_model(problem)
        best = kalman(quotient(problem, np.eye(n)), noise)
        assert entry.noise.error >= (1 - 1e-6) * np.sqrt(best.floor) * problem.v_size[0]


def test_quiet_takes_the_least_order_within_a_factor_of_the_best():
    plant = noisy(seed=5)
    for entry in design(plant).virtual_sensors:
        best = min(rung.noise for rung in entry.ladder)
        assert entry.noise.error <= 2.0 * best + 1e-12
        assert [r.order for r in entry.ladder] == sorted(r.order for r in entry.ladder)
        assert entry.ladder[0].order == entry.proof.upper


def test_quiet_does_not_take_a_difference_of_nearly_equal_readings():
    """Order 0 exists, (y2 - y1)/0.3, with five times the noise of a reading."""
    plant = Plant.from_matrices([[-1, 0.5], [0.2, -2]], None, [[1, 0], [1, 0.3], [0, 1]],
                                noise=[0.01] * 3, process_noise=[0.01] * 2)
    quiet, least = (design(plant, [('y3',)], prefer=p)['y3', 'y3'] for p in ('quiet', 'least'))
    assert least.order == quiet.proof.upper == quiet.proof.lower == 0
    assert least.noise.error == pytest.approx(0.01 * np.sqrt(2) / 0.3, rel=1e-9)
    assert quiet.order >= 1 and quiet.noise.error < 0.02
    assert quiet.ladder[0].order == 0


def test_complex_fixed_modes_are_met_exactly():
    """Two masses on a spring: the hidden pair must be copied, and nothing else."""
    plant = Plant.from_matrices(
        [[0, 1, 0, 0], [-900, -.5, 900, .4], [0, 0, 0, 1], [45, .02, -45, -.03]], None,
        np.eye(4)[[0, 2, 1]], D=np.eye(4)[:, 1])
    sensor = design(plant, [('y2',)], prefer='least')['y2', 'y2']
    assert sensor.order == sensor.proof.lower == 2


@pytest.mark.parametrize('n', [5, 40])
def test_delay_lines_need_all_but_what_is_read(n):
    plant = Plant.from_matrices(np.eye(n, k=-1), None, np.eye(n)[[0, n - 1]], sample_time=1.0)
    sensor = design(plant, [('y2',)], prefer='least')['y2', 'y2']
    assert sensor.order == sensor.proof.lower == n - 1


@pytest.mark.slow
def test_an_order_with_any_spectrum_is_never_called_impossible():
    """Twenty integrators: nothing is left of a linear program over such coefficients."""
    plant = Plant.from_matrices(np.eye(20, k=1), None, np.eye(20)[[0, 2]])
    entry = design(plant, [('y2',)], prefer='least')['y2', 'y2']
    assert entry.proof.lower <= 19
    assert all(s.verdict != 'impossible' for s in entry.proof.steps if s.freedom == s.order > 0)


def test_units_do_not_decide_stability():
    A = np.array([[-4.365, -.6723, -.3363], [7.0880, -6.5570, -4.6010], [-2.41, 7.584, -14.31]])
    unit = np.array([1e5, 1e-3, 1e5])
    for s in (np.ones(3), unit):
        plant = Plant.from_matrices(A * s[:, None] / s, None, np.eye(3)[[2, 0]] / s,
                                    D=np.eye(3)[:, 0] * s)
        assert design(plant, [('y1',)], prefer='least')['y1', 'y1'].order == 2
    light = Plant.from_matrices([[0, 1, 0, 0], [-1e6, -1e-4, 1, 0], [0, 0, -1, 0], [0, 0, 0, -2]],
                                None, np.eye(4)[[2, 0]])
    assert isinstance(design(light)['y2', 'y2'], VirtualSensor)


def test_stable_cascades_can_always_be_copied():
    """Equal parts in a row: their computed eigenvalues scatter, they themselves do not."""
    cell = np.array([[-.1, 1], [-1, -.1]])
    A = np.kron(np.eye(20), cell) + np.kron(np.eye(20, k=-1), [[0, 0], [1, 0]])
    plant = Plant.from_matrices(A, None, np.eye(40)[[0, 38]])
    assert isinstance(design(plant, [('y2',)])['y2', 'y2'], VirtualSensor)


def test_several_rows_are_no_larger_than_single_observers_side_by_side():
    plant = Plant.from_matrices([[0, 1, 0, 0], [0, 0, -7, 0], [0, 0, 0, 1], [-9, 0, 0, 0]], None,
                                np.eye(4)[[2, 3, 0]])
    rows = np.eye(4)[[1, 3]]
    result = design(plant, wanted={'both': rows, 'a': rows[0], 'b': rows[1]}, prefer='least')
    both, a, b = (result[(), name] for name in ('both', 'a', 'b'))
    assert both.order <= a.order + b.order
    np.testing.assert_allclose(both.Cv @ both.Phi + both.Q @ plant.C, rows, atol=1e-9)


def test_a_functional_that_rho_moves_is_refused_beside_others():
    plant = Plant.from_matrices([[0, 1, 0], [0, -1, 1], [0, -1, -1]], [0, 0, 1], np.eye(3),
                                D=[1, 0, 0])
    result = design(plant, [('y1',)], wanted={'two': [[1, 0, 0], [0, 0, 1]]})
    assert isinstance(result[('y1',), 'two'], Refusal)


def test_a_wanted_decay_rate_is_met_where_it_can_be():
    plant = Plant.from_matrices([[0, 1], [0, 0]], [0, 1], np.eye(2), sensors=['angle', 'rate'])
    for decay in (0.5, 5.0):
        sensor = design(plant, [('rate',)], decay=decay)['rate', 'rate']
        assert sensor.eigenvalues.real.max() <= -0.5 * decay
    assert isinstance(design(plant, temporary=False)['angle', 'angle'], Refusal)


def test_several_functionals_are_had_at_once_with_their_bounds():
    rng = np.random.default_rng(2)
    A = rng.normal(size=(6, 6)) - 3 * np.eye(6)
    plant = Plant.from_matrices(A, rng.normal(size=(6, 1)), rng.normal(size=(2, 6)))
    rows = rng.normal(size=(2, 6))
    result = design(plant, wanted={'one': rows[0], 'both': rows})
    one, both = result[(), 'one'], result[(), 'both']
    assert both.Cv.shape == (2, both.order) and both.Q.shape == (2, 2)
    assert both.proof.lower >= one.proof.lower >= 1
    for name, wanted in (('one', rows[:1]), ('both', rows)):
        problem = pose(plant, (), name, wanted)
        assert max(equation_residuals(problem, result[(), name]).values()) < 1e-9
    with pytest.raises(BadInput, match='sensor'):
        design(plant, wanted={'y1': rows[0]})
    with pytest.raises(BadInput, match='6 numbers'):
        design(plant, wanted={'v': [1, 2]})


def test_supersets_of_a_lost_set_are_lost_for_the_same_reason():
    plant = Plant.from_matrices(np.diag([-1.0, 0.5, -2.0]), None, np.eye(3))
    told = []
    result = design(plant, up_to=3, temporary=False, progress=lambda *of: told.append(of))
    assert len(result.fault_sets) == 7
    for fault_set in result.fault_sets:
        for channel in fault_set:
            assert isinstance(result[fault_set, channel],
                              Refusal if channel == 'y2' else VirtualSensor)
    assert 'already when y2 alone has failed' in result[('y1', 'y2', 'y3'), 'y2'].reason
    assert told[0][:2] == (0, 12) and told[-1][:2] == (12, 12)
    with pytest.raises(BadInput, match='up_to'):
        design(plant, up_to=0)


@pytest.mark.parametrize(('sample_time', 'rates'), [(None, (100.0, 6.25)), (0.1, (10.0, 2.5))])
def test_a_quarter_of_the_readings_is_as_good_as_twice_the_noise(sample_time, rates):
    """A filter over many readings hears their intensity, noise^2 / rate, alone."""
    def floor(noise, rate):
        plant = Plant.from_matrices(
            [[0, 1], [0, 0]] if sample_time is None else [[1, 0.1], [0, 1]], None,
            [[1, 0], [0, 1]], sample_time=sample_time, process_noise=[1e-3, 1e-2],
            noise=[noise, noise], sensor_rate=[rate, np.nan])
        return design(plant, [('y2',)])['y2', 'y2'].noise.floor

    factor = (rates[0] / rates[1])**0.5
    # but for the newest reading, which counts alone, too
    assert floor(0.1, rates[1]) == pytest.approx(floor(0.1 * factor, rates[0]), rel=0.03)
    assert floor(0.1, rates[1]) > 1.1 * floor(0.1, rates[0])
    assert floor(0.1, rates[0]) == pytest.approx(floor(0.1, np.nan), rel=1e-6)


@pytest.mark.slow
@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_sensors_may_read_commands_and_unknown_inputs(seed):
    """Simulate plant and virtual sensor as maps; the truth is the failed sensor's own reading."""
    rng = np.random.default_rng(seed)
    n, sensors, d = int(rng.integers(2, 6)), int(rng.integers(2, 5)), int(rng.integers(1, 3))
    m = 2
    A = rng.normal(size=(n, n))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B, D, C = rng.normal(size=(n, m)), rng.normal(size=(n, d)), rng.normal(size=(sensors, n))
    Cu = rng.normal(size=(sensors, m))
    Cd = rng.normal(size=(sensors, d)) * (rng.random((sensors, d)) < 0.4)
    plant = Plant.from_matrices(A, B, C, D=D, sample_time=1.0, Cu=Cu, Cd=Cd)
    for entry in design(plant).virtual_sensors:
        rows = [plant.sensors.index(s) for s in entry.healthy]
        own = plant.sensors.index(entry.channel)
        np.testing.assert_allclose(entry.B, entry.Phi @ B - entry.J @ Cu[rows], atol=1e-9)
        if np.abs(entry.eigenvalues).max(initial=0.0) > 0.85:
            continue
        x, z = rng.normal(size=n), rng.normal(size=entry.order)
        size = 1.0
        for _ in range(150):
            u, rho = rng.normal(size=m), 100 * rng.normal(size=d)
            y = C @ x + Cu @ u + Cd @ rho
            error = y[own] - (entry.Cv @ z + entry.Q @ y[rows] + entry.Qu @ u)[0]
            z = entry.N @ z + entry.J @ y[rows] + entry.B @ u
            x = A @ x + B @ u + D @ rho
            size = max(size, np.abs(x).max(), np.abs(y).max())
        gain = 1 + np.abs(entry.Cv).max(initial=0) * (1 + np.abs(entry.J).max(initial=0))
        assert abs(error) < 1e-7 * size * gain


def test_a_wanted_decay_is_met_at_little_more_than_the_least_noise():
    """A helicopter (8 states) without its yaw gyro: beside a full-order filter of that decay."""
    A = np.array([
        [-.0046, .038, .3259, -.0045, -.402, -.073, -9.81, 0],
        [-.1978, -.5667, .357, -.0378, -.2149, .5683, 0, 0],
        [.0039, -.0029, -.2947, .007, .2266, .0148, 0, 0],
        [.0133, -.0014, -.4076, -.0654, -.4093, .2674, 0, 9.81],
        [.0127, -.01, -.8152, -.0397, -.821, .1442, 0, 0],
        [-.0285, -.0232, .1064, .0709, -.2786, -.7396, 0, 0],
        [0, 0, 1, 0, 0, 0, 0, 0], [0, 0, 0, 0, 1, 0, 0, 0]])
    C, wanted = np.eye(8)[[1, 6, 7, 5, 2, 4]], 1.67
    plant = Plant.from_matrices(A, None, C, noise=[0.01] * 6, process_noise=[0.1] * 8)
    sensor = design(plant, [('y4',)], decay=wanted)['y4', 'y4']
    assert sensor.decay >= 0.999 * wanted

    def filter_of(shift):
        E, R, W = np.delete(C, 3, 0), 1e-6 * np.eye(5), 0.01 * np.eye(8)
        X = solve_continuous_are((A + shift * np.eye(8)).T, E.T, W, R)
        L = X @ E.T @ np.linalg.inv(R)
        P = solve_continuous_lyapunov(A - L @ E, -(W + L @ R @ L.T))
        return -np.linalg.eigvals(A - L @ E).real.max(), np.sqrt(C[3] @ P @ C[3])
    filters = [filter_of(shift) for shift in np.linspace(0.5, 1.0, 11) * wanted]
    assert sensor.noise.error <= 2 * min(error for decay, error in filters if decay >= wanted)


@pytest.mark.parametrize('seed', [None, 2, 6])
def test_modes_in_close_pairs_that_no_sensor_sees_are_copied(seed):
    """Five modes in two close pairs behind y1, two others behind y2; also in mixed coordinates."""
    A = block_diag([[0, 1], [-.202, -1.15]], [[0, 1, 0], [0, 0, 1], [-2.36, -13.6, -12.8]], -1, -2)
    C = np.array([[.264, .806, -1.42, -15, 0, 0, 0], [0, 0, 0, 0, 0, 1, 1]])
    if seed is not None:
        rng = np.random.default_rng(seed)
        T = np.linalg.qr(rng.normal(size=(7, 7)))[0]
        A, C = T @ A @ T.T, C @ T.T
    sensor = design(Plant.from_matrices(A, None, C), [('y1',)])['y1', 'y1']
    assert (sensor.order, sensor.proof.lower, sensor.proof.upper) == (5, 5, 5)
    assert seed is not None or not sensor.reads  # mixed states are moved by the same noise
