"""The expression language: what it accepts, how it prints, what it computes."""

import math

from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.catalogue import CATALOGUE
from vsensor_ros.functions.expression import (
    Apply,
    compile_expression,
    fold,
    gradient,
    Name,
    names,
    negate,
    Number,
    parse,
    substitute,
    to_text,
    to_words,
)

RELAXED = settings(deadline=None, suppress_health_check=[
    HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large])
VARIABLES = ('x', 'y', 'level_1')
finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
leaves = st.one_of(finite.map(Number), st.sampled_from(VARIABLES).map(Name))


def applied(children):
    calls = [st.tuples(*[children] * f.arity).map(lambda a, n=name: Apply(n, a))
             for name, f in CATALOGUE.items()]
    operators = st.builds(lambda op, a, b: Apply(op, (a, b)),
                          st.sampled_from(['+', '-', '*', '/', '**']), children, children)
    return st.one_of(operators, children.map(negate), *calls)


nodes = st.recursive(leaves, applied, max_leaves=12)


def valued(node):
    """Whether every constant part has a value: only then parse accepts the text."""
    try:
        fold(node)
    except BadInput:
        return False
    return True


@RELAXED
@given(nodes.filter(valued))
def test_printed_text_reads_back(node):
    assert parse(to_text(node)) == node


@RELAXED
@given(nodes.filter(valued), st.lists(st.floats(-5, 5), min_size=3, max_size=3))
def test_folding_does_not_change_the_value(node, values):
    whole = compile_expression(node, VARIABLES)
    folded = compile_expression(fold(node), VARIABLES)
    with np.errstate(all='ignore'):
        assert np.array_equal(whole(values), folded(values), equal_nan=True)


@RELAXED
@given(st.text(max_size=60))
def test_any_text_is_read_or_refused_in_one_line(text):
    try:
        parse(text, 'file', 'key')
    except BadInput as error:
        line = str(error)
        assert line.startswith('file: key: ') and line.isprintable()


PLAIN = {'+': float.__add__, '-': float.__sub__, '*': float.__mul__, 'neg': float.__neg__,
         'sin': math.sin, 'cos': math.cos, 'atan': math.atan, 'tanh': math.tanh, 'abs': abs,
         'atan2': math.atan2, 'min': min, 'max': max}
arithmetic = st.recursive(
    st.one_of(st.floats(-9, 9).map(Number), st.sampled_from(VARIABLES).map(Name)),
    lambda c: st.one_of(
        st.builds(lambda op, a, b: Apply(op, (a, b)),
                  st.sampled_from(['+', '-', '*', 'atan2', 'min', 'max']), c, c),
        st.builds(lambda n, a: Apply(n, (a,)),
                  st.sampled_from(['sin', 'cos', 'atan', 'tanh', 'abs']), c),
        c.map(negate)),
    max_leaves=10)


def by_the_book(node, at):
    if isinstance(node, Number):
        return node.value
    if isinstance(node, Name):
        return at[node.id]
    return PLAIN[node.function](*[by_the_book(a, at) for a in node.arguments])


@RELAXED
@given(arithmetic, st.lists(st.floats(-5, 5), min_size=3, max_size=3))
def test_compiled_text_computes_what_it_says(node, values):
    truth = by_the_book(node, dict(zip(VARIABLES, values)))
    ours = compile_expression(to_text(node), VARIABLES)(values)
    assert float(ours) == pytest.approx(truth, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(('text', 'needle'), [
    ("__import__('os')", "'__import__' is not in the language"),
    ("__import__('os').system('x')", 'attribute'),
    ('x.real', 'attribute'),
    ('().__class__', 'attribute'),
    ('lambda: 1', 'lambda'),
    ('[x for x in y]', 'comprehension'),
    ('{x: y for x in y}', 'comprehension'),
    ('(x for x in y)', 'comprehension'),
    ('[x]', 'a list'),
    ('x[0]', "unknown name 'x[0]'"),
    ('x[y]', 'an index that is no whole number'),
    ('x[1.5]', 'an index that is no whole number'),
    ('sin(x)[0]', 'an index of what is no name'),
    ('x if y else 1', 'if ... else'),
    ('x < y', 'a comparison'),
    ('x and y', 'and / or'),
    ('not x', 'not'),
    ('x % 2', '%'),
    ('x // 2', '//'),
    ('x ^ 2', 'a power is written **'),
    ('0,5', 'a decimal is written with a point'),
    ('(x := 1)', ':='),
    ('x = 1', 'cannot be read'),
    ("'text'", "'text' is not in the language"),
    ('f"{x}"', 'a text'),
    ('True', 'True is not in the language'),
    ('None', 'None is not in the language'),
    ('...', 'is not in the language'),
    ('1j', 'is not in the language'),
    ('sin(*x)', 'a star'),
    ('sin(x=1)', 'a keyword'),
    ('sin(x, y)', 'it takes 1'),
    ('atan2(x)', 'it takes 2'),
    ('sin(x)(y)', 'a call of a call'),
    ('sin', 'sin is a function'),
    ('sqr(x)', 'did you mean sqrt?'),
    ('x # y', "'#' is not in the language"),
    ('x\0', 'cannot be read'),
    ('\u03bb', 'is not in the language'),
    ('', 'empty'),
    ('   ', 'empty'),
    ('(', 'cannot be read'),
    ('9**9**9**9', 'has no value (too large)'),
    ('exp(x) + 2**9999', 'has no value (too large)'),
    ('x/0', "'x/0' has no value (domain: divisor not 0)"),
    ('1/(2 - 2)', "'1/0' has no value (domain: divisor not 0)"),
    ('sat(x, 1, -1)', "'sat(x, 1, -1)' has no value (domain: low <= high)"),
    ('deadzone(x, 1 - 3)', "'deadzone(x, -2)' has no value (domain: width >= 0)"),
    ('sqrt(-4)', 'has no value (domain: x >= 0)'),
    ('1e999', 'too large'),
    ('9'*400, 'too large'),
    ('+'.join(['x']*60), 'more than 50 deep'),
    ('sin('*60 + 'x' + ')'*60, 'more than 50 deep'),
    ('-'*60 + 'x', 'more than 50 deep'),
    ('-'*1990 + 'x', ''),
    ('('*990 + 'x' + ')'*990, ''),
    ('x' + '+x'*4000, 'keep it within 8000'),
    ('z', "unknown name 'z'; known names: x, y, level_1"),
    ('level1', 'did you mean level_1?'),
    (float('nan'), 'nan is not finite'),
    (float('inf'), 'inf is not finite'),
    (True, 'True is not an expression'),
    (None, 'None is not an expression'),
    ([1.0], 'is not an expression'),
])
def test_refused_with_one_line(text, needle):
    with pytest.raises(BadInput) as refusal:
        parse(text, 'plant.yaml', 'dynamics.x', known=VARIABLES)
    line = str(refusal.value)
    assert needle in line
    assert line.startswith('plant.yaml: dynamics.x: ')
    assert line.isprintable() and '; ' in line and len(line) < 400


@pytest.mark.parametrize(('text', 'value'), [
    ('1e-3', 1e-3), ('2 + 3*4', 14.0), ('-2**2', -4.0), ('2**-1', 0.5), ('2**3**2', 512.0),
    ('8/4/2', 1.0), ('8 - 4 - 2', 2.0), ('pi', math.pi), ('sat(3, -1, 2)', 2.0),
    ('deadzone(-3, 1)', -2.0), ('max(1, min(5, 3))', 3.0), ('atan2(1, -1)', 0.75 * math.pi),
    ('+1', 1.0), (' 1\n+ 2 ', 3.0), (7, 7.0), ((-27) ** 3, -19683.0)])
def test_constants(text, value):
    assert fold(parse(text)) == Number(pytest.approx(value, rel=1e-15))


def test_constants_refuse_only_what_they_decide_alone():
    for text in ('sat(x, y, -1)', 'sat(x, 1, 1)', 'deadzone(x, 0)', '(-1)**x', '0**x', 'x**-1'):
        assert to_text(fold(parse(text))) == text
    with pytest.raises(BadInput, match='low <= high'):
        fold(substitute(parse('sat(x, -y, y)'), {'y': -1.0}))


def test_names_and_substitution_at_once():
    node = parse('x*y + sqrt(x)')
    assert names(node) == ('x', 'y')
    swapped = substitute(node, {'x': Name('y'), 'y': Name('x')})
    assert to_text(swapped) == 'y*x + sqrt(y)'
    assert fold(substitute(node, {'x': 4.0, 'y': 0.5})) == Number(4.0)


def test_compiled_works_on_arrays():
    f = compile_expression('sat(x, 0, 1) - y/2', ('y', 'x'))
    assert np.array_equal(f([np.array([2.0, 4.0]), np.array([0.5, 9.0])]), [-0.5, -1.0])
    with pytest.raises(BadInput, match='unknown name'):
        compile_expression('z', ('x',))
    with pytest.raises(BadInput, match='unknown name'):
        compile_expression(Name('z'), ('x',))


smooth = st.recursive(
    st.one_of(st.floats(-1, 1).map(Number), st.sampled_from(VARIABLES).map(Name)),
    lambda c: st.one_of(
        st.builds(lambda op, a, b: Apply(op, (a, b)), st.sampled_from('+-*'), c, c),
        st.builds(lambda n, a: Apply(n, (a,)),
                  st.sampled_from(['sin', 'cos', 'tanh', 'atan', 'neg']), c)),
    max_leaves=5)


@RELAXED
@given(smooth, st.floats(-1, 1), st.floats(-1, 1))
def test_gradient_is_the_limit_of_difference_quotients(node, x, y):
    at = {'x': x, 'y': y, 'level_1': 0.5}
    _, slope = gradient(node, at, ('x', 'y'))
    h = 1e-5
    for i, name in enumerate(('x', 'y')):
        up, down = (gradient(node, {**at, name: at[name] + s * h}, ())[0] for s in (1, -1))
        assert slope[i] == pytest.approx((up - down) / (2 * h), rel=1e-4, abs=1e-4)


@pytest.mark.parametrize(('text', 'words'), [
    ('-(2*x) + 3', '-2*x + 3'), ('x - -(2*y)', 'x - -2*y'), ('-(x**2)', '-x**2'),
    ('(-x)**2', '(-x)**2'), ('-(x + y)', '-(x + y)'), ('1.0000000001*x + 2', 'x + 2'),
    ('x*-(2*y)', 'x*(-2*y)'), ('0.3333333333333*x', '0.333333*x'), ('-k*x', '-k*x'),
    ('2*pi*k**2*x', '2*pi*k**2*x'), ('sin(x)/(1 - k/4)', 'sin(x)/(1 - k/4)'),
    ('bend(k*x)', 'bend(k*x)'), ('bend(2) + x', 'bend(2) + x')])
def test_words_are_those_of_who_wrote_it_and_mean_the_same(text, words):
    """Parameters and tables keep their names, whatever becomes of their numbers."""
    tables = {'bend': ('table', tuple(map(Number, (0.0, 1.0, 2.0, 5.0))))}
    node = fold(substitute(parse(text, tables=tables), {'k': 3.0}))
    assert to_words(node) == words and 'k' not in names(node)
    again = substitute(parse(words, tables=tables), {'k': 3.0})
    values = [1.3, 1.7]
    assert compile_expression(again, ('x', 'y'))(values) == pytest.approx(
        compile_expression(node, ('x', 'y'))(values), rel=1e-5)
