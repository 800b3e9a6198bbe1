"""Takagi-Sugeno plants: what is refused, and that submodels of equations are the equations."""

from hypothesis import given, strategies as st
import numpy as np
import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.plant import (
    from_equations,
    grid_memberships,
    load_plant,
    load_takagi_sugeno,
    TakagiSugeno,
)

CRANE = """
name: crane
states:
  a: {range: [-0.5, 1.5]}
  b: {range: [-2, 2]}
  c: {range: [-3, 1]}
inputs: {u: {range: [-1, 1]}}
disturbances: {load: }
dynamics:
  a: -a + K*b*(c + 2) - b*c
  b: sin(a)*u - 2*b + (1 + a)*load + a**2*b
  c: -c/2 + K*a*b - 3*(1 + cos(a))
parameters: {K: 0.7}
sensors: {sa: {measures: a}, sb: {measures: b}}
"""


def plant_of(tmp_path, text):
    path = tmp_path / 'plant.yaml'
    path.write_text('time: continuous' + text)
    return load_plant(path)


def test_submodels_are_the_equations_for_whichever_premises(tmp_path):
    crane = plant_of(tmp_path, CRANE.replace('+ (1 + a)*load', '+ load'))
    random = np.random.default_rng(5)
    for healthy in (None, ('a', 'b'), ('a', 'c')):
        made = from_equations(crane, healthy)
        x = random.uniform(crane.ranges[:, :1], crane.ranges[:, 1:], (3, 300))
        u, rho = random.uniform(-1, 1, (1, 300)), random.normal(size=(1, 300))
        a, b, c = x
        truth = [-a + 0.7 * b * (c + 2) - b * c,
                 np.sin(a) * u[0] - 2 * b + rho[0] + a**2 * b,
                 -c / 2 + 0.7 * a * b - 3 * (1 + np.cos(a))]
        assert made.rate_of_change(x, u, rho) == pytest.approx(np.array(truth), abs=1e-9)
        h = made.weights(made.premises_of(x, u))
        assert h.min() > -1e-12 and abs(h.sum(axis=0) - 1).max() < 1e-12
        if healthy:
            assert set(made.premises) <= {*healthy, 'u'}


def test_number_of_submodels_is_said_and_same_ones_are_merged(tmp_path):
    head = ('\nname: p\nstates: {x: {range: [0, 2]}, y: {range: [0, 2]}}\nsensors: {s: x}\n')
    made = from_equations(plant_of(tmp_path, head + 'dynamics: {x: -x + x*y - y*x, y: -y*x}\n'),
                          ('x',))
    assert len(made.A) == 2 and made.premises == ('x',)  # what cancels is no sector
    assert made.remarks == ('2 submodels of x',)
    assert sorted(made.A[:, 1, 1]) == [-2.0, 0.0]
    head = head.replace('x: {range: [0, 2]}', 'x: {range: [0, 1]}')
    made = from_equations(plant_of(
        tmp_path, head + 'dynamics: {x: -x, y: -3*y + x*y + x*x*y}\n'), ('x',))
    assert made.remarks == ('3 submodels of x, x*x; 1 coincided',)
    assert made.weights(np.array([[0.3]])).sum() == pytest.approx(1.0, abs=1e-12)


def test_what_cannot_be_submodels_is_refused_in_one_line(tmp_path):
    crane = plant_of(tmp_path, CRANE.replace('+ (1 + a)*load', '+ load')
                     .replace('range: [-0.5, 1.5]', ''))
    with pytest.raises(BadInput, match='a.range: is open, and a is a premise'):
        from_equations(crane)
    with pytest.raises(BadInput, match='dynamics: are not known as equations'):
        from_equations(type(crane).from_matrices(-np.eye(2), None, [[1, 0]]))
    long = ''.join(f' + cos({k}*x)*y' for k in range(1, 8))
    head = ('\nname: p\nstates: {x: {range: [0, 2]}, y: {range: [0, 2]}}\nsensors: {s: x}\n')
    with pytest.raises(BadInput, match='make 128 submodels'):
        from_equations(plant_of(tmp_path, head + f'dynamics: {{x: -x, y: "-y{long}"}}\n'), ('x',))


def test_an_unknown_input_may_be_scheduled(tmp_path):
    made = from_equations(plant_of(
        tmp_path, '\nname: p\nstates: {x: {range: [0, 2]}}\ndisturbances: {d: }\n'
        'sensors: {s: x}\nmatrices: {A: [[-1]], C: [[1]]}\n'.replace(
            'matrices: {A: [[-1]], C: [[1]]}', 'dynamics: {x: -x + d}')))
    assert made.E.shape == (1, 1, 1) and made.E[0, 0, 0] == 1.0


@pytest.mark.parametrize('change, line', [
    ({'memberships': ['x1', '1 - x1*x1']}, 'memberships: sum to 1.25 at x1 = 0.4'),
    ({'memberships': ['2*x1', '1 - 2*x1']}, r'memberships\[1\]: is -1 at x1 = 1'),
    ({'memberships': ['x1', '1 - z']}, r"memberships\[1\]: unknown name 'z'"),
    ({'memberships': ['x1', '__import__("os")']}, r'memberships\[1\]: '),
    ({'memberships': ['x1']}, 'memberships: are 1; give 2'),
    ({'premises': {'x1': [0, np.inf]}}, 'premises: have a range that is open'),
    ({'premises': {'x1': [1, 0]}}, 'premises: .*give low < high'),
    ({'premises': {'other': [0, 1]}}, "premises: 'other' is no state and no input"),
    ({'A': [[[-1.0]], [[-2.0, 0.0]]]}, 'A: are none, or not of one shape'),
    ({'B': [[[1.0]]]}, r'B: has shape \(1, 1, 1\); give one of 1 rows for each of the 2'),
])
def test_bad_submodels_are_refused_in_one_line(change, line):
    good = {'A': [[[-1.0]], [[-2.0]]], 'B': None, 'C': [[1.0]], 'premises': {'x1': [0, 1]},
            'memberships': ['x1', '1 - x1']}
    assert TakagiSugeno.of_submodels(**good).weights(np.array([[0.25]])) == pytest.approx(
        np.array([[0.25], [0.75]]))
    with pytest.raises(BadInput, match=line) as raised:
        TakagiSugeno.of_submodels(**{**good, **change})
    assert '\n' not in str(raised.value)


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=5, unique_by=lambda v: round(v, 2)),
       st.lists(st.floats(-10, 10), min_size=2, max_size=3, unique_by=lambda v: round(v, 2)))
def test_grids_blend_what_is_bilinear_exactly(xs, ys):
    axes = {'x1': sorted(xs), 'x2': sorted(ys)}
    values = [[[a + 2 * b - a * b]] for a in axes['x1'] for b in axes['x2']]
    made = TakagiSugeno.of_submodels(
        [np.diag([v[0][0], 0.0]) for v in values], None, [[1, 0]],
        premises={name: [axis[0], axis[-1]] for name, axis in axes.items()},
        memberships=grid_memberships(axes))
    at = made.points(20)
    h = made.weights(at)
    assert h.min() >= -1e-12
    blended = np.einsum('vk,v->k', h, made.A[:, 0, 0])
    assert blended == pytest.approx(at[0] + 2 * at[1] - at[0] * at[1], abs=1e-8)


TANK = """
name: tank
time: {sample_time: 0.5}
parameters: {k: 0.2}
states: {level: {unit: m}, outflow: }
inputs: {pump: }
disturbances: {leak: }
sensors: {gauge: level, meter: {measures: 2*outflow}}
premises: {level: [1, 3]}
submodels:
  - {A: [[1 - k, 0], [k, 0.5]], B: [k, 0], D: [1, 0], membership: (3 - level)/2}
  - {A: [[1 - 2*k, 0], [k, 0.5]], B: [k, 0], D: [1, 0], offset: [0, 1], membership: (level - 1)/2}
"""
GRID = TANK.replace('premises: {level: [1, 3]}', 'grid: {level: [1, 3]}').replace(
    ', membership: (3 - level)/2', '').replace(', membership: (level - 1)/2', '')


@pytest.mark.parametrize('text', [TANK, GRID])
def test_submodels_are_read_from_a_file(tmp_path, text):
    path = tmp_path / 'tank.yaml'
    path.write_text(text)
    tank = load_takagi_sugeno(path)
    assert tank.sample_time == 0.5 and tank.C.tolist() == [[1, 0], [0, 2]]
    x, u, rho = np.array([[1.5], [1.0]]), np.array([[2.0]]), np.array([[0.1]])
    assert tank.rate_of_change(x, u, rho)[:, 0] == pytest.approx(
        [(1 - 0.2 * 1.25) * 1.5 + 0.4 + 0.1, 0.3 + 0.5 + 0.25])
    assert not tank.inside(np.array([[0.9, 3.1]])).any()


@pytest.mark.parametrize('old, new, line', [
    ('(3 - level)/2', '(4 - level)/2', 'memberships: sum to 1.5 at level = 1'),
    ('(3 - level)/2', '(3 - pump)/2', r"submodels\[0\].membership: unknown name 'pump'"),
    ('[1, 3]', '[3, 1]', 'premises: .*give low < high'),
    ('[1, 3]', '[1, 2, 3]', r'premises.level: are 3 numbers; write \[low, high\]'),
    ('{level: [1, 3]}', '{height: [1, 3]}', "premises: unknown state or input 'height'"),
    ('premises', 'grid', r"submodels\[0\]: unknown key 'membership'"),
    ('premises: {level: [1, 3]}', '', 'premises: must stand there, or grid, and not both'),
    ('offset: [0, 1]', 'offset: [0]', r'submodels\[1\].offset: '),
    ('[k, 0.5]]', '[k]]', r'submodels\[0\].A: is not 2 rows of 2 numbers'),
    ('name: tank', '', 'name: is missing'),
])
def test_what_is_wrong_in_the_file_gets_one_line(tmp_path, old, new, line):
    path = tmp_path / 'tank.yaml'
    path.write_text(TANK.replace(old, new, 1))
    with pytest.raises(BadInput, match=line) as raised:
        load_takagi_sugeno(path)
    assert str(raised.value).startswith(str(path)) and '\n' not in str(raised.value)


def test_a_grid_has_a_submodel_for_each_point(tmp_path):
    path = tmp_path / 'tank.yaml'
    path.write_text(GRID.replace('[1, 3]', '[1, 2, 3]'))
    with pytest.raises(BadInput, match='submodels: are 2; give 3, one a point of the grid'):
        load_takagi_sugeno(path)


def test_a_plant_file_without_submodels_is_told_so(tmp_path):
    (tmp_path / 'plant.yaml').write_text('name: cart\ndynamics: {v: u}\n')
    with pytest.raises(BadInput, match='submodels: are missing'):
        load_takagi_sugeno(tmp_path / 'plant.yaml')
