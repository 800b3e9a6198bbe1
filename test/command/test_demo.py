"""The demo: its summary, its refusals, and one short failover in real processes."""

import json
from pathlib import Path
import shutil

import pytest
import yaml

from vsensor_ros.command import show
from vsensor_ros.command.demo import main
from vsensor_ros.command.failover import reserved_domain
from vsensor_ros.command.show import Result, Row, table, write_summary
from vsensor_ros.simulate import scenario
from vsensor_ros.simulate.recording import NoRecording

CONFIG = Path(__file__).parents[2] / 'config'
GOOD = Row('tank', 'y1', 2, 4.25, 0.0012, 0.61, 'm')
BAD = Row('oven', 'T1', 1, None, None, float('nan'), 'degC')


def test_summary_is_valid_json_and_complete(tmp_path):
    write_summary(tmp_path / 'summary.json', [GOOD, BAD])
    records = json.loads((tmp_path / 'summary.json').read_text(), parse_constant=pytest.fail)
    assert records[0] == {'system': 'tank', 'failed_sensor': 'y1', 'order': 2, 'latency_ms': 4.25,
                          'rmse': 0.0012, 'rmse_hold': 0.61, 'unit': 'm'}
    assert (records[1]['rmse'], records[1]['rmse_hold']) == (None, None)
    assert [path.name for path in tmp_path.iterdir()] == ['summary.json']


def test_table_says_who_failed():
    good, bad = table([Result(GOOD, 0.002, '', True), Result(BAD, 0.8, '', False)]).split('\n')[3:]
    assert good.split() == ['tank', 'y1', '2', '4.25', 'ms', '0.0012', 'm', '0.61', 'm', '0.002',
                            'm', 'ok']
    assert 'none' in bad and bad.endswith('FAILED')


def test_an_unknown_system_is_refused_in_one_line(tmp_path, capsys):
    assert main(['four_tank', '--output', str(tmp_path / 'out')]) == 2
    said = capsys.readouterr().err
    assert 'four_tank' in said and 'three_tank' in said and said.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_a_missing_recording_is_said_and_not_counted(tmp_path, capsys, monkeypatch):
    def nowhere(*_):
        raise NoRecording('run.mat', 'recording', 'is not here', 'fetch it')
    monkeypatch.setattr(scenario, 'find_recording', nowhere)
    assert main(['tclab', '--output', str(tmp_path)]) == 1      # nothing at all was shown
    assert 'tclab is not shown: run.mat: recording: is not here; fetch it' in \
        capsys.readouterr().out
    assert json.loads((tmp_path / 'summary.json').read_text()) == []


def test_domains_are_reserved_once():
    with reserved_domain() as one, reserved_domain() as two:
        assert one != two


@pytest.fixture
def short_servo(tmp_path, monkeypatch):
    """Let the servo fail within three seconds, in a config folder of its own."""
    folder = tmp_path / 'config' / 'servo'
    shutil.copytree(CONFIG / 'servo', folder)
    content = yaml.safe_load((folder / 'demo.yaml').read_text())
    content |= {'isolated_at': 1.5, 'faults': [{'kind': 'freeze', 'start': 1.0},
                                               {'kind': 'drop_out', 'start': 2.0}]}
    content['simulation'] |= {'duration': 3.0, 'initial': {},
                              'inputs': {'voltage': '8*sin(2*t + 1)'}}
    content['bar']['rmse'] = 0.1    # on a busy machine too
    (folder / 'demo.yaml').write_text(yaml.safe_dump(content))
    monkeypatch.setattr(show, 'config_folder', lambda: tmp_path / 'config')
    return tmp_path / 'build'


def test_a_failover_in_real_processes(short_servo, capsys):
    code = main(['--output', str(short_servo)])
    said = capsys.readouterr().out
    assert code == 0, said
    assert 'the replacer speaks for it' in said
    [record] = json.loads((short_servo / 'summary.json').read_text())
    assert record['system'] == 'servo' and record['rmse'] < 0.2 * record['rmse_hold']
    assert (short_servo / 'servo.png').read_bytes().startswith(b'\x89PNG')


def test_a_replacer_that_dies_fails_the_demo(short_servo, capsys):
    path = short_servo.parent / 'config' / 'servo' / 'replacer.yaml'
    path.write_text(path.read_text().replace('rate: 100.0', 'rate: -1.0'))
    assert main(['--output', str(short_servo)]) == 1
    assert 'the replacer ended with 2' in capsys.readouterr().out
