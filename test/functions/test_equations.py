"""Several expressions at once: what each is alone, and its slopes."""

import numpy as np
import pytest

from vsensor_ros.functions import equations as module
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


def test_what_is_common_is_worked_out_once(monkeypatch):

    asked = []
    original = module.function_of

    def counted(node):
        asked.append(node.function)
        return original(node)
    monkeypatch.setattr(module, 'function_of', counted)
    both = Equations([parse('sin(x*y) + 1'), parse('2*sin(x*y)')], ('x', 'y'))
    assert asked.count('sin') == 1
    np.testing.assert_allclose(both.values(np.array([[0.5], [2.0]])),
                               [[np.sin(1.0) + 1.0], [2.0 * np.sin(1.0)]])


def test_a_name_that_is_no_variable():
    with pytest.raises(KeyError):
        Equations([parse('x + q')], ('x',))
