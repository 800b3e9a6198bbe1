"""The study's systems: the functions found, what is known of their error, and runs of them."""

from functools import cache
import math

import numpy as np
import pytest

from vsensor_ros.designer.algebra import find, Verdict
from vsensor_ros.designer.algebra.answer import CERTIFIED
from vsensor_ros.designer.algebra.operators import element, Space
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse

from . import systems
from .systems import CASES


@cache
def answer(name):
    return find(CASES[name].system)


def generic_rank(space, texts):
    """Return the rank of the gradients at points, as one tuple."""
    at = space.points(5, 4)
    slopes = Equations(element(space, *texts), tuple(space.states)).slopes(at)[1]
    scaled = np.moveaxis(slopes, 2, 0)
    scaled = scaled / np.maximum(np.linalg.norm(scaled, axis=2, keepdims=True), 1e-300)
    return tuple(np.linalg.matrix_rank(scaled, tol=1e-8))


@pytest.mark.parametrize('name', CASES)
def test_finds_what_the_study_found_beside_the_healthy_sensors(name):
    case, found = CASES[name], answer(name)
    assert found.verdict is Verdict.YES, found.reason
    space = Space(case.system.states)
    sensors = tuple(case.system.sensors.values())
    own = generic_rank(space, found.observer.phi + sensors)
    assert own == generic_rank(space, case.phi + sensors)
    assert own == generic_rank(space, found.observer.phi + case.phi + sensors)
    assert found.observer.grade == case.grade
    assert len(found.observer.names) == len(found.observer.F) == len(found.observer.ranges)


@pytest.mark.parametrize('name', CASES)
def test_right_hand_side_and_output_map_hold_at_any_unknown_input(name):
    case, o = CASES[name], answer(name).observer
    s = case.system
    names = [*s.states, *s.inputs, *s.unknown]
    random = np.random.default_rng(1)
    ranges = np.array([*s.states.values(), *s.inputs.values(), *s.unknown.values()], dtype=float)
    at = ranges[:, 0] + (ranges[:, 1] - ranges[:, 0]) * random.random((40, len(names)))
    at = at.T
    n = len(s.states)
    at[n + len(s.inputs):] *= 30.0 if s.sample_time is None else 1.0  # far beyond what is declared
    x, u = at[:n], at[n:n + len(s.inputs)]
    f = Equations([parse(t) for t in s.f.values()], names).values(at)
    phi = Equations([parse(t) for t in o.phi], list(s.states))
    z, slopes = phi.slopes(x)
    change = phi.values(f) if s.sample_time else np.einsum('knN,nN->kN', slopes, f)
    size = np.abs(phi.values(f)) if s.sample_time else np.einsum(
        'knN,nN->kN', np.abs(slopes), np.abs(f))
    y = Equations([parse(t) for t in s.sensors.values()], list(s.states)).values(x)
    known = [*o.names, *s.sensors, *s.inputs]
    here = np.concatenate([z, y, u])
    told = Equations([parse(t) for t in o.F], known).values(here)
    assert (np.abs(told - change) <= 1e-9 * (size + np.abs(z) + 1.0)).all()
    wanted = Equations([parse(t) for t in s.wanted.values()], list(s.states)).values(x)
    out = Equations([parse(t) for t in o.out.values()], known).values(here)
    assert np.allclose(out, wanted, rtol=1e-7, atol=1e-7)
    if o.residuals:
        zero = Equations([parse(t) for t in o.residuals], known).values(here)
        assert np.abs(zero).max() < 1e-9 * (1.0 + np.abs(here).max()) ** 2
    holds = Equations([parse(c.positive) for c in o.validity], known).values(here)
    assert (holds > 0.0).all()


@pytest.mark.parametrize('name', [name for name, case in CASES.items() if case.off])
def test_error_dies_out_under_a_huge_unknown_input(name):
    case = CASES[name]
    truth, estimate = systems.played(case, answer(name).observer)
    late = truth.shape[1] // 2
    rmse = math.sqrt(np.mean((truth - estimate)[:, late:] ** 2))
    assert rmse <= max(2.0 * case.rmse, 2e-4 * np.abs(truth).max())
    assert np.abs(truth - estimate)[:, 0].max() > 20.0 * rmse
    assert np.ptp(truth[:, late:]) > 20.0 * rmse


@pytest.mark.parametrize('name', [name for name, case in CASES.items() if not case.off])
def test_a_temporary_one_goes_on_from_a_tracked_start(name):
    case = CASES[name]
    case = case.__class__(**{**vars(case), 'time': 3.0, 'step': 5e-3})
    truth, estimate = systems.played(case, answer(name).observer)
    assert math.sqrt(np.mean((truth - estimate) ** 2)) < 2.0 * case.rmse
    assert np.ptp(truth) > 0.1


def test_negative_answers():
    assert find(systems.YAW_UNKNOWN).verdict is Verdict.NO
    assert find(systems.YAW_UNKNOWN).reason.fact('dimension') == 3
    assert find(systems.HEISENBERG).verdict is Verdict.NO
    assert find(systems.NOT_INVOLUTIVE).verdict is Verdict.NO
    assert find(systems.NOT_INVOLUTIVE).reason.fact('dimension') == 4
    bogus = find(systems.NOT_SUBMERSIVE)
    assert (bogus.verdict, bogus.reason.code) == (Verdict.NOT_DECIDED, 'functions not submersive')


def test_a_function_whose_error_grows_is_refused_with_its_rate():
    found = find(systems.motor('w', 'i'))
    assert found.verdict is Verdict.YES and found.observer is None
    assert found.gamma == ('w**2 + 5*i**2',)
    assert found.reason.code == 'functions not stable' and found.reason.fact('growth') > 10.0


def feed(sensors, wanted):
    """Return a reactor that is fed at an unknown rate."""
    return systems.system(
        {'s': (0.2, 4.0), 'X': (0.3, 3.0), 'V': (1.0, 5.0)},
        ['F*(5 - s)/V - 0.8*s/(0.6 + s)*X', '-F*X/V + 0.4*s/(0.6 + s)*X', 'F'],
        {f'{name}_read': name for name in sensors}, {wanted: wanted}, unknown={'F': (-1.0, 1.0)})


def test_one_that_converges_goes_before_one_that_serves_for_a_time():
    """Of X*V the error grows and of 1/(X*V) it stays; of (5 - s)/X it dies out."""
    found = find(feed('sV', 'X')).observer
    assert found.phi == ('(5 - s)/X',) and found.grade == CERTIFIED


def test_that_the_error_of_the_reciprocal_stays_is_no_answer_where_the_own_one_grows():
    """X*V and 1/(X*V) are of different dictionaries."""
    found = find(feed('sX', 'V'))
    assert found.observer is None and found.gamma == ('X*V',)
    assert found.reason.code == 'functions not stable'


def test_one_whose_error_dies_out_goes_before_a_simpler_one_whose_error_may_stay():
    """Where nothing flows in, nothing draws T to where it is; V*T there is."""
    tank = systems.system(
        systems.TANK, ['inflow - 0.5*sqrt(V)', 'inflow*(15 - T)/V + P/V'], {'level': 'V'},
        {'T': 'T'}, {'P': (0, 10), 'inflow': (0, 2)})
    found = find(tank).observer
    assert found.phi == ('V*T',) and found.grade == CERTIFIED
    assert found.rate == pytest.approx(0.5 / math.sqrt(3.0), rel=0.01)


def test_two_values_within_the_ranges_are_not_decided():
    found = find(systems.motor('i', 'w', (-100.0, 100.0)))
    assert found.verdict is Verdict.NOT_DECIDED and found.observer is None
    assert found.reason.code == 'functions many-valued'


def test_what_a_dictionary_does_not_hold_is_not_decided():
    only = tuple((degree, False, False) for degree in (1, 2, 3, 4))
    assert find(systems.CHEMOSTAT, only).verdict is Verdict.NOT_DECIDED
    assert find(systems.CHEMOSTAT).verdict is Verdict.YES


def test_a_plant_stepped_by_euler_passes_no_rank_test_by_rounding():
    found = find(systems.MOTOR_BY_EULER)
    assert found.verdict is Verdict.NOT_DECIDED
    assert found.reason.code == 'functions none found'


def test_names_of_z_keep_clear_of_the_plant():
    own = systems.system({'z1': (0.5, 3.0), 'T': (20.0, 60.0)},
                         ['rho - 0.5*sqrt(z1)', 'rho*(15 - T)/z1 + P/z1'], {'y': 'z1'},
                         {'T': 'T'}, {'P': (0, 10)}, {'rho': (0, 2)})
    found = find(own)
    assert found.observer.names == ('zz1',) and found.observer.phi == ('z1*(T - 15)',)
