"""
In which units the fields of the usual messages are; a small table, by REP 103 and the messages.

A unit here is a text in one spelling (`one_spelling`). Of a message that is not listed the unit of
a field is not known, nor is that of a Float64.
"""

from __future__ import annotations

import re

_SPELLINGS = {  # what people write, without blanks, to the one spelling
    'rad*s^-1': 'rad/s', 'm*s^-1': 'm/s', 'm/s/s': 'm/s^2', 'm*s^-2': 'm/s^2', 'Nm': 'N*m',
    'newton': 'N', 'volt': 'V', 'ampere': 'A', 'amp': 'A', 'metre': 'm', 'meter': 'm',
    'radian': 'rad', 'pascal': 'Pa', '°C': 'degC', 'C': 'degC', 'celsius': 'degC',
    'deg': 'deg', '°': 'deg', 'lux': 'lx', 'tesla': 'T', 'Hz': '1/s', 's^-1': '1/s', '-': '1',
    '%': '%',
}

# (message, its field): the units that it may be in, the likeliest first. What lies in a message
# within has the unit of the nearest that is listed.
_FIELDS: dict[tuple[str, str], tuple[str, ...]] = {
    ('sensor_msgs/JointState', 'position'): ('rad', 'm'),
    ('sensor_msgs/JointState', 'velocity'): ('rad/s', 'm/s'),
    ('sensor_msgs/JointState', 'effort'): ('N*m', 'N', 'A'),  # many drives put the current there
    ('control_msgs/DynamicJointState', 'interface_values'): ('',),
    ('sensor_msgs/Imu', 'angular_velocity'): ('rad/s',),
    ('sensor_msgs/Imu', 'linear_acceleration'): ('m/s^2',),
    ('sensor_msgs/Imu', 'orientation'): ('1',),
    ('sensor_msgs/Range', 'range'): ('m',),
    ('sensor_msgs/Temperature', 'temperature'): ('degC',),
    ('sensor_msgs/FluidPressure', 'fluid_pressure'): ('Pa',),
    ('sensor_msgs/RelativeHumidity', 'relative_humidity'): ('1',),
    ('sensor_msgs/Illuminance', 'illuminance'): ('lx',),
    ('sensor_msgs/MagneticField', 'magnetic_field'): ('T',),
    ('sensor_msgs/BatteryState', 'voltage'): ('V',),
    ('sensor_msgs/BatteryState', 'temperature'): ('degC',),
    ('sensor_msgs/BatteryState', 'current'): ('A',),
    ('sensor_msgs/BatteryState', 'charge'): ('A*h',),
    ('sensor_msgs/BatteryState', 'capacity'): ('A*h',),
    ('sensor_msgs/BatteryState', 'design_capacity'): ('A*h',),
    ('sensor_msgs/BatteryState', 'percentage'): ('1',),
    ('sensor_msgs/NavSatFix', 'latitude'): ('deg',),
    ('sensor_msgs/NavSatFix', 'longitude'): ('deg',),
    ('sensor_msgs/NavSatFix', 'altitude'): ('m',),
    ('geometry_msgs/Twist', 'linear'): ('m/s',),
    ('geometry_msgs/Twist', 'angular'): ('rad/s',),
    ('geometry_msgs/Accel', 'linear'): ('m/s^2',),
    ('geometry_msgs/Accel', 'angular'): ('rad/s^2',),
    ('geometry_msgs/Wrench', 'force'): ('N',),
    ('geometry_msgs/Wrench', 'torque'): ('N*m',),
    ('geometry_msgs/Pose', 'position'): ('m',),
    ('geometry_msgs/Pose', 'orientation'): ('1',),
    ('geometry_msgs/Pose2D', 'x'): ('m',),
    ('geometry_msgs/Pose2D', 'y'): ('m',),
    ('geometry_msgs/Pose2D', 'theta'): ('rad',),
    ('geometry_msgs/Transform', 'translation'): ('m',),
    ('geometry_msgs/Transform', 'rotation'): ('1',),
    ('geometry_msgs/PointStamped', 'point'): ('m',),
    ('trajectory_msgs/JointTrajectoryPoint', 'positions'): ('rad', 'm'),
    ('trajectory_msgs/JointTrajectoryPoint', 'velocities'): ('rad/s', 'm/s'),
    ('ackermann_msgs/AckermannDrive', 'steering_angle'): ('rad',),
    ('ackermann_msgs/AckermannDrive', 'steering_angle_velocity'): ('rad/s',),
    ('ackermann_msgs/AckermannDrive', 'speed'): ('m/s',),
    ('ackermann_msgs/AckermannDrive', 'acceleration'): ('m/s^2',),
}


def one_spelling(unit: str) -> str:
    """Return a unit in the spelling of this table: ``m/(s^2)``, ``m s^-2`` and m/s² are m/s^2."""
    text = unit.strip().replace('²', '^2').replace('³', '^3').replace('·', '*')
    text = re.sub(r'\s*([*/^])\s*', r'\1', text.replace('**', '^'))
    text = re.sub(r'\s+', '*', text)
    text = re.sub(r'\(([^()*/]+)\)', r'\1', text)  # (s^2)
    text = re.sub(r'/\(([^()*/]+)\*([^()*/]+)\)', r'/\1/\2', text)  # 1/(V s)
    return _SPELLINGS.get(text, text)


def units_of(message: str, field: str) -> tuple[str, ...]:
    """Return the units that a field of a message (package/Name) may be in; () when not known."""
    return _FIELDS.get((message, field), ())
