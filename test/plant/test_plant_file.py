"""Plant files: those that come with the package, and every way to get one wrong."""

import json
import os
from pathlib import Path
import re

from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import parse
from vsensor_ros.plant import load_plant, Plant
from vsensor_ros.plant.plain_name import plain_name

ROOT = Path(__file__).parents[2]
REFERENCE = json.loads((ROOT / 'test' / 'reference.json').read_text())

TANK = """
name: tank
time: continuous
parameters: {b: 2.0, area: {value: 4, unit: m^2}}
states:
  level1: {unit: m, initial: 2.0}
  level2: {unit: m, initial: 1.0}
inputs:
  u1: {unit: m^3/s, operating: 0.5}
disturbances:
  leak: {unit: m/s}
dynamics:
  level1: u1/area - b*sqrt(level1 - level2)
  level2: b*sqrt(level1 - level2) - sqrt(level2) + leak
sensors:
  y1: {measures: level1, noise: 1e-3}
  y2: {measures: level1 - 2*level2, unit: m}
"""

ARRAYS = """
name: tank
time: {sample_time: 0.5}
parameters: {b: 0.5}
states: {level1: {}, level2: {}}
inputs: {u1: {}}
matrices:
  A: [[1, 0], [b, 1 - b]]
  B: [[1], [0]]
  C: [[1, 0]]
  P: [[-1], [b]]
nonlinearities:
  - {function: sqrt(w1 + u1), of: [level1 - level2]}
sensors: {y1: {}}
"""


def written(tmp_path, text):
    path = tmp_path / 'plant.yaml'
    if isinstance(text, bytes):
        path.write_bytes(text)
    else:
        path.write_text(text, encoding='utf-8')
    return path


def test_tank_is_the_papers():
    plant = load_plant(ROOT / 'config/three_tank/plant.yaml')
    assert plant.A.tolist() == [[-1, 1, 0], [1, -2, 1], [0, 1, -2]]
    assert plant.B.tolist() == [[1, 0], [0, 1], [0, 0]]
    assert plant.C.tolist() == [[0, 1, 0], [0, 0, 1]]
    assert plant.D.shape == (3, 0)
    # the paper writes psi = -sqrt(w) + w, the file's terms are sqrt(w) - w
    assert (-plant.P).tolist() == [[1, 0, 0], [-1, 1, 0], [0, -1, 1]]
    assert [g.tolist() for g in plant.G] == [[[1, -1, 0]], [[0, 1, -1]], [[0, 0, 1]]]
    assert [t.text for t in plant.terms] == ['sqrt(w1)'] * 3
    assert [t.slope.tolist() for t in plant.terms] == [[1.0]] * 3
    x, u = [5.0, 3.0, 1.0], [0.5, 0.2]
    assert np.allclose(plant.rate_of_change(x, u), [0.5 - 2**0.5, 0.2, 2**0.5 - 1], atol=1e-14)
    # the operating point is an equilibrium
    assert np.allclose(plant.rate_of_change(plant.operating_point, plant.operating_input), 0)


def test_tank_has_the_papers_observer():
    # (E1) of the design of the paper, with its numbers: Phi A = N Phi + J C0
    plant = load_plant(ROOT / 'config/three_tank/plant.yaml')
    paper = REFERENCE['b_tank_continuous']['JCF_paper']
    Phi, N = np.array(paper['Phi']), np.array(paper['N_closed_loop'])
    remainder = Phi @ plant.A - N @ Phi
    assert not remainder[:, :2].any()    # only the healthy y2 = level3 is left
    assert np.allclose(np.abs(Phi @ plant.P), np.abs(paper['Pstar']))
    assert np.allclose(Phi @ plant.B, paper['Bstar'])


def test_servo_is_the_papers():
    plant = load_plant(ROOT / 'config/servo/plant.yaml')
    assert plant.A.tolist() == [[0, 1, 0], [0, -1, 1], [0, -1, -1]]
    assert plant.B.tolist() == [[0], [0], [1]]
    assert plant.D.tolist() == [[1], [0], [0]]
    assert plant.P.tolist() == [[0], [-1], [0]]
    assert plant.G[0].tolist() == [[0, 1, 0]]
    assert plant.terms[0].text == 'sign(w1)' and plant.terms[0].slope.tolist() == [0.0]
    assert plant.units['y2'] == 'rad/s'


def test_discrete_tank_is_the_papers_corrected():
    plant = load_plant(ROOT / 'config/three_tank_discrete/plant.yaml')
    assert plant.sample_time == 1.0
    assert np.allclose(plant.A, [[0.9, 0.1, 0], [0.1, 0.8, 0.1], [0, 0.1, 0.8]], atol=1e-15)
    assert plant.B.tolist() == [[0.1, 0], [0, 0.2], [0, 0]]
    assert plant.D.tolist() == [[1], [0], [0]]
    x = np.array(REFERENCE['c_tank_discrete']['sim_paper']['x']['0'])
    samples = REFERENCE['c_tank_discrete']['sim_paper']['x']
    for t in range(50):
        x = plant.rate_of_change(x, [1 + np.sin(t)] * 2)
    assert np.allclose(x, samples['50'], rtol=1e-6)


@pytest.mark.parametrize('path', sorted(ROOT.glob('config/*/plant.yaml')),
                         ids=lambda path: path.parent.name)
def test_every_plant_file_loads(path):
    plant = load_plant(path)
    assert plant.hash() == load_plant(str(path)).hash()
    assert np.isfinite(plant.rate_of_change(plant.initial, plant.operating_input)).all()


def test_what_is_read(tmp_path):
    plant = load_plant(written(tmp_path, TANK))
    assert plant.name == 'tank' and plant.sample_time is None
    assert plant.parameters == {'b': 2.0, 'area': 4.0}
    assert plant.initial.tolist() == [2.0, 1.0]
    assert plant.noise[0] == 1e-3 and np.isnan(plant.noise[1])
    assert plant.C.tolist() == [[1, 0], [1, -2]]
    assert plant.units == {'level1': 'm', 'level2': 'm', 'u1': 'm^3/s', 'leak': 'm/s',
                           'y1': 'm', 'y2': 'm'}
    assert plant.operating_input.tolist() == [0.5]
    # slopes at the initial guess: 0.5/sqrt(1) both
    assert plant.A.tolist() == [[-1, 1], [1, -1.5]]


def test_matrices(tmp_path):
    plant = load_plant(written(tmp_path, ARRAYS))
    assert plant.sample_time == 0.5
    assert plant.A.tolist() == [[1, 0], [0.5, 0.5]]
    assert plant.terms[0].name == 'sqrt(level1 - level2 + u1)'
    assert plant.terms[0].slope.tolist() == [0.0]
    moved = load_plant(written(tmp_path, ARRAYS + 'operating_point: {level1: 0.25}'))
    assert moved.terms[0].slope.tolist() == [1.0]
    assert moved.A.tolist() == [[0, 1], [1, 0]]
    for x, u in (([3.0, 1.0], [0.5]), ([0.2, 0.9], [-1.0])):
        assert np.allclose(plant.rate_of_change(x, u), moved.rate_of_change(x, u), atol=1e-14)


def test_flat_columns_and_rows(tmp_path):
    flat = ARRAYS.replace('[[1], [0]]', '[1, 0]').replace('[[1, 0]]', '[1, 0]').replace(
        '[[-1], [b]]', '[-1, b]')
    assert flat.count('[[') == 1    # A
    plants = [load_plant(written(tmp_path, text)) for text in (ARRAYS, flat)]
    assert plants[0].hash() == plants[1].hash()


def test_both_examples_of_the_documentation_are_one_plant(tmp_path):
    text = (ROOT / 'docs/plant_file.md').read_text()
    whole, matrices, *_ = re.findall(r'```yaml\n(.*?)```', text, re.DOTALL)
    other = re.sub(r'dynamics:.*?(?=sensors:)', lambda _: matrices, whole, flags=re.DOTALL)
    assert 'matrices:' in other and 'dynamics:' not in other
    plants = [load_plant(written(tmp_path, each)) for each in (whole, other)]
    assert plants[0].hash() == plants[1].hash()
    assert plants[0].B.tolist() == [[0], [25]] and plants[0].noise[0] == 0.001
    assert plants[0].Cu.tolist() == [[0], [0], [2]] and plants[0].process_noise[1] == 0.01
    assert plants[0].ranges[1].tolist() == [-50, 50]


def test_the_other_examples_of_the_documentation_are_read(tmp_path):
    text = (ROOT / 'docs/plant_file.md').read_text()
    sensors, battery, definitions = re.findall(r'```yaml\n(.*?)```', text, re.DOTALL)[2:]
    plant = load_plant(written(tmp_path, """
name: all
time: continuous
parameters: {level_max: 2, mass: 3}
states:
  level: {}
  charge: {range: [0.05, 1], initial: 0.5}
  temperature: {range: [0, 90], initial: 20}
inputs: {force: {}, current: {}}
dynamics: {level: force, charge: -current/3600, temperature: -temperature}
""" + sensors))
    assert set(plant.curves) == set(plant.sensors)
    assert plant.curves['current_loop'].shown(8.0) == 12.0
    plant = load_plant(written(tmp_path, """
name: all
time: continuous
parameters: {charge: 1e5, R0: 0.002, R1: 0.0015, tau: 40}
""" + battery))
    assert [term.name for term in plant.terms] == ['slope(ocv)*current'] and not plant.curves
    plant = load_plant(written(tmp_path, """
name: all
time: continuous
states: {concentration: {}, temperature: {initial: 100}, flow: {}}
inputs: {feed: {}}
sensors: {y: concentration}
""" + definitions + '  temperature: -temperature\n  flow: pump - flow\n'))
    assert [term.name for term in plant.terms] == ['rate*concentration', 'pump']


def test_a_sensor_may_read_inputs_and_disturbances(tmp_path):
    text = TANK.replace('measures: level1,', 'measures: b*u1/area - level1 + 3*(leak - u1),')
    plant = load_plant(written(tmp_path, text))
    assert plant.C.tolist() == [[-1, 0], [1, -2]]
    assert plant.Cu.tolist() == [[-2.5], [0]] and plant.Cd.tolist() == [[3], [0]]
    assert plant.units['y1'] == ''
    alone = load_plant(written(tmp_path, TANK.replace('measures: level1,', 'measures: leak,')))
    assert not alone.C[0].any() and alone.Cd.tolist() == [[1], [0]]
    assert alone.units['y1'] == 'm/s'


def test_direct_reading_as_matrices(tmp_path):
    text = ARRAYS.replace('inputs: {u1: {}}', 'inputs: {u1: {}}\ndisturbances: {rho: {}, tau: {}}')
    text = text.replace('  P:', '  D: [[1, 0], [0, 0]]\n  Cu: [b]\n  Cd: [0, 2*b]\n  P:')
    plant = load_plant(written(tmp_path, text))
    assert plant.Cu.tolist() == [[0.5]] and plant.Cd.tolist() == [[0, 1]]
    by_name = load_plant(written(tmp_path, text.replace('C: [[1, 0]]', '').replace(
        'Cu: [b]', '').replace('Cd: [0, 2*b]', '').replace(
        '{y1: {}}', '{y1: b*(2*level1 + u1 + 2*tau)}')))
    assert by_name.hash() == plant.hash()


def test_noise_and_range_of_a_state(tmp_path):
    text = TANK.replace('initial: 2.0', 'initial: 2.0, process_noise: b/100, range: [0, 5*b]'
                        ).replace('initial: 1.0', 'range: [null, 3]')
    plant = load_plant(written(tmp_path, text))
    assert plant.process_noise[0] == 0.02 and np.isnan(plant.process_noise[1])
    assert plant.ranges.tolist() == [[0, 10], [-np.inf, 3]]
    plain = load_plant(written(tmp_path, TANK))
    assert np.isnan(plain.process_noise).all() and np.isinf(plain.ranges).all()
    assert np.isinf(plain.input_range).all() and np.isinf(plain.disturbance_range).all()
    driven = load_plant(written(tmp_path, TANK.replace('operating: 0.5', 'range: [0, b]').replace(
        'leak: {', 'leak: {range: [null, 1], ')))
    assert driven.input_range.tolist() == [[0, 2]]
    assert driven.disturbance_range.tolist() == [[-np.inf, 1]]


def test_a_sensor_that_wraps(tmp_path):
    plant = load_plant(written(tmp_path, TANK.replace('noise: 1e-3', 'wrap: 2*pi').replace(
        'unit: m}', 'unit: m, wrap: 4*area}')))
    assert plant.wrap == pytest.approx([2 * np.pi, 16.0])
    assert plant.angles() == ({'y1': plant.wrap[0]}, {'y2': plant.wrap[1]})
    assert np.isnan(load_plant(written(tmp_path, TANK)).wrap).all()


def test_a_state_called_on(tmp_path):
    text = TANK.replace('level1', 'on').replace('  on:', "  'on':").replace(' on,', " 'on',")
    assert load_plant(written(tmp_path, text)).states == ('on', 'level2')


def test_parameters_may_use_earlier_ones(tmp_path):
    text = TANK.replace('{b: 2.0,', '{b: 2.0, c: sqrt(b)*3e-1, d: c/pi,')
    assert load_plant(written(tmp_path, text)).parameters['d'] == pytest.approx(
        2**0.5 * 0.3 / np.pi)


NAMED = TANK.replace('dynamics:', """definitions:
  head: level1 - level2
  flow: {value: b*sqrt(head), unit: m/s}
  drag: 0.1*sign(level2)
  both: 2*flow + drag + head
dynamics:""").replace('u1/area - b*sqrt(level1 - level2)', 'u1/area - both + flow').replace(
    'level2: b*sqrt(level1 - level2) -', 'level2: flow*level2 + tanh(flow) - drag -')
PLAIN = TANK.replace('u1/area - b*sqrt(level1 - level2)', 'u1/area - 2*b*sqrt(level1 - level2) '
                     '- 0.1*sign(level2) - (level1 - level2) + b*sqrt(level1 - level2)').replace(
    'level2: b*sqrt(level1 - level2) -', 'level2: b*sqrt(level1 - level2)*level2 '
    '+ tanh(b*sqrt(level1 - level2)) - 0.1*sign(level2) -')


def test_definitions_are_printed_by_name_and_change_nothing(tmp_path):
    named, plain = (load_plant(written(tmp_path, text)) for text in (NAMED, PLAIN))
    assert sorted(t.name for t in named.terms) == [
        'flow', 'flow*level2', 'sign(level2)', 'sqrt(level2)', 'tanh(flow)']
    x, u = np.random.default_rng(1).uniform(0, 3, (2, 2, 50)), np.ones((1, 50))
    assert np.allclose(named.rate_of_change(x[0], u), plain.rate_of_change(x[0], u), atol=1e-12)
    assert np.allclose(named.A, plain.A) and np.array_equal(named.C, plain.C)


def test_elements_of_arrays_and_whole_arrays(tmp_path):
    listed = TANK.replace('b: 2.0,', 'k: [1, 4/2, [3, 4]], b: "k[1]*k[2][1]/4",')
    plant = load_plant(written(tmp_path, listed))
    assert plant.parameters == {'k[0]': 1, 'k[1]': 2, 'k[2][0]': 3, 'k[2][1]': 4, 'b': 2,
                                'area': 4}
    assert plant.hash() == load_plant(written(tmp_path, TANK)).hash()
    whole = ARRAYS.replace('{b: 0.5}', '{b: 0.5, M: [[1, 0], [0.5, 0.5]]}').replace(
        '[[1, 0], [b, 1 - b]]', 'M')
    assert load_plant(written(tmp_path, whole)).hash() == \
        load_plant(written(tmp_path, ARRAYS)).hash()


@pytest.mark.parametrize('text, factor, name', [
    ('2*w1*(4*w1)', 0.25, '0.5*v*v'), ('tanh(2*w1)*(2*w1)', 0.5, 'tanh(v)*v'),
    ('exp(w1)*3', 1.0, 'exp(v)*3'), ('2*(w1/3)', 1.0, '2*(v/3)'), ('2*w1', 0.5, 'v')])
def test_numbers_that_meet_in_the_name_of_a_term_are_one(text, factor, name):
    assert plain_name(parse(text), np.array([[factor]]), ('v',)) == name


def test_terms_are_told_in_the_words_of_the_file(tmp_path):
    plant = load_plant(written(tmp_path, """
name: reactor
time: continuous
parameters: {E: 9758.3, zero: 273.15, k: 364.74651940633856, full: 5.1, row: [3, 4]}
states: {ca: {}, tr: {}}
inputs: {flow: {}}
dynamics:
  ca: flow*(full - ca) - k*exp(-E/(tr + zero))*ca
  tr: -tr - sin(k*tr/7)*1.23456789*abs(row[1]*tr - 2*pi) + 2*zero
sensors: {thermometer: {measures: tr}}
"""))
    assert [t.name for t in plant.terms] == [
        'flow*(full - ca)', 'exp(-E/(tr + zero))*ca', 'sin(k*tr/7)*abs(row[1]*tr - 2*pi)',
        'constant']
    assert plant.terms[2].text == 'sin(w1)*abs(w2 - 6.283185307179586)'


def test_a_long_term_has_a_short_name_with_its_number(tmp_path):
    made = Plant.from_matrices(
        -np.eye(4), np.eye(4)[:, :1], np.eye(4), P=np.eye(4)[:, [0, 0, 1]], inputs=('flow',),
        G=[[1, 0, 0, 0], [[1, 0, 0, 0], [0, 0, 1, 0]], np.eye(4)],
        nonlinearities=['sqrt(w1)', 'exp(-9758.3/(w2 + 273.15))*w1*sqrt(w1)*flow',
                        'exp(-9758.3/(w2 + 273.15))*w1*sqrt(w3)*w4'])
    assert [t.short for t in made.terms] == ['sqrt(x1)', 'term 2 (of x1, x3, flow)',
                                             'term 3 (of x1, x2, x3, ..)']
    assert made.part([0, 2], [0], [], [1]).terms[0].short == 'term 2 (of x1, x3, flow)'


def test_rates_may_be_per_hour(tmp_path):
    per = [load_plant(written(tmp_path, text.replace('initial: 2.0', 'process_noise: 0.3')))
           for text in (TANK, TANK.replace('time: continuous', 'time: continuous\ntime_unit: h'))]
    x, u = [3.0, 1.0], [0.5]
    assert per[1].rate_of_change(x, u) == pytest.approx(per[0].rate_of_change(x, u) / 3600)
    assert np.allclose(per[1].A, per[0].A / 3600) and per[1].process_noise[0] == 0.3 / 60


POINTS = '[[0, 3.0], [1, 5.0], [3, 6.0]]'


@pytest.mark.parametrize('shape', ['linear', 'cubic'])
def test_lookup_tables_in_equations_and_sensors(tmp_path, shape):
    text = TANK.replace('{b: 2.0,', f'{{points: {POINTS}, b: 2.0,').replace('dynamics:', (
        f'definitions: {{pump: {{value: level1 - level2, table: points, interpolation: {shape}}}}}'
        '\ndynamics:')).replace('u1/area -', 'u1/area - b*pump -').replace(
        'initial: 2.0', 'initial: 2.0, range: [0, 3]').replace(
        'measures: level1,', f'measures: level1, table: {POINTS}, interpolation: {shape},')
    plant = load_plant(written(tmp_path, text))
    if shape == 'linear':
        def table(x):
            return np.interp(x, [0, 1, 3], [3, 5, 6])
    else:
        table = PchipInterpolator([0, 1, 3], [3, 5, 6])
    bare = load_plant(written(tmp_path, TANK))
    assert 'pump' in [term.name for term in plant.terms]
    for level in (1.2, 2.0, 3.9):
        x = [level, 1.0]
        assert plant.rate_of_change(x, [0.0])[0] == pytest.approx(
            bare.rate_of_change(x, [0.0])[0] - 2 * table(level - 1.0))
    curve = plant.curves['y1']
    at = np.linspace(0.1, 2.9, 7)
    assert [curve.shown(plant.C[0, 0] * level) for level in at] == pytest.approx(list(table(at)))
    assert [curve.linear(float(table(level))) / plant.C[0, 0] for level in at] == \
        pytest.approx(list(at))
    assert plant.units['y1'] == ''


@pytest.mark.parametrize('shape', ['linear', 'cubic'])
def test_tables_are_called_by_name_as_functions_are(tmp_path, shape):
    """Whether a table is called or stands in a definition and a sensor: the same plant."""
    section = f'tables: {{head: {{points: points, interpolation: {shape}}}}}'
    called = TANK.replace('{b: 2.0,', f'{{points: {POINTS}, b: 2.0,').replace(
        'dynamics:', f'{section}\ndynamics:').replace(
        'u1/area -', 'u1/area - b*head(level1 - level2) -').replace(
        'initial: 2.0', 'initial: 2.0, range: [0, 3]').replace(
        'measures: level1,', 'measures: head(level1) - u1/area,')
    plant = load_plant(written(tmp_path, called))
    assert [t.name for t in plant.terms] == ['head(level1 - level2)', 'sqrt(level1 - level2)',
                                             'sqrt(level2)']
    apart = called.replace(section, (
        'definitions: {pump: {value: level1 - level2, table: points, '
        f'interpolation: {shape}}}}}')).replace('head(level1 - level2)', 'pump')
    apart = apart.replace('head(level1) - u1/area', 'level1').replace(
        'noise: 1e-3', f'noise: 1e-3, table: points, interpolation: {shape}')
    other = load_plant(written(tmp_path, apart))
    x = np.array([2.3, 1.1])
    assert np.allclose(plant.rate_of_change(x, [0.5]), other.rate_of_change(x, [0.5]))
    known, alike = plant.curves['y1'], other.curves['y1']
    assert known.beside == {'u1': -0.25} and known.shown(2.0, 0.1) - 0.1 == pytest.approx(
        alike.shown(1.9))


CHANGES = [
    ('dynamics:', 'tables: {level1: [[0, 1], [1, 2]]}\ndynamics:', 'is also one of the'),
    ('dynamics:', 'tables: {sin: [[0, 1], [1, 2]]}\ndynamics:', 'sin is a word of the expression'),
    ('dynamics:', 'tables: {f: [[0, 1], [0, 2]]}\ndynamics:',
     'tables.f: the table has points that do not rise in x'),
    ('dynamics:', 'tables: {f: {points: 5}}\ndynamics:', 'tables.f.points: 5 is no list of po'),
    ('dynamics:', 'tables: {f: {interpolation: cubic}}\ndynamics:', 'tables.f.points: is missing'),
    ('dynamics:\n  level1: ', 'tables: {f: [[0, 1], [1, 2]]}\ndynamics:\n  level1: f + ',
     'f is a function; write f(...)'),
    ('dynamics:\n  level1: ', 'tables: {f: [[0, 1], [1, 2]]}\ndynamics:\n  level1: f(1, 2) + ',
     'f is given 2 arguments; it takes 1'),
    ('dynamics:\n  level1: ', 'tables: {head: [[0, 1], [1, 2]]}\ndynamics:\n  level1: haed(1) + ',
     "the function 'haed' is not in the language; did you mean head?"),
    ('dynamics:', 'definitions: {level1: 2}\ndynamics:', 'definitions: level1 is also one of the'),
    ('dynamics:', 'definitions: {f: g}\ndynamics:', "definitions.f: unknown name 'g'"),
    ('dynamics:', 'definitions: {f: {unit: m}}\ndynamics:', 'definitions.f.value: is missing'),
    ('measures: level1,', 'measures: level1, table: [[0, 1], [0, 2]],',
     'sensors.y1.table: the table has points that do not rise in x; give [x, y] by rising x'),
    ('measures: level1,', 'measures: level1, table: [[0, 1]],', 'does not have 2 to 100 points'),
    ('measures: level1,', 'measures: level1, table: 5,', 'table: 5 is no list of points'),
    ('measures: level1,', 'measures: level1, interpolation: cubic,', 'stands there without a t'),
    ('measures: level1,', 'measures: level1, table: [[0, 1], [1, 2]], interpolation: quartic,',
     "sensors.y1.interpolation: 'quartic' is not known; write linear or cubic"),
    ('measures: level1,', 'measures: level1, delay: -1,', 'sensors.y1.delay: -1 is negative'),
    ('measures: level1,', 'measures: level1, stamp_offset: -1,', 'stamp_offset: -1 is negative'),
    ('measures: level1,', 'measures: level1, rate: 0,', 'sensors.y1.rate: 0 is not above 0'),
    ('operating: 0.5', 'delay: -1', 'inputs.u1.delay: -1 is negative'),
    ('time: continuous', 'time: {sample_time: 0.3}\ntime_unit: h', 'stands beside a sample time'),
    ('time: continuous', 'time: continuous\ntime_unit: year', "time_unit: 'year' is not known"),
    ('time: continuous', 'time: continuous\ntime_unit: [s]', "time_unit: ['s'] is not known"),
    ('measures: level1,', 'measures: level1, table: [[0, 1], [1, 2]], interpolation: [cubic],',
     "sensors.y1.interpolation: ['cubic'] is not known; write linear or cubic"),
    ('dynamics:', 'definitions: {f: g, g: level1}\ndynamics:', 'definitions.f: g is not known '
     'yet; a definition may use earlier ones only'),
    ('measures: level1,', 'measures: exp(u1),', "'exp(u1)' is a curve of commands alone"),
    ('b: 2.0', 'b: 1:30', "line 4: YAML reads '1:30' as a number to the base of 60"),
    ('b: 2.0', 'b: 1:30.5', 'to the base of 60; write a plain number'),
    ('b: 2.0', 'b: 010', "YAML reads '010' as a number to the base of 8; leave out the zeros"),
    ('b: 2.0', 'b: [[[1]]]', 'parameters.b[0][0]: is a list in a list in a list'),
    ('b: 2.0', 'b: [2]', "unknown name 'b'; known names: level1, level2, u1, leak, b[0], area"),
    # (old text, new text, what the line says)
    ('name: tank', '', 'name: is missing; write name: my_plant'),
    ('name: tank', 'name: [1]', 'name: [1] is not a text of one line'),
    ('name: tank', 'name: ""', 'name: is empty'),
    ('time: continuous', '', 'time: is missing; write continuous or'),
    ('time: continuous', 'time: often', "time: 'often' is not understood"),
    ('time: continuous', 'time: {sample_time: -1}', 'time.sample_time: -1 is not positive'),
    ('time: continuous', 'time: {period: 1}', "time: unknown key 'period'; known: sample_time"),
    ('time: continuous', 'time: {}', 'time.sample_time: is missing; give seconds'),
    ('dynamics:', 'dynamic:', "unknown key 'dynamic'; did you mean dynamics?"),
    ('dynamics:', 'description:', 'description: '),
    ('  level2: b*sqrt', '  level3: b*sqrt', "unknown state 'level3'; did you mean level"),
    ('  level2: b*sqrt(level1 - level2) - sqrt(level2) + leak\n', '',
     'dynamics.level2: is missing; write one equation a state'),
    ('leak\nsensors', 'lake\nsensors', "dynamics.level2: unknown name 'lake'; did you mean leak?"),
    ('u1/area', 'u1/aera', "dynamics.level1: unknown name 'aera'; did you mean area? known names: "
     'level1, level2, u1, leak, b, area'),
    ('u1/area', "__import__('os')", "dynamics.level1: the function '__import__' is not in the"),
    ('u1/area', 'u1/(b - 2)', 'dynamics.level1: '),
    ('u1/area', 'u1*exp(999)', 'dynamics.level1: '),
    ('  y2:', '  y1:', "line 17: 'y1' stands there twice (first in line 16); give each name once"),
    ('inputs:', 'states:', "'states' stands there twice"),
    ('measures: level1,', 'measures: b,', "'b' holds no state"),
    ('measures: level1,', 'measures: 0,', '0 holds no state'),
    ('measures: level1,', 'measures: u9,', "sensors.y1.measures: unknown name 'u9'"),
    ('measures: level1,', 'measures: u1 - u1,', 'holds no state, input, disturbance'),
    ('initial: 2.0', 'process_noise: -1', 'states.level1.process_noise: -1 is negative'),
    ('initial: 2.0', 'process_noise: .inf', 'states.level1.process_noise: inf is not finite'),
    ('initial: 2.0', 'process_noise: level2', "process_noise: unknown name 'level2'"),
    ('initial: 2.0', 'range: 3', 'states.level1.range: 3 is not two numbers; write [low, high]'),
    ('initial: 2.0', 'range: [1, 2, 3]', 'states.level1.range: [1, 2, 3] is not two numbers'),
    ('initial: 2.0', 'range: null', 'states.level1.range: None is not two numbers'),
    ('initial: 2.0', 'range: [b, 2]', 'states.level1.range: 2 is not below 2'),
    ('initial: 2.0', 'range: [.nan, 2]', 'states.level1.range: nan is not finite'),
    ('initial: 2.0', 'range: [0, 1e76]', 'ranges: holds a number beyond 1e+75'),
    ('initial: 2.0', 'slow: maybe', "states.level1.slow: 'maybe' is neither true nor false"),
    ('initial: 2.0', 'slow: [true]', 'line 6: YAML reads true as a truth value'),
    ('unit: m^3/s,', 'slow: true,', "inputs.u1: unknown key 'slow'"),
    ('noise: 1e-3', 'tolerance: 0', 'sensors.y1.tolerance: 0 is not positive'),
    ('noise: 1e-3', 'tolerance: b - 3', 'sensors.y1.tolerance: -1 is not positive'),
    ('noise: 1e-3', 'tolerance: much', "sensors.y1.tolerance: unknown name 'much'"),
    ('unit: m^3/s,', 'range: [1, 0],', 'inputs.u1.range: 1 is not below 0'),
    ('leak: {', 'leak: {range: 1, ', 'disturbances.leak.range: 1 is not two numbers'),
    ('measures: level1,', '', 'sensors.y1.measures: is missing; say which state'),
    ('measures: level1,', 'mesures: level1,', "unknown key 'mesures'; did you mean measures?"),
    ('measures: level1,', 'measures: level1, unit: 5,', 'sensors.y1.unit: 5 is not a text'),
    ('noise: 1e-3', 'noise: -1', 'sensors.y1.noise: -1 is negative'),
    ('noise: 1e-3', 'wrap: 0', 'sensors.y1.wrap: 0 is not above 0; give what a turn is'),
    ('noise: 1e-3', 'wrap: level1', "sensors.y1.wrap: unknown name 'level1'"),
    ('noise: 1e-3', 'noise: .nan', 'sensors.y1.noise: nan is not finite'),
    ('noise: 1e-3', 'noise: much', "sensors.y1.noise: unknown name 'much'"),
    ('noise: 1e-3', 'noise: [1]', 'sensors.y1.noise: [1] is not an expression'),
    ('noise: 1e-3', 'noise: yes', 'line 16: YAML reads yes as a truth value'),
    ('noise: 1e-3', 'noise: 2001-01-01', 'sensors.y1.noise: '),
    ('noise: 1e-3', 'noise: 2001-99-99', 'holds a value that cannot be read'),
    ('noise: 1e-3', 'noise: ' + '9' * 5000, ''),
    ('noise: 1e-3', 'noise: 1e999', 'sensors.y1.noise: a number in it is too large'),
    ('initial: 2.0', 'initial: .inf', 'states.level1.initial: inf is not finite'),
    ('initial: 2.0', 'intial: 2.0', "states.level1: unknown key 'intial'; did you mean initial?"),
    ('b: 2.0', 'b: c', "parameters.b: unknown name 'c'; known names: none"),
    ('b: 2.0', 'b: -.inf', 'parameters.b: -inf is not finite'),
    ('b: 2.0', 'b: {unit: m}', 'parameters.b.value: is missing'),
    ('b: 2.0', 'b: 9**9**9**9', 'parameters.b: '),
    ('b: 2.0', 'level1: 2.0', 'parameters: level1 is also one of the states'),
    ('b: 2.0', 'if: 2.0', 'parameters: if is a word of the expression language'),
    ('b: 2.0', '1b: 2.0', "parameters: '1b' is not a name"),
    ('b: 2.0', 'on: 2.0', "line 4: YAML reads on as a truth value (so with on, off, "
     "yes, no); write 'on'"),
    ('b: 2.0', '[1, 2]: 2.0', 'line 4: is not YAML'),
    ('b: 2.0', 'b: 1e76', 'holds a number beyond 1e+75'),
    ('b: 2.0', '"b\\n": 2.0', 'is not a name'),
    ('  u1:', '  level1:', 'inputs: level1 is also one of the states'),
    ('  u1: {unit: m^3/s, operating: 0.5}', '  - u1', 'inputs: '),
    ('  level1: {unit: m, initial: 2.0}', '  level1: 2.0', 'states.level1: 2.0 is not a mapping'),
    ('operating: 0.5', 'operating: .nan', 'inputs.u1.operating: nan is not finite'),
    ('  y1: {', '  level1: {unit: cm, ', 'sensors.level1.unit: '),
    ('  y1: {', '  u1: {', 'sensors: u1 is also one of the inputs'),
    ('sensors:', 'operating_point: {level9: 1}\nsensors:',
     "operating_point: unknown state 'level9'"),
    ('sensors:', 'operating_point: 4\nsensors:', 'operating_point: 4 is not a mapping'),
    ('sensors:', 'matrices: {}\nsensors:', 'dynamics: and matrices are both there'),
    ('sensors:', 'nonlinearities: []\nsensors:', 'nonlinearities: stands beside dynamics'),
    ('name: tank', 'name: !!python/object/apply:os.system [ls]', 'is not YAML'),
    ('name: tank', 'name: &a tank\ndescription: *a', 'line 3: an alias (*) is not read here'),
    ('name: tank', 'name: tank: x', 'line 2: is not YAML'),
    ('name: tank', '\tname: tank', 'is not YAML'),
    ('name: tank', '--- \nname: tank\n---', 'is not YAML'),
    ('name: tank', 'name: "a\\nb"', 'name: '),
]


def test_definitions_that_explode_stand_in_dynamics_only(tmp_path):
    """They are never written out: each is worked out once."""
    exploding = 'definitions:\n  d0: sin(level1/2)/4\n' + ''.join(
        f'  d{i + 1}: d{i}*d{i} + d0\n' for i in range(99)) + 'dynamics:'
    text = TANK.replace('dynamics:', exploding)
    plant = load_plant(written(tmp_path, text.replace('u1/area', 'u1/area + d99')))
    assert plant.unwritten == ('level1_rate',) and any(
        'too large to be written out' in remark for remark in plant.remarks)
    d = d0 = np.sin(1.0) / 4
    for _ in range(99):
        d = d * d + d0
    rest = load_plant(written(tmp_path, TANK))
    at = plant.operating_point, plant.operating_input
    assert plant.rate_of_change(*at) - rest.rate_of_change(*at) == pytest.approx([d, 0.0])
    refused(written(tmp_path, text.replace('measures: level1,', 'measures: d99,')),
            'sensors.y1.measures: d99 is too large with its definitions written out')


@pytest.mark.parametrize(('old', 'new', 'needle'), CHANGES, ids=range(len(CHANGES)))
def test_a_bad_file_gives_one_line(tmp_path, old, new, needle):
    assert old in TANK
    path = written(tmp_path, TANK.replace(old, new, 1))
    refused(path, needle)


def refused(path, needle):
    with pytest.raises(BadInput) as refusal:
        load_plant(path)
    line = str(refusal.value)
    assert line.startswith(f'{path}: ') and line.isprintable() and '; ' in line
    assert needle in line
    assert len(line) < 500 + len(str(path))


@pytest.mark.parametrize(('old', 'new', 'needle'), [
    ('A: [[1, 0], [b, 1 - b]]', 'A: [[1, 0]]', 'matrices.A: is not 2 rows of 2 numbers'),
    ('A: [[1, 0], [b, 1 - b]]', 'A: [[1, 0], [b, .nan]]', 'matrices.A[1][1]: nan is not finite'),
    ('A: [[1, 0], [b, 1 - b]]', 'A: [[1, 0], [b, q]]', "matrices.A[1][1]: unknown name 'q'"),
    ('A: [[1, 0], [b, 1 - b]]', 'Z: 0', "matrices: unknown key 'Z'"),
    ('A: [[1, 0], [b, 1 - b]]', '', 'matrices.A: is missing'),
    ('B: [[1], [0]]', 'B: [1, 0, 0]', 'matrices.B: is not 2 rows of 1 numbers'),
    ('A: [[1, 0], [b, 1 - b]]', 'A: [1, 0]', 'matrices.A: is not 2 rows of 2 numbers'),
    ('A: [[1, 0], [b, 1 - b]]', 'A: [[1e76, 0], [b, b]]', 'A: holds a number beyond 1e+75'),
    ('B: [[1], [0]]', 'B: 5', 'matrices.B: is not 2 rows of 1 numbers'),
    ('C: [[1, 0]]', 'C: [[1]]', 'matrices.C: is not 1 rows of 2 numbers'),
    ('C: [[1, 0]]', '', 'sensors.y1.measures: is missing'),
    ('C: [[1, 0]]', 'Cu: [[1]]', 'matrices.C: is missing'),
    ('C: [[1, 0]]', 'C: [[1, 0]]\n  Cu: [[1, 0]]', 'matrices.Cu: is not 1 rows of 1 numbers'),
    ('C: [[1, 0]]', 'C: [[1, 0]]\n  Cd: [[1]]', 'matrices.Cd: is not 1 rows of 0 numbers'),
    ('C: [[1, 0]]', 'C: [[1, 0]]\n  Cu: [[w]]', "matrices.Cu[0][0]: unknown name 'w'"),
    ('P: [[-1], [b]]', '', 'matrices.P: is missing'),
    ('{y1: {}}', '{y1: level1}', 'sensors.y1.measures: stands beside matrices.C'),
    ('{y1: {}}', '{}', 'sensors: is missing or empty'),
    ('states: {level1: {}, level2: {}}', '', 'states: is missing or empty'),
    ('sqrt(w1 + u1)', 'sqrt(w2)', "nonlinearities[0].function: unknown name 'w2'"),
    ('sqrt(w1 + u1)', 'sqrt(level1)', "unknown name 'level1'; known names: w1, u1, b"),
    ('function: sqrt(w1 + u1), ', '', 'nonlinearities[0].function: is missing'),
    ('[level1 - level2]', '[level1*level2]', 'nonlinearities[0].of: '),
    ('[level1 - level2]', '[level1 - 1]', 'has an offset'),
    ('  - {function', '  a: {function', 'nonlinearities: is not a list'),
])
def test_bad_matrices_give_one_line(tmp_path, old, new, needle):
    assert old in ARRAYS
    refused(written(tmp_path, ARRAYS.replace(old, new, 1)), needle)


LAUGHS = 'a: &a [x, x, x]\n' + ''.join(
    f'{chr(98 + i)}: &{chr(98 + i)} [{", ".join(["*" + chr(97 + i)] * 9)}]\n' for i in range(9))


@pytest.mark.parametrize(('content', 'needle'), [
    ('', 'is empty'),
    ('# nothing\n', 'is empty'),
    ('just a text', 'is not a mapping'),
    ('- a\n- list\n', 'is not a mapping'),
    ('{', 'is not YAML'),
    ('name: "open', 'is not YAML'),
    (b'\x00\x01\x02', 'is not a text file: line 1, character 0x00;'),
    (b'\xff\xfe\xfd\x80', 'is not UTF-8: line 1, byte 0xff;'),
    (b'\x89PNG\r\n\x1a\n', 'is not UTF-8: line 1, byte 0x89;'),
    ('[' * 50000, 'nested too deeply'),
    ('{a: ' * 5000, 'nested too deeply'),
    ('- ' * 5000, 'nested too deeply'),
    ('x' * (2**20 + 1), 'is larger than 1 MiB'),
    (LAUGHS, 'an alias (*) is not read here'),
    ('&a [*a]', 'an alias (*) is not read here'),
    ('states: {' + ', '.join(f's{i}: {{}}' for i in range(1001)) + '}\nname: a\ntime: continuous',
     'states: has 1001 entries'),
], ids=range(16))
def test_what_is_no_plant_file_at_all(tmp_path, content, needle):
    refused(written(tmp_path, content), needle)


def test_missing_directory_and_forbidden(tmp_path):
    refused(tmp_path / 'none.yaml', 'cannot be read (No such file or directory)')
    refused(tmp_path, 'cannot be read (Is a directory)')
    path = written(tmp_path, TANK)
    path.chmod(0)
    if not os.access(path, os.R_OK):    # root may read everything
        refused(path, 'cannot be read (Permission denied)')


@settings(deadline=None, max_examples=100,
          suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.data())
def test_a_mangled_file_loads_or_gives_one_line(tmp_path, data):
    text = data.draw(st.sampled_from([TANK, ARRAYS]))
    at = data.draw(st.integers(0, len(text)))
    cut = data.draw(st.integers(0, 12))
    put = data.draw(st.text(alphabet='abu12 :-+*/(){}[],.\n\'"&!|>#%@\\\t=lev', max_size=8))
    path = written(tmp_path, text[:at] + put + text[at + cut:])
    try:
        plant = load_plant(path)
    except BadInput as error:
        line = str(error)
        assert line.startswith(f'{path}: ') and line.isprintable()
    else:
        assert np.isfinite(plant.A).all()
