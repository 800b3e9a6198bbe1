"""One entry a function: the docs say what it says, and an entry is all that a function needs."""

import math
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import Bank
from vsensor_ros.designer.certificate import certify
from vsensor_ros.designer.slopes import slope_bounds_on
from vsensor_ros.functions.catalogue import CATALOGUE
from vsensor_ros.functions.expression import compile_expression, parse, to_text
from vsensor_ros.functions.function import Function
from vsensor_ros.functions.interval import add, around, RISING, times
from vsensor_ros.functions.nonlinearity import (
    evaluate,
    make_term,
    outside_domain,
    set_valued,
    slope_at,
)
from vsensor_ros.functions.operators import OPERATORS
from vsensor_ros.simulate import simulate

ENTRIES = {**CATALOGUE, **OPERATORS}
DOCS = Path(__file__).parents[2] / 'docs' / 'plant_file.md'


def test_the_docs_say_what_the_entries_say():
    """Paste what is missing; the table stands under 'Expressions' in the docs."""
    lines = DOCS.read_text(encoding='utf-8').splitlines()
    start = lines.index('| function | meaning | domain | outside it |') + 2
    table = lines[start:lines.index('', start)]
    assert table == [entry.row for entry in ENTRIES.values()]


@pytest.mark.parametrize('name', ENTRIES)
def test_an_entry_is_whole(name):
    entry = ENTRIES[name]
    assert entry.name == name and entry.meaning and entry.domain
    assert len(entry.slopes) == entry.arity == len(set(entry.arguments))
    value, slopes = entry.bounds(*[(0.25, 0.5)] * entry.arity)
    assert len(slopes) == entry.arity
    at = entry.value(*[0.375] * entry.arity)
    assert value[0] <= at <= value[1]
    assert (entry.outside is None) == (entry.continuation == '')
    assert (entry.precedence is None) == (name in CATALOGUE)


def test_the_entries_need_numpy_alone():
    """The machine loads them at every start."""
    rooms = sorted(path.stem for path in (DOCS.parents[1] / 'vsensor_ros/functions').glob('*.py'))
    code = f"""
import importlib, sys
import numpy
before = set(sys.modules)
for name in {[name for name in rooms if name != '__init__']}:
    importlib.import_module('vsensor_ros.functions.' + name)
loaded = {{name.split('.')[0] for name in sys.modules.keys() - before}}
print(sorted(loaded - {{'vsensor_ros', 'numpy'}} - sys.stdlib_module_names))
"""
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          timeout=120)
    assert done.stdout == '[]\n', done.stdout + done.stderr


def cube_bounds(x):
    square = times(x, x) if x[0] >= 0 or x[1] <= 0 else (0.0, max(x[0] * x[0], x[1] * x[1]))
    return around(x[0] ** 3, x[1] ** 3), (add(square, add(square, square)),)


CUBE = Function(
    'cube', ('x',), 'third power, for small x', lambda x: np.clip(x, -100.0, 100.0) ** 3,
    slopes=(lambda x: 3.0 * x * x,), bounds=cube_bounds, slope_bounds=RISING,
    outside=lambda x: np.abs(x) > 100.0, domain='-100 <= x <= 100', continuation='constant')


@pytest.fixture
def cube(monkeypatch):
    monkeypatch.setitem(CATALOGUE, 'cube', CUBE)


def test_without_its_entry_a_function_is_none():
    with pytest.raises(BadInput, match="'cube' is not in the language"):
        parse('cube(x)')


def test_one_entry_is_enough_for_the_language(cube):
    node = parse('2*cube(x + 1) - y', known=('x', 'y'))
    assert to_text(node) == '2*cube(x + 1) - y'
    assert compile_expression(node, ('x', 'y'))([2.0, 4.0]) == 50.0
    with pytest.raises(BadInput, match='it takes 1'):
        parse('cube(x, y)')
    with pytest.raises(BadInput, match='domain: -100 <= x <= 100'):
        parse('cube(101)')
    with pytest.raises(BadInput, match='and the functions .*, cube'):
        parse('x % 2')
    with pytest.raises(BadInput, match='cube is a word of the expression language'):
        Plant.from_matrices([[-1.0]], None, [[1.0]], states=['cube'])


def test_one_entry_is_enough_for_terms_and_their_slopes(cube):
    term = make_term('cube(w1)', 1, ())
    assert evaluate(term, [[2.0, -3.0]], (), ()).tolist() == [8.0, -27.0]
    assert slope_at(term, [2.0], (), ()) == 12.0
    assert outside_domain(term, [[99.0, -101.0]], (), ()).tolist() == [False, True]
    assert not set_valued(term)
    bounds = slope_bounds_on(term, np.array([[-1.0, 2.0]]), (), np.zeros((0, 2)))
    assert bounds[0] == pytest.approx((0.0, 12.0))


SPRING = """
name: spring
time: continuous
states: {angle: {initial: 1.0}, lag: {range: [-2, 2]}}
inputs: {torque: {}}
dynamics:
  angle: -cube(angle) + torque
  lag: angle - lag - 0.1*cube(lag)
sensors: {encoder: {measures: angle}, meter: {measures: lag}}
"""


def test_one_entry_is_enough_from_the_plant_file_to_the_bank(cube, tmp_path):
    (tmp_path / 'plant.yaml').write_text(SPRING)
    plant = load_plant(tmp_path / 'plant.yaml')
    time = np.linspace(0.0, 3.0, 61)
    x = simulate(plant, time)
    assert x[:, 0] == pytest.approx(1.0 / np.sqrt(1.0 + 2.0 * time), rel=1e-8)
    made = design(plant)
    made.save(tmp_path / 'design.json')
    sensor = Design.load(tmp_path / 'design.json')['meter', 'meter']
    assert {sensor.terms[i].text for i in sensor.active} == {'cube(w1)'}
    certificate = certify(plant, sensor)
    assert certificate.status != 'none' and 0.5 < certificate.rate < math.inf
    bank = Bank(made, 20.0)
    for k, angle in enumerate(x[:, 0]):
        bank.take('encoder', k * bank.period, float(angle))
        bank.take('torque', k * bank.period, 0.0)
        bank.advance(k * bank.period)
    estimate = bank.estimate(('meter',), 'meter')
    assert estimate == pytest.approx(x[-1, 1], abs=2e-3) and x[-1, 1] > 0.3


RELAY = Function(
    'relay', ('x',), '-3, 0 or 3', lambda x: 3.0 * np.sign(x),
    slopes=(lambda x: math.nan if x == 0.0 else 0.0,),
    bounds=lambda x: ((3.0 * float(np.sign(x[0])), 3.0 * float(np.sign(x[1]))),
                      (RISING if x[0] <= 0.0 <= x[1] else (0.0, 0.0),)),
    slope_bounds=RISING, set_valued=True)


def test_a_set_valued_function_other_than_sign_is_refused(monkeypatch, tmp_path):
    """The step and the simulation would hold it within -1..1, as if it were a sign."""
    path = tmp_path / 'plant.yaml'
    path.write_text(SPRING.replace('0.1*cube(lag)', '0.1*sign(lag)').replace('cube', 'atan'))
    made = tmp_path / 'design.json'
    design(load_plant(path)).save(made)
    monkeypatch.setitem(CATALOGUE, 'relay', RELAY)
    for file in (path, made):
        file.write_text(file.read_text().replace('sign(', 'relay('))
    for load, file in ((load_plant, path), (Design.load, made)):
        with pytest.raises(BadInput, match='relay is set-valued, which only sign may be; write it '
                           'with sign') as caught:
            load(file)
        assert str(caught.value).startswith(f'{file}: ')
    with pytest.raises(BadInput, match='relay is set-valued'):
        Plant.from_matrices([[-1.0]], None, [[1.0]], G=[[1.0]], P=[[1.0]],
                            nonlinearities=['relay(w1)'])
