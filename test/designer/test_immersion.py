"""Cosine and sine in place of an angle: the same equations, handed out where that is a gain."""

import json
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.advice import advice
from vsensor_ros.designer.extended import model_of, of_angle
from vsensor_ros.designer.immersion import check, immersed
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import parse
from vsensor_ros.observers import ExtendedSensor
from vsensor_ros.report.design_answer import answer

CART = """
name: cart
time: continuous
parameters: {lever: {value: 0.3, spread: 0.01}, slip: 0.1}
states:
  x: {process_noise: 0.01}
  y: {process_noise: 0.01}
  heading: {unit: rad, process_noise: 0.01}
  speed: {process_noise: 0.5}
inputs: {turn: {process_noise: 0.01}, lean: {}}
dynamics:
  x: speed*cos(heading + slip*turn) - lever*turn*sin(heading)
  y: speed*sin(lean - heading)
  heading: turn
  speed: -speed
sensors:
  east: {measures: x, noise: 0.02}
  north: {measures: y, noise: 0.02}
  compass: {measures: 2*heading, unit: rad, noise: 0.02, wrap: 4*pi}
  odometer: {measures: speed, noise: 0.02}
"""


@pytest.fixture(name='plant_of')
def _plant_of(tmp_path):
    def plant_of(*changes):
        text = CART
        for before, after in changes:
            assert before in text
            text = text.replace(before, after)
        path = tmp_path / 'plant.yaml'
        path.write_text(text, encoding='utf-8')
        return load_plant(path)
    return plant_of


def of(plant, lost='compass'):
    return immersed(model_of(plant, plant.spreads), 'heading',
                    [name != lost for name in plant.sensors])


def values(model, rng):
    """Return what its equations say at random points, and these by name."""
    names = (*model.states, *model.inputs, *model.unknown, *model.parameters)
    at = dict(zip(names, rng.uniform(-3.0, 3.0, (len(names), 50))))
    at['heading'] = rng.uniform(-9.0, 9.0, 50)
    at['cos_heading'], at['sin_heading'] = np.cos(at['heading']), np.sin(at['heading'])
    found = Equations([parse(text) for text in model.equations], names).values(
        np.array([at[name] for name in names]))
    return dict(zip(model.states, found)), at


def test_the_equations_are_the_same(plant_of):
    model = of(plant_of())
    assert model.states == ('x', 'y', 'cos_heading', 'speed', 'sin_heading')
    said, at = values(model, np.random.default_rng(0))
    th, v, w = at['heading'], at['speed'], at['turn']
    np.testing.assert_allclose(said['x'], v * np.cos(th + 0.1 * w) - at['lever'] * w * np.sin(th))
    np.testing.assert_allclose(said['y'], v * np.sin(at['lean'] - th), atol=1e-12)
    np.testing.assert_allclose(said['cos_heading'], -w * np.sin(th))
    np.testing.assert_allclose(said['sin_heading'], w * np.cos(th))
    np.testing.assert_array_equal(model.factors, [0.0, 0.0, 2.0, 0.0])
    assert not model.C[2].any() and model.parameters == ('lever',)


def test_in_steps_it_is_turned_by_each(plant_of):
    model = of(plant_of(
        ('time: continuous', 'time: {sample_time: 0.1}'), ('heading: turn', 'heading: heading + '
        '0.1*turn'), ('x: speed', 'x: x + 0.1*speed'), ('speed: -speed', 'speed: 0.9*speed')))
    said, at = values(model, np.random.default_rng(1))
    after = at['heading'] + 0.1 * at['turn']
    np.testing.assert_allclose(said['cos_heading'], np.cos(after), atol=1e-12)
    np.testing.assert_allclose(said['sin_heading'], np.sin(after), atol=1e-12)


def test_equations_that_are_not_the_same_are_found(plant_of):
    plant = plant_of()
    before, after = model_of(plant, plant.spreads), of(plant)
    check(before, after)
    wrong = of(plant_of(('lever*turn', '(lever + 1e-6)*turn')))
    with pytest.raises(BadInput, match='random point'):
        check(before, wrong)


@pytest.mark.parametrize('changes', [
    [('heading: turn', 'heading: turn - 0.1*heading')],  # it is no angle: turns are counted
    [('speed: -speed', 'speed: -speed - heading')],
    [('sin(lean - heading)', 'sin(lean - 2*heading)')],
    [('speed*sin(lean - heading)', 'speed*sin(heading)**2')],  # not linear
    [('heading: turn', 'heading: turn - sin(heading)')],  # it turns as it stands: a pendulum
    [('heading: turn', 'heading: turn + x')],
    [('2*heading,', '2*heading + speed,'), (', wrap: 4*pi', '')],
    [('measures: speed', 'measures: 3*heading')],  # there is another compass
    [('measures: x', 'measures: speed'), ('measures: y', 'measures: speed')],  # no position
    # nobody tells how fast it goes
    [('measures: speed', 'measures: y'), ('speed: -speed', 'speed: 0')],
])
def test_where_it_is_no_gain_there_is_none(plant_of, changes):
    assert of(plant_of(*changes)) is None


def test_what_dies_out_by_itself_need_not_be_read(plant_of):
    assert of(plant_of(('measures: speed', 'measures: y'))) is not None


@pytest.fixture(name='made', scope='module')
def _made(tmp_path_factory):
    path = tmp_path_factory.mktemp('made') / 'plant.yaml'
    path.write_text(CART, encoding='utf-8')
    plant = load_plant(path)
    return plant, design(plant, [['compass']])


def test_it_is_handed_out_where_nothing_is_proved(made):
    plant, found = made
    entry = found['compass', 'compass']
    assert isinstance(entry, ExtendedSensor) and entry.model.angle == 'heading'
    assert entry.reads == ('east', 'north', 'odometer') and 'cosine' in entry.method
    said = ' '.join(answer(found, plant=plant).split())
    assert 'linear in cosine and sine of heading' in said and 'heading as two' in said
    other = design(plant, [['compass']], extended=False)['compass', 'compass']
    assert not isinstance(other, ExtendedSensor)


def test_that_it_wraps_should_be_said(plant_of):
    plant = plant_of((', wrap: 4*pi', ''))
    made = design(plant, [['compass']])
    lines = advice(plant, made, None)
    assert len(lines) == 1 and 'give it wrap: 12.5664' in lines[0]
    wraps = plant_of()
    assert not any('wrap' in line for line in advice(wraps, design(wraps, [['compass']]), None))


def test_the_base_has_it_too_without_any_spread():
    plant = load_plant(Path(__file__).parents[2] / 'config/base/plant.yaml')
    assert not plant.spreads
    entry = of_angle(plant, ('yaw',), 'yaw')
    assert entry.model.angle == 'heading' and entry.model.parameters == ()
    assert of_angle(plant, ('x', 'y', 'yaw'), 'yaw') is None
    assert of_angle(plant, ('yaw', 'x'), 'x') is None


def test_the_file_holds_it(made, tmp_path):
    path = tmp_path / 'design.json'
    made[1].save(path)
    before, after = (d['compass', 'compass'] for d in (made[1], Design.load(path)))
    assert before.model.same(after.model) and after.method == before.method
    assert 'angle' in json.loads(path.read_text(encoding='utf-8'))['entries'][0]


@pytest.mark.parametrize('change, said', [
    (lambda e: e['angle'].update(state='tilt'), 'is not a state'),
    (lambda e: e['angle'].update(state='speed'), 'equations'),
    (lambda e: e['angle'].update(factors=[0, 0, 2]), 'factors'),
    (lambda e: e['angle'].update(factors=[0, 0, 0, 0]), 'not what compass reads'),
    (lambda e: e['angle'].update(factors=[0, 0, 1e80, 0]), 'too large'),
    (lambda e: e['angle'].update(factors=[1, 0, 2, 0]), 'together with something else'),
    (lambda e: e['angle'].update(more=1), 'more'),
    (lambda e: e.update(angle='heading'), 'angle'),
    (lambda e: e.pop('angle'), 'are not 4'),
])
def test_what_is_wrong_in_the_file_is_said(made, tmp_path, change, said):
    path = tmp_path / 'design.json'
    made[1].save(path)
    record = json.loads(path.read_text(encoding='utf-8'))
    change(record['entries'][0])
    path.write_text(json.dumps(record), encoding='utf-8')
    with pytest.raises(BadInput) as caught:
        Design.load(path)
    assert said in str(caught.value) and '\n' not in str(caught.value)
