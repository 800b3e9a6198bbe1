"""The fault-injection suite: on the real node, on one that lies, and its judge on its own."""

from collections import Counter
from dataclasses import replace
import json
import math
import os
from pathlib import Path
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
import yaml

from vsensor_ros import design
from vsensor_ros.command.fault_injection import main
from vsensor_ros.lab.domain import reserved_domain
from vsensor_ros.lab.injection import suite
from vsensor_ros.lab.injection.message_cases import _thousand_of
from vsensor_ros.lab.injection.suite import (
    ALL,
    ALONE_CASES,
    ALONE_QUICK,
    CaseResult,
    QUICK,
    TRIES,
)
from vsensor_ros.lab.injection.truth import compute_truth
from vsensor_ros.lab.injection.verdict import (
    Evidence,
    handovers_of,
    judge,
    Out,
    path_of,
    Stated,
    StatusHeard,
)
from vsensor_ros.lab.process import die_with_parent
from vsensor_ros.node.accessor import get_stamp, put_stamp
from vsensor_ros.plant import load_plant

SERVO = Path(__file__).parents[2] / 'config' / 'servo'

# It falls over at 3 1/s. Each sensor can be replaced out of the other.
PENDULUM = {
    'name': 'pendulum', 'time': 'continuous', 'states': {'angle': {}, 'speed': {}},
    'inputs': {'force': {}}, 'dynamics': {'angle': 'speed', 'speed': '9*angle + force'},
    'sensors': {'y1': {'measures': 'angle'}, 'y2': {'measures': 'speed'}}}
HELD = {'failed_sensor': 'y2', 'simulation': {
    'initial': {'angle': 0.1}, 'inputs': {'force': '-30*angle - 8*speed + 5*sin(1.3*t)'}}}

# It passes everything on, and says of itself what a replacer would.
LIAR = """
import sys, time
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
rclpy.init()
node = rclpy.create_node('replacer')
out = node.create_publisher(JointState, '/servo/joint_states', 100)
status = node.create_publisher(DiagnosticArray, '~/status', QoSProfile(
    depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
node.create_subscription(JointState, '/servo/joint_states_raw', out.publish, 100)
node.create_subscription(Float64, '/servo/voltage', lambda message: None, 100)
sources, switches, healthy = dict.fromkeys(('y1', 'y2', 'y3'), 'real'), 0, None
def say():
    status.publish(DiagnosticArray(status=[DiagnosticStatus(name=name, values=[
        KeyValue(key='source', value=source), KeyValue(key='switches', value=str(switches))])
        for name, source in sources.items()]))
def turn(source):
    global switches
    if sources['y2'] != source:
        sources['y2'], switches = source, switches + 1
        say()
def hear(message):
    global healthy
    faulty = any(s.name == 'y2' and s.level == b'\\x02' for s in message.status)
    healthy = None if faulty else healthy or time.monotonic()
    if faulty:
        turn('virtual')
def look():
    if healthy and time.monotonic() - healthy > 0.3:
        turn('real')
node.create_subscription(DiagnosticArray, '/isolation', hear, 10)
node.create_timer(0.02, look)
node.create_timer(0.5, say)
rclpy.spin(node)
"""


@pytest.fixture(scope='module')
def servo_design(tmp_path_factory):
    path = tmp_path_factory.mktemp('design') / 'servo.json'
    design(load_plant(SERVO / 'plant.yaml')).save(path)
    return path


@pytest.fixture
def quick(tmp_path, servo_design):
    """Return arguments for the servo, with a shorter dwell."""
    content = yaml.safe_load((SERVO / 'replacer.yaml').read_text())
    content['/**']['ros__parameters'] |= {'recovery': {'dwell': 0.3},
                                               'design_file': str(servo_design)}
    (tmp_path / 'replacer.yaml').write_text(yaml.safe_dump(content))
    return ['--plant', str(SERVO / 'plant.yaml'), '--params-file', str(tmp_path / 'replacer.yaml'),
            '--report', str(tmp_path / 'report.json')]


def results_of(arguments):
    return {r['case']: r for r in json.loads(Path(arguments[-1]).read_text())}


@pytest.mark.slow
def test_the_node_passes(quick, capsys):
    names = ['bias', 'burst']
    code = main(['--only', ','.join(names), *quick])
    said = capsys.readouterr().out
    assert code == 0, said
    results = results_of(quick)
    assert list(results) == ['start', *names]
    # a computer too busy to tell skips a case, or starts a replacer once more
    assert all(r['outcome'] == 'PASS' or 'too busy' in r['seen'] for r in results.values())
    assert ' passed, 0 failed, ' in said


@pytest.mark.slow
def test_the_node_finds_out_alone(quick, capsys):
    rewrite(quick, lambda own: {'/**': {'ros__parameters': {
        **own['ros__parameters'], 'design_file': 'none'}}})
    code = main(['--alone', '--quick', *quick])
    said = capsys.readouterr().out
    assert code == 0, said
    results = results_of(quick)
    assert list(results) == ['learning', 'freeze', 'bias']
    if results['freeze']['outcome'] == 'PASS':    # else this computer was too busy to tell
        y1, y2, y3 = results['freeze']['faults']
        assert y1['kind'] == y2['kind'] == y3['kind'] == 'stuck'
        assert (y1['sensor'], y1['replaced_s']) == ('y1', None)     # nothing can replace it
        assert max(y2['error'], y3['error']) < 0.05
    else:
        assert 'too busy' in results['freeze']['seen'], said
    if results['bias']['outcome'] == 'PASS':
        kinds = {fault['sensor']: fault['kind'] for fault in results['bias']['faults']}
        assert kinds == {'y1': None, 'y2': 'bias', 'y3': 'bias'}    # no residual feels y1
    else:
        assert 'too busy' in results['bias']['seen'], said


def test_alone_needs_a_design_with_residuals(quick, capsys):
    assert main(['--alone', *quick]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and 'isolability: no residual tells of a fault' in said
    with pytest.raises(SystemExit, match='2'):
        main(['--alone', '--running', *quick])
    assert main(['--alone', '--only', 'toggle', *quick]) == 2
    assert 'there is no case toggle' in capsys.readouterr().err


@pytest.mark.slow
def test_a_relay_that_lies_fails(quick, tmp_path, monkeypatch, capsys):
    (tmp_path / 'liar.py').write_text(LIAR)
    with reserved_domain() as domain:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        liar = subprocess.Popen([sys.executable, str(tmp_path / 'liar.py')], env=os.environ,
                                preexec_fn=die_with_parent)
        try:
            code = main(['--only', 'bias,nan,kill_9', '--running', *quick])
        finally:
            liar.kill()
            liar.wait()
    said = capsys.readouterr().out
    assert code == 1, said
    results = results_of(quick)
    # what it says is flawless: the truth alone gives it away
    assert results['start']['outcome'] == 'PASS', said
    assert results['bias']['outcome'] == 'FAIL', said
    assert results['bias']['seen'].startswith('y2: ') and 'are wrong' in results['bias']['seen']
    assert 'no numbers' in results['nan']['seen'] and results['nan']['outcome'] == 'FAIL'
    assert results['kill_9']['outcome'] == 'skipped' and 'not ours' in results['kill_9']['seen']


def test_what_cannot_be_done_is_said_in_one_line(quick, tmp_path, capsys):
    assert main(['--only', 'earthquake', *quick]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and 'garbage' in said
    assert said.startswith('fault_injection: --only: there is no case earthquake; ')
    quick = [*quick[:4], '--only', 'start', *quick[4:]]
    for wrong in (['--plant', str(tmp_path / 'none.yaml'), *quick[2:]],
                  [*quick[:-1], str(tmp_path / 'none' / 'report.json')],
                  [*quick, '--scenario', str(SERVO.parent / 'tclab' / 'demo.yaml')],
                  [*quick, '--ros-args', '-r', 'a b']):
        assert main(wrong) == 2
        said = capsys.readouterr()
        assert said.err.count('\n') == 1 and said.err.startswith('fault_injection: '), said
        assert not said.err.startswith('fault_injection: fault_injection'), said


def rewrite(arguments, change):
    """Put the parameters of the replacer another way, in the order given."""
    path = Path(arguments[3])
    path.write_text(yaml.safe_dump(change(yaml.safe_load(path.read_text())['/**']),
                                   sort_keys=False))


@pytest.mark.slow
def test_a_parameter_file_for_all_nodes_and_simulated_time(quick, capsys):
    rewrite(quick, lambda own: {'/**': {'ros__parameters': {
        **own['ros__parameters'], 'use_sim_time': True}}})
    assert main(['--only', 'start', *quick]) == 0, capsys.readouterr().out
    assert [(name, r['outcome']) for name, r in results_of(quick).items()] == [('start', 'PASS')]


@pytest.mark.slow
def test_a_parameter_file_with_a_namespace_and_a_clock_that_stands_still(quick, capsys):
    rewrite(quick, lambda own: {'robot': {'replacer': own}})
    assert main(['--only', 'paused_clock', *quick]) == 0, capsys.readouterr().out
    assert results_of(quick)['paused_clock']['seen'] == 'real > virtual > none > virtual > real'


@pytest.fixture
def pendulum(tmp_path):
    """Return arguments for a plant that falls over unless its commands hold it."""
    (tmp_path / 'plant.yaml').write_text(yaml.safe_dump(PENDULUM, sort_keys=False))
    (tmp_path / 'demo.yaml').write_text(yaml.safe_dump(HELD))
    joints = {'topic': '/pendulum', 'type': 'sensor_msgs/msg/JointState'}
    (tmp_path / 'replacer.yaml').write_text(yaml.safe_dump({'replacer': {'ros__parameters': {
        'design_file': 'none', 'recovery': {'dwell': 0.3},
        'sensors': {'y1': {**joints, 'field': 'position[rod]'},
                    'y2': {**joints, 'field': 'velocity[rod]'}},
        'commands': {'force': {'topic': '/force', 'type': 'std_msgs/msg/Float64',
                               'field': 'data'}}}}}))
    return ['--plant', str(tmp_path / 'plant.yaml'), '--params-file',
            str(tmp_path / 'replacer.yaml'), '--report', str(tmp_path / 'report.json')]


@pytest.mark.slow
def test_an_unstable_plant_that_its_commands_hold_is_judged_fairly(pendulum, capsys):
    assert main(['--only', 'bias', *pendulum]) == 0, capsys.readouterr().out
    assert results_of(pendulum)['bias']['outcome'] == 'PASS'


def test_an_unstable_plant_that_nothing_holds_is_refused(pendulum, tmp_path, capsys):
    for content in (None, {'simulation': {'inputs': {'force': 'sin(t)'}}}):
        (tmp_path / 'demo.yaml').unlink(missing_ok=True)
        if content:
            (tmp_path / 'demo.yaml').write_text(yaml.safe_dump(content))
        assert main(['--only', 'bias', *pendulum]) == 2
        said = capsys.readouterr().err
        assert said.count('\n') == 1
        assert 'unstable' in said and 'give inputs that hold the plant' in said


@pytest.mark.parametrize('force, dynamics, told', [
    # a gain that is too weak: one pole stays at 0.5 1/s
    ('2*sin(1.3*t) - 8.5*angle - 0.5*speed', '9*angle + force',
     'simulation.inputs: y1: runs away: pendulum is not held by inputs that read its states; '
     'give inputs that hold the plant'),
    ('exp(0.5*t)', '-9*angle - speed + force',
     'simulation.inputs: y1: runs away: pendulum follows inputs that grow; give inputs'),
    ('exp(1e3*t)', '-9*angle - speed + force', 'simulation.inputs.force: is 5.18e+21 at'),
    ('-30*angle - 8*speed + exp(1e3*t)', '9*angle + force',
     'simulation.inputs.force: is 5.18e+21 at'),
])
def test_a_truth_that_runs_away_is_refused(pendulum, tmp_path, capsys, force, dynamics, told):
    plant = {**PENDULUM, 'dynamics': {'angle': 'speed', 'speed': dynamics}}
    (tmp_path / 'plant.yaml').write_text(yaml.safe_dump(plant, sort_keys=False))
    (tmp_path / 'demo.yaml').write_text(yaml.safe_dump({'simulation': {'inputs': {
        'force': force}}}))
    assert main(['--only', 'freeze,handover', *pendulum]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and said.startswith(
        f'fault_injection: {tmp_path / "demo.yaml"}: {told}')


def test_the_cases_are_listed(capsys):
    assert main(['--list']) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == \
        [case.name for case in ALL]
    assert main(['--list', '--quick']) == 0
    quick = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert set(quick) == QUICK and len(quick) == len(ALL) // 2
    assert main(['--list', '--alone', '--quick']) == 0
    quick = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert set(quick) == ALONE_QUICK
    told, alone = ({case.name for case in cases} for cases in (ALL, ALONE_CASES))
    assert told - alone == {'start', 'handover', 'toggle', 'isolator_restart'}
    with pytest.raises(SystemExit, match='2'):
        main(['--quick'])
    assert '--plant and --params-file are needed, but for --list' in capsys.readouterr().err
    assert {'freeze', 'drop_out', 'bias', 'drift', 'spikes', 'nan', 'infinity', 'wrong_length',
            'wrong_type', 'burst', 'garbage', 'publisher_restart', 'node_restart', 'kill_9',
            'two_replacers', 'full_dev_shm'} <= {case.name for case in ALL}


# ------------------------------------------------------------------------------ the judge

@pytest.fixture(scope='module')
def truth():
    return compute_truth(load_plant(SERVO / 'plant.yaml'), None, 4.0)


def heard_of(truth, **changed):
    """Return what a flawless replacer would have sent, with y2 changed: row -> value."""
    heard = Evidence(100.0, spoken={'/out'}, ended=100.0 + truth.end)
    for k, time in enumerate(truth.time):
        values = {name: float(values[k]) for name, values in truth.value.items()}
        heard.outs.append(Out('/out', 100.0 + time, 100.0 + time, round(time * 1e9), time, values,
                              'base', ('motor',)))
    return heard


def put(heard, rows, value):
    for k in rows:
        out = heard.outs[k]
        heard.outs[k] = out._replace(values={**out.values, 'y2': value(out.values['y2'])})


def judged(heard, truth, gives_numbers=False):
    return judge(heard, truth, {'/out': ('base', ('motor',))}, 0.05, gives_numbers)


def test_all_sensors_move_without_a_scenario(truth):
    assert min(truth.span.values()) > 0.1
    assert all(np.isfinite(values).all() for values in truth.value.values())


def test_the_truth_passes(truth):
    assert judged(heard_of(truth), truth) == []


@pytest.mark.parametrize('value, words', [
    (lambda v: math.nan, 'are no numbers'), (lambda v: math.inf, 'are no numbers'),
    (lambda v: v + 10.0, 'are wrong')])
def test_wrong_values_are_seen_unless_nobody_could_know(truth, value, words):
    heard = heard_of(truth)
    put(heard, range(100, 110), value)
    [wrong] = judged(heard, truth)
    assert wrong.startswith('y2: 10 ') and words in wrong
    heard.blind['y2'] = [(100.99, 101.1)]
    assert judged(heard, truth) == []


def test_what_was_played_late_could_not_be_known_before(truth):
    heard = heard_of(truth)
    [k] = np.flatnonzero(np.isclose(truth.time, 2.0))
    speed = np.gradient(truth.value['y2'], truth.time)[k]
    put(heard, [k], lambda v: float(truth.at('y2', 2.0 - 0.2)))
    bar = 0.05 * truth.span['y2']
    assert abs(0.2 * speed) > 1.5 * bar     # else it would be no error
    assert len(judged(heard, truth)) == 1
    heard.late = 0.19
    assert judged(heard, truth) == []
    put(heard, [k], lambda v: float(truth.at('y2', 2.0)) + 0.2 * speed)    # it was never that
    assert len(judged(heard, truth)) == 1


def test_a_burst_is_a_thousand_messages_with_stamps_of_their_own():
    message = JointState(name=['motor'], position=[0.5], velocity=[1.5])
    put_stamp(message, 3_000_000_001)
    driver = SimpleNamespace(stamped=True, garble=True)
    burst = [deserialize_message(raw, JointState) for raw in _thousand_of(driver)(message)]
    assert driver.garble is None and len(burst) == 1000
    stamps = [get_stamp(each) for each in burst]
    assert stamps == sorted(set(stamps)) and stamps[-1] == 3_000_000_001
    assert stamps[-1] - stamps[0] < 10_000_000   # within a period of 100 Hz
    assert {(each.position[0], each.velocity[0], *each.name) for each in burst} == {
        (0.5, 1.5, 'motor')}


def test_nan_and_silence_are_right_without_a_source(truth):
    heard = heard_of(truth)
    put(heard, range(100, 200), lambda v: math.nan)
    assert len(judged(heard, truth)) == 2  # NaN, and nothing for 1 s
    heard.told += [StatusHeard(101.1, {'y2': {'source': 'none'}}), StatusHeard(101.95, {'y2': {
        'source': 'virtual'}})]
    assert judged(heard, truth) == []
    put(heard, range(100, 200), lambda v: 1e3)
    assert len(judged(heard, truth)) == 1  # a number is never right then
    assert judged(heard, truth, gives_numbers=True) == []  # but when it was asked for


def test_a_time_without_a_source_may_be_too_short_to_be_told(truth):
    heard = heard_of(truth)
    put(heard, range(100, 103), lambda v: math.nan)
    for count, excused in ((1, False), (2, True)):
        heard.told[:] = [
            StatusHeard(100.9, {'y2': {'source': 'real', 'switches': '0'}}),
            StatusHeard(101.1, {'y2': {'source': 'virtual', 'switches': str(count)}})]
        assert (judged(heard, truth) == []) is excused


def test_a_stated_deviation_excuses_an_error_of_its_size_only(truth):
    heard = heard_of(truth)
    put(heard, [150], lambda v: v + 2.0)
    heard.stated['y2'] = [Stated(100.0 + t, round(t * 1e9), 0.5) for t in truth.time]
    assert judged(heard, truth) == []
    heard.stated['y2'] = [replaced._replace(deviation=0.1) for replaced in heard.stated['y2']]
    assert len(judged(heard, truth)) == 1
    heard.stated['y2'] = [replaced._replace(deviation=math.inf) for replaced in heard.stated['y2']]
    assert len(judged(heard, truth)) == 1


def test_stamps_frames_gaps_and_bytes_are_seen(truth):
    heard = heard_of(truth)
    heard.outs[50] = heard.outs[50]._replace(stamp=heard.outs[49].stamp, frame='')
    del heard.outs[200:300]
    heard = replace(heard, unreadable=2)
    wrong = judged(heard, truth)
    assert [next(word for word in ('nobody', 'increase', 'frame_id', 'nothing went out')
                 if word in line) for line in wrong] == [
        'nobody', 'increase', 'frame_id', *['nothing went out'] * 3]
    heard.loose.append((100.4, 100.6))
    heard.quiet.append((101.9, 103.1))
    assert len(judged(heard, truth)) == 2


def test_paths():
    told = [StatusHeard(0.0, {'y': {'source': source}}) for source in (
        'real', 'silent', 'real', 'virtual', 'virtual', 'none', 'real')]
    assert path_of(told, 'y') == ['real', 'virtual', 'none', 'real']
    assert handovers_of(told, 'y') == 0
    told = [StatusHeard(0.0, {'y': {'source': source, 'fault_set': which}}) for source, which in (
        ('real', ''), ('virtual', 'y, z'), ('virtual', 'y, z'), ('virtual', 'y'), ('none', 'y'),
        ('virtual', 'y, z'), ('real', ''))]
    assert handovers_of(told, 'y') == 1


def test_what_came_late_was_said_in_time(truth):
    heard = heard_of(truth)
    put(heard, range(100, 110), lambda v: v + 10.0)
    heard.blind['y2'] = [(100.99, 101.1)]
    heard.outs[100:110] = [out._replace(arrival=101.3) for out in heard.outs[100:110]]
    assert judged(heard, truth) == []     # the listener was busy
    heard.outs[100:110] = [out._replace(said=101.3) for out in heard.outs[100:110]]
    assert len(judged(heard, truth)) == 1     # it was the replacer
    heard = heard_of(truth)
    heard.outs[100:200] = [out._replace(arrival=102.0) for out in heard.outs[100:200]]
    assert judged(heard, truth) == []     # all stamps are there
    put(heard, [150], lambda v: v + 2.0)
    heard.stated['y2'] = [Stated(102.0, round(t * 1e9), 0.5) for t in truth.time]
    assert judged(heard, truth) == []     # its deviation came late, too


@pytest.mark.parametrize('busy', ['', 'a reading was played 0.30 s late'])
def test_a_case_that_fails_on_a_busy_computer_proves_nothing(busy, monkeypatch):
    case, tries = ALL[1], Counter()
    monkeypatch.setattr(suite, '_try', lambda *_: CaseResult(case.name, '', 'wrong', 'FAIL', 1.0))
    results = [suite._attempt(SimpleNamespace(busy=busy), case, tries) for _ in range(TRIES)]
    if busy:
        assert results[:-1] == [None] * (TRIES - 1)
        assert results[-1].outcome == 'skipped' and busy in results[-1].seen
    else:
        assert [result.outcome for result in results] == ['FAIL'] * TRIES
