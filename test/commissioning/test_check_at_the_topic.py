"""What `check` says beside robots on which something is wrong, as a process, on real topics."""

import math
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32, Float64
import yaml

from vsensor_ros.commissioning.check_table import MARK

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
                f'/driver and /simulation publish on {RAW} in turn, both y1, y2, y3; '
                'end one, give it a topic of its own, or choose one with sensors.y1.publisher and '
                'sensors.y2.publisher',
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
                'cannot be replaced now: use_sim_time is true, but nobody publishes /clock',
                f'the QoS of /controller on {VOLTAGE} does not fit')
    done = robot.run_until(good, 'check', '--params-file', path)
    assert good(done), done.stdout + done.stderr
    assert 'check: 3 things would not work. First: use_sim_time' in done.stdout.splitlines()[-1]


def test_two_who_command_in_turn_and_one_of_them_chosen(robot, file):
    robot.drive('driver', JointState, RAW, joints())
    robot.drive('controller', Float64, VOLTAGE, volts)
    robot.drive('teleop', Float64, VOLTAGE, lambda t: Float64(data=-7.0))
    robot.isolate()
    good = says(f'/controller and /teleop publish on {VOLTAGE} in turn, both voltage; end one, '
                'give it a topic of its own, or choose one with commands.voltage.publisher')
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr
    path = file(commands={'voltage': {'topic': VOLTAGE, 'type': 'std_msgs/msg/Float64',
                                      'field': 'data', 'publisher': '/controller'}})
    good = says('check: all would work', status=0)
    done = robot.run_until(good, 'check', '--params-file', path)
    assert good(done), done.stdout + done.stderr
    values = next(line for line in done.stdout.splitlines() if line[MARK:].startswith('voltage '))
    assert values.endswith('  5'), values  # what the other says is not looked at


def test_stamps_since_boot_and_a_field_that_never_comes(robot, file):
    boot = time.time() - 5000.0
    robot.drive('driver', JointState, RAW, lambda t: JointState(
        name=['motor'], position=[1.0], velocity=[2.0]), late=boot)
    robot.drive('controller', Float64, VOLTAGE, volts)
    robot.isolate()
    good = says(f'{RAW} speaks, but its stamps are of another clock (',
                "behind this node's: time since boot, or of a simulation?); stamp with the ROS "
                'clock', 'y3: the array is too short for effort[motor]')
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr
    rows = done.stdout.partition('IF IT FAILED NOW')[2].splitlines()
    assert not any(row.startswith('ok') and row[MARK:].startswith('y3') for row in rows), rows


def test_a_sensor_that_never_comes_is_not_well_though_it_could_be_replaced(robot, file):
    robot.drive('driver', JointState, RAW, lambda t: JointState(
        name=['motor'], position=[1.0], velocity=[], effort=[3.0]))
    robot.drive('controller', Float64, VOLTAGE, volts)
    robot.isolate()
    good = says('WARN y2: is not heard itself; virtual sensor ready')
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr


def test_stamps_in_whole_seconds_are_not_called_late(robot, file):
    robot.drive('driver', JointState, RAW, joints(), whole=True)
    robot.drive('controller', Float64, VOLTAGE, volts)
    robot.isolate()
    good = says(f'the stamps on {RAW} repeat: ', 'stamp each when it is measured')
    done = robot.run_until(good, 'check', '--params-file', file())
    assert good(done), done.stdout + done.stderr
    assert 'chrony' not in flat(done)


def test_the_file_may_stand_after_ros_args(robot, file):
    robot.drive('driver', JointState, RAW, joints())
    robot.drive('controller', Float64, VOLTAGE, volts)
    robot.isolate()
    good = says('check: all would work', status=0)
    path = file()
    for seconds in (3, 12, 50):
        done = robot.run('check', '--for', seconds, '--ros-args', '--params-file', path)
        if good(done):
            break
    assert good(done), done.stdout + done.stderr
    done = robot.run('check', '--for', 1)
    assert done.returncode == 2 and '--params-file is needed' in done.stderr


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
    good = says('y3: cannot be replaced now: no design for the loss of y2, y3',
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
