"""Virtual sensors and designs as they are in memory."""

import numpy as np
import pytest

from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.observers import (
    Certificate,
    Design,
    Limit,
    Noise,
    Proof,
    Refusal,
    VirtualSensor,
)
from vsensor_ros.observers.kinds.functional import argument_name

TERMS = (NonlinearTerm('sin(x1)', 'sin(w1)', np.zeros(1)),
         NonlinearTerm('x1*u2', 'w1*w2*u2', np.zeros(2)))


def sensor(channel='y1', fault_set=('y1',), healthy=('y2', 'y3', 'y4'), rows=1, **more):
    """Make one of order 1 that reads y2 through J; of its two terms none is active."""
    l0 = len(healthy)
    J = np.array([[1.0] + [0.0] * (l0 - 1)])
    return VirtualSensor(**{**{
        'channel': channel, 'fault_set': fault_set, 'healthy': healthy, 'inputs': ('u1', 'u2'),
        'Phi': np.ones((1, 1)), 'N': -np.ones((1, 1)), 'J': J, 'B': np.zeros((1, 2)),
        'P': np.zeros((1, 2)), 'Cv': np.ones((rows, 1)), 'Q': np.zeros((rows, l0)),
        'Gz': (np.zeros((1, 1)), np.zeros((2, 1))), 'Gy': (np.zeros((1, l0)), np.zeros((2, l0))),
        'terms': TERMS, 'sample_time': None, 'z0': np.zeros(1), 'z0_gain': np.zeros((1, l0)),
        'eigenvalues': np.array([-1.0 + 0.0j]), 'noise_gain': 1.0, 'method': 'by hand'}, **more})


ENTRIES = (sensor(), Refusal('y2', ('y2',), 'no'), sensor('v', (), ('y1', 'y2', 'y3', 'y4')),
           sensor('v', ('y1',)))
DESIGN = Design('t', '0', ('x1',), ('u1', 'u2'), ('y1', 'y2', 'y3', 'y4'), {}, None,
                {(e.fault_set, e.channel): e for e in ENTRIES}, ('v',))
PLAIN = Design('t', '0', ('x1',), ('u1', 'u2'), ('y1', 'y2', 'y3'), {}, None,
               {(('y1',), 'y1'): ENTRIES[0]})


def test_what_is_left_out_is_zero_and_unknown():
    v = sensor(rows=3)
    assert v.Qu.shape == (3, 2) and not v.Qu.any()
    assert [g.shape for g in v.Gu] == [(1, 2), (2, 2)] and not any(g.any() for g in v.Gu)
    assert (v.grade, v.disturbance_gain) == ('exact', 0.0)
    assert (v.proof, v.ladder, v.noise, v.certificate) == (None, (), None, None)
    assert ENTRIES[1].doubts == () and ENTRIES[1].alternative == '' and PLAIN.wanted == ()


def test_every_array_is_read_only():
    v = sensor(Qu=np.ones((1, 2)), Gu=(np.ones((1, 2)), np.ones((2, 2))))
    c = Certificate('none', 0.0, np.inf, np.ones((1, 1)), (), None, '')
    for array in (v.N, v.Qu, sensor().Qu, *v.Gu, *sensor().Gu, *v.Gz, c.S):
        with pytest.raises(ValueError, match='read-only'):
            array[:] = 2.0


def test_it_reads_what_any_of_its_equations_reads():
    nothing, y4 = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    assert sensor().reads == ('y2',)
    assert sensor(J=nothing).reads == ()
    assert sensor(J=nothing, rows=2, Q=np.vstack([nothing, y4])).reads == ('y4',)
    Gy = (y4, np.zeros((2, 3)))
    assert sensor(Gy=Gy).reads == ('y2',)  # the term is not active
    assert sensor(Gy=Gy, P=np.array([[1.0, 0.0]])).reads == ('y2', 'y4')


@pytest.mark.parametrize(('name', 'text', 'called'), [
    ('sqrt(level1 - level2)', 'sqrt(w1)', ['level1 - level2']),
    ('2*(x1 + x2)*u1 - sin(-0.5*x3)', '2*w1*u1 - sin(w2)', ['x1 + x2', '-0.5*x3']),
    ('x2 - x3 - sqrt(x2 - x3)', 'w1 - sqrt(w1)', ['x2 - x3']),
    ('the leak', 'sqrt(w1)', ['w1 of the leak']),
    ('cos(x)', 'sin(w1)', ['w1 of cos(x)']),
    ('w1*w2', 'w1*w2', ['w1 of w1*w2', 'w2 of w1*w2']),
    ('__import__("os")', 'sin(w1)', ['w1 of __import__("os")']),
])
def test_arguments_have_the_names_of_the_plant(name, text, called):
    term = NonlinearTerm(name, text, np.zeros(len(called)))
    assert [argument_name(term, i) for i in range(len(called))] == called


def test_its_region_is_named():
    certificate = Certificate('region', 1.0, 1.0, np.eye(1), (
        Limit(0, 0, -1.0, 1.0), Limit(1, 1, 0.0, np.inf), Limit(None, 1, 2.0, 3.0)), None, '')
    v = sensor(certificate=certificate, terms=(
        TERMS[0], NonlinearTerm('x1*(x1 - x2)*u2', 'w1*w2*u2', np.zeros(2))))
    assert v.region == (('x1', -1.0, 1.0), ('x1 - x2', 0.0, np.inf), ('u2', 2.0, 3.0))
    assert sensor().region == ()


@pytest.mark.parametrize(('N', 'sample_time', 'decay'), [
    ([[-1.0, 5.0], [0.0, -3.0]], None, 1.0), ([[0.25]], 2.0, np.log(4) / 2), ([[0.0]], 1.0, 27.63),
    (np.zeros((0, 0)), None, np.inf)])
def test_decay_is_that_of_the_slowest_mode(N, sample_time, decay):
    N = np.array(N)
    v = sensor(N=N, eigenvalues=np.linalg.eigvals(N).astype(complex), sample_time=sample_time)
    assert v.decay == pytest.approx(decay, rel=1e-3)
    assert (v.kind, v.outputs) == ('functional', ('y1',))


@pytest.mark.parametrize(('error', 'floor', 'ratio'), [
    (3.0, 2.0, 1.5), (0.0, 2.0, 0.0), (0.0, 0.0, 1.0), (1e-300, 0.0, np.inf), (3.0, np.inf, 0.0)])
def test_noise_beside_its_floor(error, floor, ratio):
    assert Noise(error, floor, False).ratio == ratio


def test_a_least_order_is_one_whose_bounds_meet():
    assert Proof(2, 2, (), ()).least
    assert not Proof(1, 2, (), ()).least


def test_entries_are_found_by_fault_set_and_channel():
    assert DESIGN['y1', 'y1'] is DESIGN[('y1',), 'y1'] is ENTRIES[0]
    assert DESIGN[['y2'], 'y2'] is ENTRIES[1]
    assert DESIGN[(), 'v'] is ENTRIES[2]
    assert DESIGN[('y1',), 'v'] is DESIGN[{'y1'}, 'v'] is ENTRIES[3]
    assert DESIGN.fault_sets == (('y1',), ('y2',), ())
    assert DESIGN.virtual_sensors == (ENTRIES[0], *ENTRIES[2:]) and DESIGN.refusals == ENTRIES[1:2]


@pytest.mark.parametrize(('key', 'needle'), [
    (((), 'y1'), 'channel y1 of fault set {}: has not failed there; name it in the fault set'),
    ((('y2',), 'y1'), 'channel y1 of fault set {y2}: has not failed there'),
    ((('y2', 'y1'), 'y1'), 'channel y1 of fault set {y1, y2} was not designed; the fault sets are '
                           '{y1}, {y2}, {}'),
    ((('y2',), 'v'), 'channel v of fault set {y2} was not designed'),
    (((), 'w'), 'w: no such sensor; there are y1, y2, y3, y4 and, wanted, v'),
    ((('v',), 'v'), 'v: no such sensor'),
])
def test_what_was_not_designed_says_so(key, needle):
    with pytest.raises(KeyError) as caught:
        DESIGN[key]
    assert needle in str(caught.value)


@pytest.mark.parametrize('key', ['y1', ('y1',), (), ('y1', 'y1', 'y1'), 5, (5, 'y1'),
                                 (('y1',), []), (([],), 'y1')])
def test_a_wrong_key_says_how_to_index(key):
    with pytest.raises(KeyError, match='is not a fault set and a channel'):
        PLAIN[key]


def test_a_key_with_unknown_names_says_which():
    for key in (('y9', 'y1'), (('y1', 9), 'y1')):
        with pytest.raises(KeyError, match='9: no such sensor; there are y1, y2, y3'):
            PLAIN[key]
