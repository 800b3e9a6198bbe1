"""How a virtual sensor forgets its start, against closed forms and simulation."""

import tracemalloc

import numpy as np
import pytest
from scipy.special import gammaln

from vsensor_ros import design, Plant
from vsensor_ros.bank import Bank
from vsensor_ros.observers import Certificate, Limit, Noise
from vsensor_ros.observers.kinds.functional.convergence import (
    converge,
    reading_gains,
    reading_pushes,
    settling_time,
)

MS = 1_000_000
KEY = (('y1',), 'y1')


def noise(error):
    return Noise(error, 0.0, False)


def test_one_mode_is_forgotten_when_a_hundredth_is_left_or_noise_hides_it(bench):
    for error, left in ((0.0, 0.01), (0.3, 0.1), (5.0, 1.0)):  # the start is off by 3
        v = bench.virtual_sensor([[-2.0]], [[1.0]], start=np.array([[9.0]]), noise=noise(error))
        c = converge(v)
        assert c.warm_up == pytest.approx(-np.log(left) / 2, rel=0.01)
        assert c.known and c.proved and c.slowest == pytest.approx(0.5)
        for age in (0.0, 0.1, 0.7, 3.0):
            assert c.deviation(age) == pytest.approx(3 * np.exp(-2 * age), rel=0.02)
        assert c.deviation(1e3) < 1e-9


@pytest.mark.parametrize('N', [
    [[-1.0, 8.0], [0.0, -1.2]], [[-0.1, 3.0], [-3.0, -0.1]], [[-0.1, 30.0], [-30.0, -0.1]],
    [[-1000.0, 0.0], [1.0, -0.01]]],
    ids=['that grows first', 'that swings', 'that swings fast', 'of unlike modes'])
def test_what_is_left_of_a_linear_error_is_about_what_there_is(bench, N):
    start = np.array([[1.0, -0.5], [-0.5, 4.0]])
    v = bench.virtual_sensor(N, [[0.0], [0.0]], start=start, noise=noise(0.0))
    c, (modes, right) = converge(v), np.linalg.eig(np.array(N))
    t = np.append(0.0, np.geomspace(1e-5, 40.0, 60_000)) / -modes.real.max()
    flow = ((right[0] * np.exp(t[:, None] * modes)) @ np.linalg.inv(right)).real
    truth = np.sqrt(np.einsum('ti,ij,tj->t', flow, start, flow))
    later = np.maximum.accumulate(truth[::-1])[::-1][::20]
    t = t[::20]
    found = np.array([c.deviation(at) for at in t])
    assert (later <= 1.1 * found + 1e-9).all()
    assert (found <= 1.15 * later + 1e-3 * truth.max()).all()
    assert later[t >= c.warm_up][0] <= 0.0101 * truth.max()
    assert later[t <= 0.9 * c.warm_up][-1] >= 0.01 * truth.max()


def test_a_discrete_error_by_its_powers(bench):
    v = bench.virtual_sensor([[0.9, 1.0], [0.0, -0.8]], [[0.0], [0.0]], sample_time=0.5,
                             start=np.eye(2), noise=noise(0.0))
    c, power, left = converge(v), np.eye(2), []
    for _ in range(300):
        left.append(np.linalg.norm(power[0]))
        power = power @ v.N
    for k in (0, 1, 2, 5, 9, 14, 40):
        assert max(left[k:]) <= 1.01 * c.deviation(0.5 * k) <= 1.2 * max(left[k:])
    first = next(k for k in range(300) if max(left[k:]) <= 0.01 * max(left))
    assert 0.5 * (first - 1) <= c.warm_up <= 0.5 * (first + 3)


def test_terms_that_feed_the_error_are_forgotten_as_the_certificate_says(bench):
    S = np.array([[2.0]])
    more = {'P': [[-1.0]], 'Gz': [[[1.0]]], 'Gy': [[[0.0]]], 'texts': ['tanh(w1)'],
            'start': np.array([[9.0]]), 'noise': noise(0.0)}
    for status, rate, proved in (('region', 0.5, True), ('none', 4.0, False)):
        c = converge(bench.virtual_sensor([[-4.0]], [[0.0]], certificate=Certificate(
            status, rate if proved else 0.0, 1.0, S, (), None, ''), **more))
        assert c.proved is proved
        assert c.warm_up == pytest.approx(np.log(100) / rate, rel=0.02)
        assert c.deviation(0.2) == pytest.approx(3 * np.exp(-0.2 * rate), rel=0.02)
    more['Gz'] = [[[0.0]]]  # known from readings alone: the error is linear
    assert converge(bench.virtual_sensor([[-4.0]], [[0.0]], **more)).proved


def test_what_is_not_known_is_infinite(bench):
    c = converge(bench.virtual_sensor([[-2.0]], [[1.0]], noise=noise(5.0)))
    assert c.warm_up == pytest.approx(np.log(100) / 2, rel=0.01)
    assert c.deviation(0.99 * c.warm_up) == np.inf and c.deviation(c.warm_up) == 0.0
    assert converge(bench.virtual_sensor([[0.0]], [[1.0]])).warm_up == np.inf
    static = converge(bench.virtual_sensor(np.zeros((0, 0)), np.zeros((0, 1)), Q=[[2.0]]))
    assert (static.warm_up, static.deviation(0.0)) == (0.0, 0.0)


@pytest.mark.parametrize('rate', [1e-308, 1e-20])
def test_a_rate_that_is_none_is_never_warm(bench, rate):
    v = bench.virtual_sensor([[-4.0]], [[0.0]], P=[[-1.0]], Gz=[[[1.0]]], Gy=[[[0.0]]],
                             texts=['tanh(w1)'], start=np.eye(1), noise=noise(0.0),
                             certificate=Certificate('global', rate, 1.0, np.eye(1), (), None, ''))
    assert converge(v).warm_up == np.inf and converge(v).deviation(1e9) == np.inf
    assert converge(bench.virtual_sensor([[-rate]], [[1.0]])).warm_up == np.inf


def test_a_region_counts_only_where_start_and_arguments_lie_within(bench):
    def made(width, rate=0.5):
        return bench.virtual_sensor(
            [[-4.0]], [[4.0]], P=[[1.0]], Gz=[[[1.0]]], Gy=[[[0.5]]], texts=['tanh(w1)'],
            start=np.eye(1), noise=noise(0.0), certificate=Certificate(
                'region', rate, 1.0, np.eye(1), (Limit(0, 0, -width, width),), None, ''))
    assert converge(made(1.0)).proved  # an error of at most sqrt(3)
    assert not converge(made(0.8)).proved
    assert converge(made(0.8)).warm_up == pytest.approx(np.log(100) / 0.5, rel=0.02)
    assert converge(made(0.8, 9.0)).warm_up == pytest.approx(np.log(100) / 4, rel=0.02)
    bank = Bank(bench.design(made(1.0)), 100)
    assert not bank.outside_region(*KEY)
    for now in range(0, 2000, 10):
        bank.take('y2', now * MS, 0.2 if now < 1000 else 2.0)
        bank.advance(now * MS)
        if now in (990, 1990):
            assert bank.outside_region(*KEY) is (now > 1000)


def test_many_modes_that_swing_need_a_bounded_table(bench):
    k = 60
    N = np.zeros((k, k))
    for i in range(0, k, 2):
        N[i:i + 2, i:i + 2] = [[-0.02 * (1 + i), 1 + i], [-1 - i, -0.02 * (1 + i)]]
    v = bench.virtual_sensor(N, np.ones((k, 1)), Cv=np.ones((1, k)), start=np.eye(k))
    tracemalloc.start()
    c = converge(v)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40e6
    start = np.sqrt(k)  # and each pair of them swings with sqrt(2)
    assert c.left[0] == pytest.approx(start, rel=0.01)
    assert c.deviation(20.0) >= np.sqrt(2) * np.exp(-0.02 * 20.0)


def test_gains_of_readings(bench):
    low = bench.virtual_sensor([[-2.0]], [[6.0, 0.0]], Q=[[0.0, -5.0]], healthy=('y2', 'y3'))
    np.testing.assert_allclose(reading_gains(low), [3.0, 5.0], rtol=1e-12)
    high = bench.virtual_sensor([[-2.0]], [[-6.0]], Q=[[3.0]])  # 3 s / (s + 2)
    np.testing.assert_allclose(reading_gains(high), [3.0], rtol=1e-12)
    swings = bench.virtual_sensor([[0, 1], [-9, -0.3]], [[0], [1]], Cv=[[1, 0]])
    damping = 0.05
    np.testing.assert_allclose(reading_gains(swings), [
        1 / 9 / (2 * damping * np.sqrt(1 - damping**2))], rtol=0.01)
    steps = bench.virtual_sensor([[-0.5]], [[1.0]], sample_time=1.0)  # 1 / (z + 0.5)
    np.testing.assert_allclose(reading_gains(steps), [2.0], rtol=1e-12)
    assert reading_gains(bench.virtual_sensor([[0.0]], [[1.0]]))[0] == np.inf


def test_pushes_of_readings(bench):
    both = bench.virtual_sensor([[-2.0]], [[6.0, 0.0]], Q=[[0.0, -5.0]], healthy=('y2', 'y3'))
    np.testing.assert_allclose(reading_pushes(both), [6.0, 0.0], rtol=1e-9)
    later = bench.virtual_sensor([[-1, 4], [0, -1]], [[0], [1]], Cv=[[1, 0]])  # 4 t exp(-t)
    np.testing.assert_allclose(reading_pushes(later), [4 / np.e], rtol=0.01)
    steps = bench.virtual_sensor([[-0.5]], [[3.0]], sample_time=2.0)
    np.testing.assert_allclose(reading_pushes(steps), [1.5], rtol=1e-9)
    assert reading_pushes(bench.virtual_sensor([[0.0]], [[1.0]]))[0] == np.inf


def test_a_bank_says_when_it_is_ready(bench):
    v = bench.virtual_sensor([[-2.0]], [[1.0]], start=np.array([[9.0]]), noise=noise(0.3))
    bank = Bank(bench.design(v), 100)
    assert bank.warm_up(*KEY) == pytest.approx(np.log(10) / 2, rel=0.01)
    assert bank.warm_up(('y2',), 'y2') == np.inf
    assert (bank.ready(*KEY), bank.waiting(*KEY), bank.deviation(*KEY)) == (False, np.inf, np.inf)
    for now in range(0, 1500, 10):
        bank.take('y2', now * MS, 1.0)
        bank.advance(now * MS)
        assert bank.waiting(*KEY) == pytest.approx(max(0.0, bank.warm_up(*KEY) - now / 1e3))
        assert bank.ready(*KEY) is (now / 1e3 >= bank.warm_up(*KEY))
        assert str(bank.why_not(*KEY)) == (
            'None' if bank.ready(*KEY) else f'converging, {bank.waiting(*KEY):.1f} s more')
        left = 3 * np.exp(-2 * now / 1e3)
        assert bank.deviation(*KEY) == pytest.approx(np.hypot(0.3, left), rel=0.01)
    assert bank.ready(*KEY)


def test_the_designer_says_how_far_the_start_may_be():
    """Draw starts as it is told to: the spread of Phi x - z is the covariance it gives."""
    more = {'C': [[1, 0, 0], [0, 1, 0]], 'initial': [0.5, 1.0, 0.0], 'noise': [0.1, 0.2]}
    A, B = [[-1, 1, 0], [0, -2, 1], [0, 0, -0.5]], [0, 0, 1]
    ranges = [[-1, 3], [0, 4], [-5, 1]]
    plant = Plant.from_matrices(A, B, **more, ranges=ranges)
    v = design(plant)['y1', 'y1']
    rng = np.random.default_rng(0)
    x = rng.uniform(*np.array(ranges, float).T, (200_000, 3))
    y = x @ plant.C[1:].T + 0.2 * rng.standard_normal((len(x), 1))
    e = x @ v.Phi.T - v.z0 - y @ v.z0_gain.T
    np.testing.assert_allclose(v.start, e.T @ e / len(e), rtol=0.03, atol=1e-2 * v.start.max())
    # without ranges, the natural size: noise is 1 % of it
    v = design(Plant.from_matrices(A, B, **more))['y1', 'y1']
    assert 0.5 < np.sqrt(v.start.max()) < 100.0
    static = design(Plant.from_matrices([[-1]], [1], [[1], [2]]))['y1', 'y1']
    assert static.order == 0 and static.start is None


def test_what_is_known_of_the_whole_start_is_one_error():
    """A chain of states at the corner of their ranges: their means add up, not their squares."""
    n = 6
    A = -np.eye(n) + np.eye(n, k=1)
    C = np.vstack([np.ones(n), np.eye(n)[-1]])
    plant = Plant.from_matrices(A, np.ones((n, 1)), C, ranges=[[0.0, 2.0]] * n,
                                noise=[0.01, 0.01])
    v = design(plant)['y1', 'y1']
    x = np.random.default_rng(0).uniform(0.0, 2.0, (100_000, n))
    e = x @ v.Phi.T - v.z0 - x @ plant.C[1:].T @ v.z0_gain.T
    truth = e.T @ e / len(e)
    np.testing.assert_allclose(v.start, truth, atol=0.02 * truth.max())


@pytest.mark.parametrize('length', [4, 13])
def test_a_chain_of_dead_times_settles_in_its_length(bench, length):
    """Its eigenvalues are all 0, which would settle at once."""
    shift = np.eye(length, k=1)
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(length, length)))[0]
    for T in (np.eye(length), turned):
        v = bench.virtual_sensor(T @ shift @ T.T, np.zeros((length, 1)), Cv=T[:, :1].T,
                                 sample_time=0.5, start=np.eye(length), noise=noise(0.0))
        assert settling_time(v) == pytest.approx(0.5 * length)
        assert converge(v).warm_up == pytest.approx(0.5 * length)
        assert converge(v).slowest == pytest.approx(0.5 * length / np.log(20))


@pytest.mark.parametrize('length', [1, 3, 60])
def test_a_chain_of_equal_lags_settles_later_than_one(bench, length):
    """Closed form: the j-th lag before the last one reaches it as t^j/j! exp(-t)."""
    v = bench.virtual_sensor(np.eye(length, k=1) - np.eye(length), np.zeros((length, 1)),
                             Cv=np.eye(length)[:1], start=np.eye(length), noise=noise(0.0))
    j, t = np.arange(length), np.linspace(0.0, 3.0 * length + 10.0, 4000)[1:]
    left = np.sqrt(np.exp(2 * (np.outer(np.log(t), j) - gammaln(j + 1) - t[:, None])).sum(axis=1))
    last = t[left > 0.05 * max(1.0, left.max())][-1]
    assert settling_time(v) == pytest.approx(last, rel=0.05)
    assert settling_time(v) > 2.9 * (1 if length < 3 else 2)
