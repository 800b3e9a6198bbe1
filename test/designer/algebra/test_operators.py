"""The operators of the algebra of functions: known values, laws of a lattice, the Galois pair."""

from functools import cache

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros.designer.algebra import Verdict
from vsensor_ros.designer.algebra.dictionary import Atom, build
from vsensor_ros.designer.algebra.invariant import free_of_unknown, largest, products
from vsensor_ros.designer.algebra.model import read
from vsensor_ros.designer.algebra.operators import (
    at_most,
    delta,
    element,
    equivalent,
    M,
    m,
    oplus,
    product,
    Space,
)
from vsensor_ros.designer.algebra.reduction import closed, Inside, remainder
from vsensor_ros.designer.algebra.search import find
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Name, to_text

from .systems import system, three_tanks

SPACE = Space({'x1': (0.5, 2.0), 'x2': (0.5, 2.0), 'x3': (0.5, 2.0)})


def of(*texts):
    return element(SPACE, *texts)


def yes(decision):
    return decision.verdict is Verdict.YES


def test_product_and_sum_of_the_appendix():
    a, b = of('x1 + x2', 'x3'), of('x1*x3', 'x2*x3')
    assert list(map(to_text, product(SPACE, a, b))) == ['x1 + x2', 'x3', 'x1*x3']
    found = oplus(SPACE, a, b)
    assert yes(equivalent(SPACE, found.element, of('x3*(x1 + x2)'))) and yes(found.complete)


def test_a_sum_that_would_not_be_integrable_is_empty_for_sure():
    found = oplus(SPACE, of('x2', 'x3'), of('x1', 'x3 - x1*x2'))
    assert found.element == () and yes(found.complete)


def test_absorption_with_operands_of_a_high_degree():
    a, b = of('x1**3 + x2'), of('x1**3 + x2', 'x3')
    assert yes(equivalent(SPACE, oplus(SPACE, a, b).element, a))


def test_order_is_of_values_not_of_ranks_alone():
    both_signs = Space({'x1': (-1.0, 1.0)})
    square, x = element(both_signs, 'x1**2'), element(both_signs, 'x1')
    assert yes(at_most(both_signs, x, square))
    refused = at_most(both_signs, square, x)
    assert refused.verdict is Verdict.NO and refused.reason.code == 'functions many-valued'
    assert at_most(SPACE, of('x1'), of('x2')).reason.code == 'functions independent'
    with pytest.raises(TypeError):
        bool(refused)


def test_an_angle_is_told_by_cosine_and_sine_only_together():
    circle = Space({'th': (-np.pi, np.pi)}, ('th',))
    c, s = element(circle, 'cos(th)'), element(circle, 'sin(th)')
    assert at_most(circle, c, s).verdict is Verdict.NO
    assert yes(at_most(circle, (*c, *s), element(circle, 'sin(2*th)')))


COMPONENTS = ('x1', 'x2', 'x3', 'x1 + x2', 'x1*x3', 'x2/x3', 'x2 + x3**2', 'x1*x2 + x3')
ELEMENTS = st.lists(st.sampled_from(COMPONENTS), min_size=1, max_size=2, unique=True).map(
    lambda texts: of(*texts))


@settings(max_examples=8, deadline=None)
@given(ELEMENTS, ELEMENTS)
def test_laws_of_two(a, b):
    both = product(SPACE, a, b)
    assert yes(equivalent(SPACE, both, product(SPACE, b, a)))
    assert yes(at_most(SPACE, both, a)) and yes(at_most(SPACE, both, b))
    common = oplus(SPACE, a, b)
    assert yes(at_most(SPACE, a, common.element)) and yes(at_most(SPACE, b, common.element))
    assert yes(equivalent(SPACE, common.element, oplus(SPACE, b, a).element))
    # absorption, since the dictionary holds its operands
    assert yes(equivalent(SPACE, oplus(SPACE, both, a, 1).element, a))


LINEAR = st.lists(st.lists(st.integers(-2, 2), min_size=3, max_size=3).filter(any), min_size=1,
                  max_size=2).map(lambda rows: of(*(
                      '+'.join(f'({k})*x{i}' for i, k in enumerate(row, 1)) for row in rows)))


@settings(max_examples=6, deadline=None)
@given(ELEMENTS, ELEMENTS, ELEMENTS)
def test_product_is_associative(a, b, c):
    assert yes(equivalent(SPACE, product(SPACE, product(SPACE, a, b), c),
                          product(SPACE, a, product(SPACE, b, c))))


@settings(max_examples=10, deadline=None)
@given(LINEAR, LINEAR, LINEAR)
def test_sum_of_linear_elements_is_associative(a, b, c):
    left = oplus(SPACE, oplus(SPACE, a, b, 1).element, c, 1).element
    right = oplus(SPACE, a, oplus(SPACE, b, c, 1).element, 1).element
    assert yes(equivalent(SPACE, left, right))


@cache
def plant(discrete):
    """Return a plant, a dictionary, and elements to be tried."""
    f = ['x1 + 0.1*x2*x1 + u', 'x2 + 0.1*x3 + 0.1*u', 'x3 - 0.1*x1*x3'] if discrete else \
        ['x2*x1 + u', 'x3 + u', '-x1*x3']
    model = read(system(SPACE.states, f, {'y': 'x1'}, {'v': 'x3'}, {'u': (-1, 1)}, {}, (),
                        0.1 if discrete else None))
    own = build(model.states, [[Atom(Name(name))] for name in model.states], 2)
    return model, own


@pytest.mark.parametrize('discrete', [False, True])
def test_m_and_M_are_a_galois_pair(discrete):
    model, own = plant(discrete)
    below = {a: m(model, of(*a), own).element for a in (
        ('x1',), ('x2',), ('x1', 'x2'), ('x2', 'x3'), ('x1', 'x3'), ('x1', 'x2', 'x3'))}
    seen = set()
    for b in ('x1', 'x2', 'x3', 'x1*x3', 'x2*x3', 'x1**2', 'x2 + x3'):
        above = M(model, of(b))
        assert yes(delta(model, above, of(b)))
        for a, least in below.items():
            left, right = at_most(SPACE, of(*a), above), at_most(SPACE, least, of(b))
            assert left.verdict is right.verdict, (a, b)
            assert left.verdict is delta(model, of(*a), of(b)).verdict, (a, b)
            seen.add(left.verdict)
    assert seen == {Verdict.YES, Verdict.NO}


MONOMIALS = ('x1', 'x2', 'x3', 'x1*x2', 'x1*x3', 'x2*x3', 'x1**2', 'x3**2', 'u')
RATES = st.lists(st.tuples(st.integers(-2, 2).filter(bool), st.sampled_from(MONOMIALS)),
                 min_size=1, max_size=2, unique_by=lambda term: term[1]).map(
                     lambda terms: '+'.join(f'({k})*{text}' for k, text in terms))
WITHIN = st.lists(st.sampled_from([text for text in MONOMIALS if text != 'u'] + ['x1 + x2*x3']),
                  min_size=1, max_size=2, unique=True)


@settings(max_examples=12, deadline=None)
@given(st.tuples(RATES, RATES, RATES), st.booleans(), WITHIN, WITHIN)
def test_they_are_one_for_any_plant(rates, discrete, a, b):
    """m(a) <= b where a <= M(b), and where (a, b) is in Delta: b is in the dictionary."""
    f = [f'x{i} + 0.1*({rate})' for i, rate in enumerate(rates, 1)] if discrete else list(rates)
    model = read(system(SPACE.states, f, {'y': 'x1'}, {'v': 'x3'}, {'u': (-1, 1)}, {}, (),
                        0.1 if discrete else None))
    own = build(model.states, [[Atom(Name(name))] for name in model.states], 2)
    verdicts = {at_most(SPACE, of(*a), M(model, of(*b))).verdict,
                at_most(SPACE, m(model, of(*a), own).element, of(*b)).verdict,
                delta(model, of(*a), of(*b)).verdict}
    assert not {Verdict.YES, Verdict.NO} <= verdicts, (f, a, b)
    above = M(model, of(*b))
    assert yes(delta(model, above, of(*b)))
    below = m(model, above, own).element  # m M b <= b, and a <= M m a
    assert at_most(SPACE, below, of(*b)).verdict is not Verdict.NO


def told(model, own, span):
    return {f.text for f in Inside(model, own, span).simplest_first(span)} - {'1'}


def test_three_tanks_of_the_paper():
    model = read(three_tanks('x3'))
    own = products(model, 1, False, False)
    assert told(model, own, free_of_unknown(model, own)) == {'x2', 'x3'}
    assert told(model, own, largest(model, own)) == {'x3'}
    both = read(three_tanks('x1', 'x3'))
    with_wanted = Equations([*both.sensors.values(), *both.wanted.values()], both.states)
    found = largest(both, own, with_wanted)  # h* as the paper has it
    assert told(both, own, found) == {'x2', 'x3'}
    inside = Inside(both, own, found)
    assert not inside.told()  # (6) fails, as printed
    assert [f.text for f in closed(inside, [], [Name('x3')])] == ['x3']  # reduced
    # the rest, which the disturbance reaches
    rest = remainder(inside, closed(inside, [], [Name('x3')]), [Name('x1')])
    assert [f.text for f in rest] == ['x1']
    space = Space(both.system.states)
    assert yes(equivalent(space, M(both, element(space, 'x1')),
                          element(space, 'x1 - 0.1*sqrt(x1 - x2)')))
    assert yes(equivalent(space, M(both, element(space, 'x3')),
                          element(space, 'x3 + 0.1*sqrt(x2 - x3) - 0.1*sqrt(x3)')))


def test_three_tanks_give_the_observer_of_the_linear_way():
    observer = find(three_tanks('x3')).observer
    assert observer.phi == ('x3',) and observer.out == {'x3': 'z1'} and observer.only_coordinates
    z, y = np.array([2.0, 1.5]), np.array([3.0, 2.5])
    told = Equations([element(Space({'z1': (0, 9), 'y': (0, 9)}), observer.F[0])[0]],
                     ['z1', 'y']).values(np.array([z, y]))[0]
    assert np.allclose(told, z + 0.1 * np.sqrt(y - z) - 0.1 * np.sqrt(z))  # (28)
