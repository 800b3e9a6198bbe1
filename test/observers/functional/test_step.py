"""The step against closed forms, the papers' numbers and independent integrations."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vsensor_ros.bank import Bank
from vsensor_ros.observers.kinds.functional.discretise import phi_functions
from vsensor_ros.observers.kinds.functional.step import make_step


@pytest.mark.parametrize('N', [
    [[0.0]], [[-3.0]], [[-1e-9]], [[-40.0]], [[0.0, 1.0], [0.0, 0.0]], [[-1.0, 5.0], [0.0, -1.0]],
])
def test_phi_functions_are_their_series(N):
    N, h = np.array(N), 0.3
    power, series = np.eye(len(N)), np.zeros((4, *N.shape))
    factorial = np.cumprod([1.0, *range(1, 100)])
    for i in range(90):
        for j in range(4):
            series[j] += power / factorial[i + j]
        power = power @ N * h
    for phi, expected in zip(phi_functions(N, h), series):
        np.testing.assert_allclose(phi, expected, rtol=1e-9, atol=1e-8 * np.abs(N).max() * 1e-3
                                   + 1e-13)


def test_linear_part_is_exact_for_linear_readings_and_held_commands(bench):
    v = bench.virtual_sensor([[-2, 1], [0, -30]], [[1], [2]], B=[[3], [-1]], inputs=('u',))
    step = make_step([v], ('y1', 'y2'), 0.1)
    z, _ = step(np.array([[1.0, -1.0]]), *np.array([[0, 0.5], [0, 2.0], [4.0], [4.0], [4.0]],
                                                   dtype=object))
    truth = solve_ivp(lambda t, z: v.N @ z + v.J[:, 0] * (0.5 + 15 * t) + v.B[:, 0] * 4,
                      (0, 0.1), [1, -1], 'DOP853', rtol=1e-12, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(z[0], truth, atol=1e-11)


FINEST = 200  # Hz


@pytest.fixture(scope='module')
def truth_of(bench):
    """Return what gives the truths x and z of a servo, or of a tank, at a rate, for 8 s."""
    t = np.arange(8 * FINEST + 1) / FINEST
    servo = cache(lambda lam: bench.servo_truth(lam, t))
    tank = cache(lambda z0: bench.tank_truth(z0, t))

    def at(rate, lam, z0):
        x, z = tank(z0) if lam is None else servo(lam)
        return x[..., ::FINEST // rate], z[..., ::FINEST // rate]
    return at


def errors(bench, truth_of, rates, lam=None, z0=None):
    found = []
    for rate in rates:
        x, z = truth_of(rate, lam, z0)
        if lam is not None:
            truth, key, readings = z + (lam + 1) * x[2], (('y2',), 'y2'), {'y1': x[0], 'y3': x[2]}
            d = bench.design(bench.servo(lam), names=('y1', 'y2', 'y3'), inputs=('u',))
            commands = {'u': lambda t: 2 * np.sin(t)}
        else:
            truth, key, readings = z[0] - z[1], (('y1',), 'y1'), {'y1': x[1], 'y2': x[2]}
            d = bench.design(bench.tank(z0), inputs=('u1', 'u2'))
            commands = {'u1': lambda t: 0.5, 'u2': lambda t: 0.2}
        found.append((bench.run(Bank(d, rate), key, rate, readings, commands), truth))
    return [float(np.abs(e - v).max()) for e, v in found], found


def test_servo_is_as_exact_as_the_reference_and_of_second_order(bench, truth_of, reference):
    e, _ = errors(bench, truth_of, (50, 100, 200), lam=-1.0)
    table = reference['runtime']['servo_lam=-1.0']
    assert e[0] <= 1.01 * table['50Hz']['exp_foh_prox']['max']
    assert e[1] <= 1.01 * table['100Hz']['exp_foh_prox']['max']
    assert e[1] < e[0] / 3.7
    assert e[2] < e[1] / 3.7


def test_a_sign_that_only_passes_zero_is_split_there(bench, truth_of, reference):
    e, _ = errors(bench, truth_of, (50, 100, 200), lam=-10.0)
    table = reference['runtime']['servo_lam=-10.0']
    assert e[0] <= table['50Hz']['exp_foh_event_split']['max']
    assert e[1] <= table['100Hz']['exp_foh_event_split']['max']
    assert e[1] < e[0] / 3.5
    assert e[2] < e[1] / 3.5


def test_a_stopped_axis_does_not_chatter(bench, truth_of):
    for lam, exactly in ((-1.0, 0.0), (-10.0, 1e-15)):
        _, found = errors(bench, truth_of, (100,), lam=lam)
        estimate, truth = found[0]
        rests = np.abs(truth) < 1e-12
        assert rests.sum() > 200
        assert np.abs(estimate[rests]).max() <= exactly
        moves = np.sign(estimate[np.abs(estimate) > 1e-12])
        of_truth = np.sign(truth[np.abs(truth) > 1e-12])
        assert np.count_nonzero(np.diff(moves)) == np.count_nonzero(np.diff(of_truth))


@pytest.mark.slow
def test_truth_is_the_reference(bench, reference):
    samples = reference['a_servo']['sim_k7=-1']['samples']
    x, z = bench.servo_truth(-1.0, np.array([float(t) for t in samples]))
    np.testing.assert_allclose(z, [s['z'] for s in samples.values()], atol=2e-7)
    np.testing.assert_allclose(x.T, [s['x'] for s in samples.values()], atol=2e-6)
    for z0, key in (((4, 1), 'sim18_swapped_z0=(4,1)'), ((1, 4), 'sim18_printed_z0=(1,4)')):
        v = reference['b_tank_continuous'][key]['v']
        _, z = bench.tank_truth(z0, np.array([float(t) for t in v]))
        np.testing.assert_allclose(z[0] - z[1], list(v.values()), atol=2e-6)


def test_tank_is_as_exact_as_the_reference_and_of_second_order(bench, truth_of, reference):
    e, found = errors(bench, truth_of, (50, 100), z0=(4, 1))
    table = reference['runtime']['tank_const_u_z0=(4,1)']
    assert e[0] <= 1.01 * table['50Hz']['rk4_foh']['v_max']
    assert e[1] <= 1.01 * table['100Hz']['rk4_foh']['v_max']
    assert e[1] < e[0] / 3.9


def test_tank_from_outside_the_domain_converges_and_is_counted(bench, truth_of, reference):
    e, _ = errors(bench, truth_of, (50, 100), z0=(1, 4))
    table = reference['runtime']['tank_const_u_printed_z0=(1,4)_oddsqrt']
    assert e[0] <= 2 * table['50Hz']['rk4_foh']['v_max']  # where it crosses the kink is luck
    assert e[1] <= 2 * table['100Hz']['rk4_foh']['v_max']

    x, z = (a[..., :401] for a in truth_of(100, None, (1, 4)))
    bank = Bank(bench.design(bench.tank((1, 4)), inputs=('u1', 'u2')), 100)
    bench.run(bank, (('y1',), 'y1'), 100, {'y1': x[1], 'y2': x[2]},
              {'u1': lambda t: 0.5, 'u2': lambda t: 0.2})
    outside = np.count_nonzero((z[1] < 0) | (z[0] - z[1] - x[2] < 0))
    assert 200 < outside < 400
    assert abs(bank.outside_domain[('y1',), 'y1'] - outside) <= 1


def several_signs(bench):
    """Make two rubbing masses on a spring, driven by y2, with a smooth term as well."""
    return bench.virtual_sensor(
        [[-1.0, 0.5, 0], [0.5, -2.0, 0], [1, 0, -1]], [[1.4], [-0.6], [0]],
        P=[[-1.0, -0.2, 0.0], [-0.2, -0.6, 0.3], [0, 0, 0.5]],
        Gz=[[[1, 0, 0]], [[0, 1, 0]], [[2, 0, 1]]], Gy=[[[0]]] * 3,
        texts=['sign(w1)', 'sign(w1)', 'sin(w1)'], z0=[0.5, -0.4, 0.2])


@pytest.mark.slow
def test_several_signs_in_one_virtual_sensor(bench):
    v = several_signs(bench)
    finest, e = 800, []
    truths = bench.friction_truth(
        lambda t, z: v.N @ z + v.J[:, 0] * np.sin(2 * t) + v.P[:, 2] * np.sin(2 * z[0] + z[2]),
        v.P[:, :2], np.eye(3)[:2], v.z0, np.arange(6 * finest + 1) / finest)
    for rate in (50, 200, finest):
        t = np.arange(6 * rate + 1) / rate
        truth = truths[:, ::finest // rate]
        step = make_step([v], ('y2',), 1 / rate)
        z, found = v.z0[None, :], [v.z0]
        none = np.zeros(0)
        for k in range(len(t) - 1):
            z, _ = step(z, *np.sin(2 * t[k:k + 2, None]), none, none, none)
            found.append(z[0])
        assert (np.abs(truth[:2]).min(axis=1) < 1e-12).all()  # both do come to rest
        e.append(np.abs(np.array(found).T - truth).max())
    assert e[0] < 5e-4
    assert e[1] < e[0] / 8  # 16, if where the crossings fall within a step were always the same
    assert e[2] < e[1] / 8


def test_friction_that_drives_has_no_resolvent_and_is_explicit(bench, reference):
    case = reference['a_servo']['sim_k7=+1']
    for z0, end in ((-0.1, case['z_end']), (0.1, -case['z_end'])):
        v = bench.virtual_sensor([[-1.0]], [[1.0]], P=[[1.0]], Gz=[[[1.0]]], Gy=[[[0.0]]],
                                 texts=['sign(w1)'])
        step, z, none = make_step([v], ('y2',), 0.01), np.array([[z0]]), np.zeros(0)
        y = np.array([-0.5 if z0 < 0 else 0.5])
        for _ in range(4000):
            z, _ = step(z, y, y, none, none, none)
        assert z[0, 0] == pytest.approx(end, abs=1e-9)


def test_a_discrete_plant_is_its_map(bench):
    v = bench.virtual_sensor([[0.5, 0.1], [0, -0.3]], [[1], [2]], B=[[1], [0]], P=[[1], [0.5]],
                             Gz=[[[1, 0]]], Gy=[[[1]]], texts=['sqrt(w1) * u'], inputs=('u',),
                             sample_time=1.0)
    step = make_step([v], ('y2',), 1.0)
    z, out = step(np.array([[1.0, 2.0]]), np.array([3.0]), np.array([99.0]), np.array([99.0]),
                  np.array([99.0]), np.array([0.5]))
    psi = np.sqrt(1.0 + 3.0) * 0.5
    np.testing.assert_allclose(z, [[0.5 + 0.2 + 3 + 0.5 + psi, -0.6 + 6 + 0.5 * psi]], rtol=1e-14)
    assert not out.any()


def test_each_of_a_stack_steps_as_it_does_alone(bench):
    rng = np.random.default_rng(1)
    sensors = [
        several_signs(bench), bench.virtual_sensor(np.zeros((0, 0)), np.zeros((0, 1)), Q=[[2.0]]),
        bench.virtual_sensor([[-1.0]], [[1.0]], P=[[2.0]], Gz=[np.zeros((0, 1))],
                             Gy=[np.zeros((0, 1))], texts=['1']),
        bench.virtual_sensor([[-9.0]], [[1.0]], P=[[-2.0, 1.0]], Gz=[[[1]], [[1.0], [0.5]]],
                             Gy=[[[0]], [[0], [1.0]]], texts=['sign(w1)', 'w1 * w2'],
                             slopes=[[0.0], [0.1, 0.0]]),
        bench.virtual_sensor(-np.eye(5), np.ones((5, 1))),
    ]
    none, y = np.zeros(0), rng.standard_normal((2, 1))
    k = max(v.order for v in sensors)
    z = np.zeros((len(sensors), k))
    for row, v in enumerate(sensors):
        z[row, :v.order] = rng.standard_normal(v.order)
    together, _ = make_step(sensors, ('y2',), 0.05)(z, *y, none, none, none)
    for row, v in enumerate(sensors):
        alone, _ = make_step([v], ('y2',), 0.05)(z[row:row + 1, :v.order], *y, none, none, none)
        np.testing.assert_allclose(together[row, :v.order], alone[0], rtol=1e-12, atol=1e-14)
        assert not together[row, v.order:].any()
