"""Equations into matrices and nonlinear terms."""

from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.affine import affine
from vsensor_ros.functions.expression import Apply, compile_expression, Name, negate, Number, parse
from vsensor_ros.functions.nonlinearity import evaluate, set_valued
from vsensor_ros.plant.split import check_split, Split, split_equations, with_addends

RELAXED = settings(deadline=None, suppress_health_check=[
    HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large])
STATES, INPUTS, DISTURBANCES = ('x', 'y', 'z'), ('u', 'v'), ('rho',)


def split(*texts, states=STATES):
    equations = [parse(text) for text in texts]
    equations += [Number(0.0)] * (len(states) - len(texts))
    return split_equations(equations, states, INPUTS, DISTURBANCES, 'plant.yaml')


def value(parts, x, u, rho):
    total = parts.A @ x + parts.B @ u + parts.D @ rho
    for term, g, column in zip(parts.terms, parts.G, parts.P.T):
        total = total + column * evaluate(term, g @ x, INPUTS, u)
    return total


numbers = st.sampled_from([-2.0, -1.0, -0.5, 0.0, 0.25, 1.0, 1.5]).map(Number)
known = st.one_of(numbers, st.sampled_from(STATES + INPUTS).map(Name))


def grown(children):
    return st.one_of(
        st.builds(lambda op, a, b: Apply(op, (a, b)), st.sampled_from('+-*'), children,
                  children),
        st.builds(lambda a, b: Apply('/', (a, Number(b))), children,
                  st.sampled_from([-2.0, 0.5, 4.0])),
        st.builds(lambda name, a: Apply(name, (a,)),
                  st.sampled_from(['sin', 'tanh', 'atan', 'abs']), children),
        st.builds(lambda a: Apply('sat', (a, Number(-1.0), Number(2.0))), children),
        children.map(negate))


nodes = st.recursive(known, grown, max_leaves=8)
disturbed = st.builds(lambda a, k: Apply('+', (a, Apply('*', (Number(k), Name('rho'))))),
                      nodes, st.sampled_from([-2.0, 0.0, 1.5]))


@settings(RELAXED, max_examples=80)
@given(st.tuples(disturbed, disturbed, nodes), st.lists(st.floats(-3, 3), min_size=6,
                                                        max_size=6))
def test_split_equals_the_equations(equations, at):
    parts = split_equations(equations, STATES, INPUTS, DISTURBANCES, 'f')
    parts = with_addends(parts, np.array([0.3, 0.7, -0.2]), INPUTS, np.array([0.5, -1.0]))
    x, u, rho = np.array(at[:3]), np.array(at[3:5]), np.array(at[5:])
    ours = value(parts, x, u, rho)
    for i, equation in enumerate(equations):
        truth = float(compile_expression(equation, STATES + INPUTS + DISTURBANCES)(at))
        # the addends may cancel
        size = 1.0 + abs(truth) + sum(
            abs(c) * (1 + abs(evaluate(t, g @ x, INPUTS, u)) + abs(t.slope) @ abs(g @ x))
            for t, g, c in zip(parts.terms, parts.G, parts.P[i]))
        assert ours[i] == pytest.approx(truth, abs=1e-8 * size)


def test_papers_tank():
    parts = split('u - sqrt(x - y)', 'v + sqrt(x - y) - sqrt(y - z)', 'sqrt(y - z) - sqrt(z)')
    assert not parts.A.any()
    assert parts.P.tolist() == [[-1, 0, 0], [1, -1, 0], [0, 1, -1]]
    assert [g.tolist() for g in parts.G] == [[[1, -1, 0]], [[0, 1, -1]], [[0, 0, 1]]]
    assert [t.text for t in parts.terms] == ['sqrt(w1)'] * 3
    assert [t.name for t in parts.terms] == ['sqrt(x - y)', 'sqrt(y - z)', 'sqrt(z)']
    moved = with_addends(parts, np.array([0.75, 0.5, 0.25]), INPUTS, np.zeros(2))
    assert moved.A.tolist() == [[-1, 1, 0], [1, -2, 1], [0, 1, -2]]


@pytest.mark.parametrize(('text', 'terms'), [
    # (factor, text, G) of each nonlinear addend
    ('2*(3*x + sqrt(y)/4) - u', [(0.5, 'sqrt(w1)', [[0, 1, 0]])]),
    ('-(-sign(2*y))', [(1, 'sign(w1)', [[0, 2, 0]])]),
    ('sqrt(x - 2*y + u + 3)', [(1, 'sqrt(w1 + u + 3)', [[1, -2, 0]])]),
    ('5 - x', [(5, '1', [])]),
    ('sin(u)', [(1, 'sin(u)', [])]),
    ('3*x*u', [(3, 'w1*u', [[1, 0, 0]])]),
    ('x*y', [(1, 'w1*w2', [[1, 0, 0], [0, 1, 0]])]),
    ('x*(2*x)', [(2, 'w1*w1', [[1, 0, 0]])]),
    ('(x - y)*sqrt(y - x)', [(1, 'w1*sqrt(-w1)', [[1, -1, 0]])]),
    ('4/(2*x)', [(2, '1/w1', [[1, 0, 0]])]),
    ('x**2/2', [(0.5, 'w1**2', [[1, 0, 0]])]),
    ('sqrt(x) + sqrt(y) - sqrt(x)', [(1, 'sqrt(w1)', [[0, 1, 0]])]),
    ('sqrt(x - y) + 2*sqrt(-y + x)', [(3, 'sqrt(w1)', [[1, -1, 0]])]),
    ('sqrt(x - x + 4) - z', [(2, '1', [])]),
    ('sin(x*0) - z', []),
    ('cos(x*0)*y + sin(0*sqrt(x))*z', []),
    ('exp(y - y)*sqrt(x) + abs(z - z)*u', [(1, 'sqrt(w1)', [[1, 0, 0]])]),
    ('0*sqrt(x) + y', []),
    ('x*3/2 - (y - u)', []),
])
def test_addends(text, terms):
    parts = split(text)
    found = [(factor, term.text, g.tolist())
             for factor, term, g in zip(parts.P[0], parts.terms, parts.G)]
    assert found == terms


def test_linear_part():
    parts = split('(x + 2*(y - u))/4 - rho', '-z', 'x - (x - v)')
    assert parts.A.tolist() == [[0.25, 0.5, 0], [0, 0, -1], [0, 0, 0]]
    assert parts.B.tolist() == [[-0.5, 0], [0, 0], [0, 1]]
    assert parts.D.tolist() == [[-1], [0], [0]]
    assert parts.terms == ()


def test_dry_friction_stays_set_valued_and_without_addend():
    parts = with_addends(split('0', '-y + z - sign(y)'), np.zeros(3), INPUTS, np.zeros(2))
    assert set_valued(parts.terms[0])
    assert parts.terms[0].slope.tolist() == [0.0]
    assert parts.P.tolist() == [[0], [-1], [0]]


@pytest.mark.parametrize('text', [
    'sqrt(x - 2*y + u) - 3*sqrt(2*y - x - u)', 'x*y/(1 + abs(z)) + 2*log(x)*u', 'x**1.5/3 - 1/y',
    'sat(x - u, -1, 2)*deadzone(z, 0.5)', 'max(x, y) - min(z, 2)*v', 'exp(x/5)*sign(y - z) + 4'])
def test_kinks_and_continuations_survive_the_split(text):
    equations = [parse(text)] * 3
    parts = split_equations(equations, STATES, INPUTS, DISTURBANCES, 'f')
    parts = with_addends(parts, np.array([0.5, 0.3, 2.0]), INPUTS, np.ones(2))
    f = compile_expression(text, STATES + INPUTS)
    for seed in range(40):
        x, u = np.split(np.random.default_rng(seed).normal(0, 3, 5), [3])
        assert value(parts, x, u, np.zeros(1)) == pytest.approx(
            float(f([*x, *u])), rel=1e-10, abs=1e-10)


def test_addends_make_the_linearisation():
    point, u = np.array([0.4, 1.1, -0.6]), np.array([0.7, 0.2])
    parts = with_addends(split('x*y + sin(z)*u', 'sqrt(y)/(1 + x**2)', 'tanh(z - u)*v'),
                         point, INPUTS, u)
    h = 1e-6
    for j in range(3):
        ends = [value(parts, point + s * h * np.eye(3)[j], u, np.zeros(1)) for s in (1, -1)]
        assert np.allclose((ends[0] - ends[1]) / (2 * h), parts.A[:, j], atol=1e-8)


def test_a_nonlinear_addend_with_a_disturbance_is_left_as_it_is():
    for text in ('sqrt(x + rho)', 'x*rho', 'x + 2*u*rho', '3*z - (y + rho)/x'):
        found = split(text)  # which compares it with the equation, too
        assert len(found.rest[0]) == 1 and not found.D.any() and not found.terms


def test_states_named_as_arguments_do_not_mix():
    equations = [parse('sqrt(w2 - w1)'), parse('w1*w2')]
    parts = split_equations(equations, ('w1', 'w2'), (), (), 'f')
    assert [t.text for t in parts.terms] == ['sqrt(w1)', 'w1*w2']
    assert parts.G[0].tolist() == [[-1, 1]]
    assert [t.name for t in parts.terms] == ['sqrt(w2 - w1)', 'w1*w2']


def test_check_catches_a_wrong_split():
    equations = [parse('x - sqrt(y)'), parse('u*z'), parse('rho - z')]
    right = split_equations(equations, STATES, INPUTS, DISTURBANCES, 'f')
    check_split(right, equations, STATES, INPUTS, DISTURBANCES, np.ones(3), 'f')
    for letter in ('A', 'B', 'D', 'P'):
        wrong = {k: getattr(right, k) for k in ('A', 'B', 'D', 'P', 'G', 'terms')}
        wrong[letter] = wrong[letter] + 1e-6 * (np.arange(wrong[letter].size) == 0).reshape(
            wrong[letter].shape)
        with pytest.raises(BadInput, match=r'dynamics\.x: its matrix form differs'):
            check_split(Split(**wrong), equations, STATES, INPUTS, DISTURBANCES, np.ones(3), 'f')


def test_affine():
    assert affine(parse('2*(x - 3)/4 + y')) == {'x': 0.5, 'y': 1.0, '': -1.5}
    assert affine(parse('x - x')) == {}
    assert affine(parse('x*y')) is None
    assert affine(parse('1/x')) is None
