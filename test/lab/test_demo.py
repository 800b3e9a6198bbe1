"""The demo: its summary, its refusals, and one short failover in real processes."""

from dataclasses import replace
import json
from pathlib import Path
import shutil
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from vsensor_ros.command.demo import main
from vsensor_ros.lab import demo_failover, demo_runner
from vsensor_ros.lab.demo_failover import Run
from vsensor_ros.lab.demo_runner import Result, Row, table, told_of, write_summary
from vsensor_ros.lab.domain import reserved_domain
from vsensor_ros.lab.parameter_file import read_parameters
from vsensor_ros.lab.wiring import wiring_of
from vsensor_ros.observers import Design, VirtualSensor
from vsensor_ros.simulate import scenario
from vsensor_ros.simulate.fault import freeze, Recorded
from vsensor_ros.simulate.judge import Heard
from vsensor_ros.simulate.recording import NoRecording

CONFIG = Path(__file__).parents[2] / 'config'
GOOD = Row('tank', 'y1', 2, 1004.0, 4.25, 0.0012, 0.61, 'm')
BAD = Row('oven', 'T1', 1, None, None, None, float('nan'), 'degC')


def test_summary_is_valid_json_and_complete(tmp_path):
    write_summary(tmp_path / 'summary.json', [GOOD, BAD])
    records = json.loads((tmp_path / 'summary.json').read_text(), parse_constant=pytest.fail)
    assert records[0] == {'system': 'tank', 'failed_sensor': 'y1', 'order': 2, 'fault_ms': 1004.0,
                          'latency_ms': 4.25, 'rmse': 0.0012, 'rmse_hold': 0.61, 'unit': 'm'}
    assert (records[1]['rmse'], records[1]['rmse_hold']) == (None, None)
    assert [path.name for path in tmp_path.iterdir()] == ['summary.json']


def test_table_says_who_failed():
    good, bad = table([Result(GOOD, 0.002, '', True), Result(BAD, 0.8, '', False)]).split('\n')[3:]
    assert good.split() == ['tank', 'y1', '2', '1e+03', 'ms', '4.25', 'ms',
                            '0.0012', 'm', '0.61', 'm', '0.002', 'm', 'ok']
    assert 'none' in bad and bad.endswith('FAILED')


def test_an_unknown_system_is_refused_in_one_line(tmp_path, capsys):
    assert main(['four_tank', '--output', str(tmp_path / 'out')]) == 2
    said = capsys.readouterr().err
    assert said.startswith('demo: ') and 'four_tank' in said and 'three_tank' in said
    assert said.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_a_missing_recording_is_said_and_not_counted(tmp_path, capsys, monkeypatch):
    def nowhere(*_):
        raise NoRecording('run.mat', 'recording', 'is not here', 'fetch it')
    monkeypatch.setattr(scenario, 'find_recording', nowhere)
    assert main(['tclab', '--output', str(tmp_path)]) == 1      # nothing at all was shown
    assert 'tclab is not shown: run.mat: recording: is not here; fetch it' in \
        capsys.readouterr().out
    assert json.loads((tmp_path / 'summary.json').read_text()) == []


def test_what_the_replacer_says_of_itself_is_set_against_the_truth():
    time = np.arange(0.0, 10.0, 0.1)
    truth = Recorded.of(time, 2.0 * time)
    played = SimpleNamespace(
        unit='m', failed_sensor='y', truth=truth, isolated_at=7.05, end=9.9,
        channels={'y': freeze(truth, 4.05)})  # at 8 m
    late = time > 7.05
    error = np.where(time > 9.05, 0.3, 0.01)[late]  # 9 of 29 are out
    run = Run(Heard(time[late], truth.value[late] + error, time[late] - 7.05), True, -6.0,
              np.array([[7.0, 0.1], [10.0, 0.1]]))
    assert told_of(played, run) == [
        'step at the switch 6 m; the sensor was 6.1 m off the truth by then',
        'standard deviation given: 0.1 m; 69 % of the estimates are within two of it']
    assert told_of(played, replace(run, step=float('nan'), deviation=np.empty((0, 2)))) == []


def test_domains_are_reserved_once():
    with reserved_domain() as one, reserved_domain() as two:
        assert one != two


@pytest.fixture
def short_servo(tmp_path, monkeypatch):
    """Let the servo fail once its observer has converged, in a config folder of its own."""
    folder = tmp_path / 'config' / 'servo'
    shutil.copytree(CONFIG / 'servo', folder)
    content = yaml.safe_load((folder / 'demo.yaml').read_text())
    content |= {'isolated_at': 2.8, 'faults': [{'kind': 'freeze', 'start': 2.4},
                                               {'kind': 'drop_out', 'start': 3.4}]}
    content['simulation'] |= {'duration': 4.2, 'initial': {},
                              'inputs': {'voltage': '8*sin(2*t + 1)'}}
    content['bar']['rmse'] = 0.1    # on a busy machine too
    (folder / 'demo.yaml').write_text(yaml.safe_dump(content))
    (folder / 'demo_alone.yaml').unlink()
    monkeypatch.setattr(demo_runner, 'config_folder', lambda: tmp_path / 'config')
    return tmp_path / 'build'


def curves(array, topic):
    """Return what PlotJuggler calls the series of a DiagnosticArray, in no namespace."""
    return {'/'.join(filter(None, (topic, s.hardware_id.removeprefix('/robot'), s.name,
                                   value.key)))
            for s in array.status for value in s.values}


@pytest.mark.slow
def test_a_failover_in_real_processes(short_servo, capsys, monkeypatch):
    # on simulated time and in a namespace, which the parameter file alone says
    path = short_servo.parent / 'config' / 'servo' / 'replacer.yaml'
    own = yaml.safe_load(path.read_text())['/**']
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': {'use_sim_time': True}},
                                    'robot': {'replacer': own}}))
    statuses = []

    def read_status(array):
        statuses.append(array)
        return failover_reads(array)
    failover_reads = demo_failover.read_status
    monkeypatch.setattr(demo_failover, 'read_status', read_status)
    code = main(['--output', str(short_servo)])
    said = capsys.readouterr().out
    assert code == 0, said
    assert 'the replacer speaks for it' in said
    assert '  step at the switch 0.' in said and 'of the estimates are within two of it' in said
    [record] = json.loads((short_servo / 'summary.json').read_text())
    assert record['system'] == 'servo' and record['rmse'] < 0.2 * record['rmse_hold']
    assert (short_servo / 'servo.png').read_bytes().startswith(b'\x89PNG')
    assert_plots({*curves(statuses[0], '/replacer/status'), *curves(statuses[-1],
                 '/replacer/status')}, Design.load(short_servo / 'servo.design.json'))


def assert_plots(known, design):
    """Check that each curve of the layout for PlotJuggler is of something that is published."""
    known |= {f'/replacer/estimates/{name}/{key}' for (_, name), entry in design.entries.items()
              if isinstance(entry, VirtualSensor) for key in (
                  'value', 'deviation', 'offset', 'reading', 'reserve', 'reserve_deviation')}
    for port in wiring_of(read_parameters(CONFIG / 'servo' / 'replacer.yaml')).ports.values():
        array, _, joint = port.field.path.partition('[')
        known |= {f'{topic}/{joint[:-1]}/{array}' for topic in (port.source, port.output)}
    root = ElementTree.parse(CONFIG / 'plotjuggler.xml').getroot()
    plotted = {curve.get('name') for curve in root.iter('curve')}
    assert len(plotted) > 15 and plotted <= known, plotted - known
    for splitter in root.iter('DockSplitter'):
        count = int(splitter.get('count'))
        assert len(splitter) == len(splitter.get('sizes').split(';')) == count
    topics = root.find('Plugins/plugin/selected_topics').get('value').split(';')
    assert all(any(name.startswith(f'{topic}/') for topic in topics) for name in plotted)


@pytest.mark.slow
def test_a_story_in_which_nobody_isolates(short_servo):
    folder = short_servo.parent / 'config' / 'servo'
    content = yaml.safe_load((CONFIG / 'servo' / 'demo_alone.yaml').read_text())
    content['faults'] = [{'kind': 'freeze', 'start': 12.5}]
    content['bar'] = {'rmse': 0.01, 'of': 'range'}  # of a run so short 0.005 is its very noise
    content['simulation'] |= {'duration': 18.0, 'inputs': {'voltage': '8*sin(2*t + 1)'}}
    (folder / 'demo.yaml').write_text(yaml.safe_dump(content))
    assert main(['--output', str(short_servo)]) == 0
    [record] = json.loads((short_servo / 'summary.json').read_text())
    assert record['latency_ms'] is None and 0.0 < record['fault_ms'] < 3000.0
    assert record['rmse'] < 0.1 * record['rmse_hold']


@pytest.mark.slow
def test_a_replacer_that_dies_fails_the_demo(short_servo, capsys):
    path = short_servo.parent / 'config' / 'servo' / 'replacer.yaml'
    path.write_text(path.read_text().replace('rate: 100.0', 'rate: -1.0'))
    assert main(['--output', str(short_servo)]) == 1
    assert 'the replacer ended with 2' in capsys.readouterr().out
