"""What in a message was measured."""

from geometry_msgs.msg import Point32, PolygonStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu, Joy, Range

from vsensor_ros.node.accessor import put_stamp
from vsensor_ros.node.template import blank


def point(x):
    return Point32(x=x)


def blanked(first, last):
    message = deserialize_message(serialize_message(last), type(last))
    blank(message, first, last)
    return message


def test_what_changed_was_measured_and_what_did_not_is_a_property():
    first, last = Imu(), Imu()
    first.header.frame_id = last.header.frame_id = 'base'
    put_stamp(last, 10**9)
    last.linear_acceleration.x = 9.81
    last.angular_velocity_covariance[4] = first.angular_velocity_covariance[4] = 0.5
    last.orientation_covariance[8] = 0.25
    message = blanked(first, last)
    text = str(message)
    assert text.count('nan') == 2 + text.count('nanosec') and message.header == last.header
    assert str(message.linear_acceleration.x) == str(message.orientation_covariance[8]) == 'nan'
    assert message.angular_velocity_covariance[4] == 0.5 and message.orientation.w == 1.0
    assert blanked(last, last) == last


def test_arrays_of_any_length():
    first, last = Joy(axes=[0.5, 0.25]), Joy(axes=[0.5, 1.0, 2.0], buttons=[1])
    message = blanked(first, last)
    assert message.axes[0] == 0.5 and str(list(message.axes[1:])) == '[nan, nan]'
    assert list(message.buttons) == [1] and list(blanked(last, first).axes[:1]) == [0.5]
    near, far = PolygonStamped(), PolygonStamped()
    near.polygon.points, far.polygon.points = [point(1.0)], [point(1.0), point(2.0)]
    message = blanked(near, far)
    assert message.polygon.points[0] == point(1.0)
    assert str(message.polygon.points[1].x) == 'nan'


def test_a_range_keeps_what_it_is():
    first = Range(field_of_view=0.5, min_range=0.25, max_range=8.0, range=1.0)
    message = blanked(first, Range(field_of_view=0.5, min_range=0.25, max_range=8.0, range=2.0))
    assert (message.field_of_view, message.min_range, message.max_range) == (0.5, 0.25, 8.0)
    assert str(message.range) == 'nan'
