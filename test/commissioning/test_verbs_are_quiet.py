"""How the verbs end: at Ctrl-C, beside a replacer of the same name, in a namespace."""

import os
import signal
import subprocess
import sys
import time

from geometry_msgs.msg import Twist
import pytest
from rclpy.context import Context
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState, Range
import yaml

from vsensor_ros.commissioning.silent_node import SilentNode
from vsensor_ros.lab.process import die_with_parent
from vsensor_ros.node.parameters import read
from vsensor_ros.node.replacer import Replacer

pytestmark = pytest.mark.slow  # a verb listens for seconds, as a process


@pytest.fixture
def tanks(robot, designs, tmp_path):
    """Play the three tanks under /robot1; return what writes their parameter file."""
    for name in ('level2', 'level3'):
        robot.drive('gauges', Range, f'/robot1/{name}_raw', lambda t: Range(range=2.0))
    robot.drive('pumps', Twist, '/robot1/pumps', lambda t: Twist())  # both commands in one
    robot.isolate('/robot1/isolation', ('y1', 'y2'))

    def write(node):
        path = tmp_path / 'replacer.yaml'
        path.write_text(yaml.safe_dump({node: {'ros__parameters': {
            'design_file': str(designs['three_tank']), 'isolation': {'topic': 'isolation'},
            'sensors': {s: {'topic': t, 'type': 'sensor_msgs/msg/Range', 'field': 'range'}
                        for s, t in (('y1', 'level2'), ('y2', 'level3'))},
            'commands': {u: {'topic': 'pumps', 'type': 'geometry_msgs/msg/Twist', 'field': f}
                         for u, f in (('u1', 'linear.x'), ('u2', 'angular.z'))}}}}))
        return path
    return write


@pytest.mark.parametrize('node, ros_args, start', [
    ('/robot1/replacer', [], ', if started with --ros-args -r __ns:=/robot1'),
    ('/**', ['--ros-args', '-r', '__ns:=/robot1'], '')])
def test_relative_names_are_those_of_the_namespace(robot, tanks, node, ros_args, start):
    path = tanks(node)
    for seconds in (3, 12, 50):
        done = robot.run('check', '--params-file', path, '--for', seconds, *ros_args)
        if done.returncode == 0:
            break
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith(f'/robot1/replacer of {path}, listened for ')
    assert done.stdout.splitlines()[0].endswith(f' s{start}')
    assert all(f'{field}  m^3/s' in done.stdout for field in ('linear.x ', 'angular.z'))
    assert 'all would work: y1, y2 can be replaced' in done.stdout.splitlines()[-1]


def test_it_runs_beside_the_replacer_itself(robot, tanks):
    path = tanks('/**')
    arguments = ['--ros-args', '-r', '__ns:=/robot1']
    process = subprocess.Popen(
        [sys.executable, '-m', 'vsensor_ros.command.replacer', '--ros-args', '--params-file',
         str(path), *arguments[1:]], env={**os.environ, 'ROS_DOMAIN_ID': str(robot.domain)},
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, preexec_fn=die_with_parent)
    try:
        for seconds in (3, 12, 50):
            done = robot.run('check', '--params-file', path, '--for', seconds, *arguments)
            if done.returncode == 0 and 'by /robot1/replacer' in done.stdout:
                break
        assert done.returncode == 0, done.stdout + done.stderr
        assert 'by /robot1/replacer' in done.stdout and process.poll() is None
    finally:
        process.terminate()
        assert process.wait(60.0) == 0


@pytest.mark.parametrize('verb', ['check', 'wire'])
def test_ctrl_c_is_quiet(robot, tanks, tmp_path, verb):
    path = tanks('/**')
    plant = os.path.join('config', 'three_tank', 'plant.yaml')
    arguments = ['--params-file', str(path)] if verb == 'check' else [
        plant, '--output', str(tmp_path / 'out.yaml'), '--yes']
    process = subprocess.Popen(
        [sys.executable, '-m', f'vsensor_ros.command.{verb}', *arguments, '--for', '600'],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=die_with_parent,
        env={**os.environ, 'ROS_DOMAIN_ID': str(robot.domain)})
    eye, end = robot.node('eye'), time.monotonic() + 120.0
    while not any(name.startswith(f'{verb}_') for name in eye.get_node_names()):
        assert process.poll() is None and time.monotonic() < end
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out, err) == (130, '', f'{verb}: stopped\n')
    assert not (tmp_path / 'out.yaml').exists()


def test_a_whole_replacer_on_a_silent_node_reaches_nobody(robot, designs):
    """Even when it is activated and forwards: what it publishes on goes nowhere."""
    context = Context()
    context.init(domain_id=robot.domain)

    given = {'design_file': str(designs['servo']), 'commands.voltage.topic': '/u',
             'commands.voltage.type': 'std_msgs/msg/Float64', 'commands.voltage.field': 'data'}
    for name, field in (('y1', 'position'), ('y2', 'velocity'), ('y3', 'effort')):
        given.update({f'sensors.{name}.topic': '/joints', f'sensors.{name}.field': f'{field}[m]',
                      f'sensors.{name}.type': 'sensor_msgs/msg/JointState'})
    node = SilentNode('silent', context, overrides=[
        Parameter(key, value=value) for key, value in given.items()])
    try:
        replacer = Replacer(node, read(node))
        replacer.activate()
        robot.drive('driver', JointState, '/joints_raw', lambda t: JointState(
            name=['m'], position=[1.0], velocity=[1.0], effort=[1.0]))
        end = time.monotonic() + 60.0
        while not all(c.readings for c in replacer.snapshot().channels):
            replacer.poll()
            assert time.monotonic() < end
        eye = robot.node('eye')
        while 'silent' not in eye.get_node_names():
            assert time.monotonic() < end
        assert all(c.source == 'real' for c in replacer.snapshot().channels)
        assert not eye.get_publisher_names_and_types_by_node('silent', '/')
        assert not eye.get_service_names_and_types_by_node('silent', '/')
        assert list(node.publishers) == []
        replacer.close()
    finally:
        node.destroy_node()
        context.shutdown()
