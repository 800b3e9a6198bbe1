"""What `check` says beside robots on which something is wrong, as a process, on real topics."""

import math

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32, Float64
import yaml

pytestmark = pytest.mark.slow  # a verb listens for seconds, as a process
RAW, OUT, VOLTAGE = '/servo/joint_states_raw', '/servo/joint_states', '/servo/voltage'
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


def joints(name='motor'):
    return lambda t: JointState(name=[name], position=[math.sin(t)], velocity=[2.0], effort=[3.0])


def volts(t):
    return Float64(data=5.0)


@pytest.fixture
def file(designs, tmp_path):
    """Return what writes the servo's parameter file, with changes."""
    def write(**changes):
        sensors = {s: {'topic': OUT, 'type': 'sensor_msgs/msg/JointState', 'field': f'{f}[motor]'}
                   for s, f in (('y1', 'position'), ('y2', 'velocity'), ('y3', 'effort'))}
        given = {'design_file': str(designs['servo']), 'isolation': {'topic': '/isolation'},
                 'sensors': sensors, 'commands': {'voltage': {
                     'topic': VOLTAGE, 'type': 'std_msgs/msg/Float64', 'field': 'data'}},
                 **changes}
        path = tmp_path / 'replacer.yaml'
        path.write_text(yaml.safe_dump({'replacer': {'ros__parameters': given}}))
        return path
    return write


def flat(done):
    """Return what was said, on one line."""
    return ' '.join(done.stdout.split())


def says(*texts, status=1):
    """Return what tells whether all of these were said, and the exit status is this."""
    return lambda done: done.returncode == status and all(text in flat(done) for text in texts)


def test_nothing_is_wrong_and_nothing_is_published(robot, file):
    robot.drive('driver', JointState, RAW, joints())
    robot.drive('controller', Float64, VOLTAGE, volts)
    robot.isolate()
    robot.hear('rviz', JointState, OUT)
    eye, seen, opened = robot.node('eye'), [], []

    def look():  # while the check is there
        for name, namespace in eye.get_node_names_and_namespaces():
            if name.startswith('check_') or name == 'replacer':
                seen.append(name)
                opened.extend(eye.get_publisher_names_and_types_by_node(name, namespace))
                opened.extend(eye.get_service_names_and_types_by_node(name, namespace))
    robot.work.append(look)
    good = says('check: all would work: y2, y3 can be replaced', status=0)
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr
    assert 'y2: virtual sensor' in flat(done) and 'y1: not replaced, by design' in flat(done)
    assert any(name.startswith('check_') for name in seen) and not opened
    assert all(len(line) <= 100 for line in done.stdout.splitlines()[1:-1]), done.stdout
    assert done.stdout.splitlines()[-1].startswith('check: ') and done.stderr == ''


def test_a_type_a_joint_an_isolation_and_a_listener_that_are_not_as_thought(robot, file):
    robot.drive('driver', JointState, RAW, joints('motor1'))
    robot.drive('controller', Float32, VOLTAGE, lambda t: Float32(data=5.0))
    robot.hear('rviz', JointState, OUT, KEPT)
    good = says('/controller publishes std_msgs/msg/Float32 on /servo/voltage, the file says '
                'std_msgs/msg/Float64', 'did you mean velocity[motor1]?',
                'nobody publishes on the isolation topic /isolation',
                '/rviz would hear nothing on /servo/joint_states: its QoS does not fit',
                'y3: cannot be replaced now: y3: effort[motor] is not in the message')
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr
    assert ' things would not work. First: ' in done.stdout.splitlines()[-1]


def test_a_listener_with_a_deadline_hears_with_the_parameter_that_is_advised(robot, file):
    robot.drive('driver', JointState, RAW, joints())
    robot.drive('controller', Float64, VOLTAGE, volts)
    robot.isolate()
    robot.hear('watch', JointState, OUT, QoSProfile(depth=1, deadline=Duration(seconds=0.1)))
    good = says(f'/watch would hear nothing on {OUT}: its QoS does not fit (deadline is none, '
                'wanted 100000000); change it there, or here with '
                f'qos_overrides.{OUT}.publisher.deadline: 100000000')
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr
    path = file(qos_overrides={OUT: {'publisher': {'deadline': 100_000_000}}})
    good = says('check: all would work', f'{OUT} output JointState ok', status=0)
    done = robot.run_until(good, 'check', '--params-file', path)
    assert good(done), done.stdout + done.stderr


def test_a_misspelt_command_two_drivers_and_one_on_the_output(robot, file):
    robot.drive('driver', JointState, RAW, joints(), late=0.3)
    robot.drive('simulation', JointState, RAW, joints(), late=0.3)
    robot.drive('old_replacer', JointState, OUT, joints())
    robot.drive('controller', Float64, '/servo/Voltage', volts)
    robot.isolate('/fault/isolation')
    good = says('y2, y3: cannot be replaced now: voltage was never heard on /servo/voltage; did '
                'you mean /servo/Voltage?',
                f'/driver and /simulation publish on {RAW} in turn, both y1, y2, y3',
                f'the stamps on {RAW} are 30', 'ms late',
                f'/old_replacer publishes on {OUT} already, where the replacer is to speak',
                'no fault would be told; did you mean /fault/isolation?')
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr


def test_a_driver_that_was_not_remapped_a_qos_and_no_clock(robot, file):
    robot.drive('driver', JointState, OUT, joints())
    robot.drive('controller', Float64, VOLTAGE, volts, BEST_EFFORT)
    robot.isolate()
    path = file(use_sim_time=True, qos_overrides={
        VOLTAGE: {'subscription': {'reliability': 'reliable'}}})
    good = says(f'y1, y2, y3 were never heard on {RAW}: /driver publishes on {OUT} itself; remap '
                f'it there: --ros-args -r {OUT}:={RAW}',
                'use_sim_time is true, but nobody publishes /clock',
                f'the QoS of /controller on {VOLTAGE} does not fit')
    done = robot.run_until(good, 'check', '--params-file', path)
    assert good(done), done.stdout + done.stderr
    assert 'check: 3 things would not work. First: use_sim_time' in done.stdout.splitlines()[-1]


def test_late_stamps_alone_are_a_warning(robot, file):
    robot.drive('driver', JointState, RAW, joints(), late=0.3)
    robot.drive('controller', Float64, VOLTAGE, volts)
    robot.isolate()
    good = says(f'check: all would work, but: the stamps on {RAW} are 30', status=0)
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr


def test_a_sensor_that_isolation_calls_faulty_is_said(robot, file):
    robot.drive('driver', JointState, RAW, joints())
    robot.drive('controller', Float64, VOLTAGE, volts)
    publisher = robot.node('isolator').create_publisher(DiagnosticArray, '/isolation', KEPT)
    publisher.publish(DiagnosticArray(status=[DiagnosticStatus(name='y2', level=b'\x02')]))
    good = says('y3: cannot be replaced now: no design for the faulty sensors y2, y3',
                'check: one thing would not work. First: isolation says that y2 is faulty now')
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr


@pytest.mark.parametrize('arguments, said', [
    (['--params-file', 'no_such.yaml'], 'no_such.yaml'),
    (['--params-file', '{file}', '--ros-args', '-p', 'rate:=-1.0'], 'rate'),
    (['--params-file', '{file}', '--ros-args', '-r', 'no remapping'], 'arguments'),
])
def test_bad_input_is_one_line(robot, file, arguments, said):
    path = file()
    done = robot.run('check', *(a.format(file=path) for a in arguments))
    assert done.returncode == 2 and done.stdout == '', done.stdout + done.stderr
    line = done.stderr.splitlines()[-1]  # rcl says in its own words what it cannot read
    assert line.startswith('check: ') and said in line and 'Traceback' not in done.stderr
