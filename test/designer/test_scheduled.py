"""Scheduled virtual sensors: equalities, inequalities and what they prove, beside the truth."""

from dataclasses import replace
import sys

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from vsensor_ros import design
from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.scheduled import scheduled, ScheduledObserver, where_it_holds
from vsensor_ros.designer.scheduled_proof import Blend, margin_left
from vsensor_ros.observers import Refusal, ScheduledSensor, VirtualSensor
from vsensor_ros.plant import from_equations, grid_memberships, load_plant, TakagiSugeno

pytest.importorskip('cvxpy')

MOTOR = """
name: motor
time: continuous
parameters: {R: 0.25, Ld: 0.0009, Lq: 0.0014, flux: 0.018, pp: 3, J: 0.001, b: 0.0004}
states:
  id: {range: [-50, 50]}
  iq: {range: [-50, 50]}
  w: {range: [-300, 300]}
inputs: {vd: {range: [-50, 50]}, vq: {range: [-50, 50]}}
disturbances: {load: {range: [-400, 400]}}
dynamics:
  id: (vd - R*id + pp*w*Lq*iq)/Ld
  iq: (vq - R*iq - pp*w*(Ld*id + flux))/Lq
  w: (1.5*pp*(flux*iq + (Ld - Lq)*id*iq) - b*w)/J + load
sensors:
  amp_d: {measures: id, noise: 0.05}
  amp_q: {measures: iq, noise: 0.05}
  encoder: {measures: w, noise: 0.5}
"""


@pytest.fixture(scope='module')
def motor(tmp_path_factory):
    path = tmp_path_factory.mktemp('motor') / 'motor.yaml'
    path.write_text(MOTOR)
    return load_plant(path)


def blended(random, submodels, discrete=False):
    """Return a random plant of three states, stable at each vertex, scheduled by an input."""
    V = submodels
    base = random.normal(size=(3, 3)) - 2.5 * np.eye(3)
    A = base + 0.4 * random.normal(size=(V, 3, 3))
    E = random.normal(size=(V, 3, 1))
    if discrete:
        A, E = np.eye(3) + 0.1 * A, 0.1 * E
    hats = grid_memberships({'u1': np.linspace(0.0, 1.0, V)})
    return TakagiSugeno.of_submodels(
        A, random.normal(size=(V, 3, 1)), np.eye(3), E=E, a=random.normal(size=(V, 3)),
        premises={'u1': [0, 1]}, memberships=hats, sample_time=0.1 if discrete else None)


def equalities_hold(answer):
    """Say how far off Phi A_i = N_i Phi + J_i C0, Phi E_i = 0 and v are, relative."""
    plant = answer.plant
    C0 = plant.C[[plant.sensors.index(name) for name in answer.reads]]
    v = plant.C[plant.sensors.index(answer.channel)]
    off = answer.Phi @ plant.A - answer.N @ answer.Phi - answer.J @ C0
    size = abs(answer.N).max() + abs(answer.J).max() + abs(plant.A).max()
    found = [abs(off).max() / size,
             abs(answer.Cv @ answer.Phi + answer.Q @ C0 - v).max() / abs(v).max(),
             abs(answer.B - answer.Phi @ plant.B).max(initial=0.0)]
    return max([*found, abs(answer.Phi @ plant.E).max()] if answer.decoupled else found)


def worst_off(answer, random, load, noise, step, steps, worst_case):
    """
    Return the largest error of a run of plant and observer from e = 0, sampled finely.

    worst_case: unknown input and noise push e outward at all times, on the edge of their bounds;
    else they are random inside.
    """
    plant, S = answer.plant, answer.S
    rows = [plant.sensors.index(name) for name in answer.reads]
    C0, v = plant.C[rows], plant.C[plant.sensors.index(answer.channel)]
    x = random.normal(size=(len(plant.states), 1))
    z = answer.Phi @ x
    worst = 0.0
    for k in range(steps):
        u = np.array([[0.5 + 0.5 * np.sin(0.01 * k)]])
        at = plant.premises_of(x, u)
        h = plant.weights(at)[:, 0]
        if worst_case:
            way = S @ (answer.Phi @ x - z) if k else np.ones((len(S), 1))
            rho = load * np.sign(np.tensordot(h, answer.Phi @ plant.E, axes=1).T @ way)
            off = -noise[:, None] * np.sign(np.tensordot(h, answer.J, axes=1).T @ way)
        else:
            rho = load * random.uniform(-1, 1, (plant.E.shape[2], 1))
            off = noise[:, None] * random.uniform(-1, 1, (len(rows), 1))
        reading = C0 @ x + off
        dx, dz = plant.rate_of_change(x, u, rho), answer.rate_of_change(z, reading, u, at)
        x, z = (dx, dz) if plant.sample_time else (x + step * dx, z + step * dz)
        worst = max(worst, float(abs(v @ x - answer.estimate(z, C0 @ x + off)).max()))
    return worst


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 4), st.booleans(), st.booleans())
def test_random_plants_are_within_what_is_proved(seed, submodels, discrete, rich):
    random = np.random.default_rng(seed)
    plant = blended(random, submodels, discrete)
    lost, noise, load = ('y1',) if rich else ('y1', 'y2'), np.array([0.01, 0.02, 0.03]), 0.5
    answer = scheduled(plant, lost, 'y1', rate=0.1, noise=noise, unknown=np.array([load]))
    if not isinstance(answer, ScheduledObserver):
        assert answer.code in ('not seen in the range', 'no form over the range')
        return
    assert equalities_hold(answer) < 1e-9
    assert answer.margin >= 1e-7
    bounds = 3.0 * noise[[plant.sensors.index(name) for name in answer.reads]]
    for worst_case in (False, True):
        off = worst_off(answer, random, load, bounds, 1e-3, 800, worst_case)
        assert off <= answer.half_width * 1.01  # Euler's steps


@pytest.mark.parametrize('discrete', [False, True])
def test_a_random_plant_is_within_what_is_proved(discrete):
    random = np.random.default_rng(11)
    answer = scheduled(blended(random, 2, discrete), ['y1'], 'y1', rate=0.1,
                       noise=np.full(3, 0.01), unknown=np.array([0.5]))
    assert equalities_hold(answer) < 1e-9
    off = worst_off(answer, random, 0.5, np.full(2, 0.03), 1e-3, 800, True)
    assert 0.02 * answer.half_width < off <= answer.half_width * 1.01


def test_unknown_inputs_are_kept_out_where_submodels_let_them():
    plant = TakagiSugeno.of_submodels(
        [[[-1, 1, 0], [0, -2, 1], [0, 0, -1]], [[-1, 3, 0], [0, -1, 2], [0, 0, -1]]], None,
        np.eye(3), E=[[[1], [0], [0]], [[2], [0], [0]]], premises={'x1': [0, 1]},
        memberships=['x1', '1 - x1'])
    answer = scheduled(plant, ['y3'], 'y3', rate=0.5, noise=np.full(3, 0.01),
                       unknown=np.array([np.inf]))
    assert answer.decoupled and len(answer.Phi) == 2 and equalities_hold(answer) < 1e-9
    bounded = scheduled(plant, ['y1'], 'y1', rate=0.5, noise=np.full(3, 0.01),
                        unknown=np.array([np.inf]))
    assert bounded.code == 'premise not read' and bounded.fact('names') == ('x1',)


def test_a_matrix_that_is_no_proof_is_not_believed():
    """An indefinite one, one that grows, one at a rate that it does not have, and one that is."""
    blend = Blend(np.array([[[-1.0]], [[-2.0]]]), np.zeros((0, 1)), np.full((2, 1, 1), 0.1),
                  np.zeros((0, 1)), np.ones((1, 1)), None)
    no_gain = np.zeros((2, 1, 0))
    assert margin_left(blend, no_gain, np.array([[10.0]]), 0.5) > 0.1
    assert margin_left(blend, no_gain, np.array([[-10.0]]), 0.5) == -np.inf
    assert margin_left(blend, no_gain, np.array([[10.0]]), 1.5) < 0.0
    assert margin_left(blend, no_gain, np.array([[1000.0]]), 0.5) < 0.0  # w pushes it out
    # whichever vertices are stable: between them there may be no common form
    turned = Blend(np.array([[[-0.1, 10.0], [-0.1, -0.1]], [[-0.1, 0.1], [-10.0, -0.1]]]),
                   np.zeros((0, 2)), np.zeros((2, 2, 1)), np.zeros((0, 1)), np.ones((1, 2)), None)
    assert margin_left(turned, np.zeros((2, 2, 0)), np.eye(2), 0.05) < 0.0


def test_speed_of_a_motor_is_refused_where_it_induces_nothing_and_proved_beside(motor):
    def make(ranges):
        return from_equations(motor, ('id', 'iq'), ranges)
    asked = {'rate': 1.0, 'noise': motor.noise, 'unknown': motor.disturbance_range[:, 1]}
    refused = scheduled(make({}), ['encoder'], 'encoder', **asked)
    assert refused.code == 'not seen in the range'
    assert refused.fact('point') == pytest.approx((-0.018 / 0.0009, 0.0), abs=1e-5)
    answer = scheduled(make({'id': (-10.0, 50.0)}), ['encoder'], 'encoder', **asked)
    assert not answer.decoupled and answer.half_width < 15.0 and equalities_hold(answer) < 1e-9


@pytest.mark.slow
def test_ranges_beside_the_place_that_makes_it_infeasible_are_found(motor):
    def make(ranges):
        return from_equations(motor, ('id', 'iq'), ranges)
    asked = {'rate': 1.0, 'noise': motor.noise, 'unknown': motor.disturbance_range[:, 1]}
    refused = scheduled(make({}), ['encoder'], 'encoder', **asked)
    answers = where_it_holds(make, refused, ['encoder'], 'encoder', **asked)
    assert any(one.ranges[0] == pytest.approx([-10.0, 50.0]) for one in answers)
    widths = [np.prod(np.diff(one.ranges)) for one in answers]
    assert widths == sorted(widths, reverse=True)
    for one in answers:  # none has the place in it
        assert not one.plant.inside(np.array([[-20.0], [0.0]]))[0]


@pytest.mark.slow
def test_speed_of_a_motor_stays_within_its_half_width_from_corner_to_corner(motor):
    """The truth is the plant's equations, with load steps and noise within its bounds."""
    plant = from_equations(motor, ('id', 'iq'), {'id': (-10.0, 50.0)})
    answer = scheduled(plant, ['encoder'], 'encoder', rate=1.0, noise=motor.noise,
                       unknown=np.array([400.0]))
    random, step = np.random.default_rng(3), 5e-6
    x = np.array([0.0, 0.0, 100.0])
    z = answer.Phi @ x[:, None]
    off, currents = 0.0, []
    for k in range(24_000):
        corner = [(-9, -45), (45, -45), (45, 45), (-9, 45)][k // 3000 % 4]
        load = 400.0 * (-1) ** (k // 3000)
        # currents are brought to the corner by voltages that cancel what the speed induces
        wanted = 400.0 * (np.array(corner) - x[:2])
        free = motor.rate_of_change(x, np.zeros(2), np.zeros(1))[:2]
        u = (wanted - free) * [0.0009, 0.0014]
        load -= 250.0 * x[2] / 100.0 if abs(x[2]) > 160.0 else 0.0
        load = float(np.clip(load, -400.0, 400.0))
        reading = x[:2] + 0.15 * random.uniform(-1, 1, 2)
        dz = answer.rate_of_change(z, reading[:, None], u[:, None], x[:2, None])
        x, z = x + step * motor.rate_of_change(x, u, np.array([load])), z + step * dz
        off = max(off, abs(answer.estimate(z, reading[:, None])[0] - x[2]))
        currents.append(x[:2])
    assert plant.inside(np.array(currents).T).all()
    assert np.ptp(currents, axis=0).min() > 40.0
    assert off <= answer.half_width


def test_bad_questions_get_one_line(motor):
    plant = from_equations(motor, ('id', 'iq'))
    asked = {'rate': 1.0, 'noise': motor.noise, 'unknown': np.array([np.inf])}
    with pytest.raises(BadInput, match="unknown sensor 'coder'"):
        scheduled(plant, ['coder'], 'encoder', **asked)
    with pytest.raises(BadInput, match='fault_set: is without encoder'):
        scheduled(plant, ['amp_d'], 'encoder', **asked)
    with pytest.raises(BadInput, match='rate: must be positive'):
        scheduled(plant, ['encoder'], 'encoder', **{**asked, 'rate': 0.0})
    refused = scheduled(plant, ['encoder'], 'encoder', **asked)
    assert str(refused) == ('load cannot be kept out, and no range says how large it may be')


def test_premises_that_are_read_wrong_are_in_the_half_width():
    """Held at x = 0.97, v = 1.94 x, p is read as 1: what is said of v is off by 0.058."""
    plant = TakagiSugeno.of_submodels(
        [[[-1.0, 0.0], [0.0, -2.0]], [[-1.0, 0.0], [4.0, -2.0]]], None, np.eye(2),
        states=['x', 'v'], premises={'x': [0.0, 1.0]}, memberships=['1 - x', 'x'])
    asked = {'rate': 1.0, 'noise': np.array([0.01, 0.1]), 'unknown': np.zeros(0)}
    alone = scheduled(plant, ['y2'], 'y2', **asked)
    both = scheduled(plant, ['y2'], 'y2', **asked, box=np.array([[0.0, 1.0], [-np.inf, np.inf]]))
    x = np.array([[0.97], [2.0 * 0.97**2]])  # where v' = 0 if something holds x there
    z = both.Phi @ x
    for _ in range(10_000):
        z = z + 1e-3 * both.rate_of_change(z, x[:1], np.zeros((0, 1)), np.array([[1.0]]))
        z = both.Phi @ np.vstack([x[:1], (both.Phi.T @ z)[1:]])  # as what holds it does there
    off = abs(both.estimate(z, x[:1])[0] - x[1, 0])
    assert off == pytest.approx(0.058, rel=0.01)
    assert alone.half_width < off < both.half_width
    moved = TakagiSugeno.of_submodels(
        [[[-1.0, 0.0], [0.0, -2.0]], [[-1.0, 0.0], [0.0, -3.0]]], None, np.eye(2),
        states=['x', 'v'], premises={'x': [0.0, 1.0]}, memberships=['1 - x', 'x'])
    refused = scheduled(moved, ['y2'], 'y2', **asked, box=np.array([[0.0, 1.0], [0.0, np.inf]]))
    assert refused.code == 'states without ranges'


@pytest.mark.parametrize('load, why', [(400.0, 'do not see'), (np.inf, 'says how large')])
def test_a_design_says_why_it_takes_none(motor, load, why):
    plant = replace(motor, disturbance_range=np.array([[-load, load]]))
    entry = design(plant, [['encoder']])[('encoder',), 'encoder']
    assert isinstance(entry, Refusal) and why in entry.reason
    assert why not in design(plant, [['encoder']], scheduled=False)[
        ('encoder',), 'encoder'].reason


def test_with_more_faults_it_is_said_once_why_there_is_none(motor):
    both = design(motor, [['encoder'], ['amp_d', 'encoder']])[('amp_d', 'encoder'), 'encoder']
    assert both.reason.count('gains that follow the readings') == 1
    assert 'iq = 0 the healthy' in both.reason  # and not 1.4e-11


def test_a_half_width_as_wide_as_the_range_is_of_no_use(tmp_path):
    text = MOTOR.replace('id: {range: [-50, 50]}', 'id: {range: [-10, 50]}')
    found = {}
    for speed in (300, 3):
        (tmp_path / 'motor.yaml').write_text(text.replace('300', str(speed)))
        found[speed] = design(load_plant(tmp_path / 'motor.yaml'), [['encoder']])[
            ('encoder',), 'encoder']
    assert isinstance(found[300], ScheduledSensor) and 10.0 < found[300].half_width < 60.0
    assert isinstance(found[3], Refusal) and 'lies in a range of 6' in found[3].reason


def test_constant_gains_that_are_proved_go_before(motor):
    assert isinstance(design(motor, [['amp_d']])[('amp_d',), 'amp_d'], VirtualSensor)


TANK = """
name: tank
time: continuous
states: {level: {range: [0.2, 4]}, flow: {range: [0, 4]}}
inputs: {pump: {range: [0, 3], operating: 1}, valve: {range: [0.2, 1], operating: 0.5}}
disturbances: {leak: {range: [-0.1, 0.1]}}
dynamics: {level: pump - 0.8*valve*level + leak, flow: 4*valve*level - 5*flow}
sensors: {gauge: {measures: level, noise: 0.01}, meter: {measures: flow, noise: 0.01}}
"""


def of_tank(tmp_path, old='', new=''):
    """Return what a design says of the tank's gauge, with one thing written otherwise."""
    (tmp_path / 'tank.yaml').write_text(TANK.replace(old, new))
    return design(load_plant(tmp_path / 'tank.yaml'), [('gauge',)])[('gauge',), 'gauge']


def test_noise_of_the_process_is_in_the_half_width(tmp_path):
    still = of_tank(tmp_path)
    driven = of_tank(tmp_path, 'range: [0.2, 4]', 'range: [0.2, 4], process_noise: 0.2')
    (tmp_path / 'own.yaml').write_text(TANK)
    plant = from_equations(load_plant(tmp_path / 'own.yaml'), ['flow'])
    moved = np.diag([0.2**2, 0.0])  # z is a rotation of both states: what is said is row @ x
    Phi = scheduled(plant, ['gauge'], 'gauge', rate=still.decay, noise=[0.01, 0.01],
                    unknown=[0.1]).Phi
    for N in driven.N:
        P = solve_continuous_lyapunov(N, -Phi @ moved @ Phi.T)
        assert driven.half_width - still.half_width > 3.0 * np.sqrt((
            driven.Cv @ P @ driven.Cv.T)[0, 0])


def test_a_curve_counts_where_it_is_flattest(tmp_path):
    curved = of_tank(tmp_path, 'measures: flow', 'measures: sqrt(flow + 0.1)')
    # at 4 the slope is 0.25, and noise of 0.01 is one of 0.04; it is said in units at 0
    steep = 0.5 / np.sqrt(0.1)
    straight = of_tank(tmp_path, 'measures: flow, noise: 0.01',
                       f'measures: {steep}*flow, noise: {0.01 * steep * 2 * np.sqrt(4.1)}')
    assert curved.half_width == pytest.approx(straight.half_width, rel=0.05)


def test_a_refusal_says_what_the_desk_lacks(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'cvxpy', None)
    found = of_tank(tmp_path)
    assert isinstance(found, Refusal)
    assert 'were not sought: cvxpy is not installed: pip install cvxpy clarabel' in found.reason
