"""Which field is taken for which sensor, and why; candidates as a graph would have them."""

import pytest

from vsensor_ros.commissioning.ranking import assign, Candidate, rank, score, sure, Wanted

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
    return {name: (ranks[0].candidate.topic, ranks[0].candidate.field, sure(ranks))
            for name, ranks in assign(wanted, candidates).items() if ranks}


def test_a_gyro_is_the_vertical_axis_of_the_imu():
    found = best([sensor('gyro', 'rad/s')], [*imu('/imu/data'), *twist('/cmd_vel', listened=True)])
    assert found == {'gyro': ('/imu/data', 'angular_velocity.z', True)}


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
    ranks = assign([sensor('y1', 'rad'), sensor('y2', 'rad')], candidates)
    assert [len(ranks[name]) for name in ('y1', 'y2')].count(0) == 1


def test_two_that_are_alike_are_not_sure():
    ranks = assign([sensor('y1', 'rad')], joints('/joint_states', 'a', 'b'))['y1']
    assert not sure(ranks) and ranks[0].score == ranks[1].score
    assert sure(assign([sensor('y1', 'rad')], joints('/joint_states', 'a'))['y1'])


def test_a_float_of_no_likeness_is_not_sure():
    assert not sure(assign([sensor('y1', 'rad')], [number('/temperature')])['y1'])


def test_what_is_only_nan_or_stands_still_comes_last():
    numbers = [number('/a/y', found=0), number('/b/y', low=1.0, high=1.0), number('/c/y')]
    assert [p.candidate.topic for p in rank(sensor('y'), numbers)] == ['/c/y', '/b/y', '/a/y']


def test_every_point_has_its_reason():
    proposal = score(sensor('level2', 'm'), gauge('/tank/level2_raw'))
    assert proposal.why == ('in m', 'called level2', 'raw', 'measured', 'moves')
    assert proposal.score == 9.5


def test_the_order_of_what_was_found_does_not_matter():
    candidates = [*joints('/j', 'elbow', 'wrist'), *imu('/imu'), gauge('/range')]
    wanted = [sensor('elbow', 'rad'), sensor('wrist_speed', 'rad/s'), sensor('gyro', 'rad/s')]
    assert best(wanted, candidates) == best(wanted[::-1], candidates[::-1]) == {
        'elbow': ('/j', 'position[elbow]', True), 'wrist_speed': ('/j', 'velocity[wrist]', True),
        'gyro': ('/imu', 'angular_velocity.z', True)}
