"""Controllers: what a file says, what is refused, and what a transfer matrix becomes."""

from dataclasses import replace
from pathlib import Path
import re

import numpy as np
import pytest

from vsensor_ros import Controller, load_controller, load_plant, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.control.uncertainty import chosen, corners, varied

CART_POLE = Path(__file__).parents[2] / 'config' / 'cart_pole'


@pytest.fixture(scope='module')
def cart():
    return load_plant(CART_POLE / 'plant.yaml')


def written(folder, text):
    path = folder / 'K.yaml'
    path.write_text(text)
    return path


def response(controller, z):
    inner = np.linalg.inv(z * np.eye(len(controller.A)) - controller.A)
    return controller.C @ inner @ controller.B + controller.D


def test_a_gain(cart, tmp_path):
    found = load_controller(written(
        tmp_path, 'parameters: {k: 2}\nreads: [rate, angle]\ngain: [[10*k, 3]]\n'), cart)
    assert found.reads == ('rate', 'angle') and found.writes == ('force',)
    assert found.D.tolist() == [[-20.0, -3.0]] and found.sample_time is None
    assert load_controller(written(tmp_path, 'gain: [1, 2, 3, 4]\nsample_time: 0.01\n'),
                           cart).D.tolist() == [[-1.0, -2.0, -3.0, -4.0]]


def test_matrices(cart, tmp_path):
    found = load_controller(written(tmp_path, (
        'reads: [angle]\nunheard: force\nmatrices:\n'
        '  A: [[-1, 2], [0, -3]]\n  B: [1, 2]\n  C: [[4, 5]]\n')), cart)
    assert found.A.tolist() == [[-1.0, 2.0], [0.0, -3.0]] and found.B.tolist() == [[1.0], [2.0]]
    assert found.C.tolist() == [[4.0, 5.0]] and found.D.tolist() == [[0.0]]
    assert found.unheard == ('force',)


def test_a_transfer_matrix_has_no_states_to_spare(cart, tmp_path):
    found = load_controller(written(tmp_path, (
        'sample_time: 0.02\ntransfer:\n  force:\n'
        '    angle: {numerator: [3, -2.9], denominator: [1, -1]}\n'
        '    position: {numerator: [0.5, 0.1], denominator: [2, -2]}\n'
        '    rate: {numerator: 2, denominator: [1, -0.5, 0.2]}\n'
        '    speed: 7\n')), cart)
    assert found.reads == ('angle', 'position', 'rate', 'speed')
    assert len(found.A) == 3  # one integrator for both, and two of the rate
    for z in (0.3 + 0.4j, -2.0, 1.5j):
        expected = [(3 * z - 2.9) / (z - 1), (0.5 * z + 0.1) / (2 * z - 2),
                    2 / (z**2 - 0.5 * z + 0.2), 7]
        assert response(found, z)[0] == pytest.approx(expected)


@pytest.mark.parametrize(('text', 'needle'), [
    ('', 'is empty; write a controller file'),
    ('- 1\n', 'is not a mapping'),
    ('gian: [[1, 2, 3, 4]]\n', "unknown key 'gian'; did you mean gain? known: "),
    ('sample_time: 1\n', 'there is no controller in it; give one of gain, transfer, matrices'),
    ('gain: 1\nmatrices: {}\n', 'gain and matrices: are both there'),
    ('gain: [[1, 2]]\n', 'gain: is not 1 rows of 4 numbers'),
    ('gain: [[1, 2, 3, x]]\n', 'gain[0][3]'),
    ('gain: [[1, 2, 3, .inf]]\n', 'gain[0][3]'),
    ('gain: [[1]]\nreads: angel\n', "reads: unknown sensor 'angel'; did you mean angle?"),
    ('gain: [[1]]\nreads: [angle, angle]\n', 'reads: angle is named twice; name each once'),
    ('gain: [[1]]\nreads: []\n', 'reads: [] is no list of names'),
    ('gain: [[1]]\nreads: {angle: 1}\n', 'is no list of names'),
    ('gain: [[1]]\nreads: angle\nwrites: torque\n', "writes: unknown input 'torque'"),
    ('gain: [[1]]\nreads: angle\nunheard: torque\n', "unheard: unknown input 'torque'"),
    ('gain: [[1, 2, 3, 4]]\nsample_time: 0\n', 'sample_time: 0 is not positive; give seconds'),
    ('gain: [[1, 2, 3, 4]]\nsample_time: fast\n', 'sample_time'),
    ('matrices: {A: [[1]], B: [[1, 2, 3, 4]]}\n', 'matrices.C: is missing'),
    ('matrices: {A: [[1, 2]], B: [[1, 2, 3, 4]], C: [[1]]}\n', 'matrices.A: is not 1 rows of 1'),
    ('matrices: {A: 3}\n', 'matrices.A: 3 is not rows of numbers'),
    ('matrices: {E: [[1]]}\n', "matrices: unknown key 'E'"),
    ('transfer: {force: {angle: 1}}\n', 'sample_time: is missing; a transfer matrix is of z'),
    ('sample_time: 1\ntransfer: {}\n', 'transfer: is empty; write transfer: {input: {sensor'),
    ('sample_time: 1\ntransfer: {force: {}}\n', 'transfer.force: is empty'),
    ('sample_time: 1\ntransfer: {torque: {angle: 1}}\n', "transfer: unknown input 'torque'"),
    ('sample_time: 1\ntransfer: {force: {angel: 1}}\n', "transfer.force: unknown sensor 'angel'"),
    ('sample_time: 1\nreads: angle\ntransfer: {force: {angle: 1}}\n', 'reads: stands beside'),
    ('sample_time: 1\ntransfer: {force: {angle: {num: 1}}}\n',
     "transfer.force.angle: unknown key 'num'"),
    ('sample_time: 1\ntransfer: {force: {angle: {denominator: [1, 2]}}}\n',
     'transfer.force.angle.numerator: is missing'),
    ('sample_time: 1\ntransfer: {force: {angle: {numerator: [1, 2], denominator: 3}}}\n',
     'is of degree 1, above that of the denominator, 0; it would need readings of the future'),
    ('sample_time: 1\ntransfer: {force: {angle: {numerator: 1, denominator: [0, 0]}}}\n',
     'transfer.force.angle.denominator: is zero'),
    ('sample_time: 1\ntransfer: {force: {angle: {numerator: [], denominator: []}}}\n',
     'transfer.force.angle.denominator: is zero'),
    ('gain: [[1, 2, 3, 4]]\nname: [1]\n', 'name: [1] is not a text'),
])
def test_what_is_wrong_is_said_in_one_line(cart, tmp_path, text, needle):
    path = written(tmp_path, text)
    with pytest.raises(BadInput) as caught:
        load_controller(path, cart)
    line = str(caught.value)
    assert line.startswith(str(path)) and needle in line and '\n' not in line


def test_a_file_that_is_not_there(cart, tmp_path):
    with pytest.raises(BadInput, match=r'cannot be read .* name a controller file \(YAML\)'):
        load_controller(tmp_path / 'none.yaml', cart)


@pytest.mark.parametrize(('given', 'needle'), [
    ({'A': [[1.0, 2.0]]}, 'A: has shape'),
    ({'A': [[1.0], [2.0, 3.0]]}, 'A: '),
    ({'B': [[1.0]]}, 'B: has shape'),
    ({'D': [[np.nan, 1.0]]}, 'D: holds a number that is not finite'),
    ({'sample_time': -1.0}, 'sample_time: -1.0 is not a positive number'),
    ({'sample_time': True}, 'sample_time: True is not a positive number'),
    ({'reads': ('a', 'a')}, 'reads: a is named twice'),
    ({'reads': (), 'B': np.zeros((1, 0)), 'D': np.zeros((1, 0))}, 'reads: is empty'),
    ({'unheard': ('w',)}, "unheard: 'w' is no input that it writes"),
])
def test_what_is_wrong_from_python(given, needle):
    usual = {'reads': ('a', 'b'), 'writes': ('v',), 'A': [[0.5]], 'B': [[1.0, 2.0]],
             'C': [[1.0]], 'D': [[0.0, 0.0]]}
    Controller(**usual)
    with pytest.raises(BadInput) as caught:
        Controller(**{**usual, **given})
    assert needle in str(caught.value)


def test_parameters_that_others_are_made_of_take_them_along(cart):
    given = ['cart', 'pole', 'length', 'drag', 'friction', 'gravity']
    assert chosen(cart, '10%') == dict.fromkeys(given, 0.1)
    assert chosen(cart, 0.1) == chosen(cart, ' 10 %') == chosen(cart, '0.1')
    assert chosen(cart, 'pole=5%, inertia=1%') == {'pole': 0.05, 'inertia': 0.01}
    assert len(corners(chosen(cart, '10%'))) == 2**6
    heavier = varied(cart, {'pole': 1.1})
    assert heavier.parameters['pole'] == pytest.approx(0.22)
    assert heavier.parameters['moment'] == pytest.approx(0.22 * 0.3)
    assert heavier.parameters['inertia'] == pytest.approx(0.006 + 0.22 * 0.09)
    assert varied(cart, {'inertia': 1.1}).parameters['inertia'] == pytest.approx(1.1 * 0.024)
    assert varied(cart, {}).hash() == cart.hash() != heavier.hash()


@pytest.mark.parametrize(('given', 'needle'), [
    ('mass=10%', "unknown parameter 'mass'; known: cart, pole"),
    ('much', "'much' is not a share; write 10% of all parameters, or mass=10%,length=5%"),
    ('10', '10.0 is not between 0 and 1 (100%)'),
    ('0%', '0.0 is not between 0 and 1'),
    ('-5%', '-0.05 is not between'),
    ('pole=200%', '2.0 of pole is not between'),
    ('pole=x', "'x' is not a share"),
    ('pole=10%,', "'' is no name=share"),
    ('=10%', "'=10%' is no name=share"),
    ('pole=1%,pole=2%', 'pole is named twice'),
    (True, 'True is not between'),
    (np.nan, 'nan is not between'),
    ({'pole': 'a'}, "'a' is not a share"),
])
def test_what_is_wrong_with_an_uncertainty(cart, given, needle):
    with pytest.raises(BadInput) as caught:
        chosen(cart, given)
    assert str(caught.value).startswith('uncertainty: ') and needle in str(caught.value)


PLANT = """
name: valve
time: {sample_time: 0.1}
parameters: {a: [0.5, 0], b: 0.2, none: 0}
states: {x: {}}
inputs: {u: {}}
dynamics: {x: 'a[0]*x + sqrt(b - 0.19)*u'}
sensors: {y: {measures: x}}
"""


def test_what_is_no_plant_at_a_corner(tmp_path):
    path = tmp_path / 'plant.yaml'
    path.write_text(PLANT)
    plant = load_plant(path)
    assert chosen(plant, 'a=10%') == {'a[0]': 0.1}  # zeros cannot be off by a share
    with pytest.raises(BadInput, match='the parameters that it names are zero'):
        chosen(plant, 'none=10%')
    with pytest.raises(BadInput, match='with b -10 %: .*choose less uncertainty'):
        varied(plant, {'b': 0.9})
    timed = Plant.from_matrices([[0.5]], [1.0], [[1.0]], sample_time=1.0, remake=lambda factors:
                                replace(plant, sample_time=factors['slow'], states=('x1',)))
    with pytest.raises(BadInput, match=r'uncertainty: with slow \+10 % the plant has another '
                       'sample time'):
        varied(timed, {'slow': 1.1})
    bare = Plant.from_matrices([[0.5]], [1.0], [[1.0]], sample_time=1.0)
    with pytest.raises(BadInput, match='the plant has no named parameters that could be off'):
        chosen(bare, '10%')


def test_the_files_of_the_docs(cart, tmp_path):
    page = (CART_POLE.parents[1] / 'docs' / 'in_the_loop.md').read_text()
    texts = re.findall(r'```yaml\n(.*?)```', page, re.DOTALL)
    servo = load_plant(CART_POLE.parent / 'servo' / 'plant.yaml')
    found = [load_controller(written(tmp_path, text), servo if 'voltage' in text else cart)
             for text in texts]
    assert [len(c.A) for c in found] == [0, 1, 1] and found[0].D[0, 0] == 50.0
    shipped = load_controller(CART_POLE.parent / 'servo' / 'controller.yaml', servo)
    assert np.allclose(found[1].D, shipped.D) and np.allclose(found[1].B, shipped.B)
