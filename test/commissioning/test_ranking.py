"""Which field is taken for which sensor, and why; candidates as a graph would have them."""

from dataclasses import replace
import math

from nav_msgs.msg import Odometry
import pytest

from vsensor_ros.commissioning.candidates import leaves
from vsensor_ros.commissioning.ranking import assign, Candidate, rank, score, Wanted

MEASURED = {'heard': 100, 'found': 100, 'low': -1.0, 'high': 1.0, 'rate': 50.0}
AXES = ('x', 'y', 'z')


def joints(topic, *names, fields=('position', 'velocity', 'effort')):
    units = {'position': ('rad', 'm'), 'velocity': ('rad/s', 'm/s'), 'effort': ('N*m', 'N', 'A')}
    return [Candidate(topic, 'sensor_msgs/msg/JointState', f'{field}[{name}]', units[field], name,
                      **MEASURED) for name in names for field in fields]


def imu(topic):
    return [Candidate(topic, 'sensor_msgs/msg/Imu', f'{field}.{axis}', (unit,), **MEASURED)
            for field, unit in (('angular_velocity', 'rad/s'), ('linear_acceleration', 'm/s^2'))
            for axis in AXES]


def twist(topic, **more):
    return [Candidate(topic, 'geometry_msgs/msg/Twist', f'{field}.{axis}', (unit,),
                      **{**MEASURED, **more})
            for field, unit in (('linear', 'm/s'), ('angular', 'rad/s')) for axis in AXES]


def number(topic, **more):
    return Candidate(topic, 'std_msgs/msg/Float64', 'data', **{**MEASURED, **more})


def gauge(topic):
    return Candidate(topic, 'sensor_msgs/msg/Range', 'range', ('m',),
                     moved=topic.endswith('_raw'), **MEASURED)


def sensor(name, unit='', *hints):
    return Wanted(name, False, unit, hints)


def command(name, unit=''):
    return Wanted(name, True, unit)


def best(wanted, candidates):
    """Return topic and field of the best for each, and whether it is sure."""
    return {c.wanted.name: (*c.proposal.candidate.place, c.sure)
            for c in assign(wanted, candidates) if c.proposal is not None}


def test_a_gyro_is_the_vertical_axis_of_the_imu():
    found = best([sensor('gyro', 'rad/s')], [*imu('/imu/data'), *twist('/cmd_vel', listened=True)])
    assert found == {'gyro': ('/imu/data', 'angular_velocity.z', True)}


@pytest.mark.parametrize('name, field', [
    ('heading', 'yaw'), ('yaw', 'yaw'), ('theta', 'yaw'), ('tilt_pitch', 'pitch')])
def test_a_heading_is_the_yaw_of_an_orientation(name, field):
    candidates = [*imu('/imu'), *(Candidate('/imu', 'sensor_msgs/msg/Imu', f'{angle}(orientation)',
                                            ('rad',), **MEASURED)
                                  for angle in ('roll', 'pitch', 'yaw'))]
    assert best([sensor(name, 'rad')], candidates)[name] == ('/imu', f'{field}(orientation)', True)


def test_an_orientation_has_three_angles():
    message = Odometry()
    message.pose.pose.orientation.z = message.pose.pose.orientation.w = 0.5**0.5
    found = {leaf.path: leaf for leaf in leaves(message)}
    yaw, roll = (found[f'{name}(pose.pose.orientation)'] for name in ('yaw', 'roll'))
    assert (yaw.value, roll.value) == pytest.approx((math.pi / 2, 0.0))
    assert yaw.units == ('rad',)


@pytest.mark.parametrize('name, field', [
    ('roll_rate', 'angular_velocity.x'), ('gyro_y', 'angular_velocity.y'),
    ('wz', 'angular_velocity.z'), ('yaw_rate', 'angular_velocity.z')])
def test_an_axis_in_the_name_counts(name, field):
    assert best([sensor(name, 'rad/s')], imu('/imu'))[name][:2] == ('/imu', field)


def test_a_level_in_metres_is_the_gauge_that_is_named_like_it():
    candidates = [gauge('/tank/level1_raw'), gauge('/tank/level2_raw'), number('/tank/u1')]
    assert best([sensor('level2', 'm'), sensor('y2', 'm', 'level1')], candidates) == {
        'level2': ('/tank/level2_raw', 'range', True), 'y2': ('/tank/level1_raw', 'range', True)}


def test_joints_are_found_by_words_of_their_names():
    candidates = joints('/joint_states', 'left_wheel_joint', 'right_wheel_joint')
    found = best([sensor('left_wheel_speed', 'rad/s'), sensor('right_wheel_speed', 'rad/s'),
                  sensor('left_wheel_angle', 'rad')], candidates)
    assert found == {
        'left_wheel_speed': ('/joint_states', 'velocity[left_wheel_joint]', True),
        'right_wheel_speed': ('/joint_states', 'velocity[right_wheel_joint]', True),
        'left_wheel_angle': ('/joint_states', 'position[left_wheel_joint]', True)}


def test_a_unit_that_is_not_the_fields_is_never_proposed():
    assert score(sensor('range', 'rad'), gauge('/range')) is None
    assert score(sensor('a', 'deg/s'), imu('/a')[0]) is None
    assert score(sensor('range', 'm'), gauge('/range')).score > \
        score(sensor('range', ''), gauge('/range')).score


def test_units_are_compared_however_they_are_spelt():
    assert rank(sensor('accel', 'm s^-2'), imu('/imu'))[0].candidate.field == \
        'linear_acceleration.x'


def test_a_command_is_what_somebody_hears():
    candidates = [*twist('/cmd_vel', listened=True), *twist('/measured_vel'), *imu('/imu')]
    found = best([command('v', 'm/s'), command('omega', 'rad/s')], candidates)
    assert found == {'v': ('/cmd_vel', 'linear.x', True), 'omega': ('/cmd_vel', 'angular.z', True)}


def test_a_topic_has_sensors_or_commands():
    candidates = twist('/base', listened=True)
    found = best([sensor('speed', 'm/s'), command('u', 'm/s')], candidates)
    assert len(found) == 1


def test_a_command_may_wait_for_its_publisher_a_sensor_not():
    silent = number('/u', heard=0, found=0, published=False, listened=True)
    assert score(command('u'), silent) is not None
    assert score(sensor('u'), silent) is None


def test_nothing_is_given_to_two():
    candidates = joints('/joint_states', 'motor')
    found = best([sensor('y1', 'rad'), sensor('y2', 'rad')], candidates)
    assert found == {'y1': ('/joint_states', 'position[motor]', False)}  # nor is it sure


def test_two_that_are_alike_are_not_sure():
    choice, = assign([sensor('y1', 'rad')], joints('/joint_states', 'a', 'b'))
    assert not choice.sure and choice.proposal.score == choice.others[0].score
    choice, = assign([sensor('y1', 'rad')], joints('/joint_states', 'a'))
    assert choice.sure


def test_a_float_of_no_likeness_is_not_taken():
    choice, = assign([sensor('y1', 'rad')], [number('/temperature')])
    assert choice.proposal is None and not choice.sure
    assert [p.candidate.topic for p in choice.others] == ['/temperature']


def test_what_is_only_nan_or_stands_still_comes_last():
    numbers = [number('/a/y', found=0), number('/b/y', low=1.0, high=1.0), number('/c/y')]
    assert [p.candidate.topic for p in rank(sensor('y'), numbers)] == ['/c/y', '/b/y', '/a/y']


def test_every_point_has_its_reason():
    proposal = score(sensor('level2', 'm'), gauge('/tank/level2_raw'))
    assert proposal.why == ('in m', 'called level2', 'raw', 'measured', 'moves')
    assert proposal.score == 13.5


def array(topic, length, **more):
    return [Candidate(topic, 'std_msgs/msg/Float64MultiArray', f'data[{i}]',
                      **{**MEASURED, **more}) for i in range(length)]


@pytest.mark.parametrize('names', [('shoulder_effort', 'elbow_effort'),
                                   ('elbow_effort', 'shoulder_effort')])
def test_a_tie_goes_by_the_plants_order_and_is_never_sure(names):
    still = {'low': 0.0, 'high': 0.0, 'listened': True}
    commands = [*array('/effort_controller/commands', 1, **still),
                *array('/effort_controller/commands', 2, listened=True)[1:]]
    wanted = [command(name, 'N*m') for name in names]
    for candidates in (commands, [*commands, number('/battery')]):
        assert best(wanted, candidates) == {
            name: ('/effort_controller/commands', f'data[{i}]', False)
            for i, name in enumerate(names)}


def test_elements_are_counted_not_spelt():
    commands = array('/effort_controller/commands', 12, listened=True)
    found = best([command(f'effort_{name}') for name in 'abcdefghijkl'], commands)
    assert [field for _, field, _ in found.values()] == [f'data[{i}]' for i in range(12)]


def test_a_unit_that_is_seldom_the_fields_is_not_sure_beside_one_that_is():
    candidates = [*twist('/odom'), *joints('/joint_states', 'wheel')]
    assert not best([sensor('wheel_speed', 'm/s')], candidates)['wheel_speed'][-1]
    found = best([sensor('slider_position', 'm')], [gauge('/scan'), *joints('/j', 'slider')])
    assert found == {'slider_position': ('/j', 'position[slider]', True)}


def test_what_two_names_fit_alike_is_not_sure():
    found = best([sensor('yaw_rate', 'rad/s'), sensor('turn_rate', 'rad/s')], imu('/imu'))
    assert not any(sure for _, _, sure in found.values())


def test_commands_are_no_sensors():
    commands = [number('/left_wheel/command', listened=True), *array('/arm/commands', 2),
                *twist('/cmd_vel'), *joints('/joint_setpoints', 'elbow'),
                Candidate('/state', 'a/msg/B', 'reference.left_wheel', **MEASURED)]
    wanted = [sensor('left_wheel_speed', 'rpm'), sensor('T1', 'degC'), sensor('elbow', 'rad'),
              sensor('v', 'm/s')]
    assert all(c.proposal is None and not c.others for c in assign(wanted, commands))
    assert best([sensor('reference_range', 'm')], [gauge('/reference/range')])


def test_the_place_in_an_array_and_a_lone_number_are_no_name():
    for candidates in (array('/numbers', 3), [number('/heater1/power')]):
        choice, = assign([sensor('T1', 'degC')], candidates)
        assert choice.proposal is None and len(choice.others) == len(candidates)


def test_no_unit_is_no_agreement():
    for unit in ('1', '-', ''):
        candidates = [Candidate('/battery', 'sensor_msgs/msg/BatteryState', 'percentage', ('1',),
                                **MEASURED)]
        choice, = assign([sensor('encoder', unit)], candidates)
        assert choice.proposal is None and len(choice.others) == len(candidates)


@pytest.mark.parametrize('name, topic', [('level1', '/tank/level2'),
                                         ('left_range', '/range/right')])
def test_what_is_called_otherwise_is_not_sure(name, topic):
    choice, = assign([sensor(name, 'm')], [gauge(topic)])
    assert choice.proposal.doubt and not choice.sure


@pytest.mark.parametrize('place', ['', '/plant1'])
@pytest.mark.parametrize('kind', [number, gauge])
def test_numbers_pair(place, kind):
    tank1, tank2 = kind(f'{place}/tank1/level'), number(f'{place}/tank2/level')
    candidates = [tank1, tank2, number(f'{place}/tank1/temperature')]
    found = best([sensor('h1', 'm', 'level1'), sensor('h2', 'm', 'level2')], candidates)
    assert found == {'h1': (*tank1.place, True), 'h2': (*tank2.place, True)}


def test_a_joint_that_is_named_is_no_axis_of_a_base():
    candidates = [*imu('/imu/data'), *[replace(c, moved=True) for c in imu('/imu2/data_raw')],
                  *joints('/joint_states', 'left_wheel_joint', 'right_wheel_joint', 'shoulder')]
    found = best([sensor('left_speed', 'rad/s', 'left'), sensor('va', 'rad/s', 'vel_shoulder')],
                 candidates)
    assert found == {'left_speed': ('/joint_states', 'velocity[left_wheel_joint]', True),
                     'va': ('/joint_states', 'velocity[shoulder]', True)}


def test_the_order_of_what_was_found_does_not_matter():
    candidates = [*joints('/j', 'elbow', 'wrist'), *imu('/imu'), gauge('/range')]
    wanted = [sensor('elbow', 'rad'), sensor('wrist_speed', 'rad/s'), sensor('gyro', 'rad/s')]
    assert best(wanted, candidates) == best(wanted[::-1], candidates[::-1]) == {
        'elbow': ('/j', 'position[elbow]', True), 'wrist_speed': ('/j', 'velocity[wrist]', True),
        'gyro': ('/imu', 'angular_velocity.z', True)}
