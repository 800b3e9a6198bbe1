"""Names that are alike, and units in all their spellings."""

import pytest

from vsensor_ros.commissioning.likeness import bracketed, clean, nearest, nearest_topic, words_of
from vsensor_ros.commissioning.units import one_spelling, units_of


@pytest.mark.parametrize('name, meant, others', [
    ('/u_A', '/u_a', ['/u_b', '/isolation', '/joint_states']),
    ('/isolation', '/robot1/isolation', ['/diagnostics', '/clock']),
    ('/joint_state', '/joint_states', ['/joint_commands']),
    ('left_wheel', 'left_wheel_', ['right_wheel']),
])
def test_what_was_meant(name, meant, others):
    assert nearest(name, [*others, meant]) == nearest(name, [meant, *others]) == meant


def test_what_is_not_alike_is_not_proposed():
    assert nearest('/u_a', ['/joint_states', '/clock', '/u_a']) is None
    assert nearest('/u_a', []) is None


def test_the_wanted_type_comes_first():
    types = {'/u_aa': 'std_msgs/msg/String', '/u_ab': 'std_msgs/msg/Float64'}
    assert nearest_topic('/u_a', types, 'std_msgs/msg/Float64') == '/u_ab'
    assert nearest_topic('/u_a', types, 'sensor_msgs/msg/Range') in types


def test_words():
    assert words_of('/arm/joint_states_raw') == ('arm', 'joint', 'states', 'raw')
    assert words_of('leftWheelSpeed2') == ('left', 'wheel', 'speed', '2')
    assert words_of('joint01') == ('joint', '1')
    assert words_of('IMUData') == ('imu', 'data')


def test_nothing_from_outside_steers_a_terminal():
    assert clean('a\x1b[2J\nb') == 'a?[2J?b'


@pytest.mark.parametrize('written, unit', [
    ('rad s^-1', 'rad/s'), ('m/(s^2)', 'm/s^2'), ('m s^-2', 'm/s^2'), ('m/s²', 'm/s^2'),
    ('Nm', 'N*m'), ('N m', 'N*m'), ('°C', 'degC'), (' rad / s ', 'rad/s'), ('m**3/s', 'm^3/s'),
    ('A/(V s)', 'A/V/s'), ('', '')])
def test_units_in_one_spelling(written, unit):
    assert one_spelling(written) == unit
    assert one_spelling(unit) == unit


def test_units_of_fields():
    assert units_of('sensor_msgs/Range', 'range') == ('m',)
    assert units_of('std_msgs/Float64', 'data') == ()


@pytest.mark.parametrize('name', ['elbow', 'arm/elbow.left', 'a b', '1', '-2', '#3', 'a[0]',
                                  "it's", 'the "one"'])
def test_a_name_of_any_characters_is_that_joint_in_the_field(name):
    from sensor_msgs.msg import JointState

    from vsensor_ros.commissioning.candidates import leaves
    from vsensor_ros.node.accessor import compile_accessor, trace
    assert trace(JointState, f'position{bracketed(name)}')[-1].name == name
    message = JointState(name=['other', name], position=[1.0, 2.0])
    leaf = list(leaves(message))[-1]
    assert leaf.element == name and leaf.units == ('rad', 'm')
    assert compile_accessor(JointState, leaf.path).get(message) == leaf.value == 2.0
