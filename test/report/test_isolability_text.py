"""Whose fault it is: what the terminal and the page say of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import Design, Plant
from vsensor_ros.command.designer import main
from vsensor_ros.designer.location import locations
from vsensor_ros.observers import Distinction, Isolability, NONE, Residual, STRONG, WEAK
from vsensor_ros.report import isolability_text
from vsensor_ros.report.design_answer import answer

CONFIG = Path(__file__).parents[2] / 'config'
JOINT = Plant.from_matrices([[0, 1], [0, -4]], [0, 8], np.eye(2), sensors=('angle', 'speed'),
                            noise=[0.0005, 0.005])


@pytest.mark.usefixtures('designed_once')
def test_the_command_says_it_and_writes_it(tmp_path, capsys):
    servo, path = str(CONFIG / 'servo' / 'plant.yaml'), tmp_path / 'design.json'
    assert main([servo, '-o', str(path), '--isolate', '--locate']) == 0
    said = capsys.readouterr().out
    assert """
        seen     y1       y2       y3
    y1  no       -        no       no
    y2  yes      yes      -        yes
    y3  yes      yes      yes      -
""" in said
    assert ('4 residuals of virtual sensors tell 4 of the 4 ordered pairs that the plant allows, '
            'of 6') in said
    assert '- y1: no fault of it is seen: everything that checks y1 is disturbed by rho' in said
    assert 'two      all 1: y2+y3\n             others of this size were not looked at' in said
    assert 'angle  would let you lose y1' in said and 'see faults of y1' in said
    assert len(Design.load(path).isolability.residuals) == 4
    assert main([servo, '-o', str(path)]) == 0
    assert 'seen' not in capsys.readouterr().out
    assert Design.load(path).isolability is None


def test_marks_say_what_the_plant_allows_and_the_residuals_do_not():
    found = Isolability(
        (Residual('a', ('y1',), 'y1', ('y1', 'y2'), (1.0, 0.0), 0.1, 0.5),), {},
        (Distinction('y1', (), STRONG), Distinction('y2', (), STRONG),
         Distinction('y1', ('y2',), WEAK), Distinction('y2', ('y1',), NONE)))
    assert isolability_text.table(found, ('y1', 'y2')) == [
        [(STRONG, 'yes'), ('', '-'), (NONE, '(onset)')],
        [(WEAK, '(yes)'), (NONE, 'no'), ('', '-')]]
    assert isolability_text.summary(found) == (
        '1 residual of virtual sensors tells 0 of the 1 ordered pairs that the plant allows, of 2')


def test_the_answer_of_many_sensors_has_no_table_that_breaks(designed):
    result = designed(JOINT, isolate=True)
    assert 'angle  onset    -        onset' in answer(result, set())
    many = tuple(f'sensor_of_a_long_name_{i}' for i in range(20))
    wide = replace(result, sensors=many, entries={}, isolability=Isolability(
        (), {}, tuple(Distinction(s, (), NONE) for s in many), tuple(
            f'{s}: no fault of it is seen' for s in many)))
    lines = answer(wide).splitlines()
    assert max(map(len, lines)) <= 99
    assert '    - and 8 more, which are in the report' in lines


def test_the_page_has_the_table_the_gaps_and_the_residuals(designed, monkeypatch):
    pytest.importorskip('matplotlib')
    from vsensor_ros.report.page import page
    monkeypatch.setattr('vsensor_ros.report.page.MOST_PICTURES', 0)  # they take long
    result = designed(JOINT, isolate=True)
    hostile = '<script>alert(1)</script>'
    found = replace(result.isolability, gaps=(*result.isolability.gaps, hostile))
    text = page(JOINT, replace(result, isolability=found), locations(JOINT, isolate=True))
    assert 'Whose fault it is' in text and '<td class="temporary">onset</td>' in text
    assert '<li>angle: jumps, freezes and noise are seen; a constant bias is not</li>' in text
    assert 'angle without angle' in text and 'threshold to begin with' in text
    assert hostile not in text
    assert 'Whose fault' not in page(JOINT, replace(result, isolability=None))
