"""The virtual sensor that is handed out holds where the plant works, or says where it does not."""

from dataclasses import replace
import json

from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant, Plant
from vsensor_ros.designer.certificate import certify, REACHES
from vsensor_ros.designer.choice import most_valid
from vsensor_ros.designer.error_in_box import error_system, joint_system, slope_bounds
from vsensor_ros.designer.form_search import search
from vsensor_ros.designer.natural_size import reaches
from vsensor_ros.functions.nonlinearity import make_term, slope_at
from vsensor_ros.observers import VirtualSensor
from vsensor_ros.observers.kinds.functional.argument_name import argument_place, together
from vsensor_ros.report.design_answer import answer

MOTOR = """
name: spindle
time: continuous
parameters: {{R: {R}, Ld: {Ld}, Lq: {Lq}, psi: {psi}, pp: 3, J: 0.002, b: 0.001}}
states:
  i_d: {{unit: A, process_noise: 4.0, range: [-30, 30]}}
  i_q: {{unit: A, process_noise: 4.0, range: [-30, 30], initial: 3}}
  speed: {{unit: rad/s, process_noise: 3.0, range: [-300, 300], initial: 120}}
inputs: {{v_d: {{unit: V}}, v_q: {{unit: V, operating: 30}}}}
disturbances: {{load: {{unit: rad/s^2}}}}
dynamics:
  i_d: (v_d - R*i_d + pp*speed*Lq*i_q)/Ld
  i_q: (v_q - R*i_q - pp*speed*(Ld*i_d + psi))/Lq
  speed: (1.5*pp*(psi*i_q + (Ld - Lq)*i_d*i_q) - b*speed)/J + load
sensors:
  D: {{measures: i_d, unit: A, noise: 0.1}}
  Q: {{measures: i_q, unit: A, noise: 0.1}}
  W: {{measures: speed, unit: rad/s, noise: 1.0}}
"""
REACTOR = """
name: reactor
time: continuous
parameters: {{k0: 7.2e10, E: 8750, V: 100, q: 100, c0: 1, T0: 350, h: {heat}, a: 2, Tc: 305}}
states:
  c: {{unit: mol/l, range: [0.05, 1], process_noise: 0.01}}
  T: {{unit: K, range: {range}, process_noise: 0.5}}
  m: {{unit: mol/l, range: [0, 1], process_noise: 0.01}}
inputs: {{}}
dynamics:
  c: q/V*(c0 - c) - k0*exp(-E/T)*c
  T: q/V*(T0 - T) + h*k0*exp(-E/T)*c - a*(T - Tc)
  m: -q/V*m + k0*exp(-E/T)*c - 0.5*k0*exp(-E/T)*m
sensors:
  TT: {{measures: T, unit: K, noise: 0.2}}
  M: {{measures: m, unit: mol/l, noise: 0.005}}
operating_point: {{c: 0.88, T: 325.0, m: 0.1}}
"""


def loaded(tmp_path, text):
    path = tmp_path / 'plant.yaml'
    path.write_text(text)
    return load_plant(path)


def frozen(plant, sensor, x, u):
    """Return N with the slopes of all terms at one point of the plant."""
    N = np.array(sensor.N)
    for i in sensor.active:
        slope = slope_at(sensor.terms[i], plant.G[i] @ x, plant.inputs, u) - sensor.terms[i].slope
        N += np.outer(sensor.P[:, i], slope @ sensor.Gz[i])
    return N


@pytest.mark.slow
@pytest.mark.parametrize('numbers', [
    {'R': 0.2, 'Ld': 0.0009, 'Lq': 0.0014, 'psi': 0.02},
    {'R': 1.1, 'Ld': 0.004, 'Lq': 0.007, 'psi': 0.08}], ids=['small', 'large'])
def test_a_current_is_replaced_at_every_speed_of_a_motor(tmp_path, numbers):
    plant = loaded(tmp_path, MOTOR.format(**numbers))
    result = design(plant, [('D',), ('Q',)])
    for v in result.virtual_sensors:
        assert v.certificate.status == 'global' and v.certificate.uncovered == ''
        for speed in (-300.0, 300.0):
            N = frozen(plant, v, np.array([-30.0, 30.0, speed]), np.zeros(2))
            assert np.linalg.eigvals(N).real.max() <= -v.certificate.rate * (1 - 1e-6)
    assert 'BUT NOT PROVED' not in answer(result)


def test_what_is_unstable_on_the_declared_ranges_is_told_in_the_first_line(tmp_path):
    """The error of x obeys d e = (w - 1) e, whatever the observer does."""
    plant = loaded(tmp_path, """
name: growth
time: continuous
states:
  x: {unit: g, range: [0, 10]}
  w: {unit: 1/h, range: [-3, 3]}
inputs: {u: {}}
dynamics: {x: w*x - x + u, w: -w + u}
sensors: {X: {measures: x, unit: g, noise: 0.1}, W: {measures: w, unit: 1/h, noise: 0.01}}
""")
    v = (result := design(plant, [('X',)]))['X', 'X']
    assert v.certificate.status == 'region'
    assert all(limit.high < 1.0 for limit in v.certificate.region if v.region[limit.argument][0]
               == 'w')
    assert v.certificate.uncovered.startswith('with ')
    assert 'unstable at' in v.certificate.uncovered and 'w = 3 1/h' in v.certificate.uncovered
    first = next(line for line in answer(result).split('\n') if line.startswith('X [g]'))
    assert 'BUT NOT PROVED with ' in first
    path = tmp_path / 'design.json'
    result.save(path)
    again = Design.load(path)['X', 'X']
    assert again.certificate.uncovered == v.certificate.uncovered and again.region == v.region
    # a file of before has neither, and its region is named by the terms
    record = json.loads(path.read_text())
    for entry in record['entries']:
        for key in ('uncovered', 'where'):
            del entry['certificate'][key]
    path.write_text(json.dumps(record))
    older = Design.load(path)['X', 'X']
    assert older.certificate.uncovered == '' and older.region == v.region


def test_validity_goes_before_rank_and_a_valid_first_asks_for_no_other():
    """Of d e = -e + s e, s the slope of a term, by gain: everywhere, on ranges, nowhere."""
    def of(gain, text='w1**2'):
        plant = Plant.from_matrices(
            [[-1.0, 0], [0, -1]], None, np.eye(2), P=[[1.0], [0]], G=[[1, 0]],
            nonlinearities=[text], ranges=[[-1, 1], [-1, 1]], operating_point=[0.0, 0.0])
        return plant, VirtualSensor(
            'y1', ('y1',), ('y2',), (), np.array([[1.0, 0]]), np.array([[-1.0]]), np.zeros((1, 1)),
            np.zeros((1, 0)), np.array([[gain]]), np.eye(1), np.zeros((1, 1)),
            (np.eye(1),), (np.zeros((1, 1)),), plant.terms, None, np.zeros(1), np.zeros((1, 1)),
            np.array([-1.0 + 0j]), 1.0, 'by hand')

    (plant, wild), (_, ranged), (_, valid) = of(5.0), of(0.2), of(0.0)
    sensor, c = most_valid(plant, iter([wild, ranged]))
    assert sensor is ranged and c.status == 'region' and c.uncovered == ''
    assert c.region[0].low == -1.0 and c.rate == pytest.approx(0.6, rel=1e-3)
    assert most_valid(plant, iter([wild, ranged, valid]))[0] is valid
    sensor, c = most_valid(plant, iter([wild]))
    assert c.status == 'region' and 'unstable at' in c.uncovered

    def ranks():
        yield valid
        raise AssertionError('nobody asked for more')
    assert most_valid(plant, ranks())[1].status == 'global'


def test_of_those_that_hold_in_the_same_region_the_rank_decides_not_the_third_digit():
    """Of d e = -e + s e; the first, by half a percent the worst, holds in the same box."""
    plant = Plant.from_matrices(
        [[-1.0, 0], [0, -1]], None, np.eye(2), P=[[1.0], [0]], G=[[1, 0]],
        nonlinearities=['w1**2'], operating_point=[0.0, 0.0])
    widest = max(REACHES) * reaches(plant)[0][0]

    def of(gain):
        return VirtualSensor(
            'y1', ('y1',), ('y2',), (), np.array([[1.0, 0]]), np.array([[-1.0]]), np.zeros((1, 1)),
            np.zeros((1, 0)), np.array([[gain]]), np.eye(1), np.zeros((1, 1)),
            (np.eye(1),), (np.zeros((1, 1)),), plant.terms, None, np.zeros(1), np.zeros((1, 1)),
            np.array([-1.0 + 0j]), 1.0, 'by hand')

    wild, first, *others = (of(share / (2 * widest)) for share in (
        0.9, 0.745, 0.741, 0.7409, 0.7408, 0.7407))  # of the linear rate, lost in this box
    sensor, c = most_valid(plant, iter([wild, first, *others]))
    assert sensor is first and c.where == (('x1', -widest, widest),)
    assert c.rate == pytest.approx(0.255, rel=1e-3)


# ------------------------------------------------- slopes of shared arguments, bounded together

def shared_terms(w, u):
    return (np.exp(0.3 * w[0]) * w[1], w[0]**2 * w[1],
            u[0] * np.sin(w[0]) + w[1] * abs(w[1]))


def random_system(seed, discrete=False):
    """Return a plant of three terms that share two arguments and an input, and its observer."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(2, 4))
    N = rng.normal(size=(k, k)) * 0.3 - 1.5 * np.eye(k)
    P = rng.normal(size=(k, 3)) * 0.3
    G = [rng.normal(size=(2, k)) for _ in range(1)] * 3
    texts = ['exp(0.3*w1)*w2', 'w1**2*w2', 'u1*sin(w1) + w2*abs(w2)']
    if discrete:
        N, P = np.eye(k) + 0.1 * N, 0.1 * P
    plant = Plant.from_matrices(
        N, np.zeros((k, 1)), np.eye(k), sample_time=0.1 if discrete else None, P=P, G=G,
        nonlinearities=texts, inputs=['u1'], ranges=np.tile([-0.5, 0.7], (k, 1)),
        input_range=[[0.2, 0.6]])
    one = np.zeros((k, k - 1))
    return rng, plant, VirtualSensor(
        'y1', ('y1',), plant.sensors[1:], ('u1',), np.eye(k), N, one, np.zeros((k, 1)), P,
        np.eye(k)[:1], np.zeros((1, k - 1)), tuple(G), (np.zeros((2, k - 1)),) * 3, plant.terms,
        plant.sample_time, np.zeros(k), one, np.linalg.eigvals(N).astype(complex), 1.0, 'by hand')


@settings(max_examples=8, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32 - 1), discrete=st.booleans())
def test_no_frozen_point_and_no_secant_of_the_box_grows_faster_than_its_bound(seed, discrete):
    rng, plant, v = random_system(seed, discrete)
    box = plant.ranges, plant.input_range
    joint = joint_system(plant, v, slope_bounds(plant, v, *box), *box).joint
    k = v.order
    L = np.linalg.cholesky(np.eye(k) + 0.2 * np.diag(rng.random(k)))
    bound = joint.growth(L, plant.sample_time)
    x, other = rng.uniform(*plant.ranges.T, size=(2, 60, k))
    for a, b, u in zip(x, other, rng.uniform(0.2, 0.6, size=(60, 1))):
        e = a - b
        moved = v.N @ e
        for i, term in enumerate(v.terms):
            wa, wb = plant.G[i] @ a, plant.G[i] @ b
            moved = moved + v.P[:, i] * (shared_terms(wa, u)[i] - shared_terms(wb, u)[i]
                                         - term.slope @ (wa - wb))
        size = np.linalg.norm(L.T @ e)
        grows = ((L.T @ e) @ (L.T @ moved) / size**2 if not discrete
                 else np.linalg.norm(L.T @ moved) / size)
        assert grows <= bound + 1e-9


def test_terms_that_cancel_each_other_are_certified_together():
    """Of slope -0.5 - 0.1 exp x; taken apart, exp x and 0.9 exp x could be at different x."""
    plant = Plant.from_matrices(
        [[-0.5, 0], [0, -1]], None, np.eye(2), P=[[-1.0, 0.9], [0, 0]], G=[[1, 0], [2, 0]],
        nonlinearities=['exp(w1)', 'exp(0.5*w1)'], ranges=[[0, 2], [-1, 1]],
        operating_point=[1, 0])
    v = VirtualSensor(
        'y1', ('y1',), ('y2',), (), np.array([[1.0, 0]]), np.array([[-0.5]]), np.zeros((1, 1)),
        np.zeros((1, 0)), np.array([[-1.0, 0.9]]), np.eye(1), np.zeros((1, 1)),
        (np.eye(1), 2 * np.eye(1)), (np.zeros((1, 1)),) * 2, plant.terms, None, np.zeros(1),
        np.zeros((1, 1)), np.array([-0.5 + 0j]), 1.0, 'by hand')
    box = plant.ranges, plant.input_range
    assert search(error_system(v, slope_bounds(plant, v, *box))) is None
    c = certify(plant, v)
    assert c.status == 'region' and c.where == (('x1', 0.0, 2.0),) and c.uncovered == ''
    assert 0.54 <= c.rate <= 0.6


@pytest.mark.parametrize(('heat', 'span'), [(50.0, [310, 345]), (-50.0, [315, 335])])
def test_a_reactor_is_certified_far_about_its_operating_point(tmp_path, heat, span):
    """Heat of reaction of both signs; the lost temperature follows from a concentration."""
    plant = loaded(tmp_path, REACTOR.format(heat=heat, range=span))
    v = design(plant, [('TT',)])['TT', 'TT']
    c, at = v.certificate, dict(zip(plant.states, plant.operating_point))
    assert c.status in ('region', 'global')
    N = frozen(plant, v, plant.operating_point, np.zeros(0))
    assert c.rate >= 0.2 * -np.linalg.eigvals(N).real.max()
    own = dict(zip(plant.states, plant.ranges))
    for name, low, high in v.region:
        assert low <= max(0.6 * at[name], own[name][0]) + 1e-9
        assert high >= min(1.4 * at[name], own[name][1]) - 1e-9
    rng = np.random.default_rng(1)
    L = np.linalg.cholesky(c.S)
    where = {name: (low, high) for name, low, high in v.region}
    for _ in range(200):
        x = np.array([rng.uniform(*where.get(name, (at[name],) * 2)) for name in plant.states])
        turned = np.linalg.solve(L, (L.T @ frozen(plant, v, x, np.zeros(0))).T).T
        assert np.linalg.eigvalsh(turned + turned.T)[-1] <= -2 * c.rate * (1 - 1e-6)


# ------------------------------------------------------------------------------- the words

def test_regions_are_told_in_states_each_once():
    def term(text, name, r):
        return replace(make_term(text, r, ()), name=name)

    flux = term('w1*(w2 + 0.0175)', 'w*(0.0008*id + 0.0175)', 2)
    assert argument_place(flux, 1, -0.048, 0.048) == ('id', pytest.approx(-60), pytest.approx(60))
    assert argument_place(term('exp(w1)', 'exp(-p1)', 1), 0, -3.0, 1.0) == ('p1', -1.0, 3.0)
    assert argument_place(term('sqrt(w1)', 'sqrt(2*a - 2*b)', 1), 0, 0.0, 4.0) == (
        'a - b', 0.0, 2.0)
    assert argument_place(term('sqrt(w1)', 'sqrt(-2*a + 3*b)', 1), 0, 0.0, 4.0) == (
        '2*a - 3*b', -4.0, 0.0)
    assert together([('id', -60.0, 60.0), ('w', -np.inf, np.inf), ('id', -50.0, 70.0)]) == (
        ('id', -50.0, 60.0),)
    own = [('a', -1.0, 1.0), ('b', 0.0, 2.0)]
    assert together([*own, ('a - b', -3.0, 1.0)]) == tuple(own)
    assert together([('a + 2*b', -1.0, 4.0), *own]) == (('a + 2*b', -1.0, 4.0), *own)


def test_what_is_unstable_only_between_the_ends_of_a_range_is_said():
    """Of sin(2 a) the slope is steepest in the middle, and falls at both ends."""
    plant = Plant.from_matrices(
        -np.eye(2), [[1], [0]], np.eye(2), P=[1.5, 0], G=[[1, 0]], nonlinearities=['sin(2*w1)'],
        ranges=[[-1.5, 1.5], [-1, 1]], operating_point=[1.5, 0], operating_input=[1.3])
    slope = 3 * np.cos(3.0)
    A = [[slope - 1, 0], [0, -1]]
    plant = replace(plant, A=np.array(A), terms=(replace(
        plant.terms[0], slope=np.array([2 * np.cos(3.0)])),))
    found = design(plant, [('y1',)])[('y1',), 'y1']
    assert 'unstable at x1 = 0, where an error grows at 2 1/s' in found.certificate.uncovered
