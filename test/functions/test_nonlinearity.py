"""The catalogue's promises and the nonlinear terms."""

from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.nonlinearity import (
    CATALOGUE,
    check_term,
    compile_outside_domain,
    compile_term,
    evaluate,
    make_term,
    NonlinearTerm,
    outside_domain,
    set_valued,
    slope_at,
    slope_bounds,
)

RELAXED = settings(deadline=None, suppress_health_check=[
    HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large])
ordinary = st.floats(-1e3, 1e3)
# how the arguments after the first are fixed when a function is looked at along its first
FIXED = {'atan2': (0.5,), 'min': (0.3,), 'max': (0.3,), 'sat': (-1.0, 2.0), 'deadzone': (0.5,)}
LIMITED = {'sqrt': (-1.0,), 'asin': (1.5,), 'exp': (701.0,), 'log': (0.0,),
           'sat': (0.0, 2.0, 1.0), 'deadzone': (0.0, -1.0)}    # one point outside each


@pytest.mark.parametrize('name', CATALOGUE)
@RELAXED
@given(data=st.data())
def test_finite_everywhere(name, data):
    function = CATALOGUE[name]
    arguments = data.draw(st.tuples(*[ordinary] * function.arity))
    assert np.isfinite(function.value(*arguments))
    assert np.isfinite(function.value(*[np.array([a]) for a in arguments])).all()


@pytest.mark.parametrize('name', [n for n, f in CATALOGUE.items() if f.slope_bounds])
@RELAXED
@given(a=ordinary, b=ordinary)
def test_slope_bounds_hold_with_the_continuation(name, a, b):
    function = CATALOGUE[name]
    rest = FIXED.get(name, ())
    low, high = function.slope_bounds
    rise = float(function.value(a, *rest) - function.value(b, *rest)) * np.sign(a - b)
    run = abs(a - b)
    slack = 1e-9 * (1.0 + abs(float(function.value(a, *rest))))
    assert rise >= low * run - slack * (1 + abs(low))
    if np.isfinite(high):
        assert rise <= high * run * (1 + 1e-9) + slack


@pytest.mark.parametrize('name', CATALOGUE)
@pytest.mark.parametrize('x', [-0.7, 0.41, 2.3])
def test_slopes_are_derivatives(name, x):
    function = CATALOGUE[name]
    arguments = [x, *FIXED.get(name, ())]
    for i, slope in enumerate(function.slopes):
        ends = [[a + s * 1e-6 * (j == i) for j, a in enumerate(arguments)] for s in (1, -1)]
        quotient = (float(function.value(*ends[0])) - float(function.value(*ends[1]))) / 2e-6
        assert float(slope(*arguments)) == pytest.approx(quotient, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize('name', CATALOGUE)
def test_domain_and_continuation_are_said(name):
    function = CATALOGUE[name]
    assert (function.outside is not None) == (name in LIMITED)
    if name in LIMITED:
        assert function.continuation
        inside = (0.5, *FIXED.get(name, ()))
        assert function.outside(*LIMITED[name]) and not function.outside(*inside)
        assert not function.outside(*[np.nan] * function.arity)


def test_closed_forms_of_the_continuations():
    def f(text, *w):
        return evaluate(make_term(text, len(w), ()), np.array(w, float), (), ())
    assert f('sqrt(w1)', -4.0) == -2.0
    assert f('w1**0.5', -4.0) == -2.0
    assert f('w1**1.5', -4.0) == -8.0
    assert f('w1**2', -4.0) == 16.0
    assert f('w1**3', -2.0) == -8.0
    assert f('w1**-1', -4.0) == -0.25
    assert f('w1**-2', 0.0) == 0.0
    assert f('1/w1', 0.0) == 0.0
    assert f('w1/w2', 3.0, 0.0) == 0.0
    assert f('w1**w2', -4.0, 0.5) == -2.0
    assert f('w1**w2', -2.0, 3.0) == -8.0
    assert f('w1**w2', -2.0, 2.0) == 4.0
    assert f('w1**w2', 0.0, -1.0) == 0.0
    assert f('asin(w1)', 2.0) == pytest.approx(np.pi / 2 + 1)
    assert f('log(w1)', 1e-6 - 2e-6) == pytest.approx(np.log(1e-6) - 2)
    assert f('exp(w1)', 1e4) == np.exp(700.0)
    assert [f('sat(w1, 2, w2)', x, 1.0) for x in (-9.0, 1.5, 9.0)] == [1.0] * 3
    assert [f('deadzone(w1, w2)', x, -2.0) for x in (-9.0, 0.0, 9.0)] == [-7.0, 2.0, 11.0]


@pytest.mark.parametrize(('text', 'w', 'outside'), [
    ('sqrt(w1)', -1.0, True), ('sqrt(w1)', 0.0, False), ('1 + 2*sqrt(w1 - 1)', 0.5, True),
    ('1/w1', 0.0, True), ('1/w1', 1.0, False), ('w1**0.5', -1.0, True), ('w1**2', -1.0, False),
    ('w1**-1', 0.0, True), ('w1/2', 0.0, False), ('sin(w1)', -9.0, False),
    ('sat(0, 1.2, w1)', 1.0, True), ('sat(w1, 0, 1)', 3.0, False), ('deadzone(0, w1)', -1.0, True),
    ('log(w1) + w1', -1.0, True), ('w1**w1', -1.5, True), ('w1**w1', -2.0, False)])
def test_outside_domain(text, w, outside):
    term = make_term(text, 1, ())
    assert outside_domain(term, [w], (), ()) == outside
    both = outside_domain(term, [[w, 1.5]], (), ())
    assert both.tolist() == [outside, False]


def test_hot_loop_knows_that_there_is_no_domain():
    for text in ('sin(w1) + w1**2/3', 'sat(w1, -1, 1) - deadzone(w1, 2)'):
        assert compile_outside_domain(make_term(text, 1, ()), ()) is None
    assert compile_outside_domain(make_term('sqrt(u1)*w1', 1, ('u1',)), ('u1',)) is not None


def test_addend_is_taken_out_of_psi_but_not_of_f():
    term = NonlinearTerm('', 'sqrt(w1)*u1', np.array([2.0]))
    w, u = np.array([[4.0, 9.0]]), np.array([[1.0, 3.0]])
    assert np.array_equal(evaluate(term, w, ('u1',), u), [2.0 - 8.0, 9.0 - 18.0])
    assert np.array_equal(compile_term(term, ('u1',))(w, u), [2.0, 9.0])


@RELAXED
@given(w=st.lists(ordinary, min_size=2, max_size=2), u=ordinary, count=st.integers(1, 4))
def test_evaluate_broadcasts(w, u, count):
    term = NonlinearTerm('', 'sin(w1)*w2 + u1', np.array([0.5, -1.0]))
    one = evaluate(term, w, ('u1',), [u])
    many = evaluate(term, np.repeat(np.reshape(w, (2, 1)), count, axis=1), ('u1',), [u])
    assert one.shape == () and many.shape == (count,)
    assert np.allclose(many, one, rtol=1e-12)


def test_terms_without_arguments():
    assert evaluate(make_term('1', 0, ()), np.zeros((0, 3)), (), ()).tolist() == [1, 1, 1]
    assert evaluate(make_term('sin(u1)', 0, ('u1',)), np.zeros((0,)), ('u1',), [0.5]) \
        == np.sin(0.5)


@pytest.mark.parametrize(('text', 'expected'), [
    ('sign(w1)', True), ('sign((w1))', True), ('sign(2*w1)', False), ('sign(w1 - 1)', False),
    ('2*sign(w1)', False), ('sqrt(w1)', False), ('sign(w1) + 0*w1', False)])
def test_set_valued_is_sign_alone(text, expected):
    assert set_valued(make_term(text, 1, ())) is expected


def test_sign_of_one_of_two_arguments_is_not_set_valued():
    assert not set_valued(make_term('sign(w1)', 2, ()))


@pytest.mark.parametrize(('text', 'slope', 'bounds'), [
    ('sqrt(w1)', 0.0, (0.0, np.inf)), ('sqrt(w1)', 1.0, (-1.0, np.inf)),
    ('sat(w1, -1, 1)', 0.25, (-0.25, 0.75)), ('sin(w1)', 0.0, (-1.0, 1.0)),
    ('sign(w1)', 0.0, (0.0, np.inf)), ('tanh(w1)', 0.0, (0.0, 1.0)),
    ('tan(w1)', 0.0, None), ('w1**3', 0.0, None),
    ('sat(0.5, w1, 2)', 0.0, None), ('sqrt(w1)*u1', 0.0, None)])
def test_slope_bounds_are_of_psi(text, slope, bounds):
    assert slope_bounds(NonlinearTerm('', text, np.array([slope]))) == bounds


@pytest.mark.parametrize(('text', 'w', 'expected'), [
    ('sqrt(w1)', 0.25, 1.0), ('sqrt(w1)', 0.0, 0.0), ('sqrt(w1)', -4.0, 0.0),
    ('sign(w1)', 0.0, 0.0), ('sign(w1)', 3.0, 0.0), ('abs(w1)', 0.0, 0.0),
    ('abs(w1)', -2.0, -1.0), ('w1**2', 3.0, 6.0), ('w1**1.5', 4.0, 3.0), ('w1*u1', 1.0, 7.0),
    ('1/w1', 2.0, -0.25), ('1/w1', 0.0, 0.0), ('1/w1', 1e-200, 0.0), ('w1**3', 0.0, 0.0)])
def test_slope_at(text, w, expected):
    assert slope_at(make_term(text, 1, ('u1',)), [w], ('u1',), [7.0]) == pytest.approx(expected)


@pytest.mark.parametrize('text', ['sqrt(w2)', 'u2', "__import__('os')", 'w1 +'])
def test_bad_terms_give_one_line(text):
    with pytest.raises(BadInput, match=r'^design\.json: terms: '):
        check_term(NonlinearTerm('', text, np.zeros(1)), ('u1',), 'design.json', 'terms')
