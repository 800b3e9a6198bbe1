"""What of the sizes of faults stands in the design file, and what is refused of it."""

import json

from design_example import example, rewrite, sensor
import numpy as np
import pytest

from vsensor_ros import Design
from vsensor_ros.bad_input import BadInput
from vsensor_ros.observers import FaultSize, FaultSizes, Injection
from vsensor_ros.observers.fault_size import SLIDING, TWISTING, VIRTUAL, WALK

MODE = Injection(np.array([[-1.0 / 3.0]]), np.array([0.5]), np.array([2.0]), 10.0, 0.7)
SIZES = FaultSizes((
    FaultSize('y2', VIRTUAL, example()['y2', 'y2'], 0.3, 0.1, 0.2, False,
              others={WALK: 1.0 / 3.0}, why_not={SLIDING: 'nothing is checked'}),
    FaultSize('y3', WALK, sensor('fault of y3', (), order=2), 0.3, 0.1, 0.2, True),
    FaultSize('u1', TWISTING, sensor('fault of u1', ()), 0.3, 0.1, 0.2, False, injection=MODE)),
    {'y1': 'nothing feels it'})


@pytest.fixture
def path(tmp_path):
    """Return where an example with sizes of faults is written."""
    Design(**{**vars(example()), 'fault_sizes': SIZES}).save(tmp_path / 'design.json')
    return tmp_path / 'design.json'


def test_what_is_written_is_read(path, tmp_path):
    read = Design.load(path)
    sizes = read.fault_sizes
    assert [s.method for s in sizes.found] == [VIRTUAL, WALK, TWISTING]
    assert sizes.refused == SIZES.refused and sizes.found[0].others == {WALK: 1.0 / 3.0}
    assert sizes.found[0].observer is read['y2', 'y2']
    assert np.array_equal(sizes.found[2].injection.N, MODE.N)
    assert sizes.found[2].injection.change == 0.7
    read.save(tmp_path / 'again.json')
    assert path.read_text() == (tmp_path / 'again.json').read_text()
    assert set(read.isolating().entries) == {(('y2',), 'y2'), ((), 'fault of y3'),
                                             ((), 'fault of u1')}


def test_a_file_without_it_is_as_before(path):
    rewrite(path, lambda record: record.pop('fault_sizes'))
    read = Design.load(path)
    assert read.fault_sizes is None
    read.save(path)
    assert 'fault_sizes' not in json.loads(path.read_text())


BROKEN = {
    'unknown key': (lambda s: s.update(extra=1), 'fault_sizes.extra'),
    'no list': (lambda s: s.pop('found'), 'fault_sizes.found'),
    'no such name': (lambda s: s['found'][0].update(name='y9'), 'found[0].name'),
    'twice': (lambda s: s['found'].append(s['found'][1]), 'found[3].name: y3 stands there twice'),
    'no such method': (lambda s: s['found'][1].update(method='magic'), 'found[1].method'),
    'no virtual sensor': (lambda s: s['found'][0].update(name='y1'), 'found[0].method'),
    'an observer beside it': (lambda s: s['found'][0].update(observer=s['found'][1]['observer']),
                              'found[0].observer'),
    'no observer': (lambda s: s['found'][1].pop('observer'), 'found[1].observer'),
    'unknown kind': (lambda s: s['found'][1]['observer'].update(kind='magic'), 'observer.kind'),
    'unstable': (lambda s: s['found'][2]['observer'].update(
        N=[[1.0]], eigenvalues=[[1.0, 0.0]]), 'observer.N'),
    'no response': (lambda s: s['found'][0].update(response=0.0), 'found[0].response'),
    'negative noise': (lambda s: s['found'][0].update(noise=-1.0), 'found[0].noise'),
    'injection of a walk': (lambda s: s['found'][1].update(injection=s['found'][2]['injection']),
                            'found[1].injection'),
    'no injection': (lambda s: s['found'][2].pop('injection'), 'found[2].injection'),
    'residual that does not feel it': (lambda s: s['found'][2]['injection'].update(c=[1.0]),
                                       'injection.c'),
    'injection that grows': (lambda s: s['found'][2]['injection'].update(N=[[0.1]]),
                             'injection.N'),
    'no gain': (lambda s: s['found'][2]['injection'].update(largest=0.0), 'injection.largest'),
    'follows nothing': (lambda s: s['found'][2]['injection'].update(change=0.0),
                        'injection.change'),
    'injection beyond all numbers': (lambda s: s['found'][2]['injection'].update(N=[[-1e200]]),
                                     'injection.N: has a number beyond 1e+30'),
    'change that is hardly one': (lambda s: s['found'][2]['injection'].update(change=5e-324),
                                  'injection.change'),
    'of two shapes': (lambda s: s['found'][2]['injection'].update(c=[1.0, 2.0]), 'injection.c'),
    'beside itself': (lambda s: s['found'][1]['others'].update({WALK: 1.0}), 'found[1].method'),
    'refused and found': (lambda s: s['refused'].update(y2='no'), 'y2 is found, too'),
    'line break': (lambda s: s['refused'].update(y1='a\nb'), 'refused.y1'),
}


def test_numbers_that_are_zero_but_for_rounding_are_read(path):
    rewrite(path, lambda record: record['fault_sizes']['found'][2]['injection'].update(
        N=[[-1.0, 1e-40], [0.0, -2.0]], f=[0.5, 1e-40], c=[2.0, 1e-40]))
    assert Design.load(path).fault_sizes.found[2].injection.N[0, 1] == 1e-40


@pytest.mark.parametrize('name', BROKEN)
def test_what_is_wrong_is_refused_in_one_line(path, name):
    change, needle = BROKEN[name]
    rewrite(path, lambda record: change(record['fault_sizes']))
    with pytest.raises(BadInput) as caught:
        Design.load(path)
    line = str(caught.value)
    assert needle in line and '\n' not in line and str(path) in line
