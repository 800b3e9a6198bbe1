"""What of isolability stands in the design file, and what is refused of it."""

from dataclasses import replace
import json

from design_example import example, rewrite, sensor
import numpy as np
import pytest

from vsensor_ros import Design
from vsensor_ros.bad_input import BadInput
from vsensor_ros.observers import (
    Distinction,
    Isolability,
    NONE,
    Residual,
    STRONG,
    WEAK,
)

FOUND = Isolability(
    (Residual('y2 without y2', ('y2',), 'y2', ('y1', 'y2', 'y3'), (1.0 / 3.0, 1.0, None), 0.3,
              1.5, True),
     Residual('y3 without y3', ('y3',), 'y3', ('y2', 'y3'), (-0.5, 0.0), 0.1, 0.5),
     Residual('without y1', ('y1',), 'without y1', ('y2', 'y3'), (2.0, -1e-300), 1.0, 5.3)),
    {'without y1': sensor('without y1', ('y1',), order=2)},
    (Distinction('y1', (), STRONG), Distinction('y2', (), STRONG), Distinction('y3', (), STRONG),
     Distinction('y3', ('y1', 'y2'), NONE), Distinction('y2', ('y1',), STRONG)),
    ('y1 cannot be told from y2',))


@pytest.fixture
def path(tmp_path):
    """Return where an example with isolability is written."""
    Design(**{**vars(example()), 'isolability': FOUND}).save(tmp_path / 'design.json')
    return tmp_path / 'design.json'


def test_what_is_written_is_read(path, tmp_path):
    read = Design.load(path)
    found = read.isolability
    assert (found.residuals, found.plant, found.gaps) == (
        FOUND.residuals, FOUND.plant, FOUND.gaps)
    v = found.filters['without y1']
    assert v.fault_set == ('y1',) and np.array_equal(v.J, FOUND.filters['without y1'].J)
    read.save(tmp_path / 'again.json')
    assert path.read_text() == (tmp_path / 'again.json').read_text()


def test_a_file_without_it_is_as_before(path):
    design = example()
    rewrite(path, lambda record: record.pop('isolability'))
    assert Design.load(path).isolability is None and design.isolability is None
    design.save(path)
    assert 'isolability' not in json.loads(path.read_text())
    assert not Design.load(path).isolating().entries


def test_residuals_say_whom_they_tell_from_whom():
    assert [FOUND.by_residuals(s) for s in ('y1', 'y2', 'y3')] == [STRONG] * 3
    assert FOUND.by_residuals('y2', ['y1']) == FOUND.by_residuals('y3', ['y1']) == STRONG
    assert FOUND.by_residuals('y1', ['y2']) == FOUND.by_residuals('y2', ['y1', 'y3']) == NONE
    y2, y3, _ = FOUND.residuals
    # a gain that nobody knows promises no more than the onset
    assert [r.shows('y3') for r in (y2, y3)] == [WEAK, WEAK] and y3.shows('y1') == NONE


def test_residuals_say_whose_motion_is_in_them():
    def motion(channel, *gains):
        return Residual('', (), channel, ('a', 'b'), gains, 1.0, 5.0).motion()
    assert motion('a', 1.0, -0.5) == motion('a', None, 0.5) == {'a': 1.0}
    assert motion('a', 0.0, -0.5) == {'a': 0.0, 'b': 0.5}  # a corrects it
    assert motion('without c', -2.0, None) == {'a': 2.0, 'b': 0.0}


def test_the_observers_of_the_residuals_are_a_design_of_their_own(path):
    stack = Design.load(path).isolating()
    assert set(stack.entries) == {(('y2',), 'y2'), (('y3',), 'y3'), (('y1',), 'without y1')}
    assert stack.wanted == ('without y1',) and stack.isolability is None
    assert stack['y1', 'without y1'].outputs == ('without y1',)



BROKEN = {
    'unknown key': (lambda s: s.update(extra=1), 'isolability.extra'),
    'no residuals': (lambda s: s.pop('residuals'), 'isolability.residuals: is missing'),
    'name twice': (lambda s: s['residuals'][1].update(name='y2 without y2'), 'twice'),
    'no such observer': (lambda s: s['residuals'][0].update(channel='y3'),
                         'residuals[0].channel: y3 is no virtual sensor of its fault set'),
    'of a refusal': (lambda s: s['residuals'][0].update(channel='y1', fault_set=['y1']),
                     'residuals[0].channel'),
    'filter of another set': (lambda s: s['residuals'][2].update(fault_set=['y2']),
                              'residuals[2].channel'),
    'of what is disturbed': (lambda s: s['residuals'][0].update(channel='v', fault_set=[]),
                             'unknown inputs disturb'),
    'feels what it does not read': (
        lambda s: s['residuals'][2].update(support=['y1', 'y3']), 'residuals[2].support'),
    'feels nobody': (lambda s: s['residuals'][0].update(support=[], gains=[]), 'support'),
    'out of order': (lambda s: s['residuals'][1].update(support=['y3', 'y2']),
                     'is not sensors in their order'),
    'no such sensor': (lambda s: s['residuals'][1].update(support=['y2', 'y9']), 'support'),
    'too few gains': (lambda s: s['residuals'][1].update(gains=[1.0]), 'gains: is not 2 numbers'),
    'a word for a gain': (lambda s: s['residuals'][1].update(gains=[1.0, 'x']), 'gains[1]'),
    'negative noise': (lambda s: s['residuals'][0].update(noise=-1.0), 'residuals[0].noise'),
    'true for a threshold': (lambda s: s['residuals'][0].update(threshold=True), 'threshold'),
    'filter as a sensor': (lambda s: s['filters'][0].update(channel='y1'),
                           'filters[0].channel: y1 is a sensor'),
    'filter twice': (lambda s: s['filters'].append(s['filters'][0]), 'filters[1].channel'),
    'unstable filter': (lambda s: s['filters'][0].update(
        N=[[1.0, 0.0], [0.0, -1.0]], eigenvalues=[[1.0, 0.0], [-1.0, 0.0]]), 'filters[0].N'),
    'unknown kind of filter': (lambda s: s['filters'][0].update(kind='magic'), 'kind'),
    'told from itself': (lambda s: s['plant'][0].update(others=['y1']), 'plant[0].sensor'),
    'a word of its own': (lambda s: s['plant'][0].update(strength='very'), 'plant[0].strength'),
    'said twice': (lambda s: s['plant'].append(s['plant'][0]), 'plant[5].sensor'),
    'more than the plant allows': (lambda s: s['plant'][4].update(strength='weak'),
                                   'says weak of y2 against y1, and a residual strong'),
    'newline in a gap': (lambda s: s.update(gaps=['a\nb']), 'gaps'),
}


@pytest.mark.parametrize('name', BROKEN)
def test_what_is_wrong_is_refused_in_one_line(path, name):
    change, needle = BROKEN[name]
    rewrite(path, lambda record: change(record['isolability']))
    with pytest.raises(BadInput) as caught:
        Design.load(path)
    line = str(caught.value)
    assert needle in line and '\n' not in line and str(path) in line


def test_what_would_be_refused_is_not_written(path, tmp_path):
    wrong = replace(FOUND, residuals=(replace(FOUND.residuals[0], support=('y1',)),))
    with pytest.raises(BadInput, match='gains'):
        Design(**{**vars(example()), 'isolability': wrong}).save(tmp_path / 'wrong.json')
    assert not (tmp_path / 'wrong.json').exists()
