"""Reasons are data: every code has its sentence, and nothing in the designer reads sentences."""

import ast
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import design, Plant
from vsensor_ros.designer.existence import examine
from vsensor_ros.designer.problem import pose
from vsensor_ros.designer.sentences import say, SENTENCES
from vsensor_ros.reason import Reason

PACKAGE = Path(__file__).parents[2] / 'vsensor_ros'
ROOMS = ('functions', 'plant', 'designer', 'report')


def calls(room):
    """Return all calls of methods in the files of a room."""
    for path in (PACKAGE / room).glob('*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                yield path.name, node


def test_every_code_has_its_sentence_and_every_sentence_its_code():
    used = {node.args[0].value for _, node in calls('designer')
            if node.func.attr == 'of' and ast.unparse(node.func.value) == 'Reason'}
    assert used == SENTENCES.keys()


@pytest.mark.parametrize('room', ROOMS)
def test_nothing_takes_a_text_of_its_own_apart(room):
    """Only what users typed is read, and names that were made here: numbers, expressions."""
    readers = {'exact.py', 'expression.py', 'nonlinear_entry.py', 'page.py', 'units.py',
               'unknown_inputs.py'}
    assert {path for path, node in calls(room) if node.func.attr in (
        'startswith', 'endswith', 'partition', 'rpartition')} <= readers


def test_what_stands_in_the_way_is_known_by_code_and_facts():
    chain = Plant.from_matrices([[-1, 0], [1, -1]], None, np.eye(2), D=[1, 0])
    in_the_way = examine(pose(chain, ('y1', 'y2'), 'y1')).obstruction
    assert in_the_way.code == 'unknown inputs' and in_the_way.fact('names') == ('rho1',)
    assert in_the_way.fact('healthy') == ()
    assert say(in_the_way) == ('the unknown input rho1 acts on it and no sensor is left to tell '
                               'them apart')
    growing = Plant.from_matrices(np.diag([-1.0, 0.5]), None, np.eye(2))
    found = examine(pose(growing, ('y2',), 'y2'))
    assert found.hidden and found.obstruction.fact('size') == pytest.approx(0.5)
    assert found.obstruction.fact('states') == ('x2',)
    assert not examine(pose(chain, ('y2',), 'y2')).hidden


def test_a_refusal_names_the_least_set_that_lost_the_channel():
    """Whatever order the sets are given in, and however long the way from one to the next is."""
    plant = Plant.from_matrices(-np.eye(4), None, np.eye(4), D=[1, 0, 0, 0])
    made = design(plant, up_to=3)
    alone = made['y1', 'y1'].reason
    for fault_set in (('y1', 'y2'), ('y1', 'y2', 'y4')):
        assert made[fault_set, 'y1'].reason == f'already when y1 alone has failed: {alone}'
    made = design(plant, [('y1', 'y2', 'y4'), ('y1', 'y2'), ('y1', 'y2', 'y3')])
    assert made[('y1', 'y2', 'y3'), 'y1'].reason == (
        'already when y1 and y2 alone have failed: ' + made[('y1', 'y2'), 'y1'].reason)


@pytest.mark.parametrize(('reason', 'text'), [
    (Reason.of('decoupled', free=('a',), kept=(('b', 2.0, 1.0, 0.5),), unit='m'),
     'decoupled from a, not decoupled from b (at most 2 m per unit, at 1 rad/s; 0.5 m when '
     'constant)'),
    (Reason.of('alternative', order=2, gain=0.9999, names=('a', 'b'), unit='', terms=True),
     'not decoupled, but bounded: order 2 or less with at most 1 per unit of a and b together '
     'near the operating point (bounded=True, or --bounded)'),
    (Reason.of('mode stays', size=1.0, discrete=True, states=('x',), healthy=(), terms=False),
     'no sensor is left for the mode of modulus 1 in x, which does not surely die out by itself: '
     'an initial error would stay'),
    (Reason.of('rows decoupled', rows=(1, 3)), 'rows 1, 3 decoupled from all; the others'),
    (Reason.of('taken for', sensor='a', other='b', names=('p', 'q'), terms=False),
     'a fault of a may be taken for one of b: everything that checks a without b is disturbed by '
     'p and q'),
    (Reason.of('not seen', sensor='a', other='', names=('sign(x)',), terms=True),
     'a: no fault of it is seen: everything that checks a depends on sign(x), of which nobody '
     'tells the argument'),
    (Reason.of('bias taken for', sensor='a', others=('b', 'c')),
     'a: jumps, freezes and noise are told from faults of b and c; a constant bias is not'),
    (Reason.of('not built', sensor='a', others=('b',), strength='weak'),
     'a constant bias of a could be told from faults of b, but no filter for it passed its '
     'checks')])
def test_sentences(reason, text):
    assert say(reason) == text
