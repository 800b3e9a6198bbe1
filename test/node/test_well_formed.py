"""Composed messages have an element for each name, in every array that ever had them."""

import math

from geometry_msgs.msg import Transform, Twist
import pytest
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import JointState, MultiDOFJointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from vsensor_ros.node.cdr import decode
from vsensor_ros.node.parameters import read, Refused

JOINTS = 'sensor_msgs/msg/JointState'
NAMES = ['wrist', 'elbow', 'shoulder']


def arm(name=NAMES, position=(0.0, 1.0, 0.5), velocity=(5.0, 6.0, 7.0), effort=()):
    return '/joint_states_raw', JointState(name=list(name), position=list(position),
                                           velocity=list(velocity), effort=list(effort))


def lengths(raw):
    m = decode(JointState, raw)
    return len(m.name), len(m.position), len(m.velocity), len(m.effort)


FAILING = {
    'leaves the velocities out': (arm(velocity=()), (3, 3, 3, 0)),
    'has fewer velocities': (arm(velocity=(5.0,)), (3, 3, 3, 0)),
    'has more velocities': (arm(velocity=(5.0, 6.0, 7.0, 8.0)), (3, 3, 3, 0)),
    'has fewer positions': (arm(position=(0.0, 1.0)), (3, 3, 3, 0)),
    'leaves the joint out': (arm(['wrist', 'shoulder'], (0.0, 0.5), (5.0, 7.0)), (3, 3, 3, 0)),
    'leaves all but names out': (arm(position=(), velocity=()), (3, 3, 3, 0)),
    'has a joint more': (arm([*NAMES, 'finger'], (0.0, 1.0, 0.5, 9.0), (5.0,)), (4, 4, 4, 0)),
    'has a joint more, named only': (arm([*NAMES, 'finger']), (4, 4, 4, 0)),
    'begins with efforts': (arm(effort=(1.0, 2.0, 3.0)), (3, 3, 3, 3)),
}


@pytest.mark.parametrize('field', ['position', 'velocity'])
@pytest.mark.parametrize('driver', FAILING)
def test_arrays_have_an_element_for_each_name(rig, joint_parameters, driver, field):
    r = rig({**joint_parameters, 'sensors.y2.field': f'{field}[elbow]'})
    heard = r.listen(JOINTS, '/joint_states')
    r.step(arm(), r.healthy()[2], periods=5)
    r.isolate('y2')
    failing, expected = FAILING[driver]
    before = len(heard)
    r.step(failing, r.healthy()[2], periods=20)
    assert r.spin_until(lambda: len(heard) >= before + 20)
    assert {lengths(raw) for raw in heard[before + 2:]} == {expected}
    message = decode(JointState, heard[-1])
    estimate = getattr(message, field)[message.name.index('elbow')]
    if 'position' not in driver and 'all but' not in driver:  # which y1 is read from
        assert estimate == 1.0 and message.position[message.name.index('shoulder')] == 0.5


def test_arrays_that_come_and_go(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen(JOINTS, '/joint_states')
    r.step(arm(velocity=()), r.healthy()[2], periods=3)  # a driver that starts
    r.step(arm(effort=(1.0, 2.0, 3.0)), r.healthy()[2])
    r.step(arm(), r.healthy()[2], periods=3)
    r.isolate('y2')
    r.step(arm(velocity=()), r.healthy()[2], periods=5)
    assert lengths(heard[-1]) == (3, 3, 3, 3)
    message = decode(JointState, heard[-1])
    assert all(map(math.isnan, [*message.velocity, *message.effort]))
    r.step(arm(velocity=(5.0, 6.0, 7.0)), r.healthy()[2], periods=5)
    assert list(decode(JointState, heard[-1]).velocity) == [5.0, 6.0, 7.0]
    r.isolate()
    r.step(arm(), r.healthy()[2])
    assert r.spin_until(lambda: bytes(heard[-1]) == r.sent['/joint_states_raw'][-1])


def test_what_another_driver_fills_stays_empty(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen(JOINTS, '/joint_states')
    elbow = arm(['elbow'], [1.0], [])
    shoulder = arm(['shoulder'], [0.5], [7.0])
    for _ in range(5):
        r.step(elbow, r.healthy()[2])
        r.step(shoulder)
    r.isolate('y2')
    before = len(heard)
    for _ in range(5):
        r.step(arm(['elbow'], [99.0], []), r.healthy()[2])
        r.step(shoulder)
    made = [decode(JointState, raw) for raw in heard[before:]]
    made = [m for m in made if list(m.name) == ['elbow']]
    assert made and all(list(m.position) == [1.0] and not m.velocity for m in made)


def test_a_silent_driver_whose_arrays_were_cut(rig, joint_parameters):
    r = rig(joint_parameters)
    heard = r.listen(JOINTS, '/joint_states')
    r.step(arm(), r.healthy()[2], periods=5)
    r.command(0.0)
    r.isolate('y1')
    r.step(arm(velocity=(5.0, 6.0, 7.0, 8.0)), r.healthy()[2], periods=3)
    r.step(r.healthy()[2], periods=60)  # longer than max_age
    assert lengths(heard[-1]) == (3, 3, 3, 0)
    assert 'silent' in r.told()['y1'].reason


def test_joints_of_several_degrees_of_freedom(rig, parameters):
    given = dict(parameters)
    for name, joint in (('y1', 'base'), ('y2', 'arm')):
        given[f'sensors.{name}.topic'] = '/joints'
        given[f'sensors.{name}.type'] = 'sensor_msgs/msg/MultiDOFJointState'
        given[f'sensors.{name}.field'] = f'transforms[{joint}].translation.x'

    def body(base, *arm):
        message = MultiDOFJointState(joint_names=['base', 'arm'], twist=[Twist(), Twist()])
        for value in (base, *arm):
            transform = Transform()
            transform.translation.x = value
            message.transforms.append(transform)
        return '/joints_raw', message

    r = rig(given)
    heard = r.listen('sensor_msgs/msg/MultiDOFJointState', '/joints')
    r.step(body(0.5, 1.0), r.healthy()[2], periods=5)
    r.isolate('y2')
    failing = body(0.5)
    failing[1].twist = []
    r.step(failing, r.healthy()[2], periods=5)
    message = decode(MultiDOFJointState, heard[-1])
    assert [t.translation.x for t in message.transforms] == [0.5, 1.0]
    assert math.isnan(message.transforms[1].translation.y)
    assert len(message.twist) == 2 and math.isnan(message.twist[0].linear.x)
    assert not message.wrench


def test_names_one_level_above_the_arrays(rig, parameters):
    given = dict(parameters)
    for name, field in (('y1', 'positions[a]'), ('y2', 'velocities[b]')):
        given[f'sensors.{name}.topic'] = '/path'
        given[f'sensors.{name}.type'] = 'trajectory_msgs/msg/JointTrajectory'
        given[f'sensors.{name}.field'] = f'points[0].{field}'

    def trajectory(velocities):
        return '/path_raw', JointTrajectory(joint_names=['a', 'b', 'c'], points=[
            JointTrajectoryPoint(positions=[0.5, 2.0, 3.0], velocities=velocities),
            JointTrajectoryPoint(positions=[4.0], velocities=[5.0, 6.0, 7.0])])

    r = rig(given)
    heard = r.listen('trajectory_msgs/msg/JointTrajectory', '/path')
    r.step(trajectory([0.0, 1.0, 0.0]), r.healthy()[2], periods=5)
    r.isolate('y2')
    before = len(heard)
    r.step(trajectory([]), r.healthy()[2], periods=5)
    assert r.spin_until(lambda: len(heard) >= before + 5)
    here, beyond = decode(JointTrajectory, heard[-1]).points
    assert list(here.positions) == [0.5, 2.0, 3.0] and here.velocities[1] == 1.0
    assert math.isnan(here.velocities[0]) and len(here.velocities) == 3
    assert len(beyond.positions) == 3 and list(beyond.velocities) == [5.0, 6.0, 7.0]
    assert not here.accelerations and not beyond.effort


# ---- joints that are named by numbers


def numbered(r, first, second):
    return ('/joint_states_raw', JointState(name=['1', '2', '3'], position=[first, second, 7.0]))


def test_a_joint_named_by_a_number_is_that_joint(rig, joint_parameters):
    r = rig({**joint_parameters, 'sensors.y1.field': 'position["2"]',
             'sensors.y2.field': "position['1']"})
    heard = r.listen(JOINTS, '/joint_states')
    r.step(numbered(r, 1.0, 0.5), r.healthy()[2], periods=5)
    r.isolate('y2')
    before = len(heard)
    r.step(numbered(r, 99.0, 0.75), r.healthy()[2], periods=5)
    assert r.spin_until(lambda: len(heard) >= before + 5)
    made = [list(decode(JointState, raw).position) for raw in heard[before:]]
    assert made[-1] == [1.5, 0.75, 7.0]
    assert all(position[0] != 99.0 for position in made)


def test_an_index_is_one_whatever_the_names(rig, joint_parameters):
    r = rig({**joint_parameters, 'sensors.y1.field': 'position[#1]',
             'sensors.y2.field': 'position[#0]'})
    heard = r.listen(JOINTS, '/joint_states')
    r.step(numbered(r, 1.0, 0.5), r.healthy()[2], periods=5)
    r.isolate('y2')
    r.step(numbered(r, 99.0, 0.75), r.healthy()[2], periods=5)
    assert list(decode(JointState, heard[-1]).position) == [1.5, 0.75, 7.0]
    r.step(('/joint_states_raw', JointState(name=['1', '2', '3'], velocity=[1.0])),
           r.healthy()[2], periods=5)
    assert len(decode(JointState, heard[-1]).position) == 3


def test_a_number_that_could_be_either_is_refused(rig, joint_parameters):
    with pytest.raises(Refused) as refused:
        rig({**joint_parameters, 'sensors.y1.field': 'position[1]'})
    problem, = refused.value.problems
    assert str(problem) == (
        '/replacer: sensors.y1.field: position[1] may be the element that name calls 1, or an '
        'index; write position["1"] for the name, position[#1] for the index')


def test_one_joint_written_in_two_ways_is_one(rig, joint_parameters):
    with pytest.raises(Refused) as refused:
        rig({**joint_parameters, 'sensors.y1.field': 'position["elbow"]'})
    assert 'is that of y1 too' in str(refused.value)


def test_brackets_come_through_a_parameter_file(design_file, tmp_path):
    """Neither quotes nor # mean anything to the parser of ROS where they stand here."""
    path = tmp_path / 'replacer.yaml'
    path.write_text(f"""replacer:
  ros__parameters:
    design_file: {design_file}
    sensors:
      y1: {{topic: /joints, type: {JOINTS}, field: 'position["1"]'}}
      y2: {{topic: /joints, type: {JOINTS}, field: "position[#1]"}}
      y3:
        topic: /joints
        type: {JOINTS}
        field: velocity["1"]   # a comment
    commands:
      u1:
        topic: /u1
        type: {JOINTS}
        field: effort[#1]
""")
    context = Context()
    context.init(args=['--ros-args', '--params-file', str(path)])
    try:
        node = Node('replacer', context=context,
                    automatically_declare_parameters_from_overrides=True)
        settings = read(node)
        node.destroy_node()
    finally:
        context.try_shutdown()
    paths = [s.accessor.path for s in (*settings.sensors, *settings.commands)]
    assert paths == ['position["1"]', 'position[#1]', 'velocity["1"]', 'effort[#1]']
