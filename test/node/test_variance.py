import math

from geometry_msgs.msg import (
    AccelWithCovarianceStamped,
    PoseStamped,
    PoseWithCovarianceStamped,
    TwistWithCovarianceStamped,
    WrenchStamped,
)
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from sensor_msgs.msg import (
    BatteryState,
    FluidPressure,
    Illuminance,
    Imu,
    JointState,
    MagneticField,
    NavSatFix,
    Range,
    RelativeHumidity,
    Temperature,
)
from std_msgs.msg import Float64, Float64MultiArray

from vsensor_ros.node.accessor import compile_accessor
from vsensor_ros.node.variance import compile_variance, metres_per_degree

LINEAR = [(axis, place) for axis, place in zip('xyz', (0, 7, 14))]
ANGULAR = [(axis, place) for axis, place in zip('xyz', (21, 28, 35))]
IN_3_BY_3 = [(axis, place) for axis, place in zip('xyz', (0, 4, 8))]

MATRICES = [
    *((Imu, f'angular_velocity.{a}', 'angular_velocity_covariance', i) for a, i in IN_3_BY_3),
    *((Imu, f'linear_acceleration.{a}', 'linear_acceleration_covariance', i)
      for a, i in IN_3_BY_3),
    *((MagneticField, f'magnetic_field.{a}', 'magnetic_field_covariance', i)
      for a, i in IN_3_BY_3),
    *((Odometry, f'pose.pose.position.{a}', 'pose.covariance', i) for a, i in LINEAR),
    *((Odometry, f'twist.twist.linear.{a}', 'twist.covariance', i) for a, i in LINEAR),
    *((Odometry, f'twist.twist.angular.{a}', 'twist.covariance', i) for a, i in ANGULAR),
    *((PoseWithCovarianceStamped, f'pose.pose.position.{a}', 'pose.covariance', i)
      for a, i in LINEAR),
    *((TwistWithCovarianceStamped, f'twist.twist.linear.{a}', 'twist.covariance', i)
      for a, i in LINEAR),
    *((TwistWithCovarianceStamped, f'twist.twist.angular.{a}', 'twist.covariance', i)
      for a, i in ANGULAR),
    *((AccelWithCovarianceStamped, f'accel.accel.linear.{a}', 'accel.covariance', i)
      for a, i in LINEAR),
    *((AccelWithCovarianceStamped, f'accel.accel.angular.{a}', 'accel.covariance', i)
      for a, i in ANGULAR),
    (NavSatFix, 'altitude', 'position_covariance', 8),
]
SCALARS = [(FluidPressure, 'fluid_pressure'), (Temperature, 'temperature'), (Range, 'range'),
           (RelativeHumidity, 'relative_humidity'), (Illuminance, 'illuminance')]
NONE = [
    (Imu, 'orientation.x'), (Odometry, 'pose.pose.orientation.w'),
    (Odometry, 'pose.covariance[0]'), (Imu, 'angular_velocity_covariance[4]'),
    (PoseStamped, 'pose.position.x'), (WrenchStamped, 'wrench.force.x'),
    (Range, 'max_range'), (Range, 'variance'), (Temperature, 'header.stamp.sec'),
    (NavSatFix, 'position_covariance_type'), (BatteryState, 'voltage'), (Float64, 'data'),
    (Float64MultiArray, 'data[0]'), (JointState, 'position[elbow]'),
]


def matrix_of(message, path):
    for field in path.split('.'):
        message = getattr(message, field)
    return message


@pytest.mark.parametrize('kind, path, matrix, place', MATRICES)
def test_variance_lands_on_its_place_of_the_diagonal(kind, path, matrix, place):
    message = kind()
    covariance = matrix_of(message, matrix)
    size = math.isqrt(len(covariance))
    covariance[:] = np.arange(1.0, len(covariance) + 1)
    expected = covariance.reshape(size, size).copy()
    row = place // (size + 1)
    expected[row, :] = expected[:, row] = 0.0
    expected[row, row] = 0.25
    assert compile_accessor(kind, path).put(message, 3.0) is None
    compile_variance(kind, path)(message, np.float32(0.5))
    assert matrix_of(message, matrix).tolist() == expected.ravel().tolist()
    assert compile_accessor(kind, path).get(message) == 3.0


@pytest.mark.parametrize('kind, path, matrix, place', MATRICES)
def test_no_quantity_that_we_supply_is_disowned(kind, path, matrix, place):
    for deviation, variance in ((2.0, 4.0), (math.inf, 0.0), (math.nan, 0.0)):
        message = kind()
        matrix_of(message, matrix)[0] = -1.0
        compile_variance(kind, path)(message, deviation)
        expected = np.zeros(len(matrix_of(message, matrix)))
        expected[place] = variance
        assert matrix_of(message, matrix).tolist() == expected.tolist()


@pytest.mark.parametrize('kind, path', SCALARS)
def test_variance_beside_a_number(kind, path):
    message = kind(variance=7.0)
    assert compile_accessor(kind, path).put(message, 3.0) is None
    put = compile_variance(kind, path)
    put(message, np.float32(0.5))
    assert message.variance == 0.25 and compile_accessor(kind, path).get(message) == 3.0
    put(message, math.inf)
    assert message.variance == 0.0
    put(message, 1e200)
    assert 1e38 < message.variance < math.inf


@pytest.mark.parametrize('kind, path', NONE)
def test_what_has_no_variance(kind, path):
    assert compile_variance(kind, path) is None


def test_a_covariance_of_more_than_one_thing_is_left_alone():
    class Two:
        @staticmethod
        def get_fields_and_field_types():
            return {'pose': 'geometry_msgs/Pose', 'covariance': 'double[36]', 'mean': 'double'}

    assert compile_variance(Two, 'pose.position.x') is None


def test_a_degree_is_as_long_as_on_the_earth():
    # NGA TR8350.2, arc lengths of one degree on WGS84
    for latitude, north, east in ((0.0, 110574.3, 111319.5), (45.0, 111131.8, 78846.8),
                                  (-60.0, 111412.3, 55800.1), (90.0, 111693.9, 0.0)):
        assert metres_per_degree(latitude) == pytest.approx((north, east), abs=0.1)


@pytest.mark.parametrize('path, place, metres', [('longitude', 0, 78.8468),
                                                 ('latitude', 4, 111.1318)])
def test_degrees_become_metres(path, place, metres):
    message = NavSatFix(latitude=45.0, longitude=8.0)
    put = compile_variance(NavSatFix, path)
    put(message, math.inf)
    assert message.position_covariance_type == NavSatFix.COVARIANCE_TYPE_UNKNOWN
    assert not message.position_covariance.any()
    put(message, 1e-3)
    expected = np.zeros(9)
    expected[place] = metres**2
    assert message.position_covariance == pytest.approx(expected, rel=1e-5)
    assert message.position_covariance_type == NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
    message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_KNOWN
    for latitude, expected[place] in ((45.0, metres**2), (math.nan, 0.0), (math.inf, 0.0)):
        message.latitude = latitude
        put(message, 1e-3)
        assert message.position_covariance_type == NavSatFix.COVARIANCE_TYPE_KNOWN
        assert message.position_covariance == pytest.approx(expected, rel=1e-5)
