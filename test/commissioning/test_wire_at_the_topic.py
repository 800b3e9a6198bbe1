"""From what is on the graph to a parameter file with which the replacer serves, as processes."""

import math
import os
from pathlib import Path
import pty
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
import pytest
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Float64
import yaml

from vsensor_ros.lab.process import die_with_parent

pytestmark = pytest.mark.slow  # a verb listens for seconds, as a process
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def plant_of(name):
    return Path(__file__).parents[2] / 'config' / name / 'plant.yaml'


def joints(t):
    return JointState(name=['motor'], position=[math.sin(t)], velocity=[math.cos(t)],
                      effort=[3.0 + 0.1 * math.sin(2.0 * t)])


def servo(robot, raw):
    """Play the servo; raw: its driver was remapped."""
    robot.drive('driver', JointState, f'/servo/joint_states{raw}', joints)
    robot.drive('controller', Float64, '/servo/voltage', lambda t: Float64(data=math.sin(t)))
    robot.hear('driver', Float64, '/servo/voltage')


def tanks(robot, raw):
    """Play the three tanks."""
    for i, name in ((2, 'level2'), (3, 'level3')):
        robot.drive('gauges', Range, f'/tank/{name}{raw}',
                    lambda t, i=i: Range(range=i + 0.1 * math.sin(t)))
        robot.drive('pumps', Float64, f'/tank/u{i - 1}', lambda t: Float64(data=0.5))


def wired(path):
    """Return topic, field and input of each sensor and command in a file."""
    given = yaml.safe_load(path.read_text())['/**']['ros__parameters']
    return {name: tuple(said.get(key) for key in ('topic', 'field', 'input'))
            for group in ('sensors', 'commands') for name, said in given[group].items()}


SERVO = {'y1': ('/servo/joint_states', 'position[motor]', '/servo/joint_states_raw'),
         'y2': ('/servo/joint_states', 'velocity[motor]', '/servo/joint_states_raw'),
         'y3': ('/servo/joint_states', 'effort[motor]', '/servo/joint_states_raw'),
         'voltage': ('/servo/voltage', 'data', None)}
TANKS = {'y1': ('/tank/level2', 'range', '/tank/level2_raw'),
         'y2': ('/tank/level3', 'range', '/tank/level3_raw'),
         'u1': ('/tank/u1', 'data', None), 'u2': ('/tank/u2', 'data', None)}


@pytest.mark.parametrize('name, play, expected', [
    ('servo', servo, SERVO), ('three_tank', tanks, TANKS)])
def test_from_the_graph_to_an_active_replacer(robot, designs, tmp_path, name, play, expected):
    play(robot, '')
    robot.isolate()
    path = tmp_path / 'replacer.yaml'

    def good(done):
        return done.returncode == 0 and wired(path) == expected
    done = robot.run_until(good, 'wire', plant_of(name), '--design', designs[name],
                           '--output', path, '--yes', '--force')
    assert good(done), done.stdout + done.stderr + path.read_text()
    remappings = {(source, f'{source}_raw') for source, _, raw in expected.values() if raw}
    for source, raw in remappings:
        line = f'--ros-args -r {source}:={raw}'
        assert line in done.stdout and line in path.read_text()
    robot.work.clear()
    for node in ('driver', 'gauges'):  # start the drivers anew, with the remappings
        if node in robot.nodes:
            robot.nodes.pop(node).destroy_node()
    play(robot, '_raw')
    states, heard = [], []
    eye = robot.node('eye')
    executor = SingleThreadedExecutor(context=robot.context)
    executor.add_node(eye)
    eye.create_subscription(DiagnosticArray, '/replacer/status', states.append, KEPT)
    topic, field, _ = next(iter(expected.values()))
    eye.create_subscription(JointState if '[' in field else Range, topic, heard.append, 10)
    process = subprocess.Popen(
        [sys.executable, '-m', 'vsensor_ros.command.replacer', '--ros-args', '--params-file',
         str(path)], env={**os.environ, 'ROS_DOMAIN_ID': str(robot.domain)},
        stderr=subprocess.PIPE, text=True, preexec_fn=die_with_parent)
    try:
        end = time.monotonic() + 120.0
        while not (heard and states and {s.name for s in states[-1].status} >= {'y1', 'y2'}):
            executor.spin_once(timeout_sec=0.05)
            assert process.poll() is None and time.monotonic() < end, process.stderr.read()
    finally:
        process.terminate()
        process.communicate(timeout=60.0)
        executor.shutdown()
    assert process.returncode == 0
    if '[' in field:
        assert list(heard[-1].name) == ['motor']


def test_a_raw_topic_is_an_input_and_a_file_is_not_overwritten(robot, tmp_path):
    servo(robot, '_raw')
    path = tmp_path / 'replacer.yaml'

    def good(done):
        return done.returncode == 0 and wired(path) == SERVO and 'start these' not in done.stdout
    done = robot.run_until(good, 'wire', plant_of('servo'), '--output', path, '--yes',
                           '--force')
    assert good(done), done.stdout + done.stderr
    assert 'nobody says yet which sensors are faulty' in path.read_text()
    before = path.read_bytes()
    done = robot.run('wire', plant_of('servo'), '--output', path, '--yes')
    assert done.returncode == 2 and 'is there already' in done.stderr
    assert path.read_bytes() == before


def test_only_a_listener_that_would_hear_nothing_is_noted(robot, tmp_path):
    servo(robot, '')
    robot.hear('rviz', JointState, '/servo/joint_states')
    robot.hear('watch', JointState, '/servo/joint_states',
               QoSProfile(depth=1, deadline=Duration(seconds=0.1)))
    path = tmp_path / 'replacer.yaml'

    def good(done):
        return done.returncode == 0 and (
            '# /watch would not hear it there (deadline is none, wanted 100000000): change it '
            'there, or here with qos_overrides./servo/joint_states.publisher.deadline: 100000000'
            ) in path.read_text()
    done = robot.run_until(good, 'wire', plant_of('servo'), '--output', path, '--yes', '--force')
    assert good(done), done.stdout + done.stderr + path.read_text()
    assert '/rviz would' not in path.read_text()


def test_what_is_not_found_is_left_to_be_filled_in(robot, tmp_path):
    robot.drive('driver', JointState, '/servo/joint_states', joints)
    path = tmp_path / 'replacer.yaml'

    def good(done):
        return done.returncode == 1 and 'voltage: NOT FOUND' in done.stdout and \
            'y3: /servo/joint_states effort[motor]' in done.stdout
    done = robot.run_until(good, 'wire', plant_of('servo'), '--output', path, '--yes',
                           '--force')
    assert good(done), done.stdout + done.stderr
    assert "# voltage: {topic: '', type: '', field: ''}" in path.read_text()


def test_where_unsure_it_asks(robot, tmp_path):
    def two(t):
        return JointState(name=['a', 'b'], position=[math.sin(t)] * 2, velocity=[t, t],
                          effort=[t, t])
    robot.drive('driver', JointState, '/servo/joint_states', two)
    robot.drive('controller', Float64, '/servo/voltage', lambda t: Float64(data=math.sin(t)))
    path = tmp_path / 'replacer.yaml'
    arguments = ('wire', plant_of('servo'), '--output', path)
    done = robot.run_until(lambda done: 'nobody can be asked' in done.stderr, *arguments)
    assert done.returncode == 2 and not path.exists(), done.stderr
    assert done.stderr.startswith('wire: y1: it is not sure which sensor it is'), done.stderr
    piped = tmp_path / 'piped.yaml'

    def good(done):
        return done.returncode == 0 and wired(piped)['y1'][1] == 'position[b]'
    done = robot.run_until(good, 'wire', plant_of('servo'), '-o', piped, '--force',
                           input='2\n' * 9)
    assert good(done), done.stdout + done.stderr
    terminal, slave = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, '-m', 'vsensor_ros.command.wire', *map(str, arguments[1:]), '--for', '5'],
        stdin=slave, stdout=slave, stderr=slave, preexec_fn=die_with_parent,
        env={**os.environ, 'ROS_DOMAIN_ID': str(robot.domain)})
    os.close(slave)
    said = answered = ''
    try:
        while more := os.read(terminal, 65536).decode():
            said += more
            if said.count('[1] ') > len(answered):
                answered += '2'
                chosen = next(line for line in reversed(said.splitlines())
                              if line.startswith('  2  '))
                assert '[b]' in chosen or 'effort' in chosen
                os.write(terminal, b'2\n')
    except OSError:  # it has ended
        pass
    assert process.wait(60.0) == 0, said
    os.close(terminal)
    assert answered and 'Which is the sensor y1 (angle) [rad]?' in said
    assert wired(path)['y1'][1] == 'position[b]'


def test_nobody_is_there(robot, tmp_path):
    done = robot.run('wire', plant_of('servo'), '--yes', '--for', '1', '-o',
                     tmp_path / 'x.yaml')
    assert done.returncode == 2 and done.stderr.count('\n') == 1
    assert done.stderr.startswith('wire: graph: there is no topic with numbers')
    done = robot.run('wire', tmp_path / 'no_plant.yaml', '--yes')
    assert done.returncode == 2 and done.stderr.count('\n') == 1 and 'no_plant' in done.stderr
