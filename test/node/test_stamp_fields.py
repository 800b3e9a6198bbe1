"""Messages with a time of their own beside the header, or without one."""

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
import pytest
from rcl_interfaces.msg import ParameterValue
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Range, TimeReference
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import compile_accessor
from vsensor_ros.node.cdr import decode, Reader
from vsensor_ros.node.parameters import Refused
from vsensor_ros.node.stamp import compile_stamps

S = 1_000_000_000
ARRAY, PATH = 'std_msgs/msg/Float64MultiArray', 'nav_msgs/msg/Path'
DIM = 'layout.dim[0].size'  # uint32; the only integers beside floats that are installed
OFFSET = 'layout.data_offset'


def array(value, *, milliseconds=0, seconds=0):
    message = Float64MultiArray(data=[value])
    message.layout.dim = [MultiArrayDimension(size=milliseconds)]
    message.layout.data_offset = seconds
    return message


def path(value, stamp=0, header=0):
    pose = PoseStamped()
    pose.pose.position.x = value
    pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(stamp, S)
    message = Path(poses=[pose])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(header, S)
    return message


def read(kind, field, stamps, message):
    """Return the stamp of a message, as the reader and the decoder have it."""
    reader = Reader(kind, [compile_accessor(kind, field)], stamps)
    raw = serialize_message(message)
    stamp = reader.read(raw).stamp
    assert stamp == reader._decode(raw).stamp == reader.read(raw).stamp
    return stamp


def test_a_number_of_a_unit():
    for unit, ns in (('ms', 1_000_000), ('us', 1000), ('ns', 1), ('s', S)):
        stamps = compile_stamps(Float64MultiArray, DIM, unit)
        assert read(Float64MultiArray, 'data[0]', stamps, array(1.0, milliseconds=7)) == 7 * ns
        assert read(Float64MultiArray, 'data[0]', stamps, array(1.0)) is None
        message = array(1.0)
        assert stamps[0].put(message, 5 * ns) is None and message.layout.dim[0].size == 5
        assert stamps[0].put(message, 5 * ns + 1) is None  # never older than that
        assert message.layout.dim[0].size == 6
    problem = compile_stamps(Float64MultiArray, DIM, 'ms')[0].put(message, 2**32 * 1_000_000)
    assert problem.code == 'does not fit'


def test_every_nanosecond_counts():
    stamp, = compile_stamps(ParameterValue, 'integer_value', 'ns')
    time = 1_795_969_057_488_063_567
    message = ParameterValue(integer_value=time)
    assert read(ParameterValue, 'double_value', [stamp], message) == time
    assert stamp.put(message, time + 1) is None and message.integer_value == time + 1


def test_an_element_that_is_not_there_is_not_stamped():
    stamp, = compile_stamps(Float64MultiArray, DIM, 'ms')
    empty = Float64MultiArray(data=[1.0])
    assert read(Float64MultiArray, 'data[0]', [stamp], empty) is None
    assert stamp.put(empty, S) is None and not empty.layout.dim


def test_a_header_comes_first_and_all_are_written():
    stamps = compile_stamps(Path, 'poses[0].header.stamp')
    assert [stamp.path for stamp in stamps] == ['header.stamp', 'poses[0].header.stamp']
    message = path(1.0, 5, 7)
    assert read(Path, 'poses[0].pose.position.x', stamps, message) == 7
    for stamp in stamps:
        assert stamp.put(message, 3 * S + 4) is None
    assert message == path(1.0, 3 * S + 4, 3 * S + 4)
    float_stamp, = compile_stamps(Float64MultiArray, 'data[1]', 's')
    message = Float64MultiArray(data=[0.0, 0.0])
    assert float_stamp.put(message, 3 * S // 2) is None and message.data[1] == 1.5
    for text, stamp in ((1.5, 3 * S // 2), (float('nan'), None), (float('inf'), None),
                        (1e300, 4_611_686_018 * S), (0.0, None)):
        message.data[1] = text
        assert float_stamp.get(message) == stamp


@pytest.mark.parametrize('kind, fields, unit, told', [
    (Float64MultiArray, DIM, '', 'stamp_unit: layout.dim[0].size is a number, and its unit'),
    (Float64MultiArray, DIM, 'h', "stamp_unit: 'h' is not a unit of time; choose from s, ms"),
    (Float64MultiArray, 'timestamp', 'us', 'has no field timestamp; its fields are'),
    (Float64MultiArray, 'layout', 'us', 'is a std_msgs/MultiArrayLayout, not a number'),
    (TimeReference, 'source', 'us', 'is a string, not a number'),
    (JointTrajectory, 'points[0].time_from_start', '', 'is a builtin_interfaces/Duration'),
    (JointTrajectory, 'points[0].time_from_start.sec', 's', 'is in a duration, not a time'),
    (Path, 'poses.header.stamp', '', 'is an array'),
])
def test_what_is_no_time_is_refused(kind, fields, unit, told):
    with pytest.raises(BadInput) as raised:
        compile_stamps(kind, fields, unit, 'here', 'sensors.y1.stamp')
    assert told in str(raised.value) and str(raised.value).startswith('here: sensors.y1.stamp')


# ---- at the topic


def wired(parameters, name, kind, field, **more):
    return {**parameters, f'sensors.{name}.type': kind, f'sensors.{name}.field': field,
            **{f'sensors.{name}.{key}': value for key, value in more.items()}}


def test_a_time_without_a_header(rig, parameters):
    """Such as px4 has it: microseconds in an integer of 64 bits, beside the numbers."""
    r = rig(wired(parameters, 'y2', 'rcl_interfaces/msg/ParameterValue', 'double_value',
                  stamp='integer_value', stamp_unit='us'))
    heard = r.listen('rcl_interfaces/msg/ParameterValue', '/y2')

    def send(value):
        stamp = (r.now + 10_000_000) // 1000
        r.step(r.healthy()[0], ('/y2_raw', ParameterValue(
            double_value=value, integer_value=stamp)), r.healthy()[2])

    for _ in range(5):
        send(1.0)
    again = ParameterValue(double_value=9.0, integer_value=r.now // 1000)
    before = r.taken['/y2_raw']
    r.publisher(ParameterValue, '/y2_raw').publish(again)
    assert r.spin_until(lambda: r.taken['/y2_raw'] > before)
    assert ('y2', 'duplicate stamp') in r.counts
    r.isolate('y2')
    before = len(heard)
    for _ in range(10):
        send(99.0)
    assert r.spin_until(lambda: len(heard) >= before + 10)
    made = [decode(ParameterValue, raw) for raw in heard[before:]]
    stamps = [m.integer_value for m in made]
    assert all(m.double_value == 1.0 for m in made)
    assert all(a < b for a, b in zip(stamps, stamps[1:])) and stamps[-1] == r.now // 1000


def test_two_times_without_a_header(rig, parameters):
    """A clock of 1000 s at the start fits into milliseconds of uint32."""
    r = rig(wired(parameters, 'y2', ARRAY, 'data[0]', stamp=f'{DIM}, {OFFSET}', stamp_unit='ms'))
    heard = r.listen(ARRAY, '/y2')
    for value in [1.0] * 5 + [99.0] * 5:
        if value == 99.0:
            r.isolate('y2')
        r.step(r.healthy()[0], ('/y2_raw', array(
            value, milliseconds=(r.now + 10_000_000) // 1_000_000)), r.healthy()[2])
    assert r.spin_until(lambda: len(heard) >= 10)
    made = decode(Float64MultiArray, heard[-1])
    assert made.data[0] == 1.0
    assert made.layout.data_offset == made.layout.dim[0].size == r.now // 1_000_000


def test_poses_in_a_path_get_the_stamp_of_the_estimate(rig, parameters):
    r = rig(wired(parameters, 'y2', PATH, 'poses[0].pose.position.x',
                  stamp='poses[0].header.stamp'))
    heard = r.listen(PATH, '/y2')
    for _ in range(5):
        r.step(r.healthy()[0], ('/y2_raw', path(1.0, r.now)), r.healthy()[2])
    r.isolate('y2')
    before = len(heard)
    for _ in range(5):
        r.step(r.healthy()[0], ('/y2_raw', path(99.0, 3)), r.healthy()[2])
    made = [decode(Path, raw) for raw in heard[before:]]
    assert len(made) >= 5
    for message in made:
        assert message.poses[0].header.stamp == message.header.stamp
        assert message.poses[0].pose.position.x == 1.0


def test_a_command_with_a_time_of_its_own(rig, parameters):
    r = rig({**parameters, 'commands.u1.type': ARRAY, 'commands.u1.field': 'data[0]',
             'commands.u1.stamp': DIM, 'commands.u1.stamp_unit': 'ms'})
    heard = r.listen('sensor_msgs/msg/Range', '/y1')

    def command(value, stamp):
        before = r.taken['/u1']
        r.publisher(Float64MultiArray, '/u1').publish(
            array(value, milliseconds=stamp // 1_000_000))
        assert r.spin_until(lambda: r.taken['/u1'] > before)

    command(0.0, r.now)
    r.step(*r.healthy(), periods=5)
    r.isolate('y1')
    r.step(*r.healthy(), periods=10)
    before = len(heard)
    assert r.values(heard)[-1] < 0.25
    command(10.0, r.now - 40_000_000)
    r.step(*r.healthy(), periods=2)
    assert r.spin_until(lambda: len(heard) >= before + 2)
    # x' = -x + 10 from 40 ms ago, not from now on: after 20 ms more x is 0.58 higher, not 0.2
    assert 0.5 < r.values(heard)[-1] - r.values(heard)[before - 1] < 0.6


def test_sensors_in_one_message_have_one_time(rig, joint_parameters):
    with pytest.raises(Refused) as refused:
        rig({**joint_parameters, 'sensors.y1.stamp': 'effort[wrist]',
             'sensors.y1.stamp_unit': 's', 'sensors.y2.stamp': 'header.stamp'})
    assert 'sensors.y2.stamp: is not that of y1, which comes in the same message; give both ' \
        'the same' in str(refused.value)


def test_a_header_needs_no_name():
    assert [stamp.path for stamp in compile_stamps(Range)] == ['header.stamp']
    assert compile_stamps(Float64MultiArray) == ()
