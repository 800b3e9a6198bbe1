"""The slope bounds of the nonlinear terms over boxes: never violated, and tight where known."""

from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros.designer.slopes import jumps, slope_bounds_on
from vsensor_ros.functions.nonlinearity import (
    CATALOGUE,
    evaluate,
    make_term,
    NonlinearTerm,
    slope_bounds,
)

LINE = [[-np.inf, np.inf]]
FIXED = {'min': ', 0.3', 'max': ', 0.3', 'sat': ', -1, 2', 'deadzone': ', 0.5'}


def bounds(text, box, inputs=(), input_box=()):
    return slope_bounds_on(make_term(text, len(box), inputs), np.array(box, float), inputs,
                           np.array(input_box, float).reshape(len(inputs), 2))


@pytest.mark.parametrize('name', [n for n, f in CATALOGUE.items() if f.slope_bounds])
def test_on_the_whole_line_they_are_the_catalogues(name):
    term = make_term(f'{name}(w1{FIXED.get(name, "")})', 1, ())
    low, high = slope_bounds(term)
    found = bounds(term.text, LINE)[0]
    assert found[0] == pytest.approx(low, abs=1e-12)
    if name == 'exp':
        assert found[1] > 1e300  # the catalogue calls that infinite
    else:
        assert found[1] == pytest.approx(high, rel=1e-12)


@pytest.mark.parametrize(('text', 'box', 'expected'), [
    ('sqrt(w1)', [[0.1, 3.0]], [(0.5 / 3**0.5, 0.5 / 0.1**0.5)]),
    ('sqrt(w1)', [[-4.0, 1.0]], [(0.25, np.inf)]),
    ('w1 - sqrt(w1)', [[0.25, 1.0]], [(0.0, 0.5)]),
    ('w1*abs(w1)', LINE, [(0.0, np.inf)]),
    ('w1**2', [[-1.0, 3.0]], [(-2.0, 6.0)]),
    ('w1**3', LINE, [(0.0, np.inf)]),
    ('w1**1.5', [[-4.0, 1.0]], [(0.0, 3.0)]),
    ('1/w1', [[0.5, 2.0]], [(-4.0, -0.25)]),
    ('1/w1', [[-0.5, 2.0]], [(-np.inf, np.inf)]),
    ('w1*w2', [[1.0, 2.0], [-1.0, 3.0]], [(-1.0, 3.0), (1.0, 2.0)]),
    ('sin(w1)', [[0.0, 0.5]], [(np.cos(0.5), 1.0)]),
    ('cos(w1)', [[0.0, 0.5]], [(-np.sin(0.5), 0.0)]),
    ('tan(w1)', [[-0.5, 0.5]], [(1.0, 1.0 + np.tan(0.5)**2)]),
    ('tan(w1)', [[1.0, 2.0]], [(-np.inf, np.inf)]),
    ('atan2(w1, w2)', [[-1.0, 1.0], [-1.0, 1.0]], [(-np.inf, np.inf)] * 2),
    ('log(w1)', [[0.5, 2.0]], [(0.5, 2.0)]),
    ('log(w1)', [[-1.0, 2.0]], [(0.5, 1e6)]),
    ('asin(w1)', [[1.5, 2.0]], [(1.0, 1.0)]),
    ('sign(w1)', [[0.5, 2.0]], [(0.0, 0.0)]),
    ('-2*sign(w1 - 1)', LINE, [(-np.inf, 0.0)]),
    ('sat(w1, -1, 1)', [[-0.5, 1.0]], [(1.0, 1.0)]),
    ('deadzone(w1, 1)', [[-0.5, 1.0]], [(0.0, 0.0)]),
    ('max(w1, w2)', [[2.0, 3.0], [0.0, 1.0]], [(1.0, 1.0), (0.0, 0.0)]),
])
def test_closed_forms(text, box, expected):
    for found, wanted in zip(bounds(text, box), expected):
        assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def test_addend_and_inputs():
    term = NonlinearTerm('', 'w1*u1', np.array([2.0]))
    found = slope_bounds_on(term, np.array(LINE), ('u1',), np.array([[3.0, 5.0]]))
    assert found[0] == pytest.approx((1.0, 3.0))
    unknown = slope_bounds_on(term, np.array(LINE), ('u1',), np.array(LINE))
    assert unknown == ((-np.inf, np.inf),)


def test_a_box_that_is_a_point():
    assert bounds('sqrt(w1)', [[4.0, 4.0]])[0] == pytest.approx((0.25, 0.25))
    assert bounds('abs(w1)', [[0.0, 0.0]])[0] == (-1.0, 1.0)


@pytest.mark.parametrize(('text', 'expected'), [
    ('sign(w1)', True), ('2*sign(w1 - 1) + w1', True), ('sqrt(w1)', False), ('3', False)])
def test_jumps(text, expected):
    assert jumps(make_term(text, 1, ())) is expected


SIMPLE = ('abs', 'sin', 'cos', 'tan', 'asin', 'atan', 'tanh', 'exp', 'log', 'sqrt', 'sign')
trees = st.recursive(
    st.sampled_from(['w1', 'w2', 'u1', '2', '0.3', '(-1.5)']),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(SIMPLE), inner).map(lambda t: f'{t[0]}({t[1]})'),
        st.tuples(inner, st.sampled_from('+-*/'), inner).map(lambda t: f'({t[0]}{t[1]}{t[2]})'),
        st.tuples(inner, st.sampled_from(['2', '3', '0.5', '1.5', '-1', '-2', '0.4']))
        .map(lambda t: f'({t[0]})**({t[1]})'),
        st.tuples(inner, inner).map(lambda t: f'(abs({t[0]}) + 0.1)**{t[1]}'),
        st.tuples(st.sampled_from(['min', 'max', 'atan2', 'deadzone']), inner, inner)
        .map(lambda t: f'{t[0]}({t[1]}, {t[2]})'),
        st.tuples(inner, inner, inner).map(lambda t: f'sat({t[0]}, {t[1]}, {t[2]})')),
    max_leaves=5)
# thousandths: the square of 1e-200 is 0 in floating point, and its inverse is no longer large
ends = st.tuples(st.integers(-3000, 3000), st.integers(0, 4000)).map(
    lambda t: (t[0] / 1000, (t[0] + t[1]) / 1000))


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(text=trees, box=st.tuples(ends, ends, ends), seed=st.integers(0, 2**32 - 1))
def test_no_difference_quotient_leaves_its_bounds(text, box, seed):
    """Two points of the box that differ in one argument only, for expressions of any shape."""
    try:
        term = make_term(text, 2, ('u1',))
    except ValueError:  # a constant part without a value
        return
    box = np.array(box)
    found = slope_bounds_on(term, box[:2], ('u1',), box[2:])
    rng = np.random.default_rng(seed)
    low, high = box[:, :1], box[:, 1:]
    points = low + rng.choice([0.0, 1.0, 0.5, rng.random()], size=(3, 60)) * (high - low)
    for j in range(2):
        moved = points.copy()
        moved[j] = low[j] + rng.random(60) * (high - low)[j]
        a, b = (evaluate(term, p[:2], ('u1',), p[2:]) for p in (points, moved))
        run = points[j] - moved[j]
        clear = np.abs(run) > 1e-6  # rounding within the function drowns a smaller run
        with np.errstate(all='ignore'):
            rise = (a - b) * np.sign(run)
            slack = 1e-9 * (np.abs(a) + np.abs(b)) + 1e-7 * np.abs(run) + 1e-12
            least, most = (np.multiply(end, np.abs(run)) for end in found[j])
            judged = clear & np.isfinite(rise)
            assert np.all(~judged | (rise >= least - slack))
            assert np.all(~judged | (rise <= most + slack))
