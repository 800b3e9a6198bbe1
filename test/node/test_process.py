import os
import signal
import subprocess
import sys
import time

from lifecycle_msgs.srv import GetState
import pytest
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Range

from vsensor_ros.lab.domain import by_hand
from vsensor_ros.lab.process import die_with_parent
from vsensor_ros.node.private_rclpy import take_all

COMMAND = [sys.executable, '-m', 'vsensor_ros.command.replacer']
TEXT = """
replacer:
  ros__parameters:
    design_file: {design}
    rate: 100
    sensors:
      y1: {{topic: /y1, type: sensor_msgs/msg/Range, field: range}}
      y2: {{topic: /y2, type: sensor_msgs/msg/Range, field: range}}
      y3: {{topic: /y3, type: sensor_msgs/msg/Range, field: range}}
    commands:
      u1: {{topic: /u1, type: std_msgs/msg/Float64, field: data}}
"""


@pytest.fixture
def parameter_file(tmp_path, design_file):
    path = tmp_path / 'replacer.yaml'
    path.write_text(TEXT.format(design=design_file))
    return path


def run(*arguments, **environment):
    return subprocess.run([*COMMAND, *arguments], env={**os.environ, **environment},
                          capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_serves_until_a_signal_and_ends_in_order(parameter_file, number):
    process = subprocess.Popen([*COMMAND, '--ros-args', '--params-file', str(parameter_file)],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               preexec_fn=die_with_parent)
    context = Context()
    context.init()
    node = Node('rig', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        heard = []
        publisher = node.create_publisher(Range, '/y1_raw', 10)
        node.create_subscription(Range, '/y1', heard.append, 10)
        end = time.monotonic() + 120
        while not heard and time.monotonic() < end and process.poll() is None:
            publisher.publish(Range(range=1.5))
            executor.spin_once(timeout_sec=0.02)
        assert heard and heard[0].range == 1.5
        process.send_signal(number)
        process.send_signal(number)  # an impatient user
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
        process.wait()
        executor.shutdown()
        node.destroy_node()
        context.shutdown()
    assert process.returncode == 0, err
    assert 'Traceback' not in out + err and 'Exception' not in out + err, err
    assert '/y1_raw -> /y1 (sensor_msgs/msg/Range, range)' in err
    assert 'isolation: /isolation (diagnostic_msgs/msg/DiagnosticArray)' in err


def test_bursts_go_through_completely(parameter_file):
    context = Context()
    context.init()
    node = Node('rig', context=context)
    listener = node.create_subscription(Range, '/y1', by_hand, QoSProfile(depth=1000))
    driver = node.create_publisher(Range, '/y1_raw', 100)
    process = subprocess.Popen([*COMMAND, '--ros-args', '--params-file', str(parameter_file)],
                               stderr=subprocess.DEVNULL, preexec_fn=die_with_parent)
    heard = []

    def publish(*values):
        for value in values:
            driver.publish(Range(range=float(value)))

    def hear(count):
        end = time.monotonic() + 120
        while len(heard) < count:
            assert process.poll() is None and time.monotonic() < end, heard[-5:]
            heard.extend(message.range for message, _ in take_all(listener))
            time.sleep(0.002)
    try:
        end = time.monotonic() + 120
        while not heard and time.monotonic() < end:  # until it sends
            publish(-2)
            heard.extend(message.range for message, _ in take_all(listener))
            time.sleep(0.01)
        publish(-1)
        while heard[-1] != -1.0:
            hear(len(heard) + 1)
        heard.clear()
        for k in range(10):
            publish(*range(50 * k, 50 * k + 50))
            hear(50 * k + 50)
    finally:
        process.kill()
        process.wait()
        node.destroy_node()
        context.shutdown()
    assert heard == list(range(500))


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_starting(parameter_file, number):
    # a machine so busy that the node's modules take long to load
    script = ('import sys, time; from vsensor_ros.command import replacer; '
              'replacer.prepare_environment = lambda: (print(flush=True), time.sleep(600)); '
              f'sys.exit(replacer.main(["--ros-args", "--params-file", "{parameter_file}"]))')
    process = subprocess.Popen([sys.executable, '-c', script], stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True,
                               preexec_fn=die_with_parent)
    process.stdout.readline()
    process.send_signal(number)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0 and 'Traceback' not in err, err


def test_what_it_cannot_start_with(parameter_file):
    parameter_file.write_text(
        parameter_file.read_text().replace('rate: 100', 'rate: 0.0\n    colour: red'))
    ended = run('--ros-args', '--params-file', str(parameter_file))
    assert ended.returncode == 2
    assert ended.stderr.splitlines() == [
        '/replacer: rate: 0 is out of range; choose from 0.001 to 1000',
        '/replacer: colour: there is no such parameter; leave it out']


def test_arguments_it_cannot_start_with(tmp_path, parameter_file):
    """Each given to the command, all in one process, which takes a second to load."""
    parameter_file.write_text(parameter_file.read_text().replace(
        'rate: 100', 'rate: 100\n    autostart: maybe'))
    cases = [
        (['--ros-args', '--params-file', '/no/such.yaml'],
         '/no/such.yaml: parameter file: cannot'),
        (['--ros-args', '-r', 'a b'], 'replacer: arguments: '),
        (['--ros-args', '-p', 'rate:=[]'], ''),
        (['--fast'], 'replacer: --fast: there is no such argument'),
        (['--ros-args', '--params-file', str(parameter_file)],
         "/replacer: autostart: 'maybe' is not true or false; ")]
    ended = subprocess.run([sys.executable, '-c', f"""
import sys
from vsensor_ros.command.replacer import main
for arguments in {[arguments for arguments, _ in cases]}:
    status = main(arguments)
    print('ended with', status, file=sys.stderr, flush=True)
"""], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0 and 'Traceback' not in ended.stderr, ended.stderr
    *said, rest = ended.stderr.split('ended with 2\n')
    assert not rest and len(said) == len(cases)
    for lines, (_, told) in zip(said, cases):
        assert any(line.startswith(told) for line in lines.splitlines()), lines
    assert said[-1].count('\n') == 1


@pytest.mark.parametrize('missing', ['rclpy', 'diagnostic_msgs'])
@pytest.mark.parametrize('command, arguments', [
    ('replacer', ['--ros-args']), ('player', ['table.csv', 'wiring.yaml']), ('demo', [])])
def test_no_ros(command, arguments, missing):
    script = (f'import sys; sys.modules["{missing}"] = None; '
              f'from vsensor_ros.command import {command}; '
              f'sys.exit({command}.main({arguments}))')
    ended = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                           timeout=120)
    assert ended.returncode == 2
    assert ended.stderr.count('\n') == 1 and ended.stderr.startswith(
        f'{command}: ROS 2 is not found (')
    assert 'source /opt/ros/jazzy/setup.bash' in ended.stderr


def test_no_home(parameter_file, tmp_path):
    environment = {k: v for k, v in os.environ.items()
                   if k not in ('AMENT_PREFIX_PATH', 'ROS_LOG_DIR', 'ROS_HOME')}
    environment.update(HOME='/nonexistent', TMPDIR=str(tmp_path))
    process = subprocess.Popen([*COMMAND, '--ros-args', '--params-file', str(parameter_file)],
                               env=environment, stderr=subprocess.PIPE, text=True,
                               preexec_fn=die_with_parent)
    seen = ''
    while 'virtual sensors of' not in seen:
        line = process.stderr.readline()
        assert line, seen
        seen += line
    process.terminate()
    _, rest = process.communicate(timeout=120)
    assert process.returncode == 0 and 'Traceback' not in seen + rest
    assert list(tmp_path.glob('ros_log_*'))


def test_it_waits_for_a_lifecycle_manager_and_ends_meanwhile(parameter_file):
    parameter_file.write_text(parameter_file.read_text().replace(
        'rate: 100', 'rate: 100\n    autostart: false'))
    process = subprocess.Popen([*COMMAND, '--ros-args', '--params-file', str(parameter_file)],
                               stderr=subprocess.PIPE, text=True,
                               preexec_fn=die_with_parent)
    context = Context()
    context.init()
    node = Node('rig', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        client = node.create_client(GetState, '/replacer/get_state')
        assert client.wait_for_service(120.0)
        end = time.monotonic() + 120.0
        while True:  # an answer is lost if its sender has not yet discovered who asks
            future = client.call_async(GetState.Request())
            executor.spin_until_future_complete(future, 2.0)
            if future.done() or time.monotonic() > end:
                break
        assert future.result().current_state.label == 'unconfigured'
        process.terminate()
        _, err = process.communicate(timeout=120)
    finally:
        process.kill()
        process.wait()
        executor.shutdown()
        node.destroy_node()
        context.shutdown()
    assert process.returncode == 0 and 'Traceback' not in err, err
    assert ' -> ' not in err  # it was never configured
