"""The fault-injection suite: on the real node, on one that lies, and its judge on its own."""

from dataclasses import replace
import json
import math
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest
import yaml

from vsensor_ros.command.fault_injection import main
from vsensor_ros.lab.demo_failover import reserved_domain
from vsensor_ros.lab.injection.suite import ALL
from vsensor_ros.lab.injection.truth import make_world
from vsensor_ros.lab.injection.verdict import Heard, judge, Out, path_of, Stated, Told
from vsensor_ros.plant import load_plant

SERVO = Path(__file__).parents[2] / 'config' / 'servo'

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


@pytest.fixture
def quick(tmp_path):
    """Return arguments for the servo, with a shorter dwell."""
    content = yaml.safe_load((SERVO / 'replacer.yaml').read_text())
    content['replacer']['ros__parameters']['recovery'] = {'dwell': 0.3}
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
    assert {name: r['outcome'] for name, r in results_of(quick).items()} == dict.fromkeys(
        ['start', *names], 'PASS')
    assert '3 passed, 0 failed, 0 skipped' in said


@pytest.mark.slow
def test_a_relay_that_lies_fails(quick, tmp_path, monkeypatch, capsys):
    (tmp_path / 'liar.py').write_text(LIAR)
    with reserved_domain() as domain:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        liar = subprocess.Popen([sys.executable, str(tmp_path / 'liar.py')], env=os.environ)
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
    assert said.count('\n') == 1 and 'earthquake' in said and 'garbage' in said
    assert main(['--plant', str(tmp_path / 'none.yaml'), *quick[2:]]) == 2
    assert capsys.readouterr().err.count('\n') == 1


def test_the_cases_are_listed(quick, capsys):
    assert main(['--list', *quick]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == \
        [case.name for case in ALL]
    assert {'freeze', 'drop_out', 'bias', 'drift', 'spikes', 'nan', 'infinity', 'wrong_length',
            'wrong_type', 'burst', 'garbage', 'publisher_restart', 'node_restart', 'kill_9',
            'two_replacers', 'full_dev_shm'} <= {case.name for case in ALL}


# ------------------------------------------------------------------------------ the judge

@pytest.fixture(scope='module')
def world():
    return make_world(load_plant(SERVO / 'plant.yaml'), None, 4.0)


def heard_of(world, **changed):
    """Return what a flawless replacer would have sent, with y2 changed: row -> value."""
    heard = Heard(100.0, spoken={'/out'}, ended=100.0 + world.end)
    for k, time in enumerate(world.time):
        values = {name: float(truth[k]) for name, truth in world.truth.items()}
        heard.outs.append(Out('/out', 100.0 + time, round(time * 1e9), time, values, 'base',
                              ('motor',)))
    return heard


def put(heard, rows, value):
    for k in rows:
        out = heard.outs[k]
        heard.outs[k] = out._replace(values={**out.values, 'y2': value(out.values['y2'])})


def judged(heard, world, gives_numbers=False):
    return judge(heard, world, {'/out': ('base', ('motor',))}, 0.05, gives_numbers)


def test_all_sensors_move_without_a_scenario(world):
    assert min(world.span.values()) > 0.1
    assert all(np.isfinite(truth).all() for truth in world.truth.values())


def test_the_truth_passes(world):
    assert judged(heard_of(world), world) == []


@pytest.mark.parametrize('value, words', [
    (lambda v: math.nan, 'are no numbers'), (lambda v: math.inf, 'are no numbers'),
    (lambda v: v + 10.0, 'are wrong')])
def test_wrong_values_are_seen_unless_nobody_could_know(world, value, words):
    heard = heard_of(world)
    put(heard, range(100, 110), value)
    [wrong] = judged(heard, world)
    assert wrong.startswith('y2: 10 ') and words in wrong
    heard.blind['y2'] = [(100.99, 101.1)]
    assert judged(heard, world) == []


def test_nan_and_silence_are_right_without_a_source(world):
    heard = heard_of(world)
    put(heard, range(100, 200), lambda v: math.nan)
    assert len(judged(heard, world)) == 2  # NaN, and nothing for 1 s
    heard.told += [Told(101.1, {'y2': {'source': 'none'}}), Told(101.95, {'y2': {
        'source': 'virtual'}})]
    assert judged(heard, world) == []
    put(heard, range(100, 200), lambda v: 1e3)
    assert len(judged(heard, world)) == 1  # a number is never right then
    assert judged(heard, world, gives_numbers=True) == []  # but when it was asked for


def test_a_stated_deviation_excuses_an_error_of_its_size_only(world):
    heard = heard_of(world)
    put(heard, [150], lambda v: v + 2.0)
    heard.stated['y2'] = [Stated(100.0 + t, round(t * 1e9), 0.5) for t in world.time]
    assert judged(heard, world) == []
    heard.stated['y2'] = [replaced._replace(deviation=0.1) for replaced in heard.stated['y2']]
    assert len(judged(heard, world)) == 1
    heard.stated['y2'] = [replaced._replace(deviation=math.inf) for replaced in heard.stated['y2']]
    assert len(judged(heard, world)) == 1


def test_stamps_frames_gaps_and_bytes_are_seen(world):
    heard = heard_of(world)
    heard.outs[50] = heard.outs[50]._replace(stamp=heard.outs[49].stamp, frame='')
    del heard.outs[200:300]
    heard = replace(heard, unreadable=2)
    wrong = judged(heard, world)
    assert [next(word for word in ('nobody', 'increase', 'frame_id', 'nothing went out')
                 if word in line) for line in wrong] == [
        'nobody', 'increase', 'frame_id', *['nothing went out'] * 3]
    heard.loose.append((100.4, 100.6))
    heard.quiet.append((101.9, 103.1))
    assert len(judged(heard, world)) == 2


def test_paths():
    told = [Told(0.0, {'y': {'source': source}}) for source in (
        'real', 'silent', 'real', 'virtual', 'virtual', 'none', 'real')]
    assert path_of(told, 'y') == ['real', 'virtual', 'none', 'real']
