"""Readings that their own message marks as not there: no readings; and no mark on estimates."""

import math

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import (
    BatteryState,
    FluidPressure,
    Imu,
    LaserEcho,
    LaserScan,
    MultiEchoLaserScan,
    NavSatFix,
    Range,
    TimeReference,
)
from std_msgs.msg import Float64

from vsensor_ros.node.accessor import compile_accessor
from vsensor_ros.node.cdr import decode, Reader
from vsensor_ros.node.disowned import compile_remover, heed_marks


def imu(value, variance=1e-6, own=1e-6):
    message = Imu()
    message.angular_velocity.z = message.orientation.x = value
    for matrix in (message.angular_velocity_covariance, message.orientation_covariance):
        matrix[0], matrix[8] = variance, own
    return message


def odometry(value, variance=0.0, own=0.0):
    message = Odometry()
    message.twist.twist.angular.z = message.pose.pose.position.y = value
    message.twist.covariance[0] = message.pose.covariance[0] = variance
    message.twist.covariance[35] = message.pose.covariance[7] = own
    return message


def pose(value, **variances):
    message = PoseWithCovarianceStamped()
    message.pose = odometry(value, **variances).pose
    return message


def fix(value, status=0, variance=1.0):
    message = NavSatFix(latitude=1.0, longitude=2.0, altitude=value)
    message.status.status = status
    message.position_covariance[0] = variance
    return message


def scan(value, low=0.125, high=8.0):
    return LaserScan(ranges=[1.0, value], range_min=low, range_max=high)


def echoes(value, low=0.125, high=8.0):
    return MultiEchoLaserScan(ranges=[LaserEcho(echoes=[value])], range_min=low, range_max=high)


def ranger(value, low=0.125, high=8.0):
    return Range(range=value, min_range=low, max_range=high)


def battery(value, present=True):
    return BatteryState(voltage=value, current=1.0, present=present, capacity=4.0)


MARKED = [  # field, a message, one with a mark on the field
    ('angular_velocity.z', imu(0.5), imu(0.0, variance=-1.0)),
    ('angular_velocity.z', imu(0.5), imu(0.0, own=-1.0)),
    ('orientation.x', imu(0.5), imu(0.0, variance=-1.0)),
    ('twist.twist.angular.z', odometry(0.5), odometry(0.0, variance=-1.0)),
    ('twist.twist.angular.z', odometry(0.5), odometry(0.0, own=-1.0)),
    ('pose.pose.position.y', odometry(0.5), odometry(0.0, variance=-1.0)),
    ('pose.pose.position.y', pose(0.5), pose(0.0, own=-1.0)),
    ('altitude', fix(0.5), fix(0.0, status=-1)),
    ('altitude', fix(0.5), fix(0.0, status=-2)),  # not set any more
    ('altitude', fix(0.5), fix(0.0, variance=-1.0)),
    ('ranges[1]', scan(0.5), scan(0.0)),
    ('ranges[1]', scan(0.5), scan(9.0)),
    ('ranges[0].echoes[0]', echoes(0.5), echoes(math.inf)),
    ('range', ranger(0.5), ranger(8.5)),
    ('range', ranger(0.5), ranger(math.inf)),
    ('range', ranger(0.5), ranger(-math.inf)),
    ('range', ranger(0.5), Range(range=0.5, variance=-1.0)),
    ('fluid_pressure', FluidPressure(fluid_pressure=0.5), FluidPressure(variance=-1.0)),
    ('voltage', battery(0.5), battery(0.0, present=False)),
    ('data[0]', OccupancyGrid(data=[1]), OccupancyGrid(data=[-1])),
]
UNMARKED = [
    ('angular_velocity.z', imu(0.5, variance=0.0, own=0.0)),
    ('angular_velocity.z', imu(0.5, own=-1e-18)),  # computed, and rounded
    ('linear_acceleration.z', imu(0.0, variance=-1.0)),  # that of something else
    ('angular_velocity.x', imu(0.0, own=-1.0)),
    ('altitude', fix(0.5, status=-2)),  # never set
    ('range', ranger(0.125)), ('range', ranger(8.0)),
    ('range', ranger(9.0, low=0.0, high=0.0)), ('range', ranger(9.0, low=2.0, high=2.0)),
    ('ranges[1]', scan(9.0, low=0.0, high=0.0)),
    ('voltage', battery(0.5, present=False)),  # never set
    ('max_range', ranger(9.0)), ('variance', Range(variance=-1.0)),
    ('capacity', battery(0.5, present=False)),
]


def heeding(kind, path):
    return heed_marks(compile_accessor(kind, path))


def both(accessor, kind, message):
    """Read a message both ways, which must agree."""
    reading = Reader(kind, [accessor]).read(serialize_message(message))
    assert repr(reading.values[0]) == repr(accessor.get(message))
    return reading.values[0]


@pytest.mark.parametrize('path, good, marked', MARKED)
def test_what_is_marked_is_no_reading(path, good, marked):
    kind = type(good)
    accessor = heeding(kind, path)
    assert isinstance(both(accessor, kind, good), float)
    why = both(accessor, kind, marked)
    assert why.code == 'disowned' and str(why).startswith(f'{path} is marked as not there (')
    assert isinstance(both(compile_accessor(kind, path), kind, marked), float)


@pytest.mark.parametrize('path, message', UNMARKED)
def test_what_is_not_marked_is_one(path, message):
    assert isinstance(both(heeding(type(message), path), type(message), message), float)


def test_a_time_that_is_not_filled_in():
    accessor = heeding(TimeReference, 'time_ref.sec')
    assert both(accessor, TimeReference, TimeReference()).code == 'disowned'
    message = TimeReference()
    message.time_ref.nanosec = 1
    assert both(accessor, TimeReference, message) == 0.0


def test_types_without_marks_pay_nothing():
    for kind, path in ((Float64, 'data'), (Imu, 'angular_velocity_covariance[4]'),
                       (Range, 'field_of_view')):
        accessor = compile_accessor(kind, path)
        assert heed_marks(accessor) is accessor


def test_a_mark_on_one_field_leaves_the_others():
    kind, message = Imu, imu(0.5, variance=-1.0)
    message.linear_acceleration.x = 2.0
    reading = Reader(kind, [heeding(kind, path) for path in (
        'angular_velocity.z', 'linear_acceleration.x', 'orientation.x')]
        ).read(serialize_message(message))
    assert [getattr(value, 'code', value) for value in reading.values] == [
        'disowned', 2.0, 'disowned']


@pytest.mark.parametrize('path, good, marked', [
    case for case in MARKED if not isinstance(case[1], OccupancyGrid)])
def test_no_mark_stays_on_what_is_written(path, good, marked):
    kind = type(good)
    accessor = heeding(kind, path)
    accessor.get(good)
    remove = compile_remover(accessor)
    message = decode(kind, serialize_message(marked))
    for value in (0.25, 16.0):  # the latter is beyond the limits of a range
        remove(message, value)
        accessor.put(message, value)
        assert accessor.get(message) == value
    unknown = decode(kind, serialize_message(marked))
    remove(unknown, math.nan)  # nothing is supplied: it is still not there
    assert unknown == marked


def test_a_field_that_was_set_once_is_believed_in_every_layout():
    kind, accessor = BatteryState, heeding(BatteryState, 'voltage')
    reader = Reader(kind, [accessor])
    out, other = battery(12.0, present=False), battery(12.0)
    other.location = 'somewhere else'
    for message, there in ((out, True), (other, True), (out, False), (battery(12.0), True),
                           (out, False)):
        value = reader.read(serialize_message(message)).values[0]
        assert isinstance(value, float) is there


def test_what_else_a_mark_was_on_becomes_nan():
    message = imu(0.0, variance=-1.0)
    compile_remover(heeding(Imu, 'angular_velocity.z'))(message, 0.5)
    assert math.isnan(message.angular_velocity.x) and message.angular_velocity_covariance[0] == 0
    assert message.orientation_covariance[0] == -1.0 and message.orientation.w == 1.0
    message = imu(0.0, own=-1.0)
    compile_remover(heeding(Imu, 'angular_velocity.z'))(message, 0.5)
    assert message.angular_velocity.x == 0.0
    message = fix(0.0, status=-1)
    compile_remover(heeding(NavSatFix, 'altitude'))(message, 0.5)
    assert math.isnan(message.latitude) and message.status.status == 0
    message = imu(0.0, variance=-1e-18, own=-1.0)  # rounded, and marked
    compile_remover(heeding(Imu, 'angular_velocity.z'))(message, 0.5)
    assert message.angular_velocity.x == 0.0


def test_limits_are_widened_no_more_than_needed():
    message, accessor = ranger(0.5), heeding(Range, 'range')
    remove = compile_remover(accessor)
    for value in (0.5, 1e39, math.nan):  # within; more than fits into the field; none
        remove(message, np.float64(value))
        assert message == ranger(0.5)
    remove(message, np.float32(0.0625))
    assert (message.min_range, message.max_range) == (0.0625, 8.0)
    remove(message, np.float32(16.0))
    assert (message.min_range, message.max_range) == (0.0625, 16.0)


# ---- at the topic: y1 comes in another type, and the virtual sensor of y2 is twice y1


def wired(parameters, path, kind, **more):
    return {**parameters, 'sensors.y1.type': f'{kind.__module__.split(".")[0]}/msg/'
            f'{kind.__name__}', 'sensors.y1.field': path,
            **{f'sensors.y1.{key}': value for key, value in more.items()}}


AT_THE_TOPIC = [case for case in MARKED if type(case[1]) in (
    Imu, Odometry, NavSatFix, LaserScan, Range, FluidPressure, BatteryState)][::2]


@pytest.mark.parametrize('path, good, marked', AT_THE_TOPIC)
def test_a_disowned_sensor_is_silent_and_nothing_is_made_of_it(
        rig, parameters, path, good, marked):
    kind = type(good)
    r = rig(wired(parameters, path, kind))
    y1 = r.listen(r.replacer.topics[0].sensors[0].type, '/y1')
    y2 = r.listen('sensor_msgs/msg/Range', '/y2')
    rest = r.healthy(y2=1.0)[1:]
    r.step(('/y1_raw', good), *rest, periods=5)
    assert r.told()['y1'].source == 'real'
    for _ in range(60):  # longer than max_age
        r.step(('/y1_raw', marked), *rest)
    told = r.told()['y1']
    assert told.source == 'silent' and 'is marked as not there (' in told.reason
    assert r.counts['y1', next(why for _, why in r.counts if 'is marked' in why)] == 60
    assert [bytes(raw) for raw in y1] == r.sent['/y1_raw']  # the driver's own go on as they came
    r.isolate('y2')
    before = len(y2)
    r.step(('/y1_raw', marked), *rest, periods=5)
    assert r.told()['y2'].source == 'none' and len(y2) == before


def test_a_driver_that_does_not_mean_the_mark(rig, parameters):
    r = rig(wired(parameters, 'angular_velocity.z', Imu, disowned='use'))
    y2 = r.listen('sensor_msgs/msg/Range', '/y2')
    message, rest = ('/y1_raw', imu(0.5, variance=-1.0)), r.healthy()[1:]
    r.step(message, *rest, periods=60)
    assert r.told()['y1'].source == 'real'
    r.isolate('y2')
    r.step(message, *rest, periods=5)
    assert r.values(y2)[-1] == 1.0


@pytest.mark.parametrize('path, good, marked', AT_THE_TOPIC)
def test_an_estimate_in_its_place_carries_no_mark(rig, parameters, path, good, marked):
    kind = type(good)
    r = rig(wired(parameters, path, kind))
    heard = r.listen(r.replacer.topics[0].sensors[0].type, '/y1')
    r.command(0.5)
    rest = r.healthy()[1:]
    r.step(('/y1_raw', good), *rest, periods=5)
    r.isolate('y1')
    before = len(heard)
    r.step(('/y1_raw', marked), *rest, periods=20)
    accessor = heeding(kind, path)
    accessor.get(good)
    values = [accessor.get(decode(kind, raw)) for raw in heard[before + 2:]]
    assert len(values) >= 18 and all(0.2 < value < 0.5 for value in values)


def test_a_command_that_is_marked_is_none(rig, parameters):
    given = {**parameters, 'commands.u1.type': 'sensor_msgs/msg/Imu',
             'commands.u1.field': 'angular_velocity.z'}
    r = rig(given)
    r.step(('/u1', imu(2.0)), *r.healthy(), periods=3)
    assert not any(name == 'u1' for name, _ in r.counts)
    r.publisher(Imu, '/u1').publish(imu(0.0, variance=-1.0))
    assert r.spin_until(lambda: any(name == 'u1' and 'is marked' in why for name, why in r.counts))
