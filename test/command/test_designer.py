"""The command designer: what it says, what it writes, and one line for what is wrong."""

from dataclasses import replace
from importlib.util import find_spec
from itertools import combinations
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.command.designer import main
from vsensor_ros.designer.unfinished import Unfinished
from vsensor_ros.observers import Certificate, Design, Limit, Refusal, VirtualSensor
from vsensor_ros.report import design_text
from vsensor_ros.report.design_answer import answer

CONFIG = Path(__file__).parents[2] / 'config'
SERVO = CONFIG / 'servo' / 'plant.yaml'


LONG = {'base', 'three_tank', 'three_tank_discrete', 'two_link'}  # plants whose design takes long


@pytest.mark.parametrize('plant', [
    pytest.param(path, id=path.parent.name,
                 marks=[pytest.mark.slow] if path.parent.name in LONG else [])
    for path in sorted(CONFIG.glob('*/plant.yaml'))])
def test_what_is_said_is_what_is_written(plant, tmp_path, capsys):
    path = tmp_path / 'design.json'
    assert main([str(plant), '-o', str(path), '--up-to', '3', '--details', 'all']) == 0
    said, wrong = capsys.readouterr()
    assert not wrong
    result = Design.load(path)
    assert f'Plant {result.plant_name}, ' in said
    blocks = said.split('\n\n')
    once = ''.join(said.split())
    for (fault_set, channel), entry in result.entries.items():
        title = design_text.title(result, fault_set, channel)
        block, = (b for b in blocks if b.startswith(f'{title}: '))
        if isinstance(entry, Refusal):
            plain = ' '.join(block.split())
            assert ': cannot be replaced\n' in block and entry.reason in plain
            assert not entry.alternative or f'instead: {entry.alternative}' in plain
        else:
            some = {'temporary': ' for a time',
                    'filtered': ' by a filter of which nothing is proved'}.get(entry.grade, '')
            left = design_text.left_out(entry)
            functional = isinstance(entry, VirtualSensor)
            assert f'{title}: can be replaced{some}{left} order' in ' '.join(block.split())
            filtered = entry.grade == 'filtered'
            assert f'order             {entry.order}{"," if filtered else " ("}' in block
            assert all(name in block for name in entry.reads)
            if not functional:
                continue
            assert all(''.join(entry.terms[i].short.split()) in ''.join(
                block.split()) for i in entry.active if entry.terms[i].text != '1')
            assert all(once.count(''.join(entry.terms[i].name.split())) == 1
                       for i in entry.active if entry.terms[i].short != entry.terms[i].name)
    assert said.endswith(f'; written to {path}\n')
    assert f'\n\n{len(result.virtual_sensors)} of {len(result.entries)} can be replaced' in said
    lost = ' '.join(lines_of(said, 'Sensors that this plant can afford'))
    if any(entry.grade in ('temporary', 'filtered') for entry in result.virtual_sensors):
        return  # told in another way: see the next test
    for size, word in ((1, 'one'), (2, 'two'), (3, 'three')):
        sets = [s for s in result.fault_sets if len(s) == size]
        able = [s for s in sets
                if not any(isinstance(result[s, channel], Refusal) for channel in s)]
        named = ', '.join('+'.join(s) for s in able)
        if sets and not able:
            assert f'{word} none' in lost
        elif sets:
            count = f'all {len(sets)}' if able == sets else f'{len(able)} of {len(sets)}'
            assert f'{word} {count}: {named}' in lost


JOINT = """
name: joint
time: continuous
states:
  angle: {unit: rad, process_noise: 0, range: [-3, 3]}
  velocity: {unit: rad/s, process_noise: 0.2}
inputs: {command: {}}
dynamics: {angle: velocity, velocity: 8*command - 4*velocity}
sensors:
  encoder: {measures: angle, noise: 0.0005}
  tacho: {measures: velocity, noise: 0.005, tolerance: 0.1}
"""


def test_what_serves_for_a_time_is_told_from_what_serves_for_good(tmp_path, capsys):
    plant, path = tmp_path / 'joint.yaml', tmp_path / 'x'
    plant.write_text(JOINT)
    assert main([str(plant), '-o', str(path), '--up-to', '2']) == 0
    said = capsys.readouterr().out
    assert ('one      1 of 2 for good: tacho\n             for a time: encoder\n'
            '    two      none for good\n             for a time: encoder+tacho\n') in said
    block = said[said.index('encoder [rad] when it alone failed: can be replaced for a time'):]
    assert 'good              for 7.1 days to 0.6 rad; 0.000195 rad at the loss\n' in block
    assert 'it starts from the last good readings of encoder\n' in block
    assert '4 of 4 can be replaced, 2 of them for a time only; written to' in said
    assert Design.load(path)['encoder', 'encoder'].grade == 'temporary'
    assert Design.load(path).tolerance('tacho') == 0.1
    plant.write_text(JOINT.replace(', range: [-3, 3]', ''))
    assert main([str(plant), '-o', str(path)]) == 0
    assert ('for 1.6 s to 0.001 rad, for 2.9 min to 0.01 rad, for 4.8 h to 0.1 rad;'
            in capsys.readouterr().out)
    assert main([str(plant), '-o', str(path), '--no-temporary']) == 0
    said = capsys.readouterr().out
    assert 'one      1 of 2: tacho\n             not encoder\n' in said
    assert isinstance(Design.load(path)['encoder', 'encoder'], Refusal)


@pytest.mark.usefixtures('designed_once')
def test_servo_as_in_the_readme(tmp_path, capsys):
    assert main([str(SERVO), '-o', str(tmp_path / 'x')]) == 0
    readme = (CONFIG.parent / 'README.md').read_text()
    block = readme[readme.index('y2 [rad/s]: can'):]
    assert block[:block.index('```')].rstrip() in capsys.readouterr().out


@pytest.mark.usefixtures('designed_once')
def test_fault_sets_are_lists_with_commas(tmp_path, capsys):
    path = tmp_path / 'x'
    assert main(['--fault-set', 'y3, y2', '--fault-set', 'y2', str(SERVO), '-o', str(path)]) == 0
    assert Design.load(path).fault_sets == (('y2', 'y3'), ('y2',))
    said = capsys.readouterr().out
    assert 'y2 [rad/s] when y2 and y3 failed: ' in said
    assert 'y2 [rad/s] when it alone failed: ' in said


@pytest.mark.parametrize(('arguments', 'needle'), [
    (['{plant}', '-o', '{plant}'], '-o: {plant} is the plant file itself; name another file'),
    (['{plant}', '-o', '{link}'], '-o: {link} is the plant file itself'),
    (['{plant}', '-o', ''], '-o: is empty'),
    (['', '-o', '{out}'], 'PLANT: is empty'),
    (['{plant}', '-o', '{out}', '--fault-set', ''], '--fault-set: a name is empty'),
    (['{plant}', '-o', '{out}', '--fault-set', 'y1,'], '--fault-set: a name is empty'),
    (['{plant}', '-o', '{out}', '--fault-set', 'y1,y9'], 'y9'),
    (['{folder}/none.yaml', '-o', '{out}'], 'none.yaml: cannot be read (No such file'),
    (['{folder}', '-o', '{out}'], 'cannot be read (Is a directory)'),
    (['{plant}', '-o', '{folder}'], 'cannot be written (Is a directory)'),
    (['{plant}', '-o', '{folder}/no/such/x'], 'cannot be written (No such file'),
    (['{plant}', '-o', '{folder}/a\0b'], 'cannot be written (embedded null byte)'),
    (['{plant}\0', '-o', '{out}'], 'cannot be read (embedded null byte)'),
    (['{plant}', '-o', '{out}', '--prefer', 'loud'], "prefer: 'loud' is not a preference"),
    (['{plant}', '-o', '{out}', '--method', 'guess'], "method: 'guess' is not a method"),
    (['{plant}', '-o', '{out}', '--decay', '-1'], 'decay: -1.0 is not a rate'),
    (['{plant}', '-o', '{out}', '--up-to', '0'], 'up_to: 0 is not a number of sensors'),
    (['{plant}', '-o', '{out}', '--details', 'y9'], '--details: y9 is no fault set'),
    (['{plant}', '-o', '{out}', '--details', 'y1,'], '--details: a name is empty'),
    (['{plant}', '-o', '{out}', '--report', ''], '--report: is empty'),
    (['{plant}', '-o', '{out}', '--report', '{plant}'], '--report: {plant} is the plant file'),
    (['{plant}', '-o', '{out}', '--report', '{out}'], '--report: {out} is the design file'),
    (['{plant}', '-o', '{out}', '--report', '{link}'], '--report: {link} is the plant file'),
])
@pytest.mark.usefixtures('designed_once')
def test_bad_arguments_give_one_line(tmp_path, capsys, arguments, needle):
    names = {'plant': tmp_path / 'plant.yaml', 'link': tmp_path / 'link', 'folder': tmp_path,
             'out': tmp_path / 'x'}
    names['plant'].write_bytes(SERVO.read_bytes())
    names['link'].symlink_to('plant.yaml')
    assert main([a.format(**names) for a in arguments]) == 2
    said, wrong = capsys.readouterr()
    assert not said and wrong.startswith('designer: ') and wrong.count('\n') == 1
    assert needle.format(**names) in wrong
    assert names['plant'].read_bytes() == SERVO.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ['link', 'plant.yaml']


def test_a_bad_plant_gives_one_line_and_leaves_the_old_design(tmp_path, capsys):
    plant, path = tmp_path / 'plant.yaml', tmp_path / 'x'
    plant.write_text(SERVO.read_text().replace('k1*velocity', 'k1*speed'))
    path.write_text('old')
    assert main([str(plant), '-o', str(path)]) == 2
    assert "dynamics.angle: unknown name 'speed'" in capsys.readouterr().err
    assert path.read_text() == 'old'


@pytest.mark.parametrize('arguments', [
    [], ['x'], ['x', '-o'], ['x', 'y', '-o', 'z'], ['x', '-o', 'z', '--up-to', 'many'],
    ['x', '-o', 'z', '--up-to', '2', '--fault-set', 'y1'], ['x', '-o', 'z', '--decay', 'fast'],
    ['x', '-o', 'z', '--jobs', '0'], ['x', '-o', 'z', '--jobs', 'all']])
def test_usage(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert 'usage: designer' in capsys.readouterr().err


@pytest.mark.parametrize(('where', 'code', 'line'), [
    ('>/dev/full', 2, 'designer: stdout: cannot be written (No space left on device); '
                      'the design file is complete\n'),
    ('>&-', 0, ''),
    ('', 0, ''),
])
def test_a_stdout_that_is_full_closed_or_ascii(tmp_path, where, code, line):
    plant = tmp_path / 'plant.yaml'
    plant.write_text(SERVO.read_text().replace('unit: A,', 'unit: °C,'), encoding='utf-8')
    command = f'exec "$0" -m vsensor_ros.command.designer plant.yaml -o x --fault-set y3 {where}'
    done = subprocess.run(
        ['/bin/sh', '-c', command, sys.executable], capture_output=True, text=True, cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': str(CONFIG.parent), 'PYTHONIOENCODING': 'ascii'},
        timeout=120)
    assert (done.returncode, done.stderr) == (code, line)
    assert Design.load(tmp_path / 'x').units['y3'] == '°C'
    assert ('y3 [\\xb0C]: can be replaced' in done.stdout) == (not where)


def lines_of(said, start):
    """Return the lines from the one that starts so to the next empty one, as words."""
    lines = said.splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith(start))
    end = next(i for i in range(at, len(lines) + 1) if i == len(lines) or not lines[i])
    return [' '.join(line.split()) for line in lines[at + 1:end]]


def test_what_can_be_lost_comes_first(designed):
    """Of a row of eight tanks with a leak in the fourth."""
    result = designed(load_plant(SERVO), [('y2',)])
    v, names = result['y2', 'y2'], tuple(f'y{i}' for i in range(1, 9))
    entries = {(failed, y): Refusal(y, failed, 'a leak') if y == 'y4' else replace(
        v, channel=y, fault_set=failed) for n in (1, 2) for failed in combinations(names, n)
        for y in failed}
    said = answer(replace(result, sensors=names, entries=entries))
    one, not_one, two, not_two = lines_of(said, 'Sensors that this plant can afford')
    assert one == 'one 7 of 8: y1, y2, y3, y5, y6, y7, y8'
    assert not_one == 'not y4'
    assert two == 'two 21 of 28'
    assert not_two == 'none that holds y4'


def test_a_block_says_what_the_design_says(designed):
    result = designed(load_plant(CONFIG / 'three_tank' / 'plant.yaml'), [('y1',)])
    v = result['y1', 'y1']
    ladder = (v.ladder[0], replace(v.ladder[0], order=5, noise=0.0125, decay=0.5))
    certificate = Certificate('region', 0.11, 2.5, np.eye(v.order), (Limit(0, 0, 0.1, 3),),
                              (2.35, 0.25), 'it contracts')
    v = replace(v, ladder=ladder, certificate=certificate,
                proof=replace(v.proof, lower=1, doubts=('order 1: a close call',)))
    text = answer(replace(result, entries={(('y1',), 'y1'): v}))
    block = lines_of(text, 'y1 [m]: can be replaced')
    assert f'order {v.order} (the least is between 1 and {v.order})' in block
    noise = next(line for line in block if line.startswith('noise error '))
    assert f'{v.noise.error:.3g} m, {v.noise.ratio:.2f} x the floor' in noise
    assert f'{v.noise.floor:.3g} m' in noise and noise.endswith('assumed noise')
    slowest = -v.eigenvalues.real.max()
    assert any(line.startswith(f'decay {slowest:.3g} 1/s ') for line in block)
    assert f'ladder order {v.order}: noise error {ladder[0].noise:.3g} m, decay ' \
           f'{ladder[0].decay:.3g} 1/s <- this one' in block
    assert 'order 5: noise error 0.0125 m, decay 0.5 1/s' in block
    assert 'stability certified only while 0.1 <= level1 - level2 <= 3 m: it contracts' in block
    assert 'proved decay rate 0.11 1/s; readings wrong by 1 put it out by at most 2.5' in block
    assert "the papers' Lipschitz condition fails: 2.35 is not below 0.25" in block
    assert 'in doubt order 1: a close call' in block


@pytest.mark.parametrize(('certificate', 'needle'), [
    (None, 'not certified: judged by the linear part alone, without sign(velocity)'),
    (Certificate('none', 0.0, np.inf, np.zeros((1, 1)), (), None, 'it drives the motion'),
     'NOT CERTIFIED: it drives the motion'),
    (Certificate('global', 1.25, np.inf, np.eye(1), (), (1.0, 2.0), 'friction only brakes'),
     'certified everywhere: friction only brakes'),
])
def test_stability_is_never_silent(certificate, needle, designed):
    result = designed(load_plant(SERVO), [('y2',)])
    v = replace(result['y2', 'y2'], certificate=certificate)
    assert f'stability {needle}' in lines_of(
        answer(replace(result, entries={(('y2',), 'y2'): v})), 'y2 [rad/s]: can')


def test_what_is_not_certified_says_so_in_the_first_line(designed):
    result = designed(load_plant(SERVO), [('y2',)])
    nothing = Certificate('none', 0.0, np.inf, np.zeros((1, 1)), (), None, 'it drives the motion')
    v = replace(result['y2', 'y2'], certificate=nothing)
    said = answer(replace(result, entries={(('y2',), 'y2'): v}))
    assert 'y2 [rad/s]: can be replaced, BUT NOT CERTIFIED: it drives the motion\n' in said


def test_figures_and_times_are_written_as_people_do():
    assert [design_text.number(v) for v in (1459.6, 999.7, 0.00123, 2.5e6, -1.23456e4)] == [
        '1460', '1000', '0.00123', '2.5e+06', '-12300']
    assert [design_text.seconds(v) for v in (449.0, 1800.0, 24000.0, 3e6, np.inf)] == [
        '449 s', '30 min', '6.67 h', '34.7 days', 'inf s']


def test_a_dead_beat_is_called_so_on_every_rung(tmp_path, capsys):
    """A pipe of three pieces, measured at both ends."""
    plant = tmp_path / 'pipe.yaml'
    plant.write_text("""
name: pipe
time: {sample_time: 60}
states: {hot: {}, a: {}, b: {}, c: {}}
inputs: {burner: {operating: 1}}
dynamics: {hot: 0.9*hot + burner, a: hot, b: a, c: b}
sensors: {flow: {measures: hot, noise: 0.2}, back: {measures: c, noise: 0.2}}
""")
    assert main([str(plant), '-o', str(tmp_path / 'x'), '--fault-set', 'back']) == 0
    said = capsys.readouterr().out
    assert 'decay             dead beat (an error is down to 5 % in 180 s)' in said
    v = Design.load(tmp_path / 'x')['back', 'back']
    text = answer(replace(Design.load(tmp_path / 'x'), entries={(('back',), 'back'): replace(
        v, ladder=(replace(v.ladder[0], order=1, decay=0.01), v.ladder[0]))}))
    assert 'order 1: noise error' in text and ', decay 0.01 1/s\n' in text
    assert ', decay dead beat <- this one\n' in text


def test_many_eigenvalues_are_shortened(designed):
    result = designed(load_plant(SERVO), [('y2',)])
    v = result['y2', 'y2']
    values = np.array([*-np.arange(1.0, 41), -0.5 + 2j, -0.5 - 2j])
    text = answer(replace(result, entries={(('y2',), 'y2'): replace(v, eigenvalues=values)}))
    assert 'eigenvalues of N -0.5 +- 2i, -1, -2, -3, -4, .. 35 more .., -40' in lines_of(
        text, 'y2 [rad/s]: can')


@pytest.mark.slow
@pytest.mark.usefixtures('designed_once')
def test_bounded_ones(tmp_path, capsys):
    plant = str(CONFIG / 'three_tank_discrete' / 'plant.yaml')
    assert main([plant, '-o', str(tmp_path / 'x'), '--bounded']) == 0
    said = capsys.readouterr().out
    entry = Design.load(tmp_path / 'x')['y1', 'y1']
    assert entry.grade == 'bounded'
    block = lines_of(said, 'y1 [m]: can be replaced within a bound')
    assert 'unknown inputs reach it: ' in ' '.join(block)
    assert f' {entry.disturbance_gain:.3g} m' in ' '.join(block)
    assert 'of these disturbed by unknown inputs, within a bound: y1' in said
    assert '3 of 3 can be replaced, 1 of them within a bound only; written' in said


def test_choices_reach_the_design(tmp_path, monkeypatch, designed):
    asked = []

    def design(plant, fault_sets, *, progress, executor, work_file, **choices):
        assert executor is None and work_file == str(tmp_path / 'x.work')
        asked.append((plant.name, fault_sets, choices))
        return designed(plant, [('y2',)])
    monkeypatch.setattr('vsensor_ros.command.designer.design', design)
    assert main([str(SERVO), '-o', str(tmp_path / 'x'), '--up-to', '2', '--prefer', 'least',
                 '--decay', '3', '--method', 'jordan', '--bounded']) == 0
    assert main([str(SERVO), '-o', str(tmp_path / 'x'), '--fault-set', 'y1,y2']) == 0
    assert asked == [
        ('servo', None, {'up_to': 2, 'prefer': 'least', 'decay': 3.0, 'method': 'jordan',
                         'bounded': True}),
        ('servo', [['y1', 'y2']], {})]


@pytest.mark.usefixtures('designed_once')
def test_of_many_only_those_asked_for_are_printed(tmp_path, capsys):
    plant, path = tmp_path / 'plant.yaml', tmp_path / 'x'
    states = [f'T{i}' for i in range(1, 13)]
    plant.write_text('\n'.join([
        'name: many', 'time: continuous', 'states:', *(f'  {s}: {{unit: K}}' for s in states),
        'dynamics:', *(f'  {s}: -{i + 1}*{s}' for i, s in enumerate(states)),
        'sensors:', *(f'  m{i + 1}: {{measures: {s}}}' for i, s in enumerate(states))]))
    assert main([str(plant), '-o', str(path)]) == 0
    said = capsys.readouterr().out
    assert 'm1 [K]' not in said and 'one all 12: m1, m2,' in ' '.join(said.split())
    assert '12 more not printed: ask with --details SENSORS or --details all' in said
    assert main([str(plant), '-o', str(path), '--details', 'm7']) == 0
    said = capsys.readouterr().out
    assert 'm7 [K]: can be replaced' in said and 'm8 [K]' not in said
    assert main([str(plant), '-o', str(path), '--details', 'all']) == 0
    said = capsys.readouterr().out
    assert said.count(' [K]: can be replaced') == 12 and 'more not printed' not in said


def test_where_one_more_sensor_would_help(tmp_path, capsys):
    plant, path = tmp_path / 'plant.yaml', str(tmp_path / 'x')
    plant.write_text("""
name: chain
time: continuous
states: {a: {unit: m}, b: {unit: m}, c: {unit: m}, alone: {unit: m}}
disturbances: {leak: {unit: m/s}}
dynamics: {a: leak - a, b: a - b, c: b - c, alone: -alone}
sensors: {yb: {measures: b}, yc: {measures: c}}
""")
    assert main([str(plant), '-o', path, '--locate']) == 0
    assert lines_of(capsys.readouterr().out, 'With one more sensor') == [
        'a would let you lose yb']
    assert main([str(plant), '-o', path, '--locate', '--up-to', '2']) == 0
    assert lines_of(capsys.readouterr().out, 'With one more sensor') == [
        'a would let you lose yb and replace yc when yb+yc failed (1 more in larger sets)']
    assert main([str(SERVO), '-o', path, '--locate', '--fault-set', 'y2']) == 0
    assert 'every state is measured already' in capsys.readouterr().out


@pytest.mark.parametrize('with_rich', [
    False, pytest.param(True, marks=pytest.mark.skipif(find_spec('rich') is None,
                                                       reason='rich is not installed'))])
def test_progress_is_shown_on_a_terminal(tmp_path, with_rich):
    """What is none stays empty: test_a_stdout_that_is_full_closed_or_ascii."""
    ours, theirs = os.openpty()
    run = '' if with_rich else "sys.modules['rich.console'] = None; "
    run = f'import sys; {run}from vsensor_ros.command.designer import main; sys.exit(main())'
    try:
        done = subprocess.run(
            [sys.executable, '-c', run, str(SERVO), '-o', str(tmp_path / 'x')],
            stderr=theirs, stdout=subprocess.DEVNULL, timeout=120,
            env={**os.environ, 'PYTHONPATH': str(CONFIG.parent), 'TERM': 'xterm'})
        assert done.returncode == 0
        shown = os.read(ours, 10000).decode()
    finally:
        os.close(ours)
        os.close(theirs)
    if with_rich:
        plain = re.sub(r'\x1b\[[0-9;?]*[a-zA-Z]', '', shown)
        assert re.search('1/3 .* y2 without y2', plain)
        shown = shown.removesuffix('\x1b[?25h')  # the cursor
    else:
        assert '\r\x1b[K1/3 y2 without y2' in shown
    assert shown.endswith('\x1b[2K' if with_rich else '\r\x1b[K')  # nothing is left of it


def test_ctrl_c_ends_in_one_line(tmp_path, capsys, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt
    monkeypatch.setattr('vsensor_ros.command.designer.design', stop)
    assert main([str(SERVO), '-o', str(tmp_path / 'x')]) == 130
    assert capsys.readouterr().err == 'designer: stopped\n' and not (tmp_path / 'x').exists()


def test_what_is_kept_when_it_is_stopped_is_gone_on_from(tmp_path, capsys, monkeypatch):
    path, work, asked = tmp_path / 'x', tmp_path / 'x.work', []

    def stopping(plant, sets, *, progress, **given):
        def stop(done, *_):
            if done == 2:
                raise KeyboardInterrupt
        return design(plant, sets, progress=stop, **given)

    def going_on(plant, sets, *, progress, **given):
        asked.append(len(work.read_text().splitlines()) if work.exists() else 0)
        return design(plant, sets, progress=progress, **given)
    for options, kept in ((['--resume'], 3), ([], 0)):
        monkeypatch.setattr('vsensor_ros.command.designer.design', stopping)
        assert main([str(SERVO), '-o', str(path)]) == 130
        assert capsys.readouterr().err == (
            f'designer: stopped; what is designed is kept in {work}: --resume goes on from it\n')
        assert not path.exists() and len(work.read_text().splitlines()) == 3
        monkeypatch.setattr('vsensor_ros.command.designer.design', going_on)
        assert main([str(SERVO), '-o', str(path), *options]) == 0
        assert asked.pop() == kept and not work.exists()
        path.unlink()
    work.write_text('{}\n')
    assert main([str(SERVO), '-o', str(path), '--resume']) == 2
    wrong = capsys.readouterr().err
    assert wrong.startswith(f'designer: {work}: work file: is no work file of the designer')
    assert wrong.count('\n') == 1 and work.read_text() == '{}\n'


def test_an_error_of_one_channel_is_said_last(tmp_path, capsys, monkeypatch):
    def failing(plant, sets, **given):
        try:
            raise ZeroDivisionError('by zero')
        except ZeroDivisionError as error:
            raise Unfinished(design(plant, [('y3',)]), {(('y1',), 'y1'): error}, 2) from error
    monkeypatch.setattr('vsensor_ros.command.designer.design', failing)
    assert main([str(SERVO), '-o', str(tmp_path / 'x')]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == 'Traceback (most recent call last):'
    assert lines[-1] == ('designer: y1 without y1: ZeroDivisionError: by zero; 1 of 2 channels '
                         'failed, the others are designed')


def processes_of_group(group):
    """Return the command lines of a group's processes that have not ended."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            state, _, of = (folder / 'stat').read_text().rpartition(')')[2].split()[:3]
            if int(of) == group and state != 'Z':
                found.append((folder / 'cmdline').read_text())
        except OSError:
            continue  # has ended meanwhile
    return found


@pytest.mark.slow
def test_ctrl_c_ends_all_processes_and_another_number_of_them_goes_on(tmp_path):
    """As from a keyboard: all processes of the command get it."""
    plant, path, work = tmp_path / 'plant.yaml', tmp_path / 'x', tmp_path / 'x.work'
    states = [f'T{i}' for i in range(9)]
    plant.write_text('\n'.join([
        'name: many', 'time: continuous', 'states:', *(f'  {s}: {{unit: K}}' for s in states),
        'dynamics:', *(f'  {s}: T{(i + 1) % 9} - {i + 2}*{s}' for i, s in enumerate(states)),
        'sensors:', *(f'  m{i}: {{measures: {s}}}' for i, s in enumerate(states))]))
    command = [sys.executable, CONFIG.parent / 'scripts' / 'designer', plant, '-o', path,
               '--up-to', '2']
    environment = {**os.environ, 'PYTHONPATH': str(CONFIG.parent)}
    stopped = subprocess.Popen([*command, '--jobs', '2'], stderr=subprocess.PIPE, text=True,
                               env=environment, start_new_session=True)
    while not (work.exists() and work.read_text().count('\n') > 3):
        assert stopped.poll() is None, stopped.stderr.read()
        time.sleep(0.01)
    os.killpg(stopped.pid, signal.SIGINT)
    wrong = stopped.communicate(timeout=60)[1]
    assert stopped.returncode == 130 and wrong == (
        f'designer: stopped; what is designed is kept in {work}: --resume goes on from it\n')
    deadline = time.monotonic() + 60.0
    while alive := processes_of_group(stopped.pid):
        assert time.monotonic() < deadline, alive
        time.sleep(0.01)
    kept = work.read_bytes()
    assert not path.exists() and 3 < kept.count(b'\n') < 82
    done = subprocess.run([*command, '--resume', '--jobs', '1'], env=environment, timeout=300,
                          capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, '') and not work.exists()
    design(load_plant(plant), up_to=2).save(tmp_path / 'y')
    assert path.read_bytes() == (tmp_path / 'y').read_bytes()


def test_a_long_term_is_written_out_once_and_what_forgets_in_steps_has_no_rate(tmp_path):
    path = tmp_path / 'plant.yaml'
    path.write_text("""
name: chain
time: {sample_time: 2}
states: {a: {}, b: {}}
dynamics: {a: '0.5*tanh(a*1.25 + 0.125)*cos(a + 0.375)*exp(-a**2)', b: a}
sensors: {y1: {measures: a}, y2: {measures: b}}
""")
    plant = load_plant(path)
    text = ' '.join(answer(design(plant, [('y1',), ('y2',), ('y1', 'y2')]), plant=plant).split())
    assert text.count('cos(a + 0.375)') == 1 and text.count('term 1 (of a)') > 2
    assert 'dead beat (an error is down to 5 % in 2 s)' in text


CART = """
name: cart
time: {sample_time: 0.05}
states:
  p: {unit: m, noise_bound: 0.002}
  v: {unit: m/s, range: [-3, 3], noise_bound: 0.002}
inputs: {push: {range: [-2, 2]}}
sensors:
  ruler: {measures: p, unit: m, noise_bound: 0.01}
  tacho: {measures: v, unit: m/s, noise_bound: 0.01}
premises: {p: [-2, 2]}
submodels:
  - {A: [[1, 0.05], [-0.1, 0.9]], B: [0, 0.05], membership: (2 - p)/4}
  - {A: [[1, 0.05], [-0.02, 0.98]], B: [0, 0.05], membership: (2 + p)/4}
"""


def test_faults_of_a_plant_with_submodels_are_asked_for_by_name(tmp_path, capsys):
    pytest.importorskip('cvxpy')
    plant, path = tmp_path / 'cart.yaml', tmp_path / 'cart.design.json'
    plant.write_text(CART)
    assert main([str(plant), '--faulty', 'tacho', '-o', str(path)]) == 0
    said, wrong = capsys.readouterr()
    entry, = Design.load(path).virtual_sensors
    assert not wrong and entry.outputs == ('tacho',) and entry.kind == 'fault_estimator'
    assert f'tacho within {entry.half_widths[0]:.3g} m/s' in said
    assert 'reads             ruler, push; of sensors that may be faulty nothing' in said
    assert f'1 of 1 can be replaced; written to {path}' in said
    path.unlink()
    for arguments, line in ((['--faulty', 'speed'], "faulty: 'speed' is no sensor and no input"),
                            ([], 'submodels: are for what estimates faults, or by hand')):
        assert main([str(plant), *arguments, '-o', str(path)]) == 2
        assert line in capsys.readouterr().err and not path.exists()
    with pytest.raises(SystemExit):
        main([str(plant), '--faulty', 'tacho', '--isolate', '-o', str(path)])
    assert '--faulty stands alone with PLANT and -o' in capsys.readouterr().err
