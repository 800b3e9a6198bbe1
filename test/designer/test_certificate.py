"""
Certificates against simulation, closed forms and the method's numbers (test/reference.json).

A plant is made around each error system: its states are z and the readings, Phi = [1 0].
"""

from dataclasses import replace
import json
from pathlib import Path
import sys

from hypothesis import example, given, HealthCheck, settings, strategies as st
import numpy as np
import pytest
from scipy.linalg import expm

from vsensor_ros import Plant
from vsensor_ros.designer.certificate import certify
from vsensor_ros.functions.nonlinearity import evaluate
from vsensor_ros.observers import Limit, VirtualSensor

REFERENCE = json.loads((Path(__file__).parents[1] / 'reference.json').read_text())
TANK = REFERENCE['b_tank_continuous']
FEW = settings(max_examples=8, suppress_health_check=list(HealthCheck))


def observer(plant, Phi, N, J, Cv, Q, Gz=(), Gy=(), P=None):
    """Make a virtual sensor of the first channel by hand."""
    Phi, N, J, Cv, Q = (np.atleast_2d(np.asarray(M, float)) for M in (Phi, N, J, Cv, Q))
    k, l0 = len(Phi), len(plant.sensors) - 1
    P = Phi @ plant.P if P is None else np.asarray(P, float)
    return VirtualSensor(
        channel=plant.sensors[0], fault_set=plant.sensors[:1], healthy=plant.sensors[1:],
        inputs=plant.inputs, Phi=Phi, N=N.reshape(k, k), J=J.reshape(k, l0), B=Phi @ plant.B,
        P=P, Cv=Cv.reshape(-1, k), Q=Q.reshape(-1, l0),
        Gz=tuple(np.array(g, float).reshape(-1, k) for g in Gz),
        Gy=tuple(np.array(g, float).reshape(-1, l0) for g in Gy), terms=plant.terms,
        sample_time=plant.sample_time, z0=np.zeros(k), z0_gain=np.zeros((k, l0)),
        eigenvalues=np.linalg.eigvals(N).astype(complex), noise_gain=0.0, method='by hand')


def system(N, J, texts=(), P=None, Gz=(), Gy=(), Cv=None, Q=None, sample_time=None, inputs=0,
           **more):
    """Return plant and virtual sensor with a given error system; the readings are states."""
    N, J = np.atleast_2d(np.asarray(N, float)), np.atleast_2d(np.asarray(J, float))
    k, l0 = J.shape
    P = np.zeros((k, 0)) if P is None else np.asarray(P, float).reshape(k, len(texts))
    Gz = [np.asarray(g, float).reshape(-1, k) for g in Gz]
    Gy = [np.asarray(g, float).reshape(-1, l0) for g in Gy]
    Cv = np.ones((1, k)) if Cv is None else np.atleast_2d(np.asarray(Cv, float))
    Q = np.zeros((1, l0)) if Q is None else np.atleast_2d(np.asarray(Q, float))
    rest = -np.eye(l0) if sample_time is None else 0.5 * np.eye(l0)
    plant = Plant.from_matrices(
        np.block([[N, J], [np.zeros((l0, k)), rest]]), np.zeros((k + l0, inputs)),
        np.block([[Cv, Q], [np.zeros((l0, k)), np.eye(l0)]]), sample_time=sample_time,
        P=np.vstack([P, np.zeros((l0, len(texts)))]), G=[np.hstack(g) for g in zip(Gz, Gy)],
        nonlinearities=list(texts), **more)
    return plant, observer(plant, np.eye(k, k + l0), N, J, Cv, Q, Gz, Gy)


def tank(**more):
    """Return the three-tank plant of paper R and its observer of y1 from y2 = level3."""
    plant = Plant.from_matrices(
        [[-1, 1, 0], [1, -2, 1], [0, 1, -2]], [[1, 0], [0, 1], [0, 0]], [[0, 1, 0], [0, 0, 1]],
        P=[[1, 0, 0], [-1, 1, 0], [0, -1, 1]], G=[[1, -1, 0], [0, 1, -1], [0, 0, 1]],
        nonlinearities=['w1 - sqrt(w1)'] * 3, initial=[4, 3, 1],
        states=['level1', 'level2', 'level3'], name='tank', **more)
    paper = TANK['JCF_paper']
    G = [paper['Gz_Gy'][name] for name in ('G1', 'G2')]
    J = np.array(paper['J_declared_order_y1_y2'], float)[:, 1:]
    return plant, observer(
        plant, paper['Phi'], paper['N_closed_loop'], J, paper['Cv'], paper['Q'],
        Gz=[[g[:2]] for g in G] + [[[0, 0]]], Gy=[[g[2:]] for g in G] + [[[0]]],
        P=paper['Pstar'])


# level differences in [0.1, 3], written as ranges of the levels
TANK_RANGES = [[4.1 - 1e-9, 4.1 + 1e-9], [1.1, 4.0], [1.0 - 1e-9, 1.0 + 1e-9]]


def servo(k7, lam=-1.0):
    """Return the servo of paper S and z = velocity + b current of the rate lam (erratum 3)."""
    plant = Plant.from_matrices(
        [[0, 1, 0], [0, -1, 1], [0, -1, -1]], [0, 0, 1], np.eye(3)[[1, 0, 2]], D=[1, 0, 0],
        P=[0, k7, 0], G=[[0, 1, 0]], nonlinearities=['sign(w1)'],
        states=['angle', 'velocity', 'current'], sensors=['velocity', 'angle', 'current'])
    b = -(lam + 1)
    return plant, observer(plant, [[0, 1, b]], [[lam]], [[0, 1 - b - lam * b]], [[1]], [[0, -b]],
                           Gz=[[[1]]], Gy=[[[0, -b]]])


def V(S, e):
    return np.einsum('i...,ij,j...->...', e, S, e)


def rhs(sensor, zeta, e, noise):
    """
    Return d e for true arguments zeta (list of (r,)) and an error of the readings (l0,).

    Several errors side by side are columns: (k, m), (r, m), (l0, m).
    """
    total = sensor.N @ e - sensor.J @ noise
    for i in sensor.active:
        seen = zeta[i] - sensor.Gz[i] @ e + sensor.Gy[i] @ noise
        total = total + np.multiply.outer(sensor.P[:, i], (
            evaluate(sensor.terms[i], zeta[i], (), ()) - evaluate(sensor.terms[i], seen, (), ())))
    return total


def rk4(f, e, h):
    a = f(e)
    b = f(e + h / 2 * a)
    c = f(e + h / 2 * b)
    return e + h / 6 * (a + 2 * b + 2 * c + f(e + h * c))


# -------------------------------------------------------------------------- linear errors

def test_linear_closed_forms():
    """First order: |J| / a + |Q|; a pair of real poles; deadbeat; a static sensor."""
    c = certify(*system([[-2.0]], [[3.0, -1.0]], Q=[[0.5, 0.0]]))
    assert c.status == 'global' and c.region == () and 'linear' in c.reason
    assert c.rate == pytest.approx(2.0, rel=1e-3) and c.rate <= 2.0
    assert c.bound == pytest.approx(4 / 2 + 0.5, rel=1e-3) and c.bound >= 2.5
    assert c.lipschitz == pytest.approx((0.0, 2.0))
    # e^-t - e^-3t is never negative: the peak gain is the static one
    c = certify(*system([[-1, 0], [0, -3]], [[1.0], [-1.0]]))
    assert c.bound == pytest.approx(1 - 1 / 3, rel=1e-3)
    c = certify(*system([[0, 1], [0, 0]], [[1.0], [2.0]], sample_time=0.5))
    assert c.status == 'global' and c.rate > 10.0
    assert c.bound == pytest.approx(3 + 2)
    plant, sensor = system([[-2.0]], [[3.0, -1.0]])
    static = replace(sensor, **{
        name: np.zeros((0, getattr(sensor, name).shape[1]))
        for name in ('Phi', 'J', 'B', 'P', 'z0_gain')}, N=np.zeros((0, 0)), z0=np.zeros(0),
        Cv=np.zeros((1, 0)), Q=np.array([[1.0, -2.0]]), eigenvalues=np.zeros(0, complex))
    c = certify(plant, static)
    assert (c.status, c.rate, c.bound, c.S.shape) == ('global', np.inf, 3.0, (0, 0))


@FEW
@given(k=st.integers(1, 6), seed=st.integers(0, 2**32 - 1), discrete=st.booleans())
def test_linear_rate_and_bound_are_true_and_tight(k, seed, discrete):
    """The worst noise switches with the sign of the impulse response; it is played."""
    rng = np.random.default_rng(seed)
    N, J = rng.normal(size=(k, k)), rng.normal(size=(k, 2))
    h = 0.1 if discrete else None
    if discrete:
        N = N * rng.uniform(0.2, 0.95) / np.abs(np.linalg.eigvals(N)).max()
        decay = -np.log(np.abs(np.linalg.eigvals(N)).max()) / h
    else:
        N = N - (np.linalg.eigvals(N).real.max() + rng.uniform(0.1, 2)) * np.eye(k)
        decay = -np.linalg.eigvals(N).real.max()
    plant, sensor = system(N, J, sample_time=h)
    c = certify(plant, sensor)
    assert c.status == 'global'
    assert 0.95 * decay <= c.rate <= decay * (1 + 1e-9)
    step = 0.002 / np.linalg.norm(N, 2) if not discrete else h
    E = N if discrete else expm(N * step)
    X, response = np.eye(k), []
    for _ in range(int(min(20 / decay / step, 50000)) if not discrete else 2000):
        response.append(sensor.Cv @ X @ J * (1.0 if discrete else step))
        X = E @ X
    played = np.abs(np.array(response)).sum()
    assert played <= c.bound * 1.005
    assert c.bound <= 1.3 * played
    e = rng.normal(size=(k, 50))
    for n in (1, 10, 100):
        t = n * step if not discrete else n * h
        moved = np.linalg.matrix_power(E, n) @ e
        assert np.all(V(c.S, moved) <= V(c.S, e) * np.exp(-2 * c.rate * t) * (1 + 1e-6) + 1e-250)
    assert np.all((sensor.Cv @ e)[0]**2 <= V(c.S, e) * (1 + 1e-6))


def test_two_hundred_states_and_stiff_and_defective_ones():
    rng = np.random.default_rng(3)
    N = rng.normal(size=(200, 200)) / 200**0.5 - 1.5 * np.eye(200)
    decay = -np.linalg.eigvals(N).real.max()
    c = certify(*system(N, rng.normal(size=(200, 5))))
    assert 0.95 * decay <= c.rate <= decay and np.isfinite(c.bound)
    c = certify(*system(np.diag(-np.logspace(-3, 6, 8)), np.ones((8, 1))))
    assert c.rate == pytest.approx(1e-3, rel=1e-2)
    assert c.bound == pytest.approx(np.logspace(3, -6, 8).sum(), rel=1e-2)
    jordan = np.eye(5, k=1) - np.eye(5)
    c = certify(*system(jordan, [[0.0]] * 4 + [[1.0]], Cv=[[1, 0, 0, 0, 0]]))
    assert 0.0 < c.rate <= 1.0
    assert c.bound == pytest.approx(1.0, rel=2e-3)  # the integral of t^4 e^-t / 4!
    e = rng.normal(size=(5, 50))
    slope = V(c.S @ jordan + jordan.T @ c.S, e)
    assert np.all(slope <= -2 * c.rate * V(c.S, e) * (1 - 1e-6))


def test_a_linear_error_that_grows():
    c = certify(*system([[0.1]], [[1.0]]))
    assert c.status == 'none' and c.rate == 0.0 and c.bound == np.inf and not c.S.any()
    assert 'eigenvalue 0.1' in c.reason


def test_terms_with_measured_arguments_only_count_in_the_bound():
    term = {'P': [[2.0]], 'Gz': [[[0.0]]], 'Gy': [[[1.0]]]}
    c = certify(*system([[-1.0]], [[1.0]], ['sin(w1)'], **term))
    assert c.status == 'global' and c.rate == pytest.approx(1.0, rel=1e-3)
    assert c.bound == pytest.approx(1 + 2, rel=1e-3)
    c = certify(*system([[-1.0]], [[1.0]], ['sign(w1)'], **term))
    assert c.status == 'global' and c.bound == np.inf and 'sign(x2)' in c.reason
    c = certify(*system([[-1.0]], [[1.0]], ['w1**2'], **term, ranges=[[-9, 9], [-1, 2]]))
    assert c.status == 'global' and c.region == ()
    assert c.bound == pytest.approx(1 + 2 * 4, rel=1e-3)
    assert 'while states, readings and inputs stay in the given ranges' in c.reason


# ---------------------------------------------------------------------- the papers' cases

def test_tank_has_the_reference_rate_and_the_papers_condition_fails():
    plant, sensor = tank(ranges=TANK_RANGES)
    C0 = plant.C[1:]
    np.testing.assert_allclose(sensor.Phi @ plant.A, sensor.N @ sensor.Phi + sensor.J @ C0,
                               atol=1e-12)
    c = certify(plant, sensor)
    wanted = TANK['certificate_paper_observer']['lmi_alpha']
    assert c.status == 'region'
    assert c.rate == pytest.approx(wanted, rel=1e-3) and c.rate <= wanted * (1 + 1e-6)
    assert c.region == (Limit(0, 0, pytest.approx(0.1), pytest.approx(3.0)),
                        Limit(1, 0, pytest.approx(0.1), pytest.approx(3.0)))
    assert [name for name, *_ in replace(sensor, certificate=c).region] == [
        'level1 - level2', 'level2 - level3']
    assert 'only while plant and estimate both keep' in c.reason
    assert c.lipschitz == pytest.approx((2.35, 0.25), abs=0.005)
    assert c.lipschitz[0] > c.lipschitz[1]


def test_tank_error_falls_at_the_certified_rate_from_random_starts():
    """The flow of the true levels is frozen: any frozen argument is as good as a moving one."""
    plant, sensor = tank(ranges=TANK_RANGES)
    c = certify(plant, sensor)
    rng = np.random.default_rng(4)
    true, seen = rng.uniform(0.1, 3.0, size=(2, 2, 20))  # level differences of 20 starts
    # e2 = error of level2, e1 - that of the difference: seen = true - Gz e
    e = np.linalg.solve(np.vstack([sensor.Gz[0], sensor.Gz[1]]), true - seen)
    zeta = [true[:1], true[1:], np.ones((1, 20))]
    before, inside, judged = V(c.S, e), np.full(20, True), 0
    for n in range(1, 401):
        e = rk4(lambda e: rhs(sensor, zeta, e, np.zeros((1, 20))), e, 0.01)
        for i in (0, 1):  # what has left the region is judged no more
            inside &= ((zeta[i] - sensor.Gz[i] @ e >= 0.1)
                       & (zeta[i] - sensor.Gz[i] @ e <= 3.0))[0]
        assert np.all((V(c.S, e) <= before * np.exp(-2 * c.rate * 0.01 * n) * (1 + 1e-6))[inside])
        judged += np.count_nonzero(inside)
    assert judged > 1000


def test_tank_without_ranges_is_certified_about_its_operating_point():
    plant, sensor = tank()
    c = certify(plant, sensor)
    assert c.status == 'region' and c.rate > 0.01
    at = dict(zip(('level1 - level2', 'level2 - level3'), (1.0, 2.0)))
    assert all(low < at[name] < high
               for name, low, high in replace(sensor, certificate=c).region)


def test_servo_with_friction_is_certified_everywhere_and_against_friction_not():
    c = certify(*servo(-1.0))
    assert c.status == 'global' and c.region == ()
    assert c.rate == pytest.approx(1.0) and c.bound == pytest.approx(1.0)
    assert c.lipschitz is None  # a sign has no Lipschitz constant
    c = certify(*servo(1.0))
    assert c.status == 'none' and c.rate == 0.0 and c.bound == np.inf
    assert c.reason == ('sign(velocity) drives its own argument away from zero: '
                        'two branches can stay apart')


def test_servo_bound_holds_although_the_sign_reads_a_wrong_current():
    """Backward Euler with the resolvent of the sign, for plant and observer alike."""
    plant, sensor = servo(-1.0, lam=-3.0)
    c = certify(plant, sensor)
    assert c.status == 'global' and c.rate == pytest.approx(3.0)
    assert 1.0 < c.bound < 20.0
    h, b, rng = 1e-3, 2.0, np.random.default_rng(5)
    lam, gain = -3.0, sensor.J[0, 1]
    for size in (0.02, 0.5):
        v, i, z, worst, noise = 0.0, 0.0, 0.0, 0.0, size
        for n in range(8000):
            if n % rng.choice([7, 150, 900]) == 0:
                noise = size * rng.choice([-1.0, 1.0])
            i += h * (-i - v + 2 * np.sin(2 * n * h))
            r = (v + h * i) / (1 + h)  # v+ = v + h (-v + i - sign v+)
            v_new = np.sign(r) * max(abs(r) - h / (1 + h), 0.0)
            read = i + noise
            shift = b * read  # w = z - b read; w+ (1 - h lam) = ... - h sign w+
            u = 2 * np.sin(2 * n * h)
            r = z + h * (gain * read + b * u) + (h * lam - 1) * shift
            w = np.sign(r) * max(abs(r) - h, 0.0) / (1 - h * lam)
            z, v = w + shift, v_new
            if n > 2000:
                worst = max(worst, abs(v - (z - b * read)))
        assert worst <= 1.02 * c.bound * size


def test_tank_with_empty_levels_relies_on_the_monotone_square_root():
    """Slopes from 0.158 on, without an upper end: V = e1^2 + e2^2 of the levels falls."""
    plant, sensor = tank(ranges=[[0, 10]] * 3)
    c = certify(plant, sensor)
    assert c.status == 'region' and c.lipschitz is None and np.isfinite(c.bound)
    assert c.region == (Limit(0, 0, -10.0, 10.0), Limit(1, 0, -10.0, 10.0))
    assert c.rate >= 0.5 / 10**0.5 * (3 - 5**0.5) / 2 * (1 - 1e-3)
    rng = np.random.default_rng(7)
    for s in rng.uniform(0.5 / 10**0.5, rng.choice([1.0, 1e6], size=(200, 1)), size=(200, 2)):
        A = sensor.N + sum(np.outer(sensor.P[:, i], (1 - s[i]) * sensor.Gz[i][0]) for i in (0, 1))
        L = np.linalg.cholesky(c.S)
        turned = np.linalg.solve(L, (L.T @ A).T).T
        assert np.linalg.eigvalsh(turned + turned.T)[-1] <= -2 * c.rate + 1e-9 * s.max()


def test_where_no_bound_can_be_had_it_is_said_why():
    """An error n of a level that runs empty is sqrt(n) in its square root: no multiple of n."""
    steep = system([[-1]], [[1.0]], ['sqrt(w1)'], [[1.0]], [[[0.0]]], [[[1.0]]],
                   ranges=[[-9, 9], [0, 10]])
    c = certify(*steep)
    assert c.status == 'global' and c.bound == np.inf
    assert 'sqrt(x2) is taken of readings, and has a slope without bound' in c.reason
    away = certify(replace(steep[0], ranges=np.array([[-9, 9], [0.25, 10]])), steep[1])
    assert away.bound == pytest.approx(1.0 + 1.0, rel=1e-2)
    assert 'slope without bound' not in away.reason
    endless = certify(replace(steep[0], ranges=np.tile([-np.inf, np.inf], (2, 1))), steep[1])
    assert 'a slope without bound: give x2 a range' in endless.reason


@pytest.mark.parametrize('top', [2.0, 8.0])
def test_a_bound_on_the_ranges_where_there_is_none_everywhere(top):
    """E' = -e - (|x|x - |x-e|(x-e)) - (a b - a'b'): errors of a, b by 1 are up to 2 top + 1."""
    plant, sensor = system(
        [[-1]], [[0.0, 0.0]], ['w1*abs(w1)', 'w1*w2'], [[-1.0, -1.0]],
        [[[1.0]], [[0.0], [0.0]]], [[[0.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]]],
        ranges=[[-9, 9], [-top, top], [-top, top]])
    c = certify(plant, sensor)
    assert c.status == 'global' and 'its bound holds while states' in c.reason
    assert 2 * top <= c.bound <= 3 * top
    endless = certify(replace(plant, ranges=np.tile([-np.inf, np.inf], (3, 1))), sensor)
    assert endless.bound == np.inf and 'give x2 and x3 a range' in endless.reason


def test_a_sign_that_reads_a_wrong_argument_may_hold_the_error_there():
    """A constant n holds e1 = n at rest, and e1 drives e2 to 5 n."""
    c = certify(*system([[-1, 0], [5, -1]], [[0.0], [0.0]], ['sign(w1)'], [[-10.0], [0.0]],
                        [[[1.0, 0.0]]], [[[1.0]]], Cv=[[0, 1]]))
    assert c.status == 'global'
    assert 5.0 <= c.bound <= 100.0


def test_discrete_tank_is_certified_away_from_equal_levels():
    """The x3 part of paper D: e+ = (1 - a (s2 + s3)) e, with slopes s of the square root."""
    plant = Plant.from_matrices(
        [[0.9, 0.1, 0], [0.1, 0.8, 0.1], [0, 0.1, 0.8]], [[0.1, 0], [0, 0.2], [0, 0]],
        np.eye(3)[[2, 1]], D=[1, 0, 0], sample_time=1.0,
        P=[[0.1, 0, 0], [-0.1, 0.1, 0], [0, -0.1, 0.1]],
        G=[[1, -1, 0], [0, 1, -1], [0, 0, 1]], nonlinearities=['w1 - sqrt(w1)'] * 3,
        ranges=[[4, 9], [2, 4], [0.25, 1.0]])
    sensor = observer(plant, [[0, 0, 1]], [[0.8]], [[0.1]], [[1]], [[0]],
                      Gz=[[[0]], [[-1]], [[1]]], Gy=[[[0]], [[1]], [[0]]])
    c = certify(plant, sensor)
    slowest = 1 - 0.1 * (0.5 / 3.75**0.5 + 0.5)
    assert c.status == 'region' and c.rate == pytest.approx(-np.log(slowest))
    assert replace(sensor, certificate=c).region == (('x2 - x3', 1.0, 3.75), ('x3', 0.25, 1.0))
    assert c.lipschitz is not None
    # plant noise-free, readings of x2 off by 1 at most: e+ = .. - 0.1 s2 n
    assert 0.1 * 0.5 / (1 - slowest) <= c.bound <= 3 * 0.1 * 0.5 / (1 - slowest)
    steep = certify(replace(plant, ranges=np.array([[0.0, 9], [0, 4], [0, 4]])), sensor)
    assert steep.status == 'none' or all(limit.low > 0 for limit in steep.region)


def test_the_range_of_an_input_bounds_the_slopes_that_it_scales():
    """D e = -2 e - u (sin x - sin(x - e)): the slope along x is within +-max |u|."""
    def of(limits):
        return certify(*system([[-2]], [[0.0]], ['u1*sin(w1)'], [[1.0]], [[[1.0]]], [[[0.0]]],
                               inputs=1, input_range=limits))

    c = of([[-0.5, 1.5]])
    assert c.status == 'region' and c.rate == pytest.approx(0.5, rel=0.02)
    assert c.region == (Limit(0, 0, -np.inf, np.inf), Limit(None, 0, -0.5, 1.5))
    assert c.where == (('u1', -0.5, 1.5),)
    # one side alone bounds no slope, so a box about the operating input is made, within it
    assert of([[-np.inf, 0.5]]).region[1] == Limit(None, 0, -2.0, 0.5)


# --------------------------------------------------------------------------- properties

def random_case(seed, discrete=False, q=None):
    rng = np.random.default_rng(seed)
    k, q = int(rng.integers(1, 5)), int(rng.integers(1, 4)) if q is None else q
    N = rng.normal(size=(k, k)) * 0.4 - 1.5 * np.eye(k)
    N = N - max(np.linalg.eigvals(N).real.max() + 0.3, 0) * np.eye(k)
    J, P = rng.normal(size=(k, 2)), rng.normal(size=(k, q)) * 0.5
    Gz = [rng.normal(size=(1, k)) * 0.5 for _ in range(q)]
    Gy = [rng.normal(size=(1, 2)) for _ in range(q)]
    texts = list(rng.choice(['sin(w1)', 'tanh(w1)', 'atan(2*w1)', 'sat(w1, -1, 1)'], size=q))
    if discrete:
        N, J, P = np.eye(k) + 0.1 * N, 0.1 * J, 0.1 * P
    else:
        for i in range(q):
            if rng.random() < 0.5:  # passive, and perhaps without a bound on its slope
                P[:, i] = -Gz[i][0] * 2
                texts[i] = str(rng.choice(['sign(w1)', 'sqrt(w1)', 'w1*abs(w1)', 'tanh(w1)']))
    return system(N, J, texts, P, Gz, Gy, sample_time=0.1 if discrete else None), rng


STEEP = {'sign(w1)': (0.0, 1e9), 'sqrt(w1)': (0.0, 1e9), 'w1*abs(w1)': (0.0, 1e9),
         'tanh(w1)': (0.0, 1.0), 'sin(w1)': (-1.0, 1.0), 'atan(2*w1)': (0.0, 2.0),
         'sat(w1, -1, 1)': (0.0, 1.0)}


@pytest.mark.slow
@FEW
@given(seed=st.integers(0, 2**32 - 1), discrete=st.booleans(), many=st.booleans())
def test_no_slopes_in_their_bounds_break_the_inequality(seed, discrete, many):
    (plant, sensor), rng = random_case(seed, discrete, q=10 if many else None)
    c = certify(plant, sensor)
    if c.status != 'global':
        assert c.status == 'region' or (c.rate == 0.0 and c.bound == np.inf and c.reason)
        return
    L = np.linalg.cholesky(c.S)
    for _ in range(60):
        A = np.array(sensor.N)
        for i in sensor.active:
            low, high = STEEP[sensor.terms[i].text]
            s = rng.choice([low, high, low + (high - low) * rng.random()**8])
            A += s * np.outer(sensor.P[:, i], sensor.Gz[i][0])
        turned = np.linalg.solve(L, (L.T @ A).T).T
        size = np.linalg.norm(turned)
        if discrete:
            assert np.linalg.norm(turned, 2) <= np.exp(-c.rate * 0.1) + 1e-9 * size
        else:
            assert np.linalg.eigvalsh(turned + turned.T)[-1] <= -2 * c.rate + 1e-9 * size


@FEW
@given(seed=st.integers(0, 2**32 - 1))
@example(seed=2086822)  # what is proved stays below each rate that is tried
def test_simulated_errors_keep_rate_and_bound_in_steps(seed):
    """A sampled error system is simulated without any error of integration."""
    (plant, sensor), rng = random_case(seed, discrete=True)
    c = certify(plant, sensor)
    if c.status != 'global':
        return
    e, worst = rng.normal(size=sensor.order) * 3, 0.0
    for _ in range(100):
        zeta = [rng.normal(size=1) * 2 for _ in sensor.terms]
        moved = rhs(sensor, zeta, e, np.zeros(2))
        assert V(c.S, moved)**0.5 <= V(c.S, e)**0.5 * np.exp(-c.rate * 0.1) * (1 + 1e-9) + 1e-12
        e = moved
    e = np.zeros((sensor.order, 20))
    zeta = [rng.normal(size=(1, 20)) * 2 for _ in sensor.terms]
    for n in range(200):
        if n % 25 == 0:
            noise = rng.choice([-1.0, 1.0], size=(2, 20))
        e = rhs(sensor, zeta, e, noise)
        worst = max(worst, np.abs(sensor.Cv[0] @ e).max())
    assert worst <= c.bound


@settings(FEW, max_examples=6)
@given(seed=st.integers(0, 2**32 - 1))
def test_simulated_errors_keep_rate_and_bound_in_continuous_time(seed):
    (plant, sensor), rng = random_case(seed)
    if any(t.text in ('sign(w1)', 'sqrt(w1)') for t in sensor.terms):
        return  # not for Runge and Kutta
    c = certify(plant, sensor)
    if c.status != 'global':
        return
    e, worst, h = rng.normal(size=sensor.order) * 3, 0.0, 0.01
    zeta = [rng.normal(size=1) * 2 for _ in sensor.terms]
    start = V(c.S, e)
    for n in range(300):
        e = rk4(lambda e: rhs(sensor, zeta, e, np.zeros(2)), e, h)
        assert V(c.S, e) <= start * np.exp(-2 * c.rate * h * (n + 1)) * (1 + 1e-6)
    e = np.zeros((sensor.order, 10))
    zeta = [np.repeat(z[:, None], 10, axis=1) for z in zeta]
    for n in range(600):
        if n % 60 == 0:
            noise = rng.choice([-1.0, 1.0], size=(2, 10))
        e = rk4(lambda e: rhs(sensor, zeta, e, noise), e, h)  # noqa: B023
        worst = max(worst, np.abs(sensor.Cv[0] @ e).max())
    assert worst <= c.bound * (1 + 1e-6)


# ------------------------------------------------------------------------- regions, reasons

def test_product_of_two_estimates_is_certified_in_a_box():
    plant, sensor = system([[-1.0, 0.2], [0, -2]], np.ones((2, 1)), ['w1*w2'], [[0.3], [0.1]],
                           [np.eye(2)], [np.zeros((2, 1))], ranges=[[-1, 1], [0, 2], [-1, 1]])
    c = certify(plant, sensor)
    assert c.status == 'region'
    assert c.region == (Limit(0, 0, -1.0, 1.0), Limit(0, 1, 0.0, 2.0))
    assert [name for name, *_ in replace(sensor, certificate=c).region] == ['x1', 'x2']
    for w1, w2 in ((-1, 0), (1, 0), (-1, 2), (1, 2)):
        A = sensor.N + np.outer(sensor.P[:, 0], [w2, w1])
        assert np.linalg.eigvalsh(c.S @ A + A.T @ c.S + 2 * c.rate * c.S)[-1] <= 1e-9


def test_an_input_in_a_term_is_confined_too():
    plant, sensor = system([[-1.0]], [[1.0]], ['w1*u1'], [[0.5]], [[[1.0]]], [[[0.0]]],
                           inputs=1, operating_input=[1.0], operating_point=[1.0, 1.0])
    c = certify(plant, sensor)
    assert c.status == 'region' and [name for name, *_ in replace(
        sensor, certificate=c).region] == ['x1', 'u1']
    assert c.rate == pytest.approx(1 - 0.5 * c.region[1].high)


@pytest.mark.parametrize(('text', 'P', 'ranges', 'words'), [
    ('sin(w1)', 2.0, [[-1, 1], [-1, 1]], 'the error does not die out'),
    ('1/w1', 0.1, [[-1, 1], [-1, 1]], 'the slope of 1/x1 has no bound in the given ranges'),
    ('sqrt(w1)', 1.0, [[0, 1], [0, 1]], 'does not pull its argument back')])
def test_what_cannot_be_certified_says_why(text, P, ranges, words):
    plant, sensor = system([[-1.0]], [[1.0]], [text], [[P]], [[[1.0]]], [[[0.0]]], ranges=ranges)
    c = certify(plant, sensor)
    assert c.status == 'none' and c.rate == 0.0 and c.bound == np.inf
    assert words in c.reason and '\n' not in c.reason


def test_a_jump_that_runs_away_is_told_even_where_the_operating_point_is_clear_of_it():
    plant, sensor = servo(1.0)
    moving = replace(plant, operating_point=np.array([0.0, 3.0, 1.0]))
    assert certify(moving, sensor).status == 'none'


def test_unknown_inputs_that_remain_are_mentioned():
    plant, sensor = system([[-2.0]], [[1.0]])
    assert 'unknown inputs' in certify(plant, replace(sensor, grade='bounded')).reason


def test_large_orders_with_terms_do_without_a_solver():
    rng = np.random.default_rng(6)
    N = rng.normal(size=(45, 45)) / 45**0.5 * 0.3 - np.eye(45)
    G = rng.normal(size=(1, 45)) / 45
    c = certify(*system(N, np.ones((45, 1)), ['sin(w1)'], G.T, [G], [[[0.0]]]))
    assert c.status == 'global' and c.rate > 0.1
    c = certify(*system(N, np.ones((45, 1)), ['sin(w1)'], 1e4 * G.T, [G], [[[0.0]]]))
    assert c.status in ('none', 'region') and c.reason


def test_missing_solver_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, 'cvxpy', None)
    c = certify(*tank(ranges=TANK_RANGES))
    assert c.status == 'none' and c.reason == 'cvxpy is not installed: pip install cvxpy clarabel'
    assert c.bound == np.inf and c.rate == 0.0
    # neither a linear error nor a single state needs it
    assert certify(*servo(-1.0)).status == 'global'
    assert certify(*system([[-1, 1], [0, -2]], np.ones((2, 1)))).status == 'global'
