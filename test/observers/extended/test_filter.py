"""The steps of the filter, against formulas that were written down elsewhere."""

import numpy as np
from scipy.linalg import expm

from vsensor_ros.observers import Model, Told
from vsensor_ros.observers.kinds.extended.filter import Filter, LOST

H = 0.01
A = np.array([[0.0, 1.0], [-4.0, -0.5]])
SPRING = 4.0


def model(spread=0.4, sample_time=None, **changed):
    """Return a mass on a spring, k not known exactly, with position and speed measured."""
    given = {
        'states': ('x', 'v'), 'inputs': ('u',), 'equations': ('v', '-k*x - 0.5*v + u'),
        'unknown': (), 'parameters': ('k',), 'values': np.array([SPRING]),
        'spreads': np.array([spread]), 'process_noise': np.array([0.0, 0.1]),
        'input_noise': np.array([0.05]), 'unknown_noise': np.zeros(0), 'C': np.eye(2),
        'Cu': np.zeros((2, 1)), 'noise': np.array([0.01, 0.03]), 'lasts': np.zeros(2),
        'initial': np.zeros(2), 'start': np.array([0.5, 1.0]), 'sample_time': sample_time}
    return Model(**{**given, **changed})


def one(reads=(True, False), **changed):
    return Filter(model(**changed), H, np.array([reads]), np.array([reads]))


def told(*y):
    return Told(np.array(y), np.ones(3, dtype=bool), np.zeros(0))


def run(filter_, y, u=0.0):
    z = filter_.start(told(*y[0]))
    for reading in y[1:]:
        z = filter_.step(z, told(*reading), np.full((3, 1), u))
    return z


def test_of_a_linear_plant_it_is_the_kalman_filter():
    rng = np.random.default_rng(1)
    y, u = rng.standard_normal((40, 2)), 0.7
    z = run(one(spread=0.0), y, u)
    # the textbook's, with the exact discretisation of A and of the noise (van Loan)
    drive = np.array([[0.0], [1.0]])
    W = np.diag([0.0, 0.1**2]) + 0.05**2 * drive @ drive.T
    F = expm(A * H)
    both = expm(np.block([[-A, W], [np.zeros((2, 2)), A.T]]) * H)
    Q = both[2:, 2:].T @ both[:2, 2:]
    push = np.linalg.solve(A, (F - np.eye(2)) @ drive)[:, 0] * u
    C, R = np.array([[1.0, 0.0]]), np.array([[0.01**2]])
    x, P = np.zeros(2), np.diag([0.25, 1.0])
    for k, reading in enumerate(y):
        if k:
            x, P = F @ x + push, F @ P @ F.T + Q
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        x, P = x + K @ (reading[:1] - C @ x), P - K @ C @ P
    np.testing.assert_allclose(z[0, :2], x, rtol=2e-3)
    np.testing.assert_allclose(z[0, 2:6].reshape(2, 2), P, rtol=2e-3)


def test_what_is_considered_is_in_the_covariance():
    """The covariance is that of state and gain of the input together, of which none is learnt."""
    u, spread = 2.0, 0.3
    filter_ = one(equations=('v', '-4*x - 0.5*v + k*u'), spread=spread)
    z = run(filter_, np.zeros((60, 2)), u)
    joint = np.zeros((3, 3))
    joint[:2, :2], joint[1, 2] = A, u
    F, noisy = expm(joint * H), np.array([[0.0], [1.0], [0.0]])
    W = (0.1**2 + (SPRING * 0.05)**2) * noisy @ noisy.T
    both = expm(np.block([[-joint, W], [np.zeros((3, 3)), joint.T]]) * H)
    Q = both[3:, 3:].T @ both[:3, 3:]
    P, C, R = np.diag([0.25, 1.0, spread**2]), np.array([[1.0, 0.0, 0.0]]), 0.01**2
    for k in range(60):
        if k:
            P = F @ P @ F.T + Q
        K = P @ C.T / (C @ P @ C.T + R)
        K[2] = 0.0  # only considered
        left = np.eye(3) - K @ C
        P = left @ P @ left.T + R * K @ K.T
    np.testing.assert_allclose(z[0, 2:6].reshape(2, 2), P[:2, :2], rtol=5e-3)
    np.testing.assert_allclose(z[0, 6:8], P[:2, 2], rtol=5e-3)
    assert P[1, 1] > 1.2 * run(one(equations=('v', '-4*x - 0.5*v + k*u'), spread=0.0),
                               np.zeros((60, 2)), u)[0, 5]


def test_rare_readings_count_as_rare():
    """A reading that comes every fifth step, but is told at each, is not believed five times."""
    often, rare = (run(one(lasts=np.array([lasts, 0.0]), spread=0.0), np.zeros((3, 2)))
                   for lasts in (0.0, 5 * H))
    assert rare[0, 2] > 1.5 * often[0, 2]


def test_a_discrete_plant_is_stepped_by_its_map():
    z = run(one(sample_time=H, equations=('x + 0.01*v', 'v - 0.01*k*x + u'), reads=(False, False)),
            np.zeros((2, 2)), 0.3)
    np.testing.assert_allclose(z[0, :2], [0.0, 0.3])


def test_what_is_never_so_by_chance_is_lost_for_good():
    filter_ = one(spread=0.0)
    z = run(filter_, np.zeros((50, 2)))
    assert z[0, -1] < LOST
    calm = filter_.deviation(np.array([0.0, 1.0]), z[0])
    for k in range(30):  # the mass is moved by a hand
        z = filter_.step(z, told(1e-3 * k * k, 0.0), np.zeros((3, 1)))
    assert z[0, -1] > LOST and filter_.deviation(np.array([0.0, 1.0]), z[0]) > 2 * calm
    worst = z[0, -1]
    for _ in range(200):
        z = filter_.step(z, told(z[0, 0], 0.0), np.zeros((3, 1)))
    assert z[0, -1] >= worst


def test_numbers_beyond_use_do_not_stop_it():
    filter_ = one()
    z = run(filter_, np.zeros((2, 2)))
    for number in (np.nan, np.inf, 1e200):
        spoilt = z.copy()
        spoilt[0, :6] = number
        with np.errstate(all='ignore'):
            filter_.step(spoilt, told(0.0, 0.0), np.zeros((3, 1)))


def test_two_sensors_of_one_state_that_nobody_knows():
    twice = one(reads=(True, True), C=np.array([[1.0, 0.0], [1.0, 0.0]]),
                start=np.array([1e40, 1e40]), noise=np.array([1e-9, 1e-9]))
    assert np.isfinite(run(twice, np.ones((3, 2)))[0, :2]).all()


def test_many_readings_count_as_each_of_them():
    """Seven readings of two states, one of all: the textbook's gain of seven, step by step."""
    rng = np.random.default_rng(3)
    C, noise = rng.standard_normal((7, 2)), rng.uniform(0.01, 3.0, 7)
    given = {'C': C, 'Cu': np.zeros((7, 1)), 'noise': noise, 'lasts': np.zeros(7), 'spread': 0.0}
    reads = np.array([[True] * 7, [True, False] * 3 + [False]])
    filter_ = Filter(model(**given), H, reads, reads)
    z, y = filter_.start(told(*np.zeros(7))), rng.standard_normal((30, 7))
    F, _, Q = (of[0] for of in filter_.linear(np.zeros(2), np.zeros(1)))
    for reading in y:
        before, z = z, filter_.step(z, told(*reading), np.zeros((3, 1)))
        for row, some in enumerate(reads):
            R, Cs = np.diag(noise[some]**2), C[some]
            P = F @ before[row, 2:6].reshape(2, 2) @ F.T + Q
            K = P @ Cs.T @ np.linalg.inv(Cs @ P @ Cs.T + R)
            x = expm(A * H) @ before[row, :2]
            np.testing.assert_allclose(z[row, :2], x + K @ (reading[some] - Cs @ x), rtol=1e-5)
            np.testing.assert_allclose(z[row, 2:6].reshape(2, 2), P - K @ Cs @ P, rtol=1e-7)


def test_what_has_become_old_is_no_reading():
    """A sensor pauses while the mass moves on: that neither pulls nor tells of the model."""
    filter_, alone = one(reads=(True, True)), one(reads=(True, False))
    z = run(filter_, np.zeros((30, 2)))
    stale = told(0.0, 9.0)._replace(ages=np.array([0.0, 5 * H]))
    np.testing.assert_allclose(filter_.step(z, stale, np.zeros((3, 1)))[0, :8],
                               alone.step(z, stale, np.zeros((3, 1)))[0, :8])
    fresh = stale._replace(ages=np.array([0.0, H]))
    assert abs(filter_.step(z, fresh, np.zeros((3, 1)))[0, 1]) > 0.1
    for _ in range(30):
        z = filter_.step(z, stale, np.zeros((3, 1)))
    assert z[0, -1] < LOST


def test_a_variance_that_rounding_has_taken():
    filter_ = one()
    z = run(filter_, np.zeros((2, 2)))
    z[0, 2:6] = -filter_.variances(z[:, 2:6].reshape(1, 2, 2))[0, 0] * np.eye(2).ravel()
    with np.errstate(all='raise'):
        assert np.isfinite(filter_.step(z, told(1.0, 0.0), np.zeros((3, 1)))).all()


def test_sensors_that_fall_silent_by_turns_leave_no_chain_of_filters():
    """A copy of an engine follows what filters hold on to: it must not grow with time."""
    filter_ = one((True, True), lasts=np.full(2, H))
    z = filter_.start(told(0.0, 0.0))
    for k in range(300):
        ages = np.array([k % 2, 1.0 - k % 2])
        z = filter_.step(z, told(0.0, 0.0)._replace(ages=ages), np.zeros((3, 1)))
    depth, at = 0, filter_
    while at._fresh[1] is not at and depth < 10:
        depth, at = depth + 1, at._fresh[1]
    assert depth == 1
