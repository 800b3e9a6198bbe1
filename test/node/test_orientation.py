"""Roll, pitch and yaw of quaternions: as fields, in bytes, and at the topic."""

import math

from geometry_msgs.msg import PoseStamped, Quaternion, Transform
from hypothesis import given, strategies as st
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, MultiDOFJointState, Range
from std_msgs.msg import String

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import compile_accessor
from vsensor_ros.node.cdr import decode, Reader
from vsensor_ros.node.disowned import heed_marks
from vsensor_ros.node.known import Refused
from vsensor_ros.node.orientation import ANGLES, EulerAngle
from vsensor_ros.node.variance import compile_variance
from vsensor_ros.observers import Design, VirtualSensor
from vsensor_ros.reason import Reason

NAMES = list(ANGLES)
FIELDS = [(Imu, 'orientation'), (Odometry, 'pose.pose.orientation'),
          (PoseStamped, 'pose.orientation')]
TURN = st.floats(-math.pi, math.pi)
PITCH = st.floats(-1.55, 1.55)  # at 90 degrees roll and yaw are one


def quaternion(roll, pitch, yaw, size=1.0):
    return tuple((size * Rotation.from_euler('xyz', [roll, pitch, yaw]).as_quat()).tolist())


def angles_of(q):
    return Rotation.from_quat(q).as_euler('xyz')


def message_of(kind, path, q):
    message = kind()
    holder = message
    for field in path.split('.'):
        holder = getattr(holder, field)
    holder.x, holder.y, holder.z, holder.w = q
    return message


def in_message(message, path):
    for field in path.split('.'):
        message = getattr(message, field)
    return message.x, message.y, message.z, message.w


@given(TURN, PITCH, TURN, st.floats(0.97, 1.03))
def test_each_angle_is_that_of_the_rotation(roll, pitch, yaw, size):
    q = quaternion(roll, pitch, yaw, size)
    for name, truth in zip(NAMES, (roll, pitch, yaw)):
        assert math.remainder(EulerAngle(name, 'q').read(q) - truth, math.tau) == pytest.approx(
            0.0, abs=1e-6)


@given(TURN, PITCH, TURN, st.floats(-9.0, 9.0), st.sampled_from(range(3)))
def test_only_the_angle_that_is_meant_changes(roll, pitch, yaw, value, which):
    if which == 1:
        value /= 6.0
    before = np.array([roll, pitch, yaw])
    q = EulerAngle(NAMES[which], 'q').changed(quaternion(*before), value)
    assert math.hypot(*q) == pytest.approx(1.0, abs=1e-12)
    before[which] = value
    assert np.abs((angles_of(q) - before + math.pi) % math.tau - math.pi) == pytest.approx(
        np.zeros(3), abs=1e-6)


@pytest.mark.parametrize('kind, path', FIELDS)
@pytest.mark.parametrize('name', NAMES)
def test_bytes_and_messages_say_the_same(kind, path, name):
    field = f'{name}({path})'
    reader, accessor = Reader(kind, [field]), compile_accessor(kind, field)
    for euler in ([0.1, -0.2, 3.1], [3.0, 1.2, -3.1], [-1.0, 0.5, 0.0]):
        message = message_of(kind, path, quaternion(*euler))
        raw = serialize_message(message)
        for _ in range(2):  # walked through, and as it was before
            reading = reader.read(raw)
            assert reading.values == (pytest.approx(euler[NAMES.index(name)]),)
        assert accessor.get(message) == reading.values[0]
        written = reader.write(raw, reading, {0: 0.7})
        assert accessor.put(message, 0.7) is None
        assert decode(kind, written) == message
        after = list(euler)
        after[NAMES.index(name)] = 0.7
        assert angles_of(in_message(message, path)) == pytest.approx(after)


@pytest.mark.parametrize('q', [(0.0,) * 4, (0.0, 0.0, 1.0, 1.0), (math.inf, 0.0, 0.0, 0.0)])
def test_what_is_no_rotation_is_no_reading(q):
    reader = Reader(Imu, ['yaw(orientation)'])
    good, bad = (serialize_message(message_of(Imu, 'orientation', q))
                 for q in (quaternion(0.3, 0.2, 0.1), q))
    assert reader.read(good).values == (pytest.approx(0.1),)
    why = reader.read(bad).values[0]
    assert isinstance(why, Reason) and str(why) == \
        'the quaternion of yaw(orientation) is no rotation: all zeros, or not normalised'
    # an estimate in its place has the roll and the pitch of the last message that had some
    written = decode(Imu, reader.write(bad, reader.read(bad), {0: 1.0}))
    assert angles_of(in_message(written, 'orientation')) == pytest.approx([0.3, 0.2, 1.0])


def test_nan_marks_the_angle_that_is_not_known():
    yaw, roll = (compile_accessor(Imu, f'{name}(orientation)') for name in ('yaw', 'roll'))
    message = message_of(Imu, 'orientation', quaternion(0.3, 0.2, 0.1))
    assert yaw.get(message) == pytest.approx(0.1) and roll.get(message) == pytest.approx(0.3)
    assert yaw.put(message, math.nan) is None and math.isnan(yaw.get(message))
    assert roll.put(message, 0.4) is None  # which is known does not make the other known
    assert math.isnan(message.orientation.z)
    assert yaw.put(message, 0.5) is None
    assert angles_of(in_message(message, 'orientation'))[1:] == pytest.approx([0.2, 0.5])
    assert yaw.put(message, math.inf) is None and math.isnan(message.orientation.z)


def test_room_is_made_for_a_joint_that_is_not_there():
    kind = MultiDOFJointState
    yaw, roll = (compile_accessor(kind, f'{name}(transforms[base].rotation)')
                 for name in ('yaw', 'roll'))
    message = kind(joint_names=['arm'], transforms=[Transform()])
    assert str(yaw.get(message)) == 'yaw(transforms[base].rotation) is not in the message'
    assert yaw.absent(message)
    reader, raw = Reader(kind, [yaw]), serialize_message(message)
    written = decode(kind, reader.write(raw, reader.read(raw), {0: 1.0}))
    assert written.joint_names == ['arm', 'base'] and yaw.get(written) == pytest.approx(1.0)
    assert roll.get(written) == 0.0 and math.isnan(written.transforms[1].translation.x)


@pytest.mark.parametrize('kind, path, matrix, size, first', [
    (Imu, 'orientation', 'orientation_covariance', 3, 0),
    (Odometry, 'pose.pose.orientation', 'pose.covariance', 6, 3)])
@pytest.mark.parametrize('name', NAMES)
def test_the_variance_is_that_of_the_angle(kind, path, matrix, size, first, name):
    field, row = f'{name}({path})', first + NAMES.index(name)
    message = message_of(kind, path, quaternion(0.1, 0.2, 0.3))
    holder = message if kind is Imu else message.pose
    numbers = getattr(holder, matrix.rpartition('.')[2])
    numbers[:] = np.ones(size * size)
    compile_variance(kind, field)(message, 0.2)
    found = np.array(numbers).reshape(size, size)
    assert found[row, row] == pytest.approx(0.04)
    assert not np.delete(found[row], row).any() and not np.delete(found[:, row], row).any()
    assert (np.delete(np.delete(found, row, 0), row, 1) == 1.0).all()
    assert compile_variance(PoseStamped, f'{name}(pose.orientation)') is None
    # the mark of one that does not measure this angle
    accessor = heed_marks(compile_accessor(kind, field))
    reader = Reader(kind, [accessor])
    numbers[(size + 1) * row] = -1.0
    assert 'marked as not there' in str(accessor.get(message))
    assert reader.read(serialize_message(message)).values == (accessor.get(message),)


@pytest.mark.parametrize('path, problem', [
    ('yaw(angular_velocity)', 'angular_velocity is a geometry_msgs/Vector3, which has no yaw'),
    ('yaw(orientation.x)', 'orientation.x is a double, which has no yaw'),
    ('yaw(heading)', 'sensor_msgs/msg/Imu has no field heading'),
    ('yaw()', "'' is not a field"),
    ('heading(orientation)', "'heading(orientation)' is not a field"),
    ('orientation', 'orientation is a geometry_msgs/Quaternion, not a number; '
     'write yaw(orientation), roll or pitch')])
def test_what_is_no_angle(path, problem):
    with pytest.raises(BadInput) as error:
        compile_accessor(Imu, path)
    assert problem in str(error.value)


# ---------------------------------------------------------------------------------- at the topic


def twice(channel, of, factor):
    return VirtualSensor(
        channel, (channel,), (of,), (), np.eye(0), np.zeros((0, 0)), np.zeros((0, 1)),
        np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((1, 0)), np.array([[factor]]), (), (), (),
        None, np.zeros(0), np.zeros((0, 1)), np.zeros(0, dtype=complex), 1.0, 'by hand')


@pytest.fixture
def heading(tmp_path):
    """Return the parameters of a heading, the yaw of an Imu, and of a wheel that turns twice."""
    def parameters(**more):
        path = tmp_path / 'base.json'
        Design('base', '0' * 64, ('x',), (), ('heading', 'wheel'), {}, None, {
            (('heading',), 'heading'): twice('heading', 'wheel', 0.5),
            (('wheel',), 'wheel'): twice('wheel', 'heading', 2.0)}, **more).save(path)
        return {'design_file': str(path), 'rate': 100.0, 'time_constant': 0.0,
                'recovery.dwell': 0.0, 'isolation.type': 'std_msgs/msg/String',
                'sensors.heading.topic': '/imu', 'sensors.heading.type': 'sensor_msgs/msg/Imu',
                'sensors.heading.field': 'yaw(orientation)', 'sensors.wheel.topic': '/wheel',
                'sensors.wheel.type': 'sensor_msgs/msg/Range', 'sensors.wheel.field': 'range'}
    return parameters


def test_the_yaw_of_an_imu_is_replaced_while_it_turns(rig, heading):
    r = rig(heading())
    heard, sent = r.listen('sensor_msgs/msg/Imu', '/imu'), []
    wheels = r.listen('sensor_msgs/msg/Range', '/wheel')
    rate, tilt = 0.05, (0.1, -0.2)

    def turn(periods, yaw=None):
        for _ in range(periods):
            sent.append(rate * len(sent))
            said = sent[-1] if yaw is None else yaw
            imu = Imu(orientation=Quaternion(**dict(zip('xyzw', quaternion(*tilt, said)))))
            imu.angular_velocity.z = rate * 100.0
            r.step(('/imu_raw', imu), ('/wheel_raw', Range(range=2.0 * sent[-1], min_range=-1e6,
                                                           max_range=1e6)))

    def isolate(text, *names):
        r.publisher(String, '/isolation').publish(String(data=text))
        assert r.spin_until(lambda: r.reported == set(names))

    turn(50)
    assert r.spin_until(lambda: len(heard) == 50)
    assert [bytes(raw) for raw in heard] == r.sent['/imu_raw']  # as they came
    isolate('heading', 'heading')
    before, first = len(heard), len(sent)
    turn(200, yaw=1.0)  # stuck, while it turns through pi, and again
    assert r.spin_until(lambda: len(heard) >= before + 200)
    messages = [decode(Imu, raw) for raw in heard[-200:]]
    found = np.array([angles_of(in_message(m, 'orientation')) for m in messages])
    assert np.abs(found[:, 2]).max() > 3.09
    assert found[:, :2] == pytest.approx(np.tile(tilt, (200, 1)), abs=1e-6)
    off = (found[:, 2] - np.array(sent[first:]) + math.pi) % math.tau - math.pi
    assert np.abs(off).max() < 1e-5  # a float32 on the wheel's topic
    assert messages[-1].angular_velocity.z == pytest.approx(rate * 100.0)
    told = r.told()['heading']
    assert told.source == 'virtual' and abs(told.value) <= math.pi
    assert told.residual == pytest.approx(math.remainder(1.0 - sent[-1], math.tau), abs=1e-5)
    isolate('')
    turn(100)
    assert bytes(heard[-1]) == r.sent['/imu_raw'][-1]
    isolate('wheel', 'wheel')  # which does not wrap; the heading has gone on and on inside
    turn(20)
    assert r.told()['wheel'].source == 'virtual'
    wheel = decode(Range, wheels[-1]).range
    assert (wheel - 2.0 * sent[-1]) % (2 * math.tau) == pytest.approx(0.0, abs=1e-4) or \
        (2.0 * sent[-1] - wheel) % (2 * math.tau) == pytest.approx(0.0, abs=1e-4)


def test_a_heading_in_degrees_is_no_yaw(rig, heading):
    with pytest.raises(Refused) as error:
        rig(heading(wrap=({'heading': 360.0},)))
    assert 'sensors.heading.field: yaw(orientation) is in rad, but in the plant a turn of ' \
        'heading is 360; write the plant in rad, with wrap: 2*pi' in str(error.value)
