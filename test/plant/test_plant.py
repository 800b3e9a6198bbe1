"""Plants made of arrays."""

import re

import numpy as np
import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.plant import Plant

A = [[-1.0, 1.0, 0.0], [1.0, -2.0, 1.0], [0.0, 1.0, -2.0]]
B = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]
C = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
P = [[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]]
G = [[1.0, -1.0, 0.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]]


def tank(**more):
    return Plant.from_matrices(A, B, C, **{
        'P': P, 'G': G, 'nonlinearities': ['w1 - sqrt(w1)'] * 3, **more})


def test_default_names():
    plant = Plant.from_matrices(A, B, C, D=[1, 0, 0])
    assert plant.states == ('x1', 'x2', 'x3')
    assert plant.inputs == ('u1', 'u2')
    assert plant.sensors == ('y1', 'y2')
    assert plant.disturbances == ('rho1',)
    assert plant.sample_time is None
    assert plant.terms == () and plant.P.shape == (3, 0)
    assert plant.Cu.shape == (2, 2) and plant.Cd.shape == (2, 1)
    assert not plant.Cu.any() and not plant.Cd.any() and np.isnan(plant.process_noise).all()
    assert plant.ranges.tolist() == [[-np.inf, np.inf]] * 3
    assert np.isnan(plant.noise).all() and not plant.initial.any()
    assert plant.units == dict.fromkeys(('x1', 'x2', 'x3', 'u1', 'u2', 'y1', 'y2', 'rho1'), '')


def test_a_is_taken_as_it_stands():
    plant = tank()
    assert np.array_equal(plant.A, A)
    assert [t.slope.tolist() for t in plant.terms] == [[0.0]] * 3
    assert plant.terms[0].name == 'x1 - x2 - sqrt(x1 - x2)'


def test_rate_of_change_of_the_papers_tank():
    # equation (17) of the replacement paper, in its own matrices
    x, u = np.array([5.0, 3.0, 1.0]), np.array([0.5, 0.2])
    expected = [0.5 - 2 ** 0.5, 0.2 + 2 ** 0.5 - 2 ** 0.5, 2 ** 0.5 - 1.0]
    assert np.allclose(tank().rate_of_change(x, u), expected, atol=1e-14)
    many = np.stack([x, 2 * x, 3 * x], axis=1)
    rates = tank().rate_of_change(many, u)
    each = [tank().rate_of_change(column, u) for column in many.T]
    assert np.allclose(rates.T, each, atol=1e-14)


def test_rate_of_change_with_a_disturbance_and_terms_without_arguments():
    plant = Plant.from_matrices([[0.0]], None, [[1.0]], D=[[2.0]], P=[[3.0]], G=[[]],
                                nonlinearities=['1'])
    assert plant.inputs == () and plant.terms[0].name == 'constant'
    assert plant.rate_of_change([5.0], None) == [3.0]
    assert plant.rate_of_change([5.0], [], [0.5]) == [4.0]
    assert plant.rate_of_change(np.zeros((1, 4)), None, [0.5]).tolist() == [[4.0] * 4]


def test_flat_columns_and_rows():
    plant = Plant.from_matrices(A, [1, 0, 0], [0, 1, 0], D=[1, 0, 0], P=[0, 1, 0], G=[0, 1, 0],
                                nonlinearities=['sign(w1)'])
    assert plant.B.shape == plant.D.shape == plant.P.shape == (3, 1)
    assert plant.C.shape == plant.G[0].shape == (1, 3)
    assert plant.terms[0].name == 'sign(x2)'


def test_what_sensors_read_directly_may_be_flat():
    # an accelerometer: one row over the inputs, one column over the sensors
    one = Plant.from_matrices(A, B, [0, 1, 0], D=[1, 0, 0], Cu=[3, 4], Cd=[5])
    assert one.Cu.tolist() == [[3, 4]] and one.Cd.tolist() == [[5]]
    two = Plant.from_matrices(A, [1, 0, 0], C, D=[1, 0, 0], Cu=[3, 4], Cd=[[5], [6]])
    assert two.Cu.tolist() == [[3], [4]] and two.Cd.tolist() == [[5], [6]]
    none = Plant.from_matrices(A, None, C, Cu=np.zeros((2, 0)))
    assert none.Cu.shape == (2, 0) == none.Cd.shape


def test_noise_and_ranges_of_the_states():
    plant = tank(process_noise=[0.1, np.nan, 0.0], ranges=[[0, 10], [-np.inf, 3], [1, np.inf]])
    assert plant.process_noise[0] == 0.1 and np.isnan(plant.process_noise[1])
    assert plant.ranges.tolist() == [[0, 10], [-np.inf, 3], [1, np.inf]]


def test_readings_lie_where_ranges_of_inputs_and_unknown_inputs_put_them():
    plant = tank(D=[1, 0, 0], Cu=[[2, 0], [0, 0]], Cd=[0, -1], ranges=[[0, 5]] * 3,
                 input_range=[[-1, 3], [0, np.inf]], disturbance_range=[[0, 4]])
    assert plant.reading_ranges() == {'y1': (-2.0, 11.0), 'y2': (-4.0, 5.0)}
    assert tank(Cu=[[2, 0], [0, 0]], ranges=[[0, 5]] * 3).reading_ranges() == {'y2': (0.0, 5.0)}


def test_sensors_of_one_angle_whatever_their_units():
    C = [[180.0 / np.pi, 0.0], [-1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 0.0]]
    plant = Plant.from_matrices(np.zeros((2, 2)), None, C,
                                wrap=[360.0, 2 * np.pi, 2 * np.pi, np.nan, 2 * np.pi])
    assert plant.angles() == (
        {'y1': 360.0, 'y2': -2 * np.pi},  # which runs the other way
        {'y3': 2 * np.pi},
        {'y5': 2 * np.pi})  # it turns twice as often


def test_arrays_are_copied_and_frozen():
    a = np.array(A)
    plant = Plant.from_matrices(a, B, C)
    a[0, 0] = 9.0
    assert plant.A[0, 0] == -1.0
    for array in (plant.A, plant.Cu, plant.Cd, plant.process_noise, plant.ranges,
                  tank(Cu=np.ones((2, 2))).Cu, tank().terms[0].slope):
        with pytest.raises(ValueError, match='read-only'):
            array[:] = 9.0


def test_hash_depends_on_what_a_design_depends_on():
    first = tank().hash()
    assert re.fullmatch('[0-9a-f]{64}', first)
    assert tank().hash() == first
    assert tank(units={'x1': 'm'}).hash() == first
    changed = [
        tank(sample_time=1.0), tank(states=('a', 'b', 'c')), tank(sensors=('p', 'q')),
        tank(nonlinearities=['w1 - sqrt(w1)'] * 2 + ['w1']), tank(initial=[1, 0, 0]),
        tank(P=np.array(P) * (1 + 1e-15)), tank(G=-np.array(G)), tank(D=[1, 0, 0]),
        tank(Cu=[[0, 0], [0, 1]]), tank(Cu=[[0, 1], [0, 0]]), tank(D=[1, 0, 0], Cd=[0, 1]),
        tank(wrap=[1, 2]), tank(noise=[1, 2]),
        tank(input_range=[[0, 1]] * 2),
        tank(process_noise=[1, 2, 3]), tank(ranges=[[0, 1]] * 3),
        tank(nonlinearities=[NonlinearTerm('', 'w1 - sqrt(w1)', np.ones(1))] * 3)]
    assert len({first, *(plant.hash() for plant in changed)}) == 1 + len(changed)


@pytest.mark.parametrize(('change', 'needle'), [
    ({'A': [[1.0, 2.0]]}, 'A: has shape (1, 2)'),
    ({'A': []}, 'A: '),
    ({'A': [[1.0, 2.0], [3.0]]}, 'A: [[1.0, 2.0], [3.0]] is not a matrix'),
    ({'A': 'text'}, "A: 'text' is not a matrix"),
    ({'A': np.full((3, 3), np.nan)}, 'A: holds NaN or infinity'),
    ({'A': np.eye(3) * 1j}, 'is not a matrix of real numbers'),
    ({'A': np.full((3, 3), '1')}, 'is not a matrix of real numbers'),
    ({'A': np.full((3, 3), '2020-01-01', 'datetime64[D]')}, 'is not a matrix of real numbers'),
    ({'A': np.diag([1e76, 1, 1])}, 'A: holds a number beyond 1e+75; choose other units'),
    ({'B': [10**400, 0, 0]}, 'B: '),
    ({'A': 2.0}, 'A: has 0 dimensions'),
    ({'B': [[1.0], [2.0]]}, 'B: has shape (2, 1)'),
    ({'B': [[1.0], [np.inf], [2.0]]}, 'B: holds NaN or infinity'),
    ({'B': [[1.0], [2.0, 3.0], []]}, 'B: '),
    ({'C': [[1.0, 0.0]]}, 'C: has shape (1, 2)'),
    ({'C': np.zeros((0, 3))}, 'C: has shape (0, 3)'),
    ({'D': [1.0, 0.0]}, 'D: has shape (2, 1)'),
    ({'P': None}, 'nonlinearities: 3 nonlinearities, 3 of G and 0 columns of P'),
    ({'G': G[:2]}, '3 nonlinearities, 2 of G'),
    ({'G': 5}, 'G: 5 is not a list'),
    ({'G': [G[0], G[1], [[1.0], [2.0, 3.0]]]}, 'G[2]: '),
    ({'G': [G[0], G[1], None]}, 'G[2]: holds NaN'),
    ({'nonlinearities': 5}, 'nonlinearities: 5 is not a list'),
    ({'nonlinearities': [None] * 3}, 'nonlinearities[0]: None is not an expression'),
    ({'nonlinearities': [NonlinearTerm('a\nb', 'w1', np.zeros(1))] * 3},
     "nonlinearities[0]: 'a\\nb' is not a text of one line"),
    ({'nonlinearities': [NonlinearTerm('', 'w1', np.zeros(2))] * 3},
     'nonlinearities[0].slope: array([0., 0.]) does not fit'),
    ({'nonlinearities': [NonlinearTerm('', 'w1', np.full(1, np.nan))] * 3},
     'nonlinearities[0].slope: holds NaN'),
    ({'nonlinearities': ['w1', 'w1', 'w2']}, "nonlinearities[2]: unknown name 'w2'"),
    ({'nonlinearities': ['w1', "__import__('os')", 'w1']}, 'nonlinearities[1]: the function'),
    ({'G': [[1.0, 0.0], G[1], G[2]]}, 'G[0]: has shape (1, 2)'),
    ({'states': ('a', 'b')}, 'states: 2 names for 3'),
    ({'states': 5}, 'states: 5 is not a list'),
    ({'states': ('a', 'b', 'a')}, 'states: a is named twice'),
    ({'states': ('a', 'b', '1c')}, "states: '1c' is not a name"),
    ({'states': ('a', 'b', 'c\n')}, 'is not a name'),
    ({'states': ('a', 'b', 3)}, 'states: 3 is not a name'),
    ({'states': ('a', 'b', 'lambda')}, 'states: lambda is a word of the expression language'),
    ({'inputs': ('sin', 'v')}, 'inputs: sin is a word'),
    ({'inputs': ('u1', 'w1')}, 'inputs: w1 is the name of an argument'),
    ({'inputs': ('u1', 'x1')}, 'inputs: x1 is also one of the states'),
    ({'sensors': ('y', 'y')}, 'sensors: y is named twice'),
    ({'sensors': ('u1', 'y')}, 'sensors: u1 is also one of the inputs'),
    ({'sample_time': 0.0}, 'sample_time: 0.0 is not a positive number'),
    ({'sample_time': float('nan')}, 'sample_time: nan'),
    ({'sample_time': 'fast'}, "sample_time: 'fast'"),
    ({'sample_time': 10**400}, 'sample_time: 1000'),
    ({'name': None}, 'name: None is not a text of one line'),
    ({'name': 'a\nb'}, "name: 'a\\nb' is not a text of one line"),
    ({'name': ''}, 'name: is empty'),
    ({'parameters': {'a': 'b'}}, "parameters: ['b'] is not"),
    ({'parameters': [1.0]}, 'parameters: [1.0] is not a mapping'),
    ({'parameters': {'x1': 1.0}}, 'parameters: x1 is also one of the states'),
    ({'units': ['m']}, "units: ['m'] is not a mapping"),
    ({'units': {'x1': 'm\x1b'}}, 'units.x1: '),
    ({'units': {'x1': None}}, 'units.x1: None is not a text'),
    ({'initial': [1.0, 2.0]}, 'initial: [1.0, 2.0] does not fit'),
    ({'initial': [1.0, 2.0, np.nan]}, 'initial: '),
    ({'initial': np.zeros(3, 'datetime64[s]')}, 'initial: '),
    ({'initial': 'abc'}, "initial: 'abc' is not"),
    ({'noise': ['a', 'b']}, 'noise: '),
    ({'noise': [1.0, np.inf]}, 'noise: holds'),
    ({'noise': [-1.0, 1.0]}, 'noise: [-1.0, 1.0] is negative somewhere'),
    ({'Cu': [[1.0, 2.0]]}, 'Cu: has shape (1, 2); give one row of 2 numbers a sensor'),
    ({'Cu': [1.0, 2.0]}, 'Cu: has shape (2,)'),
    ({'Cu': 'text'}, "Cu: 'text' is not a matrix"),
    ({'Cu': np.full((2, 2), np.nan)}, 'Cu: holds NaN or infinity'),
    ({'Cd': [[1.0], [2.0]]}, 'Cd: has shape (2, 1); give one row of 0 numbers a sensor'),
    ({'D': [1, 0, 0], 'Cd': [1e76, 0]}, 'Cd: holds a number beyond 1e+75'),
    ({'process_noise': [1.0, 2.0]}, 'process_noise: [1.0, 2.0] does not fit; give 3 numbers'),
    ({'process_noise': [1.0, -2.0, 0.0]}, 'process_noise: [1.0, -2.0, 0.0] is negative somewhere'),
    ({'process_noise': [1.0, np.inf, 0.0]}, 'process_noise: holds NaN or infinity'),
    ({'ranges': [0.0, 1.0]}, 'ranges: has shape (2,); give 3 rows of low and high'),
    ({'ranges': [[0, 1], [1, 1], [0, 1]]}, 'a low that is not below its high'),
    ({'ranges': [[0, 1], [np.inf, np.inf], [0, 1]]}, 'a low that is not below its high'),
    ({'ranges': [[0, 1], [0, np.nan], [0, 1]]}, 'ranges: holds NaN'),
    ({'ranges': [[0, 1], [0, 1e76], [0, 1]]}, 'ranges: holds a number beyond 1e+75'),
    ({'input_range': [[0, 1]]}, 'input_range: has shape (1, 2); give 2 rows of low and high'),
    ({'wrap': [360.0]}, 'wrap: [360.0] does not fit; give 2 numbers'),
    ({'wrap': [360.0, 0.0]}, 'wrap: [360.0, 0.0] is not above 0 somewhere'),
    ({'curves': [1]}, 'curves: [1] is not a mapping'),
    ({'curves': {'y1': 'exp(w1)'}}, "curves.y1: 'exp(w1)' is no Curve; give Curve(offset)"),
    ({'remarks': 3}, 'remarks: 3 is not a list'),
    ({'units': {'x9': 'm'}}, "units: unknown name 'x9'; known: x1, x2, x3, u1, u2, y1, y2"),
])
def test_bad_arrays_give_one_line(change, needle):
    arguments = {'A': A, 'B': B, 'C': C, 'P': P, 'G': G,
                 'nonlinearities': ['w1 - sqrt(w1)'] * 3, **change}
    with pytest.raises(BadInput) as refusal:
        Plant.from_matrices(**arguments)
    line = str(refusal.value)
    assert needle in line and line.isprintable()
    assert line.startswith('Plant.from_matrices: ') and '; ' in line


def test_a_sensor_may_be_called_as_a_state():
    assert tank(sensors=('x2', 'x3')).sensors == ('x2', 'x3')


@pytest.mark.parametrize('more', [([[0.0], [0.5]],), (None, 0.1)])
def test_a_fourth_argument_is_asked_for_its_name(more):
    """Control packages take the feedthrough there; here it would be an unknown input."""
    with pytest.raises(BadInput, match='feedthrough is Cu=, unknown inputs are D='):
        Plant.from_matrices([[0, 1], [-2, -3]], [0, 1], np.eye(2), *more)
