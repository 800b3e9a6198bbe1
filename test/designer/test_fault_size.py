"""Which methods tell how large a fault is, and by which condition there is none."""

from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.fault_size import fault_size, sized
from vsensor_ros.observers.fault_size import METHODS, SLIDING, TWISTING, VIRTUAL, WALK

CONFIG = Path(__file__).parents[2] / 'config'
A3 = [[-1.0, 1.0, 0.0], [1.0, -2.0, 1.0], [0.0, 1.0, -2.0]]
C3 = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def plant(A, B, C, **more):
    return Plant.from_matrices(A, B, C, noise=np.full(len(C), 0.01), **more)


def size_of(made, name, **more):
    return fault_size(made, design(made), name, **more)


def test_the_papers_observer_of_the_tank_meets_its_conditions():
    tank = plant(A3, [1.0, 0.0, 0.0], C3)
    size = size_of(tank, 'y1', method=SLIDING)
    z, of = size.observer, size.injection
    Phi = z.Phi
    assert z.order == 1 and np.allclose(Phi[0] / Phi[0, 2], [0.0, 0.0, 1.0])
    assert np.allclose(Phi @ tank.A, z.N @ Phi + z.J @ tank.C)  # (E1) with all of C
    assert np.allclose(z.Q @ tank.C + z.Cv @ Phi, 0.0)  # R C = C_* Phi
    assert z.Q[0, 0] == 0.0 and z.J[0, 0] != 0.0  # R Df = 0, J Df not
    # the residual by the observer's own equation: d e = N e - J Df d, less output C_* e
    gain = -z.Cv[0] @ (-z.J[:, 0])
    assert gain == pytest.approx(of.c @ of.f) == pytest.approx(1.0)


@pytest.mark.parametrize('response', [0.1, 0.4])
def test_methods_are_weighed_at_the_same_response(response):
    tank = plant(A3, [1.0, 0.0, 0.0], C3, D=[1.0, 0.0, 0.0])
    made = design(tank)
    sizes = [s for m in METHODS
             if not isinstance(s := fault_size(tank, made, 'y1', response, m), str)]
    assert [s.method for s in sizes] == [WALK, SLIDING, TWISTING]
    assert {s.response for s in sizes} == {response}
    chosen = fault_size(tank, made, 'y1', response)
    assert chosen.noise == min(s.noise for s in sizes)
    assert {chosen.method: chosen.noise, **chosen.others} == {s.method: s.noise for s in sizes}
    assert 'unknown input rho1' in chosen.why_not[VIRTUAL]
    # of the first order it is a filtered difference: its noise is known in closed form
    h, sigma, p = 0.01, 0.01, np.exp(-0.01 / response)
    difference = np.sqrt(2.0) * sigma / h * (1.0 - p) / np.sqrt(1.0 + p)
    assert fault_size(tank, made, 'y1', response, SLIDING).noise == pytest.approx(
        difference, rel=0.05)


def test_where_there_is_an_exact_virtual_sensor_it_is_taken():
    size = size_of(plant(A3, [1.0, 0.0, 0.0], C3), 'y1')
    assert size.method == VIRTUAL and size.reads == ('y1', 'y2') and not size.why_not


BREAKS = {  # what stands in the way of a sliding mode, and of nothing else
    'disturbed': (plant(A3, [1.0, 0.0, 0.0], C3, D=[1.0, 0.0, 0.0]), 'y2',
                  'nothing is checked that rho1 does not disturb'),
    'reads it directly': (plant([[-1.0]], [1.0], [[1.0], [1.0]]), 'y1',
                          'every residual feels y1 directly'),
    'not in the derivative': (plant([[0.0, 1.0], [-1.0, -1.0]], [0.0, 1.0], [[1.0, 0.0]]), 'u1',
                              'the fault of u1 is not in the derivative of any residual'),
    'unstable zero': (plant([[-1.0, 1.0], [0.0, -1.0]], [1.0, -3.0], [[1.0, 0.0]]), 'u1',
                      'does not die out (zero at 2 1/s)'),
    'reads commands alone': (plant([[-1.0]], [1.0], [[1.0], [0.0]], Cu=[[0.0], [1.0]]), 'y2',
                             'every residual feels y2 directly'),
    'reads nothing': (plant([[-1.0]], [1.0], [[1.0], [0.0]]), 'y2',
                      'every residual feels y2 directly'),
    'sampled': (plant([[0.9]], [1.0], [[1.0]], sample_time=0.1), 'u1',
                'a sliding mode is of continuous time'),
}


@pytest.mark.parametrize('name', BREAKS)
def test_each_condition_of_a_sliding_mode_is_refused_by_its_sentence(name):
    made, faulty, needle = BREAKS[name]
    size = size_of(made, faulty)
    assert size.method in (VIRTUAL, WALK)
    assert needle in size.why_not[SLIDING] and size.why_not[TWISTING] == size.why_not[SLIDING]
    assert size_of(made, faulty, method=SLIDING) == size.why_not[SLIDING]


def test_the_same_plants_without_that_flaw_have_one():
    for made, faulty in ((plant(A3, [1.0, 0.0, 0.0], C3), 'y1'),
                         (plant([[0.0]], [1.0], [[1.0]]), 'u1'),  # nothing has a rate there
                         (plant([[0.0, 1.0], [-1.0, -1.0]], [1.0, 1.0], [[1.0, 0.0]]), 'u1'),
                         (plant([[-1.0, 1.0], [0.0, -1.0]], [1.0, 3.0], [[1.0, 0.0]]), 'u1'),
                         (plant([[0.0]], [1.0], [[1.0], [1.0]]), 'u1')):  # nothing moves by itself
        assert not isinstance(size_of(made, faulty, method=SLIDING), str)


@pytest.mark.parametrize('made, faulty, sentence', [
    (plant([[0.0, 1.0], [0.0, -1.0]], [0.0, 1.0], [[1.0, 0.0], [0.0, 1.0]]), 'y1',
     'a constant fault of it fades from all that the sensors say: only its onset shows'),
    (plant([[-1.0]], [1.0], [[1.0]], D=[1.0]), 'u1',
     'nothing that the sensors say feels a fault of it, rho1 set aside'),
    (plant([[0.0]], [1.0], [[1.0]]), 'y1', 'a constant fault of it fades')])
def test_what_nothing_tells_is_refused(made, faulty, sentence):
    assert size_of(made, faulty).startswith(sentence)


def test_what_unknown_inputs_disturb_is_taken_only_where_there_is_nothing_else():
    made = plant([[-2.0]], [1.0], [[1.0]], D=[1.0])
    assert isinstance(size_of(made, 'y1'), str)
    size = fault_size(made, design(made, bounded=True), 'y1')
    assert size.method == VIRTUAL and size.disturbed == pytest.approx(0.5)
    tank = plant(A3, [1.0, 0.0, 0.0], C3, D=[1.0, 0.0, 0.0])
    size = fault_size(tank, design(tank, bounded=True), 'y1')
    assert size.method in (WALK, TWISTING) and not size.disturbed


def test_a_design_that_isolates_carries_sizes(tmp_path):
    servo = load_plant(CONFIG / 'servo/plant.yaml')
    made = sized(servo, design(servo))
    sizes = made.fault_sizes
    assert [s.name for s in sizes.found] == ['y2', 'y3', 'voltage']
    assert list(sizes.refused) == ['y1']
    made.save(tmp_path / 'servo.json')
    again = Design.load(tmp_path / 'servo.json')
    again.save(tmp_path / 'again.json')
    assert (tmp_path / 'servo.json').read_text() == (tmp_path / 'again.json').read_text()
    assert set(again.isolating().entries) == {(('y2',), 'y2'), (('y3',), 'y3'),
                                              ((), 'fault of voltage')}


@pytest.mark.parametrize('wrong', [{'name': 'y9'}, {'method': 'magic'}, {'response': 0.0},
                                   {'response': True}])
def test_what_is_no_name_method_or_time_is_refused(wrong):
    made = plant([[-1.0]], [1.0], [[1.0]])
    with pytest.raises(BadInput) as caught:
        fault_size(made, design(made), **{'name': 'y1', **wrong})
    assert next(iter(wrong)) in str(caught.value)
