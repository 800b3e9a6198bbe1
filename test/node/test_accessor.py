import math

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Pose, PoseArray, TwistWithCovarianceStamped, WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import (
    BatteryState,
    FluidPressure,
    Illuminance,
    Imu,
    JointState,
    MagneticField,
    MultiDOFJointState,
    NavSatFix,
    Range,
    RelativeHumidity,
    Temperature,
)
from std_msgs.msg import Float64, Float64MultiArray, Int8, Int32MultiArray, UInt16
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import (
    compile_accessor,
    get_stamp,
    has_stamp,
    message_type,
    put_stamp,
)
from vsensor_ros.node.field_path import in_brackets


def joints():
    return JointState(name=['shoulder', 'elbow'], position=[1.0, 2.0], velocity=[3.0])


def _pose(x):
    pose = Pose()
    pose.position.x = x
    return pose


@pytest.mark.parametrize('message, path, value', [
    (Float64(data=1.5), 'data', 1.5),
    (Range(range=0.5), 'range', 0.5),
    (Odometry(), 'pose.pose.position.x', 0.0),
    (Odometry(), 'twist.covariance[35]', 0.0),
    (Imu(), 'angular_velocity.z', 0.0),
    (Float64MultiArray(data=[1.0, 2.0, 3.0]), 'data[2]', 3.0),
    (joints(), 'position[elbow]', 2.0),
    (joints(), 'position[#0]', 1.0),
    (joints(), 'position["elbow"]', 2.0),
    (joints(), "position['elbow']", 2.0),
    (BatteryState(voltage=12.5, cell_voltage=[4.0]), 'cell_voltage[0]', 4.0),
    (PoseArray(poses=[_pose(1.0), _pose(2.0)]), 'poses[1].position.x', 2.0),
    (UInt16(data=7), 'data', 7.0),
    (TwistWithCovarianceStamped(), 'twist.twist.linear.y', 0.0),
    (FluidPressure(fluid_pressure=1e5), 'fluid_pressure', 1e5),
    (Temperature(temperature=21.5), 'temperature', 21.5),
    (RelativeHumidity(relative_humidity=0.5), 'relative_humidity', 0.5),
    (Illuminance(illuminance=300.0), 'illuminance', 300.0),
    (MagneticField(), 'magnetic_field.z', 0.0),
    (NavSatFix(latitude=-33.9), 'latitude', -33.9),
    (WrenchStamped(), 'wrench.torque.x', 0.0),
])
def test_reads_and_writes_what_it_reads(message, path, value):
    accessor = compile_accessor(type(message), path)
    assert accessor.get(message) == value
    assert type(accessor.get(message)) is float
    assert accessor.put(message, np.float64(9.0)) is None
    assert accessor.get(message) == 9.0


def test_writes_nothing_else():
    message, expected = joints(), joints()
    compile_accessor(JointState, 'position[elbow]').put(message, 9.0)
    expected.position[1] = 9.0
    assert message == expected


def test_a_joint_is_found_wherever_it_stands():
    accessor = compile_accessor(JointState, 'position[elbow]')
    for names in (['elbow', 'shoulder'], ['shoulder', 'elbow'], ['a', 'b', 'elbow'], ['elbow']):
        positions = [5.0 if name == 'elbow' else 0.0 for name in names]
        assert accessor.get(JointState(name=names, position=positions)) == 5.0
    twice = JointState(name=['elbow', 'a', 'elbow'], position=[1.0, 2.0, 3.0])
    assert accessor.get(twice) == 1.0


@pytest.mark.parametrize('kind, path, message, reason, absent', [
    (JointState, 'position[elbow]', JointState(name=['a'], position=[1.0]), 'not in the message',
     True),
    (JointState, 'velocity[elbow]', joints(), 'too short', False),
    (JointState, 'position[elbow]', JointState(), 'not in the message', True),
    (Float64MultiArray, 'data[2]', Float64MultiArray(data=[1.0, 2.0]), 'too short', False),
])
def test_what_is_not_there_is_a_reason_and_gets_room(kind, path, message, reason, absent):
    accessor = compile_accessor(kind, path)
    assert reason in str(accessor.get(message))
    assert accessor.absent(message) is absent
    assert accessor.put(message, 1.0) is None
    assert accessor.get(message) == 1.0 and not accessor.absent(message)


@pytest.mark.parametrize('kind, path, message, reason', [
    (PoseArray, 'poses[0].position.x', PoseArray(), 'not in the message'),
    (Int32MultiArray, 'data[2]', Int32MultiArray(data=[1, 2]), 'too short'),
])
def test_room_that_cannot_be_made(kind, path, message, reason):
    accessor = compile_accessor(kind, path)
    assert reason in str(accessor.get(message))
    assert reason in str(accessor.put(message, 1.0))


def test_room_beside_others():
    message = JointState(name=['a', 'b'], position=[1.0, 2.0], effort=[3.0])
    assert compile_accessor(JointState, 'position[c]').put(message, 9.0) is None
    assert message.name == ['a', 'b', 'c'] and list(message.position) == [1.0, 2.0, 9.0]
    assert not message.velocity and len(message.effort) == 3
    assert message.effort[0] == 3.0 and all(math.isnan(e) for e in message.effort[1:])
    assert compile_accessor(JointState, 'velocity[b]').put(message, 5.0) is None
    assert math.isnan(message.velocity[0]) and message.velocity[1] == 5.0
    assert math.isnan(message.velocity[2]) and len(message.velocity) == 3  # for each name
    data = Float64MultiArray()
    assert compile_accessor(Float64MultiArray, 'data[2]').put(data, 4.0) is None
    assert math.isnan(data.data[0]) and len(data.data) == 3 and data.data[2] == 4.0
    roundtrip = deserialize_message(serialize_message(message), JointState)
    assert roundtrip.name == ['a', 'b', 'c'] and len(roundtrip.effort) == 3


def test_what_a_float_holds_goes_back_as_it_was():
    message = Range()
    for value in (math.inf, -math.inf, np.float32(0.1)):
        message.range = float(value)
        accessor = compile_accessor(Range, 'range')
        assert accessor.put(message, accessor.get(message)) is None
        assert message.range == value


def test_values_that_do_not_fit_are_a_reason():
    assert 'does not fit' in str(compile_accessor(Int8, 'data').put(Int8(), 128.0))
    assert 'does not fit' in str(compile_accessor(Int8, 'data').put(Int8(), math.nan))
    assert 'does not fit' in str(compile_accessor(Range, 'range').put(Range(), 1e39))
    integer = Int8()
    assert compile_accessor(Int8, 'data').put(integer, -127.6) is None
    assert integer.data == -128
    nothing = Range()
    assert compile_accessor(Range, 'range').put(nothing, math.nan) is None
    assert math.isnan(nothing.range)


@pytest.mark.parametrize('kind, path, told', [
    (Range, 'distance', 'its fields are header, radiation_type, field_of_view'),
    (Range, 'header.frame_id', 'is a string, not a number'),
    (Range, 'header', 'not a number'),
    (Range, 'range.x', 'has no fields'),
    (Range, 'range[0]', 'not an array'),
    (Range, '', 'is not a field'),
    (Range, 'range.', 'is not a field'),
    (Range, '__class__', 'is not a field'),
    (Range, 'get_fields_and_field_types', 'has no field'),
    (JointState, 'position', 'position[a name]'),
    (JointState, 'position[#-1]', 'indices begin at 0'),
    (JointState, 'name[0]', 'not a number'),
    (Imu, 'orientation_covariance[9]', 'indices are 0 to 8'),
    (JointState, 'position[#99999999999999999]', 'indices are 0 to 65535'),
    (JointState, 'position[1]', 'may be the element that name calls 1, or an index; write '
     'position["1"] for the name, position[#1] for the index'),
    (JointTrajectory, 'points[0].positions[1]', 'write positions["1"]'),
    (JointTrajectory, 'points[elbow].positions[a]', 'have no names'),
    (JointState, 'position["a]', 'is not a field'),
    (JointState, 'position["a"b]', 'is not a field'),
    (Float64MultiArray, 'data["1"]', 'have no names'),
    (Float64MultiArray, 'data[65536]', 'indices are 0 to 65535'),
    (Float64MultiArray, 'data[elbow]', 'have no names'),
    (DiagnosticArray, 'status[0].level', 'not a number'),
    (BatteryState, 'present', 'not a number'),
])
def test_bad_fields_are_refused_in_one_line(kind, path, told):
    with pytest.raises(BadInput) as raised:
        compile_accessor(kind, path, 'here', 'sensors.y1.field')
    assert told in str(raised.value)
    assert str(raised.value).startswith('here: sensors.y1.field: ')
    assert '\n' not in str(raised.value)


def test_names_of_other_types_are_found_too():
    message = MultiDOFJointState(joint_names=['base'])
    accessor = compile_accessor(MultiDOFJointState, 'transforms[base].translation.x')
    assert accessor.get(message).code == 'not in the message'
    assert accessor.put(message, 2.0) is None
    assert accessor.get(message) == 2.0 and not message.twist
    assert math.isnan(message.transforms[0].translation.y)
    assert math.isnan(message.transforms[0].rotation.w)


def test_names_one_level_above():
    message = JointTrajectory(joint_names=['a', '1'], points=[
        JointTrajectoryPoint(positions=[1.0, 2.0]),
        JointTrajectoryPoint(positions=[3.0, 4.0], velocities=[5.0, 6.0])])
    assert compile_accessor(JointTrajectory, 'points[1].positions["1"]').get(message) == 4.0
    assert compile_accessor(JointTrajectory, 'points[1].positions[#0]').get(message) == 3.0
    lost = compile_accessor(JointTrajectory, 'points[0].velocities[c]')
    assert lost.get(message).code == 'not in the message' and lost.absent(message)
    assert lost.put(message, 7.0) is None and lost.get(message) == 7.0
    assert message.joint_names == ['a', '1', 'c']
    assert [len(p.positions) for p in message.points] == [3, 3]
    assert [len(p.velocities) for p in message.points] == [3, 3]
    assert [len(p.accelerations) for p in message.points] == [0, 0]


def test_names_of_messages_with_arrays():
    """As control_msgs/DynamicJointState has them: joints, and the interfaces of each."""
    states = JointTrajectory(joint_names=['a', 'b'], points=[
        JointTrajectoryPoint(positions=[1.0]), JointTrajectoryPoint(positions=[2.0])])
    with pytest.raises(BadInput, match='have no names; give an index'):  # a and b are taken
        compile_accessor(JointTrajectory, 'points[b].positions[a]')
    assert compile_accessor(JointTrajectory, 'points[b].positions[0]').get(states) == 2.0
    assert compile_accessor(JointTrajectory, 'points[0].positions[a]').get(states) == 1.0


def test_joints_named_by_numbers():
    message = JointState(name=['2', '1', 'a.b[c]'], position=[2.0, 1.0, 3.0])
    for path, value in (('position["1"]', 1.0), ("position['2']", 2.0), ('position[#1]', 1.0),
                        ('position[#0]', 2.0), ('position["a.b[c]"]', 3.0)):
        assert compile_accessor(JointState, path).get(message) == value
    assert compile_accessor(JointState, 'position["0"]').get(message).code == 'not in the message'


@pytest.mark.parametrize('name', ['elbow', '1', '-1', '#1', 'a.b[c]', 'a b', "it's", 'a"b', '_x'])
def test_how_a_name_is_written(name):
    message = JointState(name=['other', name], position=[1.0, 2.0])
    path = f'position[{in_brackets(name)}]'
    assert compile_accessor(JointState, path).get(message) == 2.0
    assert (path == f'position[{name}]') is (name in ('elbow', 'a b', '_x'))


@pytest.mark.parametrize('name, told', [
    ('sensor_msgs/msg/Rang', 'did you mean Range?'),
    ('sensor_msg/msg/Range', 'did you mean sensor_msgs?'),
    ('sensor_msgs/Range', 'is not a message type'),
    ('os', 'is not a message type'),
    ('os.path/msg/Range', 'is not a message type'),
    ('os/msg/Path', 'no package of interfaces'),
    ('std_srvs/msg/Trigger', 'has no message'),
    ('', 'is not a message type'),
])
def test_only_installed_messages_are_loaded(name, told):
    with pytest.raises(BadInput) as raised:
        message_type(name)
    assert told in str(raised.value)


def test_message_type_gives_the_class():
    assert message_type('sensor_msgs/msg/Range') is Range


def test_stamps():
    message = Range()
    for stamp in (0, 1, 1_700_000_000_123_456_789):
        put_stamp(message, stamp)
        assert get_stamp(message) == stamp
    assert has_stamp(Range) and not has_stamp(Float64)


def test_a_name_that_its_driver_says_twice_is_written_wherever_it_stands():
    message = JointState(name=['a', 'a', 'b', 'a'], position=[99.0, 99.0, 2.0])
    assert compile_accessor(JointState, 'position[a]').put(message, 1.5) is None
    assert list(message.position) == [1.5, 1.5, 2.0]
