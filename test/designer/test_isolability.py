"""Whose fault can be told from whose: known answers, ranks by brute force, and injected faults."""

from pathlib import Path

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from scipy.linalg import expm

from vsensor_ros import Design, load_plant, Plant
from vsensor_ros.bank import Bank
from vsensor_ros.designer import system_matrix
from vsensor_ros.designer.isolability import blind_to, checks, distinctions
from vsensor_ros.designer.location import locations
from vsensor_ros.observers import Isolability, NONE, STRENGTHS, STRONG, WEAK
from vsensor_ros.observers.kinds.functional.tracking import tracker
from vsensor_ros.simulate.simulate import readings, simulate

CONFIG = Path(__file__).parents[2] / 'config'
# all states hear rho; s1 and s2 show one state, s3 a sum with another
SHARED = Plant.from_matrices(
    -np.diag([1.0, 2.0, 3.0]), None, [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    D=[[1, 0], [0, 1], [0, 1]], sensors=('s1', 's2', 's3', 's4'))
JOINT = Plant.from_matrices([[0, 1], [0, -4]], [0, 8], np.eye(2), sensors=('angle', 'speed'),
                            noise=[0.0005, 0.005])

# two wheels on a shaft that twists, of which the second is loaded: the study's drive
DRIVE = Plant.from_matrices(
    [[-0.5, -800, 0, 40, 0], [1, 0, -1, 0, 0], [0, 200, -0.2, 0, 0], [-10, 0, 0, -50, 0],
     [0, 0, 1, 0, 0]], [0, 0, 0, 100, 0], np.eye(5)[[0, 2, 4, 3]], D=[0, 0, -5, 0, 0],
    sensors=('motor', 'load', 'angle', 'current'), noise=[0.5, 0.1, 0.001, 0.05],
    process_noise=[0.5, 0, 0.5, 1, 0])


def load(name):
    return load_plant(CONFIG / name / 'plant.yaml')


def told(plant, sets=None):
    sets = [(), *((s,) for s in plant.sensors)] if sets is None else sets
    return {(d.sensor, *d.others): d.strength for d in distinctions(plant, sets)}


def gain_of(residual, sensor):
    return residual.gains[residual.support.index(sensor)]


def told_by(found, plant):
    return {(s, *o): found.by_residuals(s, o) for o in [(), *((s,) for s in plant.sensors)]
            for s in plant.sensors if s not in o}


# ------------------------------------------------------------------------- known answers

def test_the_servo_tells_its_speed_from_its_current_by_the_copies_of_the_pair(designed):
    plant = load('servo')
    found = designed(plant, isolate=True).isolability
    assert told(plant) == told_by(found, plant)
    assert {pair for pair, how in told(plant).items() if how == STRONG} == {
        ('y2',), ('y3',), ('y2', 'y1'), ('y3', 'y1'), ('y2', 'y3'), ('y3', 'y2')}
    assert set(told(plant).values()) == {STRONG, NONE}
    singles = [r for r in found.residuals if len(r.fault_set) == 1]
    assert {r.support for r in singles} == {('y2', 'y3')}  # each is checked by the other
    assert {r.support for r in found.residuals if len(r.fault_set) == 2} == {('y2',), ('y3',)}
    assert not found.filters
    assert found.gaps == (
        'y1: no fault of it is seen: everything that checks y1 is disturbed by rho',)


def test_the_tank_with_two_sensors_tells_them_by_pairs_only(designed):
    plant = load('three_tank')
    result = designed(plant, isolate=True)
    assert result.fault_sets == (('y1',), ('y2',), ('y1', 'y2'))
    assert set(told(plant).values()) == {STRONG}
    assert told_by(result.isolability, plant) == told(plant) and not result.isolability.gaps
    assert {r.support for r in result.isolability.residuals if r.fault_set != ('y1', 'y2')} == {
        ('y1', 'y2')}


def test_the_temperature_lab_can_never_tell_its_sensors_apart(designed):
    plant = load('tclab')
    found = designed(plant, isolate=True).isolability
    assert told(plant) == told_by(found, plant) == {
        ('T1',): STRONG, ('T2',): STRONG, ('T1', 'T2'): NONE, ('T2', 'T1'): NONE}
    assert found.gaps == ('T1 and T2 cannot be told apart: one residual checks both',)


@pytest.mark.slow
def test_the_discrete_tank_tells_all_even_what_it_cannot_replace(designed):
    plant = load('three_tank_discrete')
    result = designed(plant, isolate=True)
    assert isinstance(result['y1', 'y1'].reason, str)
    assert set(told(plant).values()) == {STRONG}
    assert told_by(result.isolability, plant) == told(plant) and not result.isolability.gaps


def test_a_constant_fault_of_an_integrated_angle_fades(designed):
    found = designed(JOINT, isolate=True).isolability
    assert told(JOINT) == told_by(found, JOINT) == {
        ('angle',): WEAK, ('angle', 'speed'): WEAK,
        ('speed',): STRONG, ('speed', 'angle'): STRONG}
    assert found.gaps == (
        'angle: jumps, freezes and noise are seen; a constant bias is not',)


def test_gaps_name_the_unknown_inputs_that_are_enough(designed):
    """s1 and s2 show the same, s3 and s4 hear the same unknown input."""
    found = designed(SHARED, isolate=True).isolability
    assert found.gaps == (
        's1 and s2 cannot be told apart: everything that checks s1 without s2 is disturbed by '
        'rho1',
        's3 and s4 cannot be told apart: everything that checks s3 without s4 is disturbed by '
        'rho2')


def test_what_is_told_from_faults_of_two_others():
    """Two states that only their sensors tell, of each two, and a sensor of their sum."""
    plant = Plant.from_matrices(-np.eye(2), None, [[1, 0], [1, 0], [0, 1], [0, 1], [1, 1]],
                                D=np.eye(2))
    assert {how for pair, how in told(plant).items() if len(pair) == 2} == {STRONG}
    # beside two a third is told only while others check it
    more = told(plant, [('y1', 'y2'), ('y1', 'y3'), ('y3', 'y4')])
    assert more['y5', 'y3', 'y4'] == NONE and more['y3', 'y1', 'y2'] == STRONG


def test_terms_count_by_what_feeds_them(designed):
    """x1 feels sign(x2), which y2 shows and nobody else: a fault of y2 reaches y1's residual."""
    plant = Plant.from_matrices([[-1, 0], [0, 0]], None, np.eye(2), P=[-1, 0], G=[[0, 1]],
                                nonlinearities=['sign(w1)'], D=[0, 1])
    assert told(plant) == {('y1',): STRONG, ('y2',): WEAK, ('y2', 'y1'): NONE,
                           ('y1', 'y2'): NONE}
    residual, = designed(plant, isolate=True).isolability.residuals
    assert residual.support == ('y1', 'y2') and residual.gains == (1.0, 0.0)


# --------------------------------------------------------------- ranks, another way each

@st.composite
def plants(draw, most=6):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, outputs, d = (draw(st.integers(*limits)) for limits in ((1, most), (1, 4), (0, 2)))

    def sparse(rows, columns, share):
        return rng.integers(-2, 3, (rows, columns)) * (rng.random((rows, columns)) < share)
    C = np.eye(n)[rng.integers(0, n, outputs)] if draw(st.booleans()) else sparse(outputs, n, 0.5)
    C[0, 0] = 1.0
    Cd = sparse(outputs, d, 0.3) if draw(st.booleans()) else None
    return Plant.from_matrices(sparse(n, n, 0.5), None, C, D=sparse(n, d, 0.5), Cd=Cd,
                               sample_time=draw(st.sampled_from([None, 0.1])))


def null_part(plant, rows, s):
    """Return of each row's unit fault how much of it left null vectors of P(s) see (l,)."""
    n = len(plant.A)
    P = np.block([[plant.A - s * np.eye(n), plant.D], [plant.C[rows], plant.Cd[rows]]])
    U, sigma, _ = np.linalg.svd(P)
    null = U[:, int(np.sum(sigma > 1e-9 * max(sigma.max(initial=0.0), 1.0))):]
    return np.linalg.norm(null[n:], axis=1)


@settings(max_examples=60)
@given(plants())
def test_as_null_vectors_of_the_system_matrix_in_floating_point(plant):
    """Near s = 0 (z = 1) the part of a constant fault that fades shrinks with the distance."""
    rests = 0.0 if plant.sample_time is None else 1.0
    for others in ((), *((s,) for s in plant.sensors)):
        found = checks(blind_to(plant, others))
        rows = [plant.sensors.index(s) for s in found.problem.healthy]
        at_all = null_part(plant, rows, 0.634 + 0.377j) > 1e-7
        far, near = (null_part(plant, rows, rests + step) for step in (1e-3, 1e-5))
        expected = [NONE if not any_ else STRONG if close > 0.1 * away else WEAK
                    for any_, close, away in zip(at_all, near, far)]
        assert list(found.strengths().values()) == expected
        assert system_matrix.strengths(plant.A, plant.C[rows], plant.D, plant.Cd[rows],
                                       plant.sample_time) == tuple(expected)


@settings(max_examples=25)
@given(plants())
def test_who_knows_less_tells_less(plant):
    """What others hide, more others hide; units of the sensors and states change nothing."""
    names = plant.sensors
    less = told(plant)
    for s, o in (pair for pair in less if len(pair) == 2 and less[pair[1],] != NONE):
        assert less[s,] == NONE or (less[s, o] == NONE) == (less[o, s] == NONE)
    for pair, how in told(plant, [(a, b) for i, a in enumerate(names)
                                  for b in names[i + 1:] if len(names) > 2]).items():
        assert STRENGTHS.index(how) <= min(STRENGTHS.index(less[pair[0], o]) for o in pair[1:])
    for pair, how in less.items():
        assert STRENGTHS.index(how) <= STRENGTHS.index(less[pair[:1]])
    units = 10.0 ** np.arange(-2, -2 + len(plant.A))
    other = Plant.from_matrices(
        plant.A / units[:, None] * units, None, plant.C * units * 1e3,
        D=plant.D / units[:, None], Cd=plant.Cd * 1e3, sample_time=plant.sample_time)
    assert told(other) == less


def test_computed_numbers_are_decided_in_floating_point():
    """1/3 is no decimal: there exact arithmetic says nothing."""
    plant = Plant.from_matrices(-np.eye(2) / 3, None, [[1, 0], [0, 1], [1 / 3, 1 / 7]], D=[1, 0])
    assert system_matrix.strengths(plant.A, plant.C, plant.D, plant.Cd, None) is None
    assert told(plant)['y2',] == STRONG and told(plant)['y1', 'y3'] == NONE


# --------------------------------------------------------------------- injected faults

def ends(plant, observer, own, u, rho, fault):
    """
    Return the residual at rest of constant inputs, from any start, by the plant's own equations.

    The plant (stable) and the observer stand in one matrix, stepped by its exponential.
    """
    rows = [plant.sensors.index(s) for s in observer.healthy]
    A, C0 = plant.A, plant.C[rows]
    seen = plant.Cd[rows] @ rho + plant.Cu[rows] @ u + fault[rows]
    both = np.block([[A, np.zeros((len(A), observer.order))], [observer.J @ C0, observer.N]])
    drive = np.concatenate([plant.B @ u + plant.D @ rho, observer.J @ seen + observer.B @ u])
    state = np.ones(len(both))
    if plant.sample_time is None:
        moved = expm(np.block([[both, drive[:, None]], [np.zeros((1, len(both) + 1))]]) * 50.0)
        for _ in range(40):
            state = moved[:-1, :-1] @ state + moved[:-1, -1]
    else:
        for _ in range(20000):
            state = both @ state + drive
    x, z = np.split(state, [len(A)])
    vhat = observer.Cv[0] @ z + observer.Q[0] @ (C0 @ x + seen) + observer.Qu[0] @ u
    if own is None:
        return vhat
    i = plant.sensors.index(own)
    return plant.C[i] @ x + plant.Cu[i] @ u + plant.Cd[i] @ rho + fault[i] - vhat


# stable plants of which pairs, filters, tracked ones and integrated readings are asked
def sampled(seed):
    rng = np.random.default_rng(seed)
    n, outputs, d = 2 + seed % 3, 3 + seed // 2 % 2, 1 + seed % 2
    A = rng.normal(size=(n, n))
    h = [None, 0.1][seed // 3 % 2]
    values = np.linalg.eigvals(A)
    A = (A - (values.real.max() + 0.3) * np.eye(n) if h is None
         else 0.8 * A / np.abs(values).max())
    return Plant.from_matrices(A, rng.normal(size=(n, 1)), rng.normal(size=(outputs, n)),
                               D=rng.normal(size=(n, d)), Cu=rng.normal(size=(outputs, 1)),
                               sample_time=h)


@pytest.mark.slow
@pytest.mark.usefixtures('without_alternatives')
@pytest.mark.parametrize('seed', range(8))
def test_injected_faults_end_as_the_residuals_say(seed, designed, tmp_path):
    """And all that the plant allows is told: by the file as it is read again."""
    plant = sampled(seed)
    designed(plant, isolate=True).save(tmp_path / 'design.json')
    read = Design.load(tmp_path / 'design.json')
    found, stack = read.isolability, read.isolating()
    assert told_by(found, plant) == told(plant) and found.residuals
    u, rho = np.array([0.7]), np.array([1.3, -0.4])[:len(plant.disturbances)]
    healthy = np.zeros(len(plant.sensors))
    for r in found.residuals:
        observer = stack.entries[r.fault_set, r.channel]
        own = None if r.channel in found.filters else r.channel
        if observer.grade == 'temporary':
            observer = tracker(observer)
        scale = max(map(abs, r.gains))
        assert ends(plant, observer, own, u, rho, healthy) == pytest.approx(0.0, abs=1e-6 * scale)
        for i, sensor in enumerate(plant.sensors):
            end = ends(plant, observer, own, u, rho, np.eye(len(healthy))[i])
            gain = r.gains[r.support.index(sensor)] if sensor in r.support else 0.0
            assert end == pytest.approx(gain, abs=1e-6 * scale), (r.name, sensor)


def test_a_filter_does_what_no_pair_can_and_a_bank_runs_it(bench, designed):
    """Its estimate is the residual, in its own standard deviations."""
    result = designed(DRIVE, isolate=True)
    found, stack, rate = result.isolability, result.isolating(), 100
    assert told_by(found, DRIVE) == told(DRIVE)
    without = Isolability([r for r in found.residuals if r.channel not in found.filters])
    assert without.by_residuals('angle', ['load']) == NONE
    r, = (r for r in found.residuals if r.channel in found.filters)
    assert r.fault_set == ('load',) and r.support == ('motor', 'angle', 'current')
    t = np.arange(7 * rate + 1) / rate
    u, rho = np.sin(t)[:, None], np.cos(3 * t)[:, None]
    said = dict(zip(DRIVE.sensors, readings(DRIVE, t, simulate(DRIVE, t, u, rho), u, rho).T))

    def heard(**faults):
        return bench.run(Bank(stack, rate), (r.fault_set, r.channel), rate,
                         {s: y + faults.get(s, 0.0) for s, y in said.items()},
                         {'u1': lambda at: u[int(at * rate), 0]})
    quiet = heard()
    assert np.abs(quiet[-rate:]).max() < 0.1  # the readings are held on straight lines
    assert np.array_equal(heard(load=5.0), quiet)
    for sensor, gain in zip(r.support, r.gains):
        assert heard(**{sensor: 2.0})[-1] - quiet[-1] == pytest.approx(2 * gain, abs=1e-3)
    jump = 2.0 * (t > 2.0)  # of the angle, which fades
    moved = np.abs(heard(angle=jump) - quiet)
    assert moved[2 * rate:3 * rate].max() > 5.0 and moved[-1] < 1e-3 and not gain_of(r, 'angle')


@pytest.mark.slow
def test_injected_faults_with_square_roots_and_an_unknown_flow(bench, designed):
    """Of the nonlinear discrete tank: who is not felt moves nothing, to the last bit."""
    plant = load('three_tank_discrete')
    result, steps = designed(plant, isolate=True), 200
    t = np.arange(steps + 1.0)
    u = np.tile([0.6, 0.1], (steps + 1, 1))
    rho = 0.03 * np.sin(t / 9)[:, None]
    x = simulate(plant, t, u, rho, x0=[3.0, 2.0, 1.0])
    said = dict(zip(plant.sensors, readings(plant, t, x, u, rho).T))

    def heard(r, faulty=None):
        heard = {s: y + 0.1 * (s == faulty) for s, y in said.items()}
        run = bench.run(Bank(result.isolating(), 1.0, 5.0), (r.fault_set, r.channel), 1.0, heard,
                        {'u1': lambda at: u[int(at), 0], 'u2': lambda at: u[int(at), 1]})
        return heard[r.channel] - run if r.channel in heard else run
    for r in result.isolability.residuals:
        quiet = heard(r)
        assert abs(quiet[-1]) < 1e-5
        for sensor in plant.sensors:
            loud = heard(r, sensor)
            if sensor in r.support:
                assert abs(loud[-1]) > 1e-3
            else:
                assert np.array_equal(loud, quiet, equal_nan=True)


def test_noise_is_as_designed(designed):
    """The residuals of a discrete plant, with the noise that it was designed for."""
    plant = Plant.from_matrices(
        [[0.9, 0.1], [0, 0.7]], [0, 0.3], [[1, 0], [0, 1], [1, 1]], sample_time=0.1,
        noise=[0.01, 0.02, 0.03], process_noise=[0.004, 0.006])
    result = designed(plant, isolate=True)
    found, rng, steps = result.isolability, np.random.default_rng(1), 12000
    x = np.zeros(2)
    y = np.empty((steps, 3))
    for k in range(steps):
        y[k] = plant.C @ x + plant.noise * rng.normal(size=3)
        x = plant.A @ x + plant.process_noise * rng.normal(size=2)
    for r in found.residuals:
        observer = result.isolating().entries[r.fault_set, r.channel]
        y0 = y[:, [plant.sensors.index(s) for s in observer.healthy]]
        z, said = np.zeros(observer.order), np.empty(steps)
        for k in range(steps):
            vhat = observer.Cv[0] @ z + observer.Q[0] @ y0[k]
            own = 0.0 if r.channel in found.filters else y[k, plant.sensors.index(r.channel)]
            said[k] = vhat if r.channel in found.filters else own - vhat
            z = observer.N @ z + observer.J @ y0[k]
        assert said[100:].std() == pytest.approx(r.noise, rel=0.06)
        assert r.noise < r.threshold < 6 * r.noise and not r.assumed


# ------------------------------------------------------------------- one more sensor

def test_which_sensor_would_make_what_isolable():
    angle, = [p for p in locations(load('servo'), isolate=True) if p.isolable]
    assert angle.name == 'angle'
    assert set(angle.isolable) == {((), 'y1'), (('y2',), 'y1'), (('y3',), 'y1')}
    for place in locations(load('tclab'), isolate=True):
        assert set(place.isolable) == {(('T1',), 'T2'), (('T2',), 'T1')}
    assert all(not p.isolable for p in locations(load('servo')))


@settings(max_examples=12)
@given(plants(most=4))
def test_as_decided_with_the_sensor_really_added(plant):
    now = told(plant)
    for place in locations(plant, isolate=True):
        wider = Plant.from_matrices(
            plant.A, None, np.vstack([plant.C, place.row]), D=plant.D,
            sensors=(*plant.sensors, 'new'), sample_time=plant.sample_time,
            Cd=np.vstack([plant.Cd, np.zeros(plant.Cd.shape[1])]))
        then = told(wider, [(), *((s,) for s in plant.sensors)])
        assert set(place.isolable) == {
            (tuple(pair[1:]), pair[0]) for pair, how in now.items()
            if STRENGTHS.index(then[tuple(pair)]) > STRENGTHS.index(how)}
