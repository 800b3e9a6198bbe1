"""When a filter on the equations is handed out, what it is told, and its section of the file."""

from dataclasses import replace
import json

import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.advice import advice
from vsensor_ros.designer.extended import extended
from vsensor_ros.designer.filter_trial import tried, with_trials
from vsensor_ros.observers import ExtendedSensor, VirtualSensor
from vsensor_ros.report.design_answer import answer
from vsensor_ros.report.page import page

PENDULUM = """
name: pendulum
time: continuous
parameters: {g: {value: 9.81}, l: {value: 0.7, spread: 0.035}, d: {value: 0.2, spread: 0.02}}
definitions: {lean: sin(angle)/l}
states:
  angle: {process_noise: 0, range: [-4, 4]}
  speed: {process_noise: 0.05, range: [-8, 8]}
inputs: {torque: {process_noise: 0.02}}
disturbances: {wind: {process_noise: 0.1}}
dynamics: {angle: speed, speed: -g*lean - d*speed + 2*torque + wind}
sensors: {encoder: {measures: angle, noise: 0.001}, tacho: {measures: speed, noise: 0.02}}
"""


@pytest.fixture(name='plant_of')
def _plant_of(tmp_path):
    def plant_of(*changes):
        text = PENDULUM
        for before, after in changes:
            assert before in text
            text = text.replace(before, after)
        path = tmp_path / 'plant.yaml'
        path.write_text(text, encoding='utf-8')
        return load_plant(path)
    return plant_of


@pytest.fixture(name='made', scope='module')
def _made(tmp_path_factory):
    path = tmp_path_factory.mktemp('made') / 'plant.yaml'
    path.write_text(PENDULUM, encoding='utf-8')
    return design(load_plant(path))


def test_it_stands_in_where_nothing_is_proved_everywhere(plant_of, made):
    found = made[('encoder',), 'encoder']
    assert isinstance(found, ExtendedSensor) and found.grade == 'filtered'
    assert found.reads == ('tacho',) and found.commands == ('torque',) and found.order == 2
    m = found.model
    assert m.parameters == ('l', 'd')
    assert m.equations == ('speed', '-9.81*(sin(angle)/l) - d*speed + 2*torque + wind')
    np.testing.assert_array_equal(m.spreads, [0.035, 0.02])
    np.testing.assert_array_equal(m.input_noise, [0.02])
    np.testing.assert_array_equal(m.unknown_noise, [0.1])
    np.testing.assert_allclose(m.start, np.array([8.0, 16.0]) / np.sqrt(12.0))
    assert not any(isinstance(e, ExtendedSensor)
                   for e in design(plant_of(), extended=False).virtual_sensors)


@pytest.mark.parametrize('changes', [
    [(', spread: 0.035', ''), (', spread: 0.02', '')],  # nobody says what is not known
    [('noise: 0.001', '')], [('process_noise: 0.05, ', '')], [('{process_noise: 0.1}', '{}')],
    [('d*speed', 'd*sign(speed)')],
])
def test_where_it_is_told_too_little_there_is_none(plant_of, changes):
    assert extended(plant_of(*changes), ('encoder',), 'encoder') is None


def test_what_is_proved_everywhere_stays(plant_of):
    made = design(plant_of(('sin(angle)', 'angle'), (' + wind', ''),
                           ('{wind: {process_noise: 0.1}}', '{}')))
    assert isinstance(made[('tacho',), 'tacho'], VirtualSensor)


SERIES = """
name: series
time: continuous
parameters: {k: {value: 0.5, spread: 0.05}}
states:
  x: {range: [0.5, 4], initial: 1, process_noise: 0.01}
  y: {range: [0.5, 4], initial: 1, process_noise: 0.01}
inputs: {f: {operating: 0.5, range: [0.1, 2]}}
dynamics: {x: f - k*x**2, y: k*x**2 - k*y**2}
sensors: {sx: {measures: x, noise: 0.01}, sy: {measures: y, noise: 0.01}}
"""


@pytest.mark.parametrize('of, sensor, why', [
    (lambda text: text, 'sx', ''),
    # certified about the operating point only: nobody says where the plant works
    (lambda text: text.replace('range: [0.5, 4], ', ''), 'sx',
     'nothing is proved beyond a region about the operating point'),
    # certified in a part of the only range
    (lambda text: text.replace('range: [0.5, 4], ', '', 1).replace(
        'k*x**2 - k*y**2', 'k*x**2 - k*y**2*x'), 'sy', 'nothing is proved with y above'),
])
def test_what_is_proved_on_the_declared_ranges_stays(tmp_path, of, sensor, why):
    path = tmp_path / 'plant.yaml'
    path.write_text(of(SERIES), encoding='utf-8')
    plant = load_plant(path)
    plain = design(plant, [[sensor]], extended=False)[(sensor,), sensor]
    assert plain.certificate.status == 'region'
    found = design(plant, [[sensor]])[(sensor,), sensor]
    assert isinstance(found, ExtendedSensor if why else VirtualSensor)
    assert not why or why in found.why


def test_the_answer_tells_of_a_filter_whose_error_stays(tmp_path):
    path = tmp_path / 'plant.yaml'
    path.write_text("""
name: cart
time: continuous
parameters: {m: {value: 2.0, spread: 0.1}}
states: {x: {process_noise: 1e-4, range: [-5, 5]}, v: {process_noise: 0.01, range: [-3, 3]}}
inputs: {f: {}}
dynamics: {x: v, v: f/m - 0.05*v*x/m}
sensors: {gps: {measures: x, noise: 0.1}, odo: {measures: v, noise: 0.02}}
""", encoding='utf-8')
    plant = load_plant(path)
    result = design(plant)
    assert result[('gps',), 'gps'].decay == 0.0
    said = ' '.join(answer(result, plant=plant).split())
    assert 'lose at the same time one 1 of 2: odo by a filter of which nothing is proved: gps' \
        in said
    assert 'decay none at the operating point: an error that is there at the loss stays' in said
    assert 'why a filter the other one, of order 1, serves for a time only' in said
    assert 'not computed' not in said
    html = page(plant, result)
    assert 'by a filter of which nothing is proved: gps' in html and 'why a filter' in html


def test_a_spread_of_what_a_sensor_reads_is_minded(tmp_path):
    path = tmp_path / 'plant.yaml'
    text = SERIES.replace('measures: y', 'measures: y - scale*f').replace(
        'spread: 0.05}', 'spread: 0.05}, scale: {value: 0.5, spread: 0.2}').replace(
        'range: [0.5, 4], ', '')
    path.write_text(text, encoding='utf-8')
    plant = load_plant(path)
    minded = [line for line in advice(plant, design(plant, [['sx']]), None) if 'spread' in line]
    assert minded == ['the spread of scale is not counted with in what sy reads (0.1 at the '
                      'operating point): filters are off by more than they say; make it part of '
                      'the noise, or a slow state']


def test_its_deviation_grows_from_that_of_the_readings(plant_of, made):
    found = made[('encoder',), 'encoder']
    assert found.drift[0] < 0.001 < found.drift[-1] < 1.0
    assert found.ages[0] == 0.0 and (np.diff(found.ages) > 0.0).all()
    unsure = extended(plant_of(('spread: 0.035', 'spread: 0.2')), ('encoder',), 'encoder')
    assert unsure.drift[-1] >= found.drift[-1]


def test_the_file_holds_it(made, tmp_path):
    path = tmp_path / 'design.json'
    made.save(path)
    before, after = (d[('encoder',), 'encoder'] for d in (made, Design.load(path)))
    assert before.model.same(after.model)
    assert before.why.startswith(('other virtual sensors', 'the other one', 'of the other one'))
    for name in ('channel', 'fault_set', 'reads', 'decay', 'warm_up', 'why'):
        assert getattr(before, name) == getattr(after, name)
    np.testing.assert_array_equal(before.drift, after.drift)
    assert not after.model.noise.flags.writeable


@pytest.mark.parametrize('change, said', [
    (lambda e: e.update(equations=['speed', '__import__("os")']), 'equations'),
    (lambda e: e.update(equations=['speed', 'sign(speed)']), 'jumps'),
    (lambda e: e.update(equations=['speed', 'angle + other']), 'other'),
    (lambda e: e.update(equations=['speed']), 'are not 2'),
    (lambda e: e.update(reads=['encoder']), 'not healthy'),
    (lambda e: e.update(noise=[0.0, 0.1]), 'noise'),
    (lambda e: e.update(process_noise=[-1.0, 0.1]), 'negative'),
    (lambda e: e.update(start=[1e200, 0.1]), 'above'),
    (lambda e: e.update(C=[[1.0, 0.0]]), 'C'),
    (lambda e: e.update(C=[[0.0, 0.0], [0.0, 1.0]]), 'nothing of encoder'),
    (lambda e: e.update(ages=[0.0, 0.0], drift=[0.0, 0.0]), 'rise'),
    (lambda e: e.update(unknown=['l']), 'something else'),
    (lambda e: e['parameters'].append({'name': 'angle', 'value': 1.0, 'spread': 1.0}),
     'something else'),
    (lambda e: e.update(extra=1), 'extra'),
])
def test_what_is_wrong_in_the_file_is_said(made, tmp_path, change, said):
    path = tmp_path / 'design.json'
    made.save(path)
    record = json.loads(path.read_text(encoding='utf-8'))
    change(record['entries'][0])
    path.write_text(json.dumps(record), encoding='utf-8')
    with pytest.raises(BadInput) as caught:
        Design.load(path)
    assert said in str(caught.value) and '\n' not in str(caught.value)


@pytest.mark.parametrize('before, after, said', [
    ('spread: 0.035', 'spread: 0', 'not positive'), ('spread: 0.035', 'spread: -l', 'l.spread'),
    ('{value: 0.7, spread: 0.035}', '{value: [0.7, 1], spread: 0.1}', 'array'),
    ('process_noise: 0.02', 'process_noise: -1', 'torque'),
])
def test_what_is_wrong_in_the_plant_file_is_said(plant_of, before, after, said):
    with pytest.raises(BadInput, match=said):
        plant_of((before, after), *([('/l', '/0.7')] if 'array' in said else []))


def test_rates_by_the_minute_are_told_by_the_second(plant_of):
    second, minute = plant_of(), plant_of(('time: continuous', 'time: continuous\ntime_unit: min'))
    np.testing.assert_allclose(minute.input_noise, second.input_noise * np.sqrt(60.0))
    assert minute.equations[0] == 'speed/60'
    assert minute.hash() != second.hash() != replace(second, spreads={}).hash()


def test_how_far_parameters_are_off_may_be_said_when_one_asks(plant_of):
    bare = plant_of((', spread: 0.035', ''), (', spread: 0.02', ''))
    assert extended(bare, ('encoder',), 'encoder') is None
    found = design(bare, [('encoder',)], spread=0.1)[('encoder',), 'encoder']
    assert dict(zip(found.model.parameters, found.model.spreads)) == pytest.approx(
        {'g': 0.981, 'l': 0.07, 'd': 0.02})
    given = extended(plant_of(), ('encoder',), 'encoder', 0.1)
    assert dict(zip(given.model.parameters, given.model.spreads)) == pytest.approx(
        {'g': 0.981, 'l': 0.035, 'd': 0.02})
    for wrong in (0.0, 1.0, True, 'much'):
        with pytest.raises(BadInput, match='share'):
            design(bare, spread=wrong)


def test_runs_over_the_ranges_say_how_far_off_it_is(made, plant_of, tmp_path):
    plant = plant_of()
    found = with_trials(plant, made)
    entry = found[('encoder',), 'encoder']
    t = entry.tried
    # it has to be off by what its covariance says, of which two deviations are 95 %
    assert entry.drift[0] < t.rmse < 2.0 * entry.drift[-1] and 0.9 < t.within < 1.0
    assert t.runs == 40 and t.lost < 0.15 and t.served > 0.85
    # one that takes its sensors for better than they are does not know what it does not know
    sure = replace(entry, model=replace(entry.model, noise=0.1 * entry.model.noise))
    wrong = tried(plant, sure, entry.model)
    assert wrong.lost > 0.9 or wrong.within < 0.7
    assert '40 runs over the declared ranges' in ' '.join(answer(found, plant=plant).split())
    found.save(tmp_path / 'design.json')
    assert Design.load(tmp_path / 'design.json')[('encoder',), 'encoder'].tried == t
    record = json.loads((tmp_path / 'design.json').read_text())
    record['entries'][0]['tried']['within'] = 1.5
    (tmp_path / 'design.json').write_text(json.dumps(record))
    with pytest.raises(BadInput, match='tried.within: is no share'):
        Design.load(tmp_path / 'design.json')
