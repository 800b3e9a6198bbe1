"""Several expressions at once: what each is alone, and its slopes."""

from dataclasses import replace

import numpy as np
import pytest

from vsensor_ros.functions.catalogue import CATALOGUE
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import compile_expression, gradient, parse

NAMES = ('x', 'y', 'p')
TEXTS = ('sin(x + p)*y', 'p*sin(x + p)/(2 + cos(y))', 'sqrt(x)', 'abs(y) - sat(x, -1, p)',
         'x**3 - y**p', 'tanh(y/p)*exp(-x) + log(2 + x*x)', 'max(x, y) + min(x, 0.5)', '7', '-p',
         'atan2(x, y)', 'deadzone(x, 0.1)', 'table(x, -9, 1, 0, 2, 9, -3)')


def test_values_and_slopes_are_those_of_each_alone():
    nodes = [parse(text) for text in TEXTS]
    at = np.random.default_rng(0).uniform(0.2, 2.0, (3, 40)) * np.array([[1.0], [1.0], [0.5]])
    at[0] *= np.where(np.arange(40) % 2, 1.0, -1.0)
    equations = Equations(nodes, NAMES)
    values, slopes = equations.slopes(at)
    assert values.shape == (12, 40) and slopes.shape == (12, 3, 40)
    np.testing.assert_array_equal(values, equations.values(at))
    for text, node, value, slope in zip(TEXTS, nodes, values, slopes):
        np.testing.assert_allclose(value, np.broadcast_to(
            compile_expression(text, NAMES)(at), 40), err_msg=text)
        for n in range(40):
            expected = gradient(node, dict(zip(NAMES, at[:, n])), NAMES)[1]
            np.testing.assert_allclose(slope[:, n], expected, err_msg=text)


def test_at_a_kink_the_slope_is_none():
    _, slopes = Equations([parse('abs(x)'), parse('sqrt(x)')], ('x',)).slopes(np.zeros((1, 1)))
    assert not slopes.any()


def test_a_kink_spoils_no_other_slope():
    """The root has no slope at 0; what the same equation has of another variable stays."""
    for many in (1, 20):
        _, slopes = Equations([parse('sqrt(x) + 3*y')], ('x', 'y')).slopes(np.zeros((2, many)))
        np.testing.assert_array_equal(slopes[0, :, 0], [0.0, 3.0])


@pytest.mark.parametrize('count', [1, 40])
def test_numbers_beyond_use_are_numbers_all_the_same(count):
    """What Python's own functions refuse numpy takes, whether points are few or many."""
    at = np.full((3, count), 1e200)
    at[1] = np.inf
    with np.errstate(all='ignore'):
        values, slopes = Equations([parse(text) for text in (
            'x**2.5', 'sin(y)', 'x/y', 'y**3.5*x', 'tan(x*x)')], NAMES).slopes(at)
    assert values.shape == (5, count) and (values[0] == np.inf).all() and (values[2] == 0.0).all()
    assert np.isnan(values[1]).all() and np.isfinite(slopes).all()


def test_few_points_are_worked_out_as_many_are():
    nodes = [parse(text) for text in TEXTS]
    at = np.random.default_rng(1).uniform(0.2, 2.0, (3, 40))
    equations = Equations(nodes, NAMES)
    for one, many in zip(equations.slopes(at[:, :2]), equations.slopes(at)):
        np.testing.assert_allclose(one, many[..., :2], rtol=1e-13)


def test_what_is_common_is_worked_out_once(monkeypatch):
    taken = []
    monkeypatch.setitem(CATALOGUE, 'sin', replace(
        CATALOGUE['sin'], value=lambda x: taken.append(1) or np.sin(x)))
    both = Equations([parse('sin(x*y) + 1'), parse('2*sin(x*y)')], ('x', 'y'))
    at = np.tile([[0.5], [2.0]], 20)
    np.testing.assert_allclose(both.values(at)[:, 0], [np.sin(1.0) + 1.0, 2.0 * np.sin(1.0)])
    assert len(taken) == 1
    both.slopes(at)
    assert len(taken) == 2


def test_a_name_that_is_no_variable():
    with pytest.raises(KeyError):
        Equations([parse('x + q')], ('x',))
