"""The command designer: what it says, what it writes, and one line for what is wrong."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

from vsensor_ros.command.designer import main
from vsensor_ros.virtual_sensor import Design, Refusal

CONFIG = Path(__file__).parents[2] / 'config'
SERVO = CONFIG / 'servo' / 'plant.yaml'


@pytest.mark.parametrize('plant', sorted(CONFIG.glob('*/plant.yaml')), ids=lambda p: p.parent.name)
def test_what_is_said_is_what_is_written(plant, tmp_path, capsys):
    path = tmp_path / 'design.json'
    assert main([str(plant), '-o', str(path)]) == 0
    said, wrong = capsys.readouterr()
    assert not wrong
    result = Design.load(path)
    assert f'Plant {result.plant_name}, ' in said
    for entry in result.entries.values():
        block = next(b for b in said.split('\n\n') if b.startswith(f'{entry.channel} '))
        if isinstance(entry, Refusal):
            assert ': cannot be replaced\n' in block and entry.reason in block
        else:
            assert ': can be replaced\n' in block
            assert f'order             {entry.order} (' in block
            assert all(entry.terms[i].name in block for i in entry.active)
            assert all(name in block for name in entry.reads)
    assert said.endswith(f'\n\n{len(result.virtual_sensors)} of {len(result.entries)} can be '
                         f'replaced; written to {path}\n')


def test_servo_as_in_the_readme(tmp_path, capsys):
    assert main([str(SERVO), '-o', str(tmp_path / 'x')]) == 0
    readme = (CONFIG.parent / 'README.md').read_text()
    block = readme[readme.index('y1 [rad]: cannot'):]
    assert block[:block.index('```')].rstrip() in capsys.readouterr().out


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
])
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


@pytest.mark.parametrize('arguments', [[], ['x'], ['x', '-o'], ['x', 'y', '-o', 'z']])
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
    command = f'exec "$0" -m vsensor_ros.command.designer plant.yaml -o x {where}'
    done = subprocess.run(
        ['/bin/sh', '-c', command, sys.executable], capture_output=True, text=True, cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': str(CONFIG.parent), 'PYTHONIOENCODING': 'ascii'},
        timeout=120)
    assert (done.returncode, done.stderr) == (code, line)
    assert Design.load(tmp_path / 'x').units['y3'] == '°C'
    assert ('y3 [\\xb0C]: can be replaced' in done.stdout) == (not where)
