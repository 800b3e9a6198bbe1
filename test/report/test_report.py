"""The report: the right numbers, nothing that a hostile name could do, and no half of a file."""

from dataclasses import replace
from html.parser import HTMLParser
import os
from pathlib import Path
import re
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from vsensor_ros import design, load_plant, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.designer import main
from vsensor_ros.designer.location import locations
from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.observers import (
    Certificate,
    deviation_after,
    horizon,
    Limit,
    Refusal,
    VirtualSensor,
)
from vsensor_ros.report import page as report_module, report_simulation
from vsensor_ros.report.page import _from_wrong_start, page, write_report

pytest.importorskip('matplotlib')
CONFIG = Path(__file__).parents[2] / 'config'
VOID = {'meta', 'br'}


class Page(HTMLParser):
    """The texts, rows and sections of a page; tags must close in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.rows = [], [], []
        self.text = self.section = ''
        self.sections = {}
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == 'section':
            self.section = dict(attributes)['id']
        if tag == 'tr':
            self.rows.append((self.section, []))
        if tag in ('td', 'th'):
            self.rows[-1][1].append('')

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag == 'section':
            self.section = ''

    def handle_data(self, data):
        if 'style' in self.open:
            return
        self.text += data
        self.sections[self.section] = self.sections.get(self.section, '') + data
        if 'td' in self.open or 'th' in self.open:
            self.rows[-1][1][-1] += data

    def rows_of(self, section):
        return [cells for where, cells in self.rows if where == section]

    def fact(self, section, name):
        return next(cells[1] for cells in self.rows_of(section) if cells[0] == name)


@pytest.fixture
def without_pictures(monkeypatch):
    """Draw none, which takes long, where only words and numbers are looked at."""
    monkeypatch.setattr(report_module, 'MOST_PICTURES', 0)


@pytest.fixture(scope='module')
def discrete(designed):
    plant = load_plant(CONFIG / 'three_tank_discrete' / 'plant.yaml')
    result = designed(plant, bounded=True)
    return plant, result, page(plant, result)


@pytest.mark.parametrize('system', ['servo', 'tclab', 'three_tank'])
def test_the_numbers_are_those_of_the_design(system, without_pictures, designed):
    plant = load_plant(CONFIG / system / 'plant.yaml')
    result = designed(plant, up_to=2)
    shown = Page(page(plant, result))
    overview = [cells for cells in shown.rows_of('') if len(cells) == 7]
    assert len(overview) == 1 + len(result.entries)
    for i, ((fault_set, channel), entry) in enumerate(result.entries.items()):
        cells, section = overview[1 + i], f'e{i + 1}'
        assert cells[:2] == ['+'.join(fault_set), channel]
        if isinstance(entry, Refusal):
            assert cells[2] == 'cannot be replaced'
            assert entry.reason in shown.sections[section]
            continue
        unit = plant.units[channel]
        assert int(cells[2]) == entry.order
        assert cells[3] == f'{entry.noise.error:.3g} {unit}'
        assert float(cells[4]) == pytest.approx(entry.noise.ratio, abs=0.006)
        assert float(cells[5]) == pytest.approx(-entry.eigenvalues.real.max(), rel=6e-3)
        assert shown.fact(section, 'order').startswith(f'{entry.order} (')
        assert f'the floor of {entry.noise.floor:.3g} {unit}' in shown.fact(section, 'noise error')
        assert shown.fact(section, 'noise gain').startswith(f'{entry.noise_gain:.3g}: ')
        for value in entry.eigenvalues:
            assert f'{value.real:.4g}' in shown.fact(section, 'eigenvalues of N')
        for name in entry.reads:
            assert name in shown.fact(section, 'reads')
        ladder = [c for c in shown.rows_of(section) if len(c) == 5][1:]
        assert [(int(c[0]), c[1], c[2]) for c in ladder] == [
            (r.order, f'{r.noise:.3g} {unit}', f'{r.noise_gain:.3g}') for r in entry.ladder]
        assert [c[0] for c in ladder if c[4].endswith(', taken')] == [str(entry.order)]
        steps = [c for c in shown.rows_of(section) if len(c) == 6][1:]
        assert [(int(c[0]), c[1], c[2], int(c[3])) for c in steps] == [
            (s.order, s.verdict, s.why, s.freedom) for s in entry.proof.steps]
        assert [float(c[4]) for c in steps] == pytest.approx(
            [s.gap[0] for s in entry.proof.steps], rel=0.5)


def test_what_serves_for_a_time_says_until_when_and_how_it_drifts_off():
    plant = Plant.from_matrices(
        [[0, 1, 0], [0, -4, -1], [0, 0, 0]], [0, 8, 0], [[1, 0, 0], [0, 1, 0]],
        states=('angle', 'velocity', 'friction'), sensors=('encoder', 'tacho'),
        units={'encoder': 'rad'}, noise=[0.0005, 0.005], process_noise=[0, 0.2, 0.001],
        ranges=[[-3, 3], [-np.inf, np.inf], [-0.4, 0.4]], slow=['friction'],
        tolerances={'encoder': 0.05})
    result = design(plant, [('encoder',), ('encoder', 'tacho')])
    alone = result['encoder', 'encoder']
    shown = Page(page(plant, result))
    assert '3 of 3 can be replaced, 3 of them for a time only' in shown.text
    assert '<svg' not in page(plant, result)
    assert re.match('for .* to 0.05 rad', shown.fact('e1', 'good'))
    drift = {cells[0]: cells[1] for cells in shown.rows_of('e1') if len(cells) == 2}
    assert drift['10 s'] == f'{deviation_after(alone, 10.0):.3g} rad'
    # alone the tacho is read, whatever the friction; without it the friction decides
    assert 'slow offset' not in drift
    learnt = re.fullmatch('good for (.*) s to 0.05 rad with friction learnt, instead of (.*) s',
                          shown.fact('e2', 'slow offset'))
    both = result[('encoder', 'tacho'), 'encoder']
    assert float(learnt[1]) == pytest.approx(horizon(both, 0.05), rel=0.05)
    assert float(learnt[1]) > 1.5 * float(learnt[2])
    assert shown.fact('e2', 'stability').endswith('the last good readings of encoder, tacho')


def test_what_the_plant_is(discrete):
    plant, _, text = discrete
    shown = Page(text)
    assert shown.fact('', '3 states') == 'level1 [m], level2 [m], level3 [m]'
    assert shown.fact('', 'commands') == 'u1 [m^3/s], u2 [m^3/s]'
    assert shown.fact('', 'unknown inputs') == 'rho [m] on level1'
    assert shown.fact('', 'nonlinear terms') == ', '.join(t.name for t in plant.terms)
    assert ['y2 [m]', 'level2', 'not given'] in shown.rows_of('')
    assert 'one step each 1 s' in shown.fact('', 'time')
    direct = Plant.from_matrices(-np.eye(2), [1, 0], [[1, 0], [0, 2.5]], D=[1, 0],
                                 Cu=[[-1.0], [0]], Cd=[[0], [3.0]], noise=[0.25, np.nan])
    shown = Page(page(direct, design(direct)))
    assert ['y1', 'x1 - u1', '0.25'] in [cells for _, cells in shown.rows]
    assert ['y2', '2.5*x2 + 3*rho1', 'not given'] in [cells for _, cells in shown.rows]
    assert shown.fact('', 'unknown inputs') == 'rho1 on x1, y2'


def test_bounded_ones_say_by_how_much(discrete):
    _, result, text = discrete
    shown, entry = Page(text), result['y1', 'y1']
    assert entry.grade == 'bounded'
    assert shown.fact('e1', 'unknown inputs').endswith(
        f'at most {entry.disturbance_gain:.3g} m (near the operating point)')
    assert shown.fact('e2', 'unknown inputs') == 'do not reach it'
    assert 'within a bound' in shown.sections['e1'] and '1 of them within a bound' in shown.text


def test_a_page_needs_nothing_else(discrete):
    shown = Page(discrete[2])
    for tag, attributes in shown.tags:
        assert tag not in ('script', 'link', 'img', 'iframe', 'object')
        for name, value in attributes.items():
            assert not name.startswith('on')
            if name in ('href', 'src', 'xlink:href'):
                assert value.startswith('#')
    assert 'url(http' not in discrete[2]
    links = {a['href'][1:] for tag, a in shown.tags if tag == 'a' and 'href' in a}
    assert links == {a['id'] for tag, a in shown.tags if tag == 'section'}


# a page is drawn of each, which takes long: what does not hide another stands together
HOSTILE = ['<script>alert(1)</script> &amp;&lt; \u00b0C \u4e2d', "$\\frac{$ ' onload='x",
           '</section></svg> "><img src=x onerror=alert(1)>']


@pytest.fixture(scope='module')
def plain():
    """Make a plant whose texts are harmless, its design, and what its report shows of y2."""
    plant = Plant.from_matrices([[-1.0, 1], [0, -2]], [0, 1], np.eye(2), D=[1, 0])
    result = design(plant)
    runs = {run.__name__: run(plant, result, result['y2', 'y2'])
            for run in (report_simulation.from_wrong_start, report_simulation.disturbed)}
    return plant, result, runs


@pytest.mark.parametrize('text', HOSTILE)
def test_hostile_texts_are_only_texts(text, plain, monkeypatch):
    plant, result, runs = plain
    for name, run in runs.items():
        monkeypatch.setattr(report_simulation, name, lambda *_, run=run: run)
    units = dict.fromkeys(('x1', 'y1', 'y2', 'u1', 'rho1'), text)
    plant = replace(plant, name=text, units=units)
    entry = result['y2', 'y2']
    assert isinstance(entry, VirtualSensor)
    entries = {
        (('y1',), 'y1'): Refusal('y1', ('y1',), f'reason {text}', (f'doubt {text}',),
                                 f'or {text}'),
        (('y2',), 'y2'): replace(
            entry, method=text, terms=(NonlinearTerm(text, 'w1', np.zeros(1)),),
            P=np.zeros((entry.order, 1)), Gz=(np.zeros((1, entry.order)),),
            Gy=(np.zeros((1, 1)),), Gu=(np.zeros((1, 1)),),
            certificate=Certificate('region', 1.0, 1.0, np.eye(entry.order),
                                    (Limit(0, 0, 0.0, 1.0),), None, text, text,
                                    ((text, 0.0, 1.0),)))}
    result = replace(result, entries=entries, plant_name=text, units=units)
    made = page(plant, result, locations(plant))
    shown = Page(made)
    assert {tag for tag, _ in shown.tags} <= {
        'html', 'head', 'meta', 'title', 'style', 'body', 'h1', 'h2', 'h3', 'p', 'table', 'thead',
        'tbody', 'tr', 'th', 'td', 'a', 'br', 'code', 'strong', 'section', 'figure', 'figcaption',
        'svg', 'defs', 'g', 'path', 'use', 'text', 'rect', 'clippath', 'tspan'}
    assert not any(name.startswith('on') for _, attributes in shown.tags for name in attributes)
    assert f'Virtual sensors of {text}' in shown.text
    for needle in (f'reason {text}', f'In doubt: doubt {text}', f'Instead: or {text}'):
        assert needle in shown.sections['e1']
    assert f'only while 0 <= {text} <= 1: {text}' in shown.sections['e2'].replace('\xa0', ' ')
    assert f'BUT NOT PROVED {text}' in shown.sections['e2']
    pictures = re.findall(r'<svg.*?</svg>', made, re.DOTALL)
    assert len(pictures) == 1
    for svg in pictures:
        labels = ''.join(ElementTree.fromstring(svg).itertext())
        assert f'y2 [{text}]' in labels


def test_a_wrong_start_is_forgotten_at_the_rate_of_the_eigenvalues(designed):
    plant = load_plant(CONFIG / 'tclab' / 'plant.yaml')
    result = designed(plant)
    for v in result.virtual_sensors:
        run = report_simulation.from_wrong_start(plant, result, v)
        size = np.abs(run.error)
        assert size[0] > 0.1
        rate = np.log(size[0] / size[len(size) // 2]) / run.time[len(size) // 2]
        assert rate == pytest.approx(-v.eigenvalues.real.max(), rel=0.05)


def test_an_exact_one_stays_on_the_truth_and_a_bounded_one_within_its_gain(discrete):
    plant, result, _ = discrete
    exact = report_simulation.disturbed(plant, result, result['y3', 'y3'])
    assert np.abs(exact.truth - exact.still).max() > 0.05  # or nothing would be shown
    assert np.abs(exact.error).max() < 1e-12
    bounded = report_simulation.disturbed(plant, result, result['y1', 'y1'])
    assert np.abs(bounded.error).max() > 1e-3
    push = np.abs(exact.rho).max()
    assert push > 0
    before = exact.time < exact.time[-1] * report_simulation.STEP_AT - 0.5 * plant.sample_time
    assert not exact.rho[before].any() and exact.rho[~before][0] == push
    assert np.array_equal(exact.truth[before], exact.still[before])


def test_a_run_that_cannot_be_shown_says_why(monkeypatch):
    monkeypatch.setattr(report_simulation, 'MOST_LOOKS', 5000)
    stiff = Plant.from_matrices([[-1.0, 0.0], [1.0, -1e9]], None, np.eye(2))
    result = design(stiff)
    v = next(v for v in result.virtual_sensors if v.order)
    with pytest.raises(report_simulation.NotRun, match=r'^the plant (has modes|takes too long)'):
        report_simulation.from_wrong_start(stiff, result, v)
    shown = Page(page(stiff, result))
    assert 'The run from a wrong start is not shown: the plant ' in shown.text


def test_what_there_is_to_see(monkeypatch):
    twice = Plant.from_matrices([[-1.0]], None, [[1.0], [2.0]])
    text = page(twice, design(twice))  # no state, no unknown input
    assert text.count('It has no state that could start wrong.') == 2 and '<svg' not in text
    growing = Plant.from_matrices([[0.5, 1], [0, 0.3]], None, np.eye(2))
    truth = np.array([0.0, 12345.0])
    run = report_simulation.SimulatedRun(
        np.array([0.0, 2.0]), truth, truth - [1.0, 0.5], np.zeros((2, 0)), truth)
    monkeypatch.setattr(report_simulation, 'from_wrong_start', lambda *_: run)
    assert ('the error goes from 1 to 0.5 in 2 s, while the truth runs away to 12300.'
            in page(growing, design(growing)))


def test_an_estimate_that_starts_right_and_then_errs_is_no_runaway():
    """At 134 degC with an error that rises from nothing to 2, and is gone at the end."""
    time, truth = np.array([0.0, 1.0, 2.0]), np.array([130.0, 134.0, 134.0])
    run = report_simulation.SimulatedRun(
        time, truth, truth - [1e-13, 2.0, 1e-6], np.zeros((3, 0)), truth)
    assert _from_wrong_start(run, 'degC') == (
        'From a wrong start the error rises to 2 degC and is 1e-06 degC after 2 s.')
    stays = replace(run, estimate=truth - [1e-13, 2.0, 2.0])
    assert 'it does not find back' in _from_wrong_start(stays, 'degC')


def test_what_an_engineer_would_mind_and_long_terms_stand_in_the_report(
        tmp_path, without_pictures):
    path = tmp_path / 'plant.yaml'
    path.write_text("""
name: minded
time: continuous
parameters: {energy: 8.5, coolant: 2}
states: {slow: {range: [0, 1], process_noise: 20}, fast: {}}
inputs: {heat: {}}
dynamics:
  slow: heat - slow
  fast: slow - fast - 0.2*sin(energy*fast/(coolant*coolant + 1))*sin(slow + coolant)
sensors: {a: {measures: slow, noise: 0.1}, b: {measures: fast, noise: 3}}
""")
    plant = load_plant(path)
    shown = Page(page(plant, design(plant), advice=('a: it is of no <use>',)))
    assert 'Mind' in shown.text and 'a: it is of no <use>' in shown.text
    assert 'term 1 (of slow, fast)' in shown.text
    assert shown.text.count('sin(energy*fast/(coolant*coolant + 1))*sin(slow + coolant)') == 1


def test_wanted_functionals_are_shown_too():
    plant = Plant.from_matrices([[-1.0, 1], [0, -2]], None, [[1.0, 0]])
    result = design(plant, wanted={'v': [1, 1], 'both': np.eye(2)})
    shown = Page(page(plant, result))
    assert 'v: can be computed' in shown.text and 'both: can be computed' in shown.text
    v = result[(), 'v']
    run = report_simulation.from_wrong_start(plant, result, v)
    assert abs(run.error[-1]) < 1e-3 * abs(run.error[0])


def test_pictures_only_of_the_first_ones_and_the_same_each_time(discrete, monkeypatch):
    plant, result, text = discrete
    assert text.count('<svg') == 3 and 'Pictures are drawn for the first' not in text
    monkeypatch.setattr(report_module, 'MOST_PICTURES', 1)
    fewer = page(plant, result)
    assert fewer.count('<svg') == 1
    said = '<p>Pictures are drawn for the first 1 of 3 virtual sensors only.</p>\n'
    assert said in fewer
    _, second, third = re.findall(r'<figure>.*?</figure>', text, re.DOTALL)
    assert fewer.replace(said, '') == text.replace(second, '').replace(third, '')


def test_places_and_pairs(without_pictures):
    plant = Plant.from_matrices(
        [[-1, 0, 0], [1, -1, 0], [0, 1, -1]], None, np.eye(3)[[1, 2]], D=[1, 0, 0])
    result = design(plant, up_to=2)
    shown = Page(page(plant, result, locations(plant, up_to=2)))
    assert any(cells == ['x1', 'would let you lose y1 and replace y2 when y1+y2 failed '
                         '(1 more in larger sets)', '3', '3 of 3'] for _, cells in shown.rows)
    assert 'Not looked at' in Page(page(plant, result)).text
    three = Plant.from_matrices(-np.eye(3), None, np.eye(3), D=[1, 0, 0])
    shown = Page(page(three, design(three, up_to=2)))
    rows = [cells for _, cells in shown.rows]
    assert ['y1', 'no'] in [r[:2] for r in rows] and ['y2', 'no', 'yes'] in rows
    assert ['y3', 'no', 'yes', 'yes'] in rows


@pytest.mark.usefixtures('designed_once')
def test_a_file_and_a_folder_through_the_command(tmp_path, capsys, monkeypatch):
    plant = str(CONFIG / 'tclab' / 'plant.yaml')
    for pictures, given, made in ((1, 'out.html', 'out.html'),
                                  (0, 'folder/deep', 'folder/deep/index.html'),
                                  (0, 'folder/deep', 'folder/deep/index.html')):
        monkeypatch.setattr(report_module, 'MOST_PICTURES', pictures)
        assert main([plant, '-o', str(tmp_path / 'x'), '--report', str(tmp_path / given)]) == 0
        said = capsys.readouterr().out
        assert said.endswith(f'written to {tmp_path}/x, the report to {tmp_path / made}\n')
        shown = (tmp_path / made).read_text()
        assert shown.endswith('</html>\n') and shown.count('<svg') == pictures
    assert [p.name for p in (tmp_path / 'folder' / 'deep').iterdir()] == ['index.html']


@pytest.mark.parametrize(('report', 'needle'), [
    ('{folder}/file', 'is a file that is not named .html'),
    ('{folder}/a.html', 'is a folder'),
    ('{folder}/file/out.html', 'cannot be written (Not a directory)'),
    ('{folder}/none/out.html', 'cannot be written (No such file'),
    ('{folder}/a\0b.html', 'cannot be written (embedded null byte)'),
])
@pytest.mark.usefixtures('designed_once', 'without_pictures')
def test_a_place_that_is_none_gives_one_line(tmp_path, capsys, report, needle):
    (tmp_path / 'file').write_text('mine')
    (tmp_path / 'a.html').mkdir()
    plant = str(CONFIG / 'tclab' / 'plant.yaml')
    target = report.format(folder=tmp_path)
    assert main([plant, '-o', str(tmp_path / 'x'), '--report', target]) == 2
    said, wrong = capsys.readouterr()
    assert not said and wrong.startswith('designer: ') and wrong.count('\n') == 1
    assert needle in wrong
    assert (tmp_path / 'file').read_text() == 'mine'


def test_matplotlib_that_is_missing_is_said_before_anything_is_designed(
        tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    asked = [str(CONFIG / 'servo' / 'plant.yaml'), '--fault-set', 'y3', '-o', str(tmp_path / 'x')]
    assert main([*asked, '--report', str(tmp_path / 'r.html')]) == 2
    wrong = capsys.readouterr().err
    assert wrong == ('designer: report: matplotlib is not installed; pip install matplotlib, or '
                     'leave the report out\n')
    assert not list(tmp_path.iterdir())
    assert main(asked) == 0  # which does not need it


def test_the_old_report_stays_whole(tmp_path, monkeypatch):
    plant = Plant.from_matrices([[-1.0]], None, [[1.0]])
    path = tmp_path / 'r.html'
    path.write_text('old')

    def full(*_):
        raise OSError(28, 'No space left on device')
    with monkeypatch.context() as patch:
        patch.setattr(os, 'replace', full)
        with pytest.raises(BadInput, match='No space left'):
            write_report(path, plant, design(plant))
    assert path.read_text() == 'old' and list(tmp_path.iterdir()) == [path]
    link = tmp_path / 'link.html'
    link.symlink_to('r.html')
    write_report(link, plant, design(plant))
    assert link.is_symlink() and path.read_text().startswith('<!DOCTYPE html>')
